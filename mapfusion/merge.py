"""Several grids of one place into one."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from mapfusion.config import Blend
from mapfusion.grid import UNKNOWN, Cells, OccupancyGrid, crop_to_known, resample
from mapfusion.layer import Layer, lay
from mapfusion.moved import CellTimes, without_moved_things
from mapfusion.steps import StampArray
from mapfusion.transform import SE2

WALL_LOG_ODDS = 3.5
FREE_LOG_ODDS = -2.0
"""Evidence of a cell that a map holds to be occupied or free. A wall weighs more than free space: walls are thin, and
where two maps lie a cell apart, the free cell beside one map's wall must not erase the other's. Source: the asymmetry
of inverse sensor models, Thrun, Burgard, Fox, Probabilistic Robotics, 2005, ch. 9."""


class MergedMapTooLargeError(ValueError):
    """The merged map would have more cells than it may: robots placed far apart, or a map of many tiny cells."""


def merge_grids(
    grids: Sequence[OccupancyGrid],
    T_world_frames: Sequence[SE2],
    blend: Blend,
    resolution_m: float | None,
    stamp_ns: int,
    since_ns: Sequence[StampArray] | None = None,
    max_cells: int = 100_000_000,
) -> OccupancyGrid:
    """Brings grids into one frame and combines their cells by evidence.

    Args:
        grids: One or more maps.
        T_world_frames: Pose of each grid's frame in the common frame.
        blend: `log-odds` sums evidence, `max` takes the highest occupancy, `paper` overlays (the highest occupancy,
            known over unknown, sampled bilinearly).
        resolution_m: Cell size of the result; None: the finest of the grids.
        stamp_ns: Stamp of the result.
        since_ns: Since when each cell of each grid is as it is; with it, things that moved fade from the result of
            `log-odds`.
        max_cells: Most cells of the result.

    Raises:
        MergedMapTooLargeError: The result would have more.

    Returns:
        A grid, without rotation, whose corner is a multiple of its cell size; a cell is known where a map knows it, and
        keeps its value where one map alone knows it. One unknown cell where no map knows anything.
    """
    finest = min(grid.resolution_m for grid in grids) if resolution_m is None else resolution_m
    known = [index for index, grid in enumerate(grids) if grid.known.any()]
    if not known:
        return OccupancyGrid(np.full((1, 1), UNKNOWN, np.int8), finest, SE2.identity(), stamp_ns=stamp_ns)
    grids, placed = [grids[index] for index in known], [T_world_frames[index] for index in known]
    parts = [crop_to_known(resample(grid, finest) if grid.resolution_m < finest else grid) for grid in grids]
    col0, row0, width, height = _canvas(parts, placed, finest)
    if width * height > max_cells:
        raise MergedMapTooLargeError(f"a merged map of {width} x {height} cells, more than {max_cells}")
    T_world_merged = SE2(col0 * finest, row0 * finest, 0.0)
    layers = [
        lay(part, T_world_merged.inverse() @ T @ part.T_frame_grid, finest, (height, width), blend == "paper")
        for part, T in zip(parts, placed, strict=True)
    ]
    if blend == "log-odds" and since_ns is not None:
        times = [
            CellTimes(since_ns[index], grid, T_world_merged.inverse() @ T @ grid.T_frame_grid)
            for index, grid, T in zip(known, grids, placed, strict=True)
        ]
        layers = without_moved_things(layers, times, (height, width), finest)
    combined = _log_odds if blend == "log-odds" else _highest
    return OccupancyGrid(combined(layers, (height, width)), finest, T_world_merged, stamp_ns=stamp_ns)


def _canvas(parts: Sequence[OccupancyGrid], placed: Sequence[SE2], resolution_m: float) -> tuple[int, int, int, int]:
    """First column and row, width and height of the lattice cells that the parts' corners span."""
    corners = []
    for part, T in zip(parts, placed, strict=True):
        corners.append((T @ part.T_frame_grid).apply(part.corners_m()))
    spanned = np.concatenate(corners) / resolution_m
    # A corner that lies on the lattice but for rounding adds no row of unknown cells.
    low, high = np.floor(spanned.min(axis=0) + 1e-6).astype(int), np.ceil(spanned.max(axis=0) - 1e-6).astype(int)
    return int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1])


def _highest(layers: Sequence[Layer], shape: tuple[int, int]) -> Cells:
    """The highest occupancy that a layer has for each cell."""
    highest = np.full(shape, UNKNOWN, np.int8)
    for layer in layers:
        np.maximum(highest[layer.box], layer.cells, out=highest[layer.box])
    return highest


def _log_odds(layers: Sequence[Layer], shape: tuple[int, int]) -> Cells:
    """Sum of the layers' evidence as occupancy per cent; a cell that one layer alone knows keeps its value."""
    evidence, num_known = np.full(shape, _CERTAIN, np.int32), np.zeros(shape, np.uint16)
    for layer in layers:
        evidence[layer.box] += np.asarray(cv2.LUT(layer.cells.view(np.uint8), _EVIDENCE), np.int32)
        num_known[layer.box] += layer.cells != UNKNOWN
    cells = _highest(layers, shape)
    shared = np.flatnonzero(num_known > 1)
    cells.ravel()[shared] = _PERCENT.take(evidence.ravel().take(shared), mode="clip")
    return cells


_STEP = 0.01
"""Evidence is summed in whole steps of this many log-odds, so that the order of the maps cannot matter."""
_EVIDENCE = np.zeros(256, np.int32)
"""Evidence of a cell by its byte: linear from free over none at 50 % to a wall; none where it is unknown."""
_EVIDENCE[:101] = np.rint(np.interp(np.arange(101), [0.0, 50.0, 100.0], [FREE_LOG_ODDS, 0.0, WALL_LOG_ODDS]) / _STEP)
_CERTAIN = 1000
"""Steps beyond which the per cent no longer change."""
_PERCENT = np.rint(100.0 / (1.0 + np.exp(-_STEP * np.arange(-_CERTAIN, _CERTAIN + 1)))).astype(np.int8)
