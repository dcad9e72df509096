from __future__ import annotations

import random
import sqlite3
from collections import Counter
from pathlib import Path

import pytest
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import StoragePlugin

from mapfusion.errors import LogReadError
from mapfusion_io.decode import Decoder
from mapfusion_io.read_limits import ReadLimits
from mapfusion_io.rosbag1_reader import Rosbag1Recording
from mapfusion_io.rosbag_reader import Sqlite3Recording
from mapfusion_io.sniff import open_one
from tests.ending import ends
from tests.io.making import (
    SHARED,
    Sent,
    delivered,
    mission_messages,
    ros1_grid,
    small_cells,
    write_rosbag1,
    write_rosbag2,
)

MESSAGES = mission_messages(40)
GRID = "nav_msgs/msg/OccupancyGrid"
ROS1_MESSAGES = [Sent(f"/robot{k % 2}/map", GRID, 10**9 + k, ros1_grid(small_cells(k))) for k in range(20)]


def database(tmp_path: Path) -> Path:
    write_rosbag2(tmp_path / "run", MESSAGES, StoragePlugin.SQLITE3)
    return tmp_path / "run" / "run.db3"


@pytest.mark.parametrize("compression", [None, *Rosbag1Writer.CompressionFormat])
def test_bag_round_trip(tmp_path: Path, compression: Rosbag1Writer.CompressionFormat | None) -> None:
    path = tmp_path / "run.bag"
    write_rosbag1(path, ROS1_MESSAGES, compression)
    recording = Rosbag1Recording(path)
    assert delivered(recording) == ROS1_MESSAGES
    assert recording.losses == ()
    assert not recording.integrity_verifiable
    assert list(recording.attachments()) == []
    assert list(recording.metadata()) == []
    raw = next(iter(recording.messages(lambda channel: True)))
    assert (raw.channel.schema_encoding, raw.channel.message_encoding) == ("ros1msg", "ros1")
    assert Decoder().decode(raw).header.frame_id == "/map"


def test_keep_and_identity_of_channels(tmp_path: Path) -> None:
    path = tmp_path / "run.bag"
    write_rosbag1(path, ROS1_MESSAGES)
    recording = Rosbag1Recording(path)
    first = {raw.channel for raw in recording.messages(lambda channel: channel.topic == "/robot1/map")}
    second = {raw.channel for raw in recording.messages(lambda channel: channel.topic == "/robot1/map")}
    assert first == second
    assert len(first) == 1
    assert list(recording.messages(lambda channel: False)) == []


def test_decompressed_chunks_of_a_bag_are_bounded(tmp_path: Path) -> None:
    path = tmp_path / "run.bag"
    sent = Sent("/map", GRID, 5, ros1_grid(small_cells(0, (400, 500))))
    write_rosbag1(path, [sent], Rosbag1Writer.CompressionFormat.BZ2)
    recording = Rosbag1Recording(path, ReadLimits(record_bytes=10_000))
    assert delivered(recording) == []
    (loss,) = recording.losses
    assert (loss.topic, loss.count) == ("/map", 1)
    assert "the limit is 10000" in loss.detail


def test_damaged_bags_end_in_an_error_or_with_losses(tmp_path: Path) -> None:
    path = tmp_path / "run.bag"
    write_rosbag1(path, ROS1_MESSAGES, Rosbag1Writer.CompressionFormat.LZ4)
    content = path.read_bytes()
    rng = random.Random(3)
    outcomes: Counter[str] = Counter()
    for index in range(150):
        damaged = bytearray(content)
        if index % 2:
            damaged = damaged[: rng.randrange(13, len(content))]
        else:
            damaged[rng.randrange(13, len(content))] ^= 1 << rng.randrange(8)
        path.write_bytes(damaged)
        recording = open_one(path)
        try:
            with ends(5.0):
                found = delivered(recording)
        except LogReadError as error:
            outcomes["error"] += len(str(error).splitlines()) == 2
        else:
            outcomes["read" if len(found) == len(ROS1_MESSAGES) else "losses"] += 1
            assert recording.losses or len(found) >= len(ROS1_MESSAGES) - 1
    assert outcomes.total() == 150
    assert min(outcomes["error"], outcomes["read"]) > 10


