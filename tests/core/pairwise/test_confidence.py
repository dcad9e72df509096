"""The models of the verdict: what speaks for an alignment, and what against it."""

from __future__ import annotations

import math

import pytest

from mapfusion.pairwise.confidence import (
    BETTER_FIT,
    CONFIDENCE,
    KNOWN_FIRMNESS,
    KNOWN_KEYPOINTS,
    MAX_MARGIN,
    MAX_NET,
    MIN_CONFIDENCE,
    PLAUSIBILITY,
    UNIQUENESS,
    USUAL_BEHIND,
    closeness,
    confidence,
    confidence_alone,
    confidence_terms,
    fit,
    fits_better,
    margin,
    plausibility,
    plausibility_terms,
    rigidity,
    uniqueness,
    uniqueness_terms,
)

FIGURES = {
    "net": 25.0,
    "tolerance_cells": 3.0,
    "ratio": 0.8,
    "chance": 0.1,
    "lines": 15.0,
    "crossing": 0.05,
    "crossing_cells": 20.0,
    "num_walls": 2000.0,
    "opposite": 0.05,
    "mutual_ratio": 0.4,
    "outside": 0.5,
    "keypoints": 2.0,
    "firmness": 0.2,
    "behind": 0.01,
    "far_behind": 0.01,
    "inliers_near": 20.0,
    "inliers_wide": 40.0,
}
ASKED = FIGURES | {"recurring": 0.6, "rest_ratio": 0.5, "like_fit": -2.0, "firm_lead": 0.1, "contradiction": 0.1}


def test_every_term_has_a_weight() -> None:
    assert plausibility_terms(FIGURES).keys() == PLAUSIBILITY.keys()
    assert confidence_terms(FIGURES, 1.0).keys() == CONFIDENCE.keys()
    assert uniqueness_terms(ASKED).keys() == UNIQUENESS.keys()


@pytest.mark.parametrize(
    "better",
    [
        {"rest_ratio": 0.6},
        {"crossing": 0.0},
        {"contradiction": 0.0},
        {"like_fit": -3.0},
        {"lines": 20.0},
        {"firm_lead": 0.3},
    ],
)
def test_uniqueness_grows_with_what_tells_a_place_from_its_like(better: dict[str, float]) -> None:
    assert uniqueness(ASKED) < uniqueness(ASKED | better) < 1.0


def test_where_nothing_follows_nothing_of_it_fits() -> None:
    without = {name: value for name, value in ASKED.items() if name != "like_fit"}
    assert uniqueness(without) == uniqueness(ASKED | {"like_fit": -12.0}) == uniqueness(ASKED | {"like_fit": -30.0})


def test_more_walls_than_tell_anything_make_nothing_more_unique() -> None:
    assert uniqueness(ASKED | {"lines": 30.0}) < uniqueness(ASKED | {"lines": 40.0})
    assert uniqueness(ASKED | {"lines": 40.0}) == uniqueness(ASKED | {"lines": 200.0})


@pytest.mark.parametrize(
    "better",
    [
        {"net": 50.0},
        {"crossing": 0.0},
        {"lines": 30.0},
        {"ratio": 0.9},
        {"chance": 0.05},
        {"keypoints": 3.0},
        {"inliers_near": 30.0},
        {"inliers_wide": 60.0},
        {"behind": 0.0},
        {"far_behind": 0.0},
    ],
)
def test_plausibility_grows_with_what_speaks_for_a_pose(better: dict[str, float]) -> None:
    assert plausibility(FIGURES | better) > plausibility(FIGURES)


@pytest.mark.parametrize(
    "better",
    [
        {"net": 28.0},
        {"lines": 18.0},
        {"crossing_cells": 0.0},
        {"crossing": 0.0},
        {"keypoints": 3.0},
        {"opposite": 0.0},
        {"mutual_ratio": 0.6},
        {"firmness": 0.3},
    ],
)
def test_confidence_grows_with_what_speaks_for_a_pose(better: dict[str, float]) -> None:
    assert confidence(FIGURES | better, 2.0) > confidence(FIGURES, 2.0)


def test_more_evidence_than_repetition_has_too_is_no_more_confidence() -> None:
    assert confidence(FIGURES | {"net": MAX_NET}, 2.0) == confidence(FIGURES | {"net": 30.0 * MAX_NET}, 2.0)


