"""Whether a fusion is to be trusted: each gate, on findings made for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mapfusion.config import FusionConfig
from mapfusion.pairwise.agreement import Agreement
from mapfusion.pairwise.confidence import MIN_CONFIDENCE, confidence_alone, uniqueness
from mapfusion.pairwise.evidence import MIN_EVIDENCE
from mapfusion.pairwise.prepared import PreparedMap, prepare
from mapfusion.pairwise.search import Candidate, Finding
from mapfusion.pairwise.verdict import (
    MORE_EVIDENCE,
    judge,
    lacks_only_confidence,
    least_evidence,
    may_repeat_itself,
    may_turn_on_parts,
    repeats_itself,
    too_little,
)
from mapfusion.result import PairFusion
from mapfusion.transform import SE2
from tests.fakes import flat, grid_of, rooms

GOOD = {
    "net": 300.0,
    "ratio": 0.9,
    "chance": 0.05,
    "contradiction": 0.01,
    "conditioning": 0.6,
    "mutual_ratio": 0.5,
    "tolerance_cells": 1.5,
    "residual_cells": 0.5,
    "num_walls": 3000.0,
    "lines": 30.0,
    "turning": 0.4,
    "opposite": 0.01,
    "crossing_cells": 0.0,
    "crossing": 0.0,
    "stray_cells": 5.0,
    "outside": 0.4,
    "keypoints": 3.0,
    "firmness": 0.3,
    "behind": 0.01,
    "far_behind": 0.01,
    "inliers_near": 60.0,
    "inliers_wide": 100.0,
}
AGREEMENT = Agreement(mae=5.0, overlap_cells=10_000, overlap_ratio=0.5, resolution_m=0.1)
RIVAL_FIGURES = {"ratio": 0.4, "lines": 8.0, "keypoints": 1.0, "inliers_near": 20.0, "inliers_wide": 40.0}
CROSSING = {"crossing": 0.3, "crossing_cells": 60.0}
REPEATED = {
    "recurring": 0.6,
    "rest_ratio": 0.3,
    "like_fit": -2.0,
    "contradiction": 0.1,
    "crossing": 0.02,
    "firm_lead": 0.0,
}
RIVAL = SE2(1.0, 2.0, 3.0)


@pytest.fixture(scope="module")
def place() -> PreparedMap:
    return prepare(grid_of(rooms(seed=3)), 0.1)


def finding(rival_net: float | None = 30.0, **figures: float) -> Finding:
    """A search's finding; one that was only verified where `rival_net` is None."""
    rival = None if rival_net is None else Candidate(np.zeros(3), GOOD | RIVAL_FIGURES | {"net": rival_net})
    information = np.diag([1e3, 1e3, 1e6])
    return Finding(Candidate(np.zeros(3), GOOD | figures), information, rival, rival_net is not None)


def unsure_finding(rival_net: float = 30.0, **figures: float) -> Finding:
    """A finding whose walls cross the other map's free space, as its rival's do."""
    rival = Candidate(np.zeros(3), GOOD | RIVAL_FIGURES | CROSSING | {"net": rival_net})
    return replace(finding(**(CROSSING | figures)), rival=rival)


def judged(place: PreparedMap, found: Finding, mae_threshold: float | None = None) -> PairFusion:
    config = FusionConfig(mae_threshold=mae_threshold)
    return judge(place, place, config, found, SE2.identity(), RIVAL, AGREEMENT)


def test_good_evidence_is_accepted(place: PreparedMap) -> None:
    result = judged(place, finding())
    assert result.accepted
    assert result.rival is None
    assert judged(place, finding(rival_net=None)).accepted


