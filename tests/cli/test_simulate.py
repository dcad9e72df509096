from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from mapfusion.errors import ConfigError, LogWriteError
from mapfusion_cli.simulate import simulate

SHORT = ["--duration", "2", "--map-period", "1", "--max-range", "5"]


def run(*arguments: str) -> Any:
    app = typer.Typer()
    app.command()(simulate)
    return CliRunner().invoke(app, list(arguments))


def test_writes_a_recording_and_its_truth(tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    result = run(str(out), "--robots", "2", "--resolution", "0.05,0.1", "--seed", "5", *SHORT)
    assert result.exit_code == 0, result.output
    assert out.exists()
    truth = json.loads((tmp_path / "out.truth.json").read_text())
    assert [robot["resolution"] for robot in truth["robots"].values()] == [0.05, 0.1]
    assert "robot1-robot2" in result.stdout


def test_json_result(tmp_path: Path) -> None:
    out = tmp_path / "out.bag"
    result = run(str(out), "--robots", "3", "--buildings", "2", "--json", *SHORT)
    assert result.exit_code == 0, result.output
    report = json.loads(result.stdout)
    assert report["recording"] == str(out)
    assert report["final_overlap"]["robot1-robot2"] == 0.0
    assert report["maps"] >= 6


def test_papers_maps(tmp_path: Path) -> None:
    result = run(str(tmp_path / "out.mcap"), "--kind", "paper", "--robots", "2", "--duration", "4", "--quiet")
    assert result.exit_code == 0, result.output
    assert result.stdout == ""
    truth = json.loads((tmp_path / "out.truth.json").read_text())
    assert truth["final_overlap"]["robot1-robot2"] > 0.2


@pytest.mark.parametrize(
    "wrong",
    [
        ["--resolution", "fine"],
        ["--resolution", "0.05,0.1"],
        ["--robots", "2", "--buildings", "3"],
        ["--duration", "-1"],
        ["--noise", "-0.1"],
        ["--poses", "gps"],
        ["--kind", "paper", "--updates"],
        ["--kind", "paper", "--robots", "2", "--resolution", "0.05,0.1"],
    ],
)
def test_wrong_usage(tmp_path: Path, wrong: list[str]) -> None:
    result = run(str(tmp_path / "out.mcap"), *wrong)
    assert result.exit_code == 2
    assert list(tmp_path.iterdir()) == []


def test_existing_output_needs_force(tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    out.write_bytes(b"mine")
    result = run(str(out), "--robots", "1", *SHORT)
    assert isinstance(result.exception, LogWriteError)
    assert "--force" in str(result.exception)
    assert out.read_bytes() == b"mine"
    assert run(str(out), "--robots", "1", "--force", *SHORT).exit_code == 0


def test_unknown_suffix(tmp_path: Path) -> None:
    result = run(str(tmp_path / "out.txt"), "--robots", "1", *SHORT)
    assert isinstance(result.exception, ConfigError)
    assert "--format" in str(result.exception)
    assert run(str(tmp_path / "out.txt"), "--robots", "1", "--format", "bag", *SHORT).exit_code == 0
