from __future__ import annotations

import json
from pathlib import Path

import cv2
import pytest
import typer
from typer.testing import CliRunner

from mapfusion.errors import LogWriteError
from mapfusion_cli.evaluate import evaluate

SMALL = ["--pairs", "3", "--negatives", "2", "--generator", "paper", "--profile", "paper"]

app = typer.Typer()
app.command()(evaluate)


def output(*arguments: str) -> str:
    result = CliRunner().invoke(app, [*arguments], catch_exceptions=False)
    assert result.exit_code == 0
    return result.stdout


def test_the_table_names_counts_profile_and_criterion() -> None:
    text = output(*SMALL)
    assert "the paper's generator: 3 pairs of one place, 2 of two" in text
    assert "joined and right (recall)" in text
    assert "false merges of two places" in text
    assert "0.70 to 1.00" in text
    assert "right: the middle of the source's known area less than 5 cells" in text
    assert "the published code's gate on the same candidates" in text
    assert "floor plans" not in text


def test_json_has_the_figures_of_every_generator_and_profile() -> None:
    content = json.loads(output("--pairs", "2", "--negatives", "1", "--profile", "paper", "--json"))
    assert [(r["generator"], r["profile"]) for r in content["results"]] == [
        ("paper", "paper"),
        ("floor-plans", "paper"),
    ]
    assert content["study"]["seed"] == 0
    for result in content["results"]:
        assert (result["num_related"], result["num_unrelated"]) == (2, 1)
        assert result["recall"] == result["num_right"] / 2
        assert len(result["roc"]) == 101


def test_the_seed_decides_and_processes_do_not() -> None:
    first = output(*SMALL, "--json")
    assert output(*SMALL, "--json", "--jobs", "2") == first
    assert output(*SMALL, "--json", "--seed", "1") != first


def test_charts_are_drawn_into_the_folder(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "charts"
    assert output(*SMALL, "--plots", str(folder), "--quiet") == ""
    names = {path.name for path in folder.iterdir()}
    assert names == {
        "paper_recall_by_overlap.png",
        "paper_recall_by_rotation.png",
        "paper_roc.png",
        "paper_reliability.png",
        "paper_mae_paper.png",
    }
    assert all(cv2.imread(str(path)) is not None for path in folder.iterdir())


def test_a_folder_that_cannot_be_made_is_said_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(LogWriteError, match="cannot write the charts"):
        CliRunner().invoke(app, [*SMALL, "--plots", str(tmp_path / "file" / "charts")], catch_exceptions=False)
