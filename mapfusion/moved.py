"""Things that stood in one robot's map and were gone when another looked: other robots, people, chairs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from mapfusion.grid import FREE_PERCENT, OCCUPIED_PERCENT, UNKNOWN, Cells, Mask, OccupancyGrid
from mapfusion.steps import StampArray
from mapfusion.transform import SE2, FloatArray

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
    for cells, walls, since in zip(kept, occupied, times, strict=True):
        for rows, cols in _small_things(walls & clear_somewhere, resolution_m):
            points_m = np.stack([cols + 0.5, rows + 0.5], axis=-1) * resolution_m
            stood_ns = np.median(since.at(points_m))
            views = [other for other, free in zip(times, clear, strict=True) if free[rows, cols].all()]
            if any(np.median(view.at(points_m)) > stood_ns for view in views):
                cells[rows, cols] = UNKNOWN
    return kept


def _small_things(mask: Mask, resolution_m: float) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Rows and columns of every connected part of a mask that is no larger than `MAX_SIZE_M` either way."""
    if not mask.any():
        return
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.view(np.uint8), connectivity=8)
    for label in range(1, count):
        left, top, width, height, _ = (int(value) for value in stats[label])
        if max(width, height) * resolution_m <= MAX_SIZE_M:
            rows, cols = np.nonzero(labels[top : top + height, left : left + width] == label)
            yield rows + top, cols + left
