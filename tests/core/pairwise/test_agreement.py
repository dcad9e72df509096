from __future__ import annotations

import math

import numpy as np
import pytest

from mapfusion.grid import Cells, OccupancyGrid, resample
from mapfusion.pairwise.agreement import agreement, mae_band
from mapfusion.transform import SE2

IDENTITY = SE2.identity()


def grid(cells: Cells, resolution_m: float = 0.05, T_frame_grid: SE2 = IDENTITY) -> OccupancyGrid:
    return OccupancyGrid(cells, resolution_m, T_frame_grid)


def uniform(percent: int, height: int = 40, width: int = 60) -> Cells:
    return np.full((height, width), percent, np.int8)


def rooms(seed: int, height: int = 120, width: int = 150) -> Cells:
    """Free rooms with walls three cells thick, unknown outside of a random box."""
    rng = np.random.default_rng(seed)
    cells = np.full((height, width), -1, np.int8)
    top, left = rng.integers(2, 12, 2)
    cells[top : height - 8, left : width - 6] = 0
    for row in rng.integers(top, height - 12, 4):
        cells[row : row + 3, left : width - 6] = 100
    for col in rng.integers(left, width - 10, 5):
        cells[top : height - 8, col : col + 3] = rng.integers(60, 101)
    return cells


def test_a_map_agrees_with_itself_exactly() -> None:
    one = grid(rooms(0), T_frame_grid=SE2(12.3, -4.5, 0.7))
    found = agreement(one, one, IDENTITY)
    assert found.mae == 0.0
    assert found.overlap_cells == np.count_nonzero(one.known)
    assert found.overlap_ratio == 1.0
    assert found.resolution_m == 0.05
    assert found.band == "good"


@pytest.mark.parametrize(("one", "other"), [(0, 100), (100, 0), (10, 43), (50, 51), (37, 37)])
def test_a_known_difference_is_found_to_a_tenth_of_a_grey_level(one: int, other: int) -> None:
    found = agreement(grid(uniform(one)), grid(uniform(other)), SE2(0.31, -0.17, 0.4))
    assert found.mae == pytest.approx(2.55 * abs(one - other), abs=0.1)


def test_half_of_the_cells_differing_halves_the_error() -> None:
    target, source = uniform(0), uniform(0)
    source[:, :30] = 100
    assert agreement(grid(target), grid(source), IDENTITY).mae == pytest.approx(127.5, abs=1e-9)


def test_unknown_is_never_a_value() -> None:
    target, source = uniform(50), uniform(50)
    target[5:9, 10:20] = -1
    source[20:30, 30:45] = -1
    found = agreement(grid(target), grid(source), IDENTITY)
    assert found.mae == 0.0
    assert found.overlap_cells == 40 * 60 - 4 * 10 - 10 * 15
    # A source between cells would mix its unknown cells in, if they had a value.
    assert agreement(grid(target), grid(source), SE2(0.02, 0.013, 0.3)).mae == 0.0


def test_poses_of_the_grids_are_honoured() -> None:
    cells = rooms(1)
    T_world_a, T_world_b = SE2(1.0, 2.0, 0.4), SE2(-30.0, 7.0, -2.5)
    # The same cells lie in two frames, each grid at its own pose in its frame.
    one, other = grid(cells, T_frame_grid=SE2(3.0, -1.0, 1.1)), grid(cells, T_frame_grid=SE2(-8.0, 20.0, 2.9))
    T_a_b = one.T_frame_grid @ other.T_frame_grid.inverse()
    found = agreement(one, other, T_a_b)
    assert found.mae == pytest.approx(0.0, abs=1e-6)
    assert found.overlap_cells == np.count_nonzero(cells != -1)
    worse = agreement(one, other, T_world_a.inverse() @ T_world_b)
    assert worse.mae is None or worse.mae > 5.0


def test_a_quarter_turn_of_the_cells_is_a_quarter_turn_of_the_frame() -> None:
    cells = rooms(2)
    turned = np.ascontiguousarray(np.rot90(cells, -1))  # rows grow with +y: this turns counter-clockwise
    T = SE2(cells.shape[0] * 0.05, 0.0, math.pi / 2)
    found = agreement(grid(turned), grid(cells), T)
    assert found.mae == pytest.approx(0.0, abs=1e-6)
    assert found.overlap_cells == np.count_nonzero(cells != -1)


