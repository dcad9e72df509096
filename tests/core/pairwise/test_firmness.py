"""Whether the parts of a map stay where a pose puts them, on walls drawn for it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mapfusion.grid import Cells
from mapfusion.pairwise.firmness import MIN_PART_POINTS, _parts, firmness
from mapfusion.pairwise.poses import inverse
from mapfusion.pairwise.prepared import PreparedMap, prepare
from tests.fakes import flat, grid_of, rooms

AS_IT_IS = np.zeros(3)


def prepared(cells: Cells) -> PreparedMap:
    return prepare(grid_of(cells), 0.1)


def test_parts_of_a_map_stay_where_they_are() -> None:
    place = prepared(rooms(seed=3))
    assert firmness(place, place, AS_IT_IS) > 0.6


@pytest.mark.parametrize("pose", [(2.0, 1.0, 0.01), (-3.0, 4.0, 0.0)])
def test_a_few_cells_off_they_stay_still(pose: tuple[float, float, float]) -> None:
    place = prepared(rooms(seed=3))
    assert firmness(place, place, np.array(pose)) > 0.6


@pytest.mark.parametrize("pose", [(18.0, 0.0, 0.0), (0.0, -18.0, 0.0), (5.0, 5.0, 1.6)])
def test_parts_that_were_carried_along_would_rather_lie_elsewhere(pose: tuple[float, float, float]) -> None:
    place = prepared(rooms(seed=3))
    assert firmness(place, place, np.array(pose)) < 0.1


def test_parts_of_a_corridor_slide() -> None:
    corridor = flat(40, 400, 0)
    corridor[:3] = corridor[-3:] = 100
    straight = prepared(corridor)
    assert firmness(straight, straight, AS_IT_IS) == 0.0


def test_nothing_stays_where_maps_do_not_meet() -> None:
    place = prepared(rooms(seed=3))
    assert firmness(place, place, np.array([1000.0, 0.0, 0.0])) == 0.0


def test_few_walls_in_common_are_no_part() -> None:
    hall = flat(60, 60, 0)
    hall[30, 28:32] = hall[31, 28] = 100
    place = prepared(hall)
    assert 0 < place.num_walls < MIN_PART_POINTS
    assert firmness(place, place, AS_IT_IS) == 0.0


def test_exchanging_the_maps_changes_nothing() -> None:
    one, other = prepared(rooms(seed=3)), prepared(rooms(seed=3)[40:, 30:])
    pose = np.array([30.0, 40.0, 0.0])
    there = firmness(one, other, pose)
    assert there > 0.5
    assert firmness(other, one, inverse(pose[None])[0]) == pytest.approx(there, abs=0.02)


def test_a_turned_map_stays_as_well() -> None:
    place = rooms(seed=3)
    turned = prepared(np.ascontiguousarray(np.rot90(place, -1)))
    pose = np.array([0.0, place.shape[0], -math.pi / 2.0])
    assert firmness(prepared(place), turned, pose) > 0.6


def test_half_a_map_that_was_carried_along_halves_it() -> None:
    place = rooms(seed=3)
    half = place.shape[1] // 2
    moved = place.copy()
    moved[:, half:] = np.roll(place[:, half:], 18, axis=0)
    whole = firmness(prepared(place), prepared(place), AS_IT_IS)
    assert firmness(prepared(place), prepared(moved), AS_IT_IS) == pytest.approx(whole / 2.0, abs=0.15)


@pytest.mark.parametrize(("num_walls", "num_parts"), [(12, 1), (23, 1), (24, 2), (191, 8), (192, 16), (5000, 16)])
def test_few_walls_are_fewer_parts(num_walls: int, num_parts: int) -> None:
    points = np.random.default_rng(0).uniform(0.0, 100.0, (num_walls, 2)).astype(np.float32)
    for turn_rad in (0.0, 0.6):
        ordered, sizes = _parts(points, turn_rad)
        assert len(sizes) == num_parts
        assert np.ptp(sizes) <= 1
        assert sorted(ordered) == list(range(num_walls))
