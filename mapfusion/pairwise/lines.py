"""How many different walls agree: one corner is two, however long its walls.

Cells of one straight wall agree together once the wall does, and any corner fits any other. What tells places apart
is how many walls, each with its own direction and offset, agree at once.
"""

from __future__ import annotations

import math

import numpy as np

from mapfusion.pairwise.poses import Poses, inverse
from mapfusion.pairwise.refine import encounters
from mapfusion.pairwise.surface import NOT_KNOWN, Surface, SurfaceField

NUM_DIRECTIONS = 24
OFFSET_CELLS = 8.0
"""Walls count as one where their directions and their offsets fall into one bin."""
NUM_POINTS = 2000


def agreeing_lines(target: SurfaceField, source: SurfaceField, pose: Poses, tolerance_cells: float) -> float:
    """Effective number of walls that agree under `pose` (3,): (sum n)^2 / sum n^2 over walls of n agreeing cells.

    The mean of both directions. Source: the participation ratio (inverse Simpson index).
    """
    forward = _effective_number(target, source.surface, pose[None], tolerance_cells)
    return (forward + _effective_number(source, target.surface, inverse(pose[None]), tolerance_cells)) / 2.0


def _effective_number(field: SurfaceField, surface: Surface, pose: Poses, tolerance_cells: float) -> float:
    surface = surface.thinned(NUM_POINTS)
    found = encounters(field, surface, pose)
    known = field.depth.ravel().take(found.cells[0]) != NOT_KNOWN
    agrees = known & found.same_side[0] & (found.squared[0] <= tolerance_cells**2)
    normals, points = surface.normals[agrees], surface.points[agrees]
    step = 2.0 * math.pi / NUM_DIRECTIONS
    direction = np.round(np.arctan2(normals[:, 1], normals[:, 0]) / step).astype(np.int64) % NUM_DIRECTIONS
    offset = points[:, 0] * np.cos(direction * step) + points[:, 1] * np.sin(direction * step)
    walls = np.stack([direction, np.round(offset / OFFSET_CELLS).astype(np.int64)], axis=-1)
    _, cells = np.unique(walls, axis=0, return_counts=True)
    return float(np.square(cells.sum()) / max(1.0, float(np.square(cells).sum())))
