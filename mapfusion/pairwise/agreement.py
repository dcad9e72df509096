"""How well two maps agree where both are known, under a given transform: the paper's error with its bands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from mapfusion.grid import OccupancyGrid, resample
from mapfusion.transform import SE2, FloatArray

MaeBand = Literal["good", "doubtful", "failed"]

GOOD_BELOW = 20.0
"""Grey levels (0..255) of MAE below which a fusion is good. Source: Zick et al. 2025, section 3.4."""
FAILED_FROM = 28.49
"""Grey levels (0..255) of MAE from which a fusion has failed. Source: Zick et al. 2025, figure 9."""
GREY_PER_PERCENT = 2.55
"""Grey levels per cent of occupancy: I = 255 (1 - p / 100)."""

Bytes = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.float32]

_NOT_KNOWN, _MOST_KNOWN = 1e20, 200.0
"""Stands for an occupancy that is not known, so that one sampling tells both values and where they are known: a sample
above the second has a cell that is not known among those that weigh in, however little."""
_OCCUPANCY: Floats = np.array([p if p <= 100 else _NOT_KNOWN for p in range(256)], np.float32)
_DECIMALS_OF_MOVE = 9
"""Decimals of a cell to which the move is rounded: a quarter turn then leaves cells whole."""


@dataclass(frozen=True, slots=True)
class Agreement:
    """What two maps say about the cells that both know.

    Attributes:
        mae: Mean of |I1 - I2| over the cells known in both, I = 255 (1 - p / 100), grey levels 0..255; None without
            a common cell. Source: Zick et al. 2025, section 3.4.
        overlap_cells: Number of cells known in both, at `resolution_m`.
        overlap_ratio: `overlap_cells` / known cells of the map that knows fewer, at `resolution_m`, in [0, 1].
        resolution_m: Cell size at which the maps were compared: the coarser one's.
    """

    mae: float | None
    overlap_cells: int
    overlap_ratio: float
    resolution_m: float

    @property
    def band(self) -> MaeBand | None:
        """The paper's verdict on `mae`; None without a common cell."""
        return None if self.mae is None else mae_band(self.mae)


def agreement(target: OccupancyGrid, source: OccupancyGrid, T_target_source: SE2) -> Agreement:
    """Compares the maps cell by cell after the source was brought to the target by `T_target_source`.

    Grids of different resolution are compared at the coarser one. The source is sampled bilinearly at the centres of
    the target's cells, and only where all cells that weigh in are known, so unknown is never a value. The identity
    leaves every cell untouched. Swapping the maps and inverting the transform changes the MAE by what bilinear
    sampling blurs.
    """
    resolution_m = max(target.resolution_m, source.resolution_m)
    target, source = resample(target, resolution_m), resample(source, resolution_m)
    known_target, known_source = target.known.view(np.uint8), source.known.view(np.uint8)
    fewer_known = min(cv2.countNonZero(known_target), cv2.countNonZero(known_source))
    box_source, box_target = _bounding_box(known_source), _bounding_box(known_target)
    to_target = _cells_to_cells(target, source, T_target_source)
    box = _intersection(box_target, _moved(box_source, to_target))
    if fewer_known == 0 or box.empty:
        return Agreement(None, 0, 0.0, resolution_m)

    to_target = (_shift(-box.left, -box.top) @ to_target @ _shift(box_source.left, box_source.top))[:2]
    moved = cv2.warpAffine(
        cv2.LUT(source.cells[box_source.slices].view(np.uint8), _OCCUPANCY),
        np.round(to_target, _DECIMALS_OF_MOVE),
        (box.right - box.left, box.bottom - box.top),
        borderValue=_NOT_KNOWN,
    )
    common = np.less_equal(moved, _MOST_KNOWN).view(np.uint8) & known_target[box.slices]
    overlap_cells = cv2.countNonZero(common)
    if overlap_cells == 0:
        return Agreement(None, 0, 0.0, resolution_m)
    error = cv2.norm(moved, target.cells[box.slices].astype(np.float32), cv2.NORM_L1, common)
    mae = error / overlap_cells * GREY_PER_PERCENT
    return Agreement(mae, overlap_cells, min(1.0, overlap_cells / fewer_known), resolution_m)


def mae_band(mae: float) -> MaeBand:
    """The paper's verdict on an error in grey levels 0..255."""
    if mae < GOOD_BELOW:
        return "good"
    return "doubtful" if mae < FAILED_FROM else "failed"


class _Box(NamedTuple):
    """Cells [top, bottom) x [left, right)."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def empty(self) -> bool:
        return self.left >= self.right or self.top >= self.bottom

    @property
    def slices(self) -> tuple[slice, slice]:
        return slice(self.top, self.bottom), slice(self.left, self.right)


def _bounding_box(mask: Bytes) -> _Box:
    left, top, width, height = cv2.boundingRect(mask)
    return _Box(left, top, left + width, top + height)


def _intersection(a: _Box, b: _Box) -> _Box:
    return _Box(max(a.left, b.left), max(a.top, b.top), min(a.right, b.right), min(a.bottom, b.bottom))


def _moved(box: _Box, matrix: FloatArray) -> _Box:
    """The box around `box` after the move, a cell wider than needed."""
    xs, ys = (box.left, box.right - 1), (box.top, box.bottom - 1)
    corners = matrix[:2] @ np.array([[x, y, 1.0] for x in xs for y in ys]).T
    (left, top), (right, bottom) = np.floor(corners.min(axis=1)), np.ceil(corners.max(axis=1))
    return _Box(int(left), int(top), int(right) + 1, int(bottom) + 1)


def _shift(x: float, y: float) -> FloatArray:
    return np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])


def _cells_to_cells(target: OccupancyGrid, source: OccupancyGrid, T_target_source: SE2) -> FloatArray:
    """(3, 3) matrix from the source's (col, row) to the target's, both counted from the first cell's centre."""
    T = target.T_frame_grid.inverse() @ T_target_source @ source.T_frame_grid
    # Resolutions that differ by rounding only count as equal: cell 1 is then cell 1, however far away.
    matrix = T.matrix()
    matrix[:2, 2] /= target.resolution_m
    moved: FloatArray = _shift(-0.5, -0.5) @ matrix @ _shift(0.5, 0.5)
    return moved
