from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from rosbags.typesys.stores import ros2_humble as ros

from mapfusion.errors import MalformedMessageError
from mapfusion_io.messages import grid_update, occupancy_grid, pose, transforms
from tests.io.making import STAMP_NS, grid_message, header, pose_message, small_cells, tf_message, update_message

CELLS = small_cells()
QUARTER = (0.0, 0.0, math.sin(math.pi / 4), math.cos(math.pi / 4))


def reason_of(convert: Any, message: Any) -> str:
    with pytest.raises(MalformedMessageError) as raised:
        convert(message)
    return raised.value.reason


def test_grid_with_a_turned_origin() -> None:
    grid = occupancy_grid(grid_message(CELLS, 0.05, "/robot1/map", x=2.0, y=-3.0, quat=QUARTER))
    np.testing.assert_array_equal(grid.cells, CELLS)
    assert grid.resolution_m == pytest.approx(0.05, abs=1e-8)
    assert (grid.frame_id, grid.stamp_ns) == ("robot1/map", STAMP_NS)
    T = grid.T_frame_grid
    assert (T.x_m, T.y_m, T.yaw_rad) == pytest.approx((2.0, -3.0, math.pi / 2), abs=1e-9)
    assert not grid.cells.flags.writeable


def test_quaternion_of_zeroes_is_no_rotation() -> None:
    assert occupancy_grid(grid_message(CELLS, quat=(0.0, 0.0, 0.0, 0.0))).T_frame_grid.yaw_rad == 0.0


def test_quaternion_is_brought_to_norm_one() -> None:
    (edge,) = transforms(tf_message(("a", "b"), quat=(0.0, 0.0, 0.0, 1.05)))
    assert edge.quat_xyzw == (0.0, 0.0, 0.0, 1.0)


@pytest.mark.parametrize(
    "quat", [(0.0, 0.0, math.nan, 1.0), (0.0, 0.0, 0.0, 2.0), (0.0, 0.0, 0.0, 0.5), (math.inf, 0.0, 0.0, 1.0)]
)
def test_quaternion_that_is_no_rotation(quat: tuple[float, float, float, float]) -> None:
    assert "no rotation" in reason_of(occupancy_grid, grid_message(CELLS, quat=quat))
    assert "no rotation" in reason_of(transforms, tf_message(("a", "b"), quat=quat))
    assert "no rotation" in reason_of(pose, ros.geometry_msgs__msg__PoseStamped(header(), pose_message(quat=quat)))


@pytest.mark.parametrize("resolution_m", [0.0, -0.05, math.nan, math.inf])
def test_resolution_that_cannot_be(resolution_m: float) -> None:
    assert "resolution" in reason_of(occupancy_grid, grid_message(CELLS, resolution_m))


@pytest.mark.parametrize("x", [math.nan, math.inf])
def test_origin_that_is_not_finite(x: float) -> None:
    assert "origin" in reason_of(occupancy_grid, grid_message(CELLS, x=x))


@pytest.mark.parametrize("value", [-2, 101, -128, 127])
def test_cell_outside_its_range(value: int) -> None:
    cells = CELLS.copy()
    cells[2, 3] = value
    assert "-1..100" in reason_of(occupancy_grid, grid_message(cells))
    assert "-1..100" in reason_of(grid_update, update_message(cells, 0, 0))


@pytest.mark.parametrize(("width", "height"), [(7, 6), (9, 6), (2**31, 2**31), (0, 0), (8, 0)])
def test_data_that_do_not_fill_the_grid(width: int, height: int) -> None:
    message = grid_message(CELLS)
    message.info.width, message.info.height = width, height
    assert "48 cells" in reason_of(occupancy_grid, message)


def test_empty_grid() -> None:
    assert "no cells" in reason_of(occupancy_grid, grid_message(np.empty((0, 5), np.int8)))


def test_update() -> None:
    update = grid_update(update_message(CELLS, 11, 22))
    assert (update.col, update.row, update.stamp_ns, update.frame_id) == (11, 22, STAMP_NS, "map")
    np.testing.assert_array_equal(update.patch, CELLS)
    assert "outside" in reason_of(grid_update, update_message(CELLS, -1, 0))


def test_transforms_in_their_order() -> None:
    first, second = transforms(
        tf_message(("/robot1/map", "/robot1/odom"), ("robot1/odom", "robot1/base_link"), quat=QUARTER)
    )
    assert (first.parent, first.child, second.child) == ("robot1/map", "robot1/odom", "robot1/base_link")
    assert first.translation_m == (1.0, 2.0, 3.0)
    assert first.quat_xyzw == pytest.approx(QUARTER, abs=1e-12)
    assert first.stamp_ns == STAMP_NS


@pytest.mark.parametrize("edge", [("", "b"), ("a", ""), ("a", "a"), ("/a", "a")])
def test_transform_without_two_frames(edge: tuple[str, str]) -> None:
    assert "frames" in reason_of(transforms, tf_message(edge))


def test_bad_transform_does_not_take_the_others_with_it() -> None:
    message = tf_message(("a", "b"), ("b", "c"), ("c", "d"))
    message.transforms[1].transform.translation.x = math.nan
    assert "translation" in reason_of(transforms, message)
    refused: list[str] = []
    assert [edge.child for edge in transforms(message, refused)] == ["b", "d"]
    assert refused == ["translation is not finite"]


def test_poses_of_every_type() -> None:
    inner = pose_message(1.0, 2.0, QUARTER)
    with_covariance = ros.geometry_msgs__msg__PoseWithCovariance(inner, np.zeros(36))
    zero = ros.geometry_msgs__msg__Vector3(0.0, 0.0, 0.0)
    twist = ros.geometry_msgs__msg__TwistWithCovariance(ros.geometry_msgs__msg__Twist(zero, zero), np.zeros(36))
    for message, child in (
        (ros.geometry_msgs__msg__PoseStamped(header("/map"), inner), ""),
        (ros.geometry_msgs__msg__PoseWithCovarianceStamped(header("/map"), with_covariance), ""),
        (ros.nav_msgs__msg__Odometry(header("/map"), "/base_link", with_covariance, twist), "base_link"),
    ):
        found = pose(message)
        assert (found.stamp_ns, found.frame_id, found.child_frame_id) == (STAMP_NS, "map", child)
        assert found.translation_m == (1.0, 2.0, 0.0)
        assert found.quat_xyzw == pytest.approx(QUARTER, abs=1e-12)
    inner.position.y = -math.inf
    assert "position" in reason_of(pose, ros.geometry_msgs__msg__PoseStamped(header(), inner))
