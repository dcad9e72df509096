"""How many different walls agree."""

from __future__ import annotations

import numpy as np
import pytest

from mapfusion.grid import Cells
from mapfusion.pairwise.lines import agreeing_lines
from mapfusion.pairwise.prepared import prepare
from tests.fakes import flat, grid_of, rooms


def lines_of(cells: Cells) -> float:
    field = prepare(grid_of(cells), 0.1).field
    assert field is not None
    return agreeing_lines(field, field, np.zeros(3), 1.5)


def test_a_corner_is_two_walls_however_long() -> None:
    for length in (60, 200):
        corner = flat(length + 20, length + 20, -1)
        corner[3:length, 3:length] = 0
        corner[:3, :length] = corner[:length, :3] = 100
        assert lines_of(corner) == pytest.approx(2.0, abs=0.3)


def test_a_furnished_place_has_many() -> None:
    assert lines_of(rooms(seed=3)) > 12.0


def test_nothing_agrees_where_maps_do_not_meet() -> None:
    field = prepare(grid_of(rooms(seed=3)), 0.1).field
    assert field is not None
    assert agreeing_lines(field, field, np.array([1000.0, 0.0, 0.0]), 1.5) == 0.0
