"""Inner loops as machine code."""

from __future__ import annotations

import ast
import importlib
import inspect
import math
import pkgutil
import subprocess
import sys
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import numba
import pytest

import mapfusion
from mapfusion.compiled import compiled

ALLOWED = {"np", "math"}
"""What compiled functions may use of other modules."""


def compiled_functions() -> Iterator[tuple[ModuleType, str, Any]]:
    """Every compiled function of the core, with its module and its name."""
    for info in pkgutil.walk_packages(mapfusion.__path__, "mapfusion."):
        module = importlib.import_module(info.name)
        for name, value in vars(module).items():
            if hasattr(value, "py_func") and value.py_func.__module__ == info.name:
                yield module, name, value


def names_from_others(module: ModuleType) -> set[str]:
    """Names that a module has from others, and those of its own that it makes of them."""
    tree = ast.parse(inspect.getsource(module))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]
    names = {alias.asname or alias.name.partition(".")[0] for node in imports for alias in node.names} - ALLOWED
    for node in tree.body:
        if isinstance(node, ast.Assign) and names & {
            one.id for one in ast.walk(node.value) if isinstance(one, ast.Name)
        }:
            names |= {one.id for target in node.targets for one in ast.walk(target) if isinstance(one, ast.Name)}
    return names


def halved(number: float, by: float) -> float:
    return number / by


def test_divisions_by_zero_are_as_in_numpy() -> None:
    function = compiled(halved)
    assert function(3.0, 2.0) == 1.5
    assert function(1.0, 0.0) == math.inf


def test_without_a_place_to_keep_code_it_is_compiled_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    kept, njit = [], numba.njit

    def read_only(*args: Any, cache: bool = False, **options: Any) -> Any:
        kept.append(cache)
        if cache:
            raise RuntimeError("cannot cache function 'halved': no locator available for file 'x.py'")
        return njit(*args, **options)

    monkeypatch.setattr(numba, "njit", read_only)
    assert compiled(halved)(3.0, 2.0) == 1.5
    assert kept == [True, False]


def test_kept_code_follows_every_change_that_concerns_it() -> None:
    """Code is kept by its own file's time and size: what it takes from other modules would stay as it was."""
    found = 0
    for module, name, function in compiled_functions():
        found += 1
        from_others = names_from_others(module) & set(function.py_func.__code__.co_names)
        assert not from_others, f"{module.__name__}.{name}"
    assert found > 20


def test_each_is_compiled_for_one_kind_of_arguments_only() -> None:
    """Another layout or type of an array would cost seconds, and go unnoticed."""
    script = """
import importlib, pkgutil
import mapfusion
from mapfusion import FusionConfig
from mapfusion.fusion import PairFuser
from mapfusion.simulation.paper import negative_pair, positive_pair
fuser, accepted = PairFuser(FusionConfig()), []
for pair in positive_pair(3), negative_pair(4):
    found = fuser.fuse(pair.target, pair.source)
    fuser.verify(pair.target, pair.source, found.T_target_source)
    accepted.append(found.accepted)
assert accepted == [True, False], accepted
found = []
for info in pkgutil.walk_packages(mapfusion.__path__, "mapfusion."):
    for name, value in vars(importlib.import_module(info.name)).items():
        if hasattr(value, "signatures") and value.py_func.__module__ == info.name:
            found.append(len(value.signatures))
            if len(value.signatures) > 1:
                print(info.name, name, value.signatures)
assert found.count(1) > 20, found
"""
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert run.stdout == ""
