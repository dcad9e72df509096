"""A closer look at a pose: how its walls agree, and what no right pose shows.

Evidence against chance counts cells. Places tell themselves apart by other things as well. Cells of one straight wall
agree together once the wall does, and any corner fits any other: it matters how many walls, each with its own direction
and offset, agree at once. Where a wall of one map crosses a passage of the other, one of the two is not there; bent
maps and moved furniture contradict each other as well, but along walls, not across. And a wall that lies on another
one, seen from the other side, is a neighbour's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from mapfusion.pairwise.poses import Poses, inverse
from mapfusion.pairwise.refine import SAME_SIDE_COSINE, Encounters, encounters
from mapfusion.pairwise.surface import NOT_KNOWN, Points, Surface, SurfaceField

NEAR_CELLS = 3.0
"""Walls within this meet; a wall deeper than this in free space stands in it."""
MIN_RUN_CELLS = 8
"""A shorter run of wall across free space may be noise."""
NUM_DIRECTIONS = 24
OFFSET_CELLS = 8.0
"""Walls count as one where their directions and their offsets fall into one bin."""


@dataclass(frozen=True, slots=True)
class Scrutiny:
    """What a closer look finds; shares are of the wall cells in the area known in both maps, in [0, 1].

    Attributes:
        lines: Effective number of walls that agree: (sum n)^2 / sum n^2 over walls of n agreeing cells, the mean of
            both directions. Source: the participation ratio (inverse Simpson index).
        agreement_weaker: Share that agrees within NEAR_CELLS, of the map for which it is less.
        opposite: Share that meets a wall seen from the other side.
        crossing_cells: Longest connected run of wall that crosses the other map's free space, cells.
        crossing: Share that belongs to such runs of at least MIN_RUN_CELLS.
        outside: Share of all wall cells that lie outside what the other map knows, of the map for which it is less.
    """

    lines: float
    agreement_weaker: float
    opposite: float
    crossing_cells: float
    crossing: float
    outside: float


def scrutinise(target: SurfaceField, source: SurfaceField, pose: Poses, tolerance_cells: float) -> Scrutiny:
    """Looks closely at `pose` (3,) of the source in the target; walls agree within `tolerance_cells`."""
    both = [
        _look(target, source.surface, pose, tolerance_cells),
        _look(source, target.surface, inverse(pose[None])[0], tolerance_cells),
    ]
    num_known = max(1, sum(one.num_known for one in both))
    runs = [run for one in both for run in one.crossing_runs]
    return Scrutiny(
        lines=sum(one.lines for one in both) / 2.0,
        agreement_weaker=min(one.num_near / max(1, one.num_known) for one in both),
        opposite=sum(one.num_opposite for one in both) / num_known,
        crossing_cells=float(max(runs, default=0)),
        crossing=sum(run for run in runs if run >= MIN_RUN_CELLS) / num_known,
        outside=min(1.0 - one.num_known / max(1, one.num_walls) for one in both),
    )


@dataclass(frozen=True, slots=True)
class _Look:
    """One direction: what the walls of one map meet in the other; numbers of cells."""

    num_walls: int
    num_known: int
    num_near: int
    num_opposite: int
    lines: float
    crossing_runs: list[int]


def _look(field: SurfaceField, surface: Surface, pose: Poses, tolerance_cells: float) -> _Look:
    found = encounters(field, surface, pose[None])
    depth = field.depth.ravel().take(found.cells[0])
    known = depth != NOT_KNOWN
    squared = found.squared[0]
    near = known & (squared <= NEAR_CELLS**2)
    cosine = _cosine(found, surface, pose)
    across = known & (depth > NEAR_CELLS) & (squared > NEAR_CELLS**2) & (np.abs(cosine) < SAME_SIDE_COSINE)
    agrees = known & found.same_side[0] & (squared <= tolerance_cells**2)
    return _Look(
        num_walls=len(surface),
        num_known=int(np.count_nonzero(known)),
        num_near=int(np.count_nonzero(near & found.same_side[0])),
        num_opposite=int(np.count_nonzero(near & (cosine < -SAME_SIDE_COSINE))),
        lines=_effective_number(surface.points[agrees], surface.normals[agrees]),
        crossing_runs=_runs(surface.points[across]),
    )


def _cosine(found: Encounters, surface: Surface, pose: Poses) -> npt.NDArray[np.float32]:
    """(N,) cosine between each wall's normal and that of the wall it meets."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    R = np.array([[c, -s], [s, c]], np.float32)
    cosine: npt.NDArray[np.float32] = (found.lines[0] * (R @ surface.normals.T)).sum(axis=0)
    return cosine


def _runs(points: Points) -> list[int]:
    """Cells of each connected run of (N, 2) points; a gap of one cell connects."""
    if not len(points):
        return []
    cells = points.astype(np.int32)
    cells -= cells.min(axis=0) - 1
    image = np.zeros(cells.max(axis=0)[::-1] + 2, np.uint8)
    image[cells[:, 1], cells[:, 0]] = 1
    _, labels = cv2.connectedComponents(cv2.dilate(image, np.ones((3, 3), np.uint8)), connectivity=8)
    counts: list[int] = np.bincount(labels[cells[:, 1], cells[:, 0]])[1:].tolist()
    return counts


def _effective_number(points: Points, normals: Points) -> float:
    step = 2.0 * math.pi / NUM_DIRECTIONS
    direction = np.round(np.arctan2(normals[:, 1], normals[:, 0]) / step).astype(np.int64) % NUM_DIRECTIONS
    offset = points[:, 0] * np.cos(direction * step) + points[:, 1] * np.sin(direction * step)
    wall = direction * 2**32 + np.round(offset / OFFSET_CELLS).astype(np.int64)
    _, cells = np.unique(wall, return_counts=True)
    return float(np.square(cells.sum()) / max(1.0, float(np.square(cells).sum())))
