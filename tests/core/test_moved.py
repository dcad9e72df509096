import numpy as np
import pytest

from mapfusion.merge import merge_grids
from mapfusion.transform import SE2
from tests.fakes import flat, grid_of, rooms

T = SE2(1.0, 2.0, 0.7)


def merged_value(first_seen_s: int, second_seen_s: int, size: int, *, swapped: bool = False) -> int:
    """What becomes of a thing of `size` cells that one map has and the other shows as free floor."""
    place = rooms(120, 120)
    place[30:90, 30:90] = 0
    with_thing = place.copy()
    with_thing[60 : 60 + size, 60 : 60 + size] = 100
    maps = [grid_of(with_thing), grid_of(place)]
    since = [np.full(place.shape, seen * 10**9, np.int64) for seen in (first_seen_s, second_seen_s)]
    if swapped:
        maps, since = maps[::-1], since[::-1]
    merged = merge_grids(maps, [SE2.identity()] * 2, "log-odds", None, 0, since)
    return int(merged.cells[60 + size // 2, 60 + size // 2])


@pytest.mark.parametrize("swapped", [False, True])
def test_a_robot_sized_thing_fades_where_a_later_view_is_free(swapped: bool) -> None:
    assert merged_value(5, 50, size=5, swapped=swapped) == 0


def test_a_thing_that_came_later_stays() -> None:
    assert merged_value(50, 5, size=5) >= 65


def test_a_large_thing_stays() -> None:
    assert merged_value(5, 50, size=20) >= 65


def test_a_wall_that_lies_a_little_off_stays() -> None:
    a, b = flat(60, 60, 0), flat(60, 60, 0)
    a[30, 10:20], b[32, 10:20] = 100, 100
    since = [np.zeros(a.shape, np.int64), np.ones(b.shape, np.int64)]
    merged = merge_grids([grid_of(a), grid_of(b)], [T, T], "log-odds", None, 0, since)
    assert merged.walls.sum() >= 18
