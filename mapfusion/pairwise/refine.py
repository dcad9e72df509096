"""Poses to a fraction of a cell: the walls of each map are drawn onto those of the other.

Point-to-line ICP in both directions at once with an annealed robust kernel, many poses side by side. Walls attract
each other only where they were seen from the same side.
Source: Chen and Medioni, Image and Vision Computing 1992 (point to plane); Tukey's biweight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mapfusion.pairwise.poses import Poses, inverse, moved, rotations, turned
from mapfusion.pairwise.surface import Floats, Indices, Surface, SurfaceField

SAME_SIDE_COSINE = 0.5
"""Normals within 60 degrees count as one wall seen from one side."""
SETTLED = np.array([1e-2, 1e-2, 1e-4])
"""Steps below this, in cells and radians, change nothing any more: a pose that stands goes on to the closest reach."""

_ONE = np.eye(3)


@dataclass(frozen=True, slots=True, eq=False)
class Encounters:
    """What points of one map meet in the field of the other, (K, N) for K poses and N points; lengths in cells.

    Attributes:
        cells: Flat index of the field's cell below the point.
        arms: (K, 2, N) from the pose's origin to the point, in the field's axes.
        lines: (K, 2, N) normals of the nearest walls.
        gap: Signed distance to the nearest wall's line, along its normal.
        squared: Squared distance to the nearest wall's point.
        same_side: Whether both walls were seen from the same side.
    """

    cells: Indices
    arms: Floats
    lines: Floats
    gap: Floats
    squared: Floats
    same_side: npt.NDArray[np.bool_]


def encounters(field: SurfaceField, surface: Surface, poses: Poses) -> Encounters:
    """What the points of `surface` meet in `field` under `poses` (K, 3)."""
    R = rotations(poses)
    arms = turned(R, surface.points)
    points = arms + poses[:, :2, None].astype(np.float32)
    facing = turned(R, surface.normals)
    cells = field.cells_below(points)
    wall = field.walls.take(field.nearest.ravel().take(cells), axis=1)
    dx, dy, nx, ny = points[:, 0] - wall[0], points[:, 1] - wall[1], wall[2], wall[3]
    return Encounters(
        cells=cells,
        arms=arms,
        lines=wall[2:].transpose(1, 0, 2),
        gap=dx * nx + dy * ny,
        squared=dx * dx + dy * dy,
        same_side=facing[:, 0] * nx + facing[:, 1] * ny > SAME_SIDE_COSINE,
    )


def refine(
    target: SurfaceField,
    source: SurfaceField,
    poses: Poses,
    centre: Poses,
    reaches: tuple[float, ...],
    num_points: int,
) -> tuple[Poses, npt.NDArray[np.float64]]:
    """Refined poses (K, 3) and their information matrices (K, 3, 3) about the source's `centre` (2,), per wall cell.

    Args:
        target: Field of the target.
        source: Field of the source.
        poses: (K, 3) to start from.
        centre: Point of the source about which a pose turns, cells.
        reaches: How far a wall attracts, cells, one for each step.
        num_points: About so many points of each map are used.
    """
    from_source, from_target = source.surface.thinned(num_points), target.surface.thinned(num_points)
    share = (len(source.surface) + len(target.surface)) / (len(from_source) + len(from_target))
    # Turning about the centre instead of the corner keeps rotation and translation nearly independent.
    about = poses.copy()
    about[:, :2] = moved(poses, centre[None].astype(np.float32))[:, :, 0]
    centred = Surface(from_source.points - centre.astype(np.float32), from_source.normals)
    information = np.zeros((len(poses), 3, 3))
    has_settled = False
    for reach in reaches:
        if has_settled and reach != reaches[-1]:
            continue
        there = encounters(target, centred, about)
        information, gradient = _normal_equations(there.lines, there.arms, there.gap, _weights(there, reach))
        back = encounters(source, from_target, inverse(_about_corner(about, centre)))
        # Seen from the target it is the source's wall that moves, and its normal turns with it.
        lines = rotations(about) @ back.lines
        walls = from_target.points.T - back.gap[:, None] * lines
        arms = walls - about[:, :2, None].astype(np.float32)
        more, more_gradient = _normal_equations(lines, arms, -back.gap, _weights(back, reach))
        information, gradient = information + more, gradient + more_gradient
        # A corridor fixes nothing along itself: without damping its pose would run away there.
        damping = 1e-4 * (information[:, 0, 0] + information[:, 1, 1]) + 1e-3
        step = np.linalg.solve(information + damping[:, None, None] * _ONE, gradient[..., None])[..., 0]
        about = about - step
        has_settled = bool((np.abs(step) < SETTLED).all())
        if has_settled and reach == reaches[-1]:
            break
    return _about_corner(about, centre), information * share


def _about_corner(about: Poses, centre: Poses) -> Poses:
    poses = about.copy()
    poses[:, :2] -= rotations(about).astype(np.float64) @ centre
    return poses


def _weights(found: Encounters, reach: float) -> Floats:
    inside = np.maximum(1.0 - found.squared * np.float32(1.0 / reach**2), 0.0)
    weights: Floats = inside * inside * found.same_side
    return weights


def _normal_equations(
    lines: Floats, arms: Floats, gap: Floats, weights: Floats
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """J^T W J (K, 3, 3) and J^T W r (K, 3) for residuals `gap` along `lines` of points at `arms` from the pivot."""
    J = np.empty((len(gap), 3, gap.shape[1]), np.float32)
    J[:, :2] = lines
    J[:, 2] = lines[:, 1] * arms[:, 0] - lines[:, 0] * arms[:, 1]
    weighted = J * weights[:, None]
    return (
        (weighted @ J.transpose(0, 2, 1)).astype(np.float64),
        (weighted @ gap[..., None])[..., 0].astype(np.float64),
    )
