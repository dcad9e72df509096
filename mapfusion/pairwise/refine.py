"""Poses to a fraction of a cell: the walls of each map are drawn onto those of the other.

Point-to-line ICP in both directions at once with an annealed robust kernel, each of many poses by itself. Walls attract
each other only where they were seen from the same side.
Source: Chen and Medioni, Image and Vision Computing 1992 (point to plane); Tukey's biweight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mapfusion.compiled import compiled
from mapfusion.pairwise.poses import Poses
from mapfusion.pairwise.surface import FIELD_MARGIN, Floats, Indices, Points, Surface, SurfaceField

SAME_SIDE_COSINE = 0.5
"""Normals within 60 degrees count as one wall seen from one side."""
SETTLED_CELLS, SETTLED_RAD = 1e-2, 1e-4
"""A step below these changes nothing any more: a pose that stands goes on to the closest reach."""


@dataclass(frozen=True, slots=True, eq=False)
class Encounters:
    """What points of one map meet in the field of the other, (K, N) for K poses and N points; lengths in cells.

    Attributes:
        cells: Flat index of the field's cell below the point.
        lines: (K, N, 2) normals of the nearest walls.
        gap: Signed distance to the nearest wall's line, along its normal.
        squared: Squared distance to the nearest wall's point.
        cosine: Of the angle between both walls' normals.
    """

    cells: Indices
    lines: Floats
    gap: Floats
    squared: Floats
    cosine: Floats

    @property
    def same_side(self) -> npt.NDArray[np.bool_]:
        """Whether both walls were seen from the same side."""
        return np.greater(self.cosine, SAME_SIDE_COSINE)


def encounters(field: SurfaceField, surface: Surface, poses: Poses) -> Encounters:
    """What the points of `surface` meet in `field` under `poses` (K, 3)."""
    return Encounters(*_encounters(field.nearest, field.walls, FIELD_MARGIN, surface.points, surface.normals, poses))


def cells_below(field: SurfaceField, points: Points, poses: Poses) -> Indices:
    """(K, N) flat index of the field's cell below each of the points (N, 2) under `poses` (K, 3).

    For points outside it is a cell at the field's edge.
    """
    height, width = field.nearest.shape
    return _cells_below(height, width, FIELD_MARGIN, points, poses)


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
    refined, information = _refined(
        (target.nearest, target.walls, from_target.points, from_target.normals),
        (source.nearest, source.walls, from_source.points, from_source.normals),
        FIELD_MARGIN,
        poses,
        centre,
        np.array(reaches),
    )
    return refined, information * share


@compiled
def _land(
    xs: Poses,
    ys: Poses,
    move: tuple[float, float, float, float],
    shape: tuple[int, int],
    margin: int,
    cells: Indices,
) -> None:
    """Writes to `cells` (N,) in which cell of a field each point lands, moved by x and y, turned by cosine and sine."""
    x, y, c, s = move
    # Cut off before they are made whole, and held to 32 bits, several points go through the loop at once. What is no
    # number becomes 0, the first of the two.
    last_row, last_column, cells_per_row = shape[0] - 1.0, shape[1] - 1.0, np.int32(shape[1])
    for i in range(len(xs)):
        row = np.int32(min(max(0.0, s * xs[i] + c * ys[i] + y + margin), last_row))
        column = np.int32(min(max(0.0, c * xs[i] - s * ys[i] + x + margin), last_column))
        cells[i] = np.int32(row * cells_per_row + column)


@compiled
def _cells_below(height: int, width: int, margin: int, points: Points, poses: Poses) -> Indices:
    cells = np.empty((len(poses), len(points)), np.int32)
    xs, ys = points[:, 0].astype(np.float64), points[:, 1].astype(np.float64)
    for k in range(len(poses)):
        move = poses[k, 0], poses[k, 1], math.cos(poses[k, 2]), math.sin(poses[k, 2])
        _land(xs, ys, move, (height, width), margin, cells[k])
    return cells


@compiled
def _encounters(
    nearest: Indices, walls: Floats, margin: int, points: Points, normals: Points, poses: Poses
) -> tuple[Indices, Floats, Floats, Floats, Floats]:
    shape = len(poses), len(points)
    xs, ys, flat = points[:, 0].astype(np.float64), points[:, 1].astype(np.float64), nearest.ravel()
    cells, lines = np.empty(shape, np.int32), np.empty((*shape, 2), np.float32)
    gap, squared, cosine = np.empty(shape, np.float32), np.empty(shape, np.float32), np.empty(shape, np.float32)
    for k in range(len(poses)):
        x, y, c, s = poses[k, 0], poses[k, 1], math.cos(poses[k, 2]), math.sin(poses[k, 2])
        _land(xs, ys, (x, y, c, s), nearest.shape, margin, cells[k])
        for i in range(len(points)):
            wall = flat[cells[k, i]]
            nx, ny = walls[wall, 2], walls[wall, 3]
            dx, dy = c * xs[i] - s * ys[i] + x - walls[wall, 0], s * xs[i] + c * ys[i] + y - walls[wall, 1]
            lines[k, i, 0], lines[k, i, 1] = nx, ny
            gap[k, i], squared[k, i] = dx * nx + dy * ny, dx * dx + dy * dy
            facing_x, facing_y = c * normals[i, 0] - s * normals[i, 1], s * normals[i, 0] + c * normals[i, 1]
            cosine[k, i] = facing_x * nx + facing_y * ny
    return cells, lines, gap, squared, cosine


_Map = tuple[Indices, Floats, Points, Points]
"""A field's nearest walls and its walls, and the points and normals of a surface."""
_Move = tuple[float, float, float, float]
"""Where the source's centre lies in the target, and the cosine and sine of the source's turn."""
_Sums = tuple[float, float, float, float, float, float, float, float, float]
"""J^T W J, its upper triangle row by row, and J^T W r."""


