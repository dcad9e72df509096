"""Things that stood in one robot's map and were gone when another looked: other robots, people, chairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from mapfusion.grid import FREE_PERCENT, OCCUPIED_PERCENT, UNKNOWN, Cells, Mask, OccupancyGrid
from mapfusion.steps import StampArray
from mapfusion.transform import SE2, FloatArray

Indices = npt.NDArray[np.intp]

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


def without_moved_things(layers: Sequence[Cells], times: Sequence[CellTimes], resolution_m: float) -> list[Cells]:
    """The layers (height, width), with small occupied things unknown where another map's later view is free.

    The order of the maps does not matter.
    """
    occupied = [layer >= OCCUPIED_PERCENT for layer in layers]
    size = 2 * round(APART_M / resolution_m) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    clear = [
        (layer >= 0) & (layer <= FREE_PERCENT) & (cv2.dilate(walls.view(np.uint8), disc) == 0)
        for layer, walls in zip(layers, occupied, strict=True)
    ]
    kept = [layer.copy() for layer in layers]
    clear_somewhere = np.logical_or.reduce(clear)
    for cells, walls, own in zip(kept, occupied, times, strict=True):
        things = _small_things(walls & clear_somewhere, resolution_m)
        if things is None:
            continue
        points_m = np.stack([things.cols + 0.5, things.rows + 0.5], axis=-1) * resolution_m
        stood_ns = np.maximum.reduceat(own.at(points_m), things.starts)
        gone = np.zeros(stood_ns.shape, np.bool_)
        for view, free in zip(times, clear, strict=True):
            seen_free = np.logical_and.reduceat(free[things.rows, things.cols], things.starts)
            gone |= seen_free & (np.minimum.reduceat(view.at(points_m), things.starts) > stood_ns)
        fades = np.repeat(gone, np.diff(things.starts, append=things.rows.size))
        cells[things.rows[fades], things.cols[fades]] = UNKNOWN
    return kept


@dataclass(frozen=True, slots=True, eq=False)
class _Things:
    """Connected parts of a mask, cell after cell: rows and columns, and where each part starts."""

    rows: Indices
    cols: Indices
    starts: Indices


def _small_things(mask: Mask, resolution_m: float) -> _Things | None:
    """The connected parts of a mask that are no larger than `MAX_SIZE_M` either way; None without any."""
    if not mask.any():
        return None
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask.view(np.uint8), connectivity=8)
    size = stats[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].max(axis=1)
    rows, cols = np.nonzero(mask)
    label = labels[rows, cols]
    order = np.argsort(label, kind="stable")
    order = order[size[label[order]] * resolution_m <= MAX_SIZE_M]
    if order.size == 0:
        return None
    starts = np.flatnonzero(np.diff(label[order], prepend=-1))
    return _Things(rows[order], cols[order], starts)
