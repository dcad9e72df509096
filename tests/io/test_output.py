"""What stands in a mission's file, read by other readers, and when there is no file."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import Statistics
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from mapfusion.errors import LogWriteError
from mapfusion.steps import FusionStep, Placement
from mapfusion.transform import SE2
from mapfusion_io.output import MissionWriter
from mapfusion_io.topic_writer import Compression
from tests.io.fake_steps import (
    MAP_FRAMES,
    START_NS,
    T_WORLD_2,
    make_acceptance,
    make_grid,
    make_pair,
    make_path,
    make_refusal,
    make_steps,
)

SUMMARY = {"version": "x", "nearest_miss": math.nan}
METADATA = {"version": "x", "inputs": "[]"}


def write_mission(path: Path, steps: Iterable[FusionStep], **options: Any) -> None:
    with MissionWriter(path, **options) as out:
        for step in steps:
            out.write(step)
        out.finish(SUMMARY, METADATA)


@dataclass(frozen=True)
class Content:
    """A file as the mcap package and mcap-ros2-support read it; grids by rosbags."""

    profile: str
    statistics: Statistics
    channels: dict[str, dict[str, str]]
    messages: dict[str, list[tuple[int, Any]]]
    attachments: dict[str, bytes]
    metadata: dict[str, dict[str, str]]


def read(path: Path) -> Content:
    factory = DecoderFactory()
    messages: dict[str, list[tuple[int, Any]]] = {}
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        for schema, channel, message in reader.iter_messages():
            decoder = factory.decoder_for(channel.message_encoding, schema)
            assert decoder is not None
            if not channel.topic.endswith("/map"):
                messages.setdefault(channel.topic, []).append((message.log_time, decoder(message.data)))
        content = Content(
            reader.get_header().profile,
            summary.statistics,
            {channel.topic: dict(channel.metadata) for channel in summary.channels.values()},
            messages,
            {attachment.name: attachment.data for attachment in reader.iter_attachments()},
            {record.name: record.metadata for record in reader.iter_metadata()},
        )
    with AnyReader([path]) as bag:
        for connection, log_time_ns, data in bag.messages():
            decoded = bag.deserialize(data, connection.msgtype)
            if connection.topic.endswith("/map"):
                messages.setdefault(connection.topic, []).append((log_time_ns, decoded))
    return content


def stamp_ns(message: Any) -> int:
    stamp = message.header.stamp
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


@pytest.fixture(scope="module")
def mission(tmp_path_factory: pytest.TempPathFactory) -> Content:
    path = tmp_path_factory.mktemp("mission") / "out.mcap"
    write_mission(path, make_steps())
    return read(path)


def test_topics_and_counts(mission: Content) -> None:
    assert {topic: len(messages) for topic, messages in mission.messages.items()} == {
        "/tf": 4,
        "/fused/map": 3,
        "/fused/robot1/pose": 4,
        "/fused/robot2/pose": 4,
        "/fused/robot1/path": 1,
        "/fused/robot2/path": 1,
        "/diagnostics": 3,
        "/fused/pairs/robot1/robot2": 3,
        "/fused/pairs/robot1/robot3": 3,
    }
    assert mission.profile == "ros2"
    assert mission.statistics.message_count == 26
    assert mission.statistics.chunk_count == 1
    assert (mission.statistics.attachment_count, mission.statistics.metadata_count) == (3, 1)


def test_every_channel_has_qos_and_hash(mission: Content) -> None:
    for topic, metadata in mission.channels.items():
        assert metadata["topic_type_hash"].startswith("RIHS01_")
        latched = topic.endswith(("/map", "/path"))
        assert f"durability: {1 if latched else 2}\n" in metadata["offered_qos_profiles"], topic


def test_rosbags_reads_the_qos(tmp_path: Path) -> None:
    write_mission(tmp_path / "out.mcap", make_steps())
    with AnyReader([tmp_path / "out.mcap"]) as bag:
        durability = {c.topic: c.ext.offered_qos_profiles[0].durability.name for c in bag.connections}  # type: ignore[union-attr]
    assert durability["/fused/map"] == "TRANSIENT_LOCAL"
    assert durability["/tf"] == "VOLATILE"


def test_transforms_stand_at_every_joined_snapshot_with_the_reference(mission: Content) -> None:
    assert [time for time, _ in mission.messages["/tf"]] == [START_NS + k * 10**9 for k in range(2, 6)]
    for time, message in mission.messages["/tf"]:
        first, second = message.transforms
        assert stamp_ns(first) == stamp_ns(second) == time
        assert (first.header.frame_id, first.child_frame_id) == ("world", "robot1/map")
        assert (first.transform.translation.x, first.transform.rotation.z) == (0.0, 0.0)
        assert (second.header.frame_id, second.child_frame_id) == ("world", "robot2/map")
        assert second.transform.translation.x == T_WORLD_2.x_m


def test_transforms_come_before_the_map_of_their_time(tmp_path: Path) -> None:
    write_mission(tmp_path / "out.mcap", make_steps())
    with (tmp_path / "out.mcap").open("rb") as file:
        order = [(m.log_time, c.topic) for _, c, m in make_reader(file).iter_messages(topics=["/tf", "/fused/map"])]
    for k, (time, topic) in enumerate(order):
        assert topic == "/tf" or order[k - 1] == (time, "/tf")


def test_maps_are_the_grids(mission: Content) -> None:
    times = [time for time, _ in mission.messages["/fused/map"]]
    assert times == [START_NS + k * 10**9 for k in (2, 4, 5)]
    for (_, message), k in zip(mission.messages["/fused/map"], (2, 4, 5), strict=True):
        grid = make_grid(40 + k, 30, seed=k)
        assert message.header.frame_id == "world"
        np.testing.assert_array_equal(message.data.reshape(30, 40 + k), grid.cells)


def test_poses_and_paths_stand_in_the_world(mission: Content) -> None:
    poses = mission.messages["/fused/robot2/pose"]
    assert [pose.pose.position.y for _, pose in poses] == pytest.approx([0.2, 0.3, 0.4, 0.5])
    assert {pose.header.frame_id for _, pose in poses} == {"world"}
    ((time, path),) = mission.messages["/fused/robot2/path"]
    assert time == START_NS + 5 * 10**9
    assert path.header.frame_id == "world"
    assert [pose.pose.position.x for pose in path.poses] == make_path(7).poses[:, 0].tolist()


@pytest.mark.parametrize("is_seen_before", [True, False])
def test_robots_that_join_after_their_last_pose_are_shown_where_it_was(tmp_path: Path, is_seen_before: bool) -> None:
    first, *_, last = make_steps()
    first = replace(first, placements=last.placements, poses=last.poses if is_seen_before else {})
    write_mission(tmp_path / "out.mcap", [first, replace(last, poses={})])
    path, poses = make_path(7), read(tmp_path / "out.mcap").messages["/fused/robot2/pose"]
    ((time, pose),) = poses
    if is_seen_before:
        assert (time, stamp_ns(pose)) == (START_NS, START_NS)
    else:
        assert (time, stamp_ns(pose)) == (last.stamp_ns, path.stamps_ns[-1])
        assert (pose.pose.position.x, pose.pose.position.y) == tuple(path.poses[-1, :2])
        assert pose.header.frame_id == "world"


def test_diagnostics_name_the_pairs_and_the_changes(mission: Content) -> None:
    first, _, third = (message for _, message in mission.messages["/diagnostics"])
    refused = first.status[0]
    assert (refused.name, refused.level) == ("mapfusion/robot1/robot2", 1)
    assert refused.message == "only 3 matches, 10 are needed"
    assert {pair.key: pair.value for pair in refused.values}["mae"] == ""
    joined, _, groups = third.status
    values = {pair.key: pair.value for pair in joined.values}
    assert (joined.name, joined.level, joined.message) == ("mapfusion/robot1/robot2", 0, "joined")
    assert (values["mae"], values["accepted"], values["evidence.wall_share"]) == ("12.25", "true", "0.75")
    assert (groups.name, groups.message) == ("mapfusion/groups", "robot1 and robot2 form group 1")
    assert [(pair.key, pair.value) for pair in groups.values] == [("group 1", "robot1, robot2")]


def test_pairs_stand_in_the_frame_of_the_first(mission: Content) -> None:
    messages = [message for _, message in mission.messages["/fused/pairs/robot1/robot2"]]
    assert {message.header.frame_id for message in messages} == {"robot1/map"}
    assert [message.accepted for message in messages] == [False, False, True]
    assert math.isnan(messages[0].mae)
    assert messages[2].yaw_deg == pytest.approx(math.degrees(T_WORLD_2.yaw_rad))


def test_attachments_are_of_the_last_map(mission: Content) -> None:
    assert sorted(mission.attachments) == ["map.pgm", "map.yaml", "summary.json"]
    assert mission.attachments["map.pgm"].split(maxsplit=3)[1:3] == [b"45", b"30"]
    assert b"origin: [-1.0, -2.0, 0.25]" in mission.attachments["map.yaml"]
    assert json.loads(mission.attachments["summary.json"]) == {"nearest_miss": None, "version": "x"}
    assert mission.metadata == {"mapfusion": METADATA}


def test_the_same_mission_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a.mcap", "b.mcap"):
        write_mission(tmp_path / name, make_steps())
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_compressions(tmp_path: Path, compression: Compression) -> None:
    write_mission(tmp_path / "out.mcap", make_steps(), compression=compression)
    with (tmp_path / "out.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert {index.compression for index in summary.chunk_indexes} == {"" if compression == "none" else compression}
    assert len(read(tmp_path / "out.mcap").messages["/fused/map"]) == 3


def test_all_bytes_before_the_summary_are_signed(tmp_path: Path) -> None:
    write_mission(tmp_path / "out.mcap", make_steps())
    data = (tmp_path / "out.mcap").read_bytes()
    (summary_start,) = struct.unpack_from("<Q", data, len(data) - 8 - 20)
    (data_crc,) = struct.unpack_from("<I", data, summary_start - 4)
    assert data_crc != 0


def test_nothing_joined_is_a_whole_file_too(tmp_path: Path) -> None:
    write_mission(tmp_path / "out.mcap", make_steps(2))
    content = read(tmp_path / "out.mcap")
    assert sorted(content.messages) == ["/diagnostics", "/fused/pairs/robot1/robot2", "/fused/pairs/robot1/robot3"]
    assert sorted(content.attachments) == ["summary.json"]
    assert content.metadata == {"mapfusion": METADATA}


def test_no_snapshot_is_a_whole_file_too(tmp_path: Path) -> None:
    write_mission(tmp_path / "out.mcap", [])
    assert read(tmp_path / "out.mcap").statistics.message_count == 0


def test_later_groups_have_their_own_frames_and_topics(tmp_path: Path) -> None:
    placements = {
        "robot1": Placement(1, SE2.identity()),
        "robot2": Placement(2, SE2.identity()),
        "robot3": Placement(2, SE2(1.0, 0.0, 0.0)),
    }
    poses = {robot: SE2(0.0, 0.0, 0.0) for robot in placements}
    paths = {"robot3": make_path(3)}
    step = FusionStep(
        START_NS, True, placements, poses, (), {1: make_grid(), 2: make_grid(20)}, paths=paths, map_frames=MAP_FRAMES
    )
    write_mission(tmp_path / "out.mcap", [step], world_frame="earth")
    content = read(tmp_path / "out.mcap")
    parents = {t.child_frame_id: t.header.frame_id for t in content.messages["/tf"][0][1].transforms}
    assert parents == {"robot1/map": "earth", "robot2/map": "earth_2", "robot3/map": "earth_2"}
    assert {topic for topic in content.messages if topic != "/tf"} == {
        "/fused/map",
        "/fused_2/map",
        "/fused/robot1/pose",
        "/fused_2/robot2/pose",
        "/fused_2/robot3/pose",
        "/fused_2/robot3/path",
    }
    ((log_time_ns, grid),) = content.messages["/fused_2/map"]
    assert (grid.header.frame_id, stamp_ns(grid), log_time_ns) == ("earth_2", START_NS, START_NS)
    assert content.attachments["map.pgm"].startswith(b"P5\n40 30\n")


def test_any_name_of_a_robot(tmp_path: Path) -> None:
    frames = {"1": "1/map", "fleet/a": "fleet/a/map", "Jäger": "Jäger/map", "map": "map"}
    placements = {robot: Placement(1, SE2.identity()) for robot in frames}
    pairs = (make_pair("1", "Jäger", make_acceptance()), make_pair("fleet/a", "map", make_refusal(), placed=True))
    step = FusionStep(
        START_NS, True, placements, {robot: SE2.identity() for robot in frames}, pairs, {}, map_frames=frames
    )
    write_mission(tmp_path / "out.mcap", [step])
    messages = read(tmp_path / "out.mcap").messages
    assert {f"/fused/{name}/pose" for name in ("r_1", "fleet_a", "J_ger", "map_2")} <= set(messages)
    assert {"/fused/pairs/r_1/J_ger", "/fused/pairs/fleet_a/map_2"} <= set(messages)
    assert [t.child_frame_id for t in messages["/tf"][0][1].transforms] == list(frames.values())
    first, second = messages["/diagnostics"][0][1].status
    assert (first.name, second.name) == ("mapfusion/1/Jäger", "mapfusion/fleet/a/map")
    assert (second.level, second.message) == (0, "joined, though not by this look: only 3 matches, 10 are needed")


def test_a_long_path(tmp_path: Path) -> None:
    step = FusionStep(
        START_NS,
        True,
        {"robot1": Placement(1, SE2.identity())},
        {},
        (),
        {},
        paths={"robot1": make_path(100_000)},
        map_frames=MAP_FRAMES,
    )
    write_mission(tmp_path / "out.mcap", [step])
    with AnyReader([tmp_path / "out.mcap"]) as bag:
        ((_, _, data),) = bag.messages([c for c in bag.connections if c.topic == "/fused/robot1/path"])
    assert struct.unpack_from("<I", data, 4 + 8 + 4 + 6 + 2) == (100_000,)


def test_without_finish_there_is_no_file(tmp_path: Path) -> None:
    with MissionWriter(tmp_path / "out.mcap") as out:
        out.write(make_steps()[0])
    assert list(tmp_path.iterdir()) == []


def write_and_raise(path: Path, error: type[BaseException]) -> None:
    with MissionWriter(path) as out:
        out.finish(SUMMARY, METADATA)
        raise error


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_an_error_after_finish_leaves_no_file_either(tmp_path: Path, error: type[BaseException]) -> None:
    with pytest.raises(error):
        write_and_raise(tmp_path / "out.mcap", error)
    assert list(tmp_path.iterdir()) == []


def test_a_snapshot_beyond_what_ros_can_say(tmp_path: Path) -> None:
    for stamp_ns in (-1, 2**31 * 10**9):
        with pytest.raises(LogWriteError, match="2038"):
            write_mission(tmp_path / "out.mcap", [FusionStep(stamp_ns, True, {}, {}, (), {})])
    assert list(tmp_path.iterdir()) == []


class FailingFile:
    """A stream whose write number `num_good` and all further ones fail."""

    def __init__(self, file: Any, num_good: int) -> None:
        self._file, self._num_left = file, num_good

    def write(self, data: bytes) -> int:
        if self._num_left == 0:
            raise OSError(28, "No space left on device")
        self._num_left -= 1
        return int(self._file.write(data))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


def test_a_disk_that_gets_full_at_any_write_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "out.mcap"
    path.write_bytes(b"old")
    steps, opened = make_steps(3), Path.open
    for num_good in range(10_000):

        def limited(at: Path, mode: str = "r", num_good: int = num_good, **options: Any) -> Any:
            file = opened(at, mode, **options)
            return FailingFile(file, num_good) if mode == "xb" else file

        with monkeypatch.context() as patch:
            patch.setattr(Path, "open", limited)
            try:
                write_mission(path, steps, force=True)
            except LogWriteError as error:
                words = str(error)
            else:
                break
        assert words == f"{path}: cannot be written: No space left on device"
        assert list(tmp_path.iterdir()) == [path]
        assert path.read_bytes() == b"old"
    assert num_good > 10
    assert path.read_bytes() != b"old"
