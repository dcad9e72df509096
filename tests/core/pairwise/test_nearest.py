import cv2
import numpy as np
import pytest

from mapfusion.pairwise.behind import FARTHEST_CELLS
from mapfusion.pairwise.evidence import TOLERANCES_CELLS
from mapfusion.pairwise.nearest import BLOCK_CELLS, FAR, REACH_CELLS, nearest_points
from mapfusion.pairwise.search import WIDE_REACHES
from mapfusion.pairwise.surface import FIELD_MARGIN

Cells = np.ndarray[tuple[int, ...], np.dtype[np.int64]]


def centres(cells: Cells) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """Of (N, 2) rows and columns: x and y."""
    return (cells[:, ::-1] + 0.5).astype(np.float32)


def true_distance(cells: Cells, shape: tuple[int, int]) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    elsewhere = np.ones(shape, np.uint8)
    elsewhere[tuple(cells.T)] = 0
    return np.asarray(cv2.distanceTransform(elsewhere, cv2.DIST_L2, cv2.DIST_MASK_PRECISE), np.float64)


def distance_to(indices: Cells, cells: Cells) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    rows, columns = np.indices(indices.shape)
    return np.asarray(np.hypot(cells[indices, 0] - rows, cells[indices, 1] - columns), np.float64)


@pytest.mark.parametrize("seed", range(6))
def test_within_reach_the_nearest_is_exact_and_its_distance_rounded(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = (int(rng.integers(1, 90)), int(rng.integers(1, 90)))
    number = int(rng.integers(1, max(2, shape[0] * shape[1] // 40)))
    cells = np.stack(np.divmod(np.sort(rng.choice(shape[0] * shape[1], number, replace=False)), shape[1]), -1)
    nearest, distance = nearest_points(centres(cells), shape, 0)
    exact = true_distance(cells, shape)
    within = exact <= REACH_CELLS + 1e-3
    assert np.array_equal(distance < FAR, within)
    np.testing.assert_allclose(distance_to(nearest.astype(np.int64), cells)[within], exact[within], atol=1e-3)
    assert np.array_equal(distance[within], np.floor(exact[within] + 0.5))


def test_beyond_reach_it_is_as_near_but_for_a_block() -> None:
    rng = np.random.default_rng(1)
    cells = np.unique(rng.integers(0, (200, 160), (12, 2)), axis=0)
    nearest, distance = nearest_points(centres(cells), (200, 160), 0)
    exact = true_distance(cells, (200, 160))
    beyond = (distance == FAR) & (exact < BLOCK_CELLS * (REACH_CELLS - 2))
    assert np.count_nonzero(beyond) > 5000
    assert (distance_to(nearest.astype(np.int64), cells) - exact)[beyond].max() <= 2 * BLOCK_CELLS


def test_what_is_too_far_from_all_points_has_some_point() -> None:
    nearest, distance = nearest_points(np.array([[0.5, 0.5]], np.float32), (300, 300), 0)
    assert not nearest.any()
    assert distance[200, 200] == FAR


def test_of_equally_near_points_the_left_one_and_then_the_upper_one_is_taken() -> None:
    nearest, _ = nearest_points(centres(np.array([[0, 5], [5, 0], [5, 10], [10, 5]])), (11, 11), 0)
    assert nearest[5, 5] == 1
    nearest, _ = nearest_points(centres(np.array([[0, 5], [10, 5]])), (11, 11), 0)
    assert nearest[5, 5] == 0


def test_points_are_counted_from_within_the_margin() -> None:
    nearest, distance = nearest_points(np.array([[0.5, 0.5], [3.5, 0.5]], np.float32), (10, 12), 4)
    assert distance[4, 4] == distance[4, 7] == 0
    assert nearest[4, 4] == 0
    assert nearest[4, 7] == 1


def test_walls_are_looked_for_no_farther_than_they_are_found_exactly() -> None:
    assert FIELD_MARGIN == REACH_CELLS
    assert max(*WIDE_REACHES, *TOLERANCES_CELLS, FARTHEST_CELLS) <= REACH_CELLS
