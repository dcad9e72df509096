import math

import numpy as np
import pytest

from mapfusion.layer import lay
from mapfusion.transform import SE2
from tests.fakes import flat, grid_of, rooms


def test_a_layer_covers_its_map_and_little_more() -> None:
    cells = rooms(40, 60)
    layer = lay(grid_of(cells), SE2(3.0, 2.0, 0.0), 0.1, (500, 500), smooth=False)
    assert layer.row in (18, 19)
    assert layer.col in (28, 29)
    rows, cols = layer.box
    assert rows.stop - rows.start <= 40 + 4
    assert cols.stop - cols.start <= 60 + 4
    np.testing.assert_array_equal(layer.cells[20 - layer.row :, 30 - layer.col :][:40, :60], cells)


@pytest.mark.parametrize("yaw_rad", [0.3, math.pi / 2, -2.0])
def test_no_known_cell_of_a_turned_map_is_cut_off(yaw_rad: float) -> None:
    layer = lay(grid_of(flat(30, 50, 0)), SE2(8.0, 8.0, yaw_rad), 0.1, (160, 160), smooth=False)
    assert abs(int((layer.cells == 0).sum()) - 1500) <= 60


def test_a_layer_stays_on_its_canvas() -> None:
    layer = lay(grid_of(flat(20, 20, 0)), SE2.identity(), 0.1, (20, 20), smooth=False)
    assert (layer.row, layer.col, layer.cells.shape) == (0, 0, (20, 20))
