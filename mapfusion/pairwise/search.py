"""From many hypotheses to the best pose and its rival: coarse ranking, refinement, evidence."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mapfusion.pairwise.behind import seen_behind
from mapfusion.pairwise.confidence import RIGID_TOLERANCE_CELLS, confidence_alone, margin, plausibility
from mapfusion.pairwise.correlation import STEP_DEGREES, correlate, likely_rotations
from mapfusion.pairwise.evidence import DEPENDENT_CELLS, MIN_EVIDENCE, Evidence, weigh
from mapfusion.pairwise.features import MANY_WALLS
from mapfusion.pairwise.firmness import firmness
from mapfusion.pairwise.keypoints import NEAR_INLIER_CELLS, keypoint_agreement, num_explained, squared_offsets
from mapfusion.pairwise.poses import Poses, differ, distinct, from_se2, to_se2
from mapfusion.pairwise.prepared import MIN_WALL_CELLS, PreparedMap
from mapfusion.pairwise.refine import refine
from mapfusion.pairwise.rough import (
    SAME_CELLS,
    SAME_DEGREES,
    TIGHT_STEPS,
    WIDE_STEPS,
    Hypotheses,
    best_distinct,
    best_nearby,
    scored,
)
from mapfusion.pairwise.scrutiny import scrutinise
from mapfusion.pairwise.surface import SurfaceField
from mapfusion.pairwise.voting import Matches, match, turns, vote

COARSE_POINTS = 250
FINE_POINTS = 400
WIDE_REACHES = (10.0, 10.0, 8.0, 6.0)
TIGHT_REACHES = (6.0, 5.0, 4.0, 4.0, 3.0, 3.0)
POLISH_REACHES = (4.0, 3.0, 3.0, 2.5, 2.5, 2.5)
POLISH_POINTS = 4000
SLIGHT_CELLS, SLIGHT_DEGREES = 0.5, 0.3
"""A pose that polishing moves less than this is the same pose."""
EVIDENCE_POINTS = 1000
DISTINCT_CELLS = 10.0
DISTINCT_SHARE = 0.04
DISTINCT_DEGREES = 10.0
REFINED_DEGREES = 3.0
SLIDING_CONDITIONING = 0.15
"""Walls that fix one direction less than this share of the other may let a pose slide."""
SLIDES_CELLS = (8.0, 12.0, 16.0, 20.0, 26.0, 32.0, 40.0, 50.0)
LARGE_CELLS = 400
"""A map with an edge this long is searched at coarser resolutions as well."""
PROMISING_EVIDENCE = 40.0
"""Rough evidence of a pose before it is refined from which on it is looked at before others are proposed. Of poses that
keypoints propose and that join their maps 97 % have as much, of the best poses of other pairs a quarter."""
WORTH_SHARE = 0.2
"""A pose with less than this share of the best one's evidence is not looked at more closely."""
MIN_RESIDUAL_CELLS = 0.3
"""Cells are no points: walls are not placed better than this."""
NUM_FIRST_LOOKS = 2
"""So many poses, those with the most evidence, say what may come of a pair."""


@dataclass(frozen=True, slots=True)
class Effort:
    """How much is spent on a search.

    Attributes:
        num_voted: How many poses are taken from the keypoints' votes.
        num_rotations: How many rotations of the walls as a whole are tried, the likely ones first.
        num_starts: How many poses are refined roughly; of maps with many walls up to half as many more.
        num_candidates: How many of them finely; as above.
        is_exhaustive: Whether every other one of the other rotations is tried as well, the poses around a pose are
            tried before it is refined, large maps are searched at coarser resolutions, and maps with many walls by more
            keypoints.
        num_scrutinised: How many poses are looked at closely.
    """

    num_voted: int
    num_rotations: int
    num_starts: int
    num_candidates: int
    is_exhaustive: bool
    num_scrutinised: int


GLANCE = Effort(
    num_voted=60,
    num_rotations=0,
    num_starts=12,
    num_candidates=4,
    is_exhaustive=False,
    num_scrutinised=3,
)
"""Keypoints alone."""
QUICK = Effort(
    num_voted=60,
    num_rotations=16,
    num_starts=24,
    num_candidates=8,
    is_exhaustive=False,
    num_scrutinised=5,
)
THOROUGH = Effort(
    num_voted=200,
    num_rotations=40,
    num_starts=32,
    num_candidates=16,
    is_exhaustive=True,
    num_scrutinised=10,
)


