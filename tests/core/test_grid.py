import numpy as np
import pytest

from mapfusion.grid import OccupancyGrid, apply_update, crop_to_known, quarter_turned, resample
from mapfusion.transform import SE2
from tests.fakes import flat, grid_of


def test_cells_are_read_only_and_checked() -> None:
    grid = grid_of(flat(2, 3, 0))
    assert (grid.height, grid.width) == (2, 3)
    with pytest.raises(ValueError, match="read-only"):
        grid.cells[0, 0] = 1


@pytest.mark.parametrize(
    ("cells", "resolution_m"),
    [
        (np.zeros((2, 2), np.int16), 0.1),
        (np.zeros(4, np.int8), 0.1),
        (np.zeros((0, 3), np.int8), 0.1),
        (np.full((1, 1), 101, np.int8), 0.1),
        (np.full((1, 1), -2, np.int8), 0.1),
        (np.zeros((1, 1), np.int8), 0.0),
        (np.zeros((1, 1), np.int8), float("nan")),
    ],
)
def test_impossible_grids_are_refused(cells: np.ndarray, resolution_m: float) -> None:
    with pytest.raises(ValueError, match="must"):
        OccupancyGrid(cells, resolution_m, SE2.identity())


def test_lists_are_no_cells() -> None:
    with pytest.raises(ValueError, match="numpy"):
        OccupancyGrid([[0, 100]], 0.1, SE2.identity())  # type: ignore[arg-type]


def test_cell_centres_honour_the_origin_and_its_yaw() -> None:
    cells = flat(2, 2, 0)
    cells[0, 1] = 100
    grid = grid_of(cells, 0.5, SE2(10.0, 20.0, np.pi / 2))
    # Column 1, row 0: (0.75, 0.25) in the grid; a quarter turn makes it (-0.25, 0.75).
    np.testing.assert_allclose(grid.centres_m(grid.walls), [[9.75, 20.75]])


def test_classes_of_cells() -> None:
    grid = grid_of(np.array([[-1, 0, 25, 26, 64, 65, 100]], np.int8))
    assert grid.known.tolist() == [[False, True, True, True, True, True, True]]
    assert grid.free.tolist() == [[False, True, True, False, False, False, False]]
    assert grid.walls.tolist() == [[False, False, False, False, False, True, True]]


def test_cropping_keeps_every_known_cell_where_it_is() -> None:
    cells = flat(20, 30)
    cells[5:9, 7:20] = 0
    cells[6, 10] = 100
    grid = grid_of(cells, 0.1, SE2(1.0, 2.0, 0.7))
    cropped = crop_to_known(grid)
    assert cropped.cells.shape == (4, 13)
    np.testing.assert_allclose(cropped.centres_m(cropped.walls), grid.centres_m(grid.walls), atol=1e-12)
    assert crop_to_known(grid, margin=100).cells.shape == grid.cells.shape


def test_an_unknown_grid_is_not_cropped() -> None:
    grid = grid_of(flat(3, 4))
    assert crop_to_known(grid) is grid


def test_an_update_replaces_its_cells_only() -> None:
    grid = apply_update(grid_of(flat(4, 5, 0)), col=2, row=1, patch=flat(2, 3, 100), stamp_ns=7)
    expected = flat(4, 5, 0)
    expected[1:3, 2:5] = 100
    np.testing.assert_array_equal(grid.cells, expected)
    assert grid.stamp_ns == 7


@pytest.mark.parametrize(("col", "row"), [(-1, 0), (0, -1), (3, 0), (0, 3)])
def test_an_update_beyond_the_grid_is_refused(col: int, row: int) -> None:
    with pytest.raises(ValueError, match="beyond"):
        apply_update(grid_of(flat(4, 5, 0)), col, row, flat(2, 3, 100), 0)


def test_coarser_keeps_thin_walls_and_knows_what_was_known() -> None:
    cells = flat(4, 6)
    cells[:, :4] = 0
    cells[1, 2] = 100
    coarse = resample(grid_of(cells, 0.05), 0.1)
    np.testing.assert_array_equal(coarse.cells, [[0, 100, -1], [0, 0, -1]])
    assert coarse.resolution_m == 0.1


def test_finer_repeats_cells_and_back_gives_the_same() -> None:
    cells = np.array([[0, 100, -1], [50, 7, 0]], np.int8)
    fine = resample(grid_of(cells, 0.1), 0.05)
    np.testing.assert_array_equal(fine.cells, np.kron(cells, np.ones((2, 2), np.int8)))
    np.testing.assert_array_equal(resample(fine, 0.1).cells, cells)


def test_rounding_of_32_bit_resolutions_changes_nothing() -> None:
    grid = grid_of(flat(100, 100, 0), float(np.float32(0.05)))
    assert resample(grid, 0.05) is grid


def test_odd_ratios_cover_the_whole_grid() -> None:
    cells = flat(10, 10, 0)
    cells[9, 9] = 100
    coarse = resample(grid_of(cells, 0.05), 0.12)
    assert coarse.cells.shape == (5, 5)
    assert coarse.cells[4, 4] == 100


@pytest.mark.parametrize("quarters", range(5))
def test_quarter_turns_keep_every_cell_where_it_is(quarters: int) -> None:
    cells = np.array([[-1, 0, 100, 30], [100, 100, -1, 0]], np.int8)
    grid = OccupancyGrid(cells, 0.5, SE2(3.0, -2.0, 0.7))
    turned = quarter_turned(grid, quarters)
    np.testing.assert_array_equal(turned.cells, np.rot90(cells, quarters))
    for value in (-1, 0, 30, 100):
        here, there = (one.centres_m(one.cells == value) for one in (grid, turned))
        gaps = np.linalg.norm(here[:, None] - there, axis=-1)
        assert here.shape == there.shape
        assert gaps.min(axis=1).max() < 1e-9
