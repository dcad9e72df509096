"""Which of a group's maps a merged map of bounded size holds: robots that are far from the others are left out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mapfusion.grid import OccupancyGrid, crop_to_known
from mapfusion.transform import SE2, FloatArray

_ROUNDING_CELLS = 1e-6
"""A corner that lies on the lattice but for this much adds no cells."""


def fitting(
    grids: Sequence[OccupancyGrid], T_world_frames: Sequence[SE2], resolution_m: float | None, max_cells: int
) -> list[int]:
    """The maps that fit into one merged map together.

    A map that is too large by itself is left out first, then the one whose middle lies farthest from the median of all
    middles, of equals the later one, until the others fit. One without a known cell takes no room.

    Args:
        grids: The maps.
        T_world_frames: Pose of each grid's frame in the common frame.
        resolution_m: Cell size of the merged map; None: the finest of its maps.
        max_cells: Most cells of the merged map.

    Returns:
        Their places in `grids`, ascending; maybe none.
    """
    boxes = {
        index: _box(grid, T)
        for index, (grid, T) in enumerate(zip(grids, T_world_frames, strict=True))
        if grid.known.any()
    }

    def num_cells(chosen: Sequence[int]) -> int:
        finest_m = min(grids[index].resolution_m for index in chosen) if resolution_m is None else resolution_m
        low = np.floor(np.min([boxes[index][0] for index in chosen], axis=0) / finest_m + _ROUNDING_CELLS)
        high = np.ceil(np.max([boxes[index][1] for index in chosen], axis=0) / finest_m - _ROUNDING_CELLS)
        width, height = (int(span) for span in high - low)
        return width * height

    kept = [index for index in boxes if num_cells([index]) <= max_cells]
    middles = np.array([np.mean(boxes[index], axis=0) for index in kept]).reshape(-1, 2)
    distances_m = np.linalg.norm(middles - np.median(middles, axis=0), axis=1) if kept else np.empty(0)
    nearest_first = [index for _, index in sorted(zip(distances_m.round(6), kept, strict=True))]
    while nearest_first and num_cells(nearest_first) > max_cells:
        nearest_first.pop()
    return [index for index in range(len(grids)) if index not in boxes or index in nearest_first]


def _box(grid: OccupancyGrid, T_world_frame: SE2) -> FloatArray:
    """(2, 2): lowest and highest x and y in metres of the known cells in the common frame."""
    part = crop_to_known(grid)
    width_m, height_m = part.width * part.resolution_m, part.height * part.resolution_m
    corners = np.array([[0.0, 0.0], [width_m, 0.0], [0.0, height_m], [width_m, height_m]])
    placed = (T_world_frame @ part.T_frame_grid).apply(corners)
    return np.array([placed.min(axis=0), placed.max(axis=0)])
