"""Odometry that drifts."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from mapfusion.transform import SE2

_DRIFT_RAD_PER_M = 0.1
"""Heading error a metre travelled, for a relative error of 1."""


def drifting_odometry(poses: Sequence[SE2], noise: float, rng: np.random.Generator) -> list[SE2]:
    """`T_odom_base` of every `T_map_base`, both starting alike.

    Every step is measured with a scale and a heading rate that are wrong throughout, and with noise of its own, all
    of them in proportion to `noise`, a relative error.
    """
    scale, drift_rad_per_m = 1.0 + noise * rng.standard_normal(), noise * _DRIFT_RAD_PER_M * rng.standard_normal()
    odometry = [poses[0]]
    for before, after in pairwise(poses):
        step = before.inverse() @ after
        travelled_m = float(np.hypot(step.x_m, step.y_m))
        step_scale = scale + noise * rng.standard_normal()
        yaw_rad = step.yaw_rad * (1.0 + noise * rng.standard_normal()) + drift_rad_per_m * travelled_m
        odometry.append(odometry[-1] @ SE2(step.x_m * step_scale, step.y_m * step_scale, yaw_rad))
    return odometry
