"""Decoded ROS messages as mapfusion's own types, believed only after a look at every number that is used."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np

from mapfusion.errors import MalformedMessageError
from mapfusion.grid import Cells, OccupancyGrid
from mapfusion.transform import SE2, yaw_from_quaternion
from mapfusion_io.read_limits import ReadLimits

GRID_TYPES = frozenset({"nav_msgs/msg/OccupancyGrid"})
UPDATE_TYPES = frozenset({"map_msgs/msg/OccupancyGridUpdate"})
TRANSFORM_TYPES = frozenset({"tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"})
POSE_TYPES = frozenset(
    {"geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped", "nav_msgs/msg/Odometry"}
)

FRAME_CHARACTERS = 1_024
"""Longest frame id that is taken for one."""
FARTHEST_M = 1e8
"""No place on earth is further from an origin on it; coordinates beyond are damage."""
RESOLUTIONS_M = (1e-3, 100.0)
"""Finest and coarsest cells that a map may have."""
NORM_TOLERANCE = 0.1
"""How far the norm of a quaternion may be from 1 before it is taken for something else than a rotation."""

_T = TypeVar("_T")
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


class OverLimitError(MalformedMessageError):
    """A message asks for more than it may."""


def believed(read: Callable[..., _T], msg: Any, *arguments: Any) -> _T:
    """What `read` makes of a message whose type's definition came with the recording and may be any.

    Raises:
        MalformedMessageError: It cannot be believed, or its fields are not those of its type.
    """
    try:
        return read(msg, *arguments)
    except (AttributeError, TypeError, ValueError, OverflowError, IndexError) as error:
        raise _malformed("its fields are not those of its type") from error


def occupancy_grid(msg: Any, limits: ReadLimits | None = None) -> OccupancyGrid:
    """From a nav_msgs/OccupancyGrid. The cells are a view of the message, not a copy.

    Raises:
        MalformedMessageError: Its data do not fill it, or a number cannot be.
        OverLimitError: It has too many cells.
    """
    info = msg.info
    cells = _cells(msg.data, info.width, info.height, (limits or ReadLimits()).map_cells)
    resolution_m = float(info.resolution)
    if not RESOLUTIONS_M[0] <= resolution_m <= RESOLUTIONS_M[1]:
        raise _malformed(f"resolution {resolution_m:g} m")
    x_m, y_m, _ = _vector(info.origin.position, "origin")
    yaw_rad = yaw_from_quaternion(*_quaternion(info.origin.orientation, "origin"))
    frame_id = strip_slash(msg.header.frame_id)
    return OccupancyGrid(cells, resolution_m, SE2(x_m, y_m, yaw_rad), frame_id, _stamp_ns(msg.header.stamp))


def grid_update(msg: Any, limits: ReadLimits | None = None) -> GridUpdate:
    """From a map_msgs/OccupancyGridUpdate. The cells are a view of the message, not a copy.

    Raises:
        MalformedMessageError: Its data do not fill it, or a number cannot be.
        OverLimitError: It has too many cells.
    """
    if msg.x < 0 or msg.y < 0:
        raise _malformed("a patch that starts outside the grid")
    patch = _cells(msg.data, msg.width, msg.height, (limits or ReadLimits()).map_cells)
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
    """A frame as ROS 2 writes it: ROS 1 allowed one slash in front.

    Raises:
        MalformedMessageError: Too long for a name.
    """
    if len(frame_id) > FRAME_CHARACTERS:
        raise _malformed(f"a frame id of more than {FRAME_CHARACTERS} characters")
    return frame_id.removeprefix("/")


def _transform(item: Any) -> StampedTransform:
    parent, child = strip_slash(item.header.frame_id), strip_slash(item.child_frame_id)
    if not parent or not child or parent == child:
        raise _malformed("a transform without two different frames")
    translation_m = _vector(item.transform.translation, "translation")
    quat_xyzw = _quaternion(item.transform.rotation, "rotation")
    return StampedTransform(_stamp_ns(item.header.stamp), parent, child, translation_m, quat_xyzw)


def _cells(data: Any, width: int, height: int, max_cells: int) -> Cells:
    """(height, width) view of row-major data."""
    if len(data) != width * height:
        raise _malformed(f"{len(data)} cells instead of {width} x {height}")
    if len(data) > max_cells:
        raise OverLimitError("", 0, f"{width} x {height} cells, the limit is {max_cells}")
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
    if max(abs(x), abs(y), abs(z)) > FARTHEST_M:
        raise _malformed(f"{what} is further away than anything on earth")
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
