"""The paper's method: ORB, cross-checked matches, RANSAC, and the mean absolute error as the judge.

Source: Zick, Martinelli, Schneider de Oliveira, Cremer Kalempa, "ORB-Based Map Fusion with Position Transformation
for Enhanced Pairwise Connection", SCITEPRESS 2025, sections 3.3 to 3.6. Where the text gives no number, the number
is that of the code that the authors published; where their code has a defect, the text is followed. The error of
their code is reported beside the text's as `published_error`, with the verdict it leads to.

Nothing here is random in the end: OpenCV seeds the RANSAC of `estimateAffinePartial2D` anew in every call with a
constant of its own and does not touch `cv2.setRNGSeed`, so equal maps give equal results in any number of threads,
and the configuration's seed has no part in it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from mapfusion.config import FusionConfig
from mapfusion.grid import OccupancyGrid, resample
from mapfusion.pairwise.agreement import GOOD_BELOW, Agreement, agreement, mae_band
from mapfusion.result import PairFusion
from mapfusion.transform import SE2, FloatArray

MIN_MATCHES = 25
"""Fewer matches give no transform. Source: the published code."""

_ORB_BORDER = 31
"""Pixels along each border in which ORB at OpenCV's defaults finds nothing (its edge threshold)."""
_GREY = np.array([(255 * p + 50) // 100 if p <= 100 else 0 for p in range(256)], np.uint8)
"""Grey value of a cell read as a byte: 255 an obstacle, 0 free, probabilities between, unknown as the background."""

_ROUNDING_SIGMA = 1.0 / math.sqrt(12.0)
"""Standard deviation, in cells, of a keypoint rounded to a whole pixel."""

Indices = npt.NDArray[np.intp]
PointsPx = npt.NDArray[np.float32]
Image = npt.NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class PaperMap:
    """What the method needs to know of one map, whatever the other one is.

    Attributes:
        grid: The map at the resolution of the comparison.
        image: (height, width), obstacles 255, free and unknown 0; the grid's last row on top, as in a picture file.
        points_px: (N, 2) float32 keypoints as (x, y) in `image`, pixel centres at whole numbers.
        descriptors: (N, 32) uint8 ORB descriptors.
    """

    grid: OccupancyGrid
    image: Image
    points_px: PointsPx
    descriptors: Image

    def __post_init__(self) -> None:
        for array in (self.image, self.points_px, self.descriptors):
            array.flags.writeable = False

    def points_m(self, indices: Indices) -> FloatArray:
        """Some of the keypoints in the grid's frame, metres."""
        x, y = self.points_px[indices].astype(np.float64).T
        corner_to_point = np.stack([x + 0.5, self.grid.height - 0.5 - y], axis=-1) * self.grid.resolution_m
        return self.grid.T_frame_grid.apply(corner_to_point)


def prepare(grid: OccupancyGrid, resolution_m: float) -> PaperMap:
    """Brings a map to `resolution_m` and finds its ORB keypoints at OpenCV's defaults."""
    grid = resample(grid, resolution_m)
    image = np.ascontiguousarray(np.asarray(cv2.LUT(grid.cells.view(np.uint8), _GREY), np.uint8)[::-1])
    points_px, descriptors = _detect(image)
    return PaperMap(grid, image, points_px, descriptors)


def fuse(target: PaperMap, source: PaperMap, config: FusionConfig) -> PairFusion:
    """Looks for the transform between two maps prepared at one resolution, and judges it by the paper's error.

    The confidence falls linearly with the error: 1 at no error, 0.5 at the threshold, 0 at twice the threshold.
    """
    num_target, num_source = len(target.points_px), len(source.points_px)
    finding = partial(
        PairFusion,
        num_keypoints_target=num_target,
        num_keypoints_source=num_source,
        resolution_m=target.grid.resolution_m,
    )
    if min(num_target, num_source) < MIN_MATCHES:
        reason = f"too few keypoints: {num_target} and {num_source}, each map needs {MIN_MATCHES}"
        return finding(accepted=False, gate="few keypoints", reason=reason)

    matches = _match(target.descriptors, source.descriptors)
    num_matches = len(matches.target)
    finding = partial(finding, num_matches=num_matches, evidence={"matches": float(num_matches)})
    if num_matches < MIN_MATCHES:
        reason = f"too few matches: {num_matches}, {MIN_MATCHES} are needed"
        return finding(accepted=False, gate="few matches", reason=reason)

    similarity = _fit_similarity(target.points_px[matches.target], source.points_px[matches.source])
    if similarity is None:
        reason = f"no transform fits the {num_matches} matches"
        return finding(accepted=False, gate="no transform", reason=reason)

    inliers = similarity.inliers
    T_target_source, covariance = _fit_rigid(
        target.points_m(matches.target[inliers]),
        source.points_m(matches.source[inliers]),
        least_sigma_m=target.grid.resolution_m * _ROUNDING_SIGMA,
    )
    common = agreement(target.grid, source.grid, T_target_source)
    finding = partial(
        finding,
        T_target_source=T_target_source,
        covariance=covariance,
        scale=similarity.scale,
        num_inliers=len(inliers),
        mae=common.mae,
        overlap_cells=common.overlap_cells,
        overlap_ratio=common.overlap_ratio,
        evidence={
            "matches": float(num_matches),
            "inlier_ratio": len(inliers) / num_matches,
            **_published_verdict(target.image, source.image, similarity.matrix),
        },
    )
    return _judged(finding, common, config)


def verify(target: PaperMap, source: PaperMap, T_target_source: SE2, config: FusionConfig) -> PairFusion:
    """Judges a transform that is known from before by the error it has now; it stays as it is."""
    common = agreement(target.grid, source.grid, T_target_source)
    finding = partial(
        PairFusion,
        num_keypoints_target=len(target.points_px),
        num_keypoints_source=len(source.points_px),
        resolution_m=target.grid.resolution_m,
        T_target_source=T_target_source,
        mae=common.mae,
        overlap_cells=common.overlap_cells,
        overlap_ratio=common.overlap_ratio,
    )
    return _judged(finding, common, config)


def _judged(finding: Callable[..., PairFusion], common: Agreement, config: FusionConfig) -> PairFusion:
    """The verdict by the error over the cells known in both, in the paper's three bands."""
    if common.mae is None:
        return finding(accepted=False, gate="no overlap", reason="no cell is known in both maps under this transform")
    threshold = GOOD_BELOW if config.mae_threshold is None else config.mae_threshold
    finding = partial(finding, confidence=max(0.0, 1.0 - common.mae / (2.0 * threshold)))
    if common.mae >= threshold:
        reason = f"MAE {common.mae:.2f} is not below {threshold:g} ({mae_band(common.mae)})"
        return finding(accepted=False, gate="mae", reason=reason)
    return finding(accepted=True)


class _Matches(NamedTuple):
    """Row by row, which descriptor of the target goes with which of the source."""

    target: Indices
    source: Indices


class _Similarity(NamedTuple):
    """What RANSAC found: (2, 3) matrix from pixels to pixels of the target, and the (K,) matches that agree."""

    matrix: FloatArray
    inliers: Indices

    @property
    def scale(self) -> float:
        return math.hypot(self.matrix[0, 0], self.matrix[1, 0])


def _detect(image: Image) -> tuple[PointsPx, Image]:
    """Keypoints and descriptors of ORB at OpenCV's defaults."""
    # ORB raises on an image that a level of its pyramid would shrink to nothing.
    if min(image.shape) > 2 * _ORB_BORDER:
        keypoints, descriptors = cv2.ORB.create().detectAndCompute(image, None)
        if keypoints:
            return np.array([k.pt for k in keypoints], np.float32), np.asarray(descriptors, np.uint8)
    return np.empty((0, 2), np.float32), np.empty((0, 32), np.uint8)


def _match(target: Image, source: Image) -> _Matches:
    """Mutual nearest neighbours by Hamming distance, in the order of the target's descriptors."""
    found = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(target, source)
    pairs = np.array([(m.queryIdx, m.trainIdx) for m in found], np.intp).reshape(-1, 2)
    return _Matches(pairs[:, 0], pairs[:, 1])


def _fit_similarity(points_target: PointsPx, points_source: PointsPx) -> _Similarity | None:
    """Rotation, translation and uniform scale by RANSAC at OpenCV's defaults (3 px, 2000 trials, 0.99)."""
    matrix, inlier_mask = cv2.estimateAffinePartial2D(points_source, points_target, method=cv2.RANSAC)
    if matrix is None or not np.isfinite(matrix).all():
        return None
    return _Similarity(np.asarray(matrix, np.float64), np.flatnonzero(inlier_mask))


def _fit_rigid(points_target: FloatArray, points_source: FloatArray, least_sigma_m: float) -> tuple[SE2, FloatArray]:
    """Least squares motion of (N, 2) source points onto target points, metres, and its (3, 3) covariance.

    The covariance follows from the residuals' variance, held to be at least `least_sigma_m` squared on each axis.
    Source: Umeyama, PAMI 1991, in the plane and without scale.
    """
    centre_target, centre_source = points_target.mean(axis=0), points_source.mean(axis=0)
    q, p = points_target - centre_target, points_source - centre_source
    yaw_rad = math.atan2(float(np.sum(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])), float(np.sum(p * q)))
    arm = SE2(0.0, 0.0, yaw_rad).apply(centre_source)
    T_target_source = SE2(centre_target[0] - arm[0], centre_target[1] - arm[1], yaw_rad)

    residuals = T_target_source.apply(points_source) - points_target
    degrees_of_freedom = max(2 * len(p) - 3, 1)
    variance = max(float(np.sum(residuals**2)) / degrees_of_freedom, least_sigma_m**2)
    about_centre = np.diag([1.0 / len(p), 1.0 / len(p), 1.0 / max(float(np.sum(p**2)), least_sigma_m**2)])
    # From a motion about the points' centre to one about the source frame's origin.
    lever = np.array([[1.0, 0.0, arm[1]], [0.0, 1.0, -arm[0]], [0.0, 0.0, 1.0]])
    return T_target_source, variance * lever @ about_centre @ lever.T


def _published_verdict(target: Image, source: Image, matrix: FloatArray) -> dict[str, float]:
    """The error by which the published code judges the same transform, grey levels, and its verdict (1 accepted).

    Its error counts only pixels above 0 in both images, lets the fitted scale stand and subtracts bytes, which wrap
    around. Where no pixel counts there is no error, and it refuses. The source is warped onto the target's image, since
    nothing beyond it counts.
    """
    height, width = target.shape
    warped = cv2.warpAffine(source, matrix, (width, height))
    both = (target > 0) & (warped > 0)
    if not both.any():
        return {"published_accepted": 0.0}
    error = float(np.mean(target[both] - warped[both]))
    return {"published_error": error, "published_accepted": float(error < GOOD_BELOW)}
