"""Damaged recordings through the reader: all there, salvaged with a word, or one clean error."""

from itertools import islice
from pathlib import Path
from typing import Any

import pytest
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import StoragePlugin

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
from tests.reliability.sweeping import Outcomes, cuts, flips, smears, sweep

MISSION = mission_messages(12)
RECORDING = mcap_bytes(MISSION, chunk_size=1000)


def check(outcomes: Outcomes, *expected: str) -> None:
    assert not outcomes.failures, f"{outcomes}: {outcomes.failures[:3]}"
    assert set(expected) <= set(outcomes.counted), outcomes


def test_a_mission_cut_at_every_byte(tmp_path: Path) -> None:
    assert len(RECORDING) < 20_000
    outcomes = sweep(cuts(RECORDING, [], seed=1), tmp_path / "run.mcap", list(MISSION), is_signed=True)
    assert outcomes.counted.total() == len(RECORDING)
    check(outcomes, "all there", "clean error", "salvaged")
    assert "unnoticed, integrity not verifiable" not in outcomes.counted


def test_five_thousand_flipped_bits(tmp_path: Path) -> None:
    outcomes = sweep(flips(RECORDING, 5000, seed=2), tmp_path / "run.mcap", list(MISSION), is_signed=True)
    check(outcomes, "all there", "salvaged")


@pytest.mark.parametrize(
    ("options", "is_signed"),
    [
        ({"use_chunking": False, "enable_data_crcs": True}, True),
        ({"use_chunking": False, "enable_crcs": False}, False),
        ({"enable_crcs": False}, False),
    ],
)
def test_other_layouts_and_lost_blocks(tmp_path: Path, options: dict[str, Any], is_signed: bool) -> None:
    messages = mission_messages(60)
    content = mcap_bytes(messages, **options)
    path = tmp_path / "run.mcap"
    check(sweep(flips(content, 300, seed=3), path, list(messages), is_signed=is_signed), "salvaged")
    check(sweep(smears(content, 300, seed=4), path, list(messages), is_signed=is_signed), "salvaged")


@pytest.mark.parametrize("compression", [None, Rosbag1Writer.CompressionFormat.BZ2])
def test_bags(tmp_path: Path, compression: Rosbag1Writer.CompressionFormat | None) -> None:
    bag = tmp_path / "whole.bag"
    grids = [
        Sent(f"/robot{index % 2}/map", "nav_msgs/msg/OccupancyGrid", 10**9 * index, ros1_grid(small_cells(index)))
        for index in range(20)
    ]
    write_rosbag1(bag, grids, compression, chunk_bytes=500)
    content, messages = bag.read_bytes(), delivered(open_one(bag))
    assert len(messages) == 20
    for cases in (islice(cuts(content, [], 5), 0, None, 60), flips(content, 200, seed=6), smears(content, 100, seed=7)):
        check(sweep(cases, tmp_path / "run.bag", messages, is_signed=False), "clean error", "salvaged")


def test_databases(tmp_path: Path) -> None:
    write_rosbag2(tmp_path / "run", mission_messages(60), StoragePlugin.SQLITE3)
    database = next((tmp_path / "run").glob("*.db3"))
    content, messages = database.read_bytes(), delivered(open_one(database))
    for cases in (cuts(content, [], 8, 300), flips(content, 400, seed=9), smears(content, 200, seed=10)):
        check(sweep(cases, tmp_path / "run.db3", messages, is_signed=False), "clean error", "salvaged")
