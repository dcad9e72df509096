"""A robot's newest grid, and since when its cells are as they are."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

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
        num_walls: Number of its walls' cells.
        num_new: Cells that became known, over all of the robot's grids. Across a change of the lattice only the number
            of known cells can be compared.
        num_turned: Known cells in which a wall came or went, over all of the robot's grids on one lattice.
        middle_m: (2,) middle of the box around its known cells, in the grid's frame.
        since_ns: (height, width) int64, since when each cell has been free, wall, between or unknown as it is now, as
            far as the robot's grids tell.
        classes: (height, width) which of these it is.
    """

    stamp_ns: int
    version: int
    grid: OccupancyGrid
    num_known: int
    num_walls: int
    num_new: int
    num_turned: int
    middle_m: FloatArray
    since_ns: StampArray
    classes: npt.NDArray[np.uint8]

    @classmethod
    def of(cls, stamp_ns: int, grid: OccupancyGrid, before: NewestGrid | None = None) -> NewestGrid:
        """Looks at a grid once, and at what has changed since the one before."""
        classes = np.asarray(cv2.LUT(grid.cells.view(np.uint8), _CLASS), np.uint8)
        known = (classes != _UNKNOWN).view(np.uint8)
        num_known = cv2.countNonZero(known)
        left, top, width, height = cv2.boundingRect(known)
        middle = np.array([left + 0.5 * width, top + 0.5 * height]) * grid.resolution_m
        since_ns = np.full(grid.cells.shape, stamp_ns, np.int64)
        num_new, num_turned = num_known, 0
        if before is not None:
            num_common, turned = _keep_times(since_ns, grid, classes, before)
            num_new, num_turned = before.num_new + abs(num_known - num_common), before.num_turned + turned
        return cls(
            stamp_ns=stamp_ns,
            version=1 if before is None else before.version + 1,
            grid=grid,
            num_known=num_known,
            num_walls=int(np.count_nonzero(classes == _WALL)),
            num_new=num_new,
            num_turned=num_turned,
            middle_m=grid.T_frame_grid.apply(middle),
            since_ns=since_ns,
            classes=classes,
        )


def _keep_times(
    since_ns: StampArray, grid: OccupancyGrid, classes: npt.NDArray[np.uint8], before: NewestGrid
) -> tuple[int, int]:
    """Gives the cells of `grid` that keep their class their old time in `since_ns`.

    Returns:
        How many cells were known before and are known now, and in how many of them a wall came or went. Those that were
        known before, and 0, where the grids do not lie on one lattice.
    """
    shift = _shift(before.grid, grid)
    if shift is None:
        return before.num_known, 0
    row, col = shift
    top, left = max(0, -row), max(0, -col)
    bottom, right = min(grid.height, before.grid.height - row), min(grid.width, before.grid.width - col)
    if top >= bottom or left >= right:
        return 0, 0
    here = np.s_[top:bottom, left:right]
    there = np.s_[top + row : bottom + row, left + col : right + col]
    now, old = classes[here], before.classes[there]
    np.copyto(since_ns[here], before.since_ns[there], where=now == old)
    both_known = (now != _UNKNOWN) & (old != _UNKNOWN)
    turned = both_known & ((now == _WALL) != (old == _WALL))
    return int(np.count_nonzero(both_known)), int(np.count_nonzero(turned))


def _shift(before: OccupancyGrid, grid: OccupancyGrid) -> tuple[int, int] | None:
    """Row and column of `before` at which `grid` begins; None where they do not lie on one lattice."""
    if grid.resolution_m != before.resolution_m:
        return None
    shift = before.T_frame_grid.inverse() @ grid.T_frame_grid
    col, row = round(shift.x_m / grid.resolution_m), round(shift.y_m / grid.resolution_m)
    off_lattice_m = max(abs(shift.x_m - col * grid.resolution_m), abs(shift.y_m - row * grid.resolution_m))
    return None if abs(shift.yaw_rad) > 1e-6 or off_lattice_m > 0.1 * grid.resolution_m else (row, col)
