"""A map brought onto the lattice of a merged map."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from mapfusion.grid import UNKNOWN, Cells, OccupancyGrid
from mapfusion.transform import SE2, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """The part of a merged map's canvas that one map can know.

    Attributes:
        cells: (height, width) int8, as in a grid; unknown where the map says nothing.
        row: Row of the canvas at which it begins.
        col: Column of the canvas at which it begins.
    """

    cells: Cells
    row: int
    col: int

    @property
    def box(self) -> tuple[slice, slice]:
        """Its rows and columns on the canvas."""
        height, width = self.cells.shape
        return slice(self.row, self.row + height), slice(self.col, self.col + width)


def lay(part: OccupancyGrid, T_canvas_part: SE2, resolution_m: float, shape: tuple[int, int], smooth: bool) -> Layer:
    """Samples a map at the cells of a canvas.

    Args:
        part: The map.
        T_canvas_part: Pose of the map's corner in the frame of the canvas's corner.
        resolution_m: Cell size of the canvas.
        shape: Height and width of the canvas, which holds the whole map.
        smooth: Bilinearly between known cells; else the nearest cell.
    """
    top, left, bottom, right = _box(part, T_canvas_part, resolution_m, shape)
    T_box_part = SE2(-left * resolution_m, -top * resolution_m, 0.0) @ T_canvas_part
    ratio = resolution_m / part.resolution_m
    c, s = math.cos(T_box_part.yaw_rad), math.sin(T_box_part.yaw_rad)
    inverse = T_box_part.inverse()
    # Pixel centres lie at integers for cv2 and at half cells on the grid.
    half = (
        ratio * (np.array([[c, s], [-s, c]]) @ [0.5, 0.5])
        + np.array([inverse.x_m, inverse.y_m]) / part.resolution_m
        - 0.5
    )
    M = np.array([[ratio * c, ratio * s, half[0]], [-ratio * s, ratio * c, half[1]]])
    size = (right - left, bottom - top)
    # cv2 warps unsigned bytes: 255 stands for unknown.
    nearest = cv2.warpAffine(
        part.cells.view(np.uint8),
        M,
        size,
        flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=255,
    ).view(np.int8)
    return Layer(_smoothed(part, M, size, nearest) if smooth else nearest, top, left)


def _box(
    part: OccupancyGrid, T_canvas_part: SE2, resolution_m: float, shape: tuple[int, int]
) -> tuple[int, int, int, int]:
    """First row and column of the canvas that the map may reach, and those behind its last."""
    cols, rows = T_canvas_part.apply(part.corners_m()).T / resolution_m
    return (
        max(0, math.floor(rows.min()) - 1),
        max(0, math.floor(cols.min()) - 1),
        min(shape[0], math.ceil(rows.max()) + 1),
        min(shape[1], math.ceil(cols.max()) + 1),
    )


def _smoothed(part: OccupancyGrid, M: FloatArray, size: tuple[int, int], nearest: Cells) -> Cells:
    """Mean of the known cells around, weighted bilinearly; unknown where the nearest cell is."""
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    weight = cv2.warpAffine(part.known.astype(np.float32), M, size, flags=flags)
    value = cv2.warpAffine(np.where(part.known, part.cells, 0).astype(np.float32), M, size, flags=flags)
    blended = np.rint(value / np.maximum(weight, 1e-6)).clip(0, 100)
    cells: Cells = np.where(nearest == UNKNOWN, UNKNOWN, blended).astype(np.int8)
    return cells
