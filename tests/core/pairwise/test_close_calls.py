"""Close calls, by verdicts that are made up for them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from mapfusion.config import FusionConfig
from mapfusion.joins import OVERWHELMING, held_back
from mapfusion.pairwise import close_calls
from mapfusion.pairwise.close_calls import MIN_AGREEING, NUM_VERDICTS, asked_again, is_close_call
from mapfusion.pairwise.default import fuse
from mapfusion.pairwise.prepared import PreparedMap, prepare
from mapfusion.result import PairFusion
from mapfusion.transform import SE2
from tests.core.pairwise.test_verdict import GOOD
from tests.fakes import grid_of, rooms

RESOLUTION_M = 0.1
HERE, ELSEWHERE = SE2(1.0, 2.0, 0.3), SE2(-4.0, 2.0, 0.3)


def yes(T: SE2 = HERE, confidence: float = 0.9, deviation_deg: float = 0.1, **evidence: float) -> PairFusion:
    return PairFusion(
        accepted=True,
        T_target_source=T,
        confidence=confidence,
        covariance=np.diag([1e-4, 1e-4, np.radians(deviation_deg) ** 2]),
        evidence={**GOOD, "margin": 4.0, "ungated_confidence": 0.1, **evidence},
    )


def no(
    gate: str = "confidence", reason: str = "not sure enough", confidence: float = 0.7, **evidence: float
) -> PairFusion:
    return replace(yes(HERE, confidence, 0.1, **evidence), accepted=False, reason=reason, gate=gate)


@pytest.fixture(scope="module")
def maps() -> tuple[PreparedMap, PreparedMap]:
    cells = rooms()
    one, other = (prepare(grid_of(part), RESOLUTION_M) for part in (cells[:, :90], cells[:, 40:]))
    return one, other


Ask = Callable[[Sequence[PairFusion]], tuple[PairFusion, int]]


@pytest.fixture
def ask(maps: tuple[PreparedMap, PreparedMap]) -> Ask:
    """The verdict of the vote, where maps as they are and turned get these; and how many were asked for."""

    def asked(verdicts: Sequence[PairFusion]) -> tuple[PairFusion, int]:
        left = list(verdicts[1:])
        result = asked_again(verdicts[0], *maps, lambda *_: left.pop(0))
        return result, len(verdicts) - len(left)

    return asked


@pytest.mark.parametrize(
    ("verdict", "is_close"),
    [
        (yes(confidence=0.98), True),
        (yes(confidence=0.995), False),
        (yes(confidence=0.995, recurring=0.6), True),
        (yes(confidence=0.995, recurring=0.4), False),
        (yes(confidence=0.995, deviation_deg=1.2), True),
        (yes(confidence=0.995, deviation_deg=1.0), False),
        (no(confidence=0.51), True),
        (no(confidence=0.49), False),
        (no("ambiguous", confidence=0.5), True),
        (no("mae", confidence=0.5), False),
        (no("one direction", confidence=0.5), False),
    ],
)
def test_which_verdicts_are_close_calls(verdict: PairFusion, is_close: bool) -> None:
    assert is_close_call(verdict) == is_close


def test_a_second_acceptance_of_the_same_confirms_the_first(ask: Ask) -> None:
    result, number = ask([yes(confidence=0.9, net=80.0), yes(SE2(1.1, 2.0, 0.31), confidence=0.89), no(), no()])
    assert result.accepted
    assert result.T_target_source == HERE
    assert number == 2
    assert (result.evidence["verdicts"], result.evidence["agreeing"], result.evidence["net"]) == (2.0, 2.0, 80.0)


def test_two_of_four_join_what_the_first_refused(ask: Ask) -> None:
    result, number = ask([no(), yes(confidence=0.9), no(), yes(SE2(1.1, 2.0, 0.31), confidence=0.95)])
    assert result.accepted
    assert result.confidence == 0.95
    assert number == NUM_VERDICTS == 4


def test_what_only_one_of_four_accepts_is_refused_with_both_sides_named(ask: Ask) -> None:
    result, number = ask([yes(ELSEWHERE, confidence=0.9), no("parts", "parts drift"), no(), no()])
    assert (result.accepted, result.gate) == (False, "parts")
    assert number == NUM_VERDICTS
    assert "of 4 verdicts on these and on the same maps turned by quarters only 1 accept the same" in result.reason
    assert "parts drift" in result.reason
    assert result.T_target_source == ELSEWHERE
    assert result.confidence == 0.5


def test_a_refusal_ends_as_soon_as_no_vote_can_overturn_it(ask: Ask) -> None:
    result, number = ask([no(reason="the first"), no(), no(), yes()])
    assert number == NUM_VERDICTS - MIN_AGREEING + 1 == 3
    assert result.reason == "the first"
    assert result.evidence["agreeing"] == 0.0


def nearly(confidence: float, T: SE2 = HERE, gate: str = "ambiguous", **evidence: float) -> PairFusion:
    """A refusal for too little confidence."""
    refusal = no(gate)
    own = {"margin": 1.0, "ungated_confidence": confidence}
    return replace(refusal, T_target_source=T, evidence={**refusal.evidence, **own, **evidence})


def surely(confidence: float) -> PairFusion:
    return yes(ungated_confidence=confidence)


def test_where_all_four_find_the_same_one_acceptance_and_the_mean_confidence_are_enough(ask: Ask) -> None:
    result, number = ask([nearly(0.7), surely(0.9), nearly(0.7), nearly(0.7)])
    assert (result.accepted, number) == (True, 4)
    log_odds = (3.0 * np.log(0.7 / 0.3) + np.log(0.9 / 0.1)) / 4.0
    assert result.confidence == pytest.approx(1.0 / (1.0 + np.exp(-log_odds)))
    assert (result.evidence["verdicts"], result.evidence["agreeing"]) == (4.0, 1.0)


@pytest.mark.parametrize(("last", "is_accepted"), [(0.65, False), (0.69, True)])
def test_a_mean_of_seven_tenths_is_enough(ask: Ask, last: float, is_accepted: bool) -> None:
    assert ask([surely(0.8), nearly(0.65), nearly(0.65), nearly(last)])[0].accepted == is_accepted


@pytest.mark.parametrize(
    "last",
    [
        nearly(0.2),  # not sure enough in the mean
        nearly(0.9, margin=0.4),  # the two are the same to us
        nearly(0.9, margin=1.5, conditioning=0.1),  # the same of walls that may let a pose slide
        nearly(0.9, conditioning=0.2, firmness=0.05),  # it may have slid
        nearly(0.9, firmness=0.2, behind=0.04),  # parts would lie as well elsewhere
        nearly(0.9, gate="repeats"),
        nearly(0.9, gate="chance"),
        nearly(0.7, recurring=0.6),
        nearly(0.7, SE2(HERE.x_m + 0.8, HERE.y_m, HERE.yaw_rad)),
        nearly(0.7, SE2(HERE.x_m, HERE.y_m, HERE.yaw_rad + np.radians(1.5))),
    ],
)
def test_the_mean_overrules_no_graver_doubt(ask: Ask, last: PairFusion) -> None:
    result, _ = ask([surely(0.95), nearly(0.7), nearly(0.7), last])
    assert not result.accepted
    assert result.confidence == 0.5


def test_the_mean_needs_an_acceptance(ask: Ask) -> None:
    result, number = ask([nearly(0.75), nearly(0.75), nearly(0.75), nearly(0.75)])
    assert (result.accepted, number) == (False, NUM_VERDICTS)
    assert (result.confidence, result.reason) == (0.7, "not sure enough")


def test_no_verdict_decides_the_mean_alone_whenever_it_is_asked(ask: Ask) -> None:
    for others in permutations((nearly(0.05), nearly(0.05), surely(0.9999999))):
        assert not ask([nearly(0.6), *others])[0].accepted
    for others in permutations((nearly(0.3), surely(0.97), surely(0.98))):
        result, _ = ask([nearly(0.6), *others])
        assert result.accepted
        assert result.confidence < OVERWHELMING


def test_the_asking_ends_where_the_mean_can_no_longer_suffice(ask: Ask) -> None:
    result, number = ask([nearly(0.001), nearly(0.001), surely(0.9), surely(0.9)])
    assert (result.accepted, number) == (False, 2)


@pytest.mark.parametrize("doubt", [no("ambiguous"), no("repeats", recurring=0.3), yes(ELSEWHERE, recurring=0.6)])
def test_where_one_verdict_doubts_three_must_accept_the_same(ask: Ask, doubt: PairFusion) -> None:
    agreed, number = ask([yes(), doubt, yes(), yes()])
    assert agreed.accepted
    assert agreed.T_target_source == HERE
    assert number == 4
    refused, number = ask([yes(), doubt, yes(), no()])
    assert not refused.accepted
    assert number == 4
    assert "only 2 accept the same, and 3 must" in refused.reason


def test_what_one_verdict_finds_of_repeats_is_told(ask: Ask) -> None:
    repeating = no("repeats", recurring=0.8, rest_ratio=0.1, like_fit=-0.5)
    result, _ = ask([yes(net=80.0, firm_lead=0.3), repeating, yes(recurring=0.2, rest_ratio=0.9), yes()])
    assert result.accepted
    assert "firm_lead" not in result.evidence
    assert (result.evidence["recurring"], result.evidence["rest_ratio"], result.evidence["like_fit"]) == (
        0.8,
        0.1,
        -0.5,
    )
    assert held_back(result).gate == "alike"


def test_where_the_rotation_is_left_open_a_degree_apart_is_not_the_same(ask: Ask) -> None:
    def turned(degrees: float, deviation_deg: float) -> PairFusion:
        return yes(SE2(HERE.x_m, HERE.y_m, HERE.yaw_rad + np.radians(degrees)), deviation_deg=deviation_deg)

    assert ask([turned(0.0, 0.1), turned(1.5, 0.1), no(), no()])[0].accepted
    assert ask([turned(0.0, 1.2), turned(0.8, 0.1), turned(0.4, 0.1), no()])[0].accepted
    assert not ask([turned(0.0, 1.2), turned(1.5, 0.1), turned(0.4, 0.1), no()])[0].accepted


def test_the_one_that_most_agree_with_is_taken(ask: Ask) -> None:
    result, number = ask([yes(ELSEWHERE, confidence=0.98), yes(), yes(), no()])
    assert result.T_target_source == HERE
    assert number == 3


def test_of_three_that_agree_the_one_in_the_middle_is_taken_however_sure(ask: Ask) -> None:
    moved, turned = SE2(HERE.x_m + 0.3, HERE.y_m, HERE.yaw_rad), SE2(HERE.x_m, HERE.y_m, HERE.yaw_rad + 0.02)
    result, number = ask([yes(moved, confidence=0.98, recurring=0.6), yes(confidence=0.85), yes(turned), no()])
    assert number == 3
    assert (result.T_target_source, result.confidence) == (HERE, 0.85)
    result, number = ask([yes(moved, confidence=0.97), yes(confidence=0.85), no(), no()])
    assert number == 2
    assert result.T_target_source == moved


def test_acceptances_of_different_alignments_are_ambiguous(ask: Ask) -> None:
    result, _ = ask([yes(confidence=0.95, recurring=0.6), yes(), yes(ELSEWHERE), yes(ELSEWHERE)])
    assert (result.accepted, result.gate) == (False, "ambiguous")
    assert (result.T_target_source, result.rival) == (HERE, ELSEWHERE)
    assert result.confidence == 0.5


def test_a_vote_gives_the_inverse_where_maps_are_exchanged(
    maps: tuple[PreparedMap, PreparedMap], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(close_calls, "SURE_ALONE", 2.0)
    there, back = (fuse(*pair, FusionConfig()) for pair in (maps, maps[::-1]))
    assert there.accepted
    assert there.evidence["verdicts"] == back.evidence["verdicts"] == 2.0
    assert there.T_target_source is not None
    assert back.T_target_source == there.T_target_source.inverse()


def test_the_maps_are_turned_together_and_stay_where_they_are(maps: tuple[PreparedMap, PreparedMap]) -> None:
    seen: list[tuple[PreparedMap, PreparedMap]] = []

    def refuse(one: PreparedMap, other: PreparedMap) -> PairFusion:
        seen.append((one, other))
        return no() if len(seen) < NUM_VERDICTS - 1 else yes()

    asked_again(yes(), *maps, refuse)
    assert len(seen) == 3
    for quarters, pair in enumerate(seen, start=1):
        for turned, original in zip(pair, maps, strict=True):
            np.testing.assert_array_equal(turned.grid.cells, np.rot90(original.grid.cells, quarters))
            there, before = (
                sorted(map(tuple, one.grid.centres_m(one.grid.walls).round(6))) for one in (turned, original)
            )
            assert there == before
