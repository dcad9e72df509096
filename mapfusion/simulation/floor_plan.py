"""Random floor plans: corridors with rooms off them, doors, furniture, loops and no symmetry."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations, pairwise

import cv2
import numpy as np

from mapfusion.simulation.furniture import furnish
from mapfusion.simulation.plan import PLAN_RESOLUTION_M, FloorPlan, plan_cells

SIDE_M = (24.0, 44.0)
"""Least and greatest outer length of a building, metres; its depth is 0.55 to 0.85 of that."""

_INNER_WALL, _OUTER_WALL = 2, 4
_CORRIDOR_M = (1.8, 2.8)
_DOOR_M = (0.8, 1.2)
_LONGEST_ROOM_M = (5.0, 9.0)
_DOOR_CLEARANCE_M = 1.0
_LOOP_CHANCE = 0.3


@dataclass(frozen=True, slots=True)
class _Region:
    """A room or corridor: the free cells [left, right) x [bottom, top)."""

    left: int
    bottom: int
    right: int
    top: int
    corridor: bool = False

    @property
    def width(self) -> int:
        return self.right - self.left

    @property
    def height(self) -> int:
        return self.top - self.bottom


def random_floor_plan(rng: np.random.Generator) -> FloorPlan:
    """A storey of about 24 to 44 m by 14 to 36 m."""
    length_m = rng.uniform(*SIDE_M)
    depth_m = length_m * rng.uniform(0.55, 0.85)
    width, height = plan_cells(length_m), plan_cells(depth_m)
    if rng.random() < 0.5:
        width, height = height, width
    storey = _Region(_OUTER_WALL, _OUTER_WALL, width - _OUTER_WALL, height - _OUTER_WALL)
    regions = _without_corners(_divide(storey, 0, rng), storey, rng)

    occupied = np.ones((height, width), np.uint8)
    for region in regions:
        occupied[region.bottom : region.top, region.left : region.right] = 0
    keep_clear = np.zeros_like(occupied)
    for opening in _openings(regions, rng):
        occupied[opening.bottom : opening.top, opening.left : opening.right] = 0
        centre = ((opening.left + opening.right) // 2, (opening.bottom + opening.top) // 2)
        cv2.circle(keep_clear, centre, plan_cells(_DOOR_CLEARANCE_M), (1.0,), cv2.FILLED)
    for region in regions:
        window = slice(region.bottom, region.top), slice(region.left, region.right)
        furnish(occupied[window], keep_clear[window], region.corridor, rng)

    clearance = cv2.distanceTransform(1 - occupied, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * PLAN_RESOLUTION_M
    places = np.array([place for region in regions for place in _places_m(region)])
    return FloorPlan(occupied > 0, np.ascontiguousarray(clearance, np.float32), places)


def _divide(region: _Region, level: int, rng: np.random.Generator) -> list[_Region]:
    """Cuts a region by corridors, first along it, then across, and what remains by walls into rooms."""
    longest, shortest = max(region.width, region.height), min(region.width, region.height)
    along_x = region.width >= region.height
    if level < 3 and longest > plan_cells(14.0) and shortest > plan_cells(9.0 if level == 0 else 7.0):
        # The first corridor runs along the storey; the next ones lead off it.
        wide = plan_cells(rng.uniform(*_CORRIDOR_M))
        return _cut(region, along_x if level > 0 else not along_x, wide, level, rng)
    if longest > plan_cells(rng.uniform(*_LONGEST_ROOM_M)) and longest > plan_cells(5.0):
        return _cut(region, along_x, 0, 3, rng)
    return [region]


def _cut(region: _Region, at_x: bool, corridor: int, level: int, rng: np.random.Generator) -> list[_Region]:
    """Both parts of a region, divided further, and the corridor of `corridor` cells between them if there is one."""
    low, high = (region.left, region.right) if at_x else (region.bottom, region.top)
    gap = corridor + (2 if corridor else 1) * _INNER_WALL
    middle = low + round(rng.uniform(0.34, 0.66) * (high - low))
    first_stop, second_start = middle - gap // 2, middle - gap // 2 + gap
    spans = [(low, first_stop, False), (second_start, high, False)]
    if corridor:
        spans.append((first_stop + _INNER_WALL, second_start - _INNER_WALL, True))
    parts: list[_Region] = []
    for start, stop, is_corridor in spans:
        if at_x:
            part = _Region(start, region.bottom, stop, region.top, is_corridor)
        else:
            part = _Region(region.left, start, region.right, stop, is_corridor)
        parts += [part] if is_corridor else _divide(part, level + 1, rng)
    return parts


def _without_corners(regions: list[_Region], storey: _Region, rng: np.random.Generator) -> list[_Region]:
    """Leaves one or two corner rooms out, so that the outline is no rectangle."""
    corners = [
        region
        for region in regions
        if not region.corridor
        and (region.left == storey.left or region.right == storey.right)
        and (region.bottom == storey.bottom or region.top == storey.top)
    ]
    leave_out = {corners[k] for k in rng.permutation(len(corners))[: rng.integers(1, 3)]}
    return [region for region in regions if region not in leave_out]


def _openings(regions: list[_Region], rng: np.random.Generator) -> list[_Region]:
    """Doors and open corridor crossings that tie all regions together, and some more, so that there are loops."""
    walls = [(a, b, wall) for a, b in combinations(range(len(regions)), 2) if (wall := _wall(regions[a], regions[b]))]
    order = [walls[k] for k in rng.permutation(len(walls))]
    order.sort(key=lambda item: -(regions[item[0]].corridor + regions[item[1]].corridor))
    group = list(range(len(regions)))
    openings = []
    for a, b, wall in order:
        if regions[a].corridor and regions[b].corridor:
            openings.append(wall)
        elif group[a] != group[b] or rng.random() < _LOOP_CHANCE:
            openings.append(_door(wall, rng))
        else:
            continue
        group = [group[a] if g == group[b] else g for g in group]
    return openings


def _wall(a: _Region, b: _Region) -> _Region | None:
    """The wall between two neighbours; None where they are none or share too little of it for a door."""
    bottom, top = max(a.bottom, b.bottom), min(a.top, b.top)
    left, right = max(a.left, b.left), min(a.right, b.right)
    shortest = plan_cells(_DOOR_M[1] + 0.4)
    if top - bottom >= shortest and left - right == _INNER_WALL:
        return _Region(right, bottom, left, top)
    if right - left >= shortest and bottom - top == _INNER_WALL:
        return _Region(left, top, right, bottom)
    return None


def _door(wall: _Region, rng: np.random.Generator) -> _Region:
    width, margin = plan_cells(rng.uniform(*_DOOR_M)), plan_cells(0.2)
    if wall.width == _INNER_WALL:
        start = int(rng.integers(wall.bottom + margin, wall.top - margin - width + 1))
        return _Region(wall.left, start, wall.right, start + width)
    start = int(rng.integers(wall.left + margin, wall.right - margin - width + 1))
    return _Region(start, wall.bottom, start + width, wall.top)


def _places_m(region: _Region) -> list[tuple[float, float]]:
    """Points at most about 5 m apart that cover a region."""
    xs, ys = _spread(region.left, region.right), _spread(region.bottom, region.top)
    return [(x * PLAN_RESOLUTION_M, y * PLAN_RESOLUTION_M) for y in ys for x in xs]


def _spread(start: int, stop: int) -> list[float]:
    num = max(1, math.ceil((stop - start) / plan_cells(5.0)))
    edges = np.linspace(start, stop, num + 1)
    return [float(a + b) / 2.0 for a, b in pairwise(edges)]
