"""Missions on the paper's random maps: every robot has a patch of one, and drives about in it."""

from __future__ import annotations

import heapq
import random
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from mapfusion.grid import OccupancyGrid
from mapfusion.simulation.explore import resample_path
from mapfusion.simulation.messages import MapMessage, Mission, MissionMessage, SimulatedRobot
from mapfusion.simulation.mission_config import MissionConfig
from mapfusion.simulation.paper import patch_grid, pose_in_map, random_map, random_patch
from mapfusion.simulation.robot import pose_messages, travelling_robot
from mapfusion.transform import SE2, FloatArray


def simulate_paper_mission(config: MissionConfig) -> Mission:
    """Robots of one building have patches of one map, those of building k of the map of seed `config.seed` + k.

    A robot drives from one random cell of its patch to the next; its map frame lies at the first, parallel to the
    patch. Its map never changes. World of a building: the generated map with its lower left corner at the origin.
    Scanner, overlap, updates and graded maps have no meaning here.

    Raises:
        ValueError: More than one cell size: the paper's maps are made of pixels of one size.
    """
    if len(set(config.resolutions_m)) > 1:
        raise ValueError("the paper's maps are made of cells of one size: give one resolution")
    rngs = [random.Random(config.seed + k) for k in range(config.num_buildings)]
    images = [random_map(rng) for rng in rngs]
    robots: list[tuple[SimulatedRobot, OccupancyGrid]] = []
    for k in range(config.num_robots):
        rng, image = rngs[k % config.num_buildings], images[k % config.num_buildings]
        patch = random_patch(rng, image)
        T_world_patch = pose_in_map(patch, config.resolutions_m[0])
        grid = patch_grid(patch, config.resolutions_m[0])
        inside = np.argwhere(patch.inside[::-1])
        length_m = 0.0
        stops_m: list[FloatArray] = []
        while length_m <= config.duration_s or len(stops_m) < 2:
            row, col = inside[rng.randrange(len(inside))] + 0.5
            stops_m.append(np.array([col, row]) * config.resolutions_m[0])
            length_m += float(np.linalg.norm(stops_m[-1] - stops_m[-2])) if len(stops_m) > 1 else 0.0
        path_m = resample_path(T_world_patch.apply(np.array(stops_m)))
        T_patch_map = SE2(float(stops_m[0][0]), float(stops_m[0][1]), 0.0)
        yaw_rad = T_world_patch.yaw_rad + rng.uniform(-np.pi, np.pi)
        robot = travelling_robot(config, k, path_m, yaw_rad, T_world_patch @ T_patch_map)
        robots.append((robot, replace(grid, T_frame_grid=T_patch_map.inverse(), frame_id=robot.map_frame)))

    def messages() -> Iterator[MissionMessage]:
        streams = (_drive(config, k, robot, grid) for k, (robot, grid) in enumerate(robots))
        return heapq.merge(*streams, key=lambda message: message.stamp_ns)

    return Mission(tuple(robot for robot, _ in robots), config.odometry_noise == 0.0, messages)


def _drive(
    config: MissionConfig, robot: int, simulated: SimulatedRobot, grid: OccupancyGrid
) -> Iterator[MissionMessage]:
    period_ns = round(config.map_period_s * 1e9)
    next_map_ns = 0
    for pose in pose_messages(config, robot, simulated):
        yield pose
        if pose.stamp_ns >= next_map_ns or pose.stamp_ns == simulated.trajectory.stamps_ns[-1]:
            yield MapMessage(simulated.name, replace(grid, stamp_ns=pose.stamp_ns))
            next_map_ns = pose.stamp_ns + period_ns
