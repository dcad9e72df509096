"""What becomes of a recorded channel in a ROS 2 recording."""

from __future__ import annotations

import numpy as np
import pytest

from mapfusion_io.definitions import default_store
from mapfusion_io.interfaces import Channel
from mapfusion_io.ros2_form import NoRos2FormError, ros2_form


def test_a_ros2_definition_stays_as_recorded() -> None:
    text = b"# my comment\nfloat64 level # metres\n"
    form = ros2_form(Channel("/l", "my_msgs/msg/Level", "ros2msg", text, "cdr"))
    assert (form.kind.name, form.kind.encoding, form.kind.definition) == ("my_msgs/msg/Level", "ros2msg", text)
    assert form.kind.type_hash.startswith("RIHS01_")
    data = b"\0\1\0\0" + bytes(8)
    assert form.cdr(data, None) is data


def test_fields_are_those_of_the_type_and_all_within() -> None:
    definition = default_store("cdr").generate_msgdef("geometry_msgs/msg/PoseStamped", ros_version=2)[0]
    form = ros2_form(Channel("/p", "geometry_msgs/msg/PoseStamped", "ros2msg", definition.encode(), "cdr"))
    assert {"geometry_msgs/msg/Pose", "std_msgs/msg/Header", "builtin_interfaces/msg/Time"} <= set(form.fields())
    assert "nav_msgs/msg/Path" not in form.fields()


@pytest.mark.parametrize("defined", [True, False])
def test_ros1_has_the_hash_and_the_header_of_ros2(defined: bool) -> None:
    name = "geometry_msgs/msg/PoseStamped"
    definition = default_store("ros1").generate_msgdef(name)[0].encode() if defined else b""
    form = ros2_form(Channel("/p", name, "ros1msg" if defined else "", definition, "ros1"))
    assert form.kind.type_hash == default_store("cdr").hash_rihs01(name)
    assert form.kind.encoding == "ros2msg"
    assert b"seq" not in form.kind.definition


def test_ros1_bytes_become_cdr() -> None:
    form = ros2_form(Channel("/p", "my_msgs/msg/P", "ros1msg", b"uint8 a\nfloat64 b\n", "ros1"))
    cdr = bytes(form.cdr(b"\x05" + np.float64(1.5).tobytes(), None))
    assert cdr == b"\0\1\0\0" + b"\x05" + bytes(7) + np.float64(1.5).tobytes()


@pytest.mark.parametrize("data", [b"\x05", b"\x05" + bytes(9)])
def test_ros1_bytes_of_another_length_are_malformed(data: bytes) -> None:
    form = ros2_form(Channel("/p", "my_msgs/msg/P", "ros1msg", b"uint8 a\nfloat64 b\n", "ros1"))
    with pytest.raises(NoRos2FormError, match="malformed message"):
        form.cdr(data, None)


def test_no_form_for_a_type_nobody_knows() -> None:
    with pytest.raises(NoRos2FormError, match="no usable definition"):
        ros2_form(Channel("/p", "my_msgs/msg/P", "", b"", "cdr"))
