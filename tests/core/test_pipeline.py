import math
from dataclasses import replace

import numpy as np
import pytest

from mapfusion.config import FusionConfig, Prior, ReplayConfig
from mapfusion.pipeline import replay
from mapfusion.steps import Event, FusionStep
from mapfusion.transform import SE2
from tests.fakes import SECOND_NS, StillPoses, flat, grid_event, grid_of, robot_event, rooms, seen_from

PLACE = rooms()
T_PLACE_A, T_PLACE_B = SE2(1.0, 2.0, 0.2), SE2(4.0, 9.0, -0.6)
T_A_B = T_PLACE_A.inverse() @ T_PLACE_B
MAP_A, MAP_B = (seen_from(PLACE, pose, (260, 260)) for pose in (T_PLACE_A, T_PLACE_B))
PAPER = ReplayConfig(fusion=FusionConfig(profile="paper"))


def mission() -> list[Event]:
    poses = StillPoses(SE2(3.0, 2.0, 1.0), [0, 6 * SECOND_NS])
    return [
        robot_event("a", poses),
        robot_event("b", poses),
        robot_event("c"),
        grid_event("c", 0.0, grid_of(flat(40, 40))),
        grid_event("a", 1.0, MAP_A),
        grid_event("b", 2.0, MAP_B),
        grid_event("a", 4.0, MAP_A),
    ]


@pytest.fixture(scope="module")
def steps() -> list[FusionStep]:
    return list(replay(mission(), PAPER))


