"""The point of a surface that is nearest to each cell: exactly as far as walls are looked for, and about beyond.

Columns first, then rows, as squared distances separate (P. F. Felzenszwalb, D. P. Huttenlocher, "Distance Transforms of
Sampled Functions", Theory of Computing 8, 2012). For a short reach the rows' lower envelopes are not worth building: of
all offsets within reach the least is taken, for many cells at a time, each with its offset in the lowest bits.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from mapfusion.compiled import compiled

REACH_CELLS = 20
"""How far the nearest point is looked for exactly."""
BLOCK_CELLS = 4
"""Beyond, as many times as far, it is looked for among the first points of blocks of cells this large."""
FAR = 255
"""Distance of a cell that has no point within reach."""
_OFFSET_BITS = 6
"""What an offset from -REACH_CELLS to REACH_CELLS takes."""
_NO_POINT = 39_000
"""More than a column's packed square can be; with the largest offset still a number of 16 bits."""
_WHOLE = np.array([math.floor(math.sqrt(square) + 0.5) for square in range(REACH_CELLS**2 + 1)], np.uint8)
"""Whole cells by squared distance."""
Bytes = npt.NDArray[np.uint8]
Indices = npt.NDArray[np.int32]
_Packed = npt.NDArray[np.uint16]


def nearest_points(points: npt.NDArray[np.float32], shape: tuple[int, int], margin: int) -> tuple[Indices, Bytes]:
    """The index (H, W) of the point that is nearest to each cell, and how many cells away it is, rounded (H, W).

    Where no point is within REACH_CELLS the distance is FAR; the index is that of a point that is nearly as near as any
    up to BLOCK_CELLS times as far, and beyond that of the first point. Of points that are equally near the leftmost
    column's is taken, and there the upper one's.

    Args:
        points: (N, 2) x and y of the points, cells: at least one, none in another's cell, in row-major order of cells.
        shape: (H, W).
        margin: Rows above and columns before the cell whose corner the points are counted from.
    """
    columns, rows = np.ascontiguousarray((points + np.float32(margin)).astype(np.int32).T)
    every = np.arange(len(points), dtype=np.int32)
    blocks = _firsts(rows, columns, shape[0] // BLOCK_CELLS + 1, shape[1] // BLOCK_CELLS + 1)
    nowhere = np.zeros((shape[0] // BLOCK_CELLS**2 + 1, shape[1] // BLOCK_CELLS**2 + 1), np.int32)
    beyond, _ = _nearest(*blocks, shape[0] // BLOCK_CELLS + 1, shape[1] // BLOCK_CELLS + 1, nowhere)
    return _nearest(rows, columns, every, shape[0], shape[1], beyond)


@compiled
def _firsts(rows: Indices, columns: Indices, height: int, width: int) -> tuple[Indices, Indices, Indices]:
    """Of each block (of height x width) that has points the row and column, and the index of its first point."""
    first = np.full((height, width), -1, np.int32)
    number = 0
    for i in range(len(rows)):
        row, column = rows[i] // BLOCK_CELLS, columns[i] // BLOCK_CELLS
        if first[row, column] < 0:
            first[row, column] = i
            number += 1
    of_rows, of_columns, points = np.empty(number, np.int32), np.empty(number, np.int32), np.empty(number, np.int32)
    number = 0
    for row in range(height):
        for column in range(width):
            if first[row, column] >= 0:
                of_rows[number], of_columns[number], points[number] = row, column, first[row, column]
                number += 1
    return of_rows, of_columns, points


@compiled
def _nearest(
    rows: Indices, columns: Indices, points: Indices, height: int, width: int, beyond: Indices
) -> tuple[Indices, Bytes]:
    """As nearest_points.

    Args:
        rows: (N,) of the points, in row-major order.
        columns: (N,).
        points: (N,) indices by which they are named.
        height: H.
        width: W.
        beyond: The index for the cells of each block (H / BLOCK_CELLS, W / BLOCK_CELLS) that have no point in reach.
    """
    nearest, distance = np.empty((height, width), np.int32), np.empty((height, width), np.uint8)
    in_column = np.full(width, points[0], np.int32)
    steps = np.full(width, FAR, np.uint8)
    point = 0
    for row in range(height):  # downwards: the point above
        _step(steps)
        while point < len(rows) and rows[point] == row:
            steps[columns[point]], in_column[columns[point]] = 0, points[point]
            point += 1
        distance[row], nearest[row] = steps, in_column
    steps[:] = FAR
    packed = np.full(width + 2 * REACH_CELLS, _NO_POINT, np.uint16)
    best, candidates = np.empty(width, np.uint16), np.empty(width, np.int32)
    point = len(rows) - 1
    for row in range(height - 1, -1, -1):  # upwards: the one below, and along the row
        _step(steps)
        while point >= 0 and rows[point] == row:
            steps[columns[point]], in_column[columns[point]] = 0, points[point]
            point -= 1
        _choose(distance[row], nearest[row], steps, in_column, candidates, packed)
        _least(packed, best)
        _unpack(best, candidates, beyond[row // BLOCK_CELLS], nearest[row], distance[row])
    return nearest, distance


@compiled
def _step(steps: Bytes) -> None:
    """Another row away from the last point of each column."""
    for column in range(len(steps)):
        steps[column] = np.uint8(min(steps[column], np.uint8(FAR - 1)) + np.uint8(1))


@compiled
def _choose(
    above: Bytes, of_above: Indices, below: Bytes, of_below: Indices, candidates: Indices, packed: _Packed
) -> None:
    """The nearer of the points above and below in each column, its index and its packed squared distance."""
    for column in range(len(above)):
        candidates[column] = of_below[column] if below[column] < above[column] else of_above[column]
        cells = np.uint16(min(above[column], below[column]))
        square = np.uint16(np.uint16(cells * cells) << np.uint16(_OFFSET_BITS))
        packed[REACH_CELLS + column] = square if cells <= np.uint16(REACH_CELLS) else np.uint16(_NO_POINT)


@compiled
def _least(packed: _Packed, best: _Packed) -> None:
    """The least sum of a column's square and the offset's to it, each with the offset to that column, from 0 on."""
    best[:] = np.uint16(0xFFFF)
    for first in range(0, 2 * REACH_CELLS, 4):
        a, b, c, d = _cost(first), _cost(first + 1), _cost(first + 2), _cost(first + 3)
        for column in range(len(best)):
            one = np.uint16(packed[column + first] + a)
            two = np.uint16(packed[column + first + 1] + b)
            three = np.uint16(packed[column + first + 2] + c)
            four = np.uint16(packed[column + first + 3] + d)
            best[column] = min(min(min(one, two), min(three, four)), best[column])
    last = _cost(2 * REACH_CELLS)
    for column in range(len(best)):
        best[column] = min(np.uint16(packed[column + 2 * REACH_CELLS] + last), best[column])


@compiled
def _cost(offset: int) -> np.uint16:
    return np.uint16(((offset - REACH_CELLS) ** 2 << _OFFSET_BITS) + offset)


@compiled
def _unpack(best: _Packed, candidates: Indices, beyond: Indices, nearest: Indices, distance: Bytes) -> None:
    for column in range(len(best)):
        square, offset = best[column] >> _OFFSET_BITS, best[column] & ((1 << _OFFSET_BITS) - 1)
        if square <= REACH_CELLS**2:
            nearest[column] = candidates[column + offset - REACH_CELLS]
            distance[column] = _WHOLE[square]
        else:
            nearest[column], distance[column] = beyond[column // BLOCK_CELLS], FAR
