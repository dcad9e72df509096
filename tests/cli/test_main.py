import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from mapfusion_cli import main
from tests.cli.conftest import Command
from tests.io.making import mcap_bytes
from tests.reliability.missions import mission

LAUNCH = "import sys; from mapfusion_cli.main import run; run(sys.argv[1:])"


def launched(arguments: Sequence[object], redirection: str) -> subprocess.CompletedProcess[str]:
    """The command in a shell, its streams as the redirection says."""
    words = [sys.executable, "-c", LAUNCH, *map(str, arguments)]
    return subprocess.run(
        ["sh", "-c", f'"$@" {redirection}', "sh", *words], capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize(
    "arguments",
    [
        (),
        ("--bogus",),
        ("bogus",),
        ("replay",),
        ("replay", "a.mcap"),
        ("info",),
        ("replay", "a.mcap", "b.mcap", "--clock", "moon"),
        ("info", "a.mcap", "--max-chunk", "0"),
    ],
)
def test_wrong_usage_is_said_in_two_lines(arguments: tuple[str, ...], mapfusion: Command) -> None:
    ran = mapfusion(*arguments)
    assert (ran.code, ran.out) == (2, "")
    wrong, advice = ran.err.splitlines()
    assert wrong.startswith("mapfusion: ")
    assert "--help" in advice


@pytest.mark.parametrize("name", ["x" * 300, "loop", "no\x1b[2Jsuch"])
def test_inputs_that_cannot_be_are_said_in_two_lines(name: str, mapfusion: Command, tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to("loop")
    for ran in (mapfusion("info", tmp_path / name), mapfusion("replay", tmp_path / name, tmp_path / "fused.mcap")):
        assert (ran.code, ran.out) == (1, "")
        assert len(ran.err.splitlines()) <= 2
        assert "itself" not in ran.err
        assert all(char.isprintable() for line in ran.err.splitlines() for char in line)


@pytest.mark.skipif(os.name != "posix", reason="closes streams by a POSIX shell")
@pytest.mark.parametrize("redirection", [">&-", "2>&-"])
def test_closed_streams_are_no_failure(redirection: str, tmp_path: Path) -> None:
    recording, output = tmp_path / "run.mcap", tmp_path / "fused.mcap"
    recording.write_bytes(mcap_bytes(mission(1)))
    assert launched(["replay", recording, output, "--final-only", "--profile", "paper"], redirection).returncode == 0
    assert output.exists()


def test_ctrl_c_before_anything_runs_is_said_by_the_exit_code(
    mapfusion: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*arguments: object, **options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(main, "_command", interrupted)
    assert mapfusion("info", "a.mcap") == (130, "", "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_help_that_cannot_be_printed() -> None:
    ran = launched(["replay", "--help"], ">/dev/full")
    assert ran.returncode == 1
    assert ran.stderr == "mapfusion: cannot be printed: No space left on device\n"
