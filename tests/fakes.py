"""Small places, maps and missions with known truth, drawn in the test."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mapfusion.grid import Cells, OccupancyGrid
from mapfusion.steps import GridEvent, RobotEvent, StampArray
from mapfusion.transform import SE2, FloatArray

SECOND_NS = 1_000_000_000


def flat(height: int, width: int, value: int = -1) -> Cells:
    """Cells that all have one value."""
    return np.full((height, width), value, np.int8)


def grid_of(cells: Cells, resolution_m: float = 0.1, pose: SE2 | None = None, stamp_ns: int = 0) -> OccupancyGrid:
    """A grid at the origin unless `pose` says otherwise."""
    return OccupancyGrid(cells, resolution_m, pose or SE2.identity(), "map", stamp_ns)


def rooms(height: int = 300, width: int = 320, seed: int = 0) -> Cells:
    """A free place with an outer wall, random inner walls with gaps, and pillars: no two corners alike."""
    rng = np.random.default_rng(seed)
    cells = flat(height, width, 0)
    cells[[0, 1, -2, -1], :] = 100
    cells[:, [0, 1, -2, -1]] = 100
    for _ in range(14):
        row, col = rng.integers(15, height - 15), rng.integers(15, width - 15)
        length, gap = rng.integers(40, 120), rng.integers(8, 20)
        if rng.random() < 0.5:
            cells[row : row + 2, col : col + length] = 100
            cells[row : row + 2, col + length // 2 : col + length // 2 + gap] = 0
        else:
            cells[row : row + length, col : col + 2] = 100
            cells[row + length // 2 : row + length // 2 + gap, col : col + 2] = 0
    for _ in range(10):
        row, col, size = rng.integers(10, height - 20), rng.integers(10, width - 20), rng.integers(3, 10)
        cells[row : row + size, col : col + size] = 100
    return cells


def seen_from(place: Cells, T_place_map: SE2, shape: tuple[int, int], resolution_m: float = 0.1) -> OccupancyGrid:
    """A robot's map of a place: the place's cells at the map's cell centres, unknown where the place has none."""
    rows, cols = np.indices(shape)
    points = T_place_map.apply(np.stack([cols + 0.5, rows + 0.5], axis=-1) * resolution_m) / resolution_m
    x, y = np.floor(points[..., 0]).astype(int), np.floor(points[..., 1]).astype(int)
    inside = (x >= 0) & (y >= 0) & (x < place.shape[1]) & (y < place.shape[0])
    cells = flat(*shape)
    cells[inside] = place[y[inside], x[inside]]
    return grid_of(cells, resolution_m)


class StillPoses:
    """A robot that stands still between two times."""

    def __init__(self, pose: SE2, stamps_ns: Sequence[int]) -> None:
        self._pose = pose
        self.stamps_ns: StampArray = np.array(stamps_ns, np.int64)

    def poses_at(self, stamps_ns: StampArray) -> FloatArray:
        """(N, 3), NaN outside the stamps."""
        poses = np.tile([self._pose.x_m, self._pose.y_m, self._pose.yaw_rad], (stamps_ns.size, 1))
        poses[(stamps_ns < self.stamps_ns[0]) | (stamps_ns > self.stamps_ns[-1])] = np.nan
        return poses


def robot_event(robot: str, poses: StillPoses | None = None) -> RobotEvent:
    """A robot whose map frame carries its name."""
    return RobotEvent(robot, f"{robot}/map", poses)


def grid_event(robot: str, second: float, grid: OccupancyGrid) -> GridEvent:
    """A grid at a time in seconds."""
    return GridEvent(robot, round(second * SECOND_NS), grid)
