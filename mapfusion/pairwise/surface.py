"""Walls as a robot sees them: the rim between free and occupied cells, with the side from which it was seen.

Coordinates are in cells from the grid's corner: the centre of cell (row, col) is (x, y) = (col + 0.5, row + 0.5).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

from mapfusion.compiled import compiled
from mapfusion.grid import Mask
from mapfusion.pairwise.nearest import nearest_points

Floats = npt.NDArray[np.float32]
Points = Floats
Bytes = npt.NDArray[np.uint8]
Indices = npt.NDArray[np.int32]

SPECKLE_CELLS = 5
"""Islands of wall of fewer cells are taken for noise where they are not of a row of such islands."""
ROW_SHARE, MIN_ROW_KNOWN = 0.14, 0.5
"""A cell is of a row where walls make up at least the first of what is known around it, or of the second of all around
it where less is known. A straight wall of one cell makes up 0.2 there, 0.16 if its cells are moved by a cell and some
fall together; of 3 % noise, each cell with itself, 0.07 +- 0.02."""
_WEIGHTS = np.convolve(np.ones(5), np.ones(5)) / 25.0
"""Of the cells around in either direction: those of a Gaussian of 2 cells, nearly."""
POCKET_CELLS = 12
"""Islands of free space of fewer cells are taken for noise."""
NORMAL_SIGMA = 1.5
"""Blur of the wall image from whose gradient normals are taken, cells."""
_NORMAL_KERNEL = cv2.getGaussianKernel(9, NORMAL_SIGMA, cv2.CV_32F)
NOT_KNOWN = 255
DIRECTION_BINS = 24
"""Directions that are told apart where they are counted."""
FIELD_MARGIN = 20
"""A field reaches this many cells beyond its map."""
_BOX, _CROSS = np.ones((3, 3), np.uint8), cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
_TO_DEPTH = (_CROSS, _BOX, _CROSS, _BOX, _CROSS) * 2 + (_CROSS, _BOX)
"""Erosions one after the other: what is left after each is a cell deeper. Seven crosses to five boxes make the octagon
that is nearest to a circle."""
MAX_DEPTH = len(_TO_DEPTH) + 1


@dataclass(frozen=True, eq=False)
class Surface:
    """The rim of the walls: free cells that touch a wall.

    Attributes:
        points: (N, 2) float32, x and y in cells.
        normals: (N, 2) float32, unit vectors from the wall into free space.
        facing: (N,) float32, the direction of each normal, in bins, from -DIRECTION_BINS / 2 to DIRECTION_BINS / 2.
    """

    points: Points
    normals: Points
    facing: Floats

    def __len__(self) -> int:
        return len(self.points)

    def thinned(self, count: int) -> Surface:
        """About `count` of the points, spread evenly over their order; all of them where there are fewer."""
        if len(self) <= count:
            return self
        if count not in self._thinned:
            some = np.arange(count) * (len(self) - 1) // (count - 1)
            points, normals = (each.take(some, axis=0) for each in (self.points, self.normals))
            self._thinned[count] = Surface(points, normals, self.facing.take(some))
        return self._thinned[count]

    @cached_property
    def _thinned(self) -> dict[int, Surface]:
        return {}


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceField:
    """For every cell of a map and a margin around it: the nearest point of the surface, and what is known.

    Attributes:
        surface: The surface, at least one point.
        walls: (N, 4) float32, the surface's x, y and its normals' x, y.
        nearest: (H, W) int32, index into the surface, as `nearest_points` gives it; cell (0, 0) lies FIELD_MARGIN
            cells outside the map.
        distance: (H, W) uint8, whole cells to it.
        depth: (H, W) uint8, NOT_KNOWN where the map knows neither the cell nor one beside it; else about the distance
            of a free cell to the nearest cell that is not free, cells, as far as MAX_DEPTH, and 0 for other cells.
    """

    surface: Surface
    walls: Floats
    nearest: Indices
    distance: Bytes
    depth: Bytes


def remove_speckle(walls: Mask, known: Mask) -> Mask:
    """The walls (H, W) without noise: islands of fewer than SPECKLE_CELLS cells which other walls do not surround.

    A thin wall that noise broke up is a row of such islands; `known` are the map's known cells, its walls among them.
    The walls themselves where no island is so small.
    """
    small = _small_islands(walls, SPECKLE_CELLS, True)
    if not len(small):
        return walls
    wall_around, known_around = (_share_around(mask, small) for mask in (walls, known))
    is_noise = wall_around < ROW_SHARE * np.maximum(known_around, MIN_ROW_KNOWN)
    kept = walls.copy()
    kept.ravel()[small[is_noise]] = False
    return kept


@compiled
def _share_around(mask: Mask, cells: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
    """(N,) share of a mask (H, W) around some cells, by flat index, as weighted; nothing lies beyond the edge."""
    height, width = mask.shape
    shares, reach = np.empty(len(cells)), len(_WEIGHTS) // 2
    for i in range(len(cells)):
        row, column = divmod(cells[i], width)
        total = 0.0
        for other_row in range(max(row - reach, 0), min(row + reach + 1, height)):
            for other in range(max(column - reach, 0), min(column + reach + 1, width)):
                if mask[other_row, other]:
                    total += _WEIGHTS[other_row - row + reach] * _WEIGHTS[other - column + reach]
        shares[i] = total
    return shares


def remove_pockets(free: Mask) -> Mask:
    """The free space without islands of fewer than POCKET_CELLS cells, which touch nothing but at their corners.

    A noisy wall has free cells in and behind it. With their rims it would seem to be seen from both sides.
    """
    pockets = _small_islands(free, POCKET_CELLS, False)
    if not len(pockets):
        return free
    kept = free.copy()
    kept.ravel()[pockets] = False
    return kept


@compiled
def _small_islands(mask: Mask, least_cells: int, is_diagonal: bool) -> npt.NDArray[np.int64]:
    """(N,) flat indices of the cells of a mask (H, W) that belong to islands of fewer than `least_cells`.

    An island is followed no further than it takes to know that it is no small one.
    """
    height, width = mask.shape
    unseen, large = 1, 2
    state = mask.astype(np.uint8)  # 0 once it is known to be small, or is being followed
    small, number = np.empty(height * width, np.int64), 0
    found = np.empty(least_cells + 8, np.int64)
    for row in range(height):
        for column in range(width):
            if state[row, column] != unseen:
                continue
            is_large = (row > 0 and state[row - 1, column] == large) or (column > 0 and state[row, column - 1] == large)
            if is_large:
                state[row, column] = large
                continue
            found[0], num_found, next_one = row * width + column, 1, 0
            state[row, column] = 0
            while next_one < num_found < least_cells and not is_large:
                at_row, at_column = found[next_one] // width, found[next_one] % width
                next_one += 1
                for other_row in range(max(at_row - 1, 0), min(at_row + 2, height)):
                    for other_column in range(max(at_column - 1, 0), min(at_column + 2, width)):
                        if not (is_diagonal or other_row == at_row or other_column == at_column):
                            continue
                        is_large |= state[other_row, other_column] == large
                        if state[other_row, other_column] == unseen:
                            state[other_row, other_column] = 0
                            found[num_found] = other_row * width + other_column
                            num_found += 1
            is_large |= num_found >= least_cells
            for k in range(num_found):
                if is_large:
                    state[found[k] // width, found[k] % width] = large
                else:
                    small[number] = found[k]
                    number += 1
    return small[:number].copy()


def smooth_walls(walls: Mask, free: Mask) -> Mask:
    """The walls, free pores and notches of up to two cells in them filled.

    Noise roughens a rim: left as it is, one wall would have more cells, facing more ways, the noisier it is.
    """
    closed = cv2.morphologyEx(walls.view(np.uint8), cv2.MORPH_CLOSE, _BOX).view(np.bool_)
    smooth: Mask = (closed & free) | walls
    return smooth


def widen_free(walls: Mask, free: Mask) -> Mask:
    """The free space without `walls`, widened by the single unknown cells that some mappers leave before a wall."""
    no_wall = ~walls
    free = free & no_wall
    beside_both = cv2.bitwise_and(*(cv2.dilate(mask.view(np.uint8), _CROSS) for mask in (walls, free)))
    widened: Mask = free | (beside_both.view(np.bool_) & no_wall)
    return widened


def extract_surface(walls: Mask, free: Mask) -> Surface:
    """The rim of `walls` towards `free` (both (H, W) masks), in row-major order."""
    solid = walls.view(np.uint8)
    rim = np.asarray(cv2.dilate(solid, _CROSS), np.uint8).view(np.bool_) & free
    blurred = cv2.sepFilter2D(solid, cv2.CV_32F, _NORMAL_KERNEL, _NORMAL_KERNEL, borderType=cv2.BORDER_REPLICATE)
    return Surface(*_downhill(np.flatnonzero(rim), np.asarray(blurred, np.float32), DIRECTION_BINS))


@compiled
def _downhill(cells: npt.NDArray[np.intp], image: Floats, num_bins: int) -> tuple[Points, Points, Floats]:
    """The centres (N, 2) of some cells of an image (H, W), by flat index, and where it falls there.

    That is a unit vector (N, 2) against Sobel's gradient, and its direction (N,) in bins from -num_bins / 2 to
    num_bins / 2. What lies beyond the image counts as what lies as far within.
    """
    height, width = image.shape
    points, outwards = np.empty((len(cells), 2), np.float32), np.empty((len(cells), 2), np.float32)
    facing = np.empty(len(cells), np.float32)
    for i in range(len(cells)):
        row, column = divmod(cells[i], width)
        above, below = abs(row - 1), row + 1 if row + 1 < height else max(row - 1, 0)
        left, right = abs(column - 1), column + 1 if column + 1 < width else max(column - 1, 0)
        above, left = min(above, height - 1), min(left, width - 1)
        x = image[above, right] - image[above, left] + image[below, right] - image[below, left]
        y = image[below, left] - image[above, left] + image[below, right] - image[above, right]
        x += 2.0 * (image[row, right] - image[row, left])
        y += 2.0 * (image[below, column] - image[above, column])
        steepness = max(math.hypot(x, y), 1e-6)
        points[i, 0], points[i, 1] = column + 0.5, row + 0.5
        outwards[i, 0], outwards[i, 1] = -x / steepness, -y / steepness
        facing[i] = math.atan2(outwards[i, 1], outwards[i, 0]) * num_bins / (2.0 * math.pi)
    return points, outwards, facing


def surface_field(surface: Surface, free: Mask, known: Mask) -> SurfaceField:
    """The field of a surface of at least one point, as `extract_surface` gives it: one a cell, in row-major order.

    `free` and `known` are the map's (H, W) masks.
    """
    depth = _depth(_with_margin(free))
    near_known = np.asarray(cv2.dilate(_with_margin(known), _BOX), np.uint8)
    nearest, distance = nearest_points(surface.points, depth.shape, FIELD_MARGIN)
    return SurfaceField(
        surface=surface,
        walls=np.concatenate([surface.points, surface.normals], axis=1),
        nearest=nearest,
        distance=distance,
        depth=np.maximum(depth, near_known - np.uint8(1)),  # 0 - 1 is NOT_KNOWN
    )


def _depth(free: Bytes) -> Bytes:
    """Cells to the nearest cell that is 0, about: MAX_DEPTH from there on."""
    left, depth = free, free.copy()
    for element in _TO_DEPTH:
        left = np.asarray(cv2.erode(left, element), np.uint8)
        depth += left
    return depth


def disc_around(points: Points, shape: tuple[int, ...], radius_cells: int) -> Bytes:
    """1 at the cells within `radius_cells` of `points` (N, 2), in a map of `shape` and FIELD_MARGIN around it.

    What lies beyond the margin counts at its edge.
    """
    return _discs(points, shape[0] + 2 * FIELD_MARGIN, shape[1] + 2 * FIELD_MARGIN, radius_cells)


@compiled
def _discs(points: Points, height: int, width: int, radius_cells: int) -> Bytes:
    near = np.zeros((height, width), np.uint8)
    for i in range(len(points)):
        row = min(max(int(points[i, 1] + FIELD_MARGIN), 0), height - 1)
        column = min(max(int(points[i, 0] + FIELD_MARGIN), 0), width - 1)
        for other in range(max(row - radius_cells, 0), min(row + radius_cells + 1, height)):
            half = int(math.sqrt(radius_cells**2 - (other - row) ** 2))
            near[other, max(column - half, 0) : column + half + 1] = 1
    return near


def _with_margin(mask: Mask) -> Bytes:
    """The mask with FIELD_MARGIN cells around it that are not in it."""
    m = FIELD_MARGIN
    return np.asarray(cv2.copyMakeBorder(mask.view(np.uint8), m, m, m, m, cv2.BORDER_CONSTANT, value=0), np.uint8)