def test_bilinear_sampling_matches_a_plain_loop() -> None:
    target, source = rooms(3, 60, 50), rooms(4, 50, 60)
    T = SE2(0.7, -0.4, 0.5)
    inverse = T.inverse().matrix()
    differences = []
    for row, col in zip(*np.nonzero(target != -1), strict=True):
        x, y, _ = inverse @ [(col + 0.5) * 0.05, (row + 0.5) * 0.05, 1.0] / 0.05 - 0.5
        c, r = math.floor(x), math.floor(y)
        if not (0 <= c < 59 and 0 <= r < 49) or (source[r : r + 2, c : c + 2] == -1).any():
            continue
        across, up = np.array([1 - (x - c), x - c]), np.array([1 - (y - r), y - r])
        differences.append(2.55 * abs(float(target[row, col]) - up @ source[r : r + 2, c : c + 2] @ across))
    found = agreement(grid(target), grid(source), T)
    assert found.overlap_cells == pytest.approx(len(differences), abs=3)
    assert found.mae == pytest.approx(np.mean(differences), abs=0.2)


@pytest.mark.parametrize("seed", range(6))
def test_swapped_maps_agree_alike(seed: int) -> None:
    one = grid(rooms(seed), T_frame_grid=SE2(5.0, 1.0, 0.3))
    other = grid(rooms(seed), T_frame_grid=SE2(-2.0, 3.0, 2.0))
    T = one.T_frame_grid @ SE2(0.11 * seed, -0.07 * seed, 0.02 + 0.15 * seed) @ other.T_frame_grid.inverse()
    found, swapped = agreement(one, other, T), agreement(other, one, T.inverse())
    assert found.mae is not None
    assert swapped.mae == pytest.approx(found.mae, abs=1.0)
    assert swapped.overlap_cells == pytest.approx(found.overlap_cells, rel=0.01)
    assert swapped.overlap_ratio == pytest.approx(found.overlap_ratio, abs=0.01)


def test_maps_of_different_resolution_are_compared_at_the_coarser_one() -> None:
    fine = grid(rooms(5), 0.05, SE2(3.0, 4.0, 0.6))
    coarse = resample(fine, 0.10)
    for found in (agreement(fine, coarse, IDENTITY), agreement(coarse, fine, IDENTITY)):
        assert found.resolution_m == 0.10
        assert found.mae == pytest.approx(0.0, abs=1e-9)
        assert found.overlap_cells == np.count_nonzero(coarse.known)


def test_the_overlap_ratio_is_that_of_the_smaller_map() -> None:
    large, small = grid(uniform(0, 40, 60)), grid(uniform(0, 20, 20))
    inside = agreement(large, small, SE2(0.5, 0.5, 0.0))
    assert (inside.overlap_cells, inside.overlap_ratio) == (400, 1.0)
    half = agreement(large, small, SE2(-0.5, 0.5, 0.0))
    assert (half.overlap_cells, half.overlap_ratio) == (200, 0.5)


@pytest.mark.parametrize(
    ("target", "source", "T"),
    [
        (uniform(0), uniform(0), SE2(50.0, 0.0, 0.0)),
        (uniform(0), uniform(-1), IDENTITY),
        (uniform(-1), uniform(-1), IDENTITY),
        (uniform(-1, 1, 1), uniform(0, 1, 1), IDENTITY),
        (uniform(0), uniform(0), SE2(1e7, -1e7, 2.0)),
    ],
)
def test_no_common_cell_gives_no_error(target: Cells, source: Cells, T: SE2) -> None:
    found = agreement(grid(target), grid(source), T)
    assert found.mae is None
    assert found.band is None
    assert (found.overlap_cells, found.overlap_ratio) == (0, 0.0)


def test_single_cells_are_maps_too() -> None:
    found = agreement(grid(uniform(0, 1, 1)), grid(uniform(100, 1, 1)), IDENTITY)
    assert found.mae == pytest.approx(255.0)
    assert (found.overlap_cells, found.overlap_ratio) == (1, 1.0)


def test_polarity_does_not_matter() -> None:
    one, other, T = rooms(6), rooms(7), SE2(0.3, 0.2, 0.1)
    inverted = [np.where(cells == -1, -1, 100 - cells).astype(np.int8) for cells in (one, other)]
    found, found_inverted = agreement(grid(one), grid(other), T), agreement(grid(inverted[0]), grid(inverted[1]), T)
    assert found.mae == pytest.approx(found_inverted.mae, abs=0.05)
    assert found.overlap_cells == found_inverted.overlap_cells


def test_complementary_known_areas_share_nothing() -> None:
    target, source = uniform(0), uniform(0)
    target[:, :30], source[:, 30:] = -1, -1
    assert agreement(grid(target), grid(source), IDENTITY).mae is None


@pytest.mark.parametrize(
    ("mae", "band"),
    [(0.0, "good"), (19.99, "good"), (20.0, "doubtful"), (28.48, "doubtful"), (28.49, "failed"), (255.0, "failed")],
)
def test_bands_are_the_papers(mae: float, band: str) -> None:
    assert mae_band(mae) == band
