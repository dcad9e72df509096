"""What a simulated mission is asked to be like."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from mapfusion.simulation.lidar import LidarConfig


@dataclass(frozen=True, slots=True)
class MissionConfig:
    """What a simulated mission is like.

    Attributes:
        seed: Seed of everything random, >= 0.
        num_robots: Robots; robot k is in building (k - 1) modulo `num_buildings`.
        num_buildings: Buildings, each with a world of its own.
        duration_s: Time from a robot's first pose to its last.
        resolutions_m: Cell size of every robot's map; a single one holds for all.
        map_period_s: Time between two maps of a robot.
        pose_period_s: Time between two poses, and between two scans.
        overlap: Overlap with some earlier robot of its building that a robot's tour is chosen for, [0, 1].
        odometry_noise: Relative error of the odometry; 0 for none. Maps are made with exact poses.
        updates: Send what changed between two maps.
        graded: Give probabilities in per cent; else 0 and 100 only.
        lidar: The robots' scanner.
    """

    seed: int = 0
    num_robots: int = 3
    num_buildings: int = 1
    duration_s: float = 100.0
    resolutions_m: tuple[float, ...] = (0.05,)
    map_period_s: float = 5.0
    pose_period_s: float = 0.2
    overlap: float = 0.5
    odometry_noise: float = 0.02
    updates: bool = False
    graded: bool = False
    lidar: LidarConfig = field(default_factory=LidarConfig)

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise ValueError(f"seed must be >= 0, not {self.seed}")
        if not 1 <= self.num_buildings <= self.num_robots:
            raise ValueError(f"{self.num_robots} robots cannot be in {self.num_buildings} buildings")
        if not (math.isfinite(self.duration_s) and self.duration_s >= 1.0):
            raise ValueError(f"duration_s must be at least 1 s, not {self.duration_s}")
        if len(self.resolutions_m) not in (1, self.num_robots):
            raise ValueError(
                f"{len(self.resolutions_m)} resolutions for {self.num_robots} robots: give one, or one each"
            )
        if not all(0.01 <= resolution_m <= 1.0 for resolution_m in self.resolutions_m):
            raise ValueError(f"resolutions_m must lie in 0.01..1 m, not {self.resolutions_m}")
        if not 0.02 <= self.pose_period_s <= self.map_period_s:
            raise ValueError(f"pose_period_s must lie in 0.02 s..map_period_s, not {self.pose_period_s}")
        if not math.isfinite(self.map_period_s):
            raise ValueError(f"map_period_s must be finite, not {self.map_period_s}")
        if not 0.0 <= self.overlap <= 1.0:
            raise ValueError(f"overlap must lie in [0, 1], not {self.overlap}")
        if not 0.0 <= self.odometry_noise <= 0.5:
            raise ValueError(f"odometry_noise must lie in [0, 0.5], not {self.odometry_noise}")

    def resolution_of(self, robot: int) -> float:
        """Cell size of the map of robot 0, 1, ..., metres."""
        return self.resolutions_m[robot if len(self.resolutions_m) > 1 else 0]


def generator(config: MissionConfig, purpose: str, number: int) -> np.random.Generator:
    """A generator of its own for every purpose, so that one robot more changes nothing for the others."""
    return np.random.default_rng([config.seed, number, *purpose.encode()])
