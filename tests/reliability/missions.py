"""Small missions of two robots in one place, as messages to be damaged."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from rosbags.typesys.stores import ros2_humble as ros

from mapfusion.grid import Cells
from mapfusion.transform import SE2
from tests.fakes import rooms, seen_from
from tests.io.making import Sent, cdr, grid_message, header, pose_message, tf_message, update_message

START_NS = 1_700_000_000_000_000_000
GRID = "nav_msgs/msg/OccupancyGrid"
TF = "tf2_msgs/msg/TFMessage"
POSE = "geometry_msgs/msg/PoseStamped"
RESOLUTION_M = 0.1


@cache
def maps() -> dict[str, Cells]:
    """The two robots' last maps; b's frame stands in a's at (3, 2) metres, turned by 0.4 rad."""
    place = rooms(170, 180, seed=5)
    return {
        "a": seen_from(place, SE2(0.0, 0.0, 0.0), (150, 150)).cells,
        "b": seen_from(place, SE2(3.0, 2.0, 0.4), (150, 140)).cells,
    }


def stamped(message: Any, stamp_ns: int) -> Any:
    """The message with this time in its headers."""
    time = ros.builtin_interfaces__msg__Time(*divmod(stamp_ns, 10**9))
    for item in getattr(message, "transforms", None) or [message]:
        item.header.stamp = time
    return message


def sent(topic: str, message: Any, second: float, stamp_s: float | None = None) -> Sent:
    """A message on its way, `second` seconds after the start; its header says `stamp_s`."""
    log_time_ns = START_NS + round(second * 1e9)
    stamp_ns = log_time_ns if stamp_s is None else START_NS + round(stamp_s * 1e9)
    return Sent(topic, message.__msgtype__, log_time_ns, cdr(stamped(message, stamp_ns)))


def grid(robot: str, **changed: Any) -> Any:
    """A robot's map, with other values of `cells`, `resolution_m` or of its origin where given."""
    cells = changed.pop("cells", maps()[robot])
    resolution_m = changed.pop("resolution_m", RESOLUTION_M)
    frame_id = changed.pop("frame_id", f"{robot}/map")
    return grid_message(cells, resolution_m, frame_id, **changed)


def update(robot: str, x: int) -> Any:
    """A patch of 5 x 5 free cells for a robot's map, from column `x` on."""
    message = update_message(np.zeros((5, 5), np.int8), x, 0)
    message.header.frame_id = f"{robot}/map"
    return message


def where(robot: str, second: float) -> Any:
    """The transform from a robot's map to its body."""
    message = tf_message((f"{robot}/map", f"{robot}/base_link"))
    message.transforms[0].transform.translation.x = 1.0 + 0.1 * second
    return message


def pose(robot: str, **changed: Any) -> Any:
    """A robot's pose, with other values where given."""
    return ros.geometry_msgs__msg__PoseStamped(header(f"{robot}/map"), pose_message(**changed))


def mission(seconds: int = 4) -> list[Sent]:
    """A map of each robot every two seconds, growing, and transforms four times a second."""
    messages = []
    for quarter in range(4 * seconds + 1):
        second = quarter / 4
        for robot in ("a", "b"):
            messages.append(sent("/tf", where(robot, second), second))
            if quarter % 8 == 0:
                cells = maps()[robot].copy()
                seen = 90 + 60 * quarter // max(4 * seconds, 1)
                cells[seen:] = -1
                messages.append(sent(f"/{robot}/map", grid(robot, cells=np.ascontiguousarray(cells)), second))
    return messages
