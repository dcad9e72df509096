"""Damaged recordings through the command line."""

import json
from itertools import chain, islice
from pathlib import Path

import pytest

from tests.io.making import SHARED, mcap_bytes
from tests.reliability.missions import mission
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
