"""A closer look at a pose: how its walls agree, and what no right pose shows.

Evidence against chance counts cells. Places tell themselves apart by other things as well. Cells of one straight wall
agree together once the wall does, and any corner fits any other: it matters how many walls, each with its own direction
and offset, agree at once. Where a wall of one map crosses a passage of the other, one of the two is not there; bent
maps and moved furniture contradict each other as well, but along walls, not across. A wall that strays through the
other's free space for many metres, however it lies to the walls there, is no furniture. And a wall that lies on another
one, seen from the other side, is a neighbour's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from mapfusion.pairwise.poses import Poses, inverse, rotations, turned
from mapfusion.pairwise.refine import SAME_SIDE_COSINE, Encounters, encounters
from mapfusion.pairwise.surface import NOT_KNOWN, Points, Surface, SurfaceField

NEAR_CELLS = 3.0
"""Walls within this meet; a wall deeper than this in free space stands in it."""
STRAY_CELLS = 6.0
"""A wall this deep in free space, and this far from any wall, strays through it."""
MIN_RUN_CELLS = 8
"""A shorter run of wall across free space may be noise."""
NUM_COMPARED = 128
"""So many agreeing cells are compared with each other to count walls."""
SAME_WALL_CELLS = 4.0
"""Standard deviation of the offset of cells of one wall."""


@dataclass(frozen=True, slots=True)
class Scrutiny:
    """What a closer look finds; shares are of the wall cells in the area known in both maps, in [0, 1].

    Attributes:
        lines: Effective number of walls that agree, the mean of both directions.
        turning: How firmly the agreeing walls hold the rotation, the mean of both directions: what they fix of it once
            the translation is free / the mean square of their distance from their middle; 0 for a circle.
        opposite: Share that meets a wall seen from the other side.
        crossing_cells: Longest connected run of wall that crosses the other map's free space, cells.
        crossing: Share that belongs to such runs of at least MIN_RUN_CELLS.
        stray_cells: Length, across its bounding box, of the longest connected run of wall that strays through the other
            map's free space, cells.
        outside: Share of all wall cells that lie outside what the other map knows, of the map for which it is less.
    """

    lines: float
    turning: float
    opposite: float
    crossing_cells: float
    crossing: float
    stray_cells: float
    outside: float


def scrutinise(target: SurfaceField, source: SurfaceField, pose: Poses, tolerance_cells: float) -> Scrutiny:
    """Looks closely at `pose` (3,) of the source in the target; walls agree within `tolerance_cells`."""
    both = [
        _look(target, source.surface, pose, tolerance_cells),
        _look(source, target.surface, inverse(pose[None])[0], tolerance_cells),
    ]
    num_known = max(1, sum(one.num_known for one in both))
    runs = [run.cells for one in both for run in one.crossing]
    return Scrutiny(
        lines=sum(one.lines for one in both) / 2.0,
        turning=sum(one.turning for one in both) / 2.0,
        opposite=sum(one.num_opposite for one in both) / num_known,
        crossing_cells=float(max(runs, default=0)),
        crossing=sum(run for run in runs if run >= MIN_RUN_CELLS) / num_known,
        stray_cells=max((run.length for one in both for run in one.stray), default=0.0),
        outside=min(1.0 - one.num_known / max(1, one.num_walls) for one in both),
    )


class _Run(NamedTuple):
    """A connected run of wall: its number of cells, and the diagonal of its bounding box, cells."""

    cells: int
    length: float


@dataclass(frozen=True, slots=True)
class _Look:
    """One direction: what the walls of one map meet in the other; numbers of cells."""

    num_walls: int
    num_known: int
    num_opposite: int
    lines: float
    turning: float
    crossing: list[_Run]
    stray: list[_Run]


def _look(field: SurfaceField, surface: Surface, pose: Poses, tolerance_cells: float) -> _Look:
    found = encounters(field, surface, pose[None])
    depth = field.depth.ravel().take(found.cells[0])
    known = depth != NOT_KNOWN
    squared = found.squared[0]
    near = known & (squared <= NEAR_CELLS**2)
    cosine = _cosine(found, surface, pose)
    across = known & (depth > NEAR_CELLS) & (squared > NEAR_CELLS**2) & (np.abs(cosine) < SAME_SIDE_COSINE)
    stray = known & (depth > STRAY_CELLS) & (squared > STRAY_CELLS**2)
    agrees = known & found.same_side[0] & (squared <= tolerance_cells**2)
    some = surface.at(np.flatnonzero(agrees)).thinned(NUM_COMPARED)
    return _Look(
        num_walls=len(surface),
        num_known=int(np.count_nonzero(known)),
        num_opposite=int(np.count_nonzero(near & (cosine < -SAME_SIDE_COSINE))),
        lines=_effective_number(some),
        turning=_hold_on_rotation(some),
        crossing=_runs(surface.points[across]),
        stray=_runs(surface.points[stray]),
    )


def _cosine(found: Encounters, surface: Surface, pose: Poses) -> npt.NDArray[np.float32]:
    """(N,) cosine between each wall's normal and that of the wall it meets."""
    (facing,) = turned(rotations(pose[None]), surface.normals)
    cosine: npt.NDArray[np.float32] = (found.lines[0] * facing).sum(axis=0)
    return cosine


