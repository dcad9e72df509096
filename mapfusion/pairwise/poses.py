"""Poses of the source in the target, many at once, in cells.

A pose is a row (x, y, theta): it takes a point p of the source, in cells from its grid's corner, to
R(theta) p + (x, y) in cells from the target's corner.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from mapfusion.compiled import compiled
from mapfusion.grid import OccupancyGrid
from mapfusion.pairwise.surface import Points
from mapfusion.transform import SE2

Poses = npt.NDArray[np.float64]


def rotations(poses: Poses) -> npt.NDArray[np.float32]:
    """(K, 2, 2) rotation matrices of (K, 3) poses."""
    R = np.empty((len(poses), 2, 2), np.float32)
    R[:, 0, 0] = R[:, 1, 1] = np.cos(poses[:, 2])
    R[:, 1, 0] = np.sin(poses[:, 2])
    R[:, 0, 1] = -R[:, 1, 0]
    return R


def moved(poses: Poses, points: Points) -> Points:
    """(K, 2, N): the points (N, 2) under each pose."""
    result: Points = rotations(poses) @ points.T
    result += poses[:, :2, None].astype(np.float32)
    return result


@compiled
def inverse(poses: Poses) -> Poses:
    """The poses of the target in the source."""
    inverted = np.empty_like(poses)
    for k in range(len(poses)):
        x, y, theta = poses[k]
        c, s = math.cos(theta), math.sin(theta)
        inverted[k, 0], inverted[k, 1], inverted[k, 2] = -c * x - s * y, s * x - c * y, -theta
    return inverted


def after(outer: Poses, inner: Poses) -> Poses:
    """(K, 3): first one of the `inner` poses, then one of the `outer` ones; (K, 3) each, or one (3,) for all."""
    outer, inner = np.broadcast_arrays(np.atleast_2d(outer), np.atleast_2d(inner))
    c, s = np.cos(outer[:, 2]), np.sin(outer[:, 2])
    x, y = inner[:, 0], inner[:, 1]
    moved_by = np.stack([c * x - s * y, s * x + c * y], -1)
    return np.concatenate([outer[:, :2] + moved_by, outer[:, 2:] + inner[:, 2:]], -1)


@compiled
def pose_from_centre(theta: Poses, centre_in_target: Poses, centre: Poses) -> Poses:
    """Poses (K, 3) that turn by theta (K,) and take the source's `centre` (2,) to `centre_in_target` (K, 2)."""
    poses = np.empty((len(theta), 3))
    for k in range(len(theta)):
        c, s = math.cos(theta[k]), math.sin(theta[k])
        poses[k, 0] = centre_in_target[k, 0] - c * centre[0] + s * centre[1]
        poses[k, 1] = centre_in_target[k, 1] - s * centre[0] - c * centre[1]
        poses[k, 2] = theta[k]
    return poses


@compiled
def centre_moved(poses: Poses, centre: Poses) -> Poses:
    """(K, 2): one point (2,) under each pose."""
    there = np.empty((len(poses), 2))
    for k in range(len(poses)):
        c, s = math.cos(poses[k, 2]), math.sin(poses[k, 2])
        there[k, 0] = c * centre[0] - s * centre[1] + poses[k, 0]
        there[k, 1] = s * centre[0] + c * centre[1] + poses[k, 1]
    return there


def differ(poses: Poses, others: Poses, centre: Poses, cells: float, degrees: float) -> npt.NDArray[np.bool_]:
    """(J, K) which of J `poses` and K `others` differ: by over `cells` at the source's `centre` (2,), or `degrees`."""
    return _apart(
        centre_moved(poses, centre), poses, centre_moved(others, centre), others, cells, math.radians(degrees)
    )


@compiled
def _apart(
    here: Poses, poses: Poses, there: Poses, others: Poses, cells: float, turn_rad: float
) -> npt.NDArray[np.bool_]:
    apart = np.empty((len(poses), len(others)), np.bool_)
    for j in range(len(poses)):
        for k in range(len(others)):
            apart[j, k] = _are_apart(here[j], poses[j], there[k], others[k], cells, turn_rad)
    return apart


@compiled
def _are_apart(here: Poses, pose: Poses, there: Poses, other: Poses, cells: float, turn_rad: float) -> bool:
    """Whether two poses (3,), which take a point to `here` and `there` (2,), differ by over `cells` or `turn_rad`."""
    dx, dy, turn = here[0] - there[0], here[1] - there[1], pose[2] - other[2]
    is_turned = abs((turn + math.pi) % (2.0 * math.pi) - math.pi) > turn_rad
    return bool(is_turned or dx * dx + dy * dy > cells * cells)


def distinct(poses: Poses, centre: Poses, cells: float, degrees: float, count: int) -> npt.NDArray[np.intp]:
    """Indices of the first `count` of the poses (K, 3) that do not lie near an earlier one; near as in `differ`."""
    return _distinct(poses, centre_moved(poses, centre), cells, math.radians(degrees), count)


@compiled
def _distinct(poses: Poses, at: Poses, cells: float, turn_rad: float, count: int) -> npt.NDArray[np.intp]:
    chosen, number = np.empty(len(poses), np.intp), 0
    for k in range(len(poses)):
        if number >= count:
            break
        is_new = True
        for j in chosen[:number]:
            is_new = is_new and _are_apart(at[j], poses[j], at[k], poses[k], cells, turn_rad)
        if is_new:
            chosen[number] = k
            number += 1
    return chosen[:number].copy()


def to_se2(pose: Poses, resolution_m: float) -> SE2:
    """The motion between the two grids' corners, in metres."""
    return SE2(float(pose[0]) * resolution_m, float(pose[1]) * resolution_m, float(pose[2]))


def from_se2(T: SE2, resolution_m: float) -> Poses:
    """(3,) pose in cells of a motion between the two grids' corners."""
    return np.array([T.x_m / resolution_m, T.y_m / resolution_m, T.yaw_rad])


def between_corners(T_target_source: SE2, target: OccupancyGrid, source: OccupancyGrid) -> Poses:
    """(3,) pose of a motion between the frames of two grids of one resolution."""
    T = target.T_frame_grid.inverse() @ T_target_source @ source.T_frame_grid
    return from_se2(T, target.resolution_m)


def between_frames(pose: Poses, target: OccupancyGrid, source: OccupancyGrid) -> SE2:
    """T_target_source of a pose (3,), the inverse of `between_corners`."""
    return target.T_frame_grid @ to_se2(pose, target.resolution_m) @ source.T_frame_grid.inverse()
