from __future__ import annotations

import math

import numpy as np

from mapfusion.simulation.odometry import drifting_odometry
from mapfusion.transform import SE2

CIRCLE = [SE2(5.0 * math.cos(t), 5.0 * math.sin(t), t + math.pi / 2) for t in np.linspace(0.0, 2.0 * math.pi, 200)]


def test_without_noise_the_odometry_is_the_pose() -> None:
    for exact, measured in zip(CIRCLE, drifting_odometry(CIRCLE, 0.0, np.random.default_rng(0)), strict=True):
        assert max(exact.distance_to(measured)) < 1e-9


def test_drift_is_small_at_first_and_grows() -> None:
    errors = []
    for seed in range(20):
        odometry = drifting_odometry(CIRCLE, 0.02, np.random.default_rng(seed))
        assert odometry[0] == CIRCLE[0]
        errors.append([exact.distance_to(measured)[0] for exact, measured in zip(CIRCLE, odometry, strict=True)])
    early_m, late_m = np.mean(errors, axis=0)[[10, -1]]
    assert 0.0 < early_m < 0.1
    assert early_m < late_m < 3.0