@pytest.mark.parametrize(
    ("less", "expected"),
    [
        ({}, 1.0),
        ({"ratio": 0.935}, 0.5),
        ({"ratio": 0.9}, 0.0),
        ({"net": math.sqrt(100.0 * 300.0)}, 0.5),
        ({"net": 100.0}, 0.0),
        ({"tolerance_cells": 3.0}, 0.0),
    ],
)
def test_nearly_all_walls_and_much_evidence_make_few_walls_the_same(less: dict[str, float], expected: float) -> None:
    close = FIGURES | {"tolerance_cells": 1.5, "ratio": 0.97, "net": 300.0, "lines": 4.0}
    assert closeness(close | less) == pytest.approx(expected, abs=1e-9)
    assert confidence(close, 1.0) >= confidence(close | less, 1.0)


def test_many_tight_walls_whose_parts_stay_are_those_of_one_rigid_place() -> None:
    rigid = FIGURES | {"tolerance_cells": 1.5, "firmness": 0.4, "lines": 6.0}
    assert rigidity(rigid) == 1.0
    assert rigidity(rigid | {"firmness": 0.3}) == pytest.approx(0.5)
    assert rigidity(rigid | {"behind": 0.05, "far_behind": 0.03}) == pytest.approx(0.5)
    assert rigidity(rigid | {"behind": 0.02, "far_behind": 0.04}) == pytest.approx(1.0)
    assert rigidity({name: value for name, value in rigid.items() if name != "firmness"}) == 0.0
    for less in ({"firmness": 0.24}, {"tolerance_cells": 3.0}, {"lines": 5.9}, {"ratio": 0.59}):
        assert rigidity(rigid | less) == 0.0
        assert confidence(rigid, 1.0) > confidence(rigid | less, 1.0)


def test_where_maps_share_little_firmness_tells_less() -> None:
    firm, very_firm = {"firmness": 0.2}, {"firmness": 0.4}
    assert confidence(FIGURES | very_firm, 2.0) > confidence(FIGURES | firm, 2.0)
    little, some, enough = (FIGURES | {"mutual_ratio": share} for share in (0.29, 0.4, 0.51))
    assert confidence(little | very_firm, 2.0) == confidence(little | firm, 2.0)
    more, most = (confidence(one | very_firm, 2.0) - confidence(one | firm, 2.0) for one in (some, enough))
    assert 0.0 < more < most


def test_a_close_rival_takes_confidence() -> None:
    weak, close = FIGURES | {"net": 5.0, "lines": 4.0, "ratio": 0.3}, FIGURES | {"net": 22.0}
    assert margin(FIGURES, None) == MAX_MARGIN
    assert margin(FIGURES, FIGURES) == 0.0
    assert confidence(FIGURES, margin(FIGURES, weak)) > confidence(FIGURES, margin(FIGURES, close))


def test_a_rival_that_falls_far_behind_counts_less_where_plausibility_cannot_tell() -> None:
    best = FIGURES | {"net": 400.0}
    assert margin(best, best | {"net": 201.0}) == 0.0
    assert margin(best, best | {"net": 150.0}) == pytest.approx(3.0 * math.log(200.0 / 150.0))
    assert margin(best, best | {"net": 0.0}) == MAX_MARGIN
    less = FIGURES | {"net": 99.0}
    assert margin(less, less | {"net": 20.0}) == pytest.approx(plausibility(less) - plausibility(less | {"net": 20.0}))


@pytest.mark.parametrize("rival_net", [10.0, 30.0, 49.0])
def test_the_margin_grows_with_the_evidence_and_without_a_jump(rival_net: float) -> None:
    def over_rival(net: float) -> float:
        return margin(FIGURES | {"net": net}, FIGURES | {"net": rival_net, "lines": FIGURES["lines"] - 1.0})

    for net in (50.0, 100.0):
        assert over_rival(net + 0.001) == pytest.approx(over_rival(net), abs=1e-3)
    assert over_rival(49.0) <= over_rival(50.0) <= over_rival(100.0) < over_rival(110.0) < MAX_MARGIN


@pytest.mark.parametrize(
    ("name", "enough"), [("net", 50.0), ("lines", 40.0), ("inliers_wide", 200.0), ("inliers_near", 100.0)]
)
def test_what_grows_with_the_common_area_counts_only_so_far(name: str, enough: float) -> None:
    assert plausibility(FIGURES | {name: enough}) > plausibility(FIGURES | {name: 0.9 * enough})
    assert plausibility(FIGURES | {name: 10.0 * enough}) == plausibility(FIGURES | {name: enough})


