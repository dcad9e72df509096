"""Who may import whom, and what must not be there."""

from __future__ import annotations

import ast
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FORBIDDEN = {
    "mapfusion": {"mapfusion_io", "mapfusion_cli", "mcap", "rosbags", "typer", "rich"},
    "io/mapfusion_io": {"mapfusion_cli", "typer", "rich"},
    "cli/mapfusion_cli": {"mcap", "rosbags"},
}


def imported_packages(path: Path) -> set[str]:
    """Top-level packages that a module imports, anywhere in it."""
    packages = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            packages |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            packages.add(node.module.partition(".")[0])
    return packages


@pytest.mark.parametrize("folder", FORBIDDEN)
def test_imports_go_one_way(folder: str) -> None:
    modules = sorted((ROOT / folder).rglob("*.py"))
    assert modules
    for module in modules:
        assert not imported_packages(module) & FORBIDDEN[folder], module


def test_core_opens_no_files() -> None:
    for module in sorted((ROOT / "mapfusion").rglob("*.py")):
        assert not imported_packages(module) & {"io", "os", "pathlib", "shutil", "tempfile"}, module


@pytest.mark.parametrize("folder", ["io", "cli"])
def test_source_roots_are_no_packages(folder: str) -> None:
    assert not list((ROOT / folder).glob("*.py"))


def test_ci_runs_the_test_command_of_the_readme() -> None:
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (command,) = [line for line in readme.splitlines() if line.startswith("python3 -m venv") and "pytest" in line]
    assert command in script.splitlines()


def test_every_package_says_that_it_is_typed() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    for package in project["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]:
        assert (ROOT / package / "py.typed").exists()
