"""The truth about a simulated mission, as it is published beside the recording."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from typing import TypedDict

import numpy as np

from mapfusion.grid import OccupancyGrid
from mapfusion.simulation.messages import Mission, SimulatedRobot
from mapfusion.transform import SE2

WALL_CELL_M = 0.1
"""Edge length of the world's cells in which walls are listed."""


class Truth(TypedDict):
    """The truth as its file has it; see `mission_truth`."""

    robots: dict[str, dict[str, object]]
    final_overlap: dict[str, float]


def mission_truth(mission: Mission, last_maps: Mapping[str, OccupancyGrid]) -> Truth:
    """Two tables, `robots` and `final_overlap`, of plain numbers and lists.

    - `robots.NAME`: `map_frame`, `building`, `T_world_map` [x m, y m, yaw rad], `resolution` in metres, `path` with
      [time s, x m, y m, yaw rad] in the world at every recorded pose, and `walls_dm`, the cells [x, y] of 0.1 m of the
      world in which its last map has a wall.
    - `final_overlap.A-B`: area known in both last maps / that of the smaller one; 0 in different buildings.

    Args:
        mission: The mission.
        last_maps: Every robot's last map, in its map frame.
    """
    robots: dict[str, dict[str, object]] = {}
    for robot in mission.robots:
        T = robot.T_world_map
        robots[robot.name] = {
            "map_frame": robot.map_frame,
            "building": robot.building,
            "T_world_map": [T.x_m, T.y_m, T.yaw_rad],
            "resolution": robot.resolution_m,
            "path": _path(robot),
            "walls_dm": _walls_dm(last_maps[robot.name], T),
        }
    overlaps = {
        f"{a.name}-{b.name}": round(
            overlap_ratio(last_maps[a.name], last_maps[b.name], a.T_world_map.inverse() @ b.T_world_map), 3
        )
        if a.building == b.building
        else 0.0
        for a, b in combinations(mission.robots, 2)
    }
    return {"robots": robots, "final_overlap": overlaps}


def overlap_ratio(a: OccupancyGrid, b: OccupancyGrid, T_a_b: SE2) -> float:
    """Share of the known area of the smaller map that is known in the other one too, [0, 1]; 0 for an empty map."""
    area_a, area_b = (np.count_nonzero(grid.known) * grid.resolution_m**2 for grid in (a, b))
    if min(area_a, area_b) == 0.0:
        return 0.0
    if area_b > area_a:
        return overlap_ratio(b, a, T_a_b.inverse())
    centres_m = (a.T_frame_grid.inverse() @ T_a_b).apply(b.centres_m(b.known))
    cols, rows = np.floor(centres_m / a.resolution_m).astype(np.intp).T
    inside = (rows >= 0) & (rows < a.height) & (cols >= 0) & (cols < a.width)
    return float(np.count_nonzero(a.known[rows[inside], cols[inside]]) / len(centres_m))


def _path(robot: SimulatedRobot) -> list[list[float]]:
    rows = zip(robot.trajectory.stamps_ns.tolist(), robot.trajectory.poses.tolist(), strict=True)
    return [
        [stamp_ns / 1e9, round(x_m, 4), round(y_m, 4), round(SE2(0.0, 0.0, yaw_rad).yaw_rad, 4)]
        for stamp_ns, (x_m, y_m, yaw_rad) in rows
    ]


def _walls_dm(grid: OccupancyGrid, T_world_map: SE2) -> list[list[int]]:
    cells = np.floor(T_world_map.apply(grid.centres_m(grid.walls)) / WALL_CELL_M).astype(int)
    listed: list[list[int]] = np.unique(cells, axis=0).tolist()
    return listed
