"""Poses of the source in the target, many at once."""

from __future__ import annotations

import math

import numpy as np

from mapfusion.grid import OccupancyGrid
from mapfusion.pairwise.poses import (
    after,
    between_corners,
    between_frames,
    differ,
    distinct,
    from_se2,
    inverse,
    moved,
    pose_from_centre,
    to_se2,
)
from mapfusion.transform import SE2

POSES = np.array([[3.0, -2.0, 0.7], [10.0, 4.0, -3.0]])
POINTS = np.array([[1.0, 2.0], [-5.0, 7.0], [0.0, 0.0]], np.float32)


def test_poses_move_points_as_se2_does() -> None:
    for pose, points in zip(POSES, moved(POSES, POINTS), strict=True):
        expected = to_se2(pose, 0.05).apply(POINTS.astype(np.float64) * 0.05) / 0.05
        np.testing.assert_allclose(points.T, expected, atol=1e-4)


def test_inverse_undoes_a_pose() -> None:
    for pose, back in zip(POSES, inverse(POSES), strict=True):
        there = moved(pose[None], POINTS)[0].T
        np.testing.assert_allclose(moved(back[None], there)[0].T, POINTS, atol=1e-4)


def test_poses_follow_each_other_as_se2_does() -> None:
    outer, inner = POSES
    both = to_se2(outer, 1.0) @ to_se2(inner, 1.0)
    for followed in (after(outer, inner), after(outer[None], inner), after(POSES, inner)[:1]):
        assert followed.shape == (1, 3)
        np.testing.assert_allclose(to_se2(followed[0], 1.0).distance_to(both), 0.0, atol=1e-9)
    assert after(POSES, inverse(POSES)).shape == (2, 3)
    np.testing.assert_allclose(after(POSES, inverse(POSES)), 0.0, atol=1e-9)
    assert after(outer, np.zeros((0, 3))).shape == (0, 3)


def test_metres_and_cells_convert_both_ways() -> None:
    T = SE2(1.5, -0.25, 2.0)
    again = to_se2(from_se2(T, 0.05), 0.05)
    np.testing.assert_allclose(T.distance_to(again), 0.0, atol=1e-9)


def test_pose_from_centre_takes_the_centre_where_it_shall_lie() -> None:
    centre, there = np.array([30.0, 40.0]), np.array([[5.0, 6.0]])
    pose = pose_from_centre(np.array([1.1]), there, centre)
    np.testing.assert_allclose(moved(pose, centre[None].astype(np.float32))[0, :, 0], there[0], atol=1e-4)


def test_poses_differ_by_distance_at_the_centre_or_by_rotation() -> None:
    centre = np.array([100.0, 0.0])
    base = pose_from_centre(np.zeros(1), centre[None], centre)[0]
    turned = pose_from_centre(np.radians([4.0, 6.0, 358.0]), np.tile(centre, (3, 1)), centre)
    shifted = pose_from_centre(np.zeros(2), centre + np.array([[9.0, 0.0], [11.0, 0.0]]), centre)
    others = np.concatenate([turned, shifted])
    assert differ(base[None], others, centre, 10.0, 5.0).tolist() == [[False, True, False, False, True]]
    assert distinct(others, centre, 10.0, 5.0, 5).tolist() == [0, 2, 4]
    assert distinct(others, centre, 10.0, 5.0, 2).tolist() == [0, 2]
    assert math.isclose(turned[2, 2], math.radians(358.0))


def test_a_pose_between_corners_and_the_motion_between_frames_are_the_same() -> None:
    target, source = (
        OccupancyGrid(np.zeros((4, 6), np.int8), 0.5, SE2(x_m, -2.0, yaw_rad))
        for x_m, yaw_rad in ((3.0, 0.7), (-1.0, -2.0))
    )
    pose = np.array([12.0, -7.0, 0.4])
    T = between_frames(pose, target, source)
    np.testing.assert_allclose(between_corners(T, target, source), pose, atol=1e-9)
    # The source's corner lies at (12, -7) cells of the target.
    corner = target.T_frame_grid.apply(np.array([[6.0, -3.5]]))
    np.testing.assert_allclose(T.apply(np.array([[-1.0, -2.0]])), corner, atol=1e-9)
