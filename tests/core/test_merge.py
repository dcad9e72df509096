import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapfusion.merge import merge_grids
from mapfusion.transform import SE2
from tests.fakes import flat, grid_of, rooms, seen_from

AT_HOME = SE2.identity()


@pytest.mark.parametrize("blend", ["log-odds", "max", "paper"])
def test_one_map_in_its_own_frame_is_that_map(blend: str) -> None:
    cells = rooms(60, 80)
    cells[:5, :7] = 37
    grid = grid_of(cells, 0.1, SE2(1.2, -0.7, 0.0))
    merged = merge_grids([grid], [AT_HOME], blend, None, 5)  # type: ignore[arg-type]
    np.testing.assert_array_equal(merged.cells, cells)
    assert (merged.T_frame_grid.x_m, merged.T_frame_grid.y_m) == pytest.approx((1.2, -0.7))
    assert merged.stamp_ns == 5


def test_a_quarter_turn_moves_every_cell_exactly() -> None:
    cells = rooms(60, 80)
    merged = merge_grids([grid_of(cells)], [SE2(6.0, 0.0, math.pi / 2)], "log-odds", None, 0)
    np.testing.assert_array_equal(merged.cells, cells.T[:, ::-1])


def test_the_order_of_maps_does_not_matter() -> None:
    place = rooms()
    poses = [SE2(2.0, 3.0, 0.0), SE2(8.0, 4.0, 0.9), SE2(20.0, 15.0, 2.5)]
    maps = [seen_from(place, pose, (150, 150)) for pose in poses]
    one = merge_grids(maps, poses, "log-odds", None, 0)
    other = merge_grids(maps[::-1], poses[::-1], "log-odds", None, 0)
    np.testing.assert_array_equal(one.cells, other.cells)
    assert one.T_frame_grid == other.T_frame_grid


@pytest.mark.parametrize("blend", ["log-odds", "max", "paper"])
def test_walls_of_rotated_maps_lie_where_the_place_has_them(blend: str) -> None:
    place = rooms()
    poses = [SE2(1.0, 1.0, 0.3), SE2(14.0, 3.0, 1.0)]
    maps = [seen_from(place, pose, (180, 180)) for pose in poses]
    merged = merge_grids(maps, poses, blend, None, 0)  # type: ignore[arg-type]
    walls = np.argwhere(place >= 65)
    found = merged.centres_m(merged.walls) / 0.1 - 0.5
    distance = np.abs(found[:, None, ::-1] - walls[None]).max(axis=2).min(axis=1)
    assert np.quantile(distance, 0.99) <= 1.0
    assert found.shape[0] > 1000


def test_what_no_map_knows_stays_unknown_and_what_one_knows_keeps_its_value() -> None:
    a, b = flat(10, 10), flat(10, 10)
    a[2, 3], b[7, 8] = 42, 9
    merged = merge_grids([grid_of(a), grid_of(b)], [AT_HOME, AT_HOME], "log-odds", None, 0)
    assert sorted(merged.cells[merged.known].tolist()) == [9, 42]


@pytest.mark.parametrize(
    ("values", "low", "high"),
    [
        ((0, 0), 0, 5),
        ((100, 100), 95, 100),
        ((50, 50), 50, 50),
        ((100, 0), 65, 95),
        ((0, 0, 100), 0, 45),
        ((80, 80), 81, 99),
    ],
)
def test_evidence_of_several_maps_is_weighed(values: tuple[int, ...], low: int, high: int) -> None:
    maps = [grid_of(flat(3, 3, value)) for value in values]
    merged = merge_grids(maps, [AT_HOME] * len(maps), "log-odds", None, 0)
    assert low <= merged.cells[1, 1] <= high


def test_the_finest_resolution_is_kept_and_another_can_be_asked_for() -> None:
    fine, coarse = grid_of(flat(40, 40, 0), 0.05), grid_of(flat(20, 20, 0), 0.1)
    assert merge_grids([coarse, fine], [AT_HOME] * 2, "max", None, 0).resolution_m == 0.05
    asked = merge_grids([coarse, fine], [AT_HOME] * 2, "max", 0.2, 0)
    assert asked.resolution_m == 0.2
    np.testing.assert_array_equal(asked.cells, flat(10, 10, 0))


def test_maps_without_a_known_cell_make_one_unknown_cell() -> None:
    merged = merge_grids([grid_of(flat(5, 5))], [AT_HOME], "log-odds", None, 0)
    np.testing.assert_array_equal(merged.cells, [[-1]])


@settings(max_examples=30)
@given(st.floats(-50, 50), st.floats(-50, 50), st.floats(-3.2, 3.2))
def test_the_lattice_never_moves_and_no_known_area_is_lost(x_m: float, y_m: float, yaw_rad: float) -> None:
    merged = merge_grids([grid_of(flat(30, 20, 0))], [SE2(x_m, y_m, yaw_rad)], "log-odds", None, 0)
    corner = np.array([merged.T_frame_grid.x_m, merged.T_frame_grid.y_m]) / 0.1
    np.testing.assert_allclose(corner, np.rint(corner), atol=1e-6)
    assert abs(int(merged.known.sum()) - 600) <= 60