@pytest.mark.parametrize(
    ("gate", "found"),
    [
        ("chance", finding(net=10.0, rival_net=5.0)),
        ("chance", finding(ratio=0.15, chance=0.005)),
        ("contradiction", finding(contradiction=0.7)),
        ("contradiction", finding(stray_cells=61.0)),
        ("repeats", finding(**REPEATED)),
        ("one direction", finding(conditioning=0.001)),
        ("one direction", finding(turning=0.01)),
        ("confidence", finding(firmness=0.05, mutual_ratio=0.3, lines=9.0)),
        (
            "confidence",
            replace(finding(net=25.0, behind=0.3, far_behind=0.3, mutual_ratio=0.3, lines=9.0), rival=None),
        ),
        ("parts", finding(firmness=0.05, far_behind=0.05)),
        ("parts", finding(firmness=0.05, conditioning=0.2, tolerance_cells=6.0)),
        ("ambiguous", replace(finding(), rival=finding().best)),
        (
            "confidence",
            unsure_finding(net=30.0, lines=4.0, rival_net=10.0, crossing_cells=40.0, crossing=0.1, mutual_ratio=0.5),
        ),
    ],
)
def test_each_weakness_has_its_gate_and_reason(place: PreparedMap, gate: str, found: Finding) -> None:
    result = judged(place, found)
    assert (result.accepted, result.gate) == (False, gate)
    assert any(c.isdigit() for c in result.reason)
    assert result.confidence < MIN_CONFIDENCE
    assert (result.rival == RIVAL) == (gate == "ambiguous")


@pytest.mark.parametrize(
    ("figures", "least"),
    [
        ({"lines": 7.9, "mutual_ratio": 0.39}, MORE_EVIDENCE),
        ({"lines": 8.1, "mutual_ratio": 0.39}, MIN_EVIDENCE),
        ({"lines": 7.9, "mutual_ratio": 0.41}, MIN_EVIDENCE),
        ({"lines": 11.9, "mutual_ratio": 0.41, "tolerance_cells": 6.0}, MORE_EVIDENCE),
        ({"lines": 12.1, "mutual_ratio": 0.39, "tolerance_cells": 6.0}, MIN_EVIDENCE),
        ({"lines": 7.9, "mutual_ratio": 0.91}, MORE_EVIDENCE),
        ({"lines": 8.1, "mutual_ratio": 0.91}, MIN_EVIDENCE),
    ],
)
def test_a_few_things_that_two_maps_have_in_common_are_no_place_yet(
    place: PreparedMap, figures: dict[str, float], least: float
) -> None:
    assert least_evidence(GOOD | figures, is_searched=True) == least
    assert judged(place, finding(net=60.0, rival_net=5.0, **figures)).gate in (
        ("chance",) if least == MORE_EVIDENCE else ("", "confidence")
    )


def test_a_known_pose_is_not_doubted_for_lying_wholly_within_the_other_map(place: PreparedMap) -> None:
    within = GOOD | {"lines": 7.9, "mutual_ratio": 1.0}
    assert least_evidence(within, is_searched=False) == MIN_EVIDENCE


def test_a_pose_that_may_slide_must_be_clearly_better_than_its_rival(place: PreparedMap) -> None:
    close = {"net": 200.0, "lines": 20.0, "keypoints": 2.7, "inliers_near": 45.0, "inliers_wide": 80.0}
    rival = Candidate(np.zeros(3), GOOD | close)
    assert judged(place, replace(finding(), rival=rival)).accepted
    assert judged(place, replace(finding(conditioning=0.1), rival=rival)).gate == "ambiguous"
    assert judged(place, finding(conditioning=0.1)).accepted


def test_parts_are_looked_at_where_the_verdict_may_turn_on_them() -> None:
    worse = {"lines": 18.0, "keypoints": 1.0, "crossing": 0.05, "crossing_cells": 30.0}
    assert not may_turn_on_parts(finding(rival_net=None, lines=40.0, keypoints=5.0))
    assert may_turn_on_parts(finding(rival_net=None, **worse))
    assert not may_turn_on_parts(finding(rival_net=None, **worse | {"lines": 2.0}))


def test_a_rival_is_named_though_parts_would_not_stay(place: PreparedMap) -> None:
    alike = finding(firmness=0.0)
    assert judged(place, replace(alike, rival=alike.best)).gate == "ambiguous"


def test_error_threshold_is_a_gate_only_where_given(place: PreparedMap) -> None:
    assert judged(place, finding(), mae_threshold=5.5).accepted
    assert judged(place, finding(), mae_threshold=5.0).gate == "mae"


