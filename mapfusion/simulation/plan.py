"""A storey as a raster of free and occupied cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mapfusion.grid import Mask
from mapfusion.transform import FloatArray

PLAN_RESOLUTION_M = 0.05
"""Edge length of a plan's cell, metres."""

Raster = npt.NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class FloorPlan:
    """One storey as a raster; its world frame has the origin in the corner of cell (0, 0), x along columns.

    Attributes:
        occupied: (height, width) mask of walls, furniture and everything outside. Read-only.
        clearance_m: (height, width) float32, distance from a cell's centre to the nearest occupied one's, metres.
        places_m: (N, 2) points in rooms and corridors that are worth a visit, metres.
    """

    occupied: Mask
    clearance_m: npt.NDArray[np.float32]
    places_m: FloatArray

    def __post_init__(self) -> None:
        for array in (self.occupied, self.clearance_m, self.places_m):
            array.flags.writeable = False

    def clearance_at_m(self, points_m: FloatArray) -> FloatArray:
        """Clearance (...) of the cells in which points (..., 2) lie, metres; 0 beyond the plan."""
        height, width = self.occupied.shape
        cols, rows = np.moveaxis(np.floor(points_m / PLAN_RESOLUTION_M).astype(np.intp), -1, 0)
        inside = (rows >= 0) & (rows < height) & (cols >= 0) & (cols < width)
        clearance: FloatArray = np.where(inside, self.clearance_m[rows * inside, cols * inside], 0.0)
        return clearance


def plan_cells(length_m: float) -> int:
    """A length in cells of a plan."""
    return round(length_m / PLAN_RESOLUTION_M)
