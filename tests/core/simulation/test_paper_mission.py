from __future__ import annotations

import numpy as np
import pytest

from mapfusion.grid import OccupancyGrid
from mapfusion.simulation.messages import MapMessage, PoseMessage
from mapfusion.simulation.mission_config import MissionConfig
from mapfusion.simulation.paper import positive_pair
from mapfusion.simulation.paper_mission import simulate_paper_mission
from mapfusion.simulation.truth import overlap_ratio

CONFIG = MissionConfig(seed=4, num_robots=3, num_buildings=1, duration_s=20.0)


def test_first_two_robots_have_the_pair_of_the_seed() -> None:
    mission = simulate_paper_mission(CONFIG)
    maps: dict[str, OccupancyGrid] = {m.robot: m.grid for m in mission.messages() if isinstance(m, MapMessage)}
    a, b, _ = mission.robots
    pair = positive_pair(4)
    np.testing.assert_array_equal(maps["robot1"].cells, pair.target.cells)
    T_a_b = a.T_world_map.inverse() @ b.T_world_map
    points = maps["robot2"].centres_m(maps["robot2"].walls)
    in_a = (maps["robot1"].T_frame_grid.inverse() @ T_a_b).apply(points)
    cols, rows = np.floor(in_a / 0.05).astype(int).T
    inside = (rows >= 0) & (rows < maps["robot1"].height) & (cols >= 0) & (cols < maps["robot1"].width)
    assert inside.sum() > 1000
    assert maps["robot1"].walls[rows[inside], cols[inside]].mean() > 0.95
    assert overlap_ratio(maps["robot1"], maps["robot2"], T_a_b) > 0.2


def test_robots_drive_inside_their_maps() -> None:
    mission = simulate_paper_mission(CONFIG)
    maps = {m.robot: m.grid for m in mission.messages() if isinstance(m, MapMessage)}
    for robot in mission.robots:
        grid = maps[robot.name]
        poses = [m for m in mission.messages() if isinstance(m, PoseMessage) and m.robot == robot.name]
        in_map = [m.T_map_odom @ m.T_odom_base for m in poses]
        cells = grid.T_frame_grid.inverse().apply(np.array([[T.x_m, T.y_m] for T in in_map])) / 0.05
        assert (cells >= 0).all()
        assert (cells <= (grid.width, grid.height)).all()
        assert np.hypot(in_map[0].x_m, in_map[0].y_m) < 1e-9
        assert np.linalg.norm(np.ptp(cells, axis=0)) * 0.05 > 3.0


def test_cells_of_two_sizes() -> None:
    with pytest.raises(ValueError, match="one resolution"):
        simulate_paper_mission(MissionConfig(num_robots=2, resolutions_m=(0.05, 0.1)))
