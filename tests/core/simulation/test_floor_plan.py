from __future__ import annotations

import cv2
import numpy as np
import pytest

from mapfusion.simulation.floor_plan import random_floor_plan
from mapfusion.simulation.plan import PLAN_RESOLUTION_M

SEEDS = range(8)


@pytest.mark.parametrize("seed", SEEDS)
def test_building_is_closed_and_all_places_can_be_reached(seed: int) -> None:
    plan = random_floor_plan(np.random.default_rng(seed))
    occupied = plan.occupied
    assert occupied[0].all()
    assert occupied[-1].all()
    assert occupied[:, 0].all()
    assert occupied[:, -1].all()
    sides_m = sorted(n * PLAN_RESOLUTION_M for n in occupied.shape)
    assert 13.0 < sides_m[0] <= sides_m[1] < 45.0
    # A robot of 0.4 m width gets nearly everywhere it has room to stand.
    standable = (plan.clearance_m > 0.2).astype(np.uint8)
    _, _, stats, _ = cv2.connectedComponentsWithStats(standable, connectivity=4)
    assert stats[1:, cv2.CC_STAT_AREA].max() > 0.97 * standable.sum()


def test_same_seed_same_plan() -> None:
    first, again, other = (random_floor_plan(np.random.default_rng(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.occupied, again.occupied)
    np.testing.assert_array_equal(first.places_m, again.places_m)
    assert not np.array_equal(first.occupied.shape, other.occupied.shape)


@pytest.mark.parametrize("seed", SEEDS)
def test_building_is_not_symmetric(seed: int) -> None:
    occupied = random_floor_plan(np.random.default_rng(seed)).occupied[10:-10, 10:-10]
    near = cv2.dilate(occupied.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    for mirrored in (occupied[::-1], occupied[:, ::-1], occupied[::-1, ::-1]):
        assert np.mean(near[mirrored]) < 0.8


def test_clearance_is_the_distance_to_the_nearest_wall() -> None:
    plan = random_floor_plan(np.random.default_rng(3))
    rows, cols = np.nonzero(~plan.occupied)
    walls = np.argwhere(plan.occupied)
    for k in range(0, len(rows), len(rows) // 5):
        nearest_m = np.linalg.norm(walls - (rows[k], cols[k]), axis=1).min() * PLAN_RESOLUTION_M
        point_m = np.array([[cols[k] + 0.5, rows[k] + 0.5]]) * PLAN_RESOLUTION_M
        assert plan.clearance_at_m(point_m)[0] == pytest.approx(nearest_m, abs=1e-3)
    assert plan.clearance_at_m(np.array([[-1.0, 5.0], [5.0, 1000.0]])).tolist() == [0.0, 0.0]
