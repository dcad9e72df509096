"""Occupancy grids: cells, where they lie, and how one grid becomes another of the same place."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from mapfusion.compiled import compiled
from mapfusion.transform import SE2, FloatArray

Cells = npt.NDArray[np.int8]
Mask = npt.NDArray[np.bool_]

UNKNOWN = -1
"""Value of a cell that was never observed."""
OCCUPIED_PERCENT = 65
"""From this occupancy on a cell is a wall. Source: `occupied_thresh` of the ROS map_server."""
FREE_PERCENT = 25
"""Below or at this occupancy a cell is free. Source: `free_thresh` as Nav2's map_saver writes it."""


@dataclass(frozen=True, slots=True, eq=False)
class OccupancyGrid:
    """Occupancy of a planar area on a regular grid.

    Attributes:
        cells: (height, width) int8, -1 unknown, 0 free to 100 occupied; row 0 lies at the origin and rows grow
            with +y, columns with +x, as in nav_msgs/OccupancyGrid. Read-only.
        resolution_m: Edge length of a cell, metres, > 0.
        T_frame_grid: Pose of the corner of cell (0, 0) in `frame_id`, with its yaw.
        frame_id: Frame named in the message header.
        stamp_ns: Time of the message header, nanoseconds since the epoch.

    Raises:
        ValueError: Another shape or dtype, a value outside -1..100, or a resolution that is not finite and > 0.
    """

    cells: Cells
    resolution_m: float
    T_frame_grid: SE2
    frame_id: str = ""
    stamp_ns: int = 0

    def __post_init__(self) -> None:
        cells = self.cells
        if not isinstance(cells, np.ndarray):
            raise ValueError(f"cells must be a numpy array, not {type(cells).__name__}")
        if cells.ndim != 2 or cells.dtype != np.int8 or cells.size == 0:
            raise ValueError(f"cells must be (height, width) int8 and not empty, not {cells.shape} {cells.dtype}")
        if int(cells.min()) < UNKNOWN or int(cells.max()) > 100:
            raise ValueError(f"cells must lie in -1..100, not {cells.min()}..{cells.max()}")
        if not (math.isfinite(self.resolution_m) and self.resolution_m > 0.0):
            raise ValueError(f"resolution must be finite and > 0 m, not {self.resolution_m}")
        view = np.ascontiguousarray(cells).view()
        view.flags.writeable = False
        object.__setattr__(self, "cells", view)

    @property
    def height(self) -> int:
        """Number of rows."""
        return int(self.cells.shape[0])

    @property
    def width(self) -> int:
        """Number of columns."""
        return int(self.cells.shape[1])

    @property
    def known(self) -> Mask:
        """(height, width) mask of the cells that were observed."""
        return np.not_equal(self.cells, UNKNOWN)

    @property
    def walls(self) -> Mask:
        """(height, width) mask of the cells that are occupied."""
        return self.cells >= OCCUPIED_PERCENT

    @property
    def free(self) -> Mask:
        """(height, width) mask of the cells that are known to be free."""
        return (self.cells >= 0) & (self.cells <= FREE_PERCENT)

    def corners_m(self) -> FloatArray:
        """(4, 2) corners relative to that of cell (0, 0), in the grid's own directions, metres."""
        width_m, height_m = self.width * self.resolution_m, self.height * self.resolution_m
        return np.array([[0.0, 0.0], [width_m, 0.0], [0.0, height_m], [width_m, height_m]])

    def centres_m(self, mask: Mask) -> FloatArray:
        """Centres (N, 2) of the masked cells in the grid's frame, metres, in row-major order."""
        rows, cols = np.nonzero(mask)
        return self.T_frame_grid.apply(np.stack([cols + 0.5, rows + 0.5], axis=-1) * self.resolution_m)


def crop_to_known(grid: OccupancyGrid, margin: int = 0) -> OccupancyGrid:
    """The smallest grid that holds every known cell and `margin` cells around, within the old one.

    A grid without a known cell is returned as it is.
    """
    col, row, width, height = cv2.boundingRect(grid.known.view(np.uint8))
    if width == 0:
        return grid
    top, bottom = max(row - margin, 0), min(row + height + margin, grid.height)
    left, right = max(col - margin, 0), min(col + width + margin, grid.width)
    corner = SE2(left * grid.resolution_m, top * grid.resolution_m, 0.0)
    return replace(grid, cells=grid.cells[top:bottom, left:right], T_frame_grid=grid.T_frame_grid @ corner)


