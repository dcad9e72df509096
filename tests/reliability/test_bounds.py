"""What a small recording may not do: take the machine."""

import json
import math
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from mapfusion.steps import GridEvent
from mapfusion_io.mission import Mission, MissionOptions, open_recording
from mapfusion_io.read_limits import ReadLimits
from tests.ending import least_cpu_s
from tests.io.making import Sent, cdr, mcap_bytes, tf_message
from tests.reliability.bombs import BOMBS, MOST_MIB, MOST_S, cost
from tests.reliability.missions import START_NS, TF, grid, mission, sent
from tests.reliability.running import command

FAST = ("--profile", "paper", "--final-only", "--json")


REFUSED = {
    "a zstd bomb": "it would take 1073741824 bytes",
    "a lying zstd bomb": "holds 268435456 bytes instead of 1000",
    "a length of 2^62": "a record of 4611686018427387904 bytes reaches beyond the end",
    "a size of 2^62": "it would take 4611686018427387904 bytes",
    "records of length 0": "more than 100000 records in a row hold no message",
    "records of length 0 in a chunk": "more than 100000 records in a row hold no message",
    "a bag's length of 2^32": "a record of 4294967295 bytes reaches beyond the end",
}


@pytest.mark.skipif(sys.platform != "linux", reason="reads its peak memory from /proc")
@pytest.mark.parametrize("name", BOMBS)
def test_bombs_are_refused_in_a_second_and_300_mib(name: str, tmp_path: Path) -> None:
    recording = tmp_path / "run.mcap"
    recording.write_bytes(BOMBS[name])
    found = cost(recording)
    assert REFUSED[name] in found.words
    assert found.peak_mib < MOST_MIB
    assert found.cpu_s < MOST_S or least_cpu_s(lambda: cost(recording).cpu_s, MOST_S) < MOST_S


def with_big_map(robot: str, cells: int) -> list[Sent]:
    return [*mission(1), sent(f"/{robot}/map", grid(robot, cells=np.zeros((cells, 1000), np.int8)), 0.6)]


@pytest.mark.parametrize(
    ("messages", "options", "words", "count"),
    [
        (with_big_map("a", 100), ("--max-map-cells", 99_999), "1000 x 100 cells, the limit is 99999", 1),
        (mission(1), ("--max-messages", 8), "more than 8 maps, transforms and poses", 4),
        (with_big_map("a", 2000), ("--max-chunk", 1), "the limit is 1048576", None),
    ],
)
def test_what_is_over_a_limit_is_lost_by_name(
    messages: list[Sent], options: tuple[object, ...], words: str, count: int | None, tmp_path: Path
) -> None:
    recording, output = tmp_path / "run.mcap", tmp_path / "fused.mcap"
    recording.write_bytes(mcap_bytes(sorted(messages, key=lambda message: message.log_time_ns)))
    ran = command("replay", recording, output, *FAST, *options)
    losses = [loss for loss in json.loads(ran.out)["losses"] if loss["kind"] == "over limit"]
    assert ran.code == 3
    assert any(words in loss["detail"] for loss in losses)
    if count is not None:
        assert sum(loss["messages"] for loss in losses) == count
    info = command("info", recording, *options)
    assert info.code == 3
    assert words in info.out


def test_robots_over_the_limit_are_dropped_by_name(tmp_path: Path) -> None:
    recording, output = tmp_path / "run.mcap", tmp_path / "fused.mcap"
    more = [sent("/c/map", grid("a", frame_id="c/map"), 0.1)]
    recording.write_bytes(mcap_bytes([*mission(1), *more]))
    ran = command("replay", recording, output, *FAST, "--max-robots", 2)
    result = json.loads(ran.out)
    assert (ran.code, set(result["robots"])) == (3, {"a", "b"})
    assert [(loss["kind"], loss["topic"]) for loss in result["losses"]] == [("over limit", "/c/map")]
    ran = command("replay", recording, tmp_path / "none.mcap", *FAST, "--max-robots", 1)
    assert (ran.code, (tmp_path / "none.mcap").exists()) == (1, False)
    assert command("replay", recording, output, "--max-robots", 0).code == 2


def test_maps_that_are_too_large_together_are_dropped_by_name(tmp_path: Path) -> None:
    recording, output = tmp_path / "run.mcap", tmp_path / "fused.mcap"
    more = [sent(f"/{name}/map", grid("a", frame_id=f"{name}/map"), 0.1) for name in "cd"]
    recording.write_bytes(mcap_bytes([*mission(1), *more]))
    ran = command("replay", recording, output, *FAST, "--max-all-cells", 3 * 150 * 150)
    result = json.loads(ran.out)
    assert (ran.code, set(result["robots"])) == (3, {"a", "b", "c"})
    assert [(loss["kind"], loss["topic"]) for loss in result["losses"]] == [("over limit", "/d/map")]
    assert "together" in result["losses"][0]["detail"]


@pytest.mark.parametrize("cells", [(400, 400), (150, 150)])
def test_a_robot_without_a_map_that_counts_is_a_loss(cells: tuple[int, int], tmp_path: Path) -> None:
    recording, output = tmp_path / "run.mcap", tmp_path / "fused.mcap"
    is_over = cells == (400, 400)
    bad = grid("a", cells=np.zeros(cells, np.int8), frame_id="c/map", resolution_m=0.1 if is_over else math.nan)
    recording.write_bytes(mcap_bytes([*mission(1), sent("/c/map", bad, 0.5)]))
    ran = command("replay", recording, output, *FAST, "--max-map-cells", 100_000)
    result = json.loads(ran.out)
    assert (ran.code, set(result["robots"])) == (3, {"a", "b"})
    kind = "over limit" if is_over else "malformed message"
    assert [(loss["kind"], loss["topic"], loss["messages"]) for loss in result["losses"]] == [(kind, "/c/map", 1)]
    assert command("info", recording, "--max-map-cells", 100_000).code == 3


