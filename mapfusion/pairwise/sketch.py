"""A map in one byte a cell: what a wall of another map would meet there, roughly."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mapfusion.pairwise.poses import Poses
from mapfusion.pairwise.refine import SAME_SIDE_COSINE
from mapfusion.pairwise.surface import DIRECTION_BINS, NOT_KNOWN, Bytes, Floats, SurfaceField

NEAR_CELLS = 6
"""A wall this near a wall seen from the same side agrees with it."""
DEEP_CELLS = 3
"""A wall this deep in free space, and this far from any wall, contradicts the map."""
_NOT_NEAR, _DEEP = np.uint8(31), np.uint8(32)
UNKNOWN = 64
NUM_CODES = 128
"""A cell's code: the direction of the wall near it or _NOT_NEAR, and the flags _DEEP and UNKNOWN."""
KNOWN, AGREES, CONTRADICTS = 1, 1 << 10, 1 << 20
"""What a wall meets, as digits that can be summed over fewer than 1024 walls."""


def sketch(field: SurfaceField) -> Bytes:
    """(H, W) codes of the cells of a field."""
    bins = np.floor(field.surface.facing() + np.float32(0.5)).astype(np.int32) % DIRECTION_BINS
    codes: Bytes = bins.astype(np.uint8).take(field.nearest)
    codes |= (field.distance > NEAR_CELLS) * _NOT_NEAR
    codes |= ((field.distance > DEEP_CELLS) & (field.depth > DEEP_CELLS)) * _DEEP
    codes |= (field.depth == NOT_KNOWN) * np.uint8(UNKNOWN)
    return codes


def meetings(codes: Bytes, facing: Floats, turns_rad: Poses) -> npt.NDArray[np.int32]:
    """(K, N) what N walls that face `facing` (N,), turned by `turns_rad` (K,), meet in cells of `codes` (K, N)."""
    # Half a turn more makes every bin positive, half a bin more rounds it by cutting it off.
    turns = np.remainder(turns_rad, 2.0 * np.pi) * (DIRECTION_BINS / (2.0 * np.pi)) + (DIRECTION_BINS / 2 + 0.5)
    rows = (facing + turns[:, None].astype(np.float32)).astype(np.int32)
    met: npt.NDArray[np.int32] = _TURNED_MEETINGS.take(rows * NUM_CODES + codes)
    return met


def _meetings() -> npt.NDArray[np.int32]:
    """(DIRECTION_BINS, NUM_CODES) what a wall that faces into a bin meets in a cell of a code."""
    codes, here = np.arange(NUM_CODES), np.arange(DIRECTION_BINS)[:, None]
    there = codes & _NOT_NEAR
    alike = np.cos((here - there) * (2.0 * np.pi / DIRECTION_BINS)) > SAME_SIDE_COSINE - 1e-6
    agrees = alike & (there != _NOT_NEAR)
    meets = KNOWN + agrees * AGREES + (codes & _DEEP > 0) * CONTRADICTS
    return np.where(codes & UNKNOWN > 0, 0, meets).astype(np.int32)


_TURNED_MEETINGS = _meetings().take(np.arange(2 * DIRECTION_BINS + 1) + DIRECTION_BINS // 2, axis=0, mode="wrap")
"""The same for directions to which half a turn was added, none of them reduced to a whole turn."""
