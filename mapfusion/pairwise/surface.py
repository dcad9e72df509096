"""Walls as a robot sees them: the rim between free and occupied cells, with the side from which it was seen.

Coordinates are in cells from the grid's corner: the centre of cell (row, col) is (x, y) = (col + 0.5, row + 0.5).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from mapfusion.grid import Mask

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
_AROUND, _SUM_AROUND = (5, 5), 5.0**4
"""Summed over this twice, what is around has the weights of a Gaussian of 2 cells, nearly."""
POCKET_CELLS = 12
"""Islands of free space of fewer cells are taken for noise."""
NORMAL_SIGMA = 1.5
"""Blur of the wall image from whose gradient normals are taken, cells."""
NOT_KNOWN = 255
DIRECTION_BINS = 24
"""Directions that are told apart where they are counted."""
FIELD_MARGIN = 12
"""A field reaches this many cells beyond its map."""
_BOX, _CROSS = np.ones((3, 3), np.uint8), cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
_TO_DEPTH = (_CROSS, _BOX, _CROSS, _BOX, _CROSS) * 2 + (_CROSS, _BOX)
"""Erosions one after the other: what is left after each is a cell deeper. Seven crosses to five boxes make the octagon
that is nearest to a circle."""
MAX_DEPTH = len(_TO_DEPTH) + 1


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """The rim of the walls: free cells that touch a wall.

    Attributes:
        points: (N, 2) float32, x and y in cells.
        normals: (N, 2) float32, unit vectors from the wall into free space.
    """

    points: Points
    normals: Points

    def __len__(self) -> int:
        return len(self.points)

    def thinned(self, count: int) -> Surface:
        """About `count` of the points, spread evenly over their order; all of them where there are fewer."""
        if len(self) <= count:
            return self
        return self.at(np.arange(count) * (len(self) - 1) // (count - 1))

    def at(self, indices: npt.NDArray[np.intp]) -> Surface:
        """The points of these indices (K,) alone."""
        return Surface(self.points.take(indices, axis=0), self.normals.take(indices, axis=0))

    def facing(self) -> Floats:
        """(N,) direction that each wall faces, in bins, from -DIRECTION_BINS / 2 to DIRECTION_BINS / 2."""
        angles = np.arctan2(self.normals[:, 1], self.normals[:, 0])
        bins: Floats = angles * np.float32(DIRECTION_BINS / (2.0 * np.pi))
        return bins


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceField:
    """For every cell of a map and a margin around it: the nearest point of the surface, and what is known.

    Attributes:
        surface: The surface, at least one point.
        walls: (4, N) float32, the surface's x, y and its normals' x, y.
        nearest: (H, W) int32, index into the surface; cell (0, 0) lies FIELD_MARGIN cells outside the map.
        distance: (H, W) uint8, whole cells to it, about; 255 from there on.
        depth: (H, W) uint8, NOT_KNOWN where the map knows neither the cell nor one beside it; else about the distance
            of a free cell to the nearest cell that is not free, cells, as far as MAX_DEPTH, and 0 for other cells.
    """

    surface: Surface
    walls: Floats
    nearest: Indices
    distance: Bytes
    depth: Bytes

    def cells_below(self, points: Points) -> Indices:
        """(K, N) flat index of the cell below each of (K, 2, N) points; the field's edge for points outside."""
        height, width = self.nearest.shape
        cells = (points + np.float32(FIELD_MARGIN)).astype(np.int32)
        np.maximum(cells, 0, out=cells)
        flat: Indices = np.minimum(cells[:, 1], height - 1)
        flat *= width
        flat += np.minimum(cells[:, 0], width - 1)
        return flat


def remove_speckle(walls: Mask, known: Mask) -> Mask:
    """The walls (H, W) without noise: islands of fewer than SPECKLE_CELLS cells which other walls do not surround.

    A thin wall that noise broke up is a row of such islands; `known` are the map's known cells, its walls among them.
    The walls themselves where no island is so small.
    """
    _, labels = cv2.connectedComponents(walls.view(np.uint8), connectivity=8)
    cells = np.flatnonzero(walls)
    islands = np.asarray(labels, np.int32).ravel().take(cells)
    is_small = np.bincount(islands, minlength=1) < SPECKLE_CELLS
    if not is_small[1:].any():  # island 0 is what is not wall
        return walls
    small = cells[is_small.take(islands)]
    wall_around, known_around = (_summed_around(mask.view(np.uint8)).take(small) for mask in (walls, known))
    is_noise = wall_around < ROW_SHARE * np.maximum(known_around, MIN_ROW_KNOWN * _SUM_AROUND)
    kept = walls.copy()
    kept.ravel()[small[is_noise]] = False
    return kept


