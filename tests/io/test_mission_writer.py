from __future__ import annotations

import json
import sys
from collections import Counter
from functools import cache
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from mapfusion.errors import ConfigError, LogWriteError
from mapfusion.grid import OccupancyGrid, apply_update
from mapfusion.simulation.lidar import LidarConfig
from mapfusion.simulation.messages import Mission
from mapfusion.simulation.mission import simulate_mission
from mapfusion.simulation.mission_config import MissionConfig
from mapfusion.transform import SE2, yaw_from_quaternion
from mapfusion_io.mission_writer import MissionCompression, PoseSource, truth_path, write_mission

SAMPLES = Path(__file__).resolve().parents[2] / "data" / "samples"
LIDAR = LidarConfig(num_beams=180, max_range_m=6.0)


@cache
def mission(updates: bool = False, odometry_noise: float = 0.02) -> Mission:
    return simulate_mission(
        MissionConfig(
            seed=2,
            num_robots=2,
            duration_s=6.0,
            map_period_s=2.0,
            pose_period_s=0.5,
            updates=updates,
            odometry_noise=odometry_noise,
            lidar=LIDAR,
        )
    )


def read(path: Path) -> list[tuple[str, int, Any]]:
    """Every message as topic, log time and content, with rosbags."""
    with AnyReader([path]) as reader:
        return [(c.topic, stamp, reader.deserialize(data, c.msgtype)) for c, stamp, data in reader.messages()]


def se2(translation: Any, rotation: Any) -> SE2:
    return SE2(translation.x, translation.y, yaw_from_quaternion(rotation.x, rotation.y, rotation.z, rotation.w))


def poses_of(messages: list[tuple[str, int, Any]], robot: str) -> list[tuple[int, SE2]]:
    """`T_map_base` by log time, whatever way it is told."""
    edges: dict[tuple[str, str], SE2] = {}
    found = []
    for topic, stamp, message in messages:
        if topic in ("/tf", "/tf_static"):
            for t in message.transforms:
                edges[t.header.frame_id, t.child_frame_id] = se2(t.transform.translation, t.transform.rotation)
                if t.child_frame_id == f"{robot}/base_link":
                    found.append(
                        (stamp, edges[f"{robot}/map", f"{robot}/odom"] @ edges[t.header.frame_id, t.child_frame_id])
                    )
        elif topic == f"/{robot}/odom":
            pose = se2(message.pose.pose.position, message.pose.pose.orientation)
            assert (message.header.frame_id, message.child_frame_id) == (f"{robot}/odom", f"{robot}/base_link")
            found.append((stamp, edges[f"{robot}/map", f"{robot}/odom"] @ pose))
        elif topic == f"/{robot}/pose":
            assert message.header.frame_id == f"{robot}/map"
            found.append((stamp, se2(message.pose.position, message.pose.orientation)))
    return found


def last_maps(messages: list[tuple[str, int, Any]]) -> dict[str, OccupancyGrid]:
    maps: dict[str, OccupancyGrid] = {}
    for topic, stamp, m in messages:
        robot = topic.split("/")[1]
        if topic.endswith("/map"):
            origin = se2(m.info.origin.position, m.info.origin.orientation)
            cells = m.data.reshape(m.info.height, m.info.width)
            maps[robot] = OccupancyGrid(cells, float(m.info.resolution), origin, m.header.frame_id, stamp)
        elif topic.endswith("/map_updates"):
            maps[robot] = apply_update(maps[robot], m.x, m.y, m.data.reshape(m.height, m.width), stamp)
    return maps