def _runs(points: Points) -> list[_Run]:
    """The connected runs of (N, 2) points; a gap of one cell connects."""
    if not len(points):
        return []
    cells = points.astype(np.int32)
    cells -= cells.min(axis=0) - 1
    image = np.zeros(cells.max(axis=0)[::-1] + 2, np.uint8)
    image[cells[:, 1], cells[:, 0]] = 1
    _, labels, boxes, _ = cv2.connectedComponentsWithStats(cv2.dilate(image, np.ones((3, 3), np.uint8)), connectivity=8)
    counts = np.bincount(labels[cells[:, 1], cells[:, 0]])[1:].tolist()
    # The dilated runs are wider by a cell on each side, and a run of one cell has no length.
    edges = boxes[1:, cv2.CC_STAT_WIDTH : cv2.CC_STAT_HEIGHT + 1] - 3
    return [_Run(cells, math.hypot(*edge)) for cells, edge in zip(counts, edges.tolist(), strict=True)]


def _effective_number(some: Surface) -> float:
    """How many different walls some cells belong to: 1 / the probability that two of them are of one wall.

    Source: the order-2 diversity of Leinster and Cobbold, Ecology 2012. Two cells are of one wall as far as they were
    seen from the same side and lie on one line across their mean normal, give or take SAME_WALL_CELLS.
    """
    n = len(some)
    if n < 2:
        return float(n)
    # With p_ij = points_i . normals_j, (point_i - point_j) . (normal_i + normal_j) = p_ii - p_jj + p_ij - p_ji.
    projections = (some.points - some.points.mean(axis=0)) @ some.normals.T
    own = projections.diagonal()
    across = projections - projections.T + (own[:, None] - own)
    across *= across
    squared_length = 2.0 + 2.0 * (some.normals @ some.normals.T)  # of the sum of two unit vectors
    across /= np.maximum(squared_length, np.float32(1e-6))
    across *= np.float32(-0.5 / SAME_WALL_CELLS**2)
    is_one = np.exp(across, out=across)
    is_one *= squared_length > 2.0 + 2.0 * SAME_SIDE_COSINE
    return n * (n - 1) / max(float(is_one.sum()) - n, 1e-6)


def _hold_on_rotation(some: Surface) -> float:
    if len(some) < 3:
        return 0.0
    arms = some.points - some.points.mean(axis=0)
    J = np.concatenate([some.normals, (arms[:, 0] * some.normals[:, 1] - arms[:, 1] * some.normals[:, 0])[:, None]], 1)
    information = (J.T @ J).astype(np.float64)
    along = information[:2, 2]
    left = information[2, 2] - along @ np.linalg.solve(information[:2, :2] + 1e-3 * np.eye(2), along)
    return float(left / max(float(np.square(arms).sum()), 1e-6))
