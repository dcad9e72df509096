"""A map in one byte a cell."""

from __future__ import annotations

import numpy as np
import pytest

from mapfusion.pairwise.prepared import PreparedMap, prepare
from mapfusion.pairwise.sketch import AGREES, CONTRADICTS, KNOWN, lying_well, summed_meetings
from mapfusion.pairwise.surface import DIRECTION_BINS, FIELD_MARGIN
from tests.fakes import flat, grid_of


@pytest.fixture(scope="module")
def room() -> PreparedMap:
    """Free from 20 to 80 in both directions, two cells of wall around, unknown beyond."""
    cells = flat(100, 100, -1)
    cells[18:82, 18:82] = 100
    cells[20:80, 20:80] = 0
    return prepare(grid_of(cells), 0.1)


def met(room: PreparedMap, x: int, y: int, facing_deg: float) -> int:
    """What a wall at a cell of the room, counted from its outermost wall cell, meets there."""
    cell = np.array([(y + FIELD_MARGIN) * room.sketch.shape[1] + x + FIELD_MARGIN], np.int32)
    east, turns_rad = np.zeros(1, np.float32), np.radians([facing_deg, facing_deg + 360.0])
    turned, whole_turn_more = summed_meetings(room.sketch, cell[None].repeat(2, axis=0), east, turns_rad).tolist()
    assert turned == whole_turn_more
    ((well,),) = lying_well(room.sketch, cell, np.zeros(1, np.int32), east, float(turns_rad[0])).tolist()
    assert well == turned % CONTRADICTS // AGREES - turned // CONTRADICTS
    return int(turned)


def test_a_wall_agrees_near_a_wall_that_faces_alike(room: PreparedMap) -> None:
    # 30 cells up the left wall, which faces right.
    assert met(room, 3, 32, 0.0) == met(room, 3, 32, 45.0) == KNOWN + AGREES
    assert met(room, 3, 32, 90.0) == met(room, 3, 32, 180.0) == KNOWN


def test_a_wall_in_the_middle_of_free_space_contradicts(room: PreparedMap) -> None:
    assert {met(room, 32, 32, facing) for facing in (0.0, 90.0, 200.0)} == {KNOWN + CONTRADICTS}


def test_what_is_unknown_says_nothing(room: PreparedMap) -> None:
    assert met(room, -8, 32, 0.0) == 0


def test_directions_are_those_of_the_normals(room: PreparedMap) -> None:
    assert room.field is not None
    facing = room.field.surface.facing * (2.0 * np.pi / DIRECTION_BINS)
    normals = np.stack([np.cos(facing), np.sin(facing)], axis=-1)
    np.testing.assert_allclose(normals, room.field.surface.normals, atol=1e-5)
