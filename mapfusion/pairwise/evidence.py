"""How far the agreement of two maps lies above what chance would give.

For a tolerance, n points of one map's walls fall into the area that the other map knows, a share r of them within
the tolerance of a wall seen from the same side; a point put there at random would meet one with probability p.
The evidence of this direction is n KL(r || p) / c, with c the length over which neighbouring wall cells are not
independent (Chernoff's bound on the tail of the binomial distribution). Both directions must speak for a pose: their
geometric mean counts. Walls that stand in the other map's free space speak against it: with x times as many as by
chance, (1 - x)^2 of the evidence is left.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from mapfusion.compiled import compiled
from mapfusion.pairwise.poses import Poses, inverse
from mapfusion.pairwise.prepared import PreparedMap
from mapfusion.pairwise.refine import SAME_SIDE_COSINE, cells_below, encounters
from mapfusion.pairwise.surface import DIRECTION_BINS, NOT_KNOWN, Bytes, Floats, Indices, Points

TOLERANCES_CELLS = (1.5, 3.0, 6.0)
DEPENDENT_CELLS = 12.0
"""Length of wall over which neighbouring cells agree or disagree together, an estimate."""
MIN_EVIDENCE = 15.0
"""Net evidence below which agreement is no better than what a search finds between any two maps."""
DEEP_TOLERANCES = 2.0
"""A wall this many tolerances inside the other map's free space contradicts it."""
MIN_DEEP_CHANCE = 0.2
"""Where hardly any free space is wide enough to be deep, contradictions are counted against this share."""
_BIN_ANGLES = np.arange(DIRECTION_BINS) * (2.0 * np.pi / DIRECTION_BINS)
FACING_ALIKE = (np.cos(_BIN_ANGLES[:, None] - _BIN_ANGLES) > SAME_SIDE_COSINE - 1e-6).astype(np.float64)
"""Which bins of direction count as the same side."""
Figures = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What speaks for and against each of K poses; arrays are (K,).

    Attributes:
        net: Evidence against chance of both directions, less what contradicts; at the tolerance where it is highest.
        tolerance_cells: The tolerance.
        ratio: Share of the walls in the mutual area that agree.
        chance: Share that would agree by chance.
        contradiction: Walls deep in the other map's free space / those that would be by chance.
        num_walls: Wall cells in the mutual area, of both maps.
        mutual_cells: Cells known in both.
        mutual_ratio: The same / known cells of the smaller map.
        conditioning: Smallest / largest eigenvalue of what the agreeing walls say about the translation, [0, 1].
        residual_cells: Root mean square distance of the agreeing points from their walls, cells.
    """

    net: Figures
    tolerance_cells: Figures
    ratio: Figures
    chance: Figures
    contradiction: Figures
    num_walls: Figures
    mutual_cells: Figures
    mutual_ratio: Figures
    conditioning: Figures
    residual_cells: Figures

    def of(self, index: int) -> dict[str, float]:
        """The figures of one pose by name."""
        return {f.name: float(getattr(self, f.name)[index]) for f in fields(self)}

    def joined(self, other: Evidence) -> Evidence:
        """This evidence followed by that for other poses."""
        return Evidence(*(np.concatenate([getattr(self, f.name), getattr(other, f.name)]) for f in fields(self)))


def weigh(target: PreparedMap, source: PreparedMap, poses: Poses, num_points: int) -> Evidence:
    """The evidence for poses (K, 3) of `source` in `target`; both need a surface."""
    forward = _direction(target, source, poses, num_points)
    backward = _direction(source, target, inverse(poses), num_points)
    num_known = min(len(m.area) * m.cells_per_area_sample for m in (target, source))
    return Evidence(*_weighed(forward, backward, num_known))


def against_chance(n: Figures, agreeing: Figures, chance: float) -> Figures:
    """(K,) evidence of `agreeing` (K,) of `n` (K,): n KL(agreeing / n || chance) / DEPENDENT_CELLS, 0 up to chance."""
    return _each_against_chance(n, agreeing, chance)


def discounted(evidence: Figures, contradiction: Figures) -> Figures:
    """What contradictions leave of the evidence; none where there are as many as by chance."""
    result: Figures = evidence * np.square(np.maximum(1.0 - contradiction, 0.0))
    return result


class _Direction(NamedTuple):
    """One direction, (K,) or (K, T) for T tolerances: what the points of one map meet in the field of the other.

    Attributes:
        n: Wall cells in the mutual area.
        agreeing: (K, T) of them agree.
        chance: (K, T) share of them that would by chance.
        deep: (K, T) of them stand deep in free space.
        deep_chance: (K, T) share of them that would by chance.
        mutual: Cells known in both.
        squares: Sum of the squared gaps of the points that agree within the widest tolerance.
        scatter: (K, 3) sums of x^2, x y, y^2 over the normals of the walls that agree within the middle one.
    """

    n: Figures
    agreeing: Figures
    chance: Figures
    deep: Figures
    deep_chance: Figures
    mutual: Figures
    squares: Figures
    scatter: Figures


def _direction(there: PreparedMap, here: PreparedMap, poses: Poses, num_points: int) -> _Direction:
    """What the walls of `here` meet in `there` under poses (K, 3)."""
    assert there.field is not None
    assert here.field is not None
    field, surface = there.field, here.field.surface.thinned(num_points)
    found = encounters(field, surface, poses)
    walls = _counted_walls(
        field.depth.ravel(),
        NOT_KNOWN,
        found.cells,
        found.same_side,
        found.squared,
        found.gap,
        found.lines,
        surface.facing,
        DIRECTION_BINS,
        poses,
    )
    area = _counted_area(
        field.depth.ravel(),
        NOT_KNOWN,
        field.nearest.ravel(),
        field.walls,
        there.facing_bins,
        DIRECTION_BINS,
        cells_below(field, here.area, poses),
        here.area,
        poses,
    )
    cells_per_wall = len(here.field.surface) / len(surface)
    return _Direction(*_scaled(walls, area, FACING_ALIKE, cells_per_wall, here.cells_per_area_sample))


_Walls = tuple[Figures, Figures, Figures, Figures, Figures, Figures]
_Area = tuple[Figures, Figures, Figures, Figures]


@compiled
def _counted_walls(
    depth: Bytes,
    not_known: int,
    cells: Indices,
    same_side: npt.NDArray[np.bool_],
    squared: Floats,
    gap: Floats,
    lines: Floats,
    facing: Floats,
    num_bins: int,
    poses: Poses,
) -> _Walls:
    """Counts what N walls meet under K poses, at T tolerances.

    Args:
        depth: Of a field's cells.
        not_known: Depth of a cell that is not known.
        cells: (K, N) those below the walls, as the next four from Encounters.
        same_side: (K, N).
        squared: (K, N).
        gap: (K, N).
        lines: (K, N, 2).
        facing: (N,) direction of each wall, in bins.
        num_bins: Bins of a whole turn.
        poses: (K, 3).

    Returns:
        (K,) walls in the area that is known; (K, T) of them agree; (K, T) of them stand deep in free space;
        (K, num_bins) directions that they face; `squares` and `scatter` as in _Direction.
    """
    num_poses, num_tolerances = len(poses), len(TOLERANCES_CELLS)
    known, squares, scatter = np.zeros(num_poses), np.zeros(num_poses), np.zeros((num_poses, 3))
    agreeing, deep = np.zeros((num_poses, num_tolerances)), np.zeros((num_poses, num_tolerances))
    bins = np.zeros((num_poses, num_bins))
    nears, deeps = np.empty(num_tolerances + 1), np.empty(num_tolerances + 1)
    for k in range(num_poses):
        turn = poses[k, 2] * num_bins / (2.0 * math.pi) + 0.5
        turn -= num_bins * math.floor(turn / num_bins) - num_bins
        nears[:], deeps[:], xx, xy, yy, gaps = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(len(facing)):
            depth_cells = depth[cells[k, i]]
            if depth_cells == not_known:
                continue
            known[k] += 1.0
            bins[k, int(facing[i] + turn) % num_bins] += 1.0
            deeps[_num_deep(depth_cells, squared[k, i])] += 1.0
            if not same_side[k, i]:
                continue
            level = _least_tolerance(squared[k, i])
            nears[level] += 1.0
            if level < num_tolerances:
                gaps += gap[k, i] ** 2
            if level <= 1:
                nx, ny = lines[k, i, 0], lines[k, i, 1]
                xx += nx * nx
                xy += nx * ny
                yy += ny * ny
        _accumulate(nears, deeps, agreeing[k], deep[k])
        squares[k], scatter[k, 0], scatter[k, 1], scatter[k, 2] = gaps, xx, xy, yy
    return known, agreeing, deep, bins, squares, scatter


@compiled
def _counted_area(
    depth: Bytes,
    not_known: int,
    nearest: Indices,
    walls: Floats,
    facing_bins: Indices,
    num_bins: int,
    cells: Indices,
    area: Points,
    poses: Poses,
) -> _Area:
    """Counts what A points of a map's area meet under K poses: what walls would meet that stand there at random.

    Args:
        depth: Of a field's cells.
        not_known: Depth of a cell that is not known.
        nearest: Index of the wall that is nearest to each of the field's cells.
        walls: (N, 4) of the field.
        facing_bins: (N,) direction that each of these faces, as a whole bin.
        num_bins: Bins of a whole turn.
        cells: (K, A) those of the field below the points.
        area: (A, 2) the points, cells.
        poses: (K, 3).

    Returns:
        (K,) points in the area that is known; (K, T) of them are near a wall; (K, T) of them are deep in free space;
        (K, num_bins) directions of the walls that they are near to within the widest tolerance.
    """
    num_poses, num_tolerances = len(poses), len(TOLERANCES_CELLS)
    known, bins = np.zeros(num_poses), np.zeros((num_poses, num_bins))
    near, deep = np.zeros((num_poses, num_tolerances)), np.zeros((num_poses, num_tolerances))
    nears, deeps = np.empty(num_tolerances + 1), np.empty(num_tolerances + 1)
    for k in range(num_poses):
        x, y, c, s = poses[k, 0], poses[k, 1], math.cos(poses[k, 2]), math.sin(poses[k, 2])
        nears[:], deeps[:] = 0.0, 0.0
        for i in range(len(area)):
            depth_cells = depth[cells[k, i]]
            if depth_cells == not_known:
                continue
            known[k] += 1.0
            wall = nearest[cells[k, i]]
            dx = c * area[i, 0] - s * area[i, 1] + x - walls[wall, 0]
            dy = s * area[i, 0] + c * area[i, 1] + y - walls[wall, 1]
            squared = dx * dx + dy * dy
            level = _least_tolerance(squared)
            nears[level] += 1.0
            deeps[_num_deep(depth_cells, squared)] += 1.0
            if level < num_tolerances:
                bins[k, facing_bins[wall]] += 1.0
        _accumulate(nears, deeps, near[k], deep[k])
    return known, near, deep, bins


@compiled
def _least_tolerance(squared: float) -> int:
    """The first of the tolerances within which a wall is, by its squared distance; their number where none is."""
    level = 0
    for tolerance_cells in TOLERANCES_CELLS:
        level += squared > tolerance_cells**2
    return level


@compiled
def _num_deep(depth_cells: float, squared: float) -> int:
    """At how many tolerances a point contradicts the map: deep in its free space, and far from any wall."""
    number = 0
    for tolerance_cells in TOLERANCES_CELLS:
        far = DEEP_TOLERANCES * tolerance_cells
        number += (depth_cells > far) & (squared > far * far)
    return number


@compiled
def _accumulate(nears: Figures, deeps: Figures, near: Figures, deep: Figures) -> None:
    """From counts by _least_tolerance and by _num_deep (T + 1,) to counts of what is near and deep (T,) at each."""
    number = 0.0
    for t in range(len(near)):
        number += nears[t]
        near[t] = number
    number = 0.0
    for t in range(len(deep) - 1, -1, -1):
        number += deeps[t + 1]
        deep[t] = number


@compiled
def _scaled(
    walls: _Walls, area: _Area, facing_alike: Figures, cells_per_wall: float, cells_per_area_sample: float
) -> tuple[Figures, Figures, Figures, Figures, Figures, Figures, Figures, Figures]:
    """The fields of a _Direction, from what was counted and how many cells each of what was counted stands for."""
    known, agreeing, deep, bins, squares, scatter = walls
    area_known, area_near, area_deep, area_bins = area
    chance, deep_chance = np.empty_like(agreeing), np.empty_like(agreeing)
    for k in range(len(known)):
        # Probability that a wall of the mutual area and the wall near a random cell of it face alike.
        alike = 0.0
        for one in range(bins.shape[1]):
            for other in range(bins.shape[1]):
                alike += facing_alike[one, other] * bins[k, one] * area_bins[k, other]
        alike /= max(bins[k].sum(), 1.0) * max(area_bins[k].sum(), 1.0)
        for t in range(chance.shape[1]):
            chance[k, t] = area_near[k, t] * alike / max(area_known[k], 1.0)
            deep_chance[k, t] = area_deep[k, t] / max(area_known[k], 1.0)
    return (
        known * cells_per_wall,
        agreeing * cells_per_wall,
        chance,
        deep * cells_per_wall,
        deep_chance,
        area_known * cells_per_area_sample,
        squares * cells_per_wall,
        scatter * cells_per_wall,
    )


@compiled
def _weighed(forward: _Direction, backward: _Direction, num_known: float) -> Figures:
    """The fields of Evidence (10, K); the map that knows fewer cells knows `num_known`."""
    num_poses, num_tolerances = forward.agreeing.shape
    figures = np.empty((10, num_poses))
    for k in range(num_poses):
        n = forward.n[k] + backward.n[k]
        share = forward.n[k] / max(n, 1.0)
        best, net, contradiction = 0, -1.0, 0.0
        for t in range(num_tolerances):
            there = _against_chance(forward.n[k], forward.agreeing[k, t], forward.chance[k, t])
            back = _against_chance(backward.n[k], backward.agreeing[k, t], backward.chance[k, t])
            deep_chance = forward.deep_chance[k, t] * share + backward.deep_chance[k, t] * (1.0 - share)
            deep = (forward.deep[k, t] + backward.deep[k, t]) / max(n, 1.0)
            contradicts = deep / max(deep_chance, MIN_DEEP_CHANCE)
            left = 2.0 * math.sqrt(there * back) * max(1.0 - contradicts, 0.0) ** 2
            if left > net:
                best, net, contradiction = t, left, contradicts
        agreeing = forward.agreeing[k] + backward.agreeing[k]
        mutual = (forward.mutual[k] + backward.mutual[k]) / 2.0
        # The backward normals are seen from the source; eigenvalues do not mind.
        (least, most), (least_back, most_back) = _eigenvalues(forward.scatter[k]), _eigenvalues(backward.scatter[k])
        figures[0, k] = net
        figures[1, k] = TOLERANCES_CELLS[best]
        figures[2, k] = agreeing[best] / max(n, 1.0)
        figures[3, k] = forward.chance[k, best] * share + backward.chance[k, best] * (1.0 - share)
        figures[4, k] = contradiction
        figures[5, k] = n
        figures[6, k] = mutual
        figures[7, k] = mutual / max(num_known, 1.0)
        figures[8, k] = max(least + least_back, 0.0) / max(most + most_back, 1e-9)
        figures[9, k] = math.sqrt((forward.squares[k] + backward.squares[k]) / max(agreeing[-1], 1.0))
    return figures


@compiled
def _eigenvalues(scatter: Figures) -> tuple[float, float]:
    """Of the symmetric matrix [[a, b], [b, c]], the smaller one first."""
    a, b, c = scatter
    middle, half = (a + c) / 2.0, math.sqrt(((a - c) / 2.0) ** 2 + b * b)
    return middle - half, middle + half


@compiled
def _against_chance(n: float, agreeing: float, chance: float) -> float:
    """As `against_chance`, of one pose."""
    n = max(n, 1.0)
    p = min(max(chance, 0.5 / n), 1.0 - 1e-3)
    r = min(max(agreeing / n, 1e-9), 1.0 - 1e-9)
    if r <= p:
        return 0.0
    divergence = r * math.log(r / p) + (1.0 - r) * math.log((1.0 - r) / (1.0 - p))
    return n * max(divergence, 0.0) / DEPENDENT_CELLS


@compiled
def _each_against_chance(n: Figures, agreeing: Figures, chance: float) -> Figures:
    evidence = np.empty(len(n))
    for k in range(len(n)):
        evidence[k] = _against_chance(n[k], agreeing[k], chance)
    return evidence
