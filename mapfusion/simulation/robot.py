"""One robot of a mission: where it drives, what it measures, and what it sends."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mapfusion.grid import OccupancyGrid
from mapfusion.simulation.explore import follow
from mapfusion.simulation.lidar import scan
from mapfusion.simulation.mapping import GridMapper
from mapfusion.simulation.messages import MapMessage, MapUpdateMessage, MissionMessage, PoseMessage, SimulatedRobot
from mapfusion.simulation.mission_config import MissionConfig, generator
from mapfusion.simulation.odometry import drifting_odometry
from mapfusion.simulation.plan import FloorPlan
from mapfusion.transform import SE2, FloatArray

START_NS = 1_750_000_000_000_000_000
"""Stamp of the first robot's first pose."""

_ROBOT_LAG_NS = 37_000_000
_UPDATES_PER_MAP = 5
_SCANS_AT_ONCE = 16


def travelling_robot(
    config: MissionConfig, robot: int, path_m: FloatArray, first_yaw_rad: float, T_world_map: SE2 | None = None
) -> SimulatedRobot:
    """Robot 0, 1, ... on a path of points (N, 2) in its world; its map frame is its first pose unless given."""
    start_ns = START_NS + robot * _ROBOT_LAG_NS
    trajectory = follow(path_m, start_ns, config.duration_s, config.pose_period_s, first_yaw_rad)
    x_m, y_m, yaw_rad = trajectory.poses[0]
    return SimulatedRobot(
        name=f"robot{robot + 1}",
        building=robot % config.num_buildings,
        resolution_m=config.resolution_of(robot),
        T_world_map=T_world_map or SE2(float(x_m), float(y_m), float(yaw_rad)),
        trajectory=trajectory,
    )


def pose_messages(config: MissionConfig, robot: int, simulated: SimulatedRobot) -> Iterator[PoseMessage]:
    """The poses of robot 0, 1, ... in its map frame, exact, by way of an odometry that drifts."""
    T_map_world = simulated.T_world_map.inverse()
    poses = [T_map_world @ SE2(float(x), float(y), float(yaw)) for x, y, yaw in simulated.trajectory.poses]
    odometry = drifting_odometry(poses, config.odometry_noise, generator(config, "odometry", robot))
    for stamp_ns, T_map_base, T_odom_base in zip(simulated.trajectory.stamps_ns, poses, odometry, strict=True):
        # Without drift the odometry is the pose, and rounding must not make the static transform move.
        T_map_odom = T_map_base @ T_odom_base.inverse() if config.odometry_noise > 0.0 else SE2.identity()
        yield PoseMessage(simulated.name, int(stamp_ns), T_map_odom, T_odom_base)


def explore(config: MissionConfig, robot: int, simulated: SimulatedRobot, plan: FloorPlan) -> Iterator[MissionMessage]:
    """One robot's messages: at every pose a scan, now and then the map or what changed in it."""
    rng = generator(config, "scan", robot)
    corner_m = rng.uniform(-simulated.resolution_m, 0.0, 2)
    mapper = GridMapper(
        simulated.map_frame, simulated.resolution_m, (corner_m[0], corner_m[1]), config.lidar, config.graded
    )
    schedule = _Schedule(config, first_s=float(rng.uniform(0.2, 1.0)) * config.map_period_s)
    last_map: OccupancyGrid | None = None
    world_poses = simulated.trajectory.poses
    ranges = np.empty((0, config.lidar.num_beams))
    for k, pose in enumerate(pose_messages(config, robot, simulated)):
        if k % _SCANS_AT_ONCE == 0:
            ranges = scan(plan, world_poses[k : k + _SCANS_AT_ONCE], config.lidar, rng)
        T_map_base = pose.T_map_odom @ pose.T_odom_base
        pose_in_map = np.array([T_map_base.x_m, T_map_base.y_m, T_map_base.yaw_rad])
        mapper.add_scan(pose_in_map, ranges[k % _SCANS_AT_ONCE])
        yield pose
        last = k == len(world_poses) - 1
        due = schedule.due(pose.stamp_ns - int(simulated.trajectory.stamps_ns[0]), last)
        if due is None:
            continue
        grid = mapper.grid(pose.stamp_ns)
        if due == "update" and last_map is not None and _same_extent(grid, last_map):
            update = _difference(simulated.name, last_map, grid)
            if update is None:
                continue
            yield update
        else:
            yield MapMessage(simulated.name, grid)
        last_map = grid


class _Schedule:
    """When a robot gives its map, and when an update of it."""

    def __init__(self, config: MissionConfig, first_s: float) -> None:
        self._step_ns = round(config.map_period_s * 1e9) // (_UPDATES_PER_MAP if config.updates else 1)
        self._steps_per_map = _UPDATES_PER_MAP if config.updates else 1
        self._first_ns = round(first_s * 1e9)
        self._next = 0

    def due(self, since_start_ns: int, last: bool) -> str | None:
        """`map`, `update` or None at a time after the robot's start; something at the `last` pose."""
        if since_start_ns < self._first_ns + self._next * self._step_ns and not last:
            return None
        step = self._next
        self._next = max((since_start_ns - self._first_ns) // self._step_ns + 1, 0)
        return "update" if step % self._steps_per_map else "map"


def _same_extent(a: OccupancyGrid, b: OccupancyGrid) -> bool:
    return a.cells.shape == b.cells.shape and a.T_frame_grid == b.T_frame_grid


def _difference(robot: str, before: OccupancyGrid, after: OccupancyGrid) -> MapUpdateMessage | None:
    """The smallest update that makes one map of the other; None where nothing changed."""
    rows, cols = np.nonzero(before.cells != after.cells)
    if rows.size == 0:
        return None
    bottom, left = int(rows.min()), int(cols.min())
    cells = after.cells[bottom : int(rows.max()) + 1, left : int(cols.max()) + 1]
    return MapUpdateMessage(robot, after.frame_id, after.stamp_ns, left, bottom, cells)
