"""Recordings that exist only in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.typesys.stores import ros2_humble as ros

from mapfusion.grid import Cells
from mapfusion.steps import GridEvent
from mapfusion_io.interfaces import Attachment, Channel, Loss, RawMessage
from mapfusion_io.mission import Mission, MissionOptions
from mapfusion_io.survey import Survey, take_survey
from tests.io.making import HUMBLE, cdr, grid_message, header, pose_message, tf_message, update_message

SECOND_NS = 10**9
START_NS = 1_700_000_000 * SECOND_NS
CELLS: Cells = np.zeros((4, 5), np.int8)


class FakeRecording:
    """Implements `Recording` over a list of messages."""

    container = "mcap"
    integrity_verifiable = True

    def __init__(self, name: str, messages: Iterable[RawMessage], losses: tuple[Loss, ...] = ()) -> None:
        self.path = Path(name)
        self.losses = losses
        self._messages = list(messages)
        self.records: list[tuple[str, Mapping[str, str]]] = []

    def messages(self, keep: Callable[[Channel], bool]) -> Iterator[RawMessage]:
        wanted: dict[Channel, bool] = {}
        for raw in self._messages:
            if raw.channel not in wanted:
                wanted[raw.channel] = keep(raw.channel)
            if wanted[raw.channel]:
                yield raw

    def attachments(self) -> Iterator[Attachment]:
        return iter(())

    def metadata(self) -> Iterator[tuple[str, Mapping[str, str]]]:
        return iter(self.records)


class Sender:
    """Makes messages of one recording; times are seconds after `START_NS`."""

    def __init__(self) -> None:
        self._channels: dict[tuple[str, str], Channel] = {}

    def send(self, topic: str, message: Any, time_s: float, stamp_s: float | None = None) -> RawMessage:
        """A message with its log time, and its header's stamp where that is another."""
        type_name = message.__msgtype__
        if hasattr(message, "header"):
            stamp_ns = ns(time_s if stamp_s is None else stamp_s)
            message.header.stamp = ros.builtin_interfaces__msg__Time(*divmod(stamp_ns, SECOND_NS))
        channel = self._channels.setdefault((topic, type_name), Channel(topic, type_name, "", b"", "cdr"))
        return RawMessage(channel, ns(time_s), ns(time_s), cdr(message))

    def grid(
        self, topic: str, time_s: float, frame: str = "map", cells: Cells = CELLS, stamp_s: float | None = None
    ) -> RawMessage:
        return self.send(topic, grid_message(cells, frame_id=frame), time_s, stamp_s)

    def update(self, topic: str, time_s: float, cells: Cells, x: int, y: int) -> RawMessage:
        return self.send(topic, update_message(cells, x, y), time_s)

    def transforms(self, topic: str, time_s: float, *edges: tuple[str, str]) -> RawMessage:
        message = tf_message(*edges)
        for transform in message.transforms:
            transform.header.stamp = ros.builtin_interfaces__msg__Time(*divmod(ns(time_s), SECOND_NS))
        return self.send(topic, message, time_s)

    def pose(self, topic: str, time_s: float, frame: str = "map", x: float = 0.0) -> RawMessage:
        return self.send(topic, ros.geometry_msgs__msg__PoseStamped(header(frame), pose_message(x)), time_s)

    def odometry(self, topic: str, time_s: float, frame: str = "odom", x: float = 0.0) -> RawMessage:
        zero = ros.geometry_msgs__msg__Vector3(0.0, 0.0, 0.0)
        message = ros.nav_msgs__msg__Odometry(
            header(frame),
            "base_link",
            ros.geometry_msgs__msg__PoseWithCovariance(pose_message(x), np.zeros(36)),
            ros.geometry_msgs__msg__TwistWithCovariance(ros.geometry_msgs__msg__Twist(zero, zero), np.zeros(36)),
        )
        return self.send(topic, message, time_s)

    def text(self, topic: str, time_s: float) -> RawMessage:
        return self.send(topic, HUMBLE.types["std_msgs/msg/String"]("hello"), time_s)


def ns(time_s: float) -> int:
    """The time on the recordings' clock."""
    return START_NS + round(time_s * SECOND_NS)


def surveyed(name: str, *messages: RawMessage, losses: tuple[Loss, ...] = ()) -> Survey:
    """A recording after its first pass."""
    recording = FakeRecording(f"{name}.mcap", messages, losses)
    return take_survey(recording, name, "header")


def mission(*messages: RawMessage, losses: tuple[Loss, ...] = (), **options: object) -> Mission:
    """A mission of one recording."""
    return Mission([surveyed("run", *messages, losses=losses)], MissionOptions(**options))  # type: ignore[arg-type]


def grids(mission: Mission) -> list[tuple[str, float]]:
    """Robot and stamp of every map, in seconds after `START_NS`."""
    return [
        (event.robot, (event.stamp_ns - START_NS) * 1e-9) for event in mission.events() if isinstance(event, GridEvent)
    ]