@dataclass(frozen=True, eq=False)
class Candidate:
    """One pose, looked at closely.

    Attributes:
        pose: (3,) of the source in the target, in cells.
        figures: Its evidence, what the closer look found and what keypoints say, by name; its firmness where parts were
            looked at, or 0 where that was not worth it.
    """

    pose: Poses
    figures: dict[str, float]

    @cached_property
    def plausibility(self) -> float:
        """By how much it is to be preferred to other poses of the pair, as a log-odds."""
        return plausibility(self.figures)


@dataclass(frozen=True, eq=False)
class Finding:
    """The best pose of the source in the target, and the distinctly different one that comes nearest to it.

    Attributes:
        best: The best pose.
        information: (3, 3) information matrix about the source's centre, in cells and radians, per wall cell.
        rival: The distinctly different pose that comes nearest to it; None where there is none, or none was looked for.
        is_searched: Whether other poses were looked for.
        is_hopeless: Whether the search ended early, its first looks leaving no hope: rivals were hardly looked for.
        num_matches: Keypoint matches used.
        num_inliers: Those that agree with the best pose.
        num_keypoints: Of the target and of the source; 0 where none were looked for.
    """

    best: Candidate
    information: Poses
    rival: Candidate | None = None
    is_searched: bool = False
    is_hopeless: bool = False
    num_matches: int = 0
    num_inliers: int = 0
    num_keypoints: tuple[int, int] = (0, 0)

    @cached_property
    def margin(self) -> float:
        """How clearly the best pose is to be preferred to its rival."""
        return margin(self.best.figures, None if self.rival is None else self.rival.figures)

    @property
    def covariance(self) -> Poses:
        """(3, 3) of where the source's centre lies, cells, and of the rotation, radians.

        The information matrix counts wall cells. Neighbouring ones err together, so DEPENDENT_CELLS of them count as
        one; and so do all of one wall where walls do not agree closely, as maps are bent or things were moved.
        """
        figures, cells_as_one = self.best.figures, DEPENDENT_CELLS
        if figures["tolerance_cells"] > RIGID_TOLERANCE_CELLS:
            num_agreeing = figures["ratio"] * figures["num_walls"]
            cells_as_one = max(DEPENDENT_CELLS, num_agreeing / max(figures["lines"], 1.0))
        variance = cells_as_one * max(figures["residual_cells"], MIN_RESIDUAL_CELLS) ** 2
        return np.asarray(variance * np.linalg.inv(self.information + 1e-3 * np.eye(3)), np.float64)


def propose(
    target: PreparedMap, source: PreparedMap, matches: Matches, effort: Effort = QUICK, before: Effort | None = None
) -> Hypotheses:
    """Hypotheses from features and from the maps as a whole, none that an effort `before` had from the same of these.

    Where a coarser resolution is searched, more rotations than a quick search has are left to it.
    """
    assert target.field is not None
    assert source.field is not None
    is_coarsened = effort.is_exhaustive and _can_be_coarsened(target, source)
    first = 0 if before is None else before.num_rotations
    last = QUICK.num_rotations if is_coarsened else effort.num_rotations
    proposed = [np.zeros((0, 3))]
    if before is None or before.num_voted < effort.num_voted:
        proposed.append(_voted(target, source, matches, effort, 0 if before is None else before.num_voted))
    if first < last:
        turns_rad = turns(target.features, source.features, matches)
        rotations = likely_rotations(target.field.surface, source.field.surface, turns_rad)
        tried = rotations[first:last]
        if effort.is_exhaustive and not is_coarsened:
            tried = np.concatenate([tried, _every_other(rotations[last:])])
        proposed.append(correlate(target.field, source.field, source.centre, tried))
    if is_coarsened:
        proposed.append(_found_coarsely(target, source, effort))
    return scored(target, source, np.concatenate(proposed), COARSE_POINTS)


def _voted(target: PreparedMap, source: PreparedMap, matches: Matches, effort: Effort, first: int) -> Poses:
    """The poses (K, 3) with the most votes from the `first` one on; of maps with many walls all, refined.

    In large maps a vote is off by more than what the rough score forgives.
    """
    more = _more_matches(target, source, effort)
    if more is None:
        return vote(target.features, source.features, matches, source.centre, effort.num_voted)[first:]
    voted = vote(target.more_features, source.more_features, more, source.centre, effort.num_voted)
    return _refined_widely(target, source, best_nearby(target, source, voted, WIDE_STEPS))


def _more_matches(target: PreparedMap, source: PreparedMap, effort: Effort) -> Matches | None:
    """Matches of the further keypoints that a thorough search takes of maps with many walls; None for other maps."""
    if not (effort.is_exhaustive and have_many_walls(target, source)):
        return None
    return match(target.more_features, source.more_features)


