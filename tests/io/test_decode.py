from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from mapfusion.errors import LogReadError
from mapfusion_io.decode import Decoder, MalformedMessageError
from mapfusion_io.definitions import MAX_DEFINITIONS
from mapfusion_io.interfaces import RawMessage
from tests.io.making import (
    HUMBLE,
    NOETIC,
    STAMP_NS,
    UPDATE_TYPE,
    cdr,
    grid_message,
    raw_message,
    ros1_grid,
    small_cells,
    tf_message,
    update_message,
)

GRID = "nav_msgs/msg/OccupancyGrid"
CELLS = small_cells(0, (30, 40))
GRID_BYTES = cdr(grid_message(CELLS))
GRID_DEFINITION = HUMBLE.generate_msgdef(GRID, ros_version=2)[0].encode()
POINT_IDL = b"""module demo { module msg { struct Pair {
  @verbatim (language="comment", text="first")
  int32 first; sequence<int8> rest; }; }; };
"""


def own(type_name: str, definition: str, data: bytes, encoding: str = "ros2msg", **channel: Any) -> RawMessage:
    return raw_message(type_name, data, schema_encoding=encoding, schema_data=definition.encode(), **channel)


def test_past_many_definitions_the_usual_one_is_taken() -> None:
    decoder = Decoder()
    definitions = [f"# {number}\n{GRID_DEFINITION.decode()}" for number in range(MAX_DEFINITIONS + 20)]
    for definition in [*definitions, definitions[0]]:
        assert (decoder.decode(own(GRID, definition, GRID_BYTES)).info.width) == 40
    assert len(decoder.warnings) == 1
    pair = own("demo/msg/Pair", "int32 first\n", bytes(8))
    assert "more than 64 definitions" in (decoder.supported(pair.channel) or "")


@pytest.mark.parametrize("definition", [b"", GRID_DEFINITION, GRID_DEFINITION.replace(b"\n", b"\r\n")])
@pytest.mark.parametrize("little_endian", [True, False])
def test_grid_with_and_without_its_definition(definition: bytes, little_endian: bool) -> None:
    data = cdr(grid_message(CELLS), little_endian)
    raw = raw_message(GRID, data, schema_encoding="ros2msg" if definition else "", schema_data=definition)
    decoder = Decoder()
    assert decoder.supported(raw.channel) is None
    message = decoder.decode(raw)
    np.testing.assert_array_equal(message.data.reshape(30, 40), CELLS)


def test_large_grid_is_a_view_of_its_bytes() -> None:
    raw = raw_message(GRID, cdr(grid_message(small_cells(0, (300, 400)))))
    data = Decoder().decode(raw).data
    assert not data.flags.owndata
    assert not data.flags.writeable
    assert np.shares_memory(data, np.frombuffer(raw.data, np.uint8))


def test_ros1_by_its_definition_and_without() -> None:
    definition = NOETIC.generate_msgdef(GRID, ros_version=1)[0].encode()
    for encoding, schema in (("ros1msg", definition), ("", b"")):
        channel = {"schema_encoding": encoding, "schema_data": schema, "message_encoding": "ros1"}
        message = Decoder().decode(raw_message(GRID, ros1_grid(CELLS), **channel))
        assert (message.header.seq, message.header.frame_id) == (7, "/map")
        np.testing.assert_array_equal(message.data.reshape(30, 40), CELLS)


@pytest.mark.parametrize("wrapped", [False, True])
def test_idl(wrapped: bool) -> None:
    text = POINT_IDL.decode()
    if wrapped:
        text = "=" * 80 + "\nIDL: demo/msg/Pair\n" + text
    data = b"\0\1\0\0" + struct.pack("<iI3b", 7, 3, 1, 2, 3)
    message = Decoder().decode(own("demo/msg/Pair", text, data, "ros2idl"))
    assert message.first == 7
    assert message.rest.tolist() == [1, 2, 3]


@pytest.mark.parametrize("type_name", [UPDATE_TYPE, "tf/msg/tfMessage"])
def test_types_that_rosbags_does_not_bring(type_name: str) -> None:
    message = update_message(CELLS, 3, 4) if type_name == UPDATE_TYPE else tf_message(("a", "b"))
    decoded = Decoder().decode(raw_message(type_name, cdr(message)))
    assert decoded.x == 3 if type_name == UPDATE_TYPE else decoded.transforms[0].child_frame_id == "b"


def test_definitions_of_one_name_do_not_clash() -> None:
    first = own("demo/msg/Thing", "int32 a\n", b"\0\1\0\0" + struct.pack("<i", 5))
    second = own("demo/msg/Thing", "int16 b\nint16 c\n", b"\0\1\0\0" + struct.pack("<hh", 1, 2))
    decoder = Decoder()
    for _ in range(2):
        assert decoder.decode(first).a == 5
        assert (decoder.decode(second).b, decoder.decode(second).c) == (1, 2)


def test_definition_that_cannot_be_used_gives_way_to_the_usual_one() -> None:
    decoder = Decoder()
    assert decoder.decode(own(GRID, "int32 = nonsense", GRID_BYTES)).info.width == 40
    (warning,) = decoder.warnings
    assert warning.startswith("/topic: type nav_msgs/msg/OccupancyGrid: its definition cannot be used")
    assert warning.endswith("the usual one is taken")


@pytest.mark.parametrize(
    ("channel", "words"),
    [
        ({"schema_name": "demo/msg/Thing"}, "no definition"),
        ({"message_encoding": "json"}, "json"),
        ({"message_encoding": ""}, "no encoding"),
        ({"schema_name": "foxglove.Grid", "schema_encoding": "protobuf", "schema_data": b"x"}, "protobuf"),
        ({"schema_name": "demo/msg/Thing", "schema_encoding": "ros2msg", "schema_data": b"\xff"}, "cannot be parsed"),
    ],
)
def test_why_a_channel_cannot_be_decoded(channel: dict[str, Any], words: str) -> None:
    raw = raw_message(GRID, GRID_BYTES, **channel)
    decoder = Decoder()
    assert words in (decoder.supported(raw.channel) or "")
    with pytest.raises(LogReadError, match="/topic"):
        decoder.decode(raw)


@pytest.mark.parametrize("cut", [0, 1, 3, 4, 8, 20, 60, -1, -900])
def test_cut_bytes_are_malformed(cut: int) -> None:
    with pytest.raises(MalformedMessageError) as raised:
        Decoder().decode(raw_message(GRID, GRID_BYTES[:cut]))
    assert (raised.value.topic, raised.value.log_time_ns) == ("/topic", STAMP_NS)
    assert "OccupancyGrid" in raised.value.reason


def test_other_damage_is_malformed_too() -> None:
    rng = np.random.default_rng(5)
    decoder = Decoder()
    reasons = []
    for _ in range(300):
        damaged = np.frombuffer(GRID_BYTES, np.uint8).copy()
        damaged[rng.integers(0, 90, 3)] ^= rng.integers(1, 256, 3).astype(np.uint8)
        try:
            decoder.decode(raw_message(GRID, damaged.tobytes()))
        except MalformedMessageError as error:
            reasons.append(error.reason)
    assert len(reasons) > 50
    assert set(reasons) == {f"its bytes are no {GRID}"}
