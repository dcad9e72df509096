"""Walls as a robot sees them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mapfusion.grid import Mask
from mapfusion.pairwise.prepared import prepare
from mapfusion.pairwise.refine import cells_below
from mapfusion.pairwise.surface import (
    FIELD_MARGIN,
    MAX_DEPTH,
    NOT_KNOWN,
    POCKET_CELLS,
    SPECKLE_CELLS,
    _small_islands,
    disc_around,
    extract_surface,
    remove_pockets,
    remove_speckle,
    smooth_walls,
    surface_field,
    widen_free,
)
from tests.fakes import grid_of


def mask(*rows: str) -> Mask:
    return np.array([[c == "#" for c in row] for row in rows])


def test_rim_lies_on_the_free_side_and_normals_point_into_free_space() -> None:
    walls = np.zeros((30, 40), np.bool_)
    walls[14:17] = True
    free = ~walls
    surface = extract_surface(walls, free)
    below, above = surface.points[:, 1] < 15, surface.points[:, 1] > 15
    assert np.unique(surface.points[:, 1]).tolist() == [13.5, 17.5]
    np.testing.assert_allclose(surface.normals[below], [[0.0, -1.0]] * int(below.sum()), atol=1e-5)
    np.testing.assert_allclose(surface.normals[above], [[0.0, 1.0]] * int(above.sum()), atol=1e-5)


def test_wall_beside_unknown_has_one_side_only() -> None:
    walls = np.zeros((30, 40), np.bool_)
    walls[14:17] = True
    free = np.zeros_like(walls)
    free[:14] = True
    assert np.unique(extract_surface(walls, free).points[:, 1]).tolist() == [13.5]


def test_single_unknown_cell_between_wall_and_free_is_closed_but_two_are_not() -> None:
    walls = mask("....", "####", "....", "....", "....")
    one_apart = mask("....", "....", "....", "####", "####")
    two_apart = mask("....", "....", "....", "....", "####")
    assert widen_free(walls, one_apart)[2].all()
    np.testing.assert_array_equal(widen_free(walls, two_apart), two_apart)


def test_specks_go_and_walls_stay() -> None:
    walls = np.zeros((40, 40), np.bool_)
    walls[10:13, 5:35] = True
    with_noise = walls.copy()
    with_noise[25, 20 : 20 + SPECKLE_CELLS - 1] = True
    np.testing.assert_array_equal(remove_speckle(with_noise, np.ones_like(walls)), walls)


def test_a_wall_that_noise_broke_up_stays_and_noise_as_such_goes() -> None:
    rng = np.random.default_rng(7)
    along = np.arange(10, 190)
    broken = np.zeros((200, 200), np.bool_)
    broken[100 + rng.integers(-1, 2, len(along)), along + rng.integers(-1, 2, len(along))] = True
    noise = rng.random(broken.shape) < 0.03
    noise[80:121] = False
    kept = remove_speckle(broken | noise, np.ones_like(broken))
    assert kept[broken].mean() > 0.75
    assert kept[noise].mean() < 0.05


def test_the_broken_edge_of_what_is_known_stays_and_a_lone_cell_beyond_it_goes() -> None:
    rng = np.random.default_rng(3)
    along = np.arange(10, 90)
    walls, known = np.zeros((100, 100), np.bool_), np.zeros((100, 100), np.bool_)
    known[:50] = True
    walls[50 + rng.integers(-1, 2, len(along)), along] = True
    lone = np.zeros_like(walls)
    lone[80, 50] = True
    kept = remove_speckle(walls | lone, known | walls | lone)
    assert kept[walls].mean() > 0.95
    assert not kept[lone].any()


def test_pockets_of_free_space_go_and_passages_stay() -> None:
    open_space = np.zeros((30, 30), np.bool_)
    open_space[2:12, 2:28] = True
    open_space[12:25, 5] = True  # a passage of one cell
    with_noise = open_space.copy()
    with_noise[[15, 15, 16, 17, 18], [20, 21, 20, 19, 18]] = True
    with_noise[12, 28] = True  # touches the open space at a corner only
    np.testing.assert_array_equal(remove_pockets(with_noise), open_space)
    with_room = open_space.copy()
    with_room[15:18, 20:24] = True
    np.testing.assert_array_equal(remove_pockets(with_room), with_room)


@pytest.mark.parametrize("seed", range(4))
def test_a_noisy_wall_is_seen_from_where_it_was_seen_only(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cells = np.zeros((60, 200), np.int8)
    cells[36:] = -1
    walls = rng.integers(-1, 2, (2, 6, 200)) + np.mgrid[30:36, 0:200]  # each cell moved by up to one
    cells[30:36] = 0
    cells[walls[0], walls[1].clip(0, 199)] = 100
    prepared = prepare(grid_of(cells), 0.1)
    assert prepared.field is not None
    assert (prepared.field.surface.points[:, 1] <= 31.5).all()
    assert (prepared.field.surface.normals[:, 1] < 0.0).all()


def test_pores_of_a_wall_are_filled() -> None:
    walls = np.zeros((40, 40), np.bool_)
    walls[10:13, 5:35] = True
    porous = walls.copy()
    porous[11, 20] = porous[12, 8] = False
    np.testing.assert_array_equal(smooth_walls(porous, ~porous), walls)


def test_a_rough_wall_has_about_as_much_rim_as_a_smooth_one() -> None:
    walls = np.zeros((120, 120), np.bool_)
    walls[50:60, 10:110] = True
    rows, cols = np.nonzero(walls)
    rng = np.random.default_rng(0)
    rough = np.zeros_like(walls)
    rough[rows + rng.integers(-1, 2, len(rows)), cols + rng.integers(-1, 2, len(cols))] = True
    lengths = []
    for noisy in (walls, rough):
        smooth = smooth_walls(noisy, ~noisy)
        lengths.append(len(extract_surface(smooth, widen_free(smooth, ~noisy))))
    assert lengths[1] < 1.3 * lengths[0]
    assert len(extract_surface(rough, ~rough)) > 2 * lengths[0]


def test_only_free_cells_are_filled() -> None:
    walls = np.zeros((20, 20), np.bool_)
    walls[8:13, 4:16] = True
    walls[10, 10] = False
    unknown = np.zeros_like(walls)
    np.testing.assert_array_equal(smooth_walls(walls, unknown), walls)
    assert smooth_walls(walls, ~walls)[10, 10]


def test_a_filled_cell_is_not_free() -> None:
    walls = mask("....", "####", "....", "....")
    assert not widen_free(walls, np.ones_like(walls))[1].any()


@pytest.mark.parametrize(("radius_cells", "num_cells"), [(2, 13), (4, 49), (8, 197)])
def test_discs_around_points_hold_the_cells_within_their_radius(radius_cells: int, num_cells: int) -> None:
    near = disc_around(np.array([[5.5, 3.5]], np.float32), (10, 20), radius_cells)
    m = FIELD_MARGIN
    assert near.shape == (10 + 2 * m, 20 + 2 * m)
    assert near.sum() == num_cells  # the lattice points of a circle: Gauss's problem
    assert near[3 + m, 5 + m - radius_cells] == near[3 + m + radius_cells, 5 + m] == 1
    assert not disc_around(np.zeros((0, 2), np.float32), (10, 20), radius_cells).any()


def test_field_names_the_nearest_point_and_the_depth_of_free_space() -> None:
    walls = np.zeros((40, 60), np.bool_)
    walls[:, 10:12] = True
    free = np.zeros_like(walls)
    free[:, 12:40] = True
    surface = extract_surface(walls, free)
    field = surface_field(surface, free, walls | free)
    (cells,) = cells_below(field, np.array([[20.5, 20.5], [55.5, 20.5], [9.5, 20.5]], np.float32), np.zeros((1, 3)))
    np.testing.assert_allclose(surface.points[field.nearest.ravel()[cells]], [[12.5, 20.5]] * 3)
    (rim,) = cells_below(field, surface.points, np.zeros((1, 3)))
    assert field.nearest.ravel()[rim].tolist() == list(range(len(surface)))
    depth = field.depth.ravel()[cells]
    assert depth[0] == pytest.approx(9, abs=1)
    assert depth[1] == NOT_KNOWN
    outside = np.array([[-1e6, 1e6], [1e6, -1e6]], np.float32)
    assert (field.depth.ravel()[cells_below(field, outside, np.zeros((1, 3)))] == NOT_KNOWN).all()
    assert field.nearest.shape == (40 + 2 * FIELD_MARGIN, 60 + 2 * FIELD_MARGIN)


def test_depth_is_nearly_round_whatever_the_direction() -> None:
    walls = np.zeros((61, 61), np.bool_)
    walls[30, 30] = True
    field = surface_field(extract_surface(walls, ~walls), ~walls, np.ones_like(walls))
    inner = np.s_[FIELD_MARGIN + MAX_DEPTH : -FIELD_MARGIN - MAX_DEPTH]
    depth = field.depth[inner, inner].astype(np.float64)
    rows, cols = np.indices(depth.shape) - depth.shape[0] // 2
    distance = np.hypot(rows, cols)
    within = distance < MAX_DEPTH - 1
    assert np.abs(depth - distance)[within].max() <= 1.0
    assert (depth[distance >= MAX_DEPTH + 1] == MAX_DEPTH).all()


def test_depth_agrees_with_the_distance_transform() -> None:
    rng = np.random.default_rng(3)
    free = np.ones((120, 150), np.bool_)
    for row, col, height, width in rng.integers(3, 100, (12, 4)):
        free[row : row + height // 8, col : col + width // 8] = False
    walls = ~free
    field = surface_field(extract_surface(walls, free), free, np.ones_like(free))
    inside = np.s_[FIELD_MARGIN:-FIELD_MARGIN]
    padded = np.pad(free, 1).view(np.uint8)
    distance = cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    off = np.abs(field.depth[inside, inside] - np.minimum(distance, MAX_DEPTH))
    assert off.max() <= 1.3
    assert off.mean() <= 0.5


@given(hnp.arrays(np.bool_, hnp.array_shapes(min_dims=2, max_dims=2, max_side=12)), st.booleans())
def test_small_islands_are_those_of_few_connected_cells(mask: Mask, is_diagonal: bool) -> None:
    least_cells = SPECKLE_CELLS if is_diagonal else POCKET_CELLS
    _, labels = cv2.connectedComponents(mask.view(np.uint8), connectivity=8 if is_diagonal else 4)
    is_small = np.bincount(labels.ravel()) < least_cells
    is_small[0] = False
    assert sorted(_small_islands(mask, least_cells, is_diagonal)) == np.flatnonzero(is_small[labels]).tolist()
