"""Hypotheses from the maps as a whole: walls and free space correlated over rotations and translations.

The cross-correlation of the images of two rims' normals sums the cosines between normals that fall together, so walls
seen from opposite sides count against a pose. Alone it favours poses that put much wall onto much wall. Where maps
share little, the right pose shows by what is missing: no wall of either map stands in the other's free space. So the
peaks are taken twice, of the correlation of the normals and of what is left when walls in free space are subtracted;
bent maps are found by the first only. Rotations are tried in the order in which the two maps' wall directions and the
turns of their keypoints speak for them.
Sources: orientation correlation, Fitch et al., BMVC 2002; the Hough spectrum, Carpin, Autonomous Robots 2008.
"""

from __future__ import annotations

import math
from functools import cache
from itertools import product

import cv2
import numpy as np
import numpy.typing as npt

from mapfusion.compiled import compiled
from mapfusion.pairwise.poses import Poses, pose_from_centre
from mapfusion.pairwise.poses import rotations as matrices
from mapfusion.pairwise.surface import (
    DIRECTION_BINS,
    FIELD_MARGIN,
    NOT_KNOWN,
    Bytes,
    Floats,
    Indices,
    Points,
    Surface,
    SurfaceField,
)

Places = npt.NDArray[np.floating]

MAX_SIZE = 160
"""Longest edge of the correlated images, coarse cells."""
MIN_UNWRAPPED, LEAST_OVERLAP = 0.4, 0.1
"""Images are as long as the longer map and the first of the shorter one: the correlation of two is circular, and shifts
by which less than the rest of it overlaps fall together with others. Those by which less overlaps than the second are
taken for the others."""
MIN_STRIDE = 3
STEP_DEGREES = 3
DIRECTION_SIGMA_DEGREES, TURN_SIGMA_DEGREES = 2.0, 4.0
"""Of wall directions, and of the turns of matched keypoints."""
LEAST_POSSIBLE = 0.01
"""No rotation is so impossible for walls that keypoints cannot speak for it; as a share of the walls' correlation."""
NUM_POINTS = 2000
PEAKS_PER_ROTATION = 3
PEAK_RADIUS = 2
DEEP_CELLS = 6
"""A wall this deep in free space, and this far from any wall of that map, contradicts it."""
CONTRADICTION_WEIGHT = 0.25
"""What a wall in free space takes away, of what a wall brings that agrees."""


