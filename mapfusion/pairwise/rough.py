"""Many poses told apart by a rough score: cheap enough for hundreds of them, good enough to choose where to look."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mapfusion.pairwise.evidence import against_chance, discounted
from mapfusion.pairwise.poses import Poses, centre_moved, distinct, inverse, pose_from_centre
from mapfusion.pairwise.prepared import PreparedMap
from mapfusion.pairwise.refine import cells_below
from mapfusion.pairwise.sketch import AGREES, CONTRADICTS, summed_meetings

CHANCE = 0.1
"""Share of walls that agree by chance, about."""
SAME_CELLS = 6.0
SAME_DEGREES = 4.0


class Steps(NamedTuple):
    """Poses around a pose that are tried: a lattice.

    Attributes:
        cells: Distance between two, cells.
        degrees: Turn between two.
        num_points: Points of each map by which they are told apart.
    """

    cells: float
    degrees: float
    num_points: int


NUM_STEPS = 2
"""So many steps to each side, along both axes and in rotation."""
WIDE_STEPS = Steps(3.0, 2.0, 150)
TIGHT_STEPS = Steps(2.0, 1.5, 250)


@dataclass(frozen=True, slots=True, eq=False)
class Hypotheses:
    """Poses of the source in the target, and how likely each is, roughly.

    Attributes:
        poses: (K, 3), in cells.
        scores: (K,) rough score.
    """

    poses: Poses
    scores: Poses

    def __len__(self) -> int:
        return len(self.poses)

    def joined(self, other: Hypotheses) -> Hypotheses:
        """These followed by others."""
        return Hypotheses(*(np.concatenate(two) for two in ((self.poses, other.poses), (self.scores, other.scores))))


def scored(target: PreparedMap, source: PreparedMap, poses: Poses, num_points: int) -> Hypotheses:
    """The poses (K, 3) with their rough scores by about `num_points` of each map's points; both maps have walls."""
    return Hypotheses(poses, rough_score(target, source, poses, num_points))


def best_distinct(hypotheses: Hypotheses, centre: Poses, count: int) -> Poses:
    """The `count` best poses (K, 3), none of them within SAME_CELLS and SAME_DEGREES of a better one.

    `centre` (2,) is the source's point at which cells are compared.
    """
    poses = hypotheses.poses[np.argsort(-hypotheses.scores, kind="stable")]
    return poses[distinct(poses, centre, SAME_CELLS, SAME_DEGREES, count)]


def best_nearby(target: PreparedMap, source: PreparedMap, poses: Poses, steps: Steps) -> Poses:
    """For each of the poses (K, 3) the one with the best rough score on a lattice around it.

    Refining follows the nearest walls, and between many things the nearest is seldom the right one.
    """
    offsets = np.arange(-NUM_STEPS, NUM_STEPS + 1)
    lattice = np.stack(np.meshgrid(offsets, offsets, offsets, indexing="ij"), -1).reshape(-1, 3)
    lattice = lattice * np.array([steps.cells, steps.cells, math.radians(steps.degrees)])
    at = centre_moved(poses, source.centre)[:, None] + lattice[:, :2]
    theta = poses[:, 2, None] + lattice[:, 2]
    around = pose_from_centre(theta.ravel(), at.reshape(-1, 2), source.centre)
    best = rough_score(target, source, around, steps.num_points).reshape(theta.shape).argmax(axis=1)
    return np.asarray(around[np.arange(len(poses)) * len(lattice) + best], np.float64)


def rough_score(target: PreparedMap, source: PreparedMap, poses: Poses, num_points: int) -> Poses:
    """(K,) net evidence of both directions, roughly."""
    return _one_way(target, source, poses, num_points) + _one_way(source, target, inverse(poses), num_points)


def _one_way(target: PreparedMap, source: PreparedMap, poses: Poses, num_points: int) -> Poses:
    """(K,) net evidence of one direction, from few points, one tolerance and a fixed chance."""
    assert target.field is not None
    assert source.field is not None
    some = source.field.surface.thinned(num_points)
    met = summed_meetings(target.sketch, cells_below(target.field, some.points, poses), some.facing, poses[:, 2])
    n, agrees, contradicts = met % AGREES, met % CONTRADICTS // AGREES, met // CONTRADICTS
    evidence = against_chance(n.astype(np.float64), agrees.astype(np.float64), CHANCE)
    return discounted(evidence, contradicts / np.maximum(n, 1)) * (len(source.field.surface) / len(some))
