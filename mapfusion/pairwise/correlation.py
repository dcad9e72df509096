"""Hypotheses from the walls as a whole: their normals correlated over rotations and translations.

The rim's normals are drawn as complex numbers; the real part of the cross-correlation of two such images sums the
cosines between normals that fall together, so walls seen from opposite sides count against a pose. Rotations are
tried in the order in which the two maps' wall directions correlate.
Sources: orientation correlation, Fitch et al., BMVC 2002; the Hough spectrum, Carpin, Autonomous Robots 2008.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
import numpy.typing as npt

from mapfusion.pairwise.poses import Poses, pose_from_centre
from mapfusion.pairwise.surface import Floats, Surface

MAX_SIZE = 216
"""Edge of the correlated images, coarse cells."""
MIN_STRIDE = 3
STEP_DEGREES = 3
DIRECTION_SIGMA_DEGREES = 2.0
NUM_POINTS = 2000
PEAKS_PER_ROTATION = 3
PEAK_RADIUS = 2


def correlate(target: Surface, source: Surface, centre: Poses, num_rotations: int, count: int) -> Poses:
    """Up to `count` poses (K, 3) with the highest correlation, best first.

    Args:
        target: Surface of the target.
        source: Surface of the source.
        centre: (2,) point of the source about which it is turned, cells.
        num_rotations: How many rotations are tried.
        count: How many poses to give.
    """
    rotations = likely_rotations(target, source)[:num_rotations]
    target, source = target.thinned(NUM_POINTS), source.thinned(NUM_POINTS)
    low, high = target.points.min(axis=0), target.points.max(axis=0)
    arms = source.points - centre.astype(np.float32)
    reach = float(np.linalg.norm(arms, axis=-1).max())
    extent = float((high - low).max()) + 2.0 * reach
    stride = np.float32(max(MIN_STRIDE, math.ceil(extent / (MAX_SIZE - 4))))
    size = cv2.getOptimalDFTSize(math.ceil(extent / stride) + 4)
    image = _draw((target.points - low) / stride, target.normals, size)
    spectrum = cv2.dft(cv2.GaussianBlur(image, (0, 0), 0.8, borderType=cv2.BORDER_CONSTANT))
    found: list[tuple[float, float, int, int]] = []
    for theta in rotations:
        c, s = math.cos(theta), math.sin(theta)
        R = np.array([[c, s], [-s, c]], np.float32)
        turned = _draw((arms @ R + np.float32(reach)) / stride, source.normals @ R, size)
        product = cv2.mulSpectrums(spectrum, cv2.dft(turned), 0, conjB=True)
        score = np.ascontiguousarray(cv2.dft(product, flags=cv2.DFT_INVERSE)[..., 0])
        for _ in range(PEAKS_PER_ROTATION):
            _, value, _, (x, y) = cv2.minMaxLoc(score)
            found.append((value, theta, x, y))
            near_y = slice(max(0, y - PEAK_RADIUS), y + PEAK_RADIUS + 1)
            score[near_y, max(0, x - PEAK_RADIUS) : x + PEAK_RADIUS + 1] = 0.0
    peaks = np.array(sorted(found, key=lambda peak: -peak[0])[:count])
    # Beyond the target's far edge the circular correlation means a shift to the other side.
    shift = peaks[:, 2:] - np.where(peaks[:, 2:] > (high - low) / stride + 1, size, 0)
    return pose_from_centre(peaks[:, 1], shift * stride + reach + low, centre)


def likely_rotations(target: Surface, source: Surface) -> npt.NDArray[np.float64]:
    """All rotations in steps of STEP_DEGREES, radians, those first at which most wall directions agree."""
    correlation = np.fft.irfft(np.fft.rfft(_directions(target)) * np.conj(np.fft.rfft(_directions(source))), 360)
    angles = np.arange(0, 360, STEP_DEGREES)
    order: npt.NDArray[np.intp] = np.argsort(-correlation[angles], kind="stable")
    return np.radians(angles[order])


def _directions(surface: Surface) -> npt.NDArray[np.float64]:
    """(360,) how much wall faces each whole degree, blurred, with mean 0."""
    degrees = np.degrees(np.arctan2(surface.normals[:, 1], surface.normals[:, 0]))
    counts = np.bincount(np.floor(degrees).astype(np.int64) % 360, minlength=360).astype(np.float64)
    away = np.minimum(np.arange(360), 360 - np.arange(360))
    kernel = np.exp(-0.5 * np.square(away / DIRECTION_SIGMA_DEGREES))
    blurred: npt.NDArray[np.float64] = np.fft.irfft(np.fft.rfft(counts) * np.fft.rfft(kernel), 360)
    centred: npt.NDArray[np.float64] = blurred - blurred.mean()
    return centred


def _draw(at: Floats, normals: Floats, size: int) -> Floats:
    """(size, size, 2) image of the sums of the normals that fall into each cell."""
    cell = at[:, 1].astype(np.int32) * size + at[:, 0].astype(np.int32)
    image = np.empty((size * size, 2), np.float32)
    for i in (0, 1):
        image[:, i] = np.bincount(cell, normals[:, i], size * size)
    return image.reshape(size, size, 2)