@pytest.mark.parametrize(
    "better",
    [
        {"net": 28.0},
        {"lines": 20.0},
        {"mutual_ratio": 0.3},
        {"opposite": 0.0},
        {"crossing_cells": 0.0},
        {"crossing": 0.0},
        {"keypoints": 3.0},
        {"firmness": 0.3},
        {"rival_net": 5.0},
    ],
)
def test_confidence_grows_with_every_kind_of_evidence(place: PreparedMap, better: dict[str, float]) -> None:
    worse = {
        "net": 22.0,
        "lines": 15.0,
        "mutual_ratio": 0.2,
        "opposite": 0.05,
        "crossing_cells": 20.0,
        "crossing": 0.05,
        "keypoints": 1.0,
        "firmness": 0.15,
        "rival_net": 20.0,
    }
    more, less = (finding(**one) for one in (worse | better, worse))
    if "rival_net" not in better:
        more, less = (replace(one, rival=None) for one in (more, less))
    assert judged(place, more).confidence > judged(place, less).confidence


def test_maps_without_walls_are_refused_before_any_search(place: PreparedMap) -> None:
    blank = prepare(grid_of(flat(50, 50, 0)), 0.1)
    assert too_little(place, place) is None
    refusal = too_little(place, blank)
    assert refusal is not None
    assert refusal.gate == "few walls"


def test_covariance_is_the_translation_s_at_the_frame_s_origin(place: PreparedMap) -> None:
    near = judged(place, finding())
    assert near.covariance is not None
    far_grid = replace(place.grid, T_frame_grid=SE2(100.0, 0.0, 0.0))
    far = judge(
        replace(place, grid=far_grid), replace(place, grid=far_grid), FusionConfig(), finding(), SE2.identity(),
        None, AGREEMENT,
    )  # fmt: skip
    assert far.covariance is not None
    # 100 m from the origin, an error of the yaw moves the origin's image by its lever.
    assert far.covariance[1, 1] > near.covariance[1, 1]
    assert far.covariance[2, 2] == pytest.approx(near.covariance[2, 2])


def test_what_a_refusal_leaves_of_the_confidence_and_what_it_was_before(place: PreparedMap) -> None:
    accepted = judged(place, finding())
    assert accepted.evidence["ungated_confidence"] == accepted.confidence
    close = {"net": 200.0, "lines": 20.0, "keypoints": 2.7, "inliers_near": 45.0, "inliers_wide": 80.0}
    refused = judged(place, replace(finding(conditioning=0.1), rival=Candidate(np.zeros(3), GOOD | close)))
    assert (refused.gate, refused.confidence) == ("ambiguous", 0.5)
    assert refused.evidence["ungated_confidence"] > 0.9
    assert not lacks_only_confidence(refused)


def test_a_rival_that_explains_as_much_makes_a_pair_ambiguous(place: PreparedMap) -> None:
    refused = judged(place, replace(finding(), rival=finding().best))
    assert refused.gate == "ambiguous"
    assert "explains the maps almost as well (1.00 of the evidence)" in refused.reason


def test_a_wall_that_strays_for_metres_refuses_maps_that_are_not_bent(place: PreparedMap) -> None:
    # At 0.1 m a cell.
    assert judged(place, finding(stray_cells=59.0)).accepted
    stray = judged(place, finding(stray_cells=65.0))
    assert (stray.accepted, stray.gate) == (False, "contradiction")
    assert "a wall of 6.5 m strays through the other map's free space (at most 6 m may)" in stray.reason
    assert judged(place, finding(stray_cells=65.0, tolerance_cells=3.0)).gate == "contradiction"
    assert judged(place, finding(stray_cells=65.0, tolerance_cells=6.0)).accepted


def test_walls_that_do_not_recur_must_agree_where_maps_repeat_themselves(place: PreparedMap) -> None:
    refused = judged(place, finding(**REPEATED))
    assert (refused.accepted, refused.gate) == (False, "repeats")
    assert "60% of the walls that agree have their like elsewhere in the same map" in refused.reason
    assert (
        "of those that have none 30% agree, and walls stand in free space 10% as often as by chance" in refused.reason
    )
    assert f"({uniqueness(finding(**REPEATED).best.figures):.2f}, at least 0.5 is needed)" in refused.reason
    for enough in (
        {"rest_ratio": 0.9},
        {"like_fit": -8.0},
        {"contradiction": 0.02, "crossing": 0.0},
        {"tolerance_cells": 6.0},
        {"recurring": 0.2},
    ):
        assert judged(place, finding(**(REPEATED | enough))).accepted, enough
    assert not repeats_itself(GOOD)