def test_robots_are_placed_when_their_maps_join(steps: list[FusionStep]) -> None:
    assert [step.stamp_ns // SECOND_NS for step in steps] == [0, 1, 2, 3, 4, 5, 6]
    assert [sorted(step.placements) for step in steps] == [[], [], [], [], *[["a", "b"]] * 3]
    distance_m, angle_rad = steps[-1].placements["b"].T_group_map.distance_to(T_A_B)
    assert distance_m < 0.2
    assert angle_rad < 0.02
    assert [step.changes for step in steps if step.changes] == [("a and b join", "group 1 formed: a, b")]


def test_pairs_are_looked_at_only_when_a_map_changed(steps: list[FusionStep]) -> None:
    looked = [[(report.a, report.b) for report in step.pairs] for step in steps]
    assert looked == [[], [("a", "c")], [("a", "b"), ("b", "c")], [], [("a", "b")], [], [("a", "c")]]
    found, confirmed = steps[2].pairs[0], steps[4].pairs[0]
    assert (found.age_a_s, found.age_b_s, found.placed) == (1.0, 0.0, False)
    assert (confirmed.age_a_s, confirmed.age_b_s, confirmed.placed) == (0.0, 2.0, True)


def test_poses_and_paths_are_in_the_groups_frame(steps: list[FusionStep]) -> None:
    pose = steps[-1].poses["b"]
    expected = T_A_B @ SE2(3.0, 2.0, 1.0)
    distance_m, angle_rad = pose.distance_to(expected)
    assert distance_m < 0.2
    assert angle_rad < 0.02
    assert not steps[1].poses
    path = steps[-1].paths["b"]
    assert path.stamps_ns.tolist() == [0, 6 * SECOND_NS]
    np.testing.assert_allclose(path.poses[0], [pose.x_m, pose.y_m, pose.yaw_rad], atol=1e-9)
    assert all(not step.paths for step in steps[:-1])


def test_maps_come_when_they_changed_at_most_every_interval_and_at_the_end(steps: list[FusionStep]) -> None:
    assert [step.stamp_ns // SECOND_NS for step in steps if step.maps] == [4, 6]
    growing = [*mission(), grid_event("b", 5.0, MAP_B)]
    often = list(replay(growing, replace(PAPER, map_interval_s=0.0)))
    assert [step.stamp_ns // SECOND_NS for step in often if step.maps] == [4, 5, 6]


def test_jobs_do_not_change_the_result(steps: list[FusionStep]) -> None:
    threaded = list(replay(mission(), replace(PAPER, jobs=3)))
    assert [step.placements for step in threaded] == [step.placements for step in steps]


def test_an_old_map_starts_no_join() -> None:
    events: list[Event] = [
        robot_event("a"),
        robot_event("b"),
        grid_event("a", 0.0, MAP_A),
        grid_event("b", 20.0, MAP_B),
    ]
    late = list(replay(events, replace(PAPER, max_age_s=5.0)))
    assert not late[-1].placements
    assert late[-1].pairs[0].fusion.gate == "old map"
    assert list(replay(events, PAPER))[-1].placements


def test_a_map_replaced_by_another_places_parts_the_robots() -> None:
    other = [seen_from(rooms(seed=seed), T_PLACE_A, (260, 260)) for seed in (5, 6, 7)]
    events = [*mission(), *(grid_event("a", 10.0 + 6.0 * i, grid) for i, grid in enumerate(other))]
    steps = list(replay(events))
    assert steps[6].placements
    assert not steps[-1].placements
    assert any("the join of a and b ends" in change for step in steps for change in step.changes)


def test_a_known_start_ties_robots_without_any_overlap() -> None:
    start = Prior(SE2(3.0, 4.0, 0.5))
    *_, last = replay(mission(), replace(PAPER, priors={"c": start}))
    assert last.placements["c"].T_group_map == SE2(3.0, 4.0, 0.5)
    assert set(last.placements) == {"a", "b", "c"}


def test_a_known_start_is_relative_to_the_first_robot_though_others_have_maps_before_it() -> None:
    events: list[Event] = [
        *(robot_event(robot) for robot in "abc"),
        grid_event("c", 0.0, grid_of(flat(40, 40))),
        grid_event("b", 1.0, MAP_B),
        grid_event("a", 4.0, MAP_A),
    ]
    steps = list(replay(events, replace(PAPER, priors={"c": Prior(SE2(3.0, 4.0, 0.5))})))
    assert not any(step.placements for step in steps[:4])
    assert steps[-1].placements["a"].T_group_map == SE2.identity()
    assert steps[-1].placements["c"].T_group_map == SE2(3.0, 4.0, 0.5)


def test_the_world_of_known_starts_is_the_first_robots_though_others_joined_before_it() -> None:
    events: list[Event] = [
        *(robot_event(robot) for robot in "abc"),
        grid_event("b", 0.0, MAP_A),
        grid_event("c", 0.0, MAP_B),
        grid_event("c", 12.0, MAP_B),
        grid_event("a", 14.0, grid_of(flat(40, 40))),
    ]
    steps = list(replay(events, replace(PAPER, priors={"b": Prior(SE2(3.0, 4.0, 0.5))})))
    assert sorted(steps[13].placements) == ["b", "c"]
    assert steps[-1].placements["a"].T_group_map == SE2.identity()
    assert steps[-1].placements["b"].T_group_map == SE2(3.0, 4.0, 0.5)


def test_a_pair_that_must_not_join_does_not() -> None:
    *_, last = replay(mission(), replace(PAPER, never=frozenset({frozenset({"a", "b"})})))
    assert not last.placements


def test_a_join_that_would_bring_robots_together_that_must_not_is_refused_by_name() -> None:
    apart = frozenset({frozenset({"b", "c"})})
    events: list[Event] = [
        *(robot_event(robot) for robot in "abc"),
        grid_event("a", 0.0, MAP_A),
        grid_event("b", 0.0, MAP_B),
        grid_event("b", 2.0, MAP_B),
        *(grid_event("c", 4.0 + second, MAP_B) for second in range(0, 40, 4)),
    ]
    steps = list(replay(events, replace(PAPER, never=apart)))
    assert [change for step in steps for change in step.changes] == [
        "a and b join",
        "group 1 formed: a, b",
        "a and c join",
        "a and c are held apart: it would bring b and c into one group, which must not be (--never)",
    ]
    assert sorted(steps[-1].placements) == ["a", "b"]
    (refused,) = (report for report in steps[-1].pairs if (report.a, report.b) == ("a", "c"))
    assert (refused.fusion.accepted, refused.fusion.gate) == (False, "never")
    assert "b and c" in refused.fusion.reason
    free = list(replay(events, PAPER))
    assert sorted(free[-1].placements) == ["a", "b", "c"]


def test_a_robot_that_was_held_apart_joins_when_the_other_leaves() -> None:
    other = [seen_from(rooms(seed=seed), T_PLACE_B, (260, 260)) for seed in (5, 6, 7, 8)]
    events: list[Event] = [
        *(robot_event(robot) for robot in "abc"),
        grid_event("a", 0.0, MAP_A),
        grid_event("b", 0.0, MAP_B),
        grid_event("c", 20.0, MAP_B),
        *(grid_event("b", 50.0 + 40.0 * i, grid) for i, grid in enumerate(other)),
    ]
    steps = list(replay(events, ReplayConfig(interval_s=2.0, never=frozenset({frozenset({"b", "c"})}))))
    changes = [change for step in steps for change in step.changes]
    assert changes.index("left group 1: b") == changes.index("joined group 1: c") + 1
    assert sorted(steps[-1].placements) == ["a", "c"]


def test_of_two_joins_at_once_the_more_confident_one_holds_where_both_must_not() -> None:
    events: list[Event] = [
        *(robot_event(robot) for robot in "abc"),
        grid_event("a", 0.0, MAP_A),
        grid_event("b", 0.0, seen_from(PLACE, T_PLACE_B, (110, 260))),
        grid_event("c", 0.0, MAP_B),
    ]
    free = {(report.a, report.b): report.fusion for report in list(replay(events))[-1].pairs}
    assert free["a", "b"].accepted
    assert free["a", "b"].confidence < free["a", "c"].confidence
    *_, last = replay(events, ReplayConfig(never=frozenset({frozenset({"b", "c"})})))
    assert sorted(last.placements) == ["a", "c"]


def test_a_join_that_a_known_start_puts_an_end_to_is_named_and_bars_nobody_else() -> None:
    events: list[Event] = [
        *(robot_event(robot) for robot in "abcd"),
        grid_event("a", 0.0, MAP_A),
        grid_event("b", 0.0, MAP_B),
        grid_event("b", 12.0, MAP_B),
        grid_event("c", 20.0, grid_of(flat(40, 40))),
        grid_event("d", 30.0, MAP_B),
    ]
    apart = frozenset({frozenset({"b", "c"})})
    steps = list(replay(events, replace(PAPER, priors={"c": Prior(SE2(3.0, 4.0, 0.5))}, never=apart)))
    changes = [change for step in steps for change in step.changes]
    assert "a and b are held apart: it would bring b and c into one group, which must not be (--never)" in changes
    groups = {robot: placement.group for robot, placement in steps[-1].placements.items()}
    assert groups["a"] == groups["c"]
    assert "d" in groups
    assert groups.get("b") != groups["c"]


def test_known_starts_of_two_that_must_not_join_are_refused() -> None:
    starts = {"a": Prior(SE2.identity()), "b": Prior(SE2(1.0, 2.0, 0.0))}
    with pytest.raises(ValueError, match="a and b"):
        ReplayConfig(priors=starts, never=frozenset({frozenset({"a", "b"})}))
    with pytest.raises(ValueError, match="a and b"):
        ReplayConfig(priors={"b": starts["b"]}, reference="a", never=frozenset({frozenset({"a", "b"})}))
    soft = {"a": Prior(SE2.identity()), "b": Prior(SE2(1.0, 2.0, 0.0), 0.5, 0.1)}
    assert ReplayConfig(priors=soft, never=frozenset({frozenset({"a", "b"})})).priors == soft


def test_spans_are_finite() -> None:
    with pytest.raises(ValueError, match="map_interval_s"):
        ReplayConfig(map_interval_s=math.inf)
    with pytest.raises(ValueError, match="max_age_s"):
        ReplayConfig(max_age_s=math.inf)


def test_a_robot_far_away_is_left_out_of_the_merged_map_and_named() -> None:
    far = replace(PAPER, priors={"c": Prior(SE2(1e5, 0.0, 0.0))}, max_merged_cells=1_000_000)
    events = [*mission(), grid_event("c", 5.0, grid_of(flat(40, 40, 0)))]
    *_, last = replay(events, far)
    *_, near = replay(events, PAPER)
    assert last.left_out == {1: ("c",)}
    assert near.left_out == {}
    np.testing.assert_array_equal(last.maps[1].cells, near.maps[1].cells)
    assert last.placements["c"].T_group_map == SE2(1e5, 0.0, 0.0)


def test_no_merged_map_where_no_robot_fits() -> None:
    *_, last = replay(mission(), replace(PAPER, max_merged_cells=100))
    assert (last.maps, last.left_out) == ({}, {1: ("a", "b")})
