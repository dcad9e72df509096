"""From many hypotheses to the best pose and its rival."""

from __future__ import annotations

import numpy as np
import pytest

from mapfusion.pairwise.prepared import PreparedMap, prepare
from mapfusion.pairwise.search import Candidate, Finding, with_rivals_of
from tests.core.pairwise.test_verdict import GOOD
from tests.fakes import grid_of, rooms


@pytest.fixture(scope="module")
def place() -> PreparedMap:
    return prepare(grid_of(rooms(seed=3)), 0.1)


def candidate(x_cells: float, lines: float) -> Candidate:
    return Candidate(np.array([x_cells, 0.0, 0.0]), GOOD | {"lines": lines})


def test_the_most_plausible_rival_of_either_search_counts(place: PreparedMap) -> None:
    best, weak, strong = candidate(0.0, 30.0), candidate(60.0, 5.0), candidate(120.0, 20.0)
    finding = Finding(best, np.eye(3), weak, is_searched=True)
    other = Finding(candidate(1.0, 31.0), np.eye(3), strong, is_searched=True)
    assert with_rivals_of(finding, other, place, place).rival is strong
    assert with_rivals_of(finding, Finding(strong, np.eye(3), best), place, place).rival is strong


def test_what_is_the_same_alignment_is_no_rival(place: PreparedMap) -> None:
    finding = Finding(candidate(0.0, 30.0), np.eye(3), None, is_searched=True)
    other = Finding(candidate(2.0, 31.0), np.eye(3), candidate(3.0, 20.0), is_searched=True)
    assert with_rivals_of(finding, other, place, place).rival is None
