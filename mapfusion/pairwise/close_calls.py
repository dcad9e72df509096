"""Close calls are asked again, of the same maps in turned rows and columns.

A map's cells cut its walls at random, and a search and the limits of a verdict make much of little. Quarter turns
change no cell, but what is made of them: of several verdicts on one pair those decide that agree, or, where all find
the same, how sure they are in the mean.
Source: Breiman, Bagging predictors, Machine Learning 1996: a vote steadies a decision that jumps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from mapfusion.grid import quarter_turned
from mapfusion.pairwise.confidence import logistic
from mapfusion.pairwise.poses import Poses, between_corners, centre_moved, differ
from mapfusion.pairwise.prepared import PreparedMap, prepare
from mapfusion.pairwise.repeats import REPEATS_FIGURES
from mapfusion.pairwise.rough import SAME_CELLS
from mapfusion.pairwise.search import DISTINCT_DEGREES, distinct_cells
from mapfusion.pairwise.verdict import REFUSED_CONFIDENCE, lacks_only_confidence
from mapfusion.result import PairFusion

NUM_VERDICTS = 4
"""One for each quarter turn."""
MIN_AGREEING, MIN_AGREEING_IN_DOUBT = 2, 3
"""So many must accept the same, or one where the mean suffices; the second where one of them found a rival or repeats,
that most walls recur, or that the rotation is left open: a wrong alignment is accepted nearly as steadily as a right
one there."""
CLOSE_GATES = ("ambiguous", "chance", "confidence", "parts", "repeats")
"""Gates whose figures change as maps are turned."""
SURE_ALONE, LEAST_HOPE = 0.99, 0.5
"""Joins with less confidence than the first, and refusals with at least the second, are close calls."""
MOST_RECURRING = 0.5
"""Where more of the walls that agree recur within one of the maps, an alignment leans on what repeats itself."""
MAX_TURN_DEVIATION_DEG = 1.1
"""Standard deviation of the rotation from which on it is left open: small maps of places that changed may be joined two
to five degrees off."""
SAME_DEGREES = 1.0
"""Where the rotation is left open, and where the mean decides, alignments further apart are not the same."""
MIN_MEAN_CONFIDENCE = 0.7
"""Mean from which on one acceptance is enough where all verdicts find the same: four together say more than each."""


def is_close_call(verdict: PairFusion) -> bool:
    """Whether a verdict might as well have been the other one."""
    if verdict.accepted:
        return verdict.confidence < SURE_ALONE or _repeats_itself(verdict) or _leaves_rotation_open(verdict)
    return verdict.confidence >= LEAST_HOPE and verdict.gate in CLOSE_GATES


def asked_again(
    first: PairFusion,
    target: PreparedMap,
    source: PreparedMap,
    fuse: Callable[[PreparedMap, PreparedMap], PairFusion],
) -> PairFusion:
    """The verdict of the vote on two maps: one of those that accept, or a refusal that says why.

    Its evidence names how many `verdicts` there were and how many were `agreeing`, and what any of them found of
    repeats.

    Args:
        first: The verdict on the maps as they are.
        target: Map into whose frame the source is to be brought.
        source: The other map.
        fuse: Gives the verdict on two maps.
    """
    verdicts = [first]
    chosen, agreeing = _vote(verdicts, target, source)
    while _is_open(verdicts, agreeing, target, source):
        verdicts.append(fuse(*(_turned(one, len(verdicts)) for one in (target, source))))
        chosen, agreeing = _vote(verdicts, target, source)
    if agreeing < _least_agreeing(verdicts):
        if agreeing and _mean_may_suffice(verdicts, target, source):
            chosen = replace(chosen, confidence=logistic(_summed_log_odds(verdicts) / NUM_VERDICTS))
        else:
            chosen = _refused(verdicts, agreeing, target, source)
    counts = {"verdicts": float(len(verdicts)), "agreeing": float(agreeing)}
    own = {name: value for name, value in chosen.evidence.items() if name not in REPEATS_FIGURES}
    return replace(chosen, evidence={**own, **_most_repeating(verdicts), **counts})


def _is_open(verdicts: Sequence[PairFusion], agreeing: int, target: PreparedMap, source: PreparedMap) -> bool:
    """Whether the vote is not decided yet, and another verdict may decide it."""
    num_left, least = NUM_VERDICTS - len(verdicts), _least_agreeing(verdicts)
    if agreeing >= least or not num_left:
        return False
    return agreeing + num_left >= least or _mean_may_suffice(verdicts, target, source)


def _mean_may_suffice(verdicts: Sequence[PairFusion], target: PreparedMap, source: PreparedMap) -> bool:
    """Whether all verdicts find the same, none refuses it but for its confidence, and the mean of that may suffice.

    Verdicts that were not asked yet are taken for as sure as any. Where most walls recur the mean tells nothing: a like
    part of the place is found again however the maps are turned.
    """
    if any(_repeats_itself(one) or not (one.accepted or lacks_only_confidence(one)) for one in verdicts):
        return False
    if _apart(verdicts, target, source, SAME_CELLS, SAME_DEGREES).any():
        return False
    most = _summed_log_odds(verdicts) + (NUM_VERDICTS - len(verdicts)) * _log_odds(SURE_ALONE)
    return most >= NUM_VERDICTS * _log_odds(MIN_MEAN_CONFIDENCE)


def _summed_log_odds(verdicts: Sequence[PairFusion]) -> float:
    return sum(_log_odds(one.evidence["ungated_confidence"]) for one in verdicts)


def _log_odds(confidence: float) -> float:
    """Of a confidence, held to where one verdict alone is sure, one way or the other: none decides a mean alone."""
    held = min(max(confidence, 1.0 - SURE_ALONE), SURE_ALONE)
    return math.log(held / (1.0 - held))


def _apart(
    verdicts: Sequence[PairFusion], target: PreparedMap, source: PreparedMap, cells: float, degrees: float
) -> npt.NDArray[np.bool_]:
    """(V, V) which of V verdicts are about different alignments."""
    poses = np.array([_pose(one, target, source) for one in verdicts])
    return differ(poses, poses, source.centre, cells, degrees)


def _turned(one: PreparedMap, quarters: int) -> PreparedMap:
    return prepare(quarter_turned(one.grid, quarters), one.grid.resolution_m)


def _vote(verdicts: Sequence[PairFusion], target: PreparedMap, source: PreparedMap) -> tuple[PairFusion, int]:
    """One of the accepting verdicts with which most of them agree, and how many these are; else the first verdict.

    Of two it is the surer one, of more the one in the middle of them.
    """
    accepting = [one for one in verdicts if one.accepted]
    if not accepting:
        return verdicts[0], 0
    degrees = SAME_DEGREES if any(map(_leaves_rotation_open, verdicts)) else DISTINCT_DEGREES
    agreeing = np.count_nonzero(~_apart(accepting, target, source, distinct_cells(target, source), degrees), axis=1)
    most = int(agreeing.max())
    chosen = np.flatnonzero(agreeing == most)
    if most > MIN_AGREEING:
        poses = np.array([_pose(accepting[k], target, source) for k in chosen])
        return accepting[chosen[_in_the_middle(poses, source)]], most
    return max((accepting[k] for k in chosen), key=lambda one: one.confidence), most


def _in_the_middle(poses: Poses, source: PreparedMap) -> int:
    """Which of the poses (K, 3) moves the source, to its edge, the least from where the others have it."""
    at, radius = centre_moved(poses, source.centre), math.hypot(*source.grid.cells.shape) / 2.0
    apart = np.linalg.norm(at[:, None] - at, axis=-1)
    turned = np.abs(np.angle(np.exp(1j * (poses[:, None, 2] - poses[:, 2]))))
    return int((apart + radius * turned).sum(axis=1).argmin())


def _pose(verdict: PairFusion, target: PreparedMap, source: PreparedMap) -> Poses:
    assert verdict.T_target_source is not None
    return between_corners(verdict.T_target_source, target.grid, source.grid)


def _least_agreeing(verdicts: Sequence[PairFusion]) -> int:
    is_doubted = any(
        one.gate in ("ambiguous", "repeats") or _repeats_itself(one) or _leaves_rotation_open(one) for one in verdicts
    )
    return MIN_AGREEING_IN_DOUBT if is_doubted else MIN_AGREEING


def _repeats_itself(verdict: PairFusion) -> bool:
    return verdict.evidence.get("recurring", 0.0) > MOST_RECURRING


def _most_repeating(verdicts: Sequence[PairFusion]) -> Mapping[str, float]:
    """What was found of repeats by the one that found most of them."""
    most = max(verdicts, key=lambda one: one.evidence.get("recurring", -1.0))
    return {name: most.evidence[name] for name in REPEATS_FIGURES if name in most.evidence}


def _leaves_rotation_open(verdict: PairFusion) -> bool:
    """Whether a verdict accepts what walls hold too loosely."""
    if not verdict.accepted or verdict.covariance is None:
        return False
    return math.degrees(math.sqrt(verdict.covariance[2, 2])) > MAX_TURN_DEVIATION_DEG


def _refused(verdicts: Sequence[PairFusion], agreeing: int, target: PreparedMap, source: PreparedMap) -> PairFusion:
    """The first verdict, refused for what the others say."""
    first, *others = verdicts
    if not first.accepted:
        return first
    refusal = next((one for one in others if not one.accepted), None)
    reason = (
        f"accepted as the maps are, but of {len(verdicts)} verdicts on these and on the same maps turned by quarters "
        f"only {agreeing} accept the same, and {_least_agreeing(verdicts)} must, or one where all find the same and "
        "are sure enough in the mean; turned: "
    )
    if refusal is not None:
        gate, reason, rival = refusal.gate, reason + refusal.reason, refusal.rival
    else:
        apart = _apart(verdicts, target, source, distinct_cells(target, source), SAME_DEGREES)[0]
        gate, reason = "ambiguous", reason + "a different alignment is accepted"
        rival = verdicts[int(apart.argmax())].T_target_source
    confidence = min(first.confidence, REFUSED_CONFIDENCE)
    return replace(first, accepted=False, gate=gate, reason=reason, confidence=confidence, rival=rival)