@pytest.mark.parametrize("name", ["out.mcap", "out.bag"])
@pytest.mark.parametrize("poses", ["tf", "odom", "pose"])
def test_recording_agrees_with_its_truth(tmp_path: Path, name: str, poses: PoseSource) -> None:
    written = write_mission(mission(updates=True), tmp_path / name, poses=poses)
    assert written.truth == tmp_path / "out.truth.json"
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([name, "out.truth.json"])
    truth = json.loads(written.truth.read_text())
    messages = read(written.recording)
    stamps = [stamp for _, stamp, _ in messages]
    assert stamps == sorted(stamps)
    counts = Counter(topic.split("/")[-1] for topic, _, _ in messages)
    assert (counts["map"], counts["map_updates"]) == (written.num_maps, written.num_updates)
    assert written.num_updates > 0
    for robot, grid in last_maps(messages).items():
        expected = truth["robots"][robot]
        assert grid.frame_id == expected["map_frame"]
        T_world_map = SE2(*expected["T_world_map"])
        walls = np.unique(np.floor(T_world_map.apply(grid.centres_m(grid.walls)) * 10.0).astype(int), axis=0)
        listed = {tuple(cell) for cell in expected["walls_dm"]}
        # Resolutions travel as 32-bit floats, so single cells at a border may differ.
        assert len(listed ^ {tuple(cell) for cell in walls.tolist()}) <= 0.01 * len(listed)
        found = poses_of(messages, robot)
        assert len(found) == len(expected["path"]) == 13
        for (stamp, T_map_base), (time_s, x_m, y_m, yaw_rad) in zip(found, expected["path"], strict=True):
            assert stamp / 1e9 == pytest.approx(time_s, abs=1e-6)
            assert max((T_world_map @ T_map_base).distance_to(SE2(x_m, y_m, yaw_rad))) < 2e-4


@pytest.mark.parametrize(("poses", "topics"), [("tf", {"/tf", "/tf_static"}), ("odom", {"/tf_static"})])
def test_odometry_that_does_not_drift_is_static(tmp_path: Path, poses: PoseSource, topics: set[str]) -> None:
    out = write_mission(mission(odometry_noise=0.0), tmp_path / "a.mcap", poses=poses).recording
    messages = read(out)
    assert {topic for topic, _, _ in messages if topic.startswith("/tf")} == topics
    assert [topic for topic, _, _ in messages].count("/tf_static") == 1
    assert messages[0][0] == "/tf_static"
    assert len(poses_of(messages, "robot2")) == 13


def test_mcap_is_what_ros_2_records(tmp_path: Path) -> None:
    out = write_mission(mission(updates=True), tmp_path / "a.mcap", poses="odom").recording
    with out.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == sum(1 for _ in reader.iter_messages())
        for channel in summary.channels.values():
            schema = summary.schemas[channel.schema_id]
            assert (channel.message_encoding, schema.encoding) == ("cdr", "ros2msg")
            assert channel.metadata["topic_type_hash"].startswith("RIHS01_")
            durability = "durability: 1" if channel.topic.endswith("/map") else "durability: 2"
            assert durability in channel.metadata["offered_qos_profiles"]


@pytest.mark.parametrize(
    ("name", "compression"),
    [("a.mcap", "zstd"), ("a.mcap", "lz4"), ("a.mcap", "none"), ("a.bag", "none"), ("a.bag", "lz4"), ("a.bag", "bz2")],
)
def test_same_mission_same_bytes(tmp_path: Path, name: str, compression: MissionCompression) -> None:
    contents = []
    for folder in ("first", "second"):
        (tmp_path / folder).mkdir()
        written = write_mission(mission(), tmp_path / folder / name, compression=compression)
        contents.append((written.recording.read_bytes(), written.truth.read_bytes()))
    assert contents[0] == contents[1]
    assert len(read(tmp_path / "first" / name)) == 2 * 13 + written.num_maps


def test_maps_of_a_bag_are_latched(tmp_path: Path) -> None:
    out = write_mission(mission(), tmp_path / "a.bag").recording
    with AnyReader([out]) as reader:
        latching = {c.topic: c.ext.latching for c in reader.connections}  # type: ignore[union-attr]
    assert latching == {"/robot1/map": 1, "/robot2/map": 1, "/tf": 0}


