"""Pairs of maps with known truth: patches of the paper's generator, and floor plans mapped by lidar robots."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mapfusion.grid import OccupancyGrid
from mapfusion.pairwise.agreement import agreement
from mapfusion.simulation import paper
from mapfusion.simulation.explore import Explorer
from mapfusion.simulation.floor_plan import random_floor_plan
from mapfusion.simulation.lidar import LidarConfig, scan
from mapfusion.simulation.mapping import GridMapper
from mapfusion.transform import SE2, FloatArray

Generator = Literal["paper", "floor-plans"]

LEAST_OVERLAP = 0.05
"""Maps of one floor plan that share less than this of the smaller one's known area are drawn anew."""

_RESOLUTION_M = 0.05
_TOUR_M = (12.0, 60.0)
_SCAN_EVERY_M = 0.5
_TOUR_STEP_M = 0.05
_FRAME_OFFSET_M = 30.0
_LIDAR = LidarConfig()


@dataclass(frozen=True, slots=True, eq=False)
class StudyPair:
    """Two maps and what is true about them.

    Attributes:
        target: One map.
        source: The other one.
        T_target_source: The exact transform between their frames; None where they show different places.
        overlap_ratio: Area known in both / known area of the smaller map; 0 where they show different places.
        T_source_robot: A robot somewhere in the known free area of the source, in the source's frame.
    """

    target: OccupancyGrid
    source: OccupancyGrid
    T_target_source: SE2 | None
    overlap_ratio: float
    T_source_robot: SE2


def make_pair(generator: Generator, related: bool, seed: int) -> StudyPair:
    """The pair of a seed: of one place where `related`, else of two."""
    rng = np.random.default_rng(seed)
    if generator == "paper":
        patches = paper.positive_pair(seed) if related else paper.negative_pair(seed)
        target, source = patches.target, patches.source
        return StudyPair(target, source, patches.T_target_source, patches.overlap_ratio, _place_robot(source, rng))
    return _related_floor_plans(rng) if related else _unrelated_floor_plans(rng)


def _place_robot(grid: OccupancyGrid, rng: np.random.Generator) -> SE2:
    """A robot at the centre of a random free cell, with a random heading."""
    free_m = grid.centres_m(grid.free)
    x_m, y_m = free_m[rng.integers(len(free_m))]
    return SE2(x_m, y_m, rng.uniform(-math.pi, math.pi))


def _related_floor_plans(rng: np.random.Generator) -> StudyPair:
    explorer = _FloorPlanExplorer(rng)
    while True:
        (target, T_world_target), (source, T_world_source) = explorer.map("target", rng), explorer.map("source", rng)
        T_target_source = T_world_target.inverse() @ T_world_source
        overlap_ratio = agreement(target, source, T_target_source).overlap_ratio
        if overlap_ratio >= LEAST_OVERLAP:
            return StudyPair(target, source, T_target_source, overlap_ratio, _place_robot(source, rng))


def _unrelated_floor_plans(rng: np.random.Generator) -> StudyPair:
    target, _ = _FloorPlanExplorer(rng).map("target", rng)
    source, _ = _FloorPlanExplorer(rng).map("source", rng)
    return StudyPair(target, source, None, 0.0, _place_robot(source, rng))


class _FloorPlanExplorer:
    """Robots that map parts of one random floor plan, each in a frame of its own."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._plan = random_floor_plan(rng)
        self._explorer = Explorer(self._plan)

    def map(self, frame_id: str, rng: np.random.Generator) -> tuple[OccupancyGrid, SE2]:
        """The map after one tour, and the pose of its frame in the plan's world."""
        places_m = self._explorer.places_m
        start_m = places_m[rng.integers(len(places_m))]
        tour_m = self._explorer.tour_m(start_m, rng.uniform(*_TOUR_M), rng)
        poses_world = _poses_along(tour_m)
        ranges = scan(self._plan, poses_world, _LIDAR, rng)

        x_m, y_m = rng.uniform(-_FRAME_OFFSET_M, _FRAME_OFFSET_M, 2)
        T_world_map = SE2(x_m, y_m, rng.uniform(-math.pi, math.pi))
        T_map_world = T_world_map.inverse()
        poses_map = np.column_stack([T_map_world.apply(poses_world[:, :2]), poses_world[:, 2] + T_map_world.yaw_rad])
        corner_x_m, corner_y_m = rng.uniform(0.0, _RESOLUTION_M, 2)
        mapper = GridMapper(frame_id, _RESOLUTION_M, (corner_x_m, corner_y_m), _LIDAR)
        for pose, one_scan in zip(poses_map, ranges, strict=True):
            mapper.add_scan(pose, one_scan)
        return mapper.grid(stamp_ns=0), T_world_map


def _poses_along(tour_m: FloatArray) -> FloatArray:
    """(N, 3) poses of x, y and heading where a tour is scanned from."""
    steps = np.gradient(tour_m, axis=0)
    headings = np.arctan2(steps[:, 1], steps[:, 0])
    return np.column_stack([tour_m, headings])[:: round(_SCAN_EVERY_M / _TOUR_STEP_M)]
