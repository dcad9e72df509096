"""Settings, one frozen dataclass a stage."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from mapfusion.transform import SE2

Profile = Literal["default", "paper"]
Blend = Literal["log-odds", "max", "paper"]


MAX_SPAN_S = 1e9
"""Longer than any mission: 32 years."""


@dataclass(frozen=True, slots=True)
class FusionConfig:
    """How two maps are fused.

    Attributes:
        profile: `paper` keeps to the method of Zick et al. 2025; `default` goes beyond it.
        mae_threshold: A fusion needs a MAE below this many grey levels (0..255). None: 20 for `paper`, no hard gate
            for `default`.
        seed: Seed of everything random.
    """

    profile: Profile = "default"
    mae_threshold: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if self.profile not in ("default", "paper"):
            raise ValueError(f"profile must be 'default' or 'paper', not {self.profile!r}")
        if self.mae_threshold is not None and not 0.0 < self.mae_threshold <= 255.0:
            raise ValueError(f"mae_threshold must lie in (0, 255] grey levels, not {self.mae_threshold}")


FARTHEST_PRIOR_M = 1e8
"""No place on earth is further from an origin on it."""


@dataclass(frozen=True, slots=True)
class Prior:
    """Known start of a robot.

    Attributes:
        T_world_map: Pose of the robot's map frame in the world.
        sigma_m: Standard deviation of the position; 0 with `sigma_rad` 0: it holds whatever the maps say.
        sigma_rad: Standard deviation of the heading.
    """

    T_world_map: SE2
    sigma_m: float = 0.0
    sigma_rad: float = 0.0

    @property
    def is_fixed(self) -> bool:
        """Whether it holds whatever the maps say."""
        return self.sigma_m == 0.0 and self.sigma_rad == 0.0

    def __post_init__(self) -> None:
        if math.hypot(self.T_world_map.x_m, self.T_world_map.y_m) > FARTHEST_PRIOR_M:
            raise ValueError(f"a prior's position must lie within {FARTHEST_PRIOR_M:g} m")
        sigmas = (self.sigma_m, self.sigma_rad)
        if not (all(math.isfinite(sigma) and sigma >= 0.0 for sigma in sigmas) and (min(sigmas) > 0.0) == any(sigmas)):
            raise ValueError(f"the sigmas of a prior must both be > 0, or both 0, not {sigmas}")


@dataclass(frozen=True, slots=True)
class ReplayConfig:
    """How a mission is replayed.

    Attributes:
        interval_s: Time between snapshots, > 0.
        max_age_s: A grid older than this at a snapshot starts no join; None: any age.
        map_interval_s: Least time between two merged maps of a group, >= 0; the last one is always given.
        reference: Robot whose map frame is its group's frame; None: the first robot in natural order.
        blend: How cells that several maps know are combined.
        resolution_m: Cell size of merged maps; None: the finest of the group's maps.
        priors: Known starts, by robot, in the map frame of the reference; without one of the first of all robots, which
            must be announced before the first grid then.
        never: Pairs of robots that must not come into one group.
        max_merged_cells: A merged map of more cells is not made.
        start_ns: No snapshot before this time; grids from before it still count. None: from the first stamp.
        jobs: How many pairs are looked at at once, >= 1: from 2 on in as many processes of their own. Changes the time,
            never the result.
        fusion: How two maps are fused.
    """

    interval_s: float = 1.0
    max_age_s: float | None = None
    map_interval_s: float = 5.0
    reference: str | None = None
    blend: Blend = "log-odds"
    resolution_m: float | None = None
    priors: Mapping[str, Prior] = field(default_factory=dict)
    never: frozenset[frozenset[str]] = frozenset()
    max_merged_cells: int = 25_000_000
    start_ns: int | None = None
    jobs: int = 1
    fusion: FusionConfig = field(default_factory=FusionConfig)

    def __post_init__(self) -> None:
        if not 1e-3 <= self.interval_s <= MAX_SPAN_S:
            raise ValueError(f"interval_s must lie in 0.001..{MAX_SPAN_S:g} s, not {self.interval_s}")
        if self.max_age_s is not None and not 0.0 < self.max_age_s <= MAX_SPAN_S:
            raise ValueError(f"max_age_s must be > 0 s and at most {MAX_SPAN_S:g} s, not {self.max_age_s}")
        if not 0.0 <= self.map_interval_s <= MAX_SPAN_S:
            raise ValueError(f"map_interval_s must lie in 0..{MAX_SPAN_S:g} s, not {self.map_interval_s}")
        if self.blend not in ("log-odds", "max", "paper"):
            raise ValueError(f"blend must be 'log-odds', 'max' or 'paper', not {self.blend!r}")
        if self.resolution_m is not None and not (math.isfinite(self.resolution_m) and self.resolution_m > 0.0):
            raise ValueError(f"resolution_m must be > 0 m, not {self.resolution_m}")
        if self.max_merged_cells < 1:
            raise ValueError(f"max_merged_cells must be >= 1, not {self.max_merged_cells}")
        if self.jobs < 1:
            raise ValueError(f"jobs must be >= 1, not {self.jobs}")
        for apart in self.never:
            if all(self._is_fixed(robot) for robot in apart):
                raise ValueError(
                    f"never and priors contradict each other: {' and '.join(sorted(apart))} are tied by both "
                    "their known starts"
                )

    def _is_fixed(self, robot: str) -> bool:
        """Whether it is known for sure where a robot's map lies in the world."""
        if robot in self.priors:
            return self.priors[robot].is_fixed
        return robot == self.reference and bool(self.priors)
