"""The default profile: many hypotheses, each weighed against both maps, and a verdict with its evidence."""

from __future__ import annotations

from mapfusion.config import FusionConfig
from mapfusion.pairwise import verdict
from mapfusion.pairwise.agreement import agreement
from mapfusion.pairwise.close_calls import asked_again, is_close_call
from mapfusion.pairwise.poses import between_corners, between_frames
from mapfusion.pairwise.prepared import PreparedMap, prepare
from mapfusion.pairwise.repeats import weighed_against_repeats
from mapfusion.pairwise.search import (
    GLANCE,
    QUICK,
    THOROUGH,
    Finding,
    are_alike,
    are_vast,
    examine,
    is_promising,
    propose,
    recheck,
    with_firmness,
    with_rivals_of,
)
from mapfusion.pairwise.voting import Matches, match
from mapfusion.result import PairFusion
from mapfusion.transform import SE2

__all__ = ["PreparedMap", "fuse", "prepare", "verify"]

SETTLED = 0.98
"""A join that a search is less sure of than this must stand against the rivals that a more thorough one finds."""
GLANCE_OUTLOOK, OUTLOOK = 0.9, 0.1
"""Least confidence that the first looks must leave possible for a glance, and for any other search, to go on. Where a
quick search ends so, a thorough one finds next to nothing, unless the maps are vast."""


def fuse(target: PreparedMap, source: PreparedMap, config: FusionConfig, is_thorough: bool = True) -> PairFusion:
    """Looks for the transform between two prepared maps, and judges it.

    Args:
        target: Map into whose frame the source is to be brought.
        source: The other map, prepared at the same resolution.
        config: Thresholds.
        is_thorough: Whether a thorough search follows where a quick one finds nothing to join by.

    Returns:
        The verdict with its evidence; of a close call that of a vote, see `close_calls`. Exchanging the maps gives the
        inverse: the work is done in one order, by content.
    """
    if target.key > source.key:
        return fuse(source, target, config, is_thorough).swapped()
    refusal = verdict.too_little(target, source)
    if refusal is not None:
        return refusal
    result = single_verdict(target, source, config, is_thorough)
    if not is_close_call(result):
        return result
    return asked_again(result, target, source, lambda one, other: single_verdict(one, other, config, is_thorough))


def single_verdict(target: PreparedMap, source: PreparedMap, config: FusionConfig, is_thorough: bool) -> PairFusion:
    """One verdict on two maps with walls, close call or not."""
    matches = match(target.features, source.features)
    found, result = _searched(target, source, config, matches, is_thorough)
    if not (result.accepted and verdict.may_repeat_itself(found)):
        return result
    return _judged(target, source, config, weighed_against_repeats(found, target, source, matches))


def _searched(
    target: PreparedMap, source: PreparedMap, config: FusionConfig, matches: Matches, is_thorough: bool
) -> tuple[Finding, PairFusion]:
    """What the searches find, each where the one before it found nothing sure, and the verdict on it."""
    proposed = propose(target, source, matches, GLANCE)
    if is_promising(proposed):
        found = examine(target, source, proposed, matches, GLANCE, GLANCE_OUTLOOK)
        if not found.is_hopeless:
            glance = _judged(target, source, config, found)
            if glance.accepted and glance.confidence >= SETTLED:
                return found, glance
    proposed = proposed.joined(propose(target, source, matches, QUICK, before=GLANCE))
    quickly = examine(target, source, proposed, matches, QUICK, 0.0 if are_vast(target, source) else OUTLOOK)
    quick = _judged(target, source, config, quickly)
    is_settled = quick.confidence >= SETTLED if quick.accepted else quickly.is_hopeless or not is_thorough
    if is_settled:
        return quickly, quick
    proposed = proposed.joined(propose(target, source, matches, THOROUGH, before=QUICK))
    # A join must stand against all rivals.
    thoroughly = examine(target, source, proposed, matches, THOROUGH, 0.0 if quick.accepted else OUTLOOK)
    if quick.accepted:
        found, other = quickly, thoroughly
        if are_alike(found, other, target, source) and other.best.plausibility > found.best.plausibility:
            found, other = other, found
        found = with_rivals_of(found, other, target, source)
        checked = _judged(target, source, config, found)
        if checked.accepted:
            return found, checked
    found = with_rivals_of(thoroughly, quickly, target, source)
    return found, _judged(target, source, config, found)


def verify(target: PreparedMap, source: PreparedMap, T_target_source: SE2, config: FusionConfig) -> PairFusion:
    """Refines and judges a transform that is known from before, without looking for another one.

    Whether a different one fits as well was settled when it was found: its margin is taken as
    verdict.KNOWN_MARGIN. Whether the parts stay is asked where the confidence may turn on it.
    """
    if target.key > source.key:
        return verify(source, target, T_target_source.inverse(), config).swapped()
    refusal = verdict.too_little(target, source)
    if refusal is not None:
        return refusal
    found = recheck(target, source, between_corners(T_target_source, target.grid, source.grid))
    if verdict.may_turn_on_parts(found):
        found = with_firmness(found, target, source)
    return _judged(target, source, config, found)


def _judged(target: PreparedMap, source: PreparedMap, config: FusionConfig, finding: Finding) -> PairFusion:
    T_target_source = between_frames(finding.best.pose, target.grid, source.grid)
    cells = agreement(target.grid, source.grid, T_target_source)
    rival = None if finding.rival is None else between_frames(finding.rival.pose, target.grid, source.grid)
    return verdict.judge(target, source, config, finding, T_target_source, rival, cells)