@compiled
def _refined(
    target: _Map, source: _Map, margin: int, poses: Poses, centre: Poses, reaches: Poses
) -> tuple[Poses, npt.NDArray[np.float64]]:
    refined, information = np.empty((len(poses), 3)), np.empty((len(poses), 3, 3))
    cells = np.empty(max(len(source[2]), len(target[2])), np.int32)
    xs, ys = source[2][:, 0] - centre[0], source[2][:, 1] - centre[1]
    target_xs, target_ys = target[2][:, 0].astype(np.float64), target[2][:, 1].astype(np.float64)
    last = len(reaches) - 1
    for k in range(len(poses)):
        # Turning about the centre instead of the corner keeps rotation and translation nearly independent.
        theta = poses[k, 2]
        c, s = math.cos(theta), math.sin(theta)
        x = poses[k, 0] + c * centre[0] - s * centre[1]
        y = poses[k, 1] + s * centre[0] + c * centre[1]
        has_settled = False
        for step in range(len(reaches)):
            if has_settled and step != last:
                continue
            move = x, y, c, s
            _land(xs, ys, move, target[0].shape, margin, cells)
            there = _attracted(target[0].ravel(), target[1], cells, xs, ys, source[3], move, reaches[step])
            # The inverse: where the target's corner lies in the source, whose own corner points are counted from.
            at = centre[0] - c * x - s * y, centre[1] + s * x - c * y, c, -s
            _land(target_xs, target_ys, at, source[0].shape, margin, cells)
            back = _attracted_back(
                source[0].ravel(), source[1], cells, target_xs, target_ys, target[3], move, centre, reaches[step]
            )
            xx, xy, xt = there[0] + back[0], there[1] + back[1], there[2] + back[2]
            yy, yt, tt = there[3] + back[3], there[4] + back[4], there[5] + back[5]
            # A corridor fixes nothing along itself: without damping its pose would run away there.
            damping = 1e-4 * (xx + yy) + 1e-3
            gx, gy, gt = there[6] + back[6], there[7] + back[7], there[8] + back[8]
            dx, dy, turn = _solved(xx + damping, xy, xt, yy + damping, yt, tt + damping, gx, gy, gt)
            x, y, theta = x - dx, y - dy, theta - turn
            c, s = math.cos(theta), math.sin(theta)
            has_settled = max(abs(dx), abs(dy)) < SETTLED_CELLS and abs(turn) < SETTLED_RAD
            information[k, 0, 0], information[k, 1, 1], information[k, 2, 2] = xx, yy, tt
            information[k, 0, 1], information[k, 0, 2], information[k, 1, 2] = xy, xt, yt
            information[k, 1, 0], information[k, 2, 0], information[k, 2, 1] = xy, xt, yt
        refined[k, 0], refined[k, 1] = x - c * centre[0] + s * centre[1], y - s * centre[0] - c * centre[1]
        refined[k, 2] = theta
    return refined, information


