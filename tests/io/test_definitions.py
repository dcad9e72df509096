from __future__ import annotations

import pytest

from mapfusion_io.definitions import DefinitionError, default_store, store_from
from tests.ending import ends
from tests.io.making import HUMBLE

SEPARATOR = "=" * 80 + "\n"


def test_store_holds_the_type_and_what_it_needs() -> None:
    text = "demo/Part[] parts\nint32 LIMIT=5\n" + SEPARATOR + "MSG: demo/Part\ntime stamp\nstring<=9 from\n"
    store = store_from("demo/msg/Thing", "ros2msg", text.encode())
    assert set(store.fielddefs) == {
        "demo/msg/Thing",
        "demo/msg/Part",
        "builtin_interfaces/msg/Time",
        "builtin_interfaces/msg/Duration",
    }
    part = store.types["demo/msg/Part"](stamp=store.types["builtin_interfaces/msg/Time"](sec=1, nanosec=2), from_="a")
    thing = store.types["demo/msg/Thing"](parts=[part])
    assert store.deserialize_cdr(bytes(store.serialize_cdr(thing, "demo/msg/Thing")), "demo/msg/Thing") == thing


def test_every_type_of_a_release_is_taken() -> None:
    for name in ("nav_msgs/msg/OccupancyGrid", "nav_msgs/msg/Odometry", "sensor_msgs/msg/PointCloud2"):
        text, _ = HUMBLE.generate_msgdef(name, ros_version=2)
        assert name in store_from(name, "ros2msg", text.encode()).fielddefs


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("\xff\n", "cannot be parsed"),
        ("int32 = 5\n", "cannot be parsed"),
        ("Other x\n", "no type demo/msg/Other"),
        ("Thing x\n", "contains itself"),
        ("Part[] x\n" + SEPARATOR + "MSG: demo/Part\nThing[] y\n", "contains itself"),
        ("string[999999999] x\n", "999999999 elements"),
        ("int8[99999999999] x\n", "99999999999 elements"),
        ("int8[-1] x\n", "-1 elements"),
        ("Part[] x\n" + SEPARATOR + "MSG: demo/Part\n", "list of nothing"),
        ("string X='" + "x" * 2**20 + "'\n", "bytes"),
        ("time x\n" + SEPARATOR + "MSG: builtin_interfaces/Time\nint8 x\n", "cannot be parsed"),
    ],
)
def test_definitions_that_ask_for_trouble(text: str, words: str) -> None:
    with ends(1.0), pytest.raises(DefinitionError, match=words):
        store_from("demo/msg/Thing", "ros1msg", text.encode("latin-1"))


@pytest.mark.parametrize(
    "name",
    ["demo/msg/X:\n  import os\nclass Y", "demo/msg/9", "__import__('os')", "demo/msg/x y", "demo"],
)
def test_names_are_never_run(name: str) -> None:
    with pytest.raises(DefinitionError):
        store_from(name, "ros2msg", b"int32 a\n")


def test_text_constants_stay_text() -> None:
    store = store_from("demo/msg/Thing", "ros2msg", b"string X='\\'); raise SystemExit #'\nint8 y\n")
    assert "SystemExit" in str(store.fielddefs["demo/msg/Thing"][0])


def test_usual_types_know_what_mapping_needs() -> None:
    for encoding in ("cdr", "ros1"):
        fields = default_store(encoding).fielddefs
        assert {"map_msgs/msg/OccupancyGridUpdate", "tf/msg/tfMessage", "tf2_msgs/msg/TFMessage"} <= set(fields)
    assert "seq" in dict(default_store("ros1").fielddefs["std_msgs/msg/Header"][1])
    assert "seq" not in dict(default_store("cdr").fielddefs["std_msgs/msg/Header"][1])
