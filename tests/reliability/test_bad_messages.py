"""One bad message of each kind among good ones: counted, named, passed over, never believed."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType

from tests.io.making import HUMBLE, Sent, cdr, mcap_bytes, tf_message
from tests.reliability.missions import GRID, START_NS, TF, grid, maps, mission, pose, sent, stamped, update
from tests.reliability.running import Ran, command

FAST = ("--interval", 2, "--map-interval", 2, "--json")
Results = list[tuple[str, int, bytes]]
MESSAGES = [*mission(), *(sent("/a/pose", pose("a", x=0.1 * second), second) for second in range(4))]


def replayed(messages: list[Sent], folder: Path, *options: object) -> tuple[Ran, Results]:
    """The mission through the whole program, and every message of its output."""
    recording, output = folder / "run.mcap", folder / "fused.mcap"
    recording.write_bytes(mcap_bytes(sorted(messages, key=lambda message: message.log_time_ns)))
    ran = command("replay", recording, output, "--force", *FAST, *options)
    with output.open("rb") as file:
        return ran, [(c.topic, m.log_time, m.data) for _, c, m in make_reader(file).iter_messages()]


@pytest.fixture(scope="module")
def undamaged(tmp_path_factory: pytest.TempPathFactory) -> Results:
    """What the mission gives without bad messages, its poses from TF."""
    ran, results = replayed(MESSAGES, tmp_path_factory.mktemp("undamaged"))
    assert ran.code == 0
    assert {topic for topic, *_ in results} >= {"/fused/map", "/fused/a/pose", "/fused/b/path"}
    return results


def resized(width: int, height: int) -> Any:
    message = grid("a")
    message.info.width, message.info.height = width, height
    return message


def with_cell(value: int) -> Any:
    cells = maps()["a"].copy()
    cells[3, 4] = value
    return grid("a", cells=cells)


def moved(**changed: float) -> Any:
    message = tf_message(("a/map", "a/base_link"))
    for axis, value in changed.items():
        setattr(message.transforms[0].transform.translation, axis, value)
    return message


def turned(*quat: float) -> Any:
    return tf_message(("a/map", "a/base_link"), quat=quat)  # type: ignore[arg-type]


HALF, DAYS_S = 1.625, 86_400.0
BAD: dict[str, tuple[Callable[[], Sent], str]] = {
    "data too short": (lambda: sent("/a/map", resized(151, 150), HALF), "22500 cells instead of 151 x 150"),
    "data too long": (lambda: sent("/a/map", resized(10, 150), HALF), "22500 cells instead of 10 x 150"),
    "2^31 by 2^31": (lambda: sent("/a/map", resized(2**31, 2**31), HALF), "cells instead of"),
    "no cells": (lambda: sent("/a/map", grid("a", cells=np.empty((0, 0), np.int8)), HALF), "no cells"),
    "resolution 0": (lambda: sent("/a/map", grid("a", resolution_m=0.0), HALF), "resolution 0 m"),
    "resolution negative": (lambda: sent("/a/map", grid("a", resolution_m=-0.05), HALF), "resolution -0.05 m"),
    "resolution NaN": (lambda: sent("/a/map", grid("a", resolution_m=math.nan), HALF), "resolution nan m"),
    "resolution infinite": (lambda: sent("/a/map", grid("a", resolution_m=math.inf), HALF), "resolution inf m"),
    "resolution tiny": (lambda: sent("/a/map", grid("a", resolution_m=1e-20), HALF), "resolution 1e-20 m"),
    "cell over 100": (lambda: sent("/a/map", with_cell(101), HALF), "outside -1..100"),
    "cell below -1": (lambda: sent("/a/map", with_cell(-2), HALF), "outside -1..100"),
    "origin NaN": (lambda: sent("/a/map", grid("a", x=math.nan), HALF), "origin is not finite"),
    "origin far away": (lambda: sent("/a/map", grid("a", x=1e300), HALF), "further away"),
    "origin's quaternion NaN": (lambda: sent("/a/map", grid("a", quat=(0, 0, math.nan, 1.0)), HALF), "no rotation"),
    "origin's quaternion long": (lambda: sent("/a/map", grid("a", quat=(0.0, 0.0, 0.0, 2.0)), HALF), "no rotation"),
    "another frame": (lambda: sent("/a/map", grid("a", frame_id="elsewhere"), HALF), "in frame 'elsewhere'"),
    "a frame without end": (lambda: sent("/a/map", grid("a", frame_id="x" * 100_000), HALF), "more than 1024"),
    "a map of 1970": (lambda: sent("/a/map", grid("a"), HALF, -START_NS * 1e-9 + 5), "days away"),
    "a map of 2038": (lambda: sent("/a/map", grid("a"), HALF, 2**31 - 10 - START_NS * 1e-9), "days away"),
    "a map of before 1970": (lambda: sent("/a/map", grid("a"), HALF, -5 - START_NS * 1e-9), "before 1970"),
    "bytes that are no map": (lambda: Sent("/a/map", GRID, START_NS + 10**9, bytes(range(200))), "bytes are no"),
    "half a map": (lambda: Sent("/a/map", GRID, START_NS + 10**9, cdr(grid("a"))[:9000]), "bytes are no"),
    "no bytes": (lambda: Sent("/a/map", GRID, START_NS + 10**9, b""), "bytes are no"),
    "another type": (
        lambda: Sent("/a/map", "std_msgs/msg/String", START_NS + 10**9, cdr(HUMBLE.types["std_msgs/msg/String"]("x"))),
        "not a nav_msgs/msg/OccupancyGrid",
    ),
    "an update before any map": (
        lambda: sent("/a/map_updates", update("a", x=0), -0.1),
        "before the first map",
    ),
    "an update outside": (
        lambda: sent("/a/map_updates", update("a", x=148), HALF),
        "beyond the grid",
    ),
    "transform NaN": (lambda: sent("/tf", moved(x=math.nan), HALF), "translation is not finite"),
    "transform infinite": (lambda: sent("/tf", moved(y=math.inf), HALF), "translation is not finite"),
    "transform far away": (lambda: sent("/tf", moved(y=-1e200), HALF), "further away"),
    "transform's quaternion NaN": (lambda: sent("/tf", turned(math.nan, 0.0, 0.0, 1.0), HALF), "no rotation"),
    "transform's quaternion long": (lambda: sent("/tf", turned(0.0, 0.0, 3.0, 4.0), HALF), "no rotation"),
    "transform to itself": (lambda: sent("/tf", tf_message(("a/map", "a/map")), HALF), "two different frames"),
    "transform without frames": (lambda: sent("/tf", tf_message(("", "")), HALF), "two different frames"),
    "transform of 1970": (lambda: sent("/tf", moved(), HALF, -START_NS * 1e-9 + 5), "days away"),
    "transform of next week": (lambda: sent("/tf", moved(), HALF, 7 * DAYS_S), "days away"),
    "no transform": (lambda: Sent("/tf", TF, START_NS + 10**9, b"\0\1\0\0\xff\xff\xff\xff"), "bytes are no"),
    "two million transforms": (lambda: Sent("/tf", TF, START_NS + 10**9, bytes(2**21)), "more than 1048576 bytes"),
}


@pytest.mark.parametrize("kind", BAD)
def test_a_bad_message_changes_nothing_and_is_named(kind: str, undamaged: Results, tmp_path: Path) -> None:
    make, words = BAD[kind]
    bad = make()
    ran, results = replayed([*MESSAGES, bad], tmp_path)
    losses = json.loads(ran.out)["losses"]
    assert (ran.code, ran.err) == (3, "")
    assert [(loss["topic"], loss["messages"]) for loss in losses] == [(bad.topic, 1)]
    assert words in losses[0]["detail"]
    assert results == undamaged


HARMLESS: dict[str, Callable[[], list[Sent]]] = {
    "frames of nobody": lambda: [sent("/tf", tf_message(("x", "y"), ("y", "z")), HALF)],
    "a loop": lambda: [sent("/tf", tf_message(("a/base_link", "a/map"), ("a/map", "a/base_link_2")), HALF)],
    "an unknown type": lambda: [
        Sent("/noise", "std_msgs/msg/String", START_NS + 10**9, cdr(HUMBLE.types["std_msgs/msg/String"]("x")))
    ],
    "a bad pose of an unused topic": lambda: [sent("/a/pose", pose("a", x=math.nan), HALF)],
}


@pytest.mark.parametrize("kind", HARMLESS)
def test_what_nobody_needs_is_no_loss(kind: str, undamaged: Results, tmp_path: Path) -> None:
    ran, results = replayed([*MESSAGES, *HARMLESS[kind]()], tmp_path)
    assert (ran.code, json.loads(ran.out)["losses"]) == (0, [])
    assert results == undamaged


def test_zero_duplicate_and_late_stamps_are_counted_and_no_loss(undamaged: Results, tmp_path: Path) -> None:
    first, *others = [message for message in MESSAGES if message.topic == "/a/map"]
    message = HUMBLE.deserialize_cdr(first.data, GRID)
    zero = Sent(first.topic, GRID, first.log_time_ns, cdr(stamped(message, 0)))
    late = [Sent(m.topic, m.type_name, m.log_time_ns + 10**8, m.data) for m in others]  # in the file behind others
    rest = [message for message in MESSAGES if message.topic != "/a/map"]
    ran, results = replayed([zero, *late, late[0], *rest], tmp_path)
    robot = json.loads(ran.out)["robots"]["a"]
    assert (ran.code, robot["zero_stamps"], robot["duplicate_stamps"]) == (0, 1, 1)
    assert results == undamaged


def test_bad_poses_of_a_topic_in_use(tmp_path: Path) -> None:
    good = [sent(f"/{robot}/pose", pose(robot, x=0.1 * second), second) for robot in "ab" for second in range(4)]
    others = [message for message in mission() if message.topic != "/tf"]
    _, expected = replayed([*others, *good], tmp_path)
    bad = [
        sent("/a/pose", pose("a", x=math.inf), HALF),
        sent("/a/pose", pose("a", quat=(0.0, 0.0, 0.0, 0.2)), HALF),
        sent("/a/pose", pose("a"), HALF, 30 * DAYS_S),
    ]
    ran, results = replayed([*others, *good, *bad], tmp_path)
    assert (ran.code, sum(loss["messages"] for loss in json.loads(ran.out)["losses"])) == (3, 3)
    assert results == expected


def test_a_definition_that_cannot_be_used_is_said_once(tmp_path: Path) -> None:
    recording, text = tmp_path / "run.mcap", b"float32 resolution\n"
    plain = mcap_bytes(mission(), compression=CompressionType.NONE, enable_crcs=False)
    assert text in plain
    recording.write_bytes(plain.replace(text, b"= nonsense".ljust(len(text) - 1) + b"\n"))
    ran = command("info", recording)
    assert (ran.code, ran.err) == (0, "")
    assert ran.out.count("the usual one is taken") == 1
    assert "warning: run.mcap: /a/map: type nav_msgs/msg/OccupancyGrid: its definition cannot be used" in ran.out


def test_a_definition_that_is_not_that_of_its_name(tmp_path: Path) -> None:
    recording = tmp_path / "run.mcap"
    plain = mcap_bytes(mission(), compression=CompressionType.NONE, enable_crcs=False)
    assert b"float32 resolution\n" in plain
    recording.write_bytes(plain.replace(b"float32 resolution\n", b"float32 resolutiom\n"))
    ran = command("info", recording)
    assert (ran.code, ran.err) == (3, "")
    for topic in ("/a/map", "/b/map"):
        assert f"lost: run.mcap: malformed message at {topic}, 3 messages (its fields are not those" in ran.out
