from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer

from mapfusion.errors import LogReadError
from mapfusion_io.decode import Decoder
from mapfusion_io.sniff import open_one
from tests.ending import ends
from tests.io.making import HUMBLE, delivered, mission_messages, write_rosbag2

GRID = "nav_msgs/msg/OccupancyGrid"
MESSAGES = mission_messages(40)


@pytest.mark.parametrize("storage", list(StoragePlugin))
def test_rosbag2_round_trip(tmp_path: Path, storage: StoragePlugin) -> None:
    write_rosbag2(tmp_path / "run", MESSAGES, storage)
    recording = open_one(tmp_path / "run")
    assert delivered(recording) == MESSAGES
    assert recording.losses == ()
    raw = next(iter(recording.messages(lambda channel: channel.topic == "/robot1/map")))
    assert raw.channel.schema_encoding == "ros2msg"
    assert Decoder().decode(raw).header.frame_id == "map"


def test_messages_compressed_one_by_one(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    writer = Rosbag2Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3)
    writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/robot1/map", GRID, typestore=HUMBLE)
        for sent in MESSAGES[1:4]:
            writer.write(connection, sent.log_time_ns, sent.data)
    assert [data for *_, data in delivered(open_one(folder))] == [sent.data for sent in MESSAGES[1:4]]
    with sqlite3.connect(folder / "run.db3") as connection_db:
        connection_db.execute("UPDATE messages SET data = x'00' WHERE id = 1")
    connection_db.close()
    recording = open_one(folder)
    assert len(delivered(recording)) == 2
    assert [(loss.kind, loss.topic, loss.count) for loss in recording.losses] == [("damaged message", "/robot1/map", 1)]


def test_folder_compressed_as_a_whole_says_what_to_do(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    writer = Rosbag2Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3)
    writer.set_compression(CompressionMode.FILE, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/robot1/map", GRID, typestore=HUMBLE)
        writer.write(connection, 1, MESSAGES[1].data)
    with pytest.raises(LogReadError, match="zstd -d"):
        open_one(folder)


def test_folder_of_several_files_in_their_order(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    parts = {"run_2.mcap": MESSAGES[:10], "run_10.mcap": MESSAGES[10:]}
    for name, messages in parts.items():
        write_rosbag2(tmp_path / name[:-5], messages, StoragePlugin.MCAP)
        (tmp_path / name[:-5] / name).rename(folder / name)
    assert delivered(open_one(folder)) == MESSAGES
    names = ["run_2.mcap", "../run_11.mcap", "run_10.mcap", "run_2.mcap"]  # one outside, one named twice
    metadata = "rosbag2_bagfile_information:\n  version: 9\n  relative_file_paths:\n    - " + "\n    - ".join(names)
    (folder / "metadata.yaml").write_text(metadata)
    recording = open_one(folder)
    assert delivered(recording) == MESSAGES
    assert [(loss.kind, loss.where) for loss in recording.losses] == [("missing file", "run_11.mcap")]
    (folder / "metadata.yaml").write_text("][")
    assert delivered(open_one(folder)) == MESSAGES


def test_unreadable_file_of_a_folder_is_a_loss(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    write_rosbag2(folder, MESSAGES, StoragePlugin.SQLITE3)
    (folder / "metadata.yaml").unlink()
    (folder / "run_0.db3").write_bytes((folder / "run.db3").read_bytes()[:3000])
    recording = open_one(folder)
    assert delivered(recording) == MESSAGES
    assert [(loss.kind, loss.where) for loss in recording.losses] == [("unreadable file", "run_0.db3")]


@pytest.mark.parametrize(
    "hostile",
    [
        "  junk:\n" + "    - a: [1, 2, {b: c}]\n" * 400_000,
        "  a: &a [x, x]\n" + "".join(f"  a{i}: &a{i} [{', '.join(['*a'] * 9)}]\n" for i in range(9)),
        "  compression_mode: *a8\n",
        "  compression_mode: &a [x, x]\n",
        "  junk: " + "[" * 100_000 + "\n",
    ],
    ids=["long", "aliases", "alias in use", "list in use", "deep"],
)
def test_metadata_cannot_take_the_time(hostile: str, tmp_path: Path) -> None:
    write_rosbag2(tmp_path / "run", MESSAGES, StoragePlugin.MCAP)
    path = tmp_path / "run" / "metadata.yaml"
    path.write_text(path.read_text() + hostile)
    with ends(2.0):
        recording = open_one(tmp_path / "run")
    assert delivered(recording) == MESSAGES
