"""Missions as they leave the pipeline, made up."""

from __future__ import annotations

import numpy as np

from mapfusion.grid import OccupancyGrid
from mapfusion.result import PairFusion
from mapfusion.steps import FusionStep, PairReport, Path, Placement
from mapfusion.transform import SE2

START_NS = 1_700_000_000_000_000_000
MAP_FRAMES = {"robot1": "robot1/map", "robot2": "robot2/map", "robot3": "robot3/map"}
T_WORLD_2 = SE2(3.0, -1.0, 0.5)


def make_grid(width: int = 40, height: int = 30, seed: int = 0) -> OccupancyGrid:
    cells = np.random.default_rng(seed).choice(np.array([-1, 0, 40, 100], dtype=np.int8), (height, width))
    return OccupancyGrid(cells, 0.05, SE2(-1.0, -2.0, 0.25))


def make_pair(a: str, b: str, fusion: PairFusion, *, placed: bool | None = None) -> PairReport:
    return PairReport(a, b, fusion, fusion.accepted if placed is None else placed, age_a_s=0.5, age_b_s=1.5)


def make_refusal() -> PairFusion:
    return PairFusion(accepted=False, reason="only 3 matches, 10 are needed", gate="few matches", num_matches=3)


def make_acceptance() -> PairFusion:
    return PairFusion(
        accepted=True,
        T_target_source=T_WORLD_2,
        confidence=0.9,
        mae=12.25,
        overlap_ratio=0.5,
        overlap_cells=500,
        covariance=np.diag([1e-4, 1e-4, 1e-6]),
        resolution_m=0.05,
        evidence={"wall_share": 0.75},
    )


def make_steps(num_steps: int = 6) -> list[FusionStep]:
    """Robots 1 and 2 are joined at the third step and robot 3 never; a map every other step; paths at the end."""
    steps = []
    for k in range(num_steps):
        stamp_ns, is_last = START_NS + k * 10**9, k == num_steps - 1
        refused = make_pair("robot1", "robot3", make_refusal())
        if k < 2:
            pairs = (make_pair("robot1", "robot2", make_refusal()), refused)
            steps.append(FusionStep(stamp_ns, is_last, {}, {}, pairs, {}, map_frames=MAP_FRAMES))
            continue
        joined = k == 2
        steps.append(
            FusionStep(
                stamp_ns,
                is_last,
                placements={"robot1": Placement(1, SE2.identity()), "robot2": Placement(1, T_WORLD_2)},
                poses={"robot1": SE2(0.1 * k, 0.0, 0.0), "robot2": SE2(1.0, 0.1 * k, 1.0)},
                pairs=(make_pair("robot1", "robot2", make_acceptance()), refused) if joined else (),
                maps={1: make_grid(40 + k, 30, seed=k)} if k % 2 == 0 or is_last else {},
                changes=("robot1 and robot2 form group 1",) if joined else (),
                paths={"robot1": make_path(5), "robot2": make_path(7)} if is_last else {},
                map_frames=MAP_FRAMES,
            )
        )
    return steps


def make_path(num_poses: int) -> Path:
    poses = np.random.default_rng(num_poses).uniform(-2.0, 2.0, (num_poses, 3))
    return Path(START_NS + 10**8 * np.arange(num_poses, dtype=np.int64), poses)
