import numpy as np

from mapfusion.newest import NewestGrid
from mapfusion.transform import SE2
from tests.fakes import flat, grid_of


def test_the_middle_and_the_size_of_the_known_area() -> None:
    cells = flat(10, 20)
    cells[2:6, 4:14] = 0
    newest = NewestGrid.of(0, grid_of(cells, 0.5, SE2(1.0, 0.0, 0.0)))
    assert newest.num_known == 40
    assert newest.middle_m.tolist() == [1.0 + 4.5, 2.0]
    assert NewestGrid.of(0, grid_of(flat(3, 3))).num_known == 0


def test_cells_keep_the_time_at_which_they_became_what_they_are_while_the_grid_grows() -> None:
    first = NewestGrid.of(10, grid_of(np.array([[0, 100], [-1, 0]], np.int8), 0.5, SE2(2.0, 3.0, 0.4)))
    # One row and one column more before the old corner, in the grid's own directions.
    corner = SE2(2.0, 3.0, 0.4) @ SE2(-0.5, -0.5, 0.0)
    grown = np.array([[0, 0, 0], [0, 10, 0], [0, 0, 50]], np.int8)
    second = NewestGrid.of(20, grid_of(grown, 0.5, corner), first)
    assert second.version == 2
    assert second.since_ns.tolist() == [[20, 20, 20], [20, 10, 20], [20, 20, 20]]


def test_a_grid_on_another_lattice_starts_anew() -> None:
    first = NewestGrid.of(10, grid_of(flat(4, 4, 0), 0.5))
    for other in (grid_of(flat(4, 4, 0), 0.25), grid_of(flat(4, 4, 0), 0.5, SE2(0.25, 0.0, 0.0))):
        assert (NewestGrid.of(20, other, first).since_ns == 20).all()


def test_grids_that_share_no_cell() -> None:
    first = NewestGrid.of(10, grid_of(flat(4, 4, 0), 0.5))
    assert (NewestGrid.of(20, grid_of(flat(4, 4, 0), 0.5, SE2(50.0, 0.0, 0.0)), first).since_ns == 20).all()


def test_new_cells_and_walls_that_came_or_went_are_counted_over_all_grids_of_a_robot() -> None:
    first = NewestGrid.of(10, grid_of(np.array([[0, 100], [-1, 0]], np.int8)))
    assert (first.num_known, first.num_walls, first.num_new, first.num_turned) == (3, 1, 3, 0)
    same = NewestGrid.of(20, first.grid, first)
    assert (same.num_new, same.num_turned) == (3, 0)
    # A wall that became free, a wall where nothing was known, a free cell that is a little less sure.
    second = NewestGrid.of(30, grid_of(np.array([[40, 0], [100, 0]], np.int8)), same)
    assert (second.num_known, second.num_walls, second.num_new, second.num_turned) == (4, 1, 4, 1)
    third = NewestGrid.of(40, grid_of(np.array([[100, 100], [-1, 0]], np.int8)), second)
    assert (third.num_new, third.num_turned) == (4, 3)


def test_across_a_change_of_the_lattice_the_known_cells_are_compared() -> None:
    first = NewestGrid.of(10, grid_of(flat(4, 4, 0), 0.5))
    shifted = NewestGrid.of(20, grid_of(flat(4, 5, 0), 0.5, SE2(0.2, 0.0, 0.0)), first)
    assert (shifted.num_new, shifted.num_turned) == (16 + 4, 0)
