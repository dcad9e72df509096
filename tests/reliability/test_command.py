"""Damaged recordings through the command line."""

import json
from collections import Counter
from collections.abc import Callable
from itertools import chain, islice
from pathlib import Path

import pytest
from rosbags.rosbag2 import StoragePlugin

from tests.io.making import SHARED, Sent, mcap_bytes, ros1_grid, write_rosbag1, write_rosbag2
from tests.reliability.missions import GRID, START_NS, maps, mission
from tests.reliability.running import command, complaint_about
from tests.reliability.sweeping import cuts, flips, smears

RECORDING = mcap_bytes(mission(2), chunk_size=2000)
CONFORMANCE = sorted((SHARED / "conformance").glob("*.mcap"))
FAST = ("--profile", "paper", "--final-only", "--json")


def test_three_hundred_damaged_recordings(tmp_path: Path) -> None:
    recording, output = tmp_path / "run.mcap", tmp_path / "out" / "fused.mcap"
    output.parent.mkdir()
    step = len(RECORDING) // 100
    cases = chain(
        islice(cuts(RECORDING, [], seed=1), step // 2, None, step),
        flips(RECORDING, 130, seed=2),
        smears(RECORDING, 70, seed=3),
    )
    codes = set()
    for number, content in enumerate(cases):
        recording.write_bytes(content)
        output.unlink(missing_ok=True)
        ran = command("replay", recording, output, *FAST)
        assert not complaint_about(ran, output), f"case {number}: {complaint_about(ran, output)}"
        if ran.code != 1:
            result = json.loads(ran.out)
            assert bool(result["losses"]) == (ran.code == 3), f"case {number}"
            if ran.code == 0 and all(item["integrity_verifiable"] for item in result["inputs"]):
                assert result["inputs"][0]["messages"] == len(mission(2)), f"case {number}: fewer without a word"
        codes.add(ran.code)
    assert number >= 299
    assert codes == {0, 1, 3}


def bag_of_two_robots(folder: Path) -> bytes:
    grids = [
        Sent(f"/{robot}/map", GRID, START_NS + second * 10**9, ros1_grid(cells, f"/{robot}/map"))
        for second in range(3)
        for robot, cells in maps().items()
    ]
    write_rosbag1(folder / "whole.bag", grids, chunk_bytes=20_000)
    return (folder / "whole.bag").read_bytes()


def database_of_two_robots(folder: Path) -> bytes:
    write_rosbag2(folder / "whole", mission(2), StoragePlugin.SQLITE3)
    return next((folder / "whole").glob("*.db3")).read_bytes()


@pytest.mark.parametrize("make", [bag_of_two_robots, database_of_two_robots])
def test_damaged_recordings_without_checksums(make: Callable[[Path], bytes], tmp_path: Path) -> None:
    recording, output = tmp_path / "recording", tmp_path / "out" / "fused.mcap"
    output.parent.mkdir()
    content = make(tmp_path)
    step = len(content) // 15
    beginnings = [content[:offset] for offset in range(step // 2, len(content), step)]
    codes = Counter[int]()
    for number, damaged in enumerate([content, *beginnings, *flips(content, 15, seed=5), *smears(content, 10, seed=6)]):
        recording.write_bytes(damaged)
        output.unlink(missing_ok=True)
        ran = command("replay", recording, output, *FAST)
        assert not complaint_about(ran, output), f"case {number}: {complaint_about(ran, output)}"
        if ran.code != 1:
            result = json.loads(ran.out)
            assert bool(result["losses"]) == (ran.code == 3), f"case {number}"
            assert not result["inputs"][0]["integrity_verifiable"]
            assert "integrity not verifiable" in command("info", recording).out
        codes[ran.code] += 1
        assert number > 0 or ran.code == 0
    assert codes[1] > 3
    assert codes[0] + codes[3] > 10


def test_info_says_the_same(tmp_path: Path) -> None:
    recording = tmp_path / "run.mcap"
    for content in flips(RECORDING, 30, seed=4):
        recording.write_bytes(content)
        ran = command("info", recording)
        assert ran.code in (0, 1, 3)
        assert "Traceback" not in ran.err + ran.out
        assert (ran.code == 3) == ("lost: " in ran.out)


def test_strict_writes_nothing_where_anything_is_lost(tmp_path: Path) -> None:
    recording, output = tmp_path / "run.mcap", tmp_path / "fused.mcap"
    recording.write_bytes(RECORDING[: len(RECORDING) // 2])
    output.write_bytes(b"old")
    ran = command("replay", recording, output, "--strict", "--force", *FAST)
    assert (ran.code, output.read_bytes()) == (1, b"old")
    assert "--strict" in ran.err


@pytest.mark.skipif(not CONFORMANCE, reason="no conformance files beside the repository")
def test_conformance_files_end_in_a_word(tmp_path: Path) -> None:
    """None holds a robot's map; many have no topic, no chunk, no index or no summary."""
    for path in CONFORMANCE:
        ran = command("info", path)
        assert (ran.code, ran.err) == (0, ""), path.name
        assert "lost: " not in ran.out, path.name
    for path in CONFORMANCE[::4]:
        ran = command("replay", path, tmp_path / "fused.mcap")
        assert ran.code == 1, path.name
        assert ran.err.startswith(f"mapfusion: {path.name}: no robot's map in it"), path.name
        assert len(ran.err.splitlines()) == 2, path.name
    assert list(tmp_path.iterdir()) == []
