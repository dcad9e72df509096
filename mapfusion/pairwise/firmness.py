"""Whether every part of a map, left to itself, stays where the pose of the whole puts it.

A wrong pose is the best of many: some parts of the map lie well by chance, the others were carried along and would lie
as well, or better, some cells away. Of a right pose most parts that are no straight wall prefer where they are.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
import numpy.typing as npt

from mapfusion.compiled import compiled
from mapfusion.pairwise.poses import Poses, inverse
from mapfusion.pairwise.prepared import PreparedMap
from mapfusion.pairwise.refine import cells_below
from mapfusion.pairwise.sketch import UNKNOWN, lying_well
from mapfusion.pairwise.surface import NOT_KNOWN, Bytes, Indices, Points

NUM_HALVINGS = 4
"""A map's walls are halved so often: 16 parts."""
NUM_CUTS = 4
"""So many ways to cut a map into parts, along axes turned against each other: where cuts fall decides much of one."""
MIN_PART_POINTS = 12
"""Fewer walls are no part of their own: a map with few is halved less often."""
MAX_POINTS = 768
"""About so many of a map's walls are looked at, spread evenly."""
STEP_CELLS, MAX_SHIFT_CELLS = 4, 24
"""A part is tried on a lattice of shifts."""
STAYS_CELLS, ELSEWHERE_CELLS = 8, 12
"""A shift up to the first leaves a part where it is, as maps bend; one from the second on takes it elsewhere."""
MIN_LEAD = 0.1
"""By which share of its points a part must lie better where it is than anywhere else."""

_STEPS = np.arange(-MAX_SHIFT_CELLS, MAX_SHIFT_CELLS + 1, STEP_CELLS, dtype=np.int32)
_SHIFTS = np.stack(np.meshgrid(_STEPS, _STEPS, indexing="ij"), -1).reshape(-1, 2)
_LENGTH = np.abs(_SHIFTS).max(axis=1)


def firmness(target: PreparedMap, source: PreparedMap, pose: Poses) -> float:
    """The share of the walls in the area known in both that belong to parts which stay, in [0, 1]; mean of NUM_CUTS.

    Args:
        target: A map with walls.
        source: Another one.
        pose: (3,) of the source in the target, in cells.
    """
    stays, number = np.add(_one_way(target, source, pose), _one_way(source, target, inverse(pose[None])[0]))
    return float(stays / max(number, 1))


def _one_way(there: PreparedMap, here: PreparedMap, pose: Poses) -> tuple[float, int]:
    """Walls of `here` whose part stays under `pose` in `there`, and all of its walls in the common area."""
    assert there.field is not None
    assert here.field is not None
    surface = here.field.surface
    cells = cells_below(there.field, surface.points, pose[None])[0]
    known = np.flatnonzero(there.field.depth.ravel().take(cells) != NOT_KNOWN)
    number = min(len(known), MAX_POINTS)
    if number < MIN_PART_POINTS:
        return 0.0, len(known)
    chosen = known[np.arange(number) * len(known) // number]
    codes = _with_unknown_around(there.sketch)
    width = codes.shape[1]
    rows, columns = np.divmod(cells.take(chosen), there.sketch.shape[1])
    well = lying_well(
        codes,
        (rows + MAX_SHIFT_CELLS) * width + columns + MAX_SHIFT_CELLS,
        _SHIFTS[:, 1] * width + _SHIFTS[:, 0],
        surface.facing.take(chosen),
        float(pose[2]),
    )
    points = surface.points.take(chosen, axis=0)
    parts = [_parts(points, 0.5 * math.pi * cut / NUM_CUTS) for cut in range(NUM_CUTS)]
    staying = sum(_num_staying(well, _LENGTH, *of_cut) for of_cut in parts)
    return staying / NUM_CUTS * len(known) / number, len(known)


def _with_unknown_around(codes: Bytes) -> Bytes:
    m = MAX_SHIFT_CELLS
    return np.asarray(cv2.copyMakeBorder(codes, m, m, m, m, cv2.BORDER_CONSTANT, value=UNKNOWN), np.uint8)


@compiled
def _num_staying(
    well: npt.NDArray[np.int8],
    length_cells: Indices,
    ordered: npt.NDArray[np.int64],
    sizes: npt.NDArray[np.int64],
) -> int:
    """How many of N walls belong to parts that lie better where they are than elsewhere.

    Args:
        well: (N, S) as `lying_well` gives it.
        length_cells: (S,) of each shift.
        ordered: (N,) walls, part by part.
        sizes: (P,) walls of each part.
    """
    staying, first = 0, 0
    total = np.empty(len(length_cells), np.int32)
    for size in sizes:
        total[:] = 0
        for i in range(first, first + size):
            of_wall = well[ordered[i]]
            for k in range(len(total)):
                total[k] = np.int32(total[k] + of_wall[k])
        here, elsewhere = -size, -size
        for k in range(len(total)):
            if length_cells[k] <= STAYS_CELLS:
                here = max(here, total[k])
            elif length_cells[k] >= ELSEWHERE_CELLS:
                elsewhere = max(elsewhere, total[k])
        if here - elsewhere > MIN_LEAD * size:
            staying += size
        first += size
    return staying


@compiled
def _parts(points: Points, turn_rad: float) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Some points (N, 2), at least MIN_PART_POINTS, part by part, by index (N,), and how many there are in each (P,).

    Parts are halved across their longer side again and again, seen along axes turned by `turn_rad`.
    """
    number, c, s = len(points), math.cos(turn_rad), math.sin(turn_rad)
    along, ordered, moved = np.empty((2, number)), np.empty((2, number), np.int64), np.empty(number, np.int64)
    for i in range(number):
        along[0, i], along[1, i] = c * points[i, 0] + s * points[i, 1], c * points[i, 1] - s * points[i, 0]
    for axis in range(2):
        ordered[axis] = np.argsort(along[axis], kind="mergesort")
    ends, is_beyond = np.array([0, number]), np.zeros(number, np.bool_)
    for _ in range(NUM_HALVINGS):
        if (ends[1:] - ends[:-1]).min() < 2 * MIN_PART_POINTS:
            break
        halves = np.empty(2 * len(ends) - 1, np.int64)
        halves[::2] = ends
        for k in range(len(ends) - 1):
            first, middle, last = ends[k], (ends[k] + ends[k + 1]) // 2, ends[k + 1]
            width, height = along[0, ordered[0, last - 1]], along[1, ordered[1, last - 1]]
            width, height = width - along[0, ordered[0, first]], height - along[1, ordered[1, first]]
            across = ordered[0] if width >= height else ordered[1]
            for i in range(first, last):
                is_beyond[across[i]] = i >= middle
            # Both orders stay sorted within each half.
            for axis in range(2):
                below, beyond = first, middle
                for i in range(first, last):
                    if is_beyond[ordered[axis, i]]:
                        moved[beyond] = ordered[axis, i]
                        beyond += 1
                    else:
                        moved[below] = ordered[axis, i]
                        below += 1
                ordered[axis, first:last] = moved[first:last]
            halves[2 * k + 1] = middle
        ends = halves
    return ordered[0].copy(), ends[1:] - ends[:-1]
