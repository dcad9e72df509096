"""How a robot moves: tours over the places of a floor plan, along shortest paths, at the speed of an indoor robot."""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from mapfusion.grid import Mask
from mapfusion.simulation.lidar import beam_angles_rad, cast_rays
from mapfusion.simulation.plan import PLAN_RESOLUTION_M, FloorPlan
from mapfusion.transform import FloatArray

ROBOT_RADIUS_M = 0.2
"""Least clearance of every pose of a path."""
SPEED_M_S = 0.5
"""Speed of a robot that drives straight on."""

_NODE_M = 0.2
_PLANNED_CLEARANCE_M = 0.32
_TURN_RATE_RAD_S = 1.0
_SAMPLE_M = 0.05
_SMOOTHING_M = 0.5
_VISITED_M = 2.0
_SURVEY_BEAMS = 120
_SURVEY_STEP_M = 1.0
_NEIGHBOURS = [(dr, dc, math.hypot(dr, dc)) for dr in (-1, 0, 1) for dc in (-1, 0, 1) if dr or dc]

Node = tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Where a robot is when; between two stamps it moves in a straight line and turns evenly.

    Attributes:
        stamps_ns: (N,) int64, growing. Read-only.
        poses: (N, 3) x and y in metres, yaw in radians without jumps of a full turn, in the world. Read-only.
    """

    stamps_ns: npt.NDArray[np.int64]
    poses: FloatArray

    def __post_init__(self) -> None:
        self.stamps_ns.flags.writeable = False
        self.poses.flags.writeable = False


class Explorer:
    """Plans tours on one floor plan; works on a lattice of nodes that a robot can stand on."""

    def __init__(self, plan: FloorPlan) -> None:
        self._plan = plan
        rows, cols = (int(n * PLAN_RESOLUTION_M / _NODE_M) for n in plan.occupied.shape)
        self._centres_m = np.stack(np.meshgrid(np.arange(cols) + 0.5, np.arange(rows) + 0.5), axis=-1) * _NODE_M
        standable = plan.clearance_at_m(self._centres_m) >= _PLANNED_CLEARANCE_M
        _, labels, stats, _ = cv2.connectedComponentsWithStats(standable.astype(np.uint8), connectivity=4)
        self._standable: Mask = labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
        self._places = sorted({self._nearest_node(place) for place in plan.places_m})

    @property
    def places_m(self) -> FloatArray:
        """(N, 2) places that can be reached, metres."""
        return np.array([self._centres_m[place] for place in self._places])

    def tour_m(self, start_m: FloatArray, length_m: float, rng: np.random.Generator) -> FloatArray:
        """(N, 2) points every 0.05 m of a smooth tour of at most `length_m`.

        It starts where a robot can stand nearest to `start_m`, and goes on to one of the nearest places that were not
        passed yet; when there is none left, all count as new.
        """
        nodes = [self._nearest_node(start_m)]
        remaining: set[Node] = set()
        walked_m = 0.0
        while walked_m < length_m:
            position = self._centres_m[nodes[-1]]
            remaining = {p for p in remaining if math.dist(self._centres_m[p], position) > _VISITED_M} or {
                p for p in self._places if math.dist(self._centres_m[p], position) > _VISITED_M
            }
            goals = sorted(remaining)
            costs = np.linalg.norm(np.array([self._centres_m[goal] for goal in goals]) - position, axis=1)
            goal = goals[int(np.argmin(costs * rng.uniform(0.5, 1.5, len(goals))))]
            leg = self._shortest_path(nodes[-1], goal)
            passed = np.array([self._centres_m[node] for node in leg])
            remaining -= {
                p for p in remaining if np.linalg.norm(passed - self._centres_m[p], axis=1).min() <= _VISITED_M
            }
            walked_m += float(np.linalg.norm(np.diff(passed, axis=0), axis=1).sum())
            nodes += leg[1:]
        tour = self._smooth(np.array([self._centres_m[node] for node in nodes]))
        return tour[: max(2, math.ceil(length_m / _SAMPLE_M))]

    def survey(self, tour_m: FloatArray, max_range_m: float) -> Mask:
        """What a robot would about see on a tour: a mask of the plan in cells of 0.2 m."""
        stops = tour_m[:: round(_SURVEY_STEP_M / _SAMPLE_M)]
        poses = np.column_stack([stops, np.zeros(len(stops))])
        ranges = np.minimum(cast_rays(self._plan, poses, _SURVEY_BEAMS, max_range_m), max_range_m)
        angles = beam_angles_rad(_SURVEY_BEAMS)
        ends = stops[:, None] + ranges[..., None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        seen = np.zeros(self._standable.shape, np.uint8)
        for outline in ends:
            cv2.fillPoly(seen, [np.floor(outline / _NODE_M).astype(np.int32)], (1.0,))
        return seen > 0

    def _nearest_node(self, point_m: FloatArray) -> Node:
        distance = np.where(self._standable, np.linalg.norm(self._centres_m - point_m, axis=-1), np.inf)
        row, col = divmod(int(np.argmin(distance)), distance.shape[1])
        return row, col

    def _shortest_path(self, start: Node, goal: Node) -> list[Node]:
        """A* over the eight neighbours; start and goal are nodes a robot can stand on."""
        standable, goal_row, goal_col = self._standable, *goal
        height, width = standable.shape
        cost: dict[Node, float] = {start: 0.0}
        parent: dict[Node, Node] = {}
        queue = [(0.0, start)]
        done: set[Node] = set()
        while queue:
            _, node = heapq.heappop(queue)
            if node == goal:
                break
            if node in done:
                continue
            done.add(node)
            row, col = node
            for step_row, step_col, step in _NEIGHBOURS:
                r, c = row + step_row, col + step_col
                if not (0 <= r < height and 0 <= c < width and standable[r, c]):
                    continue
                reached = cost[node] + step
                if reached < cost.get((r, c), math.inf):
                    cost[r, c] = reached
                    parent[r, c] = node
                    heapq.heappush(queue, (reached + math.hypot(r - goal_row, c - goal_col), (r, c)))
        path = [goal]
        while path[-1] != start:
            path.append(parent[path[-1]])
        return path[::-1]

    def _smooth(self, points_m: FloatArray) -> FloatArray:
        """A path with its corners rounded, except where that would bring it too near to something."""
        dense = resample_path(points_m)
        half = round(_SMOOTHING_M / _SAMPLE_M)
        padded = np.concatenate([np.repeat(dense[:1], half, axis=0), dense, np.repeat(dense[-1:], half, axis=0)])
        kernel = np.ones(2 * half + 1) / (2 * half + 1)
        rounded = np.stack([np.convolve(padded[:, k], kernel, mode="valid") for k in range(2)], axis=-1)
        too_near = self._plan.clearance_at_m(rounded) < ROBOT_RADIUS_M + PLAN_RESOLUTION_M
        # The change between both paths is spread over a metre, so that it makes no corner of its own.
        weight = np.convolve(np.pad(too_near.astype(float), 2 * half, mode="edge"), np.ones(2 * half + 1), mode="same")
        keep = np.convolve(np.minimum(weight, 1.0), kernel, mode="same")[2 * half : -2 * half, None]
        return resample_path(keep * dense + (1.0 - keep) * rounded)


def follow(points_m: FloatArray, start_ns: int, duration_s: float, step_s: float, first_yaw_rad: float) -> Trajectory:
    """A robot that turns from its first heading into the path and follows it, looking ahead, for `duration_s`.

    It drives at 0.5 m/s, and slower where it would have to turn faster than 1 rad/s. Beyond the end of the path it
    stands. Poses are given every `step_s`, the last one at `duration_s`.
    """
    steps = np.diff(points_m, axis=0)
    headings = np.unwrap(np.concatenate([[first_yaw_rad], np.arctan2(steps[:, 1], steps[:, 0])]))
    seconds = np.maximum(
        np.linalg.norm(steps, axis=1) / SPEED_M_S, np.abs(np.diff(headings)) / _TURN_RATE_RAD_S
    ).cumsum()
    times_s = np.concatenate([[0.0], seconds])
    num_steps = max(1, math.floor(duration_s / step_s + 1e-9))
    offsets_ns = np.arange(num_steps + 1, dtype=np.int64) * round(step_s * 1e9)
    wanted_s = offsets_ns * 1e-9
    columns = [np.interp(wanted_s, times_s, values) for values in (points_m[:, 0], points_m[:, 1], headings)]
    return Trajectory(start_ns + offsets_ns, np.stack(columns, axis=-1))


def resample_path(points_m: FloatArray) -> FloatArray:
    """Points every 0.05 m of a polyline, without standstills."""
    lengths = np.linalg.norm(np.diff(points_m, axis=0), axis=1)
    moving = np.concatenate([[True], lengths > 1e-9])
    points_m, along = points_m[moving], np.concatenate([[0.0], lengths[moving[1:]].cumsum()])
    wanted = np.arange(0.0, along[-1], _SAMPLE_M)
    return np.stack([np.interp(wanted, along, points_m[:, k]) for k in range(2)], axis=-1)
