"""Lidar scans of a floor plan."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mapfusion.simulation.plan import PLAN_RESOLUTION_M, FloorPlan
from mapfusion.transform import FloatArray

_HALF_DIAGONALS_M = math.sqrt(2.0) * PLAN_RESOLUTION_M
_LEAST_STEP_M = 0.25 * PLAN_RESOLUTION_M


@dataclass(frozen=True, slots=True)
class LidarConfig:
    """A scanner that looks all around.

    Attributes:
        num_beams: Beams of a scan, the first along the heading, the next ones counter-clockwise.
        max_range_m: Nothing beyond is seen.
        range_noise_m: Standard deviation of a range.
        missed_ratio: Share of the beams that come back without any measurement.
    """

    num_beams: int = 720
    max_range_m: float = 10.0
    range_noise_m: float = 0.02
    missed_ratio: float = 0.02

    def __post_init__(self) -> None:
        if self.num_beams < 8:
            raise ValueError(f"num_beams must be at least 8, not {self.num_beams}")
        if not 0.5 <= self.max_range_m <= 100.0:
            raise ValueError(f"max_range_m must lie in 0.5..100 m, not {self.max_range_m}")
        if not 0.0 <= self.range_noise_m <= 1.0:
            raise ValueError(f"range_noise_m must lie in 0..1 m, not {self.range_noise_m}")
        if not 0.0 <= self.missed_ratio < 1.0:
            raise ValueError(f"missed_ratio must lie in [0, 1), not {self.missed_ratio}")


def beam_angles_rad(num_beams: int) -> FloatArray:
    """(B,) directions of the beams against the heading, radians."""
    angles: FloatArray = np.arange(num_beams, dtype=np.float64) * (2.0 * math.pi / num_beams)
    return angles


def scan(plan: FloorPlan, poses: FloatArray, config: LidarConfig, rng: np.random.Generator) -> FloatArray:
    """Ranges (N, B) seen from poses (N, 3) of x, y (metres) and yaw (radians) in the plan's world.

    A range is in metres, inf where nothing lies within reach, NaN where the measurement was missed.
    """
    ranges = cast_rays(plan, poses, config.num_beams, config.max_range_m)
    noisy = np.maximum(ranges + config.range_noise_m * rng.standard_normal(ranges.shape), _LEAST_STEP_M)
    noisy[rng.random(ranges.shape) < config.missed_ratio] = np.nan
    return noisy


def cast_rays(plan: FloorPlan, poses: FloatArray, num_beams: int, max_range_m: float) -> FloatArray:
    """Exact ranges (N, B) to the first occupied cell, to a quarter of a cell; inf beyond `max_range_m`.

    Source: sphere tracing, Hart, The Visual Computer 1996: a ray may always go on by the clearance where it stands.
    """
    angles = poses[:, 2, None] + beam_angles_rad(num_beams)
    origins = np.repeat(poses[:, :2], num_beams, axis=0)
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1).reshape(-1, 2)
    ranges = np.zeros(len(origins))
    active = np.arange(len(origins))
    while active.size:
        clearance = plan.clearance_at_m(origins[active] + ranges[active, None] * directions[active])
        active = active[clearance > 0.0]
        # Clearance runs from centre to centre: ray and obstacle may each stand half a diagonal nearer.
        ranges[active] += np.maximum(clearance[clearance > 0.0] - _HALF_DIAGONALS_M, _LEAST_STEP_M)
        active = active[ranges[active] <= max_range_m]
    ranges[ranges > max_range_m] = np.inf
    return ranges.reshape(len(poses), num_beams)
