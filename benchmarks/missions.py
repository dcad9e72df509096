"""Whole missions against their truth: `python benchmarks/missions.py [--seeds 1 2 3 ...] [--robots 3] [--buildings 1]`.

With `--place racks` (or rooms, mazes) in places that repeat themselves instead of floor plans, see `places.py`.

Without seeds: ten missions of 2 to 12 robots, two of them with buildings that never meet, with the seeds from
`--first-seed` on; only seeds that were never used say how the method does on missions that it was not made with.

For each mission: pairs that the truth ties and the last snapshot places within 0.15 m and 1 degree, placements that
are ever more than 0.5 m or 5 degrees off or between buildings, the largest jump of a placed robot in an unchanged
group, and the speed.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

from places import PLACES, plan_of

from mapfusion.config import ReplayConfig
from mapfusion.grid import OccupancyGrid
from mapfusion.pipeline import replay
from mapfusion.simulation.events import mission_events
from mapfusion.simulation.floor_plan import random_floor_plan
from mapfusion.simulation.messages import Mission
from mapfusion.simulation.mission import simulate_mission
from mapfusion.simulation.mission_config import MissionConfig
from mapfusion.simulation.truth import overlap_ratio
from mapfusion.steps import FusionStep, GridEvent, Placement
from mapfusion.transform import SE2

SUITE = (
    MissionConfig(num_robots=2, duration_s=100.0),
    MissionConfig(num_robots=2, duration_s=60.0, overlap=0.4),
    MissionConfig(num_robots=3, duration_s=120.0),
    MissionConfig(num_robots=3, duration_s=80.0, updates=True),
    MissionConfig(num_robots=4, num_buildings=2, duration_s=100.0),
    MissionConfig(num_robots=5, duration_s=100.0),
    MissionConfig(num_robots=6, num_buildings=2, duration_s=100.0),
    MissionConfig(num_robots=8, duration_s=80.0, graded=True),
    MissionConfig(num_robots=10, duration_s=80.0),
    MissionConfig(num_robots=12, duration_s=80.0),
)
MIN_OVERLAP = 0.3


@dataclass(slots=True)
class Judged:
    """What a replay came to."""

    num_tied: int = 0
    num_right: int = 0
    num_wrong_placements: int = 0
    largest_jump_m: float = 0.0
    worst_error_m: float = 0.0
    elapsed_s: float = 0.0


def main() -> None:
    """Prints a line for each mission."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="*", default=[])
    parser.add_argument("--first-seed", type=int, default=1001)
    parser.add_argument("--robots", type=int, default=3)
    parser.add_argument("--buildings", type=int, default=1)
    parser.add_argument("--duration", type=float, default=80.0)
    parser.add_argument("--place", choices=list(PLACES), help="of which kind the places are; floor plans otherwise")
    parser.add_argument("--jobs", type=int, default=1)
    arguments = parser.parse_args()
    given = [
        MissionConfig(
            seed=seed, num_robots=arguments.robots, num_buildings=arguments.buildings, duration_s=arguments.duration
        )
        for seed in arguments.seeds
    ]
    suite = [replace(config, seed=arguments.first_seed + number) for number, config in enumerate(SUITE)]
    for config in given or suite:
        judged = judge(config, arguments.jobs, arguments.place)
        print(
            f"seed {config.seed}: {config.num_robots} robots, {config.num_buildings} buildings, "
            f"{config.duration_s:.0f} s: "
            f"right {judged.num_right}/{judged.num_tied}, wrong placements {judged.num_wrong_placements}, "
            f"largest jump {judged.largest_jump_m:.2f} m, worst final error {judged.worst_error_m:.3f} m, "
            f"{config.duration_s / judged.elapsed_s:.1f} times real time",
            flush=True,
        )


def judge(config: MissionConfig, jobs: int, place: str | None = None) -> Judged:
    """Simulates, replays and compares with the truth."""
    mission = simulate_mission(config, random_floor_plan if place is None else partial(plan_of, place))
    truth = {robot.name: robot for robot in mission.robots}
    recorded = list(mission_events(mission))  # so that the simulation's own time does not count
    last_maps = {event.robot: event.grid for event in recorded if isinstance(event, GridEvent)}
    judged, step, before = Judged(), None, None
    started_s = time.perf_counter()
    steps = list(replay(recorded, ReplayConfig(jobs=jobs)))
    judged.elapsed_s = time.perf_counter() - started_s
    for step in steps:
        for a, b in together(step):
            error_m, error_rad = error(step.placements, truth[a].T_world_map, truth[b].T_world_map, a, b)
            apart = truth[a].building != truth[b].building
            judged.num_wrong_placements += apart or error_m > 0.5 or math.degrees(error_rad) > 5.0
        judged.largest_jump_m = max(judged.largest_jump_m, jump(before, step))
        before = step
    assert step is not None
    for a, b in tied(mission, last_maps):
        judged.num_tied += 1
        if (a, b) in together(step):
            error_m, error_rad = error(step.placements, truth[a].T_world_map, truth[b].T_world_map, a, b)
            judged.num_right += error_m < 0.15 and math.degrees(error_rad) < 1.0
            judged.worst_error_m = max(judged.worst_error_m, error_m)
    return judged


def together(step: FusionStep) -> set[tuple[str, str]]:
    """Pairs of robots in one group."""
    return {(a, b) for a, b in combinations(step.placements, 2) if step.placements[a].group == step.placements[b].group}


def error(placements: Mapping[str, Placement], T_world_a: SE2, T_world_b: SE2, a: str, b: str) -> tuple[float, float]:
    """Distance and angle between where two robots are placed to each other and where they are."""
    found = placements[a].T_group_map.inverse() @ placements[b].T_group_map
    true = T_world_a.inverse() @ T_world_b
    return (true.inverse() @ found).distance_to(SE2.identity())


def jump(before: FusionStep | None, step: FusionStep) -> float:
    """The largest step of a placed robot's map frame between two snapshots with the same groups, metres."""
    if before is None:
        return 0.0
    groups = [{robot: p.group for robot, p in one.placements.items()} for one in (before, step)]
    if groups[0] != groups[1]:
        return 0.0
    return max(
        (p.T_group_map.distance_to(before.placements[robot].T_group_map)[0] for robot, p in step.placements.items()),
        default=0.0,
    )


def tied(mission: Mission, last_maps: Mapping[str, OccupancyGrid]) -> list[tuple[str, str]]:
    """Pairs that a chain of overlaps of `MIN_OVERLAP` ties in the end."""
    root = {robot.name: robot.name for robot in mission.robots}
    for a, b in combinations(mission.robots, 2):
        if a.building == b.building:
            T_a_b = a.T_world_map.inverse() @ b.T_world_map
            if overlap_ratio(last_maps[a.name], last_maps[b.name], T_a_b) >= MIN_OVERLAP:
                old, new = root[b.name], root[a.name]
                root = {name: new if its == old else its for name, its in root.items()}
    return [(a, b) for a, b in combinations(root, 2) if root[a] == root[b]]


if __name__ == "__main__":
    main()
