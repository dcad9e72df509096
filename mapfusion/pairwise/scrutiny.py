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
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from mapfusion.compiled import compiled
from mapfusion.pairwise.poses import Poses, inverse
from mapfusion.pairwise.refine import SAME_SIDE_COSINE, encounters
from mapfusion.pairwise.surface import NOT_KNOWN, Bytes, Floats, Points, Surface, SurfaceField

NEAR_CELLS = 3.0
"""Walls within this meet; a wall deeper than this in free space stands in it."""
STRAY_CELLS = 6.0
"""A wall this deep in free space, and this far from any wall, strays through it."""
MIN_RUN_CELLS = 8
"""A shorter run of wall across free space may be noise."""
NUM_COMPARED = 128
"""So many agreeing cells are compared with each other to count walls."""
SAME_WALL_CELLS, SAME_WALL_COSINE = 4.0, 0.5
"""Standard deviation of the offset of cells of one wall, and the cosine between normals of one."""
CONNECTED_CELLS = 3
"""Walls this far apart, in x and y, are one run: a gap of two cells connects."""


class Scrutiny(NamedTuple):
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
    both = (
        _look(target, source.surface, pose, tolerance_cells),
        _look(source, target.surface, inverse(pose[None])[0], tolerance_cells),
    )
    num_known = max(1, sum(one.num_known for one in both))
    return Scrutiny(
        lines=sum(one.lines for one in both) / 2.0,
        turning=sum(one.turning for one in both) / 2.0,
        opposite=sum(one.num_opposite for one in both) / num_known,
        crossing_cells=float(max(one.longest_crossing for one in both)),
        crossing=sum(one.num_crossing for one in both) / num_known,
        stray_cells=max(one.stray_cells for one in both),
        outside=min(1.0 - one.num_known / max(1, one.num_walls) for one in both),
    )


class _Look(NamedTuple):
    """One direction: what the walls of one map meet in the other; numbers of cells."""

    num_walls: int
    num_known: int
    num_opposite: int
    lines: float
    turning: float
    longest_crossing: int
    num_crossing: int
    stray_cells: float


def _look(field: SurfaceField, surface: Surface, pose: Poses, tolerance_cells: float) -> _Look:
    found = encounters(field, surface, pose[None])
    depth = field.depth.ravel().take(found.cells[0])
    figures = _looked_at(
        depth != NOT_KNOWN,
        depth,
        found.squared[0],
        found.cosine[0],
        SAME_SIDE_COSINE,
        tolerance_cells,
        surface.points,
        surface.normals,
    )
    return _Look(len(surface), *figures)


