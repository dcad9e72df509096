"""Decoded ROS messages as mapfusion's own types, believed only after a look at every number that is used."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from mapfusion.errors import MalformedMessageError
from mapfusion.grid import Cells, OccupancyGrid
from mapfusion.transform import SE2, yaw_from_quaternion

GRID_TYPES = frozenset({"nav_msgs/msg/OccupancyGrid"})
UPDATE_TYPES = frozenset({"map_msgs/msg/OccupancyGridUpdate"})
TRANSFORM_TYPES = frozenset({"tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"})
POSE_TYPES = frozenset(
    {"geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped", "nav_msgs/msg/Odometry"}
)

NORM_TOLERANCE = 0.1
"""How far the norm of a quaternion may be from 1 before it is taken for something else than a rotation."""

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
_IDENTITY: Quaternion = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class GridUpdate:
    """A patch of a grid that came before.

    Attributes:
        stamp_ns: Time of the message header, nanoseconds since the epoch.
        frame_id: Frame named in the message header, without leading slash.
        col: Column of the grid in which the patch starts; row: its row.
        patch: (height, width) int8, -1 unknown, 0 free to 100 occupied. Read-only.
    """

    stamp_ns: int
    frame_id: str
    col: int
    row: int
    patch: Cells


class StampedTransform(NamedTuple):
    """A sample of `T_parent_child`. Frames have no leading slash; the quaternion has norm 1."""

    stamp_ns: int
    parent: str
    child: str
    translation_m: Vector
    quat_xyzw: Quaternion


class StampedPose(NamedTuple):
    """A pose in `frame_id`. `child_frame_id` is empty where the type has none; the quaternion has norm 1."""

    stamp_ns: int
    frame_id: str
    child_frame_id: str
    translation_m: Vector
    quat_xyzw: Quaternion


def occupancy_grid(msg: Any) -> OccupancyGrid:
    """From a nav_msgs/OccupancyGrid. The cells are a view of the message, not a copy.

    Raises:
        MalformedMessageError: Its data do not fill it, or a number cannot be.
    """
    info = msg.info
    cells = _cells(msg.data, info.width, info.height)
    resolution_m = float(info.resolution)
    if not (math.isfinite(resolution_m) and resolution_m > 0.0):
        raise _malformed(f"resolution {resolution_m} m")
    x_m, y_m, _ = _vector(info.origin.position, "origin")
    yaw_rad = yaw_from_quaternion(*_quaternion(info.origin.orientation, "origin"))
    frame_id = strip_slash(msg.header.frame_id)
    return OccupancyGrid(cells, resolution_m, SE2(x_m, y_m, yaw_rad), frame_id, _stamp_ns(msg.header.stamp))


def grid_update(msg: Any) -> GridUpdate:
    """From a map_msgs/OccupancyGridUpdate. The cells are a view of the message, not a copy.

    Raises:
        MalformedMessageError: Its data do not fill it, or a number cannot be.
    """
    if msg.x < 0 or msg.y < 0:
        raise _malformed("a patch that starts outside the grid")
    patch = _cells(msg.data, msg.width, msg.height)
    return GridUpdate(_stamp_ns(msg.header.stamp), strip_slash(msg.header.frame_id), int(msg.x), int(msg.y), patch)


def transforms(msg: Any, refused: list[str] | None = None) -> list[StampedTransform]:
    """From a tf2_msgs/TFMessage or tf/tfMessage, in its order.

    Args:
        msg: The message.
        refused: Takes a reason for every transform that cannot be believed, which is then left out; the others count,
            as in tf2.

    Raises:
        MalformedMessageError: A transform cannot be believed, and `refused` is None.
    """
    found: list[StampedTransform] = []
    for item in msg.transforms:
        try:
            found.append(_transform(item))
        except MalformedMessageError as error:
            if refused is None:
                raise
            refused.append(error.reason)
    return found


def pose(msg: Any) -> StampedPose:
    """From a geometry_msgs/PoseStamped, PoseWithCovarianceStamped or nav_msgs/Odometry.

    Raises:
        MalformedMessageError: A number cannot be.
    """
    inner = msg.pose
    if hasattr(inner, "covariance"):
        inner = inner.pose
    translation_m, quat_xyzw = _vector(inner.position, "position"), _quaternion(inner.orientation, "orientation")
    child_frame_id = strip_slash(getattr(msg, "child_frame_id", ""))
    frame_id = strip_slash(msg.header.frame_id)
    return StampedPose(_stamp_ns(msg.header.stamp), frame_id, child_frame_id, translation_m, quat_xyzw)


def strip_slash(frame_id: str) -> str:
    """A frame as ROS 2 writes it: ROS 1 allowed one slash in front."""
    return frame_id.removeprefix("/")


def _transform(item: Any) -> StampedTransform:
    parent, child = strip_slash(item.header.frame_id), strip_slash(item.child_frame_id)
    if not parent or not child or parent == child:
        raise _malformed("a transform without two different frames")
    translation_m = _vector(item.transform.translation, "translation")
    quat_xyzw = _quaternion(item.transform.rotation, "rotation")
    return StampedTransform(_stamp_ns(item.header.stamp), parent, child, translation_m, quat_xyzw)


def _cells(data: Any, width: int, height: int) -> Cells:
    """(height, width) view of row-major data."""
    if len(data) != width * height:
        raise _malformed(f"{len(data)} cells instead of {width} x {height}")
    if not len(data):
        raise _malformed("no cells")
    if data.dtype != np.int8:
        raise _malformed(f"cells of type {data.dtype}")
    cells: Cells = data.reshape(height, width)
    low, high = int(cells.min()), int(cells.max())
    if low < -1 or high > 100:
        raise _malformed("a cell outside -1..100")
    return cells


def _vector(value: Any, what: str) -> Vector:
    x, y, z = value.x, value.y, value.z
    if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
        raise _malformed(f"{what} is not finite")
    return x, y, z


def _quaternion(value: Any, what: str) -> Quaternion:
    """Of norm 1; all zero, which many publishers leave in, is no rotation."""
    x, y, z, w = value.x, value.y, value.z, value.w
    norm = math.hypot(x, y, z, w)
    if norm == 0.0:
        return _IDENTITY
    if not abs(norm - 1.0) <= NORM_TOLERANCE:
        raise _malformed(f"{what} is a quaternion that is no rotation")
    return x / norm, y / norm, z / norm, w / norm


def _stamp_ns(stamp: Any) -> int:
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _malformed(reason: str) -> MalformedMessageError:
    return MalformedMessageError("", 0, reason)