def _refined_widely(target: PreparedMap, source: PreparedMap, poses: Poses) -> Poses:
    assert target.field is not None
    assert source.field is not None
    return refine(target.field, source.field, poses, source.centre, WIDE_REACHES, COARSE_POINTS)[0]


def _every_other(rotations: Poses) -> Poses:
    """Those of some rotations (R,), in steps of STEP_DEGREES, that are even multiples of a step, radians."""
    return np.asarray(rotations[np.round(np.degrees(rotations) / STEP_DEGREES) % 2 == 0], np.float64)


def _can_be_coarsened(target: PreparedMap, source: PreparedMap) -> bool:
    """Whether maps are large, and have walls enough at twice the cell size."""
    return (
        _longest_edge(target, source) >= LARGE_CELLS
        and min(target.coarser.num_walls, source.coarser.num_walls) >= MIN_WALL_CELLS
    )


def have_many_walls(target: PreparedMap, source: PreparedMap) -> bool:
    """Whether one of the maps has walls for more keypoints than a quick search looks at."""
    return max(target.num_walls, source.num_walls) >= MANY_WALLS


def are_vast(target: PreparedMap, source: PreparedMap) -> bool:
    """Whether one of the maps is still large at twice the cell size: a quick search sees little of it."""
    return _longest_edge(target, source) >= 2 * LARGE_CELLS


def _longest_edge(target: PreparedMap, source: PreparedMap) -> int:
    """Of both maps, cells."""
    edges: tuple[int, ...] = (*target.grid.cells.shape, *source.grid.cells.shape)
    return max(edges)


def _found_coarsely(target: PreparedMap, source: PreparedMap, effort: Effort) -> Poses:
    """The best few poses (K, 3) of the same maps at twice the cell size.

    A search sees large maps as through a veil: its images have cells of half a metre, and by the step from one
    rotation to the next their far walls move by more than it looks for them.
    """
    coarse_target, coarse_source = target.coarser, source.coarser
    matches = match(coarse_target.features, coarse_source.features)
    hypotheses = propose(coarse_target, coarse_source, matches, effort)
    poses = refine_best(coarse_target, coarse_source, hypotheses, effort)
    refined = scored(coarse_target, coarse_source, poses, FINE_POINTS)
    likely = best_distinct(refined, coarse_source.centre, effort.num_scrutinised)
    resolution_m = target.grid.resolution_m
    at_target = target.grid.T_frame_grid.inverse() @ coarse_target.grid.T_frame_grid
    at_source = coarse_source.grid.T_frame_grid.inverse() @ source.grid.T_frame_grid
    found = [at_target @ to_se2(pose, 2.0 * resolution_m) @ at_source for pose in likely]
    return np.array([from_se2(T, resolution_m) for T in found])


def examine(
    target: PreparedMap,
    source: PreparedMap,
    hypotheses: Hypotheses,
    matches: Matches,
    effort: Effort = QUICK,
    least_outlook: float = 0.0,
) -> Finding:
    """The best of the hypotheses, refined, with its evidence and its rival.

    Where the first looks, at the poses with the most evidence, leave less confidence possible than `least_outlook`, the
    search ends there: what further looks, slides and a polish would change is not waited for.
    """
    shortlist = _Shortlist.of(target, source, hypotheses, matches, effort)
    candidates = shortlist.best(NUM_FIRST_LOOKS)
    is_hopeless = _outlook(candidates) < least_outlook
    if is_hopeless:
        found = _as_it_is(target, source, candidates[0])
    else:
        candidates = shortlist.with_slides().best(effort.num_scrutinised)
        found = with_firmness(recheck(target, source, candidates[0].pose, matches), target, source)
    apart = _apart_from(candidates[0], candidates, target, source)
    off = squared_offsets(target.features, source.features, matches, found.best.pose)
    return replace(
        found,
        rival=nearest(found.best, apart),
        is_searched=True,
        is_hopeless=is_hopeless,
        num_matches=len(matches),
        num_inliers=int(np.count_nonzero(off <= NEAR_INLIER_CELLS**2)),
        num_keypoints=(len(target.features), len(source.features)),
    )


def _outlook(candidates: list[Candidate]) -> float:
    """The confidence that the most hopeful of the candidates would have alone."""
    return max(confidence_alone(one.figures) for one in candidates)


def is_promising(hypotheses: Hypotheses) -> bool:
    """Whether the best of the hypotheses, as it is, may turn out to be what joins the maps."""
    return bool((hypotheses.scores >= PROMISING_EVIDENCE).any())