def quarter_turned(grid: OccupancyGrid, quarters: int) -> OccupancyGrid:
    """The same cells in the same places of the frame, in rows and columns that are turned by quarters of a turn."""
    x_m, y_m = grid.corners_m()[(0, 1, 3, 2)[quarters % 4]]
    T_grid_turned = SE2(x_m, y_m, quarters * math.pi / 2)
    return replace(grid, cells=np.rot90(grid.cells, quarters), T_frame_grid=grid.T_frame_grid @ T_grid_turned)


def apply_update(grid: OccupancyGrid, col: int, row: int, patch: Cells, stamp_ns: int) -> OccupancyGrid:
    """The grid with `patch` (height, width) laid over it, its first cell at (row, col).

    Raises:
        ValueError: The patch reaches beyond the grid.
    """
    height, width = patch.shape
    if row < 0 or col < 0 or row + height > grid.height or col + width > grid.width:
        raise ValueError(
            f"update of {width} x {height} cells at ({col}, {row}) "
            f"reaches beyond the grid of {grid.width} x {grid.height}"
        )
    cells = grid.cells.copy()
    cells[row : row + height, col : col + width] = patch
    return replace(grid, cells=cells, stamp_ns=stamp_ns)


def resample(grid: OccupancyGrid, resolution_m: float) -> OccupancyGrid:
    """The grid at another resolution, its corner where it was.

    Coarser: a new cell takes the highest occupancy among the known cells whose centres fall into it, so that thin
    walls survive; it is unknown when all of them are. Finer: every new cell takes the value at its centre.
    Resolutions that differ by less than one cell over the whole grid are taken as equal (32-bit rounding).
    """
    ratio = resolution_m / grid.resolution_m
    if abs(ratio - 1.0) * max(grid.height, grid.width) < 1.0:
        return grid
    height, width = (max(1, math.ceil(n / ratio - 1e-6)) for n in (grid.height, grid.width))
    if ratio < 1.0:
        rows = np.minimum(((np.arange(height) + 0.5) * ratio).astype(np.intp), grid.height - 1)
        cols = np.minimum(((np.arange(width) + 0.5) * ratio).astype(np.intp), grid.width - 1)
        return replace(grid, cells=grid.cells[np.ix_(rows, cols)], resolution_m=resolution_m)
    row_starts, col_starts = _bin_starts(grid.height, height, ratio), _bin_starts(grid.width, width, ratio)
    return replace(grid, cells=_pooled(grid.cells, row_starts, col_starts), resolution_m=resolution_m)


@compiled
def _pooled(cells: Cells, row_starts: npt.NDArray[np.intp], col_starts: npt.NDArray[np.intp]) -> Cells:
    """The highest value of each block of cells, whose first rows and columns are given; every block has a cell."""
    height, width = cells.shape
    pooled = np.empty((len(row_starts), len(col_starts)), cells.dtype)
    for i in range(len(row_starts)):
        last_row = row_starts[i + 1] if i + 1 < len(row_starts) else height
        for j in range(len(col_starts)):
            last_col = col_starts[j + 1] if j + 1 < len(col_starts) else width
            highest = cells[row_starts[i], col_starts[j]]
            for row in range(row_starts[i], max(last_row, row_starts[i] + 1)):
                for col in range(col_starts[j], max(last_col, col_starts[j] + 1)):
                    highest = max(highest, cells[row, col])
            pooled[i, j] = highest
    return pooled


def _bin_starts(num_old: int, num_new: int, ratio: float) -> npt.NDArray[np.intp]:
    """First old index whose centre falls into each new bin, strictly growing and below `num_old`."""
    starts: npt.NDArray[np.intp] = np.ceil(np.arange(num_new) * ratio - 0.5 - 1e-6).astype(np.intp)
    return starts.clip(0, num_old - 1)
