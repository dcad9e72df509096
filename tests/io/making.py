"""Recordings and messages made for a test."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.stores import ros1_noetic as ros1
from rosbags.typesys.stores import ros2_humble as ros

from mapfusion.grid import Cells
from mapfusion_io.interfaces import Channel, RawMessage, Recording

SHARED = Path(__file__).resolve().parents[2] / ".." / "shared" / "data"
HUMBLE = get_typestore(Stores.ROS2_HUMBLE)
NOETIC = get_typestore(Stores.ROS1_NOETIC)
UPDATE_TYPE, UPDATE_DEFINITION = (
    "map_msgs/msg/OccupancyGridUpdate",
    "std_msgs/Header header\nint32 x\nint32 y\nuint32 width\nuint32 height\nint8[] data\n",
)
HUMBLE.register(get_types_from_msg(UPDATE_DEFINITION, UPDATE_TYPE))
STAMP_NS = 1_700_000_000_250_000_000


class Sent(NamedTuple):
    """A message on its way into a recording."""

    topic: str
    type_name: str
    log_time_ns: int
    data: bytes


def header(frame_id: str = "map", stamp_ns: int = STAMP_NS) -> ros.std_msgs__msg__Header:
    return ros.std_msgs__msg__Header(ros.builtin_interfaces__msg__Time(*divmod(stamp_ns, 10**9)), frame_id)


def pose_message(
    x: float = 0.0, y: float = 0.0, quat: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
) -> ros.geometry_msgs__msg__Pose:
    return ros.geometry_msgs__msg__Pose(
        ros.geometry_msgs__msg__Point(x, y, 0.0), ros.geometry_msgs__msg__Quaternion(*quat)
    )


def grid_message(cells: Cells, resolution_m: float = 0.05, frame_id: str = "map", **pose: Any) -> Any:
    height, width = cells.shape
    info = ros.nav_msgs__msg__MapMetaData(
        ros.builtin_interfaces__msg__Time(0, 0), resolution_m, width, height, pose_message(**pose)
    )
    return ros.nav_msgs__msg__OccupancyGrid(header(frame_id), info, cells.ravel())


def update_message(cells: Cells, x: int, y: int) -> Any:
    height, width = cells.shape
    return HUMBLE.types[UPDATE_TYPE](
        header=header(),
        x=x,
        y=y,
        width=width,
        height=height,
        data=cells.ravel(),
    )


def tf_message(*edges: tuple[str, str], quat: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)) -> Any:
    return ros.tf2_msgs__msg__TFMessage(
        [
            ros.geometry_msgs__msg__TransformStamped(
                header(parent),
                child,
                ros.geometry_msgs__msg__Transform(
                    ros.geometry_msgs__msg__Vector3(1.0, 2.0, 3.0), ros.geometry_msgs__msg__Quaternion(*quat)
                ),
            )
            for parent, child in edges
        ]
    )


def cdr(message: Any, little_endian: bool = True) -> bytes:
    return bytes(HUMBLE.serialize_cdr(message, message.__msgtype__, little_endian=little_endian))


def ros1_grid(cells: Cells, frame_id: str = "/map") -> bytes:
    height, width = cells.shape
    time = ros1.builtin_interfaces__msg__Time(*divmod(STAMP_NS, 10**9))
    pose = ros1.geometry_msgs__msg__Pose(
        ros1.geometry_msgs__msg__Point(0.0, 0.0, 0.0), ros1.geometry_msgs__msg__Quaternion(0.0, 0.0, 0.0, 1.0)
    )
    info = ros1.nav_msgs__msg__MapMetaData(time, 0.05, width, height, pose)
    message = ros1.nav_msgs__msg__OccupancyGrid(ros1.std_msgs__msg__Header(7, time, frame_id), info, cells.ravel())
    return bytes(NOETIC.serialize_ros1(message, message.__msgtype__))


def small_cells(seed: int = 0, shape: tuple[int, int] = (6, 8)) -> Cells:
    return np.random.default_rng(seed).choice(np.array([-1, 0, 100], np.int8), shape)


def mission_messages(count: int = 40) -> list[Sent]:
    """Maps and transforms by turns, the maps of each robot different."""
    sent = []
    for index in range(count):
        log_time_ns = STAMP_NS + index * 10**8
        if index % 4 == 0:
            sent.append(Sent("/tf", "tf2_msgs/msg/TFMessage", log_time_ns, cdr(tf_message(("odom", "base_link")))))
        else:
            topic = f"/robot{index % 4}/map"
            data = cdr(grid_message(small_cells(index, (12, 15))))
            sent.append(Sent(topic, "nav_msgs/msg/OccupancyGrid", log_time_ns, data))
    return sent


def mcap_bytes(messages: Sequence[Sent], profile: str = "ros2", **options: Any) -> bytes:
    """An MCAP file; `options` are those of `mcap.writer.Writer`."""
    file = BytesIO()
    writer: Any = Writer(file, **{"chunk_size": 1000, "compression": CompressionType.ZSTD, **options})
    writer.start(profile=profile)
    channels: dict[tuple[str, str], int] = {}
    for sent in messages:
        key = sent.topic, sent.type_name
        if key not in channels:
            definition = HUMBLE.generate_msgdef(sent.type_name, ros_version=2)[0].encode()
            schema = writer.register_schema(sent.type_name, "ros2msg", definition)
            channels[key] = writer.register_channel(sent.topic, "cdr", schema)
        writer.add_message(channels[key], sent.log_time_ns, sent.data, sent.log_time_ns)
    writer.finish()
    return file.getvalue()


def write_rosbag2(folder: Path, messages: Sequence[Sent], storage: StoragePlugin) -> None:
    with Rosbag2Writer(folder, version=9, storage_plugin=storage) as writer:
        connections = {
            sent.topic: writer.add_connection(sent.topic, sent.type_name, typestore=HUMBLE)
            for sent in {sent.topic: sent for sent in messages}.values()
        }
        for sent in messages:
            writer.write(connections[sent.topic], sent.log_time_ns, sent.data)


def write_rosbag1(
    path: Path,
    messages: Sequence[Sent],
    compression: Rosbag1Writer.CompressionFormat | None = None,
    chunk_bytes: int | None = None,
) -> None:
    writer = Rosbag1Writer(path)
    if chunk_bytes is not None:
        writer.chunk_threshold = chunk_bytes
    if compression:
        writer.set_compression(compression)
    with writer:
        connections = {
            sent.topic: writer.add_connection(sent.topic, sent.type_name, typestore=NOETIC)
            for sent in {sent.topic: sent for sent in messages}.values()
        }
        for sent in messages:
            writer.write(connections[sent.topic], sent.log_time_ns, sent.data)


def raw_message(type_name: str, data: bytes, **channel: Any) -> RawMessage:
    """A message of a channel with the usual definition, unless `channel` says otherwise."""
    fields = {
        "topic": "/topic",
        "schema_name": type_name,
        "schema_encoding": "",
        "schema_data": b"",
        "message_encoding": "cdr",
        **channel,
    }
    return RawMessage(Channel(**fields), STAMP_NS, STAMP_NS, data)


def delivered(recording: Recording) -> list[tuple[str, str, int, bytes]]:
    """Topic, type, log time and bytes of every message."""
    return [
        (raw.channel.topic, raw.channel.schema_name, raw.log_time_ns, bytes(raw.data))
        for raw in recording.messages(lambda channel: True)
    ]