def test_maps_are_asked_whether_they_repeat_where_something_speaks_for_it() -> None:
    assert not may_repeat_itself(finding())
    assert may_repeat_itself(finding(crossing=0.01))
    assert may_repeat_itself(finding(contradiction=0.03))
    assert may_repeat_itself(finding(rival_net=160.0))
    assert not may_repeat_itself(finding(rival_net=None))


def test_a_rival_that_follows_from_repeats_need_not_be_sure(place: PreparedMap) -> None:
    crossed = finding(crossing=0.02, crossing_cells=10.0)
    unsure = Candidate(np.zeros(3), GOOD | {"net": 25.0, "lines": 3.0, "mutual_ratio": 0.1, "outside": 0.0})
    assert confidence_alone(unsure.figures) < MIN_CONFIDENCE
    assert judged(place, replace(crossed, rival=unsure)).accepted
    repeat = Candidate(unsure.pose, unsure.figures | {"repeats": 1.0})
    refused = judged(place, replace(crossed, rival=repeat))
    assert refused.gate == "ambiguous"
    assert "follows from what one of the maps repeats, and fits better" in refused.reason


def _variance(fusion: PairFusion) -> float:
    assert fusion.covariance is not None
    return float(fusion.covariance[2, 2])


def test_a_rival_with_less_evidence_that_fits_better_makes_a_pair_ambiguous(place: PreparedMap) -> None:
    better = Candidate(np.zeros(3), GOOD | {"net": 150.0, "lines": 15.0, "mutual_ratio": 0.4})
    refused = judged(place, replace(finding(crossing=0.05, crossing_cells=20.0), rival=better))
    assert refused.gate == "ambiguous"
    assert "fits better where it lays the maps over each other (0.50 of the evidence)" in refused.reason
    assert refused.rival == RIVAL
    assert judged(place, replace(finding(), rival=better)).accepted


def test_a_search_that_ended_early_names_no_rivals_evidence(place: PreparedMap) -> None:
    unsure = unsure_finding(lines=9.0, mutual_ratio=0.6)
    whole = judged(place, unsure)
    assert whole.gate == "confidence"
    assert "the best different alignment has 0.10 of the evidence" in whole.reason
    early = judged(place, replace(unsure, is_hopeless=True))
    assert early.gate == "confidence"
    assert "no rivals were looked for" in early.reason
    assert "different alignment" not in early.reason


ADRIFT = {"firmness": 0.24, "behind": 0.02, "far_behind": 0.02}


@pytest.mark.parametrize(
    ("less", "gate"),
    [
        ({}, "parts"),
        ({"tolerance_cells": 3.0}, "parts"),
        ({"firmness": 0.26}, ""),
        ({"far_behind": 0.009}, ""),
        ({"tolerance_cells": 6.0}, ""),
    ],
)
def test_maps_whose_parts_drift_and_that_see_behind_each_others_walls_are_not_joined(
    place: PreparedMap, less: dict[str, float], gate: str
) -> None:
    result = judged(place, finding(**ADRIFT | less))
    assert result.gate == gate
    if gate:
        assert "stay where the alignment puts them (at least 25% where more than 3%" in result.reason


@pytest.mark.parametrize(
    ("figures", "gate"),
    [
        ({"firmness": 0.09, "conditioning": 0.29}, "parts"),
        ({"firmness": 0.11, "conditioning": 0.29}, ""),
        ({"firmness": 0.09, "conditioning": 0.31}, ""),
        ({"firmness": 0.021, "conditioning": 0.31}, ""),
        ({"firmness": 0.019, "conditioning": 0.9}, "parts"),
    ],
)
def test_maps_that_may_have_slid_along_their_walls_are_not_joined(
    place: PreparedMap, figures: dict[str, float], gate: str
) -> None:
    result = judged(place, finding(**figures))
    assert result.gate == gate
    if gate:
        least, share = ("10%", "29%") if figures["conditioning"] < 0.3 else ("2%", "90%")
        assert f"(at least {least} where walls hold one direction by {share} of the other)" in result.reason


def test_parts_that_were_not_looked_at_do_not_drift(place: PreparedMap) -> None:
    verified = finding(rival_net=None, **ADRIFT)
    figures = {name: value for name, value in verified.best.figures.items() if name != "firmness"}
    assert judged(place, replace(verified, best=replace(verified.best, figures=figures))).accepted
