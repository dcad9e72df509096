"""An output stands under its name whole, or not at all."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mapfusion_io.mission import Mission, open_recording
from tests.io.making import mcap_bytes
from tests.reliability.killing import complaints, started
from tests.reliability.missions import mission
from tests.reliability.running import command, read_whole

FAST = ("--profile", "paper", "--final-only")


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "run.mcap"
    path.write_bytes(mcap_bytes(mission(2)))
    return path


@pytest.mark.skipif(os.name != "posix", reason="kills by POSIX signals")
def test_kills_leave_the_output_whole(recording: Path) -> None:
    wrong, num_killed = complaints(recording, recording.parent, 15, seed=1)
    assert wrong == []
    assert num_killed >= 3


@pytest.mark.skipif(os.name != "posix", reason="kills by POSIX signals")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGINT", "SIGHUP"])
def test_a_run_that_is_stopped_while_it_writes_removes_its_file(name: str, recording: Path) -> None:
    recording.write_bytes(mcap_bytes(mission(40)))
    output = recording.with_name("fused.mcap")
    output.write_bytes(b"old")
    with started("replay", recording, output, "--force", "--interval", 0.02) as process:
        for _ in range(12_000):
            if list(recording.parent.glob(".fused.mcap.*.partial")) or process.poll() is not None:
                break
            time.sleep(0.005)
        process.send_signal(getattr(signal, name))
        out, err = process.communicate()
    assert process.returncode not in (0, 3), out
    assert "Traceback" not in err
    assert sorted(item.name for item in recording.parent.iterdir()) == ["fused.mcap", "run.mcap"]
    assert output.read_bytes() == b"old"


def test_the_next_run_removes_what_a_killed_one_left_and_nothing_else(recording: Path) -> None:
    folder = recording.parent
    with subprocess.Popen([sys.executable, "-c", "pass"]) as ended:
        pass
    kept = [
        folder / f".fused.mcap.mapfusion-{os.getppid()}-01234567.partial",  # runs
        folder / f".other.mcap.mapfusion-{ended.pid}-01234567.partial",  # another output's
        folder / f".fused.mcap.mapfusion-{ended.pid}-01234567.partial.bak",
        folder / ".fused.mcap.mapfusion-x-01234567.partial",
    ]
    left = [
        folder / f".fused.mcap.mapfusion-{ended.pid}-01234567.partial",
        folder / f".fused.mcap.mapfusion-{os.getpid()}-01234567.partial",  # of a process that had this one's number
    ]
    for path in (*kept, *left):
        path.write_bytes(b"half")
    assert command("replay", recording, folder / "fused.mcap", "-q", *FAST).code == 0
    assert sorted(folder.iterdir()) == sorted([*kept, recording, folder / "fused.mcap"])


@pytest.mark.skipif(not Path("/sys/kernel").is_dir(), reason="needs a folder that not even root can write to")
def test_a_folder_that_cannot_be_written_to(recording: Path) -> None:
    ran = command("replay", recording, "/sys/kernel/fused.mcap", *FAST)
    assert ran.code == 1
    assert "cannot be written" in ran.err
    assert len(ran.err.splitlines()) == 1


@pytest.mark.parametrize("is_gone", [True, False])
def test_an_input_that_vanishes_or_shrinks_between_the_passes(
    is_gone: bool, recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    output = recording.with_name("fused.mcap")
    output.write_bytes(b"old")
    require_robots = Mission.require_robots

    def meddle(mission: Mission) -> None:
        require_robots(mission)
        if is_gone:
            recording.unlink()
        else:
            recording.write_bytes(mcap_bytes(mission_of_less))

    mission_of_less = mission(2)[:-3]
    monkeypatch.setattr(Mission, "require_robots", meddle)
    ran = command("replay", recording, output, "--force", *FAST)
    assert ran.code == 1
    assert "run.mcap: " in ran.err
    assert "Traceback" not in ran.err
    assert output.read_bytes() == b"old"
    assert len(list(output.parent.glob(".*"))) == 0


def test_a_recording_that_grows_while_it_is_read(recording: Path) -> None:
    found = open_recording([recording])
    recording.write_bytes(mcap_bytes(mission(4)))
    assert len(list(found.events())) == 2 + 4  # what was there at first


@pytest.mark.skipif(os.name != "posix", reason="needs a pipe that breaks as on POSIX")
@pytest.mark.parametrize("arguments", [("info",), ("replay", "--json"), ("replay",)])
def test_a_closed_pipe_is_no_failure(arguments: tuple[str, ...], recording: Path) -> None:
    verb, *options = arguments
    output = recording.with_name("fused.mcap")
    paths = [recording] if verb == "info" else [recording, output, *FAST]
    reading, writing = os.pipe()
    os.close(reading)
    launch = "import sys; from mapfusion_cli.main import run; run(sys.argv[1:])"
    ran = subprocess.run(
        [sys.executable, "-c", launch, verb, *map(str, paths), *options],
        stdout=writing,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    os.close(writing)
    assert (ran.returncode, ran.stderr) == (0, "")
    if verb == "replay":
        assert read_whole(output) > 0


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_a_result_that_cannot_be_printed(recording: Path) -> None:
    output = recording.with_name("fused.mcap")
    launch = "import sys; from mapfusion_cli.main import run; run(sys.argv[1:])"
    with Path("/dev/full").open("w") as full:
        ran = subprocess.run(
            [sys.executable, "-c", launch, "replay", recording, output, *FAST],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert ran.returncode == 0
    assert "cannot be printed" in ran.stderr
    assert read_whole(output) > 0
