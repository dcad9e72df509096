"""Things that stood in one robot's map and were gone when another looked: other robots, people, chairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from mapfusion.grid import FREE_PERCENT, OCCUPIED_PERCENT, UNKNOWN, Cells, Mask, OccupancyGrid
from mapfusion.layer import Layer
from mapfusion.steps import StampArray
from mapfusion.transform import SE2, FloatArray

Indices = npt.NDArray[np.signedinteger]

MAX_SIZE_M = 1.2
"""Nothing larger is held to have moved: a long wall that another map does not have is a matter of alignment."""
APART_M = 0.25
"""Nearer than this to a wall of the other map, an occupied cell is that wall, a little off."""


@dataclass(frozen=True, slots=True, eq=False)
class CellTimes:
    """Since when a map's cells are as they are.

    Attributes:
        since_ns: (height, width) of the map's cells.
        grid: The map.
        T_merged_grid: Pose of the map's corner in the merged map's corner frame.
    """

    since_ns: StampArray
    grid: OccupancyGrid
    T_merged_grid: SE2

    def at(self, points_m: FloatArray) -> StampArray:
        """(N,) times of the cells in which points (N, 2) of the merged map's corner frame lie."""
        cells = np.floor(self.T_merged_grid.inverse().apply(points_m) / self.grid.resolution_m).astype(np.intp)
        cols = cells[:, 0].clip(0, self.grid.width - 1)
        rows = cells[:, 1].clip(0, self.grid.height - 1)
        found: StampArray = self.since_ns[rows, cols]
        return found


def without_moved_things(
    layers: Sequence[Layer], times: Sequence[CellTimes], shape: tuple[int, int], resolution_m: float
) -> list[Layer]:
    """The layers of a canvas (height, width), with small occupied things unknown where another's later view is free.

    The order of the maps does not matter.
    """
    size = 2 * round(APART_M / resolution_m) + 1
    disc = np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)), np.uint8)
    occupied = [layer.cells >= OCCUPIED_PERCENT for layer in layers]
    clear = [_clear(layer.cells, walls, disc) for layer, walls in zip(layers, occupied, strict=True)]
    clear_somewhere = np.zeros(shape, np.bool_)
    for layer, free in zip(layers, clear, strict=True):
        clear_somewhere[layer.box] |= free
    kept = []
    for layer, walls, own in zip(layers, occupied, times, strict=True):
        things = _small_things(walls & clear_somewhere[layer.box], resolution_m)
        kept.append(layer if things is None else _without_gone(layer, things, own, layers, times, clear, resolution_m))
    return kept


def _clear(cells: Cells, walls: Mask, disc: npt.NDArray[np.uint8]) -> Mask:
    """The free cells that are further from the map's own walls than the disc reaches."""
    near_walls = cv2.dilate(walls.view(np.uint8), disc).view(np.bool_)
    clear: Mask = (cells >= 0) & (cells <= FREE_PERCENT) & ~near_walls
    return clear


@dataclass(frozen=True, slots=True, eq=False)
class _Things:
    """Connected parts of a mask, cell after cell: rows and columns, and where each part starts."""

    rows: Indices
    cols: Indices
    starts: Indices


def _small_things(mask: Mask, resolution_m: float) -> _Things | None:
    """The connected parts of a mask that are no larger than `MAX_SIZE_M` either way; None without any."""
    cells = np.flatnonzero(mask)
    if cells.size == 0:
        return None
    _, labels = cv2.connectedComponents(mask.view(np.uint8), connectivity=8)
    rows, cols = np.divmod(cells, mask.shape[1])
    label = labels[rows, cols]
    order = np.argsort(label, kind="stable")
    rows, cols = rows[order], cols[order]
    starts = np.flatnonzero(np.diff(label[order], prepend=-1))
    lengths = np.diff(starts, append=rows.size)
    size = np.maximum(*(np.maximum.reduceat(x, starts) - np.minimum.reduceat(x, starts) for x in (rows, cols))) + 1
    small = size * resolution_m <= MAX_SIZE_M
    if not small.any():
        return None
    of_small = np.repeat(small, lengths)
    return _Things(rows[of_small], cols[of_small], np.cumsum(lengths[small]) - lengths[small])


def _without_gone(
    layer: Layer,
    things: _Things,
    own: CellTimes,
    layers: Sequence[Layer],
    times: Sequence[CellTimes],
    clear: Sequence[Mask],
    resolution_m: float,
) -> Layer:
    """The layer, unknown where one of its things is gone for another layer."""
    rows, cols = things.rows + layer.row, things.cols + layer.col
    points_m = np.stack([cols + 0.5, rows + 0.5], axis=-1) * resolution_m
    stood_ns = np.maximum.reduceat(own.at(points_m), things.starts)
    gone = np.zeros(stood_ns.shape, np.bool_)
    for other, view, free in zip(layers, times, clear, strict=True):
        seen_free = np.logical_and.reduceat(_values(other, free, rows, cols), things.starts)
        if seen_free.any():
            gone |= seen_free & (np.minimum.reduceat(view.at(points_m), things.starts) > stood_ns)
    fades = np.repeat(gone, np.diff(things.starts, append=rows.size))
    cells = layer.cells.copy()
    cells[things.rows[fades], things.cols[fades]] = UNKNOWN
    return replace(layer, cells=cells)


def _values(layer: Layer, mask: Mask, rows: Indices, cols: Indices) -> Mask:
    """(N,) what the layer's mask says of cells of the canvas; False outside of the layer."""
    height, width = mask.shape
    rows, cols = rows - layer.row, cols - layer.col
    inside: Mask = (rows >= 0) & (rows < height) & (cols >= 0) & (cols < width)
    inside[inside] = mask[rows[inside], cols[inside]]
    return inside
