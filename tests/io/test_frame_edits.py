"""Frames and stamps inside messages of any type."""

from __future__ import annotations

from typing import Any

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore
from rosbags.typesys.stores import ros2_humble as ros

from mapfusion_io.frame_edits import FrameEdits


@pytest.fixture(scope="module")
def store() -> Typestore:
    store = get_typestore(Stores.ROS2_HUMBLE)
    text = "std_msgs/Header[] headers\nuint32 frame_id\nstring child_frame_id\nfloat64[3] numbers\nstring note\n"
    store.register(get_types_from_msg(text, "my_msgs/msg/Odd"))
    return store


def header(frame_id: str, sec: int = 10, nanosec: int = 0) -> ros.std_msgs__msg__Header:
    return ros.std_msgs__msg__Header(ros.builtin_interfaces__msg__Time(sec, nanosec), frame_id)


def transform(parent: str, child: str, sec: int = 10) -> ros.geometry_msgs__msg__TransformStamped:
    rotation = ros.geometry_msgs__msg__Quaternion(0.0, 0.0, 0.0, 1.0)
    motion = ros.geometry_msgs__msg__Transform(ros.geometry_msgs__msg__Vector3(0.0, 0.0, 0.0), rotation)
    return ros.geometry_msgs__msg__TransformStamped(header(parent, sec), child, motion)


def test_every_transform_gets_both_frames_renamed(store: Typestore) -> None:
    message = ros.tf2_msgs__msg__TFMessage([transform("/map", "odom"), transform("odom", "base_link")])
    assert FrameEdits(store, lambda frame: f"r1/{frame}", 0).apply(message, "tf2_msgs/msg/TFMessage")
    assert [(t.header.frame_id, t.child_frame_id) for t in message.transforms] == [
        ("r1/map", "r1/odom"),
        ("r1/odom", "r1/base_link"),
    ]
    assert message.transforms[0].header.stamp.sec == 10


def test_stamps_are_shifted_but_not_zero(store: Typestore) -> None:
    message = ros.tf2_msgs__msg__TFMessage([transform("a", "b", 10), transform("a", "c", 0)])
    assert FrameEdits(store, str, -1_500_000_000).apply(message, "tf2_msgs/msg/TFMessage")
    first, second = (t.header.stamp for t in message.transforms)
    assert (first.sec, first.nanosec) == (8, 500_000_000)
    assert (second.sec, second.nanosec) == (0, 0)


def test_says_whether_anything_changed(store: Typestore) -> None:
    edits = FrameEdits(store, str, 0)
    assert not edits.apply(header("map"), "std_msgs/msg/Header")
    assert not edits.apply(header(""), "std_msgs/msg/Header")
    slashed = header("/map")
    assert edits.apply(slashed, "std_msgs/msg/Header")
    assert slashed.frame_id == "map"


def test_finds_frames_in_types_it_has_never_seen(store: Typestore) -> None:
    headers: list[Any] = [header("a"), header("b")]
    message: Any = store.types["my_msgs/msg/Odd"](
        headers=headers, frame_id=7, child_frame_id="c", numbers=[0.0, 0.0, 0.0], note="frame a"
    )
    assert FrameEdits(store, str.upper, 0).apply(message, "my_msgs/msg/Odd")
    assert [part.frame_id for part in message.headers] == ["A", "B"]
    assert (message.frame_id, message.child_frame_id, message.note) == (7, "C", "frame a")
