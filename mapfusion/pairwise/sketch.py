"""A map in one byte a cell: what a wall of another map would meet there, roughly."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from mapfusion.compiled import compiled
from mapfusion.pairwise.poses import Poses
from mapfusion.pairwise.refine import SAME_SIDE_COSINE
from mapfusion.pairwise.surface import DIRECTION_BINS, NOT_KNOWN, Bytes, Floats, Indices, SurfaceField

NEAR_CELLS = 6
"""A wall this near a wall seen from the same side agrees with it."""
DEEP_CELLS = 3
"""A wall this deep in free space, and this far from any wall, contradicts the map."""
_NOT_NEAR, _DEEP = 31, 32
UNKNOWN = 64
NUM_CODES = 128
"""A cell's code: the direction of the wall near it or _NOT_NEAR, and the flags _DEEP and UNKNOWN."""
Sums = npt.NDArray[np.int64]
KNOWN, AGREES, CONTRADICTS = 1, 1 << 10, 1 << 20
"""What a wall meets, as digits that can be summed over fewer than 1024 walls."""


def sketch(field: SurfaceField) -> Bytes:
    """(H, W) codes of the cells of a field."""
    bins = np.floor(field.surface.facing + np.float32(0.5)).astype(np.int32) % DIRECTION_BINS
    return _sketched(field.nearest, field.distance, field.depth, bins, NOT_KNOWN)


@compiled
def _sketched(nearest: Indices, distance: Bytes, depth: Bytes, bins: Indices, not_known: int) -> Bytes:
    height, width = nearest.shape
    codes = np.empty((height, width), np.uint8)
    for row in range(height):
        for column in range(width):
            is_near = distance[row, column] <= NEAR_CELLS
            codes[row, column] = bins[nearest[row, column]] if is_near else _NOT_NEAR
        # Without the look-up many cells go through the loop at once.
        for column in range(width):
            is_deep = (distance[row, column] > DEEP_CELLS) & (depth[row, column] > DEEP_CELLS)
            flags = np.uint8(_DEEP if is_deep else 0) | np.uint8(UNKNOWN if depth[row, column] == not_known else 0)
            codes[row, column] |= flags
    return codes


def summed_meetings(codes: Bytes, cells: Indices, facing: Floats, turns_rad: Poses) -> Sums:
    """(K,) sums of what N walls meet in a map of `codes`.

    Args:
        codes: (H, W).
        cells: (K, N) flat index of the cell below each.
        facing: (N,) direction of each, in bins, before it is turned.
        turns_rad: (K,) by which they are turned.
    """
    return _summed(codes.ravel(), cells, facing, np.ascontiguousarray(turns_rad), _TURNED_MEETINGS)


def lying_well(codes: Bytes, cells: Indices, shifts: Indices, facing: Floats, turn_rad: float) -> npt.NDArray[np.int8]:
    """(N, S) of N walls, at S shifts: 1 where one agrees with a map of `codes`, -1 where it contradicts it, else 0.

    Args:
        codes: (H, W).
        cells: (N,) flat index of the cell below each wall.
        shifts: (S,) what is added to them.
        facing: (N,) direction of each, in bins, before it is turned.
        turn_rad: By which they are turned.
    """
    return _shifted(codes.ravel(), cells, shifts, facing, turn_rad, _LYING_WELL)


@compiled
def _summed(codes: Bytes, cells: Indices, facing: Floats, turns_rad: Poses, table: Indices) -> Sums:
    sums = np.zeros(len(cells), np.int64)
    for k in range(len(cells)):
        turn, total = _turn(turns_rad[k], len(table)), 0
        for i in range(len(facing)):
            total += table[int(facing[i] + turn), codes[cells[k, i]]]
        sums[k] = total
    return sums


@compiled
def _shifted(
    codes: Bytes,
    cells: Indices,
    shifts: Indices,
    facing: Floats,
    turn_rad: float,
    table: npt.NDArray[np.int8],
) -> npt.NDArray[np.int8]:
    well = np.empty((len(facing), len(shifts)), np.int8)
    turn = _turn(turn_rad, len(table))
    for i in range(len(facing)):
        row = table[int(facing[i] + turn)]
        for k in range(len(shifts)):
            well[i, k] = row[codes[cells[i] + shifts[k]]]
    return well


@compiled
def _turn(turn_rad: float, num_rows: int) -> float:
    """What is added to a direction in bins to find its row of the table.

    Half a turn more makes every bin positive, half a bin more rounds it by cutting it off.
    """
    num_bins = (num_rows - 1) // 2
    turns = turn_rad / (2.0 * math.pi) % 1.0 if math.isfinite(turn_rad) else 0.0
    return turns * num_bins + num_bins / 2 + 0.5


def _meetings() -> Indices:
    """(DIRECTION_BINS, NUM_CODES) what a wall that faces into a bin meets in a cell of a code."""
    codes, here = np.arange(NUM_CODES), np.arange(DIRECTION_BINS)[:, None]
    there = codes & _NOT_NEAR
    alike = np.cos((here - there) * (2.0 * np.pi / DIRECTION_BINS)) > SAME_SIDE_COSINE - 1e-6
    agrees = alike & (there != _NOT_NEAR)
    meets = KNOWN + agrees * AGREES + (codes & _DEEP > 0) * CONTRADICTS
    return np.where(codes & UNKNOWN > 0, 0, meets).astype(np.int32)


_TURNED_MEETINGS = _meetings().take(np.arange(2 * DIRECTION_BINS + 1) + DIRECTION_BINS // 2, axis=0, mode="wrap")
"""The same for directions to which half a turn was added, none of them reduced to a whole turn."""
_LYING_WELL = (_TURNED_MEETINGS % CONTRADICTS // AGREES - _TURNED_MEETINGS // CONTRADICTS).astype(np.int8)
"""The same: 1 where it agrees, -1 where it contradicts."""
