"""What stands in the rooms of a floor plan."""

from __future__ import annotations

import cv2
import numpy as np

from mapfusion.simulation.plan import PLAN_RESOLUTION_M, Raster, plan_cells

_WALKWAY_M = 0.7


def furnish(room: Raster, keep_clear: Raster, corridor: bool, rng: np.random.Generator) -> None:
    """Puts cupboards along the walls, and tables and pillars between them, a walkway apart from each other.

    Args:
        room: (height, width) view of a plan, a room or corridor without its walls; 1 is painted into it.
        keep_clear: (height, width), not 0 where nothing may stand, such as at doors.
        corridor: Only flat things along the walls.
        rng: Draws what stands where.
    """
    area_m2 = room.size * PLAN_RESOLUTION_M**2
    blocked = keep_clear.copy()
    walkway = np.ones((2 * plan_cells(_WALKWAY_M) + 1,) * 2, np.uint8)
    num_along_walls, num_inside = rng.poisson(area_m2 / 9.0), 0 if corridor else rng.poisson(area_m2 / 14.0)
    for k in range(num_along_walls + num_inside):
        item = np.zeros_like(room)
        if k < num_along_walls:
            _paint_at_wall(item, 0.25 if corridor else 0.6, rng)
        else:
            _paint_inside(item, rng)
        if not np.any(item & blocked):
            room |= item
            blocked |= cv2.dilate(item, walkway).astype(np.uint8)


def _paint_at_wall(item: Raster, deepest_m: float, rng: np.random.Generator) -> None:
    """A cupboard, or where it is short a pillar, with its back to one of the four walls."""
    length, depth = plan_cells(rng.uniform(0.3, 2.2)), plan_cells(rng.uniform(0.15, deepest_m))
    turned = np.rot90(item, int(rng.integers(4)))
    start = int(rng.integers(0, max(turned.shape[1] - length, 1)))
    turned[:depth, start : start + length] = 1


def _paint_inside(item: Raster, rng: np.random.Generator) -> None:
    """A table, roughly parallel to the walls or not, or a round pillar."""
    height, width = item.shape
    centre = rng.uniform(0.15, 0.85) * width, rng.uniform(0.15, 0.85) * height
    if rng.random() < 0.3:
        cv2.circle(item, (round(centre[0]), round(centre[1])), plan_cells(rng.uniform(0.12, 0.4)), (1.0,), cv2.FILLED)
        return
    size = plan_cells(rng.uniform(0.7, 1.8)), plan_cells(rng.uniform(0.4, 0.9))
    angle_deg = rng.uniform(0.0, 180.0) if rng.random() < 0.35 else 90.0 * rng.integers(2) + rng.normal(0.0, 4.0)
    corners = cv2.boxPoints((centre, size, float(angle_deg)))
    cv2.fillConvexPoly(item, np.round(corners).astype(np.int32), (1.0,))
