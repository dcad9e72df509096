"""Whether every part of a map, left to itself, stays where the pose of the whole puts it.

A wrong pose is the best of many: some parts of the map lie well by chance, the others were carried along and would lie
as well, or better, some cells away. Of a right pose most parts that are no straight wall prefer where they are.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from mapfusion.pairwise.poses import Poses, inverse, moved
from mapfusion.pairwise.prepared import PreparedMap
from mapfusion.pairwise.sketch import AGREES, CONTRADICTS, UNKNOWN, meetings
from mapfusion.pairwise.surface import NOT_KNOWN, Bytes, Floats

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
    cells = there.field.cells_below(moved(pose[None], surface.points))[0]
    known = np.flatnonzero(there.field.depth.ravel().take(cells) != NOT_KNOWN)
    number = min(len(known), MAX_POINTS)
    parts = _parts(surface.points, known[np.arange(number) * len(known) // max(number, 1)])
    if not parts:
        return 0.0, len(known)
    chosen = np.concatenate(parts)
    codes = _with_unknown_around(there.sketch)
    width = codes.shape[1]
    rows, columns = np.divmod(cells.take(chosen), there.sketch.shape[1])
    at = (rows + MAX_SHIFT_CELLS) * width + columns + MAX_SHIFT_CELLS
    lattice = at + (_SHIFTS[:, 1] * width + _SHIFTS[:, 0])[:, None]
    met = meetings(codes.ravel().take(lattice), surface.at(chosen).facing(), pose[2:])
    sizes = np.array([len(part) for part in parts])
    summed = np.add.reduceat(met, np.cumsum(sizes) - sizes, axis=1)
    lies_well = summed % CONTRADICTS // AGREES - summed // CONTRADICTS
    lead = lies_well[_LENGTH <= STAYS_CELLS].max(axis=0) - lies_well[_LENGTH >= ELSEWHERE_CELLS].max(axis=0)
    stays = lead > MIN_LEAD * sizes
    return float(sizes[stays].sum() * len(known) / number), len(known)


def _with_unknown_around(codes: Bytes) -> Bytes:
    m = MAX_SHIFT_CELLS
    return np.asarray(cv2.copyMakeBorder(codes, m, m, m, m, cv2.BORDER_CONSTANT, value=UNKNOWN), np.uint8)


def _parts(points: Floats, chosen: npt.NDArray[np.intp]) -> list[npt.NDArray[np.intp]]:
    """The chosen (N,) of some points (M, 2), halved across their longer side again and again."""
    parts = [chosen] if len(chosen) >= MIN_PART_POINTS else []
    for _ in range(NUM_HALVINGS):
        if not parts or min(map(len, parts)) < 2 * MIN_PART_POINTS:
            break
        parts = [half for part in parts for half in _halves(points, part)]
    return parts


def _halves(points: Floats, part: npt.NDArray[np.intp]) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    along = points.take(part, axis=0)
    axis = int(np.ptp(along, axis=0).argmax())
    order = part[np.argsort(along[:, axis], kind="stable")]
    middle = len(order) // 2
    return order[:middle], order[middle:]