def are_alike(one: Finding, other: Finding, target: PreparedMap, source: PreparedMap) -> bool:
    """Whether two findings in the same maps are the same answer, give or take what large maps bend."""
    return not _apart_from(one.best, [other.best], target, source)


def with_rivals_of(finding: Finding, other: Finding, target: PreparedMap, source: PreparedMap) -> Finding:
    """The finding with the nearest rival that it or another search of the same maps found."""
    rivals = [one for one in (finding.rival, other.rival, other.best) if one is not None]
    return replace(finding, rival=nearest(finding.best, _apart_from(finding.best, rivals, target, source)))


def _apart_from(best: Candidate, others: list[Candidate], target: PreparedMap, source: PreparedMap) -> list[Candidate]:
    """Those of the others that are different answers."""
    poses, cells = np.array([one.pose for one in others]).reshape(-1, 3), distinct_cells(target, source)
    (apart,) = differ(best.pose[None], poses, source.centre, cells, DISTINCT_DEGREES)
    return [one for one, is_apart in zip(others, apart, strict=True) if is_apart]


def nearest(best: Candidate, rivals: list[Candidate]) -> Candidate | None:
    """The rival over which the margin is least; of equal ones the most plausible."""
    return min(rivals, key=lambda one: (margin(best.figures, one.figures), -one.plausibility), default=None)


def with_firmness(finding: Finding, target: PreparedMap, source: PreparedMap) -> Finding:
    """The finding with the firmness of its best pose among its figures; 0 where there is too little evidence."""
    best = finding.best
    is_worth = best.figures["net"] >= MIN_EVIDENCE
    figures = best.figures | {"firmness": firmness(target, source, best.pose) if is_worth else 0.0}
    return replace(finding, best=replace(best, figures=figures))


def refine_and_rank(
    target: PreparedMap, source: PreparedMap, hypotheses: Hypotheses, matches: Matches, effort: Effort = QUICK
) -> list[Candidate]:
    """The best few of the hypotheses, refined, none of them like another; the most plausible first."""
    shortlist = _Shortlist.of(target, source, hypotheses, matches, effort)
    return shortlist.with_slides().best(effort.num_scrutinised)


@dataclass(frozen=True, slots=True, eq=False)
class _Shortlist:
    """Refined poses and their evidence, and those of them that were looked at, by index."""

    target: PreparedMap
    source: PreparedMap
    matches: Matches
    poses: Poses
    evidence: Evidence
    looked_at: dict[int, Candidate]

    @classmethod
    def of(
        cls, target: PreparedMap, source: PreparedMap, hypotheses: Hypotheses, matches: Matches, effort: Effort
    ) -> _Shortlist:
        """The best few of the hypotheses."""
        poses = refine_best(target, source, hypotheses, effort)
        return cls(target, source, matches, poses, weigh(target, source, poses, EVIDENCE_POINTS), {})

    def with_slides(self) -> _Shortlist:
        """With the pose that has the most evidence moved along its walls, where they hold it in one direction only."""
        assert self.target.field is not None
        assert self.source.field is not None
        best = int(self.evidence.net.argmax())
        if self.evidence.conditioning[best] >= SLIDING_CONDITIONING:
            return self
        slid = _slid(self.target.field, self.source.field, self.poses[best], self.source.centre)
        evidence = self.evidence.joined(weigh(self.target, self.source, slid, EVIDENCE_POINTS))
        return replace(self, poses=np.concatenate([self.poses, slid]), evidence=evidence)

    def best(self, count: int) -> list[Candidate]:
        """Those with the most evidence, none of them like another, looked at closely; the most plausible first."""
        net = self.evidence.net
        order = np.argsort(-net, kind="stable")
        most = net[order[0]]
        rivals = order[net[order] >= WORTH_SHARE * most]
        count = count if most >= MIN_EVIDENCE else 1
        chosen = rivals[distinct(self.poses[rivals], self.source.centre, SAME_CELLS, REFINED_DEGREES, count)].tolist()
        for k in chosen:
            if k not in self.looked_at:
                self.looked_at[k] = look_closely(
                    self.target, self.source, self.poses[k], self.evidence, k, self.matches
                )
        return sorted((self.looked_at[k] for k in chosen), key=lambda one: -one.plausibility)


