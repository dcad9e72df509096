"""What repeats itself within one map: racks, bays, rooms of one size, two wings.

Of two maps alone no one can tell which of two like parts of a place they share. But each map can be asked whether it
has such parts: it is laid onto itself, some way off. Where walls recur so, that they agree with those of another map
says little, as their like would agree as well; where the other map lies is said by the walls that do not recur. And
from an alignment of two maps follow others, one for each of a map with itself, which a search of the two may have
missed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from mapfusion.pairwise.confidence import fit, fits_better
from mapfusion.pairwise.evidence import MIN_EVIDENCE, weigh
from mapfusion.pairwise.firmness import firmness
from mapfusion.pairwise.poses import Poses, after, differ, distinct, inverse
from mapfusion.pairwise.prepared import PreparedMap
from mapfusion.pairwise.refine import encounters, refine
from mapfusion.pairwise.rough import SAME_CELLS, best_distinct, scored
from mapfusion.pairwise.search import (
    COARSE_POINTS,
    DISTINCT_DEGREES,
    EVIDENCE_POINTS,
    FINE_POINTS,
    GLANCE,
    REFINED_DEGREES,
    TIGHT_REACHES,
    Candidate,
    Finding,
    distinct_cells,
    look_closely,
    nearest,
    refine_best,
)
from mapfusion.pairwise.surface import NOT_KNOWN, Indices
from mapfusion.pairwise.voting import Matches, match, vote

ON_ITSELF = replace(GLANCE, num_starts=24, num_candidates=12)
"""Keypoints alone: those of one map look like their repeats, noise or not."""
MIN_REPEATED = 70.0
"""Net evidence from which on a map that is laid onto itself repeats itself."""
MEETS_CELLS = 3.0
"""Walls this near a wall of their own map recur, and this near one of the other map agree."""
FEW_CELLS = 6.0
"""So many walls more that do not agree are reckoned with those that recur in neither map: a few are soon all."""
REPEATS_FIGURES = ("recurring", "rest_ratio", "like_fit", "firm_lead")
"""Figures by which a map is asked what repeats itself."""
NUM_SHIFTED = 8
"""So many alignments that follow from another one are looked at."""


@dataclass(frozen=True, slots=True, eq=False)
class Repeats:
    """What repeats itself within a map.

    Attributes:
        poses: (K, 3) of the map in itself under which it repeats itself, none of them near the identity, and then their
            inverses.
        recurs: (N,) which walls of its surface meet another wall under one of them.
    """

    poses: Poses
    recurs: npt.NDArray[np.bool_]


def repeats(one: PreparedMap) -> Repeats:
    """What repeats itself within a map that has walls."""
    matches = match(one.features, one.features)
    is_other = matches.target != matches.source
    matches = Matches(matches.target[is_other], matches.source[is_other])
    poses = _elsewhere(one, vote(one.features, one.features, matches, one.centre, ON_ITSELF.num_voted))
    if len(poses):
        poses = refine_best(one, one, scored(one, one, poses, COARSE_POINTS), ON_ITSELF)
        poses = _elsewhere(one, poses)
    if len(poses):
        net = weigh(one, one, poses, EVIDENCE_POINTS).net
        order = np.argsort(-net, kind="stable")
        order = order[net[order] >= MIN_REPEATED]
        poses = poses[order[distinct(poses[order], one.centre, SAME_CELLS, REFINED_DEGREES, len(order))]]
    poses = np.concatenate([poses, inverse(poses)])
    recurs = np.zeros(one.num_walls, np.bool_)
    for pose in poses:
        recurs |= _met(one, one, pose).agrees
    return Repeats(poses, recurs)


def weighed_against_repeats(finding: Finding, target: PreparedMap, source: PreparedMap, matches: Matches) -> Finding:
    """The finding with what recurs of its walls among its figures, and as its rival what follows and fits better.

    The finding's best pose must have its firmness among its figures. Those that come to them are:

    - `recurring`, the share of the agreeing walls that recur within their map;
    - `rest_ratio`, the share that agrees of the walls in the area known in both that recur in neither map, FEW_CELLS
      more reckoned with, of the map for which it is more;
    - `like_fit`, by how much the alignment that follows and fits best fits better than the best one, where one follows;
    - `firm_lead`, by how much more of the best one's parts stay than of its rival's or, where it has none, of those of
      the nearest one that follows; its own firmness where there is neither.
    """
    of_target, of_source = repeats(target), repeats(source)
    best = finding.best
    figures = best.figures | _what_recurs(target, source, best.pose, of_target, of_source)
    follow = np.concatenate([after(best.pose, of_source.poses), after(of_target.poses, best.pose)])
    followed = _followed(target, source, best, follow, matches)
    if followed:
        figures["like_fit"] = max(fit(one.figures) for one in followed) - fit(figures)
    better = [one for one in followed if fits_better(one.figures, figures)]
    rivals = better if finding.rival is None else [finding.rival, *better]
    rival = nearest(best, rivals)
    other = nearest(best, followed) if rival is None else rival
    figures["firm_lead"] = figures["firmness"] - (0.0 if other is None else firmness(target, source, other.pose))
    return replace(finding, best=replace(best, figures=figures), rival=rival)


def _elsewhere(one: PreparedMap, poses: Poses) -> Poses:
    """Those of the poses (K, 3) of a map in itself that take it elsewhere."""
    return _apart(poses, np.zeros(3), one, one)


def _apart(poses: Poses, pose: Poses, target: PreparedMap, source: PreparedMap) -> Poses:
    """Those of the poses (K, 3) that are different answers from one (3,)."""
    (apart,) = differ(pose[None], poses, source.centre, distinct_cells(target, source), DISTINCT_DEGREES)
    return np.asarray(poses[apart], np.float64)


class _Met(NamedTuple):
    """What the N walls of one map meet in another one, (N,).

    Attributes:
        known: Which of them the other map knows.
        agrees: Which of these meet a wall of it.
        walls: The nearest wall of it, by index.
    """

    known: npt.NDArray[np.bool_]
    agrees: npt.NDArray[np.bool_]
    walls: Indices


def _met(there: PreparedMap, here: PreparedMap, pose: Poses) -> _Met:
    """What the walls of `here` meet in `there` under a pose (3,)."""
    assert there.field is not None
    assert here.field is not None
    found = encounters(there.field, here.field.surface, pose[None])
    known = there.field.depth.ravel().take(found.cells[0]) != NOT_KNOWN
    agrees = known & found.same_side[0] & (found.squared[0] <= MEETS_CELLS**2)
    return _Met(known, agrees, there.field.nearest.ravel().take(found.cells[0]))


def _what_recurs(
    target: PreparedMap, source: PreparedMap, pose: Poses, of_target: Repeats, of_source: Repeats
) -> dict[str, float]:
    num_agreeing, num_recurring, rest_ratio = 0, 0, 0.0
    for there, here, move, others, own in (
        (target, source, pose, of_target.recurs, of_source.recurs),
        (source, target, inverse(pose[None])[0], of_source.recurs, of_target.recurs),
    ):
        met = _met(there, here, move)
        num_agreeing += int(np.count_nonzero(met.agrees))
        num_recurring += int(np.count_nonzero(met.agrees & own))
        # A wall that agrees with one that recurs may have its like where its own map does not show it.
        is_rest = met.known & ~own & ~(met.agrees & others.take(met.walls))
        num_rest = float(np.count_nonzero(is_rest)) + FEW_CELLS
        rest_ratio = max(rest_ratio, float(np.count_nonzero(is_rest & met.agrees)) / num_rest)
    return {"recurring": num_recurring / max(num_agreeing, 1), "rest_ratio": rest_ratio}


def _followed(
    target: PreparedMap, source: PreparedMap, best: Candidate, poses: Poses, matches: Matches
) -> list[Candidate]:
    """Those of the poses (K, 3) that have evidence and are others than the best one, refined and looked at closely."""
    assert target.field is not None
    assert source.field is not None
    poses = _apart(poses, best.pose, target, source)
    if not len(poses):
        return []
    starts = best_distinct(scored(target, source, poses, COARSE_POINTS), source.centre, NUM_SHIFTED)
    poses, _ = refine(target.field, source.field, starts, source.centre, TIGHT_REACHES, FINE_POINTS)
    poses = _apart(poses, best.pose, target, source)
    if not len(poses):
        return []
    evidence = weigh(target, source, poses, EVIDENCE_POINTS)
    followed = [
        look_closely(target, source, poses[k], evidence, int(k), matches)
        for k in np.flatnonzero(evidence.net >= MIN_EVIDENCE)
    ]
    return [replace(one, figures=one.figures | {"repeats": 1.0}) for one in followed]
