from __future__ import annotations

from pathlib import Path

import pytest
from rosbags.rosbag2 import StoragePlugin

from mapfusion.errors import LogReadError
from mapfusion_io.sniff import open_one
from tests.io.making import (
    Sent,
    delivered,
    mcap_bytes,
    mission_messages,
    ros1_grid,
    small_cells,
    write_rosbag1,
    write_rosbag2,
)


def error_of(path: Path) -> str:
    with pytest.raises(LogReadError) as raised:
        open_one(path)
    text = str(raised.value)
    assert len(text.splitlines()) <= 2
    assert all(line.isprintable() for line in text.splitlines())
    return text


@pytest.mark.parametrize("name", ["run.mcap", "run", "run.bin", "run.bag", "50%.x?y#z"])
def test_container_is_told_by_its_first_bytes(tmp_path: Path, name: str) -> None:
    messages = mission_messages(8)
    (tmp_path / name).write_bytes(mcap_bytes(messages))
    recording = open_one(tmp_path / name)
    assert recording.container == "mcap"
    assert delivered(recording) == messages


@pytest.mark.parametrize("name", ["run.db3", "run.mcap", "50%20.x?y#z"])
def test_bare_database_under_any_name(tmp_path: Path, name: str) -> None:
    messages = mission_messages(8)
    write_rosbag2(tmp_path / "run", messages, StoragePlugin.SQLITE3)
    (tmp_path / "run" / "run.db3").rename(tmp_path / name)
    recording = open_one(tmp_path / name)
    assert recording.container == "rosbag2-sqlite3"
    assert delivered(recording) == messages


def test_bag_under_another_name(tmp_path: Path) -> None:
    path = tmp_path / "run.bag"
    write_rosbag1(path, [Sent("/map", "nav_msgs/msg/OccupancyGrid", 5, ros1_grid(small_cells()))])
    other = path.rename(tmp_path / "run.mcap")
    assert open_one(other).container == "rosbag1"


@pytest.mark.parametrize("storage", list(StoragePlugin))
def test_folder_with_and_without_metadata(tmp_path: Path, storage: StoragePlugin) -> None:
    messages = mission_messages(8)
    folder = tmp_path / "run"
    write_rosbag2(folder, messages, storage)
    container = {StoragePlugin.MCAP: "rosbag2-mcap", StoragePlugin.SQLITE3: "rosbag2-sqlite3"}[storage]
    assert open_one(folder).container == container
    assert delivered(open_one(folder)) == messages
    (folder / "metadata.yaml").unlink()
    assert open_one(folder).container == container
    assert delivered(open_one(folder)) == messages


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.mcap", b"", "is empty"),
        ("a.mcap", b"hello, this is text", "first bytes are wrong"),
        ("notes.txt", b"hello, this is text", "not a recording"),
        ("a.mcap.zst", b"\x28\xb5\x2f\xfd....", "zstd -d"),
        ("a.bag.gz", b"\x1f\x8b\x08....", "gunzip"),
        ("a.bag", b"#ROSBAG V1.2\n....", "old version"),
        ("line\nbreak\x1b[31m.txt", b"text", r"line\nbreak\x1b[31m.txt"),
    ],
)
def test_what_is_no_recording(tmp_path: Path, name: str, content: bytes, words: str) -> None:
    (tmp_path / name).write_bytes(content)
    text = error_of(tmp_path / name)
    assert words in text
    assert str(tmp_path) in text


def test_missing_file_and_folder_without_recording(tmp_path: Path) -> None:
    assert "does not exist" in error_of(tmp_path / "a.mcap")
    assert "without a recording" in error_of(tmp_path)
    assert "is no path" in error_of(Path("nul\0.mcap")) or "does not exist" in error_of(Path("nul\0.mcap"))


def test_path_through_a_file(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"x")
    error_of(tmp_path / "a.mcap" / "b.mcap")
