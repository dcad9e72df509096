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
from itertools import product

import cv2
import numpy as np
import numpy.typing as npt

from mapfusion.pairwise.poses import Poses, pose_from_centre
from mapfusion.pairwise.poses import rotations as matrices
from mapfusion.pairwise.surface import FIELD_MARGIN, NOT_KNOWN, Floats, Indices, Points, Surface, SurfaceField

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
    low, high = there.points.min(axis=0), there.points.max(axis=0)
    arms_low, arms_high = arms.min(axis=0), arms.max(axis=0)
    deep = _deep(target)
    deep = deep[((deep >= low) & (deep <= high)).all(axis=1)]
    deep_arms = deep_arms[((deep_arms >= arms_low) & (deep_arms <= arms_high)).all(axis=1)]

    R = matrices(np.stack([np.zeros_like(rotations), np.zeros_like(rotations), rotations], -1))
    box = np.array([[x, y] for x in (arms_low[0], arms_high[0]) for y in (arms_low[1], arms_high[1])], np.float32)
    corners = R @ box.T
    starts, extents = corners.min(axis=-1), np.ptp(corners, axis=-1)
    both = np.stack([high - low, extents.max(axis=0)])
    edges = both.max(axis=0) + MIN_UNWRAPPED * both.min(axis=0)
    stride = np.float32(max(MIN_STRIDE, math.ceil(edges.max() / (MAX_SIZE - 2))))
    width, height = (_fast_size(math.ceil(edge / stride) + 2) for edge in edges)
    shape = height, width

    at, deep_at = (_cells((each - low).T / stride, shape) for each in (there.points, deep))
    normals, walls = _images(at, there.normals.T, deep_at, shape)
    normals = cv2.GaussianBlur(normals, (0, 0), 0.8, borderType=cv2.BORDER_CONSTANT)
    # A wall that agrees brings as much as there is of the other map's walls in its coarse cell.
    of_cell = CONTRADICTION_WEIGHT * (MIN_STRIDE / stride) ** 2
    walls *= of_cell * np.array([_density((arms - arms_low) / stride), _density((there.points - low) / stride)])
    # A wall of one map counts where it meets what is deep in the other.
    of_target = [np.conj(_spectrum(image)) for image in (normals, np.ascontiguousarray(walls[..., ::-1]))]
    peaks: list[tuple[int, int]] = []
    # Products with transposes as they are would take several times as long.
    columns, deep_columns, facing = (np.ascontiguousarray(each.T) for each in (arms, deep_arms, here.normals))
    for turn, start in zip(R, starts[..., None], strict=True):
        at, deep_at = (_cells((turn @ each - start) / stride, shape) for each in (columns, deep_columns))
        images = _images(at, turn @ facing, deep_at, shape)
        agreeing, contradicting = (_correlation(*both) for both in zip(of_target, images, strict=True))
        for score in (agreeing, agreeing - contradicting):
            peaks += _peaks(score)
    of_rotation = np.arange(len(rotations)).repeat(len(peaks) // len(rotations))
    of_peak, shift = _unwrapped(np.array(peaks), (high - low) / stride, extents[of_rotation] / stride, (width, height))
    of_rotation = of_rotation[of_peak]
    return pose_from_centre(rotations[of_rotation], shift * stride - starts[of_rotation] + low, centre)


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
    counts = _per_degree(np.arctan2(surface.normals[:, 1], surface.normals[:, 0]))
    roots = np.sqrt(np.maximum(_blurred(counts, DIRECTION_SIGMA_DEGREES), 0.0))
    centred: npt.NDArray[np.float64] = roots - roots.mean()
    return centred


def _per_degree(angles_rad: Places) -> npt.NDArray[np.float64]:
    """(360,) how many of some angles (N,) fall into each whole degree."""
    degrees = np.floor(np.degrees(angles_rad)).astype(np.int64) % 360
    return np.bincount(degrees, minlength=360).astype(np.float64)


def _blurred(per_degree: npt.NDArray[np.float64], sigma_degrees: float) -> npt.NDArray[np.float64]:
    """(360,) sums over a Gaussian around each degree, of height 1."""
    away = np.minimum(np.arange(360), 360 - np.arange(360))
    kernel = np.exp(-0.5 * np.square(away / sigma_degrees))
    return np.fft.irfft(np.fft.rfft(per_degree) * np.fft.rfft(kernel), 360)


def _deep(field: SurfaceField) -> Points:
    """(N, 2) cells of a raster in which a wall would contradict the map; MIN_STRIDE from one to the next."""
    raster = np.s_[FIELD_MARGIN + MIN_STRIDE // 2 : -FIELD_MARGIN : MIN_STRIDE]
    depth, distance = field.depth[raster, raster], field.distance[raster, raster]
    rows, cols = np.nonzero((depth > DEEP_CELLS) & (depth != NOT_KNOWN) & (distance > DEEP_CELLS))
    return np.stack([cols, rows], axis=-1).astype(np.float32) * MIN_STRIDE + np.float32(MIN_STRIDE // 2 + 0.5)


def _cells(at: Floats, shape: tuple[int, int]) -> Indices:
    """(N,) flat index of the cell of an image in which each point (2, N) lies."""
    x, y = at.astype(np.int32)
    flat: Indices = y * shape[1] + x
    return flat


def _images(cells: Indices, normals: Floats, deep_cells: Indices, shape: tuple[int, int]) -> Floats:
    """Two images (2, H, W, 2): sums of the rim's normals in x and y, and of its points and of deep cells.

    Args:
        cells: (N,) flat index of the cell of each point.
        normals: (2, N) of the points.
        deep_cells: (M,) flat index of the cell of each place that is deep in free space.
        shape: Of the images.
    """
    num_cells = shape[0] * shape[1]
    places = np.concatenate([2 * cells, 2 * cells + 1, 2 * (cells + num_cells), 2 * (deep_cells + num_cells) + 1])
    values = np.concatenate([*normals, np.ones(len(cells) + len(deep_cells), np.float32)])
    return np.bincount(places, values, 4 * num_cells).astype(np.float32).reshape(2, *shape, 2)


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
    """(H, W) sum of both channels' cross-correlations, of one image with two channels given as its conjugate spectrum.

    The real part of the correlation of complex numbers adds those of their real and of their imaginary parts, and the
    transform of a conjugate is the conjugate of the inverse transform.
    """
    product = conjugate * _spectrum(image)
    return np.asarray(cv2.extractChannel(cv2.dft(product.view(np.float32).reshape(image.shape)), 0), np.float32)


def _peaks(score: Floats) -> list[tuple[int, int]]:
    """Column and row of the highest values, none within PEAK_RADIUS of a higher one; the score wraps around."""
    height, width = score.shape
    around = np.arange(-PEAK_RADIUS, PEAK_RADIUS + 1)
    found = []
    for _ in range(PEAKS_PER_ROTATION):
        _, _, _, (x, y) = cv2.minMaxLoc(score)
        found.append((x, y))
        score[((y + around) % height)[:, None], (x + around) % width] = -np.inf
    return found
