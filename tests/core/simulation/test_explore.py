from __future__ import annotations

import math

import numpy as np
import pytest

from mapfusion.simulation.explore import ROBOT_RADIUS_M, Explorer, follow, resample_path
from mapfusion.simulation.floor_plan import random_floor_plan
from tests.core.simulation.fakes import room


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_tours_keep_clear_of_everything(seed: int) -> None:
    plan = random_floor_plan(np.random.default_rng(seed))
    explorer = Explorer(plan)
    rng = np.random.default_rng(seed)
    tour = explorer.tour_m(explorer.places_m[0], 80.0, rng)
    assert plan.clearance_at_m(tour).min() >= ROBOT_RADIUS_M
    steps = np.linalg.norm(np.diff(tour, axis=0), axis=1)
    assert steps.max() < 0.051
    assert 70.0 < steps.sum() <= 80.0
    # It explores: the tour comes to different parts of the building.
    assert np.ptp(tour, axis=0).max() > 6.0


def test_tours_are_seeded() -> None:
    explorer = Explorer(random_floor_plan(np.random.default_rng(4)))
    tours = [explorer.tour_m(explorer.places_m[3], 40.0, np.random.default_rng(seed)) for seed in (5, 5, 6)]
    np.testing.assert_array_equal(tours[0], tours[1])
    assert not np.array_equal(tours[0][-1], tours[2][-1])


def test_survey_of_a_room_is_the_room() -> None:
    explorer = Explorer(room(8.0, 6.0))
    seen = explorer.survey(np.linspace([2.0, 2.0], [8.0, 6.0], 150), 10.0)
    assert np.count_nonzero(seen) * 0.2**2 == pytest.approx(48.0, rel=0.15)


def test_robot_turns_before_it_drives_and_keeps_its_speed() -> None:
    path = resample_path(np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0]]))
    trajectory = follow(path, 1_000, 30.0, 0.1, math.pi / 2)
    assert trajectory.stamps_ns[[0, 1, -1]].tolist() == [1_000, 100_001_000, 30_000_001_000]
    speeds = np.linalg.norm(np.diff(trajectory.poses[:, :2], axis=0), axis=1) / 0.1
    turns = np.abs(np.diff(trajectory.poses[:, 2])) / 0.1
    assert trajectory.poses[0] == pytest.approx([0.0, 0.0, math.pi / 2])
    assert speeds[:14].max() < 0.1  # a quarter turn at 1 rad/s comes first
    assert np.median(speeds[:80]) == pytest.approx(0.5, abs=1e-6)
    assert speeds.max() < 0.5 + 1e-6
    assert turns.max() < 1.0 + 1e-6
    assert trajectory.poses[-1] == pytest.approx([4.0, 4.0, math.pi / 2], abs=0.06)