def test_a_bag_without_its_end_gives_all_messages_before(tmp_path: Path) -> None:
    path = tmp_path / "run.bag"
    write_rosbag1(path, ROS1_MESSAGES, chunk_bytes=500)
    content = path.read_bytes()
    num_found = []
    for cut in range(7500, len(content), 31):  # behind the first connection
        path.write_bytes(content[:cut])
        recording = open_one(path)
        found = delivered(recording)
        assert found == ROS1_MESSAGES[: len(found)]
        assert [loss.kind for loss in recording.losses] == ["truncated"] or len(found) == 20
        num_found.append(len(found))
    assert num_found == sorted(num_found)
    assert num_found[-1] == 20
    assert len(set(num_found)) >= 15  # also within chunks


def test_a_bag_that_was_never_closed(tmp_path: Path) -> None:
    path = tmp_path / "run.bag.active"
    write_rosbag1(path, ROS1_MESSAGES, chunk_bytes=500)
    content = bytearray(path.read_bytes())
    start = content.index(b"index_pos=") + len(b"index_pos=")
    index_offset = int.from_bytes(content[start : start + 8], "little")
    content[start : start + 8] = bytes(8)
    path.write_bytes(content[:index_offset])
    recording = open_one(path)
    assert delivered(recording) == ROS1_MESSAGES
    assert [(loss.kind, loss.count) for loss in recording.losses] == [("truncated", None)]


def test_a_damaged_chunk_of_a_bag_is_lost_by_topic_and_the_others_are_read(tmp_path: Path) -> None:
    path = tmp_path / "run.bag"
    write_rosbag1(path, ROS1_MESSAGES, Rosbag1Writer.CompressionFormat.BZ2, chunk_bytes=500)
    content = bytearray(path.read_bytes())
    content[content.index(b"BZh", content.index(b"BZh") + 1) + 40] ^= 1
    path.write_bytes(content)
    recording = Rosbag1Recording(path)
    found = delivered(recording)
    lost = Counter(message.topic for message in ROS1_MESSAGES if message not in found)
    assert 0 < lost.total() < 10
    assert Counter({loss.topic: loss.count or 0 for loss in recording.losses}) == lost
    assert {loss.kind for loss in recording.losses} == {"damaged chunk"}


def test_a_damaged_length_in_a_bag_is_overcome_at_the_next_indexed_chunk(tmp_path: Path) -> None:
    path = tmp_path / "run.bag"
    write_rosbag1(path, ROS1_MESSAGES, chunk_bytes=500)
    content = bytearray(path.read_bytes())
    content[4109 + 3] ^= 0x40  # the highest byte of the first chunk's length
    path.write_bytes(content)
    recording = Rosbag1Recording(path)
    found = delivered(recording)
    assert found == ROS1_MESSAGES[-len(found) :]
    assert [loss.kind for loss in recording.losses] == ["damaged record", "missing messages"]
    assert len(found) + sum(loss.count or 0 for loss in recording.losses) == 20


def test_database_of_an_old_release_has_no_definitions(tmp_path: Path) -> None:
    path = database(tmp_path)
    connection = sqlite3.connect(path)
    connection.executescript("DROP TABLE schema; DROP TABLE message_definitions; DROP TABLE metadata;")
    connection.close()
    recording = Sqlite3Recording(path)
    assert delivered(recording) == MESSAGES
    raw = next(iter(recording.messages(lambda channel: channel.topic == "/robot1/map")))
    assert (raw.channel.schema_encoding, raw.channel.schema_data) == ("", b"")
    assert Decoder().decode(raw).info.width == 15


def test_rows_that_are_no_messages(tmp_path: Path) -> None:
    path = database(tmp_path)
    connection = sqlite3.connect(path)
    connection.execute("UPDATE messages SET data = 'text' WHERE id = 1")
    connection.execute("UPDATE messages SET topic_id = 99 WHERE id = 2")
    connection.commit()
    connection.close()
    recording = Sqlite3Recording(path)
    assert delivered(recording) == MESSAGES[2:]
    assert [(loss.kind, loss.topic, loss.count) for loss in recording.losses] == [
        ("definition lost", "", 1),
        ("missing messages", "/tf", 1),
    ]


