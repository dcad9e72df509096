from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pytest

from mapfusion.joins import (
    FOLLOW_NS,
    MAX_LAST_THOROUGH,
    MAX_SEARCHES,
    MAX_THOROUGH,
    OVERWHELMING,
    SEARCH_AGAIN_NS,
    SETTLED_NS,
    Joins,
    Look,
    held_back,
)
from mapfusion.newest import NewestGrid
from mapfusion.result import PairFusion
from mapfusion.steps import Placement
from mapfusion.timeline import Snapshot
from mapfusion.transform import SE2
from tests.fakes import SECOND_NS, flat, grid_of

T = SE2(1.0, 2.0, 0.3)
ACCEPTED = PairFusion(accepted=True, T_target_source=T, confidence=0.95)
CERTAIN = replace(ACCEPTED, confidence=OVERWHELMING)
REFUSED = PairFusion(accepted=False, reason="walls disagree", gate="confidence", T_target_source=T, confidence=0.1)
DOUBTFUL = replace(REFUSED, confidence=0.6)
ALIKE = {"recurring": 0.9, "like_fit": -2.0}
REPEATING = replace(ACCEPTED, evidence=ALIKE)
AMBIGUOUS = replace(REFUSED, gate="ambiguous", confidence=0.5)
ELSEWHERE = replace(ACCEPTED, T_target_source=SE2(9.0, 2.0, 0.3))
AB = ("a", "b")
SEARCH, THOROUGH = Look(AB, None), Look(AB, None, is_thorough=True)


def snapshot(second: float = 0.0, is_last: bool = False, known: int = 10, **versions: int) -> Snapshot:
    """Every robot's map has `known` known columns of ten cells, which all became known."""
    cells = flat(10, 100)
    cells[:, :known] = 0
    grids = {robot: replace(NewestGrid.of(0, grid_of(cells)), version=version) for robot, version in versions.items()}
    return Snapshot(round(second * SECOND_NS), is_last, {}, grids)


def look(
    joins: Joins, at: Snapshot, *fusions: PairFusion, placements: Mapping[str, Placement] | None = None
) -> list[str]:
    looks = joins.due(at, placements or {})
    assert len(looks) == len(fusions)
    ended = [joins.record(one, fusion, at) for one, fusion in zip(looks, fusions, strict=True)]
    return [change for change in ended if change] + [joins.join(*ripe, at) for ripe in joins.ripe(at).items()]


def test_pairs_are_looked_at_in_natural_order_and_only_when_a_map_changed() -> None:
    joins = Joins()
    first = snapshot(r1=1, r10=1, r2=1)
    assert [one.pair for one in joins.due(first, {})] == [("r1", "r2"), ("r1", "r10"), ("r2", "r10")]
    look(joins, first, REFUSED, REFUSED, REFUSED)
    assert joins.due(first, {}) == []


def test_a_refused_pair_is_searched_again_when_enough_has_changed_or_at_the_end() -> None:
    joins = Joins()
    look(joins, snapshot(a=1, b=1, known=50), REFUSED)
    assert joins.due(snapshot(second=30.0, a=2, b=1, known=53), {}) == []
    assert joins.due(snapshot(second=30.0, a=3, b=1, known=56), {}) == [Look(AB, None)]
    assert joins.due(snapshot(second=30.0, a=3, b=1, known=44), {}) == [Look(AB, None)]
    assert joins.due(snapshot(a=2, b=1, known=51, is_last=True), {}) == [Look(AB, None, is_thorough=True)]


def test_a_refused_pair_is_not_searched_again_at_once_however_fast_its_maps_grow() -> None:
    joins = Joins()
    look(joins, snapshot(a=1, b=1, known=50), REFUSED)
    before, after = SEARCH_AGAIN_NS / SECOND_NS - 1.0, SEARCH_AGAIN_NS / SECOND_NS
    assert joins.due(snapshot(second=before, a=2, b=1, known=80), {}) == []
    assert joins.due(snapshot(second=after, a=2, b=1, known=80), {}) == [Look(AB, None)]


def test_a_search_is_thorough_whenever_a_map_has_grown_to_eight_times_its_size() -> None:
    joins = Joins()
    look(joins, snapshot(a=1, b=1, known=5), REFUSED)
    thorough = [Look(AB, None, is_thorough=True)]
    assert joins.due(snapshot(second=20.0, a=2, b=1, known=39), {}) == [Look(AB, None)]
    assert joins.due(snapshot(second=20.0, a=2, b=1, known=40), {}) == thorough
    look(joins, snapshot(second=20.0, a=2, b=1, known=40), REFUSED)
    assert joins.due(snapshot(second=40.0, a=3, b=1, known=80), {}) == [Look(AB, None)]


