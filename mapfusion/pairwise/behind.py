"""What one map sees right behind the other's walls.

A wall hides what lies behind it, from every robot alike. Where the maps of one place lie right, what the one has seen
through an open door or a window the other has seen as well, or its robot came in there and saw the wall from behind.
Under a wrong pose doors, niches and side corridors of the one lie behind closed walls of the other, which knows nothing
there: cells known in both do not tell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from mapfusion.compiled import compiled
from mapfusion.pairwise.poses import Poses, inverse
from mapfusion.pairwise.refine import SAME_SIDE_COSINE, cells_below, encounters
from mapfusion.pairwise.surface import FIELD_MARGIN, NOT_KNOWN, Floats, Indices, Points, Surface, SurfaceField

NEAREST_CELLS, MIDDLE_CELLS, FARTHEST_CELLS = 2.0, 10.0, 20.0
"""How far behind a wall it is looked: beyond the thickness of a wall as maps draw it, in two strips, the first as deep
as a doorway, the second where a room or a corridor begins."""
STRAIGHT_COSINE = 0.8
"""Least cosine between the way back from a wall and its normal: what lies beside the end of a wall is not hidden."""
PROBE_CELLS, OWN_WALL_CELLS = 5.0, 6.0
"""Where the other robot came in behind a wall it saw the wall from there: the first behind it, on the way to a hidden
cell, the nearest wall of the other map is no farther than the second, and faces away."""
NUM_ASKED = 1500
"""About so many cells of each map are looked at, spread evenly."""


@dataclass(frozen=True, slots=True, eq=False)
class Hidden:
    """Cells that a map's walls hide from it.

    Attributes:
        cells: (N, 2) float32, some of them, evenly spread.
        away_cells: (N,) float32, how far behind the wall each is.
        probes: PROBE_CELLS behind the wall on the way to each, with the wall's normal.
        cells_per_sample: How many of the map's each stands for.
    """

    cells: Points
    away_cells: Floats
    probes: Surface
    cells_per_sample: float


def hidden_cells(field: SurfaceField) -> Hidden:
    """The cells of a field from NEAREST_CELLS to FARTHEST_CELLS behind its walls of which its map knows nothing."""
    is_near = (field.distance > NEAREST_CELLS) & (field.distance <= FARTHEST_CELLS)
    cells = np.flatnonzero(is_near & (field.depth == NOT_KNOWN))
    some = np.ascontiguousarray(cells[:: max(1, len(cells) // NUM_ASKED)])
    points, away_cells = _behind_walls(some, field.nearest, field.walls, FIELD_MARGIN)
    hidden = np.flatnonzero(away_cells > 0.0)
    points, away_cells = points.take(hidden, axis=0), away_cells.take(hidden)
    walls = field.nearest.ravel().take(some.take(hidden))
    surface = field.surface
    in_front = surface.points.take(walls, axis=0)
    probes = Surface(
        points=in_front + np.float32(PROBE_CELLS) * (points - in_front) / away_cells[:, None],
        normals=surface.normals.take(walls, axis=0),
        facing=surface.facing.take(walls),
    )
    return Hidden(points, away_cells, probes, len(cells) / max(len(some), 1))


class SeenBehind(NamedTuple):
    """Cells that one map hides and the other one has free, with no wall of its own between, summed over both maps.

    Attributes:
        behind: Right behind walls, from NEAREST_CELLS to MIDDLE_CELLS: their number / that of the cells in such a strip
            behind the walls in the area known in both.
        far_behind: The same from MIDDLE_CELLS to FARTHEST_CELLS.
    """

    behind: float
    far_behind: float


def seen_behind(
    target: SurfaceField,
    source: SurfaceField,
    hidden: tuple[Hidden, Hidden],
    pose: Poses,
    num_walls: float,
) -> SeenBehind:
    """What the maps see behind each other's walls; nothing where a map lies on itself.

    Args:
        target: Field of the target.
        source: Field of the source.
        hidden: What the target's walls hide and what the source's do.
        pose: (3,) of the source in the target, in cells.
        num_walls: Wall cells of both maps in the area known in both.
    """
    of_target, of_source = hidden
    there, back = _num_seen(source, of_target, inverse(pose[None])), _num_seen(target, of_source, pose[None])
    walls = max(num_walls, 1.0)
    return SeenBehind(
        behind=(there[0] + back[0]) / (walls * (MIDDLE_CELLS - NEAREST_CELLS)),
        far_behind=(there[1] + back[1]) / (walls * (FARTHEST_CELLS - MIDDLE_CELLS)),
    )


def _num_seen(field: SurfaceField, hidden: Hidden, poses: Poses) -> tuple[float, float]:
    """How many hidden cells of another map a field has free, near walls and far, under the pose (1, 3) of that map."""
    depth = field.depth.ravel().take(cells_below(field, hidden.cells, poses)[0])
    found = encounters(field, hidden.probes, poses)
    is_between = (found.cosine[0] < -SAME_SIDE_COSINE) & (found.squared[0] <= OWN_WALL_CELLS**2)
    is_seen = (depth != NOT_KNOWN) & (depth > 0) & ~is_between
    seen = int(np.count_nonzero(is_seen))
    near = int(np.count_nonzero(is_seen & (hidden.away_cells <= MIDDLE_CELLS)))
    return near * hidden.cells_per_sample, (seen - near) * hidden.cells_per_sample


@compiled
def _behind_walls(cells: npt.NDArray[np.int64], nearest: Indices, walls: Floats, margin: int) -> tuple[Points, Floats]:
    """Centres (N, 2) of a field's cells, by flat index, and how far behind the nearest wall (N,) each is, or 0."""
    width = nearest.shape[1]
    points, away = np.empty((len(cells), 2), np.float32), np.zeros(len(cells), np.float32)
    flat = nearest.ravel()
    for i in range(len(cells)):
        row, column = divmod(cells[i], width)
        points[i, 0], points[i, 1] = column + 0.5 - margin, row + 0.5 - margin
        wall = flat[cells[i]]
        dx, dy = points[i, 0] - walls[wall, 0], points[i, 1] - walls[wall, 1]
        distance = math.hypot(dx, dy)
        if -(dx * walls[wall, 2] + dy * walls[wall, 3]) > STRAIGHT_COSINE * distance:
            away[i] = distance
    return points, away