@compiled
def _attracted(
    nearest: Indices, walls: Floats, cells: Indices, xs: Poses, ys: Poses, normals: Points, move: _Move, reach: float
) -> _Sums:
    """What the target's walls do to points of the source, given from its centre, that land in some cells."""
    x, y, c, s = move
    per_squared = 1.0 / reach**2
    xx, xy, xt, yy, yt, tt, gx, gy, gt = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(xs)):
        arm_x, arm_y, wall = c * xs[i] - s * ys[i], s * xs[i] + c * ys[i], nearest[cells[i]]
        dx, dy, nx, ny = arm_x + x - walls[wall, 0], arm_y + y - walls[wall, 1], walls[wall, 2], walls[wall, 3]
        facing_x, facing_y = c * normals[i, 0] - s * normals[i, 1], s * normals[i, 0] + c * normals[i, 1]
        inside = 1.0 - (dx * dx + dy * dy) * per_squared
        if inside > 0.0 and facing_x * nx + facing_y * ny > SAME_SIDE_COSINE:
            gap, weight, turning = dx * nx + dy * ny, inside * inside, ny * arm_x - nx * arm_y
            wx, wy, wt = weight * nx, weight * ny, weight * turning
            xx, xy, xt = xx + wx * nx, xy + wx * ny, xt + wx * turning
            yy, yt, tt = yy + wy * ny, yt + wy * turning, tt + wt * turning
            gx, gy, gt = gx + wx * gap, gy + wy * gap, gt + wt * gap
    return xx, xy, xt, yy, yt, tt, gx, gy, gt


@compiled
def _attracted_back(
    nearest: Indices,
    walls: Floats,
    cells: Indices,
    xs: Poses,
    ys: Poses,
    normals: Points,
    move: _Move,
    centre: Poses,
    reach: float,
) -> _Sums:
    """What points of the target do to the source's walls: it is the wall that moves, and its normal turns with it."""
    x, y, c, s = move
    centre_x, centre_y, per_squared = centre[0], centre[1], 1.0 / reach**2
    xx, xy, xt, yy, yt, tt, gx, gy, gt = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(xs)):
        qx, qy, wall = xs[i] - x, ys[i] - y, nearest[cells[i]]
        dx, dy = c * qx + s * qy + centre_x - walls[wall, 0], c * qy - s * qx + centre_y - walls[wall, 1]
        wall_nx, wall_ny = walls[wall, 2], walls[wall, 3]
        nx, ny = c * wall_nx - s * wall_ny, s * wall_nx + c * wall_ny
        inside = 1.0 - (dx * dx + dy * dy) * per_squared
        if inside > 0.0 and normals[i, 0] * nx + normals[i, 1] * ny > SAME_SIDE_COSINE:
            gap = dx * wall_nx + dy * wall_ny
            weight, turning = inside * inside, ny * (qx - gap * nx) - nx * (qy - gap * ny)
            wx, wy, wt = weight * nx, weight * ny, weight * turning
            xx, xy, xt = xx + wx * nx, xy + wx * ny, xt + wx * turning
            yy, yt, tt = yy + wy * ny, yt + wy * turning, tt + wt * turning
            gx, gy, gt = gx - wx * gap, gy - wy * gap, gt - wt * gap
    return xx, xy, xt, yy, yt, tt, gx, gy, gt


@compiled
def _solved(
    xx: float, xy: float, xt: float, yy: float, yt: float, tt: float, gx: float, gy: float, gt: float
) -> tuple[float, float, float]:
    """What a symmetric positive definite matrix, its upper triangle row by row, takes to (gx, gy, gt): by Cholesky."""
    l00 = math.sqrt(xx)
    l10, l20 = xy / l00, xt / l00
    l11 = math.sqrt(yy - l10 * l10)
    l21 = (yt - l20 * l10) / l11
    l22 = math.sqrt(tt - l20 * l20 - l21 * l21)
    a = gx / l00
    b = (gy - l10 * a) / l11
    turn = (gt - l20 * a - l21 * b) / l22 / l22
    dy = (b - l21 * turn) / l11
    return (a - l10 * dy - l20 * turn) / l00, dy, turn
