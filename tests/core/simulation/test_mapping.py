from __future__ import annotations

import numpy as np
import pytest

from mapfusion.simulation.lidar import LidarConfig, scan
from mapfusion.simulation.mapping import GridMapper
from mapfusion.transform import SE2
from tests.core.simulation.fakes import room

LIDAR = LidarConfig(max_range_m=5.0)


def mapped(poses: list[list[float]], T_world_map: SE2, graded: bool = False, resolution_m: float = 0.05) -> GridMapper:
    """A map of the room after scans from poses in the world."""
    mapper = GridMapper("a/map", resolution_m, (-0.013, -0.021), LIDAR, graded)
    ranges = scan(room(), np.array(poses), LIDAR, np.random.default_rng(1))
    for (x_m, y_m, yaw_rad), seen in zip(poses, ranges, strict=True):
        pose = T_world_map.inverse() @ SE2(x_m, y_m, yaw_rad)
        mapper.add_scan(np.array([pose.x_m, pose.y_m, pose.yaw_rad]), seen)
    return mapper


def test_walls_and_free_space_are_where_they_are() -> None:
    T_world_map = SE2(3.0, 2.0, 0.7)
    grid = mapped([[2.0 + 0.2 * k, 4.0, 0.1 * k] for k in range(30)], T_world_map).grid(5)
    assert grid.frame_id == "a/map"
    assert grid.stamp_ns == 5
    assert set(np.unique(grid.cells)) == {-1, 0, 100}
    walls, free = (T_world_map.apply(grid.centres_m(mask)) for mask in (grid.walls, grid.free))
    outside = np.maximum(np.abs(walls[:, 0] - 5.0) - 4.0, np.abs(walls[:, 1] - 4.0) - 3.0)
    assert np.quantile(np.abs(outside), 0.9) < 0.06
    assert np.abs(outside).max() < 0.15
    assert np.maximum(np.abs(free[:, 0] - 5.0) - 4.0, np.abs(free[:, 1] - 4.0) - 3.0).max() < 0.1
    assert len(free) * 0.05**2 == pytest.approx(48.0, rel=0.05)


def test_map_grows_and_its_origin_moves() -> None:
    T_world_map = SE2(2.0, 4.0, 0.0)
    few = mapped([[8.0, 4.0, 0.0]], T_world_map).grid(0)
    many = mapped([[8.0, 4.0, 0.0], [4.0, 4.0, 0.0], [2.0, 4.0, 0.0]], T_world_map).grid(0)
    assert many.width > few.width
    assert many.T_frame_grid.x_m < few.T_frame_grid.x_m
    # Cells stay where they are: only whole cells are added.
    moved = (few.T_frame_grid.x_m - many.T_frame_grid.x_m) / 0.05
    assert moved == pytest.approx(round(moved), abs=1e-6)
    assert (few.T_frame_grid.x_m + 0.013) / 0.05 == pytest.approx(round((few.T_frame_grid.x_m + 0.013) / 0.05))
    assert np.count_nonzero(many.known) > np.count_nonzero(few.known)


def test_what_lies_out_of_reach_stays_unknown() -> None:
    T_world_map = SE2.identity()
    grid = mapped([[2.0, 4.0, 0.0]] * 3, T_world_map).grid(0)
    known = grid.centres_m(grid.known)
    assert np.linalg.norm(known - [2.0, 4.0], axis=1).max() < 5.1


def test_probabilities_are_graded() -> None:
    cells = mapped([[5.0, 4.0, 0.0], [5.2, 4.0, 0.0]], SE2.identity(), graded=True).grid(0).cells
    values = np.unique(cells[cells >= 0])
    assert len(values) > 3
    assert 0 < values[0] < 40
    assert 70 < values[-1] < 100


def test_coarse_cells() -> None:
    grid = mapped([[2.0 + 0.5 * k, 4.0, 0.0] for k in range(10)], SE2.identity(), resolution_m=0.1).grid(0)
    assert np.count_nonzero(grid.free) * 0.1**2 == pytest.approx(48.0, rel=0.08)


def test_map_without_a_scan() -> None:
    with pytest.raises(ValueError, match="without a scan"):
        GridMapper("a/map", 0.05, (0.0, 0.0), LIDAR).grid(0)