@compiled
def _looked_at(
    is_known: npt.NDArray[np.bool_],
    depth: Bytes,
    squared: Floats,
    cosine: Floats,
    same_side_cosine: float,
    tolerance_cells: float,
    points: Points,
    normals: Points,
) -> tuple[int, int, float, float, int, int, float]:
    """All of a _Look but the number of its walls; arrays are (N,) or (N, 2), the walls in row-major order.

    Args:
        is_known: Whether the field knows the cell below a wall.
        depth: Of that cell.
        squared: Squared distance to the wall that it meets, cells.
        cosine: Of the angle between both walls' normals.
        same_side_cosine: From which on both were seen from the same side.
        tolerance_cells: Within which walls agree.
        points: Of the walls.
        normals: Of the walls.
    """
    number = len(points)
    agreeing, across, stray = np.empty(number, np.int64), np.empty(number, np.int64), np.empty(number, np.int64)
    num_known, num_opposite, num_agreeing, num_across, num_stray = 0, 0, 0, 0, 0
    for i in range(number):
        if not is_known[i]:
            continue
        num_known += 1
        if squared[i] <= NEAR_CELLS**2:
            num_opposite += cosine[i] < -same_side_cosine
        elif depth[i] > NEAR_CELLS and abs(cosine[i]) < same_side_cosine:
            across[num_across] = i
            num_across += 1
        if squared[i] <= tolerance_cells**2 and cosine[i] > same_side_cosine:
            agreeing[num_agreeing] = i
            num_agreeing += 1
        if depth[i] > STRAY_CELLS and squared[i] > STRAY_CELLS**2:
            stray[num_stray] = i
            num_stray += 1
    num_some = min(num_agreeing, NUM_COMPARED)
    some = agreeing[np.arange(num_some) * (num_agreeing - 1) // max(num_some - 1, 1)]
    lines, turning = _effective_number(points, normals, some), _hold_on_rotation(points, normals, some)
    longest_crossing, num_crossing, stray_cells = 0, 0, 0.0
    for cells in _runs(points, across[:num_across])[0]:
        longest_crossing = max(longest_crossing, cells)
        if cells >= MIN_RUN_CELLS:
            num_crossing += cells
    for length in _runs(points, stray[:num_stray])[1]:
        stray_cells = max(stray_cells, length)
    return num_known, num_opposite, lines, turning, longest_crossing, num_crossing, stray_cells


@compiled
def _runs(points: Points, chosen: npt.NDArray[np.int64]) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    """The connected runs of the chosen points, which are in row-major order: those up to CONNECTED_CELLS apart.

    Returns:
        (R,) how many points each has, and (R,) the diagonal of the box around it, cells.
    """
    number = len(chosen)
    parent = np.arange(number)
    rows, columns = np.empty(number, np.int64), np.empty(number, np.int64)
    for i in range(number):
        rows[i], columns[i] = int(points[chosen[i], 1]), int(points[chosen[i], 0])
    # Of each row in reach, the first point that is not too far to the left: it moves on with the points.
    firsts = np.zeros(CONNECTED_CELLS + 1, np.int64)
    for i in range(number):
        for above in range(CONNECTED_CELLS + 1):
            row, left = rows[i] - above, columns[i] - CONNECTED_CELLS
            j = firsts[above]
            while j < i and (rows[j] < row or (rows[j] == row and columns[j] < left)):
                j += 1
            firsts[above] = j
            while j < i and rows[j] == row and columns[j] <= columns[i] + CONNECTED_CELLS:
                parent[_root(parent, j)] = _root(parent, i)
                j += 1
    counts = np.zeros(number, np.int64)
    low, high = np.full((number, 2), 1 << 30), np.zeros((number, 2), np.int64)
    for i in range(number):
        k = _root(parent, i)
        counts[k] += 1
        low[k, 0], low[k, 1] = min(low[k, 0], rows[i]), min(low[k, 1], columns[i])
        high[k, 0], high[k, 1] = max(high[k, 0], rows[i]), max(high[k, 1], columns[i])
    roots = np.flatnonzero(counts)
    lengths = np.empty(len(roots))
    for k in range(len(roots)):
        lengths[k] = math.hypot(high[roots[k], 0] - low[roots[k], 0], high[roots[k], 1] - low[roots[k], 1])
    return counts[roots], lengths


@compiled
def _root(parent: npt.NDArray[np.int64], i: int) -> int:
    """The one that stands for all that are connected with point `i`."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@compiled
def _effective_number(points: Points, normals: Points, some: npt.NDArray[np.int64]) -> float:
    """How many different walls some cells belong to: 1 / the probability that two of them are of one wall.

    Source: the order-2 diversity of Leinster and Cobbold, Ecology 2012. Two cells are of one wall as far as they were
    seen from the same side and lie on one line across their mean normal, give or take SAME_WALL_CELLS.
    """
    number, of_one = len(some), 0.0
    if number < 2:
        return float(number)
    for i in range(number):
        x, y, nx, ny = points[some[i], 0], points[some[i], 1], normals[some[i], 0], normals[some[i], 1]
        for j in range(i):
            other_nx, other_ny = normals[some[j], 0], normals[some[j], 1]
            cosine = nx * other_nx + ny * other_ny
            if cosine > SAME_WALL_COSINE:
                across = (x - points[some[j], 0]) * (nx + other_nx) + (y - points[some[j], 1]) * (ny + other_ny)
                of_one += math.exp(-0.5 * across * across / (2.0 + 2.0 * cosine) / SAME_WALL_CELLS**2)
    return number * (number - 1) / max(2.0 * of_one, 1e-6)


@compiled
def _hold_on_rotation(points: Points, normals: Points, some: npt.NDArray[np.int64]) -> float:
    """What cells fix of the rotation once the translation is free / their mean square distance from their middle."""
    number = len(some)
    if number < 3:
        return 0.0
    middle_x, middle_y = 0.0, 0.0
    for i in some:
        middle_x += points[i, 0] / number
        middle_y += points[i, 1] / number
    xx, xy, yy, xt, yt, tt, spread = 1e-3, 0.0, 1e-3, 0.0, 0.0, 0.0, 0.0
    for i in some:
        x, y, nx, ny = points[i, 0] - middle_x, points[i, 1] - middle_y, normals[i, 0], normals[i, 1]
        turning = x * ny - y * nx
        xx, xy, yy = xx + nx * nx, xy + nx * ny, yy + ny * ny
        xt, yt, tt = xt + nx * turning, yt + ny * turning, tt + turning * turning
        spread += x * x + y * y
    free = (yy * xt * xt - 2.0 * xy * xt * yt + xx * yt * yt) / (xx * yy - xy * xy)
    return (tt - free) / max(spread, 1e-6)