@pytest.mark.parametrize("has_thorough", [True, False])
@pytest.mark.parametrize("how", ["last", "settled"])
def test_a_refused_pair_is_searched_thoroughly_once_when_nothing_changes_any_more(how: str, has_thorough: bool) -> None:
    joins = Joins(has_thorough=has_thorough)
    look(joins, snapshot(a=1, b=1), REFUSED)
    assert joins.due(snapshot(second=SETTLED_NS / SECOND_NS - 1.0, a=1, b=1), {}) == []
    later = snapshot(second=5.0, is_last=True, a=1, b=1) if how == "last" else snapshot(second=10.0, a=1, b=1)
    assert joins.due(later, {}) == ([Look(AB, None, is_thorough=True)] if has_thorough else [])
    look(joins, later, *([REFUSED] if has_thorough else []))
    assert joins.due(snapshot(second=99.0, is_last=True, a=1, b=1), {}) == []


def test_maps_that_did_not_change_are_not_searched_quickly_again() -> None:
    joins = Joins()
    first = snapshot(a=1, b=1, c=1)
    look(joins, first, REFUSED, REFUSED, REFUSED)
    settled = snapshot(second=SETTLED_NS / SECOND_NS, a=1, b=1, c=1)
    looks = joins.due(settled, {})
    assert [one.is_thorough for one in looks] == [True] * MAX_THOROUGH
    look(joins, settled, *[REFUSED] * MAX_THOROUGH)
    assert [one.is_thorough for one in joins.due(settled, {})] == [True]


def test_what_confirms_a_candidate_is_searched_as_thoroughly_as_what_found_it() -> None:
    joins = Joins()
    look(joins, snapshot(a=1, b=1), ACCEPTED)
    assert joins.due(snapshot(second=1.0, a=2, b=1), {}) == [Look(AB, None, is_thorough=True)]


@pytest.mark.parametrize(("is_last", "most"), [(False, MAX_THOROUGH), (True, MAX_LAST_THOROUGH)])
def test_thorough_searches_are_bounded(is_last: bool, most: int) -> None:
    joins = Joins()
    for _ in range(6):
        at = snapshot(known=7, r1=1, r2=1, r3=1, r4=1, r5=1, r6=1, r7=1)
        look(joins, at, *[REFUSED] * len(joins.due(at, {})))
    grown = snapshot(20.0, is_last, 60, r1=2, r2=2, r3=2, r4=2, r5=2, r6=2, r7=2)
    looks = joins.due(grown, {})
    assert sum(one.is_thorough for one in looks) == most


def test_a_near_miss_is_searched_again_as_soon_as_a_map_has_grown() -> None:
    joins = Joins()
    look(joins, snapshot(a=1, b=1, known=50), DOUBTFUL)
    assert joins.due(snapshot(second=1.0, a=2, b=1, known=53), {}) == []
    assert joins.due(snapshot(second=1.0, a=3, b=1, known=60), {}) == [Look(AB, None)]


def test_a_join_needs_a_second_look_that_agrees() -> None:
    joins = Joins()
    assert look(joins, snapshot(a=1, b=1), ACCEPTED) == []
    assert not joins.held
    assert look(joins, snapshot(a=2, b=1), ACCEPTED) == ["a and b join"]
    assert joins.held[AB].T_a_b == T


def test_two_looks_that_found_different_transforms_confirm_nothing() -> None:
    joins = Joins()
    look(joins, snapshot(a=1, b=1), ACCEPTED)
    look(joins, snapshot(a=2, b=1), replace(ACCEPTED, T_target_source=SE2(9.0, 2.0, 0.3)))
    assert not joins.held
    look(joins, snapshot(a=3, b=1), replace(ACCEPTED, T_target_source=SE2(9.1, 2.0, 0.3)))
    assert joins.held[AB].T_a_b == SE2(9.1, 2.0, 0.3)


def test_overwhelming_confidence_joins_at_once() -> None:
    joins = Joins()
    assert look(joins, snapshot(a=1, b=1), CERTAIN) == ["a and b join"]


