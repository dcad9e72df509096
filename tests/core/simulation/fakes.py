"""A plan that can be measured with a ruler."""

from __future__ import annotations

import cv2
import numpy as np

from mapfusion.simulation.plan import PLAN_RESOLUTION_M, FloorPlan


def room(width_m: float = 8.0, depth_m: float = 6.0) -> FloorPlan:
    """One empty room, its inner corner at (1, 1), in walls of 1 m."""
    shape = tuple(round((side + 2.0) / PLAN_RESOLUTION_M) for side in (depth_m, width_m))
    occupied = np.ones(shape, np.uint8)
    thick = round(1.0 / PLAN_RESOLUTION_M)
    occupied[thick:-thick, thick:-thick] = 0
    clearance = cv2.distanceTransform(1 - occupied, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * PLAN_RESOLUTION_M
    places = np.array([[2.0, 2.0], [width_m, depth_m], [width_m, 2.0]])
    return FloorPlan(occupied > 0, np.ascontiguousarray(clearance, np.float32), places)
