"""Whole simulated missions against their truth, small enough for every run; benchmarks/missions.py has larger ones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations, pairwise

import cv2
import numpy as np
import pytest

from mapfusion.grid import Mask
from mapfusion.pairwise.agreement import agreement
from mapfusion.pipeline import replay
from mapfusion.simulation.events import mission_events
from mapfusion.simulation.floor_plan import random_floor_plan
from mapfusion.simulation.messages import Mission
from mapfusion.simulation.mission import simulate_mission
from mapfusion.simulation.mission_config import MissionConfig, generator
from mapfusion.simulation.plan import PLAN_RESOLUTION_M
from mapfusion.steps import Event, FusionStep, GridEvent
from mapfusion.transform import SE2, FloatArray
from tests.fakes import SECOND_NS


@pytest.fixture(scope="module")
def mission() -> Mission:
    """Five robots in two buildings."""
    return simulate_mission(MissionConfig(seed=41, num_robots=5, num_buildings=2, duration_s=60.0, overlap=0.7))


@pytest.fixture(scope="module")
def steps(mission: Mission) -> list[FusionStep]:
    return list(replay(mission_events(mission)))


def test_groups_form_inside_each_building_and_never_across(mission: Mission, steps: list[FusionStep]) -> None:
    building = {robot.name: robot.building for robot in mission.robots}
    for step in steps:
        for a, b in combinations(step.placements, 2):
            together = step.placements[a].group == step.placements[b].group
            assert not together or building[a] == building[b]
    assert len({placement.group for placement in steps[-1].placements.values()}) == 2


def test_no_robot_is_ever_placed_wrongly(mission: Mission, steps: list[FusionStep]) -> None:
    T_world = {robot.name: robot.T_world_map for robot in mission.robots}
    for step in steps:
        for a, b in combinations(step.placements, 2):
            if step.placements[a].group == step.placements[b].group:
                found = step.placements[a].T_group_map.inverse() @ step.placements[b].T_group_map
                distance_m, angle_rad = found.distance_to(T_world[a].inverse() @ T_world[b])
                assert distance_m < 0.5, (step.stamp_ns, a, b)
                assert math.degrees(angle_rad) < 5.0, (step.stamp_ns, a, b)


def test_the_world_never_moves_and_nobody_jumps(steps: list[FusionStep]) -> None:
    for before, after in pairwise(steps):
        groups = [{robot: p.group for robot, p in step.placements.items()} for step in (before, after)]
        for number in set(groups[1].values()):
            members = [p.T_group_map for p in after.placements.values() if p.group == number]
            assert members.count(SE2.identity()) == 1
        if groups[0] == groups[1]:
            for robot, placement in after.placements.items():
                assert placement.T_group_map.distance_to(before.placements[robot].T_group_map)[0] <= 0.3


def test_every_pair_that_was_refused_has_a_reason(steps: list[FusionStep]) -> None:
    reports = [report for step in steps for report in step.pairs]
    assert reports
    for report in reports:
        assert bool(report.fusion.reason) != report.fusion.accepted
        assert report.fusion.mae is None or 0.0 <= report.fusion.mae <= 255.0


def test_a_join_is_withdrawn_when_one_map_is_replaced_by_another_buildings() -> None:
    ours, others = (
        list(mission_events(simulate_mission(MissionConfig(seed=seed, num_robots=2, duration_s=60.0, overlap=0.8))))
        for seed in (17, 18)
    )
    replaced_ns = maps_of(ours, "robot2")[6].stamp_ns
    theirs = maps_of(others, "robot2")[-1].grid
    events = [
        replace(event, grid=theirs)
        if isinstance(event, GridEvent) and event.robot == "robot2" and event.stamp_ns >= replaced_ns
        else event
        for event in ours
    ]
    steps = list(replay(events))
    joined = [step.stamp_ns for step in steps if len(step.placements) == 2]
    assert joined[0] < replaced_ns
    assert joined[-1] < replaced_ns + 15 * SECOND_NS
    assert any(change.startswith("the join of robot1 and robot2 ends") for step in steps for change in step.changes)


def test_the_merged_map_has_the_walls_of_the_place_and_no_others() -> None:
    """Against the floor plan: walls that some beam hit, within 2 cells."""
    config = MissionConfig(seed=2, num_robots=2, duration_s=60.0, overlap=0.7)
    mission = simulate_mission(config)
    recorded = list(mission_events(mission))
    *_, last = replay(recorded)
    assert set(last.placements) == {"robot1", "robot2"}
    own = {event.robot: event.grid for event in recorded if isinstance(event, GridEvent)}
    T_world = {robot.name: robot.T_world_map for robot in mission.robots}
    plan = random_floor_plan(generator(config, "plan", 0)).occupied
    merged = raster(plan.shape, T_world["robot1"].apply(last.maps[1].centres_m(last.maps[1].walls)))
    hit = np.logical_or.reduce([raster(plan.shape, T_world[r].apply(own[r].centres_m(own[r].walls))) for r in own])
    seen = plan & near(hit, 1.5)
    assert np.mean(near(plan, 2.0)[merged]) >= 0.95
    assert np.mean(near(merged, 2.0)[seen]) >= 0.95
    for robot, grid in own.items():
        mae = agreement(last.maps[1], grid, last.placements[robot].T_group_map).mae
        assert mae is not None
        assert mae < 10.0


def maps_of(events: Sequence[Event], robot: str) -> list[GridEvent]:
    """A robot's maps."""
    return [event for event in events if isinstance(event, GridEvent) and event.robot == robot]


def raster(shape: tuple[int, ...], points_m: FloatArray) -> Mask:
    """Mask of the plan's cells in which points lie."""
    cells = np.floor(points_m / PLAN_RESOLUTION_M).astype(int)
    cells = cells[((cells >= 0) & (cells < [shape[1], shape[0]])).all(axis=1)]
    mask = np.zeros(shape, np.bool_)
    mask[cells[:, 1], cells[:, 0]] = True
    return mask


def near(mask: Mask, distance_cells: float) -> Mask:
    """Cells within a distance of the mask."""
    return np.less_equal(cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5), distance_cells)
