"""The recordings' messages beside the results: what stays, what changes, what is left out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.stores import ros1_noetic as ros1
from rosbags.typesys.stores import ros2_humble as ros

from mapfusion_io import input_copy
from mapfusion_io.definitions import default_store
from mapfusion_io.input_copy import CUT, CopySource, InputCopy, LeftOut
from mapfusion_io.interfaces import Attachment, Channel, Loss, RawMessage
from mapfusion_io.output import MissionWriter
from tests.io.fake_steps import START_NS, make_steps

HUMBLE = get_typestore(Stores.ROS2_HUMBLE)
NOETIC = default_store("ros1")
_ZERO = "\n    sec: 0\n    nsec: 0"
RECORDED_QOS = (
    "- history: keep_last\n  depth: 7\n  reliability: reliable\n  durability: volatile\n"
    f"  deadline:{_ZERO}\n  lifespan:{_ZERO}\n  liveliness: automatic\n  liveliness_lease_duration:{_ZERO}\n"
    "  avoid_ros_namespace_conventions: false\n"
)


@dataclass
class FakeRecording:
    """A recording that is a list."""

    raws: Sequence[RawMessage]
    path: Path = Path("bag.mcap")
    container: str = "mcap"
    integrity_verifiable: bool = True
    losses: tuple[Loss, ...] = ()
    num_read: int = field(default=0)

    def messages(self, keep: Callable[[Channel], bool]) -> Iterator[RawMessage]:
        for raw in self.raws:
            self.num_read += 1
            if keep(raw.channel):
                yield raw

    def attachments(self) -> Iterator[Attachment]:
        return iter(())

    def metadata(self) -> Iterator[tuple[str, Mapping[str, str]]]:
        return iter(())


def ros2_channel(topic: str, type_name: str, text: str | None = None, **metadata: str) -> Channel:
    definition = HUMBLE.generate_msgdef(type_name, ros_version=2)[0] if text is None else text
    return Channel(topic, type_name, "ros2msg", definition.encode(), "cdr", metadata)


def ros1_channel(topic: str, type_name: str, **metadata: str) -> Channel:
    definition = NOETIC.generate_msgdef(type_name, ros_version=1)[0]
    return Channel(topic, type_name, "ros1msg", definition.encode(), "ros1", metadata)


def header(frame_id: str, stamp_ns: int = START_NS) -> ros.std_msgs__msg__Header:
    return ros.std_msgs__msg__Header(ros.builtin_interfaces__msg__Time(*divmod(stamp_ns, 10**9)), frame_id)


def cdr(message: Any) -> bytes:
    return bytes(HUMBLE.serialize_cdr(message, message.__msgtype__))


def text_message(text: str) -> bytes:
    return cdr(ros.std_msgs__msg__String(text))


def transforms(parent: str, child: str) -> ros.tf2_msgs__msg__TFMessage:
    rotation = ros.geometry_msgs__msg__Quaternion(0.0, 0.0, 0.0, 1.0)
    motion = ros.geometry_msgs__msg__Transform(ros.geometry_msgs__msg__Vector3(1.0, 2.0, 0.0), rotation)
    return ros.tf2_msgs__msg__TFMessage([ros.geometry_msgs__msg__TransformStamped(header(parent), child, motion)])


def source(
    *raws: RawMessage, name: str = "bag.mcap", prefix: str = "", shift_ns: int = 0, recording: Any = None
) -> CopySource:
    """Copies topics as they are; frames get `prefix`."""
    return CopySource(
        recording or FakeRecording(raws, Path(name)),
        lambda channel: channel.topic,
        lambda channel: (lambda frame: f"{prefix}/{frame}") if prefix else None,
        shift_ns,
        shift_ns,
    )


def raw(channel: Channel, data: bytes, time_ns: int = START_NS) -> RawMessage:
    return RawMessage(channel, time_ns, time_ns - 1, data)


def copy_to(path: Path, *sources: CopySource, steps: bool = False) -> InputCopy:
    inputs = InputCopy(sources)
    with MissionWriter(path, inputs=inputs) as out:
        for step in make_steps(3) if steps else ():
            out.write(step)
        out.finish({}, {})
    return inputs


@dataclass(frozen=True)
class Copied:
    """A message as rosbags finds it in the output."""

    topic: str
    log_time_ns: int
    data: bytes
    message: Any
    qos: Any


def read(path: Path) -> list[Copied]:
    with AnyReader([path]) as bag:
        return [
            Copied(c.topic, time_ns, data, bag.deserialize(data, c.msgtype), c.ext.offered_qos_profiles[0])  # type: ignore[union-attr]
            for c, time_ns, data in bag.messages()
        ]


def test_cdr_stays_byte_for_byte_with_definition_and_qos(tmp_path: Path) -> None:
    channel = ros2_channel("/note", "std_msgs/msg/String", "# kept\nstring data\n", offered_qos_profiles=RECORDED_QOS)
    data = text_message("hello") + b"\0\0"  # padding that rosbags would not write
    inputs = copy_to(tmp_path / "out.mcap", source(raw(channel, data)))
    (copied,) = read(tmp_path / "out.mcap")
    assert (copied.topic, copied.log_time_ns, copied.data, copied.message.data) == ("/note", START_NS, data, "hello")
    assert copied.qos.depth == 7
    assert inputs.left_out == ()
    with (tmp_path / "out.mcap").open("rb") as file:
        ((schema, written, message),) = make_reader(file).iter_messages()
    assert schema is not None
    assert schema.data == b"# kept\nstring data\n"
    assert written.metadata["topic_type_hash"] == HUMBLE.hash_rihs01("std_msgs/msg/String")
    assert message.publish_time == START_NS - 1


def test_idl_stays_idl(tmp_path: Path) -> None:
    idl = "module my_msgs {\n  module msg {\n    struct Level {\n      double level;\n    };\n  };\n};\n"
    channel = Channel("/level", "my_msgs/msg/Level", "ros2idl", idl.encode(), "cdr")
    data = b"\0\1\0\0" + np.float64(2.5).tobytes()
    copy_to(tmp_path / "out.mcap", source(raw(channel, data)))
    (copied,) = read(tmp_path / "out.mcap")
    assert (copied.data, copied.message.level) == (data, 2.5)


def test_frames_are_renamed_and_transforms_gather_on_one_topic(tmp_path: Path) -> None:
    first = ros2_channel("/tf", "tf2_msgs/msg/TFMessage", offered_qos_profiles=RECORDED_QOS)
    second = ros2_channel("/robot2/tf", "tf2_msgs/msg/TFMessage")
    static = ros2_channel("/robot2/tf_static", "tf2_msgs/msg/TFMessage")
    copy_to(
        tmp_path / "out.mcap",
        source(raw(first, cdr(transforms("map", "odom"))), prefix="robot1"),
        source(
            raw(second, cdr(transforms("/map", "odom")), START_NS + 1),
            raw(static, cdr(transforms("odom", "laser")), START_NS + 2),
            prefix="robot2",
        ),
    )
    copied = read(tmp_path / "out.mcap")
    frames = [(c.topic, t.header.frame_id, t.child_frame_id) for c in copied for t in c.message.transforms]
    assert frames == [
        ("/tf", "robot1/map", "robot1/odom"),
        ("/tf", "robot2/map", "robot2/odom"),
        ("/tf_static", "robot2/odom", "robot2/laser"),
    ]
    assert [c.qos.durability.name for c in copied] == ["VOLATILE", "VOLATILE", "TRANSIENT_LOCAL"]


def test_a_frame_that_hangs_in_the_results_frames_gets_no_second_parent(tmp_path: Path) -> None:
    channel = ros2_channel("/tf_static", "tf2_msgs/msg/TFMessage")
    both = transforms("earth", "robot1/map")
    both.transforms += transforms("robot1/base_link", "laser").transforms
    inner = cdr(transforms("robot1/map", "robot1/odom"))
    alone = raw(channel, cdr(transforms("earth", "robot1/map")), START_NS + 2)
    sent = source(raw(channel, cdr(both)), raw(channel, inner, START_NS + 1), alone)
    inputs = copy_to(tmp_path / "out.mcap", replace(sent, hung_for=lambda channel: frozenset({"robot1/map"})))
    copied = read(tmp_path / "out.mcap")
    assert [[t.child_frame_id for t in c.message.transforms] for c in copied] == [["laser"], ["robot1/odom"]]
    assert copied[1].data == inner
    assert [(left.topic, left.count, left.reason) for left in inputs.left_out] == [("/tf_static", 2, CUT)]


def test_a_shift_moves_log_times_and_stamps(tmp_path: Path) -> None:
    channel = ros2_channel("/tf", "tf2_msgs/msg/TFMessage")
    copy_to(tmp_path / "out.mcap", source(raw(channel, cdr(transforms("map", "odom"))), shift_ns=2_500_000_000))
    (copied,) = read(tmp_path / "out.mcap")
    assert copied.log_time_ns == START_NS + 2_500_000_000
    stamp = copied.message.transforms[0].header.stamp
    assert stamp.sec * 10**9 + stamp.nanosec == START_NS + 2_500_000_000
    assert copied.message.transforms[0].header.frame_id == "map"


def test_ros1_becomes_ros2(tmp_path: Path) -> None:
    time = ros1.builtin_interfaces__msg__Time(12, 34)
    identity = ros1.geometry_msgs__msg__Quaternion(0.0, 0.0, 0.0, 1.0)
    origin = ros1.geometry_msgs__msg__Pose(ros1.geometry_msgs__msg__Point(1.0, 2.0, 0.0), identity)
    grid = ros1.nav_msgs__msg__OccupancyGrid(
        ros1.std_msgs__msg__Header(99, time, "/map"),
        ros1.nav_msgs__msg__MapMetaData(time, 0.05, 2, 1, origin),
        np.array([-1, 100], dtype=np.int8),
    )
    motion = ros1.geometry_msgs__msg__Transform(ros1.geometry_msgs__msg__Vector3(1.0, 2.0, 0.0), identity)
    stamped: Any = ros1.geometry_msgs__msg__TransformStamped(
        ros1.std_msgs__msg__Header(1, time, "/map"), "/odom", motion
    )
    tf = NOETIC.types["tf/msg/tfMessage"](transforms=[stamped])
    map_channel = ros1_channel("/map", "nav_msgs/msg/OccupancyGrid")
    tf_channel = ros1_channel("/tf", "tf/msg/tfMessage")
    map_data = bytes(NOETIC.serialize_ros1(grid, "nav_msgs/msg/OccupancyGrid"))
    tf_data = bytes(NOETIC.serialize_ros1(tf, "tf/msg/tfMessage"))
    inputs = copy_to(tmp_path / "out.mcap", source(raw(map_channel, map_data), raw(tf_channel, tf_data)))
    assert inputs.left_out == ()
    first, second = (c.message for c in read(tmp_path / "out.mcap"))
    assert (first.header.frame_id, first.header.stamp.sec, first.header.stamp.nanosec) == ("map", 12, 34)
    assert not hasattr(first.header, "seq")
    assert (first.info.width, first.info.origin.position.y, first.data.tolist()) == (2, 2.0, [-1, 100])
    assert second.__msgtype__ == "tf2_msgs/msg/TFMessage"
    assert (second.transforms[0].header.frame_id, second.transforms[0].child_frame_id) == ("map", "odom")


def test_ros1_fields_get_ros2_names(tmp_path: Path) -> None:
    text = "float64[2] D\nuint8 KIND=3\n"
    channel = Channel("/camera", "my_msgs/msg/Camera", "ros1msg", text.encode(), "ros1")
    copy_to(tmp_path / "out.mcap", source(raw(channel, np.array([1.0, 2.0]).tobytes())))
    (copied,) = read(tmp_path / "out.mcap")
    assert copied.message.d.tolist() == [1.0, 2.0]


@pytest.mark.parametrize(("latching", "durability"), [("1", "TRANSIENT_LOCAL"), ("0", "VOLATILE")])
def test_ros1_latching_becomes_qos(tmp_path: Path, latching: str, durability: str) -> None:
    channel = ros1_channel("/note", "std_msgs/msg/String", latching=latching)
    data = bytes(NOETIC.serialize_ros1(ros1.std_msgs__msg__String("x"), "std_msgs/msg/String"))
    copy_to(tmp_path / "out.mcap", source(raw(channel, data)))
    assert read(tmp_path / "out.mcap")[0].qos.durability.name == durability


@pytest.mark.parametrize("qos", ["", "- depth: 3\n", "not: [yaml", "7", "x" * 100_000])
def test_qos_that_nobody_can_read_is_replaced(tmp_path: Path, qos: str) -> None:
    channel = ros2_channel("/note", "std_msgs/msg/String", offered_qos_profiles=qos)
    copy_to(tmp_path / "out.mcap", source(raw(channel, text_message("x"))))
    assert read(tmp_path / "out.mcap")[0].qos.durability.name == "VOLATILE"


def test_messages_and_results_stand_in_the_order_of_log_times(tmp_path: Path) -> None:
    channel = ros2_channel("/note", "std_msgs/msg/String")
    times_ns = [START_NS - 5 * 10**9, START_NS, START_NS + 10**9 + 1, START_NS + 60 * 10**9]
    one = source(*(raw(channel, text_message("one"), time_ns) for time_ns in times_ns), name="1.mcap")
    two = source(*(raw(channel, text_message("two"), time_ns + 1) for time_ns in times_ns), name="2.mcap")
    copy_to(tmp_path / "out.mcap", one, two, steps=True)
    with (tmp_path / "out.mcap").open("rb") as file:
        written = [m.log_time for _, _, m in make_reader(file).iter_messages(log_time_order=False)]
    assert len(written) > 8 + 6
    assert written == sorted(written)


def test_recordings_are_streamed(tmp_path: Path) -> None:
    channel = ros2_channel("/note", "std_msgs/msg/String")
    recording = FakeRecording([raw(channel, text_message("x"), START_NS + k) for k in range(1000)])
    inputs = InputCopy([source(recording=recording)])
    assert len(list(inputs.until(START_NS + 9))) == 10
    assert recording.num_read == 11
    assert len(list(inputs.until(START_NS + 9))) == 0
    assert len(list(inputs.until(None))) == 990


LEFT_OUT = [
    (Channel("/j", "Json", "jsonschema", b"{}", "json"), b"{}", "messages in json"),
    (Channel("/p", "foxglove.Grid", "protobuf", b"\x0a", "protobuf"), b"", "messages in protobuf"),
    (Channel("/s", "", "", b"", ""), b"", "messages in no known encoding"),
    (Channel("/u", "my_msgs/msg/Unknown", "", b"", "cdr"), b"\0\1\0\0", "no usable definition of the type"),
    (ros2_channel("/b", "my_msgs/msg/Broken", "float64\n"), b"\0\1\0\0", "no usable definition of the type"),
    (Channel("/x", "my_msgs/msg/X", "protobuf", b"x", "cdr"), b"\0\1\0\0", "definition in protobuf"),
    (ros2_channel("/fused/map", "std_msgs/msg/String"), b"", "/fused/map is a topic of the results"),
    (ros2_channel("/diagnostics", "std_msgs/msg/String"), b"", "/diagnostics is a topic of the results"),
    (ros2_channel("/tf", "std_msgs/msg/String"), b"", "/tf holds tf2_msgs/msg/TFMessage"),
    (
        ros2_channel("/h", "std_msgs/msg/Header", "string frame_id\n"),
        b"",
        "the type or one within is defined otherwise elsewhere in the file",
    ),
]


@pytest.mark.parametrize(("channel", "data", "reason"), LEFT_OUT, ids=[item[0].topic for item in LEFT_OUT])
def test_what_cannot_stand_in_the_file_is_named(tmp_path: Path, channel: Channel, data: bytes, reason: str) -> None:
    kept = ros2_channel("/note", "std_msgs/msg/String")
    inputs = copy_to(
        tmp_path / "out.mcap", source(raw(channel, data), raw(kept, text_message("kept")), raw(channel, data))
    )
    assert inputs.left_out == (LeftOut("bag.mcap", channel.topic, channel.schema_name, reason, 2),)
    assert [c.topic for c in read(tmp_path / "out.mcap")] == ["/note"]


def test_two_definitions_of_a_type_cannot_share_a_file(tmp_path: Path) -> None:
    first = ros2_channel("/a", "my_msgs/msg/Size", "float64 size\n")
    second = ros2_channel("/b", "my_msgs/msg/Size", "float32 size\n")
    inputs = copy_to(
        tmp_path / "out.mcap",
        source(raw(first, b"\0\1\0\0" + bytes(8)), raw(second, b"\0\1\0\0" + bytes(4), START_NS + 1)),
    )
    assert [(item.topic, item.count) for item in inputs.left_out] == [("/b", 1)]
    assert [c.topic for c in read(tmp_path / "out.mcap")] == ["/a"]


def test_what_follows_on_too_many_definitions_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(input_copy, "MAX_DEFINITIONS", 2)
    channels = [ros2_channel(f"/t{number}", "demo/msg/T", f"# {number}\nint32 x") for number in (0, 0, 1, 2)]
    inputs = copy_to(tmp_path / "out.mcap", source(*(raw(channel, bytes(8)) for channel in channels)))
    (left_out,) = inputs.left_out
    assert (left_out.topic, left_out.reason) == ("/t2", "the recordings hold more than 2 definitions")


def test_a_broken_message_is_counted_and_the_next_one_copied(tmp_path: Path) -> None:
    channel = ros2_channel("/tf", "tf2_msgs/msg/TFMessage")
    good = cdr(transforms("map", "odom"))
    inputs = copy_to(
        tmp_path / "out.mcap", source(raw(channel, good[:40]), raw(channel, good, START_NS + 1), prefix="robot1")
    )
    assert [(item.reason, item.count) for item in inputs.left_out] == [("malformed message", 1)]
    assert len(read(tmp_path / "out.mcap")) == 1


def test_humble_defines_what_an_old_recording_does_not(tmp_path: Path) -> None:
    channel = Channel("/note", "std_msgs/msg/String", "", b"", "cdr")
    copy_to(tmp_path / "out.mcap", source(raw(channel, text_message("old"))))
    assert read(tmp_path / "out.mcap")[0].message.data == "old"
