import json
import math
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from mapfusion.simulation.mission import simulate_mission
from mapfusion.simulation.mission_config import MissionConfig
from mapfusion.transform import SE2
from mapfusion_io.mission_writer import write_mission
from tests.cli.conftest import Command
from tests.io.making import Sent, cdr, mcap_bytes, tf_message
from tests.reliability.missions import START_NS, TF
from tests.reliability.missions import mission as small_mission

SHARED = Path(__file__).resolve().parents[2] / ".." / "shared" / "data"
SHORT = ("--duration", 12, "--interval", 2)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two robots of one building, 40 s."""
    path = tmp_path_factory.mktemp("recorded") / "run.mcap"
    write_mission(simulate_mission(MissionConfig(seed=7, num_robots=2, duration_s=40.0, overlap=0.8)), path, poses="tf")
    return path


@pytest.fixture
def output(tmp_path: Path) -> Path:
    return tmp_path / "fused.mcap"


def topics(path: Path) -> dict[str, int]:
    with path.open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    return {
        channel.topic: summary.statistics.channel_message_counts.get(channel.id, 0)
        for channel in summary.channels.values()
    }


def test_a_mission_is_fused_and_every_reader_reads_it(mapfusion: Command, recording: Path, output: Path) -> None:
    ran = mapfusion("replay", recording, output, "--json")
    assert (ran.code, ran.err) == (0, "")
    result = json.loads(ran.out)
    assert result["snapshots"] == pytest.approx(41, abs=1)
    assert [group["robots"] for group in result["groups"]] == [["robot1", "robot2"]]
    assert result["pairs"][0]["verdict"] == "joined"
    assert result["pairs"][0]["mae"] < 20
    written = topics(output)
    assert {"/fused/map", "/fused/robot1/pose", "/fused/robot2/path", "/tf", "/diagnostics"} <= set(written)
    with AnyReader([output]) as bag:
        counted = {topic: info.msgcount for topic, info in bag.topics.items()}
        assert counted == written
        for connection, _, data in bag.messages():
            bag.deserialize(data, connection.msgtype)


def test_the_same_run_gives_the_same_bytes_whatever_the_jobs(
    mapfusion: Command, recording: Path, tmp_path: Path
) -> None:
    paths = [tmp_path / "one" / "out.mcap", tmp_path / "two" / "out.mcap"]
    for path, jobs in zip(paths, (1, 2), strict=True):
        path.parent.mkdir()
        assert mapfusion("replay", recording, path, "--jobs", jobs, "-q").code == 0
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_the_table_says_what_was_joined(mapfusion: Command, recording: Path, output: Path) -> None:
    ran = mapfusion("replay", recording, output)
    assert "group 1 in frame world: robot1, robot2" in ran.out
    assert " joined " in ran.out
    assert "MAE" in ran.out


def test_final_only_writes_one_snapshot(mapfusion: Command, recording: Path, output: Path) -> None:
    assert mapfusion("replay", recording, output, "--final-only", "-q").code == 0
    written = topics(output)
    assert (written["/tf"], written["/fused/map"], written["/fused/robot1/path"]) == (1, 1, 1)


def test_inputs_stand_beside_the_results_byte_for_byte(mapfusion: Command, recording: Path, output: Path) -> None:
    assert mapfusion("replay", recording, output, "--include-inputs", "-q", "--profile", "paper").code == 0

    def maps(path: Path) -> list[tuple[int, bytes]]:
        with path.open("rb") as file:
            return [(m.log_time, m.data) for _, _, m in make_reader(file).iter_messages(topics=["/robot1/map"])]

    assert maps(output) == maps(recording)
    assert len(maps(output)) > 5


def test_a_map_frame_of_the_inputs_hangs_in_the_world_alone(mapfusion: Command, tmp_path: Path, output: Path) -> None:
    recording = tmp_path / "run.mcap"
    hung = Sent("/tf_static", TF, START_NS, cdr(tf_message(("earth", "a/map"), ("earth", "tower"))))
    recording.write_bytes(mcap_bytes([hung, *small_mission(2)]))
    ran = mapfusion("replay", recording, output, "--include-inputs", "--profile", "paper", "--prior", "b=1,2,0")
    assert (ran.code, "not copied: run.mcap /tf_static" in ran.out) == (0, True)
    with AnyReader([output]) as bag:
        found = [bag.deserialize(data, c.msgtype) for c, _, data in bag.messages() if c.topic in ("/tf", "/tf_static")]
    parents = {(t.header.frame_id, t.child_frame_id) for message in found for t in message.transforms}  # type: ignore[attr-defined]
    assert {parent for parent, child in parents if child == "a/map"} == {"world"}
    assert ("earth", "tower") in parents


def test_refused_pairs_are_explained_with_the_nearest_miss(mapfusion: Command, tmp_path: Path, output: Path) -> None:
    config = MissionConfig(seed=3, num_robots=2, num_buildings=2, duration_s=15.0)
    write_mission(simulate_mission(config), tmp_path / "apart.mcap", poses="pose")
    ran = mapfusion("replay", tmp_path / "apart.mcap", output)
    assert ran.code == 0
    assert "in no group: robot1, robot2" in ran.out
    assert "nothing was joined" in ran.out
    assert "try:" in ran.out
    assert set(topics(output)) == {"/diagnostics", "/fused/pairs/robot1/robot2"}


def test_names_frames_and_times_can_be_chosen(mapfusion: Command, recording: Path, output: Path) -> None:
    options = ("--world-frame", "earth", "--robot", "z=/robot1/map", "--start", 10, "--end", 35)
    ran = mapfusion("replay", recording, output, *options, "--reference", "z", "--json", "--profile", "paper")
    result = json.loads(ran.out)
    assert set(result["robots"]) == {"robot2", "z"}
    with output.open("rb") as file:
        stamps = [message.log_time for _, _, message in make_reader(file).iter_messages()]
    first = result["first_stamp_ns"]
    assert first + 10 * 10**9 <= min(stamps)
    assert max(stamps) < first + 35 * 10**9


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["{nowhere}", "{out}"], 1, "no such file"),
        (["{recording}", "{existing}"], 1, "already exists"),
        (["{recording}", "{recording}"], 2, "the output is an input"),
        (["{recording}", "{out}", "--drop", "robot1"], 1, "only one robot"),
        (["{recording}", "{out}", "--drop", "robot9"], 2, "there is no such robot"),
        (["{recording}", "{out}", "--reference", "robot9"], 2, "there is no such robot"),
        (["{recording}", "{out}", "--world-frame", "robot1/odom"], 2, "already have a frame"),
        (["{recording}", "{out}", "--prior", "robot9=0,0,0"], 2, "there is no such robot"),
        (["{recording}", "{out}", "--prior", "robot1=0,0"], 2, "X,Y,YAW"),
        (["{recording}", "{out}", "--prior", "robot1=0,0,0,1"], 2, "SIGMA_DEG"),
        (["{recording}", "{out}", "--never", "robot1,robot9"], 2, "there is no such robot"),
        (["{recording}", "{out}", "--never", "robot1"], 2, "two robots"),
        (["{recording}", "{out}", "--map-interval", "inf"], 2, "--map-interval must lie in"),
        (
            ["{recording}", "{out}", "--prior", "robot2=1,1,1", "--never", "robot1,robot2"],
            2,
            "robot1 and robot2 are tied",
        ),
        (
            ["{recording}", "{out}", "--prior", "robot1=0,0,0", "--prior", "robot2=1,1,1", "--never", "robot1,robot2"],
            2,
            "--never and --prior contradict each other",
        ),
        (["{recording}", "{out}", "--duration", "0.001"], 1, "there is no map to use from --start to --end"),
        (["{recording}", "{out}", "--interval", "0"], 2, "--interval must"),
        (["{recording}", "{out}", "--blend", "soup"], 2, "soup"),
        (["{recording}", "{out}", "--robot", "robot1"], 2, "NAME=VALUE"),
        (["{recording}", "{out}", "--start", "noon"], 2, "--start noon"),
        (["{recording}"], 2, "INPUT"),
        (["{text}", "{out}"], 1, "first bytes are wrong"),
    ],
)
def test_mistakes_get_one_clear_line_and_nothing_is_written(
    mapfusion: Command, recording: Path, tmp_path: Path, arguments: list[str], code: int, words: str
) -> None:
    (tmp_path / "text.mcap").write_text("hello")
    (tmp_path / "existing.mcap").write_text("precious")
    names = {
        "recording": recording,
        "nowhere": tmp_path / "nowhere.mcap",
        "out": tmp_path / "out.mcap",
        "existing": tmp_path / "existing.mcap",
        "text": tmp_path / "text.mcap",
    }
    before = recording.read_bytes()
    ran = mapfusion("replay", *(argument.format(**names) for argument in arguments))
    assert ran.code == code
    assert words in ran.err
    assert "Traceback" not in ran.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["existing.mcap", "text.mcap"]
    assert (tmp_path / "existing.mcap").read_text() == "precious"
    assert recording.read_bytes() == before


def test_known_starts_and_pairs_kept_apart(mapfusion: Command, recording: Path, tmp_path: Path) -> None:
    start = ("--prior", "robot2=3,4,0.5", "--json")
    tied = json.loads(mapfusion("replay", recording, tmp_path / "tied.mcap", *start).out)
    placed = tied["robots"]["robot2"]["T_group_map"]
    assert (placed["x_m"], placed["y_m"]) == pytest.approx((3.0, 4.0), abs=1e-3)
    apart = json.loads(
        mapfusion("replay", recording, tmp_path / "apart.mcap", "--never", "robot1,robot2", "--json").out
    )
    assert apart["groups"] == []


def test_losses_end_in_3_and_with_strict_in_1(mapfusion: Command, recording: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    whole = recording.read_bytes()
    cut.write_bytes(whole[: len(whole) * 3 // 4])
    output = tmp_path / "out.mcap"
    ran = mapfusion("replay", cut, output, "--profile", "paper")
    assert ran.code == 3
    assert "lost: cut.mcap: truncated" in ran.out
    assert output.exists()
    ran = mapfusion("replay", cut, tmp_path / "strict.mcap", "--profile", "paper", "--strict")
    assert ran.code == 1
    assert "--strict" in ran.err
    assert not (tmp_path / "strict.mcap").exists()


def test_options_come_from_a_file_and_go_back_into_one(
    mapfusion: Command, recording: Path, tmp_path: Path, output: Path
) -> None:
    settings = tmp_path / "settings.toml"
    settings.write_text('interval = 5.0\nprofile = "paper"\nquiet = true\n')
    assert mapfusion("replay", recording, output, "--config", settings).out == ""
    printed = mapfusion("replay", "--config", settings, "--interval", "2.5", "--print-config")
    assert "interval = 2.5" in printed.out
    assert 'profile = "paper"' in printed.out
    settings.write_text(printed.out)
    assert mapfusion("replay", "--config", settings, "--print-config").out == printed.out
    settings.write_text("intervall = 5.0\n")
    wrong = mapfusion("replay", recording, output, "--config", settings)
    assert (wrong.code, "unknown option intervall; known are align-start," in wrong.err) == (2, True)
    settings.write_text("config = 'other.toml'\n")
    assert mapfusion("replay", recording, output, "--config", settings).code == 2


def test_an_earlier_result_is_no_recording_of_robots(mapfusion: Command, recording: Path, tmp_path: Path) -> None:
    first = tmp_path / "first.mcap"
    assert mapfusion("replay", recording, first, "--include-inputs", "-q", "--profile", "paper").code == 0
    ran = mapfusion("info", first, "--json")
    found = json.loads(ran.out)
    assert set(found["robots"]) == {"robot1", "robot2"}
    assert {item["topic"]: item["reason"] for item in found["passed_over"]}["/fused/map"].startswith(
        "an earlier result"
    )
    again = mapfusion("replay", first, tmp_path / "second.mcap")
    assert again.code == 2
    assert "--world-frame" in again.err
    assert found["replay_command"].split()[-3:] == ["fused.mcap", "--world-frame", "fused"]
    assert mapfusion("info", first, first).code == 2


def test_three_real_bags_of_one_robot_each(mapfusion: Command, tmp_path: Path) -> None:
    folder = SHARED / "recordings" / "isr_small"
    if not folder.exists():
        pytest.skip("the shared recordings are not here")
    bags, output = [folder / f"{number}.bag" for number in (1, 2, 3)], tmp_path / "out.mcap"
    ran = mapfusion("replay", *bags, output, "--align-start", "--interval", 5, "--json")
    assert ran.code == 0
    robots = json.loads(ran.out)["robots"]
    assert {robot: found["group"] for robot, found in robots.items()} == {"1": 1, "2": 1, "3": 1}
    assert "/fused/pairs/r_1/r_2" in topics(output)
    truth = json.loads((folder / "truth.json").read_text())
    # The middle of each robot's known area in its own frame, as the recordings' README gives it.
    # The world is the frame of one of the two that join first; the truth is told from the first robot.
    placed = {
        robot: SE2(T["x_m"], T["y_m"], math.radians(T["yaw_deg"]))
        for robot, T in ((robot, found["T_group_map"]) for robot, found in robots.items())
    }
    for robot, middle in (("2", (15.4, 40.8)), ("3", (17.7, 42.5))):
        found = placed["1"].inverse() @ placed[robot]
        true = SE2(*truth[f"T_1_{robot}"])
        assert math.dist(found.apply(np.array(middle)), true.apply(np.array(middle))) < 0.3
        assert math.degrees(found.distance_to(true)[1]) < 3.0
    apart = mapfusion("replay", *bags, output, "--force", *SHORT)
    assert "do not overlap in time" in apart.out
    assert "--align-start" in apart.out


def test_a_recording_without_maps(mapfusion: Command, output: Path) -> None:
    bag = SHARED / "recordings" / "robot_localization" / "test1.bag"
    if not bag.exists():
        pytest.skip("the shared recordings are not here")
    ran = mapfusion("replay", bag, output)
    assert ran.code == 1
    assert "no robot's map in it" in ran.err
    assert not output.exists()