def _summed_around(mask: Bytes) -> npt.NDArray[np.uint16]:
    """(H, W) how many of the cells around each are set, as weighted, of _SUM_AROUND; nothing lies beyond the edge."""
    near = cv2.boxFilter(mask, cv2.CV_8U, _AROUND, normalize=False, borderType=cv2.BORDER_CONSTANT)
    around = cv2.boxFilter(near, cv2.CV_16U, _AROUND, normalize=False, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(around, np.uint16)


def remove_pockets(free: Mask) -> Mask:
    """The free space without islands of fewer than POCKET_CELLS cells, which touch nothing but at their corners.

    A noisy wall has free cells in and behind it. With their rims it would seem to be seen from both sides.
    """
    num_islands, labels = cv2.connectedComponents(free.view(np.uint8), connectivity=4)
    if num_islands <= 2:  # island 0 is what is not free
        return free
    islands = np.asarray(labels, np.int32)
    is_pocket = np.bincount(islands.ravel(), minlength=1) < POCKET_CELLS
    if not is_pocket[1:].any():
        return free
    kept: Mask = free & ~is_pocket.take(islands)
    return kept


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
    at = np.flatnonzero(rim)
    blurred = cv2.GaussianBlur(solid.astype(np.float32), (0, 0), NORMAL_SIGMA, borderType=cv2.BORDER_REPLICATE)
    x, y = (np.asarray(cv2.Sobel(blurred, cv2.CV_32F, *axis), np.float32).ravel().take(at) for axis in ((1, 0), (0, 1)))
    outwards = np.stack([x, y], axis=-1)
    outwards /= -np.maximum(np.sqrt(x * x + y * y), np.float32(1e-6))[:, None]
    rows, cols = np.divmod(at, walls.shape[1])
    points = np.stack([cols, rows], axis=-1).astype(np.float32)
    points += np.float32(0.5)
    return Surface(points, outwards)


def surface_field(surface: Surface, free: Mask, known: Mask) -> SurfaceField:
    """The field of a surface of at least one point, as `extract_surface` gives it: one a cell, in row-major order.

    `free` and `known` are the map's (H, W) masks.
    """
    elsewhere = _all_but(surface.points, free.shape)
    distance, labels = cv2.distanceTransformWithLabels(elsewhere, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    nearest = np.asarray(labels, np.int32)  # counted from 1, in row-major order as well
    nearest -= 1
    depth = _depth(_with_margin(free))
    near_known = cv2.dilate(_with_margin(known), _BOX)
    depth = np.maximum(depth, (near_known == 0) * np.uint8(NOT_KNOWN))
    return SurfaceField(
        surface=surface,
        walls=np.concatenate([surface.points.T, surface.normals.T]),
        nearest=nearest,
        distance=np.asarray(cv2.convertScaleAbs(distance), np.uint8),
        depth=np.asarray(depth, np.uint8),
    )


def _depth(free: Bytes) -> Bytes:
    """Cells to the nearest cell that is 0, about: MAX_DEPTH from there on."""
    left, depth = free, free.copy()
    for element in _TO_DEPTH:
        left = np.asarray(cv2.erode(left, element), np.uint8)
        depth += left
    return depth


def disc_around(points: Points, shape: tuple[int, ...], radius_cells: int) -> Bytes:
    """1 at the cells within `radius_cells` of `points` (N, 2), in a map of `shape` and FIELD_MARGIN around it."""
    across = np.square(np.arange(-radius_cells, radius_cells + 1))
    disc = (across[:, None] + across <= radius_cells**2).astype(np.uint8)
    return np.asarray(cv2.dilate(1 - _all_but(points, shape), disc), np.uint8)


def _all_but(points: Points, shape: tuple[int, ...]) -> Bytes:
    """1 but for 0 at the cells of `points`, in a map of `shape` and FIELD_MARGIN around it.

    What lies beyond the margin counts at its edge.
    """
    elsewhere = np.ones((shape[0] + 2 * FIELD_MARGIN, shape[1] + 2 * FIELD_MARGIN), np.uint8)
    columns, rows = (points + np.float32(FIELD_MARGIN)).astype(np.int32).T
    elsewhere[rows.clip(0, elsewhere.shape[0] - 1), columns.clip(0, elsewhere.shape[1] - 1)] = 0
    return elsewhere


def _with_margin(mask: Mask) -> Bytes:
    """The mask with FIELD_MARGIN cells around it that are not in it."""
    m = FIELD_MARGIN
    return np.asarray(cv2.copyMakeBorder(mask.view(np.uint8), m, m, m, m, cv2.BORDER_CONSTANT, value=0), np.uint8)
