"""Missions: robots that explore floor plans, each mapping in a frame that it shares with nobody."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterator

import numpy as np

from mapfusion.grid import Mask
from mapfusion.simulation.explore import SPEED_M_S, Explorer
from mapfusion.simulation.floor_plan import random_floor_plan
from mapfusion.simulation.messages import Mission, MissionMessage
from mapfusion.simulation.mission_config import MissionConfig, generator
from mapfusion.simulation.plan import FloorPlan
from mapfusion.simulation.robot import explore, travelling_robot
from mapfusion.transform import FloatArray

_CANDIDATE_TOURS = 8
_NEAR_M = 5.0


def simulate_mission(
    config: MissionConfig, draw_plan: Callable[[np.random.Generator], FloorPlan] = random_floor_plan
) -> Mission:
    """Draws buildings and tours; the scans and maps are made when the messages are asked for.

    Robots of one building do not see each other.
    """
    plans = [draw_plan(generator(config, "plan", k)) for k in range(config.num_buildings)]
    headings_rad = [generator(config, "heading", k).uniform(-math.pi, math.pi) for k in range(config.num_robots)]
    robots = [travelling_robot(config, k, tour, headings_rad[k]) for k, tour in enumerate(_tours_m(config, plans))]

    def messages() -> Iterator[MissionMessage]:
        streams = (explore(config, k, robot, plans[robot.building]) for k, robot in enumerate(robots))
        return heapq.merge(*streams, key=lambda message: message.stamp_ns)

    return Mission(tuple(robots), config.odometry_noise == 0.0, messages)


def _tours_m(config: MissionConfig, plans: list[FloorPlan]) -> list[FloatArray]:
    """A tour for every robot; of a few drawn ones that whose overlap with earlier robots comes nearest to the wish."""
    explorers = [Explorer(plan) for plan in plans]
    tours: list[FloatArray] = []
    surveys: list[Mask] = []
    for robot in range(config.num_robots):
        rng = generator(config, "tour", robot)
        building = robot % config.num_buildings
        explorer, others = explorers[building], range(building, robot, config.num_buildings)
        candidates: list[tuple[float, FloatArray, Mask]] = []
        for number in range(_CANDIDATE_TOURS if others else 1):
            start_m = explorer.places_m[rng.integers(len(explorer.places_m))]
            if number % 2:
                other = tours[others[rng.integers(len(others))]]
                start_m = other[rng.integers(len(other))] + rng.normal(0.0, _NEAR_M, 2)
            tour = explorer.tour_m(start_m, config.duration_s * SPEED_M_S, rng)
            seen = explorer.survey(tour, config.lidar.max_range_m)
            overlaps = [np.count_nonzero(seen & surveys[k]) / min(seen.sum(), surveys[k].sum()) for k in others]
            candidates.append((abs(max(overlaps, default=config.overlap) - config.overlap), tour, seen))
        _, tour, seen = min(candidates, key=lambda candidate: candidate[0])
        tours.append(tour)
        surveys.append(seen)
    return tours
