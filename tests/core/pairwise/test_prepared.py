"""One map made ready: what counts as noise, and what is worked out when it is first asked for."""

from __future__ import annotations

import numpy as np
import pytest

from mapfusion.pairwise.features import num_features
from mapfusion.pairwise.prepared import PreparedMap, prepare
from mapfusion.pairwise.surface import FIELD_MARGIN
from tests.fakes import flat, grid_of, rooms


def box_with_a_hole(has_noise: bool) -> PreparedMap:
    """A room with a solid box in it that holds 3 by 3 free cells, and a speck in its corner or none."""
    cells = flat(60, 80, 100)
    cells[3:-3, 3:-3] = 0
    cells[20:40, 30:50] = 100
    cells[28:31, 38:41] = 0
    if has_noise:
        cells[50, 70] = 100
    return prepare(grid_of(cells), 0.1)


def rim_cells_in_the_box(prepared: PreparedMap) -> int:
    assert prepared.field is not None
    x, y = prepared.field.surface.points.T
    return int(np.count_nonzero((x > 30) & (x < 50) & (y > 20) & (y < 40)))


def test_a_small_hole_is_noise_where_there_is_noise() -> None:
    assert rim_cells_in_the_box(box_with_a_hole(has_noise=False)) == 8
    assert rim_cells_in_the_box(box_with_a_hole(has_noise=True)) == 0


def test_specks_have_no_rim() -> None:
    clean, noisy = (box_with_a_hole(has_noise) for has_noise in (False, True))
    assert noisy.num_walls == clean.num_walls - 8


@pytest.mark.parametrize("radius_cells", [2, 8])
def test_cells_near_keypoints_are_known_once_asked_for(radius_cells: int) -> None:
    prepared = prepare(grid_of(rooms(seed=3)), 0.1)
    near = prepared.near_keypoints(radius_cells)
    columns, rows = (prepared.features.points + FIELD_MARGIN).astype(int).T
    assert near[rows, columns].all()
    assert 0.0 < near.mean() < 0.5
    assert prepared.near_keypoints(radius_cells) is near


def test_a_map_with_many_walls_gets_more_keypoints() -> None:
    assert [num_features(walls) for walls in (0, 4999, 5000, 10000, 10**7)] == [500, 500, 1000, 2000, 4000]
    cells = flat(500, 500, 0)
    for row, column, height, width in np.random.default_rng(1).integers(4, (480, 480, 9, 9), (900, 4)):
        cells[row : row + height, column : column + width] = 100
    small, large = prepare(grid_of(cells[:120]), 0.1), prepare(grid_of(cells), 0.1)
    assert small.more_features is small.features
    assert len(large.features) < 600
    assert len(large.more_features) > 3000
