"""Poses of the source in the target, many at once, in cells.

A pose is a row (x, y, theta): it takes a point p of the source, in cells from its grid's corner, to
R(theta) p + (x, y) in cells from the target's corner.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

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


def turned(R: Points, vectors: Points) -> Points:
    """(K, 2, N): the vectors (N, 2) turned by each of R (K, 2, 2)."""
    result: Points = R @ np.ascontiguousarray(vectors.T)  # several times as fast as with the transpose as it is
    return result


def moved(poses: Poses, points: Points) -> Points:
    """(K, 2, N): the points (N, 2) under each pose."""
    result: Points = turned(rotations(poses), points)
    result += poses[:, :2, None].astype(np.float32)
    return result


def inverse(poses: Poses) -> Poses:
    """The poses of the target in the source."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x, y = poses[:, 0], poses[:, 1]
    return np.stack([-c * x - s * y, s * x - c * y, -poses[:, 2]], -1)


def after(outer: Poses, inner: Poses) -> Poses:
    """(K, 3): first one of the `inner` poses, then one of the `outer` ones; (K, 3) each, or one (3,) for all."""
    outer, inner = np.broadcast_arrays(np.atleast_2d(outer), np.atleast_2d(inner))
    c, s = np.cos(outer[:, 2]), np.sin(outer[:, 2])
    x, y = inner[:, 0], inner[:, 1]
    moved_by = np.stack([c * x - s * y, s * x + c * y], -1)
    return np.concatenate([outer[:, :2] + moved_by, outer[:, 2:] + inner[:, 2:]], -1)


def pose_from_centre(theta: npt.NDArray[np.float64], centre_in_target: Poses, centre: Poses) -> Poses:
    """Poses (K, 3) that turn by theta (K,) and take the source's `centre` (2,) to `centre_in_target` (K, 2)."""
    c, s = np.cos(theta), np.sin(theta)
    arm = np.stack([c * centre[0] - s * centre[1], s * centre[0] + c * centre[1]], -1)
    return np.concatenate([centre_in_target - arm, theta[:, None]], -1)


def differ(poses: Poses, others: Poses, centre: Poses, cells: float, degrees: float) -> npt.NDArray[np.bool_]:
    """(J, K) which of J `poses` and K `others` differ: by over `cells` at the source's `centre` (2,), or `degrees`."""
    here, there = (centre_moved(some, centre) for some in (poses, others))
    return _are_apart(here[:, None] - there, poses[:, 2, None] - others[:, 2], cells, degrees)


def _are_apart(gap: Poses, turn_rad: Poses, cells: float, degrees: float) -> npt.NDArray[np.bool_]:
    """Whether gaps (..., 2) are over `cells`, or turns (...) over `degrees`."""
    turn = np.abs(np.remainder(turn_rad + math.pi, 2 * math.pi) - math.pi)
    result: npt.NDArray[np.bool_] = (np.square(gap).sum(axis=-1) > cells**2) | (turn > math.radians(degrees))
    return result


def centre_moved(poses: Poses, centre: Poses) -> Poses:
    """(K, 2): one point (2,) under each pose."""
    moved_centre: Poses = rotations(poses) @ centre + poses[:, :2]
    return moved_centre


def distinct(poses: Poses, centre: Poses, cells: float, degrees: float, count: int) -> list[int]:
    """Indices of the first `count` of the poses (K, 3) that do not lie near an earlier one; near as in `differ`."""
    at, theta = centre_moved(poses, centre), poses[:, 2]
    chosen: list[int] = []
    apart = np.ones(len(poses), np.bool_)
    while len(chosen) < count and apart.any():
        first = int(apart.argmax())
        chosen.append(first)
        apart &= _are_apart(at - at[first], theta - theta[first], cells, degrees)
    return chosen


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
