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
from mapfusion.pairwise.refine import SAME_SIDE_COSINE
from mapfusion.pairwise.surface import FIELD_MARGIN, NOT_KNOWN, Bytes, Floats, Indices, Points, SurfaceField

NEAREST_CELLS, MIDDLE_CELLS, FARTHEST_CELLS = 2.0, 10.0, 20.0
"""How far behind a wall it is looked: beyond the thickness of a wall as maps draw it, in two strips, the first as deep
as a doorway, the second where a room or a corridor begins."""
STRAIGHT_COSINE = 0.8
"""Least cosine between the way back from a wall and its normal: what lies beside the end of a wall is not hidden."""
PROBE_CELLS, OWN_WALL_CELLS = 5.0, 6.0
"""Where the other robot came in behind a wall it saw the wall from there: the first behind it, on the way to a hidden
cell, the nearest wall of the other map is no farther than the second, and faces away."""
NUM_ASKED, ROW_STEP = 1500, 2
"""About so many cells of each map are looked at, spread evenly over every second row."""


@dataclass(frozen=True, slots=True, eq=False)
class Hidden:
    """Cells that a map's walls hide from it.

    Attributes:
        cells: (N, 2) float32, some of them, evenly spread.
        away_cells: (N,) float32, how far behind the wall each is.
        probes: (N, 2) float32, PROBE_CELLS behind the wall on the way to each.
        normals: (N, 2) float32, of the walls.
        cells_per_sample: How many of the map's each stands for.
    """

    cells: Points
    away_cells: Floats
    probes: Points
    normals: Points
    cells_per_sample: float


def hidden_cells(field: SurfaceField) -> Hidden:
    """The cells of a field from NEAREST_CELLS to FARTHEST_CELLS behind its walls of which its map knows nothing."""
    distance, depth = field.distance[::ROW_STEP], field.depth[::ROW_STEP]
    cells = np.flatnonzero((distance > NEAREST_CELLS) & (distance <= FARTHEST_CELLS) & (depth == NOT_KNOWN))
    some = np.ascontiguousarray(cells[:: max(1, len(cells) // NUM_ASKED)])
    points, away_cells, probes, normals = _behind_walls(some, field.nearest, field.walls, FIELD_MARGIN)
    return Hidden(points, away_cells, probes, normals, ROW_STEP * len(cells) / max(len(some), 1))


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
    there, back = _num_seen(source, of_target, inverse(pose[None])[0]), _num_seen(target, of_source, pose)
    walls = max(num_walls, 1.0)
    return SeenBehind(
        behind=(there[0] + back[0]) / (walls * (MIDDLE_CELLS - NEAREST_CELLS)),
        far_behind=(there[1] + back[1]) / (walls * (FARTHEST_CELLS - MIDDLE_CELLS)),
    )


def _num_seen(field: SurfaceField, hidden: Hidden, pose: Poses) -> tuple[float, float]:
    """How many hidden cells of another map a field has free, near walls and far, under the pose (3,) of that map."""
    near, far = _seen(
        field.nearest,
        field.walls,
        field.depth,
        FIELD_MARGIN,
        NOT_KNOWN,
        SAME_SIDE_COSINE,
        hidden.cells,
        hidden.away_cells,
        hidden.probes,
        hidden.normals,
        pose,
    )
    return near * hidden.cells_per_sample, far * hidden.cells_per_sample


@compiled
def _seen(
    nearest: Indices,
    walls: Floats,
    depth: Bytes,
    margin: int,
    not_known: int,
    same_side_cosine: float,
    cells: Points,
    away_cells: Floats,
    probes: Points,
    normals: Points,
    pose: Poses,
) -> tuple[int, int]:
    """How many of N hidden cells a field has free up to MIDDLE_CELLS behind walls, and how many beyond.

    Args:
        nearest: Of the field.
        walls: Of the field.
        depth: Of the field.
        margin: FIELD_MARGIN.
        not_known: Depth of a cell that is not known.
        same_side_cosine: From minus this on two walls face away from each other.
        cells: (N, 2) of the other map, as the next three in Hidden.
        away_cells: (N,).
        probes: (N, 2).
        normals: (N, 2).
        pose: (3,) of the other map in the field's.
    """
    height, width = nearest.shape
    x, y, c, s = pose[0] + margin, pose[1] + margin, math.cos(pose[2]), math.sin(pose[2])
    near, far = 0, 0
    for i in range(len(cells)):
        column, row = c * cells[i, 0] - s * cells[i, 1] + x, s * cells[i, 0] + c * cells[i, 1] + y
        if not (0.0 <= row < height and 0.0 <= column < width):
            continue
        free_cells = depth[int(row), int(column)]
        if free_cells == 0 or free_cells == not_known:
            continue
        # Its robot came in behind: the wall that it saw there faces away from the one that hides.
        column, row = c * probes[i, 0] - s * probes[i, 1] + x, s * probes[i, 0] + c * probes[i, 1] + y
        wall = nearest[int(min(max(row, 0.0), height - 1.0)), int(min(max(column, 0.0), width - 1.0))]
        dx, dy = column - margin - walls[wall, 0], row - margin - walls[wall, 1]
        facing_x, facing_y = c * normals[i, 0] - s * normals[i, 1], s * normals[i, 0] + c * normals[i, 1]
        cosine = facing_x * walls[wall, 2] + facing_y * walls[wall, 3]
        if cosine < -same_side_cosine and dx * dx + dy * dy <= OWN_WALL_CELLS**2:
            continue
        if away_cells[i] <= MIDDLE_CELLS:
            near += 1
        else:
            far += 1
    return near, far


@compiled
def _behind_walls(
    some: npt.NDArray[np.int64], nearest: Indices, walls: Floats, margin: int
) -> tuple[Points, Floats, Points, Points]:
    """Of some cells of every ROW_STEP-th row of a field, by flat index there, those behind walls, as in Hidden."""
    width = nearest.shape[1]
    cells, probes = np.empty((len(some), 2), np.float32), np.empty((len(some), 2), np.float32)
    normals, away = np.empty((len(some), 2), np.float32), np.empty(len(some), np.float32)
    number = 0
    for i in range(len(some)):
        row, column = ROW_STEP * (some[i] // width), some[i] % width
        wall = nearest[row, column]
        dx, dy = column + 0.5 - margin - walls[wall, 0], row + 0.5 - margin - walls[wall, 1]
        distance = math.hypot(dx, dy)
        if -(dx * walls[wall, 2] + dy * walls[wall, 3]) <= STRAIGHT_COSINE * distance:
            continue
        part = PROBE_CELLS / distance
        cells[number, 0], cells[number, 1] = walls[wall, 0] + dx, walls[wall, 1] + dy
        probes[number, 0], probes[number, 1] = walls[wall, 0] + part * dx, walls[wall, 1] + part * dy
        normals[number, 0], normals[number, 1] = walls[wall, 2], walls[wall, 3]
        away[number] = distance
        number += 1
    return cells[:number].copy(), away[:number].copy(), probes[:number].copy(), normals[:number].copy()