def refine_best(target: PreparedMap, source: PreparedMap, hypotheses: Hypotheses, effort: Effort) -> Poses:
    """The best few of the hypotheses, refined: the poses (K, 3) after the last step, then those of before it."""
    assert target.field is not None
    assert source.field is not None
    fields, centre = (target.field, source.field), source.centre
    more = _more_matches(target, source, effort)
    starts = _likely(target, source, hypotheses, more, effort.num_starts)
    if effort.is_exhaustive:
        starts = best_nearby(target, source, starts, WIDE_STEPS)
    refined = scored(target, source, _refined_widely(target, source, starts), FINE_POINTS)
    wide = _likely(target, source, refined, more, effort.num_candidates)
    if effort.is_exhaustive:
        wide = np.concatenate([wide, best_nearby(target, source, wide, TIGHT_STEPS)])
    tight, _ = refine(*fields, wide, centre, TIGHT_REACHES, FINE_POINTS)
    return np.concatenate([tight, wide])


def _likely(
    target: PreparedMap, source: PreparedMap, hypotheses: Hypotheses, more: Matches | None, count: int
) -> Poses:
    """The `count` best of the hypotheses, none like another, and half as many of those that explain most matches.

    Maps with many walls have long ones that lie well in many places, and little in common: the right pose has less
    evidence.
    """
    best = best_distinct(hypotheses, source.centre, count)
    if more is None:
        return best
    explained = num_explained(target.more_features, source.more_features, more, hypotheses.poses)
    some = explained > 0
    by_matches = Hypotheses(hypotheses.poses[some], explained[some].astype(np.float64))
    both = np.concatenate([best, best_distinct(by_matches, source.centre, count // 2)])
    return both[distinct(both, source.centre, SAME_CELLS, SAME_DEGREES, len(both))]


def _slid(target: SurfaceField, source: SurfaceField, pose: Poses, centre: Poses) -> Poses:
    """The pose (3,) moved along the direction in which its walls hold it least, both ways, and refined there (K, 3)."""
    (there,), (information,) = refine(target, source, pose[None], centre, TIGHT_REACHES, FINE_POINTS)
    along = np.linalg.eigh(information[:2, :2])[1][:, 0]
    steps = np.concatenate([SLIDES_CELLS, np.negative(SLIDES_CELLS)])
    slid = np.tile(there, (len(steps), 1))
    slid[:, :2] += steps[:, None] * along
    return refine(target, source, slid, centre, TIGHT_REACHES, FINE_POINTS)[0]


def recheck(target: PreparedMap, source: PreparedMap, pose: Poses, matches: Matches | None = None) -> Finding:
    """One pose (3,), refined with every point and weighed, whatever else might fit; without matches by its walls."""
    assert target.field is not None
    assert source.field is not None
    fields, centre = (target.field, source.field), source.centre
    poses, (information,) = refine(*fields, pose[None], centre, POLISH_REACHES, POLISH_POINTS)
    if differ(pose[None], poses, centre, SLIGHT_CELLS, SLIGHT_DEGREES).any():
        poses = np.concatenate([poses, pose[None]])
    evidence = weigh(target, source, poses, EVIDENCE_POINTS)
    # A bent map may fit better as it was found from afar than where its nearest walls draw it.
    best = 0 if evidence.net[0] >= 0.9 * evidence.net[-1] else 1
    if best == 1:
        _, (information,) = refine(*fields, pose[None], centre, POLISH_REACHES[-1:], POLISH_POINTS)
    return Finding(look_closely(target, source, poses[best], evidence, best, matches), information)


def _as_it_is(target: PreparedMap, source: PreparedMap, candidate: Candidate) -> Finding:
    """A candidate that is not worth a polish, with what its walls fix."""
    assert target.field is not None
    assert source.field is not None
    pose = candidate.pose[None]
    _, (information,) = refine(target.field, source.field, pose, source.centre, TIGHT_REACHES[-1:], FINE_POINTS)
    return Finding(candidate, information)


def look_closely(
    target: PreparedMap, source: PreparedMap, pose: Poses, evidence: Evidence, index: int, matches: Matches | None
) -> Candidate:
    assert target.field is not None
    assert source.field is not None
    figures = evidence.of(index)
    scrutiny = scrutinise(target.field, source.field, pose, figures["tolerance_cells"])
    figures |= scrutiny._asdict()
    hidden = target.hidden, source.hidden
    figures |= seen_behind(target.field, source.field, hidden, pose, figures["num_walls"])._asdict()
    if matches is not None:
        figures |= keypoint_agreement(target, source, pose, matches, figures["tolerance_cells"])._asdict()
    return Candidate(pose, figures)


def distinct_cells(target: PreparedMap, source: PreparedMap) -> float:
    """From how many cells on two poses are different answers: more for large maps, which bend."""
    diagonal = min(math.hypot(*m.grid.cells.shape) for m in (target, source))
    return max(DISTINCT_CELLS, DISTINCT_SHARE * diagonal)
