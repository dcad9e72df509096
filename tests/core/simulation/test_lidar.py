from __future__ import annotations

import math

import numpy as np
import pytest

from mapfusion.simulation.lidar import LidarConfig, beam_angles_rad, cast_rays, scan
from mapfusion.simulation.plan import PLAN_RESOLUTION_M
from tests.core.simulation.fakes import room


def test_ranges_are_those_of_a_ruler() -> None:
    poses = np.array([[3.0, 4.0, 0.0], [3.0, 4.0, math.pi / 2]])
    ranges = cast_rays(room(8.0, 6.0), poses, 8, 20.0)
    # Room from (1, 1) to (9, 7): east 6 m, north-east 3 m up, north 3 m, west 2 m, south 3 m.
    expected = [6.0, 3.0 * math.sqrt(2), 3.0, 2.0 * math.sqrt(2), 2.0, 2.0 * math.sqrt(2), 3.0, 3.0 * math.sqrt(2)]
    assert ranges[0] == pytest.approx(expected, abs=0.5 * PLAN_RESOLUTION_M)
    assert ranges[1] == pytest.approx(expected[2:] + expected[:2], abs=0.5 * PLAN_RESOLUTION_M)


def test_no_ray_passes_a_wall() -> None:
    plan = room()
    poses = np.array([[5.0, 4.0, 0.3]])
    ranges = cast_rays(plan, poses, 720, 20.0)[0]
    angles = beam_angles_rad(720) + 0.3
    for share in (0.3, 0.6, 0.9, 0.99):
        points = poses[0, :2] + share * ranges[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        assert plan.clearance_at_m(points).min() > 0.0


def test_range_noise_and_missing_echoes() -> None:
    config = LidarConfig(num_beams=8, max_range_m=4.0, range_noise_m=0.03, missed_ratio=0.1)
    ranges = scan(room(8.0, 6.0), np.tile([3.0, 4.0, 0.0], (5000, 1)), config, np.random.default_rng(0))
    assert np.mean(np.isnan(ranges)) == pytest.approx(0.1, abs=0.01)
    east, north = ranges[~np.isnan(ranges[:, 0]), 0], ranges[~np.isnan(ranges[:, 2]), 2]
    assert np.isinf(east).all()
    assert north.mean() == pytest.approx(3.0, abs=0.02)
    assert north.std() == pytest.approx(0.03, abs=0.002)


@pytest.mark.parametrize(
    "wrong", [{"num_beams": 1}, {"max_range_m": 0.0}, {"range_noise_m": -0.1}, {"missed_ratio": 1.0}]
)
def test_impossible_scanners(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        LidarConfig(**wrong)  # type: ignore[arg-type]
