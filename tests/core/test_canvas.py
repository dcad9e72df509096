import numpy as np

from mapfusion.canvas import fitting
from mapfusion.config import Blend
from mapfusion.merge import merge_grids
from mapfusion.transform import SE2
from tests.fakes import flat, grid_of

MAP = grid_of(flat(20, 20, 0))  # 2 m x 2 m


def at(*places: tuple[float, float]) -> list[SE2]:
    return [SE2(x_m, y_m, 0.0) for x_m, y_m in places]


def test_all_fit_where_there_is_room() -> None:
    assert fitting([MAP] * 3, at((0, 0), (2, 0), (4, 0)), None, 20 * 60) == [0, 1, 2]


def test_the_farthest_go_first() -> None:
    places = at((0, 0), (500, 0), (2, 0), (-90, 0), (4, 0))
    assert fitting([MAP] * 5, places, None, 20 * 60) == [0, 2, 4]
    assert fitting([MAP] * 5, places, None, 20 * 1000) == [0, 2, 3, 4]


def test_of_equally_far_ones_the_later_goes_first() -> None:
    assert fitting([MAP] * 2, at((0, 0), (500, 0)), None, 1000) == [0]


def test_a_map_that_is_too_large_by_itself_goes_before_all_others() -> None:
    large = grid_of(flat(100, 100, 0))
    assert fitting([large, MAP, MAP], at((0, 0), (0, 0), (2, 0)), None, 2000) == [1, 2]
    assert fitting([large], at((0, 0)), None, 2000) == []


def test_unknown_borders_take_no_room() -> None:
    cells = flat(200, 200)
    cells[90:110, 90:110] = 0
    assert fitting([MAP, grid_of(cells)], at((0, 0), (-9, -9)), None, 400) == [0, 1]


def test_a_map_without_known_cells_takes_no_room() -> None:
    assert fitting([MAP, grid_of(flat(9, 9))], at((0, 0), (500, 0)), None, 400) == [0, 1]


def test_what_fits_can_be_merged() -> None:
    rng = np.random.default_rng(0)
    sides, sizes_m = rng.integers(5, 30, 8), rng.choice([0.05, 0.1, 0.2], 8)
    grids = [grid_of(flat(side, 2 * side, 0), size_m) for side, size_m in zip(sides, sizes_m, strict=True)]
    blend: Blend = "max"
    for _ in range(50):
        poses = [SE2(x_m, y_m, yaw_rad) for x_m, y_m, yaw_rad in rng.uniform(-20, 20, (8, 3))]
        limit = int(rng.integers(1000, 200_000))
        chosen = fitting(grids, poses, None, limit)
        if chosen:
            merge_grids([grids[i] for i in chosen], [poses[i] for i in chosen], blend, None, 0, max_cells=limit)
