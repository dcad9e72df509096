"""How keypoints fall together under a pose."""

from __future__ import annotations

import numpy as np
import pytest

from mapfusion.pairwise.keypoints import (
    NEAR_INLIER_CELLS,
    WIDE_INLIER_CELLS,
    KeypointAgreement,
    keypoint_agreement,
    num_explained,
    squared_offsets,
)
from mapfusion.pairwise.poses import from_se2
from mapfusion.pairwise.prepared import PreparedMap, prepare
from mapfusion.pairwise.voting import match
from mapfusion.transform import SE2
from tests.fakes import flat, grid_of, rooms, seen_from

T_A_B = SE2(4.0, -2.5, 0.6)


@pytest.fixture(scope="module")
def pair() -> tuple[PreparedMap, PreparedMap]:
    place = rooms(seed=3)
    return prepare(seen_from(place, SE2.identity(), (220, 230)), 0.1), prepare(seen_from(place, T_A_B, (220, 230)), 0.1)


def look(pair: tuple[PreparedMap, PreparedMap], T: SE2) -> KeypointAgreement:
    target, source = pair
    pose = from_se2(target.grid.T_frame_grid.inverse() @ T @ source.grid.T_frame_grid, 0.1)
    return keypoint_agreement(target, source, pose, match(target.features, source.features), 1.5)


def test_keypoints_of_one_place_fall_together_under_the_right_pose_only(
    pair: tuple[PreparedMap, PreparedMap],
) -> None:
    right = look(pair, T_A_B)
    wrong = [look(pair, SE2(T_A_B.x_m + dx, T_A_B.y_m, T_A_B.yaw_rad + turn)) for dx, turn in ((1.5, 0.0), (0.0, 2.0))]
    assert right.keypoints > 2.0
    assert all(one.keypoints < right.keypoints - 0.4 for one in wrong)
    assert all(one.inliers_near < 0.3 * right.inliers_near for one in wrong)
    assert right.inliers_wide >= right.inliers_near


def test_a_pose_explains_matches_in_place_and_in_direction(pair: tuple[PreparedMap, PreparedMap]) -> None:
    target, _ = pair
    matches = match(target.features, target.features)
    own = matches.target == matches.source
    as_it_is = squared_offsets(target.features, target.features, matches, np.zeros(3)) <= NEAR_INLIER_CELLS**2
    shifted = (
        squared_offsets(target.features, target.features, matches, np.array([5.0, 0.0, 0.0])) <= NEAR_INLIER_CELLS**2
    )
    assert as_it_is[own].all()
    assert not shifted[own].any()
    turned = np.array([0.0, 0.0, 0.6])
    assert own.any()
    assert np.isinf(squared_offsets(target.features, target.features, matches, turned)[own]).all()


def test_how_many_matches_poses_explain_is_counted_for_all_at_once(pair: tuple[PreparedMap, PreparedMap]) -> None:
    target, source = (one.features for one in pair)
    matches = match(target, source)
    T = pair[0].grid.T_frame_grid.inverse() @ T_A_B @ pair[1].grid.T_frame_grid
    poses = np.array([from_se2(T, 0.1), [5.0, 0.0, 0.0], [0.0, 9.0, 3.5], [-2.0, 1.0, -3.0]])
    explained = num_explained(target, source, matches, poses)
    for pose, number in zip(poses, explained, strict=True):
        off = squared_offsets(target, source, matches, pose)
        assert number == np.count_nonzero(off <= WIDE_INLIER_CELLS**2)
    assert explained[0] > 3 * explained[1:].max()


def test_where_nothing_is_in_common_keypoints_say_nothing(pair: tuple[PreparedMap, PreparedMap]) -> None:
    far = look(pair, SE2(1000.0, 0.0, 0.0))
    assert far.keypoints == pytest.approx(0.0, abs=4.0)
    assert (far.inliers_near, far.inliers_wide) == (0, 0)


def test_maps_without_keypoints_are_no_error() -> None:
    cells = flat(60, 60, 0)
    cells[:3] = 100
    wall = prepare(grid_of(cells), 0.1)
    assert wall.field is not None
    found = keypoint_agreement(wall, wall, np.zeros(3), match(wall.features, wall.features), 1.5)
    assert found.inliers_near >= 0