def test_messages_over_the_limit_are_named(tmp_path: Path) -> None:
    recording = Sqlite3Recording(database(tmp_path), ReadLimits(record_bytes=200))
    found = delivered(recording)
    assert found == [item for item in MESSAGES if len(item.data) <= 200]
    assert 0 < len(found) < len(MESSAGES)
    assert {(loss.kind, loss.count) for loss in recording.losses} == {("over limit", 1)}
    assert len(found) + len(recording.losses) == len(MESSAGES)


def test_settings_that_would_take_minutes_to_parse_are_refused(tmp_path: Path) -> None:
    path = database(tmp_path)
    connection = sqlite3.connect(path)
    connection.execute("UPDATE topics SET offered_qos_profiles = ?", ["- {a: b}\n" * 500_000])
    connection.commit()
    connection.close()
    with ends(1.0), pytest.raises(LogReadError, match="QoS profiles"):
        delivered(Sqlite3Recording(path))


def test_more_topics_and_definitions_than_the_library_can_take_are_refused(tmp_path: Path) -> None:
    path = database(tmp_path)
    connection = sqlite3.connect(path)
    rows = [(f"a/msg/T{number}", "ros2msg", "int8 x", "") for number in range(5000)]
    connection.executemany(
        "INSERT INTO message_definitions (topic_type, encoding, encoded_message_definition, type_description_hash) "
        "VALUES (?, ?, ?, ?)",
        rows,
    )
    connection.executemany(
        "INSERT INTO topics (name, type, serialization_format, offered_qos_profiles, type_description_hash) "
        "VALUES ('/t', ?, 'cdr', '', '')",
        [row[:1] for row in rows],
    )
    connection.commit()
    connection.close()
    with pytest.raises(LogReadError, match="too many topics"):
        delivered(Sqlite3Recording(path))


def test_journal_that_was_never_merged_is_named(tmp_path: Path) -> None:
    path = database(tmp_path)
    path.with_name("run.db3-wal").write_bytes(b"x")
    recording = Sqlite3Recording(path)
    delivered(recording)
    assert [loss.kind for loss in recording.losses] == ["unmerged journal"]


def test_damaged_databases_end_in_an_error_or_with_losses(tmp_path: Path) -> None:
    path = database(tmp_path)
    content = path.read_bytes()
    rng = random.Random(4)
    outcomes: Counter[str] = Counter()
    for index in range(80):
        damaged = bytearray(content)
        if index % 2:
            damaged = damaged[: rng.randrange(20, len(content))]
        else:
            for _ in range(20):
                damaged[rng.randrange(20, len(content))] ^= 0xFF
        path.write_bytes(damaged)
        try:
            delivered(Sqlite3Recording(path))
        except LogReadError as error:
            outcomes["error"] += len(str(error).splitlines()) == 2
        else:
            outcomes["read"] += 1
    assert outcomes["error"] > 10
    assert outcomes.total() == 80


RECORDINGS = {
    "missions/two_robots.mcap": ("mcap", {"/tf": 520, "/robot1/map": 22, "/robot2/map": 22}),
    "missions/three_robots.bag": ("rosbag1", {"/tf": 660, "/robot1/map": 19, "/robot2/map": 19, "/robot3/map": 19}),
    "recordings/isr_small/1.bag": ("rosbag1", {"/tf": 6076, "/map": 23}),
    "recordings/rosbag2/test_bag_for_seek_sqlite3": ("rosbag2-sqlite3", {"topic1": 5}),
    "recordings/rosbag2/test_bag_for_seek_mcap": ("rosbag2-mcap", {"topic1": 5}),
    "missions/updates_odom": (
        "rosbag2-sqlite3",
        {
            "/robot1/odom": 220,
            "/robot2/odom": 220,
            "/robot1/map": 15,
            "/robot2/map": 12,
            "/robot1/map_updates": 4,
            "/robot2/map_updates": 7,
        },
    ),
}


@pytest.mark.parametrize("name", RECORDINGS)
def test_recordings_of_others(name: str) -> None:
    path = SHARED / name
    if not path.exists():
        pytest.skip("no such recording beside the repository")
    recording, decoder = open_one(path), Decoder()
    topics: Counter[str] = Counter()
    for raw in recording.messages(lambda channel: True):
        topics[raw.channel.topic] += 1
        if raw.channel.topic != "topic1":
            decoder.decode(raw)
    assert (recording.container, topics) == RECORDINGS[name]
    assert recording.losses == ()