def test_hundred_thousand_topics_frames_and_tiny_messages(tmp_path: Path) -> None:
    recording = tmp_path / "run.mcap"
    transforms = [
        Sent("/tf", TF, START_NS + index, cdr(tf_message((f"frame{index}", f"frame{index + 1}"))))
        for index in range(12_000)
    ]
    topics = [Sent(f"/noise{index}", "std_msgs/msg/Empty", START_NS, b"\0\1\0\0\0") for index in range(12_000)]
    recording.write_bytes(mcap_bytes([*mission(1), *topics, *transforms], chunk_size=2**20))
    opened: list[Mission] = []

    def read() -> float:
        began_s = time.process_time()
        found = open_recording([recording])
        opened.append(found)
        assert sum(1 for event in found.events() if isinstance(event, GridEvent)) == 2
        return time.process_time() - began_s

    assert least_cpu_s(read, 10.0) < 10.0
    assert [(loss.kind, loss.topic) for loss in opened[0].losses] == [("over limit", "/tf")]


def test_a_robot_placed_far_away_does_not_blow_up_the_merged_map(tmp_path: Path) -> None:
    recording, output = tmp_path / "run.mcap", tmp_path / "fused.mcap"
    recording.write_bytes(mcap_bytes(mission(1)))
    ran = command("replay", recording, output, *FAST, "--prior", "a=0,0,0", "--prior", "b=20000,20000,0")
    result = json.loads(ran.out)
    assert ran.code == 3
    assert [(loss["kind"], loss["topic"]) for loss in result["losses"]] == [("over limit", "")]
    assert result["losses"][0]["detail"].startswith("b lies too far away")
    assert result["groups"][0]["robots"] == ["a", "b"]
    with output.open("rb") as file:
        found = [(channel.topic, message) for _, channel, message in make_reader(file).iter_messages()]
    (merged,) = (message for topic, message in found if topic == "/fused/map")
    assert 90 * 150 < len(merged.data) < 100 * 150  # what a knows
    assert "/fused/b/pose" in {topic for topic, _ in found}


def test_maps_that_come_in_reverse_are_not_all_held(tmp_path: Path) -> None:
    recording = tmp_path / "run.mcap"
    maps = [sent("/a/map", grid("a"), 0.01 * index, stamp_s=100.0 - index) for index in range(40)]
    recording.write_bytes(mcap_bytes([*mission(1), *maps]))
    limits = ReadLimits(held_cells=10 * 150 * 150)
    found = open_recording([recording], MissionOptions(limits=limits))
    stamps = [event.stamp_ns for event in found.events() if isinstance(event, GridEvent)]
    assert stamps == sorted(stamps)
    (loss,) = found.losses
    assert loss.kind == "over limit"
    assert len(stamps) + (loss.count or 0) == 42


def test_stamps_far_away_make_no_snapshots(tmp_path: Path) -> None:
    recording, output = tmp_path / "run.mcap", tmp_path / "fused.mcap"
    far = [sent("/a/map", grid("a"), 0.5, stamp_s) for stamp_s in (86_400.0 * 3, 3e8, -1.6e9)]
    recording.write_bytes(mcap_bytes([*mission(1), *far]))
    ran = command("replay", recording, output, "--profile", "paper", "--json")
    result = json.loads(ran.out)
    assert (ran.code, result["snapshots"]) == (3, 2)
    assert result["last_stamp_ns"] - result["first_stamp_ns"] == 10**9
    assert [(loss["messages"], loss["topic"]) for loss in result["losses"]] == [(3, "/a/map")]


def test_years_of_reports_are_refused_unless_the_interval_is_longer(tmp_path: Path) -> None:
    recording, output = tmp_path / "run.mcap", tmp_path / "fused.mcap"
    slow = [sent("/a/map", grid("a"), 100.0 * second) for second in range(1, 13)]
    recording.write_bytes(mcap_bytes([*mission(1), *slow]))
    ran = command("replay", recording, output, *FAST, "--interval", 0.001)
    assert (ran.code, output.exists()) == (2, False)
    assert "larger --interval" in ran.err
    assert command("replay", recording, output, *FAST, "--interval", 100).code == 0


def test_robots_whose_clocks_are_years_apart_are_both_believed(tmp_path: Path) -> None:
    recording, output = tmp_path / "run.mcap", tmp_path / "fused.mcap"
    own_clock = [sent("/b/map", grid("b"), second, second - START_NS * 1e-9 + 50.0) for second in (0.0, 0.5, 1.0)]
    others = [message for message in mission(1) if message.topic != "/b/map"]
    recording.write_bytes(mcap_bytes([*others, *own_clock]))
    ran = command("replay", recording, output, *FAST)
    result = json.loads(ran.out)
    assert (ran.code, result["losses"], result["robots"]["b"]["maps"]) == (0, [], 3)


def test_limits_are_checked() -> None:
    with pytest.raises(ValueError, match="map_cells must be at least 1"):
        ReadLimits(map_cells=0)