@pytest.mark.parametrize("how", ["last", "settled"])
def test_a_candidate_joins_when_nothing_more_can_confirm_it(how: str) -> None:
    joins = Joins()
    look(joins, snapshot(a=1, b=1), ACCEPTED)
    assert look(joins, snapshot(second=5.0, a=1, b=1)) == []
    later = snapshot(second=SETTLED_NS / SECOND_NS, is_last=how == "last", a=1, b=1)
    assert look(joins, later) == ["a and b join"]


def test_a_refusal_takes_the_candidate_back() -> None:
    joins = Joins()
    look(joins, snapshot(a=1, b=1), ACCEPTED)
    look(joins, snapshot(a=2, b=1), REFUSED)
    assert look(joins, snapshot(second=20.0, a=2, b=1)) == []
    assert not joins.held


def joined() -> Joins:
    joins = Joins()
    look(joins, snapshot(a=1, b=1), CERTAIN)
    return joins


def test_a_join_is_verified_and_refined_from_where_it_stood() -> None:
    joins = joined()
    assert joins.due(snapshot(second=1.0, a=2, b=1), {}) == []
    assert joins.due(snapshot(second=1.0, known=11, a=2, b=1), {}) == []
    assert joins.due(snapshot(second=1.0, known=12, a=2, b=1), {}) == [Look(AB, T, CERTAIN)]
    at = snapshot(second=FOLLOW_NS / SECOND_NS, a=2, b=1)
    assert joins.due(at, {}) == [Look(AB, T, CERTAIN)]
    look(joins, at, replace(ACCEPTED, T_target_source=SE2(1.1, 2.0, 0.3)))
    assert joins.held[AB].T_a_b == SE2(1.1, 2.0, 0.3)


def test_a_join_is_verified_when_walls_came_and_went() -> None:
    joins = joined()
    at = snapshot(second=1.0, a=2, b=1)
    walls = replace(at.grids["a"], num_walls=40)
    for num_turned, is_due in ((10, False), (11, True)):
        grids = {**at.grids, "a": replace(walls, num_turned=num_turned)}
        assert bool(joins.due(replace(at, grids=grids), {})) is is_due


def test_a_join_outlasts_doubt_and_a_single_contradiction() -> None:
    joins = joined()
    for version, fusion in enumerate([DOUBTFUL, DOUBTFUL, REFUSED, DOUBTFUL, REFUSED], start=2):
        assert look(joins, snapshot(second=FOLLOW_NS / SECOND_NS * version, a=version, b=1), fusion) == []
    assert AB in joins.held


def test_contradictions_in_a_row_end_a_join_and_say_why() -> None:
    joins = joined()
    assert look(joins, snapshot(second=FOLLOW_NS / SECOND_NS, a=2, b=1), REFUSED) == []
    assert look(joins, snapshot(second=FOLLOW_NS / SECOND_NS + 1.0, a=3, b=1), REFUSED) == [
        "the join of a and b ends: walls disagree"
    ]
    assert not joins.held
    assert joins.due(snapshot(a=4, b=1), {}) == [Look(AB, None)]


def test_robots_tied_over_others_are_verified_where_those_place_them() -> None:
    joins = Joins()
    placements = {"a": Placement(1, SE2.identity()), "b": Placement(1, T)}
    at = snapshot(a=1, b=1)
    assert joins.due(at, placements) == [Look(AB, T)]
    assert joins.due(at, {"a": Placement(1, T), "b": Placement(2, T)}) == [Look(AB, None)]
    look(joins, at, ACCEPTED, placements=placements)
    assert AB in joins.held


def test_a_place_given_by_others_that_does_not_look_right_is_searched_as_well() -> None:
    joins = Joins()
    placements = {"a": Placement(1, SE2.identity()), "b": Placement(1, T)}
    look(joins, snapshot(a=1, b=1), replace(REFUSED, gate="contradiction", overlap_ratio=0.5), placements=placements)
    assert joins.due(snapshot(a=2, b=1), placements) == [Look(AB, None)]


def test_pairs_that_must_not_join_are_not_looked_at() -> None:
    joins = Joins(never=[frozenset(AB)])
    assert [one.pair for one in joins.due(snapshot(a=1, b=1, c=1), {})] == [("a", "c"), ("b", "c")]