@pytest.mark.parametrize("format", ["mcap", "bag"])
def test_format_can_be_given(tmp_path: Path, format: Literal["mcap", "bag"]) -> None:  # noqa: A002
    out = write_mission(mission(), tmp_path / "recording", format=format).recording
    assert out.read_bytes()[:7] == (b"\x89MCAP0\r" if format == "mcap" else b"#ROSBAG")
    assert truth_path(out) == tmp_path / "recording.truth.json"


def test_what_stands_there_is_kept(tmp_path: Path) -> None:
    out = tmp_path / "a.mcap"
    for taken in (out, truth_path(out)):
        taken.write_bytes(b"mine")
        with pytest.raises(LogWriteError, match=f"{taken.name}: already exists"):
            write_mission(mission(), out)
        assert taken.read_bytes() == b"mine"
        assert list(tmp_path.iterdir()) == [taken]
        taken.unlink()
    out.write_bytes(b"old")
    write_mission(mission(), out, force=True)
    assert out.read_bytes()[:5] == b"\x89MCAP"


@pytest.mark.parametrize(
    ("name", "compression", "message"),
    [
        ("a.db3", None, "suffix"),
        ("a.bag", "zstd", "zstd"),
        ("a.mcap", "bz2", "bz2"),
        ("no/a.bag", None, "does not exist"),
    ],
)
def test_outputs_that_cannot_be(
    tmp_path: Path, name: str, compression: MissionCompression | None, message: str
) -> None:
    with pytest.raises(LogWriteError if name == "no/a.bag" else ConfigError, match=message):
        write_mission(mission(), tmp_path / name, compression=compression)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["a.mcap", "a.bag"])
def test_nothing_is_left_of_a_mission_that_fails(tmp_path: Path, name: str) -> None:
    def broken() -> Any:
        yield from list(mission().messages())[:5]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_mission(Mission(mission().robots, False, broken), tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def make_samples() -> ModuleType:
    spec = spec_from_file_location("make_samples", SAMPLES / "make_samples.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules["make_samples"] = module
    spec.loader.exec_module(module)
    return module


def test_a_sample_can_be_made_anew(tmp_path: Path) -> None:
    """By content: compressors, and the last bit of a sine, may differ between machines."""
    made = make_samples().make_sample("two_robots.bag", tmp_path)
    assert json.loads(made.truth.read_text())["final_overlap"] == pytest.approx(
        json.loads((SAMPLES / "two_robots.truth.json").read_text())["final_overlap"], abs=0.005
    )
    new, committed = read(made.recording), read(SAMPLES / "two_robots.bag")
    assert [message[:2] for message in new] == [message[:2] for message in committed]
    for robot in ("robot1", "robot2"):
        for (_, pose), (_, expected) in zip(poses_of(new, robot), poses_of(committed, robot), strict=True):
            assert max(pose.distance_to(expected)) < 1e-6
        grid, expected_grid = last_maps(new)[robot], last_maps(committed)[robot]
        assert grid.T_frame_grid.distance_to(expected_grid.T_frame_grid)[0] < 1e-6
        assert np.mean(grid.cells != expected_grid.cells) < 1e-3


def test_samples_are_small_and_of_their_seeds() -> None:
    assert sum(path.stat().st_size for path in SAMPLES.iterdir() if path.is_file()) < 2e6
    samples = make_samples().SAMPLES
    assert {path.name for path in SAMPLES.glob("*.mcap")} | {path.name for path in SAMPLES.glob("*.bag")} == set(
        samples
    )
    for name, sample in samples.items():
        truth = json.loads(truth_path(SAMPLES / name).read_text())
        assert len(truth["robots"]) == sample.config.num_robots
        assert all(0.4 <= overlap <= 0.7 for overlap in truth["final_overlap"].values())
