"""Whether every part of a map, left to itself, stays where the pose of the whole puts it.

A wrong pose is the best of many: some parts of the map lie well by chance, the others were carried along and would lie
as well, or better, some cells away. Of a right pose most parts that are no straight wall prefer where they are.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from mapfusion.compiled import compiled
from mapfusion.pairwise.poses import Poses, inverse
from mapfusion.pairwise.prepared import PreparedMap
from mapfusion.pairwise.refine import cells_below
from mapfusion.pairwise.sketch import UNKNOWN, lying_well
from mapfusion.pairwise.surface import NOT_KNOWN, Bytes, Points

NUM_HALVINGS = 4
"""A map's walls are halved so often: 16 parts."""
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
    """The share of the walls in the area known in both that belong to parts which stay, in [0, 1].

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
    chosen, sizes = _parts(surface.points, known[np.arange(number) * len(known) // max(number, 1)])
    if not len(sizes):
        return 0.0, len(known)
    codes = _with_unknown_around(there.sketch)
    width = codes.shape[1]
    rows, columns = np.divmod(cells.take(chosen), there.sketch.shape[1])
    lies_well = lying_well(
        codes,
        (rows + MAX_SHIFT_CELLS) * width + columns + MAX_SHIFT_CELLS,
        _SHIFTS[:, 1] * width + _SHIFTS[:, 0],
        surface.facing.take(chosen),
        pose[2],
        sizes,
    )
    lead = lies_well[_LENGTH <= STAYS_CELLS].max(axis=0) - lies_well[_LENGTH >= ELSEWHERE_CELLS].max(axis=0)
    return float(sizes[lead > MIN_LEAD * sizes].sum() * len(known) / number), len(known)


def _with_unknown_around(codes: Bytes) -> Bytes:
    m = MAX_SHIFT_CELLS
    return np.asarray(cv2.copyMakeBorder(codes, m, m, m, m, cv2.BORDER_CONSTANT, value=UNKNOWN), np.uint8)


@compiled
def _parts(points: Points, chosen: npt.NDArray[np.intp]) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.int64]]:
    """The chosen (N,) of some points (M, 2), part by part, and how many belong to each part (P,).

    Parts are halved across their longer side again and again. Fewer than MIN_PART_POINTS are none.
    """
    ordered, ends = chosen.copy(), np.array([0, len(chosen)])
    if len(chosen) < MIN_PART_POINTS:
        return ordered[:0], ends[:0]
    for _ in range(NUM_HALVINGS):
        sizes = ends[1:] - ends[:-1]
        if sizes.min() < 2 * MIN_PART_POINTS:
            break
        halves = np.empty(2 * len(sizes) + 1, np.int64)
        halves[::2] = ends
        for k in range(len(sizes)):
            part = ordered[ends[k] : ends[k + 1]]
            x, y = np.empty(len(part)), np.empty(len(part))
            for i in range(len(part)):
                x[i], y[i] = points[part[i], 0], points[part[i], 1]
            along = x if x.max() - x.min() >= y.max() - y.min() else y
            part[:] = part[np.argsort(along, kind="mergesort")]
            halves[2 * k + 1] = ends[k] + len(part) // 2
        ends = halves
    return ordered, ends[1:] - ends[:-1]