def test_among_many_robots_a_few_pairs_are_searched_at_a_time_and_all_in_the_end() -> None:
    joins, names = Joins(), [f"r{number}" for number in range(8)]
    seen = set()
    for version in range(1, 8):
        versions: dict[str, Any] = dict.fromkeys(names, version)
        at = snapshot(**versions)
        looks = joins.due(at, {})
        assert len(looks) <= MAX_SEARCHES
        for one in looks:
            seen.add(one.pair)
            joins.record(one, REFUSED, at)
    assert len(seen) == 8 * 7 // 2
    assert len(joins.due(snapshot(is_last=True, **dict.fromkeys(names, 9)), {})) == 8 * 7 // 2


def joined_early() -> Joins:
    """Joins with a and b joined by maps of 20 columns."""
    joins = Joins()
    look(joins, snapshot(a=1, b=1, known=20), CERTAIN)
    assert set(joins.held) == {AB}
    return joins


def test_a_join_is_searched_again_when_a_map_has_doubled() -> None:
    joins = joined_early()
    assert [one.T_a_b for one in joins.due(snapshot(second=20.0, a=2, b=1, known=39), {})] == [T]
    assert joins.due(snapshot(second=20.0, a=2, b=1, known=40), {}) == [SEARCH]
    assert look(joins, snapshot(second=20.0, a=2, b=1, known=40), ACCEPTED) == []
    assert set(joins.held) == {AB}
    assert [one.T_a_b for one in joins.due(snapshot(second=90.0, a=3, b=1, known=79), {})] == [T]


def test_a_join_that_the_last_look_did_not_find_right_is_searched_thoroughly() -> None:
    joins = joined_early()
    look(joins, snapshot(second=5.0, a=2, b=1, known=23), DOUBTFUL)
    assert joins.due(snapshot(second=20.0, a=3, b=1, known=24), {}) == [THOROUGH]
    assert [one.T_a_b for one in joins.due(snapshot(second=9.0, a=3, b=1, known=26), {})] == [T]
    assert joins.due(snapshot(second=9.0, is_last=True, a=3, b=1, known=24), {}) == [THOROUGH]
    look(joins, snapshot(second=20.0, a=3, b=1, known=24), ACCEPTED)
    assert [one.T_a_b for one in joins.due(snapshot(second=60.0, a=4, b=1, known=28), {})] == [T]


def test_a_search_that_puts_a_joined_pair_elsewhere_ends_the_join_and_is_a_candidate() -> None:
    joins = joined_early()
    grown = snapshot(second=20.0, a=2, b=1, known=40)
    assert look(joins, grown, ELSEWHERE) == ["the join of a and b ends: a search puts them elsewhere"]
    assert joins.held == {}
    assert look(joins, snapshot(second=21.0, a=3, b=1, known=40), ELSEWHERE) == ["a and b join"]
    assert joins.held[AB].T_a_b == ELSEWHERE.T_target_source


def test_a_search_of_a_joined_pair_that_finds_nothing_leaves_it() -> None:
    joins = joined_early()
    for second, known in ((20.0, 40), (40.0, 80)):
        assert look(joins, snapshot(second=second, a=int(second), b=1, known=known), REFUSED) == []
    assert set(joins.held) == {AB}


def test_two_ambiguous_searches_in_a_row_end_a_join_and_say_why() -> None:
    joins = joined_early()
    assert look(joins, snapshot(second=20.0, a=2, b=1, known=40), AMBIGUOUS) == []
    assert joins.due(snapshot(second=40.0, a=3, b=1, known=45), {}) == [THOROUGH]
    ended = look(joins, snapshot(second=40.0, a=3, b=1, known=45), AMBIGUOUS)
    assert ended == ["the join of a and b ends: walls disagree"]
    assert joins.held == {}


def test_a_search_that_finds_the_join_again_forgets_an_ambiguous_one() -> None:
    joins = joined_early()
    for number, fusion in enumerate((AMBIGUOUS, REPEATING, AMBIGUOUS), 2):
        assert look(joins, snapshot(second=20.0 * number, a=number, b=1, known=20 * number), fusion) == []
    assert set(joins.held) == {AB}


def test_where_maps_repeat_themselves_a_second_look_confirms_what_it_saw_more_of() -> None:
    joins = Joins()
    certain = replace(REPEATING, confidence=OVERWHELMING)
    assert look(joins, snapshot(a=1, b=1, known=20), certain) == []
    assert joins.due(snapshot(second=9.0, a=2, b=1, known=39), {}) == []
    assert look(joins, snapshot(second=10.0, a=2, b=1, known=39), certain) == []
    assert look(joins, snapshot(second=20.0, a=3, b=1, known=44), certain) == ["a and b join"]
    # From then on growth asks for a search.
    assert joins.due(snapshot(second=30.0, a=4, b=1, known=49), {}) == [THOROUGH]


