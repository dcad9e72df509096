"""What a robot makes of its scans: an occupancy grid in a frame of its own, growing as it goes."""

from __future__ import annotations

import math

import cv2
import numpy as np
import numpy.typing as npt

from mapfusion.grid import UNKNOWN, Cells, OccupancyGrid
from mapfusion.simulation.lidar import LidarConfig, beam_angles_rad
from mapfusion.transform import SE2, FloatArray

_LOG_ODDS_HIT, _LOG_ODDS_PASSED = 0.9, -0.4
_LOG_ODDS_LIMITS = (-2.5, 4.0)
_SUBPIXEL_BITS = 4


class GridMapper:
    """Log-odds mapping with known poses. Source: Thrun, Burgard, Fox: Probabilistic Robotics, chapter 9.

    The log odds live in an array that grows with what was seen, by whole metres, about an origin that is not a
    multiple of the cell size in the map frame.
    """

    def __init__(
        self,
        frame_id: str,
        resolution_m: float,
        corner_m: tuple[float, float],
        lidar: LidarConfig,
        graded: bool = False,
    ) -> None:
        """Starts with an empty map.

        Args:
            frame_id: The robot's map frame.
            resolution_m: Edge length of a cell.
            corner_m: A point of the map frame that is and stays a corner of cells.
            lidar: The scanner; beams without an echo clear the cells up to its range.
            graded: Give probabilities in per cent; else 0 and 100 only.
        """
        self._frame_id = frame_id
        self._resolution_m = resolution_m
        self._corner_m = corner_m
        self._lidar = lidar
        self._graded = graded
        self._block = max(1, round(1.0 / resolution_m))
        self._first_col = self._first_row = 0
        self._log_odds: npt.NDArray[np.float32] = np.zeros((0, 0), np.float32)

    def add_scan(self, pose: FloatArray, ranges: FloatArray) -> None:
        """Takes one scan of ranges (B,), made at a pose (3,) of x, y, yaw in the map frame, into the map."""
        reach = self._lidar.max_range_m
        angles = beam_angles_rad(len(ranges))[~np.isnan(ranges)] + pose[2]
        lengths = ranges[~np.isnan(ranges)]
        echo = lengths < reach
        directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        hits = self._to_cells(pose[:2] + lengths[echo, None] * directions[echo])
        # One cell short of the echo, so that the cleared area does not eat into the wall it ends at.
        cleared_m = np.maximum(np.where(echo, lengths - self._resolution_m, reach), 0.0)
        outline = self._to_cells(pose[:2] + cleared_m[:, None] * directions)

        low, high = (np.floor(edge).astype(int) for edge in (outline.min(axis=0) - 2, outline.max(axis=0) + 3))
        self._grow(low, high)
        shape = int(high[1] - low[1]), int(high[0] - low[0])
        evidence = np.zeros(shape, np.float32)
        # OpenCV's whole coordinates are cell centres.
        corners = np.round((outline - low - 0.5) * (1 << _SUBPIXEL_BITS)).astype(np.int32)
        cv2.fillPoly(evidence, [corners], (_LOG_ODDS_PASSED,), shift=_SUBPIXEL_BITS)
        cols, rows = np.floor(hits - low).astype(int).T
        seen = (cols >= 0) & (rows >= 0) & (cols < shape[1]) & (rows < shape[0])
        evidence[rows[seen], cols[seen]] = _LOG_ODDS_HIT

        row, col = int(low[1]) - self._first_row, int(low[0]) - self._first_col
        window = self._log_odds[row : row + shape[0], col : col + shape[1]]
        np.clip(window + evidence, *_LOG_ODDS_LIMITS, out=window)

    def grid(self, stamp_ns: int) -> OccupancyGrid:
        """The map so far: everything seen, up to the next whole metres about the corner.

        Raises:
            ValueError: No scan was taken in yet.
        """
        seen = self._log_odds != 0.0
        rows, cols = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
        if rows.size == 0:
            raise ValueError("a map without a scan has no cells")
        block = self._block
        bottom, top = rows[0] // block * block, (rows[-1] // block + 1) * block
        left, right = cols[0] // block * block, (cols[-1] // block + 1) * block
        corner = SE2(
            self._corner_m[0] + float(self._first_col + left) * self._resolution_m,
            self._corner_m[1] + float(self._first_row + bottom) * self._resolution_m,
            0.0,
        )
        cells = self._occupancy(self._log_odds[bottom:top, left:right])
        return OccupancyGrid(cells, self._resolution_m, corner, self._frame_id, stamp_ns)

    def _occupancy(self, log_odds: npt.NDArray[np.float32]) -> Cells:
        probability = 1.0 / (1.0 + np.exp(-log_odds)) if self._graded else log_odds > 0.0
        cells: Cells = np.where(log_odds == 0.0, UNKNOWN, np.round(100.0 * probability)).astype(np.int8)
        return cells

    def _to_cells(self, points_m: FloatArray) -> FloatArray:
        """(N, 2) column and row, as fractions, counted from the corner."""
        cells: FloatArray = (points_m - self._corner_m) / self._resolution_m
        return cells

    def _grow(self, low: npt.NDArray[np.int_], high: npt.NDArray[np.int_]) -> None:
        """Makes room for the cells from `low` to below `high` (column, row), in whole blocks."""
        rows, cols = self._log_odds.shape
        block = self._block
        left, bottom = (
            min(0, math.floor((edge - first) / block) * block)
            for edge, first in zip(low, (self._first_col, self._first_row), strict=True)
        )
        right, top = (
            max(size, math.ceil((edge - first) / block) * block)
            for edge, first, size in zip(high, (self._first_col, self._first_row), (cols, rows), strict=True)
        )
        if (left, bottom, right, top) != (0, 0, cols, rows):
            self._log_odds = np.pad(self._log_odds, ((-bottom, top - rows), (-left, right - cols)))
            self._first_col += left
            self._first_row += bottom
