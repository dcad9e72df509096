"""A robot's newest grid, and since when its cells are as they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapfusion.grid import FREE_PERCENT, OCCUPIED_PERCENT, OccupancyGrid
from mapfusion.steps import StampArray
from mapfusion.transform import FloatArray

_FREE, _BETWEEN, _WALL, _UNKNOWN = range(4)
_CLASS = np.full(256, _UNKNOWN, np.uint8)
"""Class of a cell by its byte."""
_CLASS[:101] = _BETWEEN
_CLASS[: FREE_PERCENT + 1] = _FREE
_CLASS[OCCUPIED_PERCENT:101] = _WALL


@dataclass(frozen=True, slots=True, eq=False)
class NewestGrid:
    """A robot's newest grid at a snapshot.

    Attributes:
        stamp_ns: When it was made, on the mission's clock.
        version: Counts the robot's grids from 1.
        grid: The grid.
        num_known: Number of its known cells.
        middle_m: (2,) middle of the box around its known cells, in the grid's frame.
        since_ns: (height, width) int64, since when each cell has been free, wall, between or unknown as it is now, as
            far as the robot's grids tell.
    """

    stamp_ns: int
    version: int
    grid: OccupancyGrid
    num_known: int
    middle_m: FloatArray
    since_ns: StampArray

    @classmethod
    def of(cls, stamp_ns: int, grid: OccupancyGrid, before: NewestGrid | None = None) -> NewestGrid:
        """Looks at a grid once, and at what has changed since the one before."""
        version = 1 if before is None else before.version + 1
        since_ns = _since(stamp_ns, grid, before)
        rows, cols = (np.flatnonzero(grid.known.any(axis=axis)) for axis in (1, 0))
        if rows.size == 0:
            return cls(stamp_ns, version, grid, 0, grid.T_frame_grid.apply(np.zeros(2)), since_ns)
        middle = np.array([cols[0] + cols[-1] + 1, rows[0] + rows[-1] + 1]) * 0.5 * grid.resolution_m
        num_known = int(np.count_nonzero(grid.known))
        return cls(stamp_ns, version, grid, num_known, grid.T_frame_grid.apply(middle), since_ns)


def _since(stamp_ns: int, grid: OccupancyGrid, before: NewestGrid | None) -> StampArray:
    """As `NewestGrid.since_ns`; cells that keep their class on the same lattice keep their time."""
    since_ns = np.full(grid.cells.shape, stamp_ns, np.int64)
    if before is None or grid.resolution_m != before.grid.resolution_m:
        return since_ns
    shift = before.grid.T_frame_grid.inverse() @ grid.T_frame_grid
    col, row = round(shift.x_m / grid.resolution_m), round(shift.y_m / grid.resolution_m)
    off_lattice_m = max(abs(shift.x_m - col * grid.resolution_m), abs(shift.y_m - row * grid.resolution_m))
    if abs(shift.yaw_rad) > 1e-6 or off_lattice_m > 0.1 * grid.resolution_m:
        return since_ns
    now, old = grid.cells, before.grid.cells
    top, left = max(0, -row), max(0, -col)
    bottom, right = min(grid.height, before.grid.height - row), min(grid.width, before.grid.width - col)
    if top < bottom and left < right:
        here = np.s_[top:bottom, left:right]
        there = np.s_[top + row : bottom + row, left + col : right + col]
        same = _CLASS[now[here].view(np.uint8)] == _CLASS[old[there].view(np.uint8)]
        np.copyto(since_ns[here], before.since_ns[there], where=same)
    return since_ns
