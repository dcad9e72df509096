from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from mapfusion.grid import OccupancyGrid, apply_update
from mapfusion.simulation.lidar import LidarConfig
from mapfusion.simulation.messages import MapMessage, MapUpdateMessage, Mission, MissionMessage, PoseMessage
from mapfusion.simulation.mission import simulate_mission
from mapfusion.simulation.mission_config import MissionConfig
from mapfusion.transform import SE2

SHORT = MissionConfig(
    seed=3, num_robots=2, duration_s=12.0, map_period_s=2.0, pose_period_s=0.25, lidar=LidarConfig(num_beams=360)
)


@cache
def mission_of(config: MissionConfig) -> tuple[Mission, tuple[MissionMessage, ...]]:
    mission = simulate_mission(config)
    return mission, tuple(mission.messages())


def last_maps(messages: tuple[MissionMessage, ...]) -> dict[str, OccupancyGrid]:
    return {message.robot: message.grid for message in messages if isinstance(message, MapMessage)}


def test_messages_come_in_order_and_at_their_periods() -> None:
    mission, messages = mission_of(SHORT)
    stamps = [message.stamp_ns for message in messages]
    assert stamps == sorted(stamps)
    for robot in mission.robots:
        poses = [m.stamp_ns for m in messages if isinstance(m, PoseMessage) and m.robot == robot.name]
        maps = [m.stamp_ns for m in messages if isinstance(m, MapMessage) and m.robot == robot.name]
        assert poses == robot.trajectory.stamps_ns.tolist()
        assert poses[-1] - poses[0] == 12_000_000_000
        assert maps[-1] == poses[-1]
        assert np.diff(maps[:-1]) == pytest.approx(2e9, abs=0.26e9)
    assert mission.robots[0].trajectory.stamps_ns[0] != mission.robots[1].trajectory.stamps_ns[0]


def test_maps_of_two_robots_agree_under_the_true_transforms() -> None:
    mission, messages = mission_of(SHORT)
    a, b = mission.robots
    assert abs(a.T_world_map.yaw_rad - b.T_world_map.yaw_rad) > 0.1
    maps = last_maps(messages)
    grid = maps[a.name]
    T_a_b = a.T_world_map.inverse() @ b.T_world_map
    walls_m = (grid.T_frame_grid.inverse() @ T_a_b).apply(maps[b.name].centres_m(maps[b.name].walls))
    cols, rows = np.floor(walls_m / grid.resolution_m).astype(int).T
    inside = (rows >= 2) & (rows < grid.height - 2) & (cols >= 2) & (cols < grid.width - 2)
    window = range(-2, 3)
    around = np.stack([grid.cells[rows[inside] + i, cols[inside] + j] for i in window for j in window])
    wall_of_both, free_for_the_other = (around == 100).any(axis=0), (around == 0).all(axis=0)
    assert wall_of_both.sum() > 200
    assert free_for_the_other.sum() < 0.02 * wall_of_both.sum()


def test_poses_are_those_of_the_truth() -> None:
    mission, messages = mission_of(SHORT)
    for robot in mission.robots:
        poses = [m for m in messages if isinstance(m, PoseMessage) and m.robot == robot.name]
        for pose, (x_m, y_m, yaw_rad) in zip(poses, robot.trajectory.poses, strict=True):
            in_world = robot.T_world_map @ pose.T_map_odom @ pose.T_odom_base
            assert max(in_world.distance_to(SE2(x_m, y_m, yaw_rad))) < 1e-9
        drift = poses[-1].T_map_odom.distance_to(poses[0].T_map_odom)
        assert 1e-4 < max(drift) < 1.0
    assert not mission.exact_odometry


def test_exact_odometry_never_moves() -> None:
    mission, messages = mission_of(replace(SHORT, odometry_noise=0.0))
    assert mission.exact_odometry
    assert {m.T_map_odom for m in messages if isinstance(m, PoseMessage)} == {SE2.identity()}


def test_grids_grow_and_their_origins_move() -> None:
    mission, messages = mission_of(replace(SHORT, seed=1, duration_s=30.0, num_robots=1))
    grids = [m.grid for m in messages if isinstance(m, MapMessage)]
    assert grids[-1].cells.size > grids[0].cells.size
    assert len({grid.T_frame_grid for grid in grids}) > 1
    assert all(grid.frame_id == mission.robots[0].map_frame for grid in grids)


def test_updates_make_the_map_that_whole_maps_give() -> None:
    _, messages = mission_of(replace(SHORT, updates=True))
    _, whole = mission_of(SHORT)
    current: dict[str, OccupancyGrid] = {}
    num_updates = 0
    for message in messages:
        if isinstance(message, MapMessage):
            current[message.robot] = message.grid
        elif isinstance(message, MapUpdateMessage):
            grid = current[message.robot]
            current[message.robot] = apply_update(grid, message.col, message.row, message.cells, message.stamp_ns)
            num_updates += 1
    assert num_updates > 4
    for robot, grid in last_maps(whole).items():
        np.testing.assert_array_equal(current[robot].cells, grid.cells)


def test_same_seed_same_messages_another_seed_other_ones() -> None:
    config = replace(SHORT, duration_s=3.0)
    mission = simulate_mission(config)
    first, again = (last_maps(tuple(mission.messages())) for _ in range(2))
    for robot in ("robot1", "robot2"):
        np.testing.assert_array_equal(first[robot].cells, again[robot].cells)
    assert simulate_mission(config).robots[0].T_world_map == mission.robots[0].T_world_map
    assert simulate_mission(replace(config, seed=4)).robots[0].T_world_map != mission.robots[0].T_world_map


def test_one_robot_more_changes_nothing_for_the_others() -> None:
    config = replace(SHORT, duration_s=3.0)
    two, three = simulate_mission(config), simulate_mission(replace(config, num_robots=3))
    for before, after in zip(two.robots, three.robots, strict=False):
        np.testing.assert_array_equal(before.trajectory.poses, after.trajectory.poses)


def test_resolutions_and_probabilities() -> None:
    config = replace(SHORT, duration_s=2.0, resolutions_m=(0.05, 0.1), graded=True)
    maps = last_maps(mission_of(config)[1])
    assert [maps[robot].resolution_m for robot in ("robot1", "robot2")] == [0.05, 0.1]
    assert all(len(np.unique(grid.cells)) > 4 for grid in maps.values())


def test_robots_are_dealt_out_to_the_buildings() -> None:
    mission = simulate_mission(replace(SHORT, num_robots=3, num_buildings=2, duration_s=2.0))
    assert [(robot.name, robot.building) for robot in mission.robots] == [("robot1", 0), ("robot2", 1), ("robot3", 0)]


@pytest.mark.parametrize(
    "wrong",
    [
        {"seed": -1},
        {"num_robots": 0},
        {"num_buildings": 4},
        {"duration_s": 0.0},
        {"duration_s": float("inf")},
        {"resolutions_m": (0.05, 0.1)},
        {"resolutions_m": (0.0,)},
        {"map_period_s": float("inf")},
        {"pose_period_s": 10.0},
        {"overlap": 1.5},
        {"odometry_noise": -0.1},
    ],
)
def test_impossible_missions(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"must|cannot|give one"):
        MissionConfig(**wrong)