def test_a_different_find_starts_the_wait_anew() -> None:
    joins = Joins()
    elsewhere = replace(ELSEWHERE, evidence=ALIKE)
    for number, (known, fusion) in enumerate(((20, REPEATING), (30, elsewhere), (50, elsewhere)), 1):
        assert look(joins, snapshot(second=20.0 * number, a=number, b=1, known=known), fusion) == []
    assert look(joins, snapshot(second=80.0, a=9, b=1, known=60), elsewhere) == ["a and b join"]


def test_a_repeating_candidate_joins_when_no_map_changes_and_not_when_nobody_had_time_for_it() -> None:
    settled = SETTLED_NS / SECOND_NS
    for version, expected in ((1, ["a and b join"]), (2, [])):
        joins = Joins()
        look(joins, snapshot(a=1, b=1, known=20), REPEATING)
        at = snapshot(second=settled, a=version, b=1, known=21)
        assert [joins.join(*ripe, at) for ripe in joins.ripe(at).items()] == expected


def test_what_maps_repeat_is_remembered_until_a_search_asks_again() -> None:
    joins = Joins()
    look(joins, snapshot(a=1, b=1, known=20), REPEATING)
    assert look(joins, snapshot(second=20.0, a=2, b=1, known=30), CERTAIN) == []
    apart = replace(CERTAIN, evidence={"recurring": 0.1})
    assert look(joins, snapshot(second=40.0, a=3, b=1, known=35), apart) == ["a and b join"]


def test_a_candidate_is_searched_and_not_verified_where_others_place_the_two() -> None:
    joins = joined_early()
    look(joins, snapshot(second=20.0, a=2, b=1, known=40), ELSEWHERE)
    placements = {"a": Placement(1, SE2.identity()), "b": Placement(1, T)}
    assert joins.due(snapshot(second=21.0, a=3, b=1, known=40), placements) == [THOROUGH]


def test_a_contradicted_join_is_verified_first() -> None:
    joins = joined_early()
    look(joins, snapshot(second=5.0, a=2, b=1, known=23), REFUSED)
    last = snapshot(second=20.0, is_last=True, a=3, b=1, known=60)
    assert [one.T_a_b for one in joins.due(last, {})] == [T]
    assert look(joins, last, REFUSED) == ["the join of a and b ends: walls disagree"]


def test_an_old_map_says_nothing_against_a_join() -> None:
    joins = Joins()
    certain = replace(REPEATING, confidence=OVERWHELMING)
    for number, known in enumerate((20, 40), 1):
        look(joins, snapshot(second=20.0 * number, a=number, b=1, known=known), certain)
    old = PairFusion(accepted=False, reason="too old", gate="old map")
    for number, known in enumerate((50, 60, 70), 3):
        assert look(joins, snapshot(second=20.0 * number, a=number, b=1, known=known), old) == []
    assert set(joins.held) == {AB}


def test_robots_of_maps_that_repeat_themselves_are_not_joined_by_a_look_at_where_others_place_them() -> None:
    joins = Joins()
    look(joins, snapshot(a=1, b=1, known=20), REPEATING)
    look(joins, snapshot(second=10.0, a=2, b=1, known=25), REFUSED)
    placements = {"a": Placement(1, SE2.identity()), "b": Placement(1, T)}
    later = snapshot(second=60.0, a=3, b=1, known=30)
    assert [one.T_a_b for one in joins.due(later, placements)] == [T]
    look(joins, later, ACCEPTED, placements=placements)
    assert joins.held == {}


def test_a_fusion_is_held_back_where_its_like_fits_nearly_as_well() -> None:
    assert held_back(REPEATING) is REPEATING
    assert held_back(ACCEPTED) is ACCEPTED
    assert held_back(REFUSED) is REFUSED
    near = replace(ACCEPTED, evidence={"recurring": 0.9, "like_fit": -0.5})
    refused = held_back(near)
    assert (refused.accepted, refused.gate) == (False, "alike")
    assert "90% of the walls that agree have their like elsewhere in the same map" in refused.reason
    assert refused.T_target_source == near.T_target_source
    assert refused.confidence == 0.5
    assert held_back(replace(near, evidence={"recurring": 0.3, "like_fit": -0.5})).accepted
    assert held_back(replace(near, evidence={"recurring": 0.9})).accepted