def correlate(target: SurfaceField, source: SurfaceField, centre: Poses, rotations: npt.NDArray[np.float64]) -> Poses:
    """The peaks of both correlations at some rotations.

    Args:
        target: Field of the target.
        source: Field of the source.
        centre: (2,) point of the source about which it is turned, cells.
        rotations: (R,) of the source in the target, radians.

    Returns:
        Poses (K, 3) of the source in the target, in cells; at least 2 PEAKS_PER_ROTATION a rotation.
    """
    there, here = target.surface.thinned(NUM_POINTS), source.surface.thinned(NUM_POINTS)
    about = centre.astype(np.float32)
    arms, deep_arms = here.points - about, _deep(source) - about
    (low, high), (arms_low, arms_high) = _bounds(there.points), _bounds(arms)
    deep, deep_arms = _within(_deep(target), low, high), _within(deep_arms, arms_low, arms_high)

    R = matrices(np.stack([np.zeros_like(rotations), np.zeros_like(rotations), rotations], -1))
    box = np.array([[x, y] for x in (arms_low[0], arms_high[0]) for y in (arms_low[1], arms_high[1])], np.float32)
    corners = R @ box.T
    starts, extents = corners.min(axis=-1), np.ptp(corners, axis=-1)
    both = np.stack([high - low, extents.max(axis=0)])
    edges = both.max(axis=0) + MIN_UNWRAPPED * both.min(axis=0)
    stride = np.float32(max(MIN_STRIDE, math.ceil(edges.max() / (MAX_SIZE - 2))))
    width, height = (_fast_size(math.ceil(edge / stride) + 2) for edge in edges)

    as_it_is, no_turn = np.eye(2, dtype=np.float32), np.zeros(2, np.float32)
    images = np.empty((2, height, width, 2), np.float32)
    _draw(images, there.points - low, there.normals, deep - low, as_it_is, no_turn, float(stride))
    normals, walls = cv2.GaussianBlur(images[0], (0, 0), 0.8, borderType=cv2.BORDER_CONSTANT), images[1]
    # A wall that agrees brings as much as there is of the other map's walls in its coarse cell.
    of_cell = CONTRADICTION_WEIGHT * (MIN_STRIDE / stride) ** 2
    walls *= of_cell * np.array([_density((arms - arms_low) / stride), _density((there.points - low) / stride)])
    # A wall of one map counts where it meets what is deep in the other.
    of_target = [
        np.conj(_spectrum(np.asarray(image, np.float32))) for image in (normals, np.ascontiguousarray(walls[..., ::-1]))
    ]
    peaks: list[tuple[int, int]] = []
    for turn, start in zip(R, starts, strict=True):
        _draw(images, arms, here.normals, deep_arms, turn, start, float(stride))
        agreeing, contradicting = (_correlation(*both) for both in zip(of_target, images, strict=True))
        for score in _scores(agreeing, contradicting):
            peaks += _peaks(score)
    of_rotation = np.arange(len(rotations)).repeat(len(peaks) // len(rotations))
    of_peak, shift = _unwrapped(np.array(peaks), (high - low) / stride, extents[of_rotation] / stride, (width, height))
    of_rotation = of_rotation[of_peak]
    return pose_from_centre(rotations[of_rotation], shift * stride - starts[of_rotation] + low, centre)


@compiled
def _bounds(points: Points) -> tuple[Floats, Floats]:
    """(2,) the least and the greatest x and y of some points (N, 2), at least one."""
    low, high = points[0].copy(), points[0].copy()
    for i in range(len(points)):
        for axis in range(2):
            low[axis], high[axis] = min(low[axis], points[i, axis]), max(high[axis], points[i, axis])
    return low, high


@compiled
def _within(points: Points, low: Floats, high: Floats) -> Points:
    """Those of the points (N, 2) that lie within bounds."""
    inside, number = np.empty_like(points), 0
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        if low[0] <= x <= high[0] and low[1] <= y <= high[1]:
            inside[number] = points[i]
            number += 1
    return inside[:number].copy()


def _unwrapped(
    peaks: Indices, extent: Places, extents: Places, size: tuple[int, int]
) -> tuple[npt.NDArray[np.intp], Indices]:
    """The shifts (M, 2) that peaks (K, 2) of circular correlations may stand for; before them, each one's peak (M,).

    Along each axis a peak is that of two shifts, `size` apart. Where the maps overlap by little but not by nothing for
    the one as for the other, either may be meant.

    Args:
        peaks: x and y in [0, size).
        extent: (2,) of the target.
        extents: (K, 2) of the source.
        size: Of the images.
    """
    either = np.stack([peaks, peaks - np.array(size)])
    overlap = np.minimum(extent, either + extents) - np.maximum(either, 0)
    may_be = (overlap >= overlap.max(axis=0)) | (overlap >= LEAST_OVERLAP * np.minimum(extent, extents))
    of_peak, shifts = [], []
    for x, y in product((0, 1), repeat=2):
        meant = np.flatnonzero(may_be[x, :, 0] & may_be[y, :, 1])
        of_peak.append(meant)
        shifts.append(np.stack([either[x, meant, 0], either[y, meant, 1]], axis=-1))
    order = np.argsort(np.concatenate(of_peak), kind="stable")
    return np.concatenate(of_peak)[order], np.concatenate(shifts)[order]


def likely_rotations(target: Surface, source: Surface, turns_rad: Places) -> npt.NDArray[np.float64]:
    """All rotations in steps of STEP_DEGREES, radians, those first for which wall directions and keypoints speak.

    Walls say which rotations are possible, often a half and quarter turns alike, and keypoints which of them is likely:
    what speaks for a rotation is the product, of the root of the votes, as bent and large maps have few right ones.

    Args:
        target: Walls of the target.
        source: Walls of the source.
        turns_rad: (M,) by how much matched keypoints turn from the source to the target.
    """
    correlation = np.fft.irfft(np.fft.rfft(_directions(target)) * np.conj(np.fft.rfft(_directions(source))), 360)
    votes = _blurred(_per_degree(turns_rad), TURN_SIGMA_DEGREES)
    possible = correlation - correlation.min() + LEAST_POSSIBLE * (np.ptp(correlation) + 1.0)
    likelihood = possible * np.sqrt(1.0 + np.maximum(votes, 0.0))
    angles = np.arange(0, 360, STEP_DEGREES)
    # Rounded, as quarter turns of a room are equally likely but for the last digits.
    ranks = np.round(likelihood[angles] / likelihood.max(), 9)
    order: npt.NDArray[np.intp] = np.argsort(-ranks, kind="stable")
    return np.radians(angles[order])


def _directions(surface: Surface) -> npt.NDArray[np.float64]:
    """(360,) root of how much wall faces each whole degree, blurred, with mean 0.

    By the root a few long walls, which the other map need not share, outweigh the others less.
    """
    counts = _per_degree(surface.facing * (2.0 * np.pi / DIRECTION_BINS))
    roots = np.sqrt(np.maximum(_blurred(counts, DIRECTION_SIGMA_DEGREES), 0.0))
    centred: npt.NDArray[np.float64] = roots - roots.mean()
    return centred


def _per_degree(angles_rad: Places) -> npt.NDArray[np.float64]:
    """(360,) how many of some angles (N,) fall into each whole degree."""
    degrees = np.floor(np.degrees(angles_rad)).astype(np.int64) % 360
    return np.bincount(degrees, minlength=360).astype(np.float64)


def _blurred(per_degree: npt.NDArray[np.float64], sigma_degrees: float) -> npt.NDArray[np.float64]:
    """(360,) sums over a Gaussian around each degree, of height 1."""
    return np.fft.irfft(np.fft.rfft(per_degree) * _spectrum_of_gaussian(sigma_degrees), 360)


@cache
def _spectrum_of_gaussian(sigma_degrees: float) -> npt.NDArray[np.complex128]:
    away = np.minimum(np.arange(360), 360 - np.arange(360))
    return np.fft.rfft(np.exp(-0.5 * np.square(away / sigma_degrees)))


def _deep(field: SurfaceField) -> Points:
    """(N, 2) cells of a raster in which a wall would contradict the map; MIN_STRIDE from one to the next."""
    return _deep_of(field.depth, field.distance, FIELD_MARGIN, NOT_KNOWN)


@compiled
def _deep_of(depth: Bytes, distance: Bytes, margin: int, not_known: int) -> Points:
    height, width = depth.shape
    points, number = np.empty((depth.size // MIN_STRIDE**2 + height + width, 2), np.float32), 0
    for row in range(margin + MIN_STRIDE // 2, height - margin, MIN_STRIDE):
        for column in range(margin + MIN_STRIDE // 2, width - margin, MIN_STRIDE):
            deep = depth[row, column]
            if deep > DEEP_CELLS and deep != not_known and distance[row, column] > DEEP_CELLS:
                points[number, 0], points[number, 1] = column - margin + 0.5, row - margin + 0.5
                number += 1
    return points[:number].copy()


@compiled
def _draw(
    images: Floats, points: Points, normals: Points, deep: Points, turn: Floats, start: Floats, stride: float
) -> None:
    """Two images (2, H, W, 2): sums of a rim's normals in x and y, and of its points and of deep cells.

    Args:
        images: What is drawn to, whatever was there before.
        points: (N, 2) of the rim, cells.
        normals: (N, 2) of the points.
        deep: (M, 2) places that are deep in free space, cells.
        turn: (2, 2) rotation by which all are turned.
        start: (2,) the images' corner, after that, cells.
        stride: Edge of the images' cells, cells.
    """
    height, width = images.shape[1:3]
    images[:] = 0.0
    c, s = turn[0, 0], turn[1, 0]
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        row, column = _row_and_column(c * x - s * y - start[0], s * x + c * y - start[1], stride, height, width)
        images[0, row, column, 0] += c * normals[i, 0] - s * normals[i, 1]
        images[0, row, column, 1] += s * normals[i, 0] + c * normals[i, 1]
        images[1, row, column, 0] += 1.0
    for i in range(len(deep)):
        x, y = deep[i, 0], deep[i, 1]
        row, column = _row_and_column(c * x - s * y - start[0], s * x + c * y - start[1], stride, height, width)
        images[1, row, column, 1] += 1.0


@compiled
def _row_and_column(x: float, y: float, stride: float, height: int, width: int) -> tuple[int, int]:
    """Of an image's cell that has a point in it, which lies within the image but for what rounding does."""
    return min(max(int(y / stride), 0), height - 1), min(max(int(x / stride), 0), width - 1)


def _density(at: Places) -> np.float32:
    """How many of the points (N, 2) there are in a cell that has any."""
    x, y = at.astype(np.int32).T
    return np.float32(len(at) / len(np.unique(y * (x.max() + 1) + x)))


def _fast_size(size: int) -> int:
    """The next larger size, or the same, whose transform takes little time."""
    return 16 * cv2.getOptimalDFTSize(math.ceil(size / 16))


def _spectrum(image: Floats) -> npt.NDArray[np.complex64]:
    """(H, W) of an image (H, W, 2) of complex numbers."""
    return np.asarray(cv2.dft(image), np.float32).view(np.complex64)[..., 0]


def _correlation(conjugate: npt.NDArray[np.complex64], image: Floats) -> Floats:
    """(H, W, 2) whose first channel is the sum of both channels' cross-correlations; one image is a conjugate spectrum.

    The real part of the correlation of complex numbers adds those of their real and of their imaginary parts, and the
    transform of a conjugate is the conjugate of the inverse transform.
    """
    product = _spectrum(image)
    product *= conjugate
    return np.asarray(cv2.dft(product.view(np.float32).reshape(image.shape)), np.float32)


@compiled
def _scores(agreeing: Floats, contradicting: Floats) -> Floats:
    """(2, H, W) the first channel of one correlation (H, W, 2), and what is left of it less that of another."""
    height, width = agreeing.shape[:2]
    scores = np.empty((2, height, width), np.float32)
    for row in range(height):
        for column in range(width):
            scores[0, row, column] = agreeing[row, column, 0]
            scores[1, row, column] = agreeing[row, column, 0] - contradicting[row, column, 0]
    return scores


def _peaks(score: Floats) -> list[tuple[int, int]]:
    """Column and row of the highest values, none within PEAK_RADIUS of a higher one; the score wraps around."""
    found = []
    for _ in range(PEAKS_PER_ROTATION):
        _, _, _, (x, y) = cv2.minMaxLoc(score)
        found.append((x, y))
        _suppress(score, x, y)
    return found


@compiled
def _suppress(score: Floats, x: int, y: int) -> None:
    """Makes the score as low as can be within PEAK_RADIUS of a column and row."""
    height, width = score.shape
    for row in range(y - PEAK_RADIUS, y + PEAK_RADIUS + 1):
        for column in range(x - PEAK_RADIUS, x + PEAK_RADIUS + 1):
            score[row % height, column % width] = -np.inf
