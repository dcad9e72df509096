import pytest

from mapfusion.groups import MAX_STEP_M, REPLACED_M, Groups
from mapfusion.posegraph import Edge, Pair
from mapfusion.steps import Placement
from mapfusion.transform import SE2


def join(x_m: float = 1.0, y_m: float = 0.0, yaw_rad: float = 0.0, confidence: float = 0.9) -> Edge:
    return Edge(SE2(x_m, y_m, yaw_rad), confidence)


def updated(
    groups: Groups, joins: dict[Pair, Edge], reference: str | None = None
) -> tuple[dict[str, Placement], tuple[str, ...]]:
    update = groups.update(joins, reference)
    return dict(update.placements), update.changes


def test_a_group_lives_in_the_frame_of_its_first_robot() -> None:
    placements, changes = updated(Groups(), {("r2", "r10"): join(3.0, 4.0, 0.5)})
    assert list(placements) == ["r2", "r10"]
    assert placements["r2"].T_group_map == SE2.identity()
    assert placements["r10"].T_group_map == SE2(3.0, 4.0, 0.5)
    assert changes == ("group 1 formed: r2, r10",)


def test_the_preferred_reference_is_the_frame_of_its_group_only() -> None:
    placements, _ = updated(Groups(), {("r1", "r2"): join(1.0), ("r3", "r4"): join(2.0)}, "r2")
    assert placements["r2"].T_group_map == SE2.identity()
    assert placements["r1"].T_group_map == SE2(-1.0, 0.0, 0.0)
    assert placements["r3"].T_group_map == SE2.identity()


@pytest.mark.parametrize("others", [{}, {("r1", "r4"): join(7.0)}])
def test_a_group_moves_into_the_frame_of_the_preferred_reference_at_once_and_says_so(others: dict[Pair, Edge]) -> None:
    groups = Groups()
    updated(groups, {("r2", "r3"): join(3.0)}, "r1")
    updated(groups, {("r2", "r3"): join(3.0), **others}, "r1")
    placements, changes = updated(groups, {("r2", "r3"): join(3.0), **others, ("r1", "r2"): join(5.0)}, "r1")
    assert {placement.group for placement in placements.values()} == {1}
    assert placements["r1"].T_group_map == SE2.identity()
    assert placements["r3"].T_group_map.distance_to(SE2(8.0, 0.0, 0.0))[0] < 1e-9
    assert "group 1 lives in the map frame of r1 from now on" in changes


def test_a_robot_that_joins_later_does_not_move_the_frame_though_it_comes_first() -> None:
    groups = Groups()
    updated(groups, {("r2", "r3"): join()})
    placements, changes = updated(groups, {("r2", "r3"): join(), ("r1", "r2"): join(5.0)})
    assert placements["r2"].T_group_map == SE2.identity()
    assert placements["r1"].T_group_map == SE2(-5.0, 0.0, 0.0)
    assert changes == ("joined group 1: r1",)


def test_groups_that_meet_take_the_lower_number_and_no_number_is_used_again() -> None:
    groups = Groups()
    placements, _ = updated(groups, {("r1", "r2"): join(), ("r3", "r4"): join()})
    assert {robot: placement.group for robot, placement in placements.items()} == {"r1": 1, "r2": 1, "r3": 2, "r4": 2}
    placements, changes = updated(groups, {("r1", "r2"): join(), ("r3", "r4"): join(), ("r2", "r3"): join()})
    assert {placement.group for placement in placements.values()} == {1}
    assert placements["r4"].T_group_map == SE2(3.0, 0.0, 0.0)
    assert changes == ("joined group 1: r3, r4", "group 2 ended: r3, r4")
    placements, _ = updated(groups, {("r1", "r2"): join(), ("r5", "r6"): join()})
    assert placements["r5"].group == 3


def test_a_group_that_parts_leaves_its_number_with_the_reference() -> None:
    groups = Groups()
    updated(groups, {("r1", "r2"): join(), ("r2", "r3"): join(), ("r3", "r4"): join()})
    placements, changes = updated(groups, {("r1", "r2"): join(), ("r3", "r4"): join()})
    assert {robot: placement.group for robot, placement in placements.items()} == {"r1": 1, "r2": 1, "r3": 2, "r4": 2}
    assert changes == ("left group 1: r3, r4", "group 2 formed: r3, r4")


def test_a_join_that_contradicts_the_others_places_nobody_and_is_named() -> None:
    joins = {("a", "b"): join(1.0, confidence=0.9), ("b", "c"): join(1.0, confidence=0.8)}
    update = Groups().update(joins | {("a", "c"): join(50.0, confidence=0.7)})
    assert update.placements["c"].T_group_map.distance_to(SE2(2.0, 0.0, 0.0))[0] < 1e-9
    assert update.dropped[("a", "c")].distance_m == pytest.approx(48.0)


def test_an_unchanged_group_moves_in_small_steps() -> None:
    groups = Groups()
    groups.update({("a", "b"): join(0.0)})
    positions = []
    for _ in range(5):
        placements, changes = updated(groups, {("a", "b"): join(0.9)})
        assert not changes
        positions.append(placements["b"].T_group_map.x_m)
    steps = [after - before for before, after in zip([0.0, *positions], positions, strict=False)]
    assert max(steps) <= MAX_STEP_M + 1e-9
    assert positions[-1] == pytest.approx(0.9)


def test_a_robot_found_to_be_elsewhere_leaves_and_comes_back_there() -> None:
    groups = Groups()
    tied = {("a", "b"): join(0.0), ("b", "c"): join(1.0)}
    groups.update(tied)
    placements, changes = updated(groups, tied | {("b", "c"): join(2.0 + REPLACED_M)})
    assert list(placements) == ["a", "b"]
    assert changes == ("left group 1: c",)
    placements, changes = updated(groups, tied | {("b", "c"): join(2.0 + REPLACED_M)})
    assert placements["c"].T_group_map.x_m == pytest.approx(2.0 + REPLACED_M)
    assert changes == ("joined group 1: c",)
