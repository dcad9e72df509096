from __future__ import annotations

import math

import numpy as np
import pytest

from mapfusion.grid import OccupancyGrid
from mapfusion.simulation.explore import Trajectory
from mapfusion.simulation.messages import Mission, SimulatedRobot
from mapfusion.simulation.truth import mission_truth, overlap_ratio
from mapfusion.transform import SE2


def known_box(width_m: float, height_m: float, resolution_m: float = 0.05) -> OccupancyGrid:
    """A free box in a margin of unknown cells, its corner at the frame's origin, with one wall cell there."""
    rows, cols = round(height_m / resolution_m), round(width_m / resolution_m)
    cells = np.full((rows + 4, cols + 4), -1, np.int8)
    cells[2:-2, 2:-2] = 0
    cells[2, 2] = 100
    return OccupancyGrid(cells, resolution_m, SE2(-2 * resolution_m, -2 * resolution_m, 0.0))


@pytest.mark.parametrize(
    ("T_a_b", "expected"),
    [
        (SE2(0.0, 0.0, 0.0), 1.0),
        (SE2(3.0, 0.0, 0.0), 0.5),
        (SE2(4.0, 2.0, math.pi), 1.0),
        (SE2(1.0, 2.0, math.pi), 0.5),
        (SE2(9.0, 0.0, 0.0), 0.0),
    ],
)
@pytest.mark.parametrize("resolution_m", [0.05, 0.1])
def test_overlap_is_measured_by_the_smaller_map(T_a_b: SE2, expected: float, resolution_m: float) -> None:
    large, small = known_box(4.0, 2.0), known_box(2.0, 2.0, resolution_m)
    assert overlap_ratio(large, small, T_a_b) == pytest.approx(expected, abs=0.03)
    assert overlap_ratio(small, large, T_a_b.inverse()) == pytest.approx(expected, abs=0.03)


def test_empty_map_overlaps_nothing() -> None:
    empty = OccupancyGrid(np.full((3, 3), -1, np.int8), 0.05, SE2.identity())
    assert overlap_ratio(known_box(1.0, 1.0), empty, SE2.identity()) == 0.0


def test_truth_of_a_mission_of_two_buildings() -> None:
    def robot(number: int, building: int, T_world_map: SE2) -> SimulatedRobot:
        trajectory = Trajectory(np.array([1_500_000_000, 2_000_000_000]), np.array([[1.0, 2.0, 0.0], [1.5, 2.0, 7.0]]))
        return SimulatedRobot(f"robot{number}", building, 0.05, T_world_map, trajectory)

    robots = (
        robot(1, 0, SE2(10.0, 20.0, math.pi / 2)),
        robot(2, 0, SE2(8.0, 20.0, 0.0)),
        robot(3, 1, SE2(10.0, 20.0, math.pi / 2)),
    )
    truth = mission_truth(
        Mission(robots, True, lambda: iter(())), {robot.name: known_box(2.0, 2.0) for robot in robots}
    )
    assert truth["final_overlap"] == pytest.approx(
        {"robot1-robot2": 1.0, "robot1-robot3": 0.0, "robot2-robot3": 0.0}, abs=0.05
    )
    first = truth["robots"]["robot1"]
    assert first["map_frame"] == "robot1/map"
    assert first["building"] == 0
    assert first["T_world_map"] == pytest.approx([10.0, 20.0, math.pi / 2])
    assert first["resolution"] == 0.05
    assert first["path"] == [[1.5, 1.0, 2.0, 0.0], [2.0, 1.5, 2.0, pytest.approx(7.0 - 2.0 * math.pi, abs=1e-4)]]
    # The wall cell's centre, (0.025, 0.025), lies at (9.975, 20.025) in the world.
    assert first["walls_dm"] == [[99, 200]]
    assert truth["robots"]["robot2"]["walls_dm"] == [[80, 200]]