MORE = {"net": 300.0, "lines": 40.0, "inliers_near": 100.0, "inliers_wide": 200.0, "mutual_ratio": 1.0}
ALONE = FIGURES | {"net": 100.0, "lines": 20.0, "mutual_ratio": 0.7, "outside": 0.6}


@pytest.mark.parametrize(("better_by", "is_better"), [(0.4, False), (0.6, True)])
def test_a_rival_that_is_sure_alone_and_fits_better_leaves_no_margin(better_by: float, is_better: bool) -> None:
    best, rival = FIGURES | MORE, ALONE | {"keypoints": FIGURES["keypoints"] + better_by / PLAUSIBILITY["keypoints"]}
    assert fit(rival) - fit(best) == pytest.approx(better_by)
    assert confidence_alone(rival) >= MIN_CONFIDENCE
    assert plausibility(best) > plausibility(rival)
    assert fits_better(rival, best) == is_better == (better_by > BETTER_FIT)
    assert (margin(best, rival) == 0.0) == is_better


def test_a_rival_that_is_not_sure_alone_is_only_less_plausible() -> None:
    best, weak = FIGURES | MORE | {"crossing": 0.2}, ALONE | {"lines": 10.0, "net": 15.0}
    assert fit(weak) - fit(best) > BETTER_FIT
    assert 0.5 < confidence_alone(weak) < MIN_CONFIDENCE
    assert not fits_better(weak, best)
    assert margin(best, weak) > 1.0


def test_alone_a_pose_has_no_rival_and_all_its_parts_stay() -> None:
    loose = FIGURES | {"firmness": 0.0, "mutual_ratio": 0.6}
    assert confidence_alone(loose) == confidence(loose | {"firmness": 0.4}, MAX_MARGIN) > confidence(loose, MAX_MARGIN)


def test_how_well_a_pose_fits_is_not_how_much_is_in_common() -> None:
    assert fit(FIGURES | {"net": 50.0, "lines": 40.0, "inliers_near": 100.0, "inliers_wide": 200.0}) == fit(FIGURES)
    for worse in (
        {"crossing": 0.1},
        {"crossing_cells": 40.0},
        {"ratio": 0.5},
        {"keypoints": 1.0},
        {"behind": 0.1},
        {"far_behind": 0.1},
    ):
        assert fit(FIGURES | worse) < fit(FIGURES)


def test_what_lies_behind_walls_tells_less_of_bent_maps() -> None:
    def lost(tolerance_cells: float, **more: float) -> float:
        figures = FIGURES | {"tolerance_cells": tolerance_cells}
        usual = {"behind": USUAL_BEHIND, "far_behind": USUAL_BEHIND}
        return plausibility(figures | usual) - plausibility(figures | usual | more)

    assert lost(1.5, behind=0.1) == pytest.approx(lost(3.0, behind=0.1)) == pytest.approx(2.0 * lost(6.0, behind=0.1))
    # As much as is usual speaks neither for nor against a pose, however closely its walls agree.
    usual = [
        plausibility(FIGURES | {"behind": USUAL_BEHIND, "far_behind": USUAL_BEHIND, "tolerance_cells": one})
        for one in (1.5, 3.0, 6.0)
    ]
    assert usual == pytest.approx([usual[0]] * 3)


def test_evidence_beyond_what_counts_makes_up_for_a_more_plausible_rival() -> None:
    best = FIGURES | {"net": 400.0, "keypoints": 1.0}
    behind = best | {"net": 150.0, "keypoints": 1.4}
    assert plausibility(behind) > plausibility(best)
    ahead = plausibility(best) - plausibility(behind) + 3.0 * math.log(200.0 / 150.0)
    assert margin(best, behind) == pytest.approx(ahead)
    assert margin(best, behind | {"keypoints": 3.0}) == 0.0


def test_nothing_at_all_is_no_error_and_no_confidence() -> None:
    nothing = dict.fromkeys(FIGURES, 0.0)
    assert confidence(nothing, 0.0) < 0.001
    assert plausibility(nothing) < plausibility(FIGURES)


def test_a_transform_that_is_only_verified_needs_neither_keypoints_nor_firmness() -> None:
    without = {name: value for name, value in FIGURES.items() if name not in ("keypoints", "firmness")}
    known = {"keypoints": KNOWN_KEYPOINTS, "firmness": KNOWN_FIRMNESS}
    assert confidence(without, 2.0) == confidence(FIGURES | known, 2.0)
