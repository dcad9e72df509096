"""What one map sees behind the other's walls, on walls drawn for it."""

from __future__ import annotations

import numpy as np
import pytest

from mapfusion.grid import Cells
from mapfusion.pairwise.behind import FARTHEST_CELLS, NEAREST_CELLS, SeenBehind, seen_behind
from mapfusion.pairwise.poses import between_corners
from mapfusion.pairwise.prepared import PreparedMap, prepare
from mapfusion.transform import SE2
from tests.fakes import flat, grid_of, rooms


def prepared(cells: Cells) -> PreparedMap:
    return prepare(grid_of(cells), 0.1)


def seen(target: PreparedMap, source: PreparedMap, num_walls: float = 400.0) -> SeenBehind:
    assert target.field is not None
    assert source.field is not None
    pose = between_corners(SE2.identity(), target.grid, source.grid)
    return seen_behind(target.field, source.field, (target.hidden, source.hidden), pose, num_walls)


def corridor(door: slice | None = None, beyond: int = 30) -> Cells:
    """A corridor of 200 x 20 cells between walls of 2, nothing known around it; a door in one wall, free beyond it."""
    cells = flat(100, 200, -1)
    cells[40:60] = 0
    cells[38:40] = cells[60:62] = 100
    if door is not None:
        cells[60 : 62 + beyond, door] = 0
    return cells


def test_a_map_sees_nothing_behind_its_own_walls() -> None:
    for cells in (rooms(seed=3), corridor(slice(80, 110))):
        one = prepared(cells)
        assert seen(one, one) == (0.0, 0.0)


def test_hidden_is_a_strip_behind_walls_and_nothing_else() -> None:
    one = prepared(corridor())
    depth = one.hidden.cells[:, 1] - one.grid.height / 2.0
    # The corridor is 20 cells wide; its rim is the middle of its outermost cells.
    assert np.all(np.abs(depth) >= 9.5 + NEAREST_CELLS)
    assert np.all(np.abs(depth) <= 9.5 + FARTHEST_CELLS)
    assert np.array_equal(np.sign(one.hidden.normals[:, 1]), -np.sign(depth))
    assert len(one.hidden.cells) * one.hidden.cells_per_sample == pytest.approx(2 * 200 * 17, rel=0.1)


def test_what_is_free_beyond_a_door_counts_by_its_share_of_the_walls() -> None:
    """But for some cells at either jamb, whose ends the other map sees from behind."""
    closed = prepared(corridor())
    for width in (40, 80):
        for share in seen(closed, prepared(corridor(slice(80, 80 + width)))):
            assert 0.6 * (width - 10) < 400.0 * share <= width


def test_what_is_seen_near_and_far_behind_walls_is_told_apart() -> None:
    closed = prepared(corridor())
    near, far = seen(closed, prepared(corridor(slice(80, 120), beyond=6)))
    assert (near > 0.0, far) == (True, 0.0)


def test_neither_map_need_be_the_one_that_sees() -> None:
    closed, opened = prepared(corridor()), prepared(corridor(slice(80, 120)))
    assert seen(closed, opened) == pytest.approx(seen(opened, closed), rel=1e-6)


def test_the_room_next_door_is_seen_from_inside_and_hidden_by_its_own_wall() -> None:
    room = flat(100, 200, -1)
    room[62:92] = 0
    room[60:62] = room[92:94] = 100
    assert seen(prepared(corridor()), prepared(room)) == (0.0, 0.0)


def test_a_map_whose_walls_hide_nothing_is_no_error() -> None:
    cells = flat(60, 60, 0)
    cells[28:32, 10:50] = 100
    one = prepared(cells)
    assert len(one.hidden.cells) == 0
    assert seen(one, one, num_walls=0.0) == (0.0, 0.0)
