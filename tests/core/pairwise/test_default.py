"""The default profile as a whole, on places drawn for it."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from mapfusion.config import FusionConfig
from mapfusion.evaluation.pairs import StudyPair, make_pair
from mapfusion.grid import Cells, OccupancyGrid
from mapfusion.pairwise import default, search
from mapfusion.pairwise.default import OUTLOOK, PreparedMap, fuse, prepare, verify
from mapfusion.result import PairFusion
from mapfusion.transform import SE2
from tests.core.pairwise.test_verdict import GOOD
from tests.fakes import flat, grid_of, rooms, seen_from

RESOLUTION_M = 0.1
T_PLACE_B = SE2(24.0, 6.0, 1.2)
"""Where the second robot's map lies in the place; the first one's is the place's corner."""


def two_views(place: Cells) -> tuple[OccupancyGrid, OccupancyGrid]:
    """Two overlapping views; the second one's frame is T_PLACE_B in the first one's."""
    return seen_from(place, SE2.identity(), (220, 230)), seen_from(place, T_PLACE_B, (200, 210))


def fused(a: OccupancyGrid, b: OccupancyGrid, config: FusionConfig | None = None) -> PairFusion:
    resolution_m = max(a.resolution_m, b.resolution_m)
    return fuse(prepare(a, resolution_m), prepare(b, resolution_m), config or FusionConfig())


def assert_near(T: SE2 | None, truth: SE2, cells: float, degrees: float) -> None:
    assert T is not None
    at_views = np.array([[5.0, 5.0], [15.0, 15.0]])
    assert np.linalg.norm(T.apply(at_views) - truth.apply(at_views), axis=1).max() < cells * RESOLUTION_M
    assert T.distance_to(truth)[1] < math.radians(degrees)


@pytest.fixture(scope="module")
def views() -> tuple[OccupancyGrid, OccupancyGrid]:
    return two_views(rooms(seed=3))


@pytest.fixture(scope="module")
def prepared(views: tuple[OccupancyGrid, OccupancyGrid]) -> tuple[PreparedMap, PreparedMap]:
    return prepare(views[0], RESOLUTION_M), prepare(views[1], RESOLUTION_M)


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_overlapping_views_join_to_a_fraction_of_a_cell(seed: int) -> None:
    result = fused(*two_views(rooms(seed=seed)))
    assert result.accepted, result.reason
    assert result.confidence >= 0.9
    assert_near(result.T_target_source, T_PLACE_B, cells=0.5, degrees=0.2)


def off_m(pair: StudyPair, result: PairFusion) -> float:
    """How far the middle of the source lies from where it belongs, metres."""
    assert pair.T_target_source is not None
    assert result.T_target_source is not None
    middle_m = pair.source.centres_m(pair.source.known).mean(axis=0)
    return float(np.linalg.norm(result.T_target_source.apply(middle_m) - pair.T_target_source.apply(middle_m)))


def test_a_thorough_search_finds_what_a_quick_one_misses() -> None:
    """Which pairs these are depends on the keypoints, which differ from one OpenCV to the next."""
    num_found = 0
    for seed in (95000529, 76000519):
        pair = make_pair("floor-plans", True, seed)
        maps = prepare(pair.target, 0.05), prepare(pair.source, 0.05)
        result = fuse(*maps, FusionConfig())
        assert not result.accepted or off_m(pair, result) < 0.1
        num_found += result.accepted and not fuse(*maps, FusionConfig(), is_thorough=False).accepted
    assert num_found >= 1


def fail(*_: object) -> None:
    raise AssertionError("was not to be called")


def test_what_keypoints_alone_make_sure_of_is_not_looked_for_otherwise(monkeypatch: pytest.MonkeyPatch) -> None:
    pair = make_pair("paper", True, 900201)
    monkeypatch.setattr(search, "correlate", fail)
    result = fuse(prepare(pair.target, 0.05), prepare(pair.source, 0.05), FusionConfig())
    assert result.accepted, result.reason
    assert off_m(pair, result) < 0.05


@pytest.mark.parametrize(("lines", "expected_cells"), [(40.0, 2.0), (20.0, 0.0)])
def test_of_two_searches_that_find_the_same_the_more_plausible_pose_is_taken(
    monkeypatch: pytest.MonkeyPatch, lines: float, expected_cells: float
) -> None:
    place = prepare(grid_of(rooms(seed=3)), RESOLUTION_M)

    def found(x_cells: float, lines: float) -> search.Finding:
        best = search.Candidate(np.array([x_cells, 0.0, 0.0]), GOOD | {"lines": lines})
        return search.Finding(best, np.diag([1e3, 1e3, 1e6]), is_searched=True)

    findings = [found(0.0, 30.0), found(2.0, lines)]
    monkeypatch.setattr(default, "is_promising", lambda proposed: False)
    monkeypatch.setattr(default, "examine", lambda *args: findings.pop(0))
    monkeypatch.setattr(default, "SETTLED", math.inf)
    result = fuse(place, place, FusionConfig())
    assert (result.accepted, findings) == (True, [])
    assert result.T_target_source is not None
    assert result.T_target_source.x_m == pytest.approx(expected_cells * RESOLUTION_M)


def test_hopeless_pairs_are_not_searched_thoroughly(monkeypatch: pytest.MonkeyPatch) -> None:
    pair = make_pair("paper", False, 900201)
    monkeypatch.setattr(search, "best_nearby", fail)
    result = fuse(prepare(pair.target, 0.05), prepare(pair.source, 0.05), FusionConfig())
    assert result.confidence < OUTLOOK


def cluttered_building(seed: int) -> tuple[OccupancyGrid, OccupancyGrid, SE2]:
    """Two views of 50 m by 55 m, one of them full of things that the other has not; the second's frame in the first's.

    They share half of the smaller one.
    """
    rng = np.random.default_rng(seed)
    place = np.block([[rooms(334, 367, 9 * seed + 3 * row + col) for col in range(3)] for row in range(3)])
    cluttered = place.copy()
    for _ in range(2500):
        row, col = rng.integers(0, place.shape[0] - 8), rng.integers(0, place.shape[1] - 8)
        height, width = rng.integers(2, 8, 2)
        cluttered[row : row + height, col : col + width] = 100
    yaw_rad = rng.uniform(-3.0, 3.0)
    from_corner = SE2(0.0, 0.0, yaw_rad).apply(np.array([[17.5, 17.5]]))[0]
    T_a_b = SE2(38.0 - from_corner[0], 25.0 - from_corner[1], yaw_rad)
    return seen_from(cluttered, SE2.identity(), (1000, 760), 0.05), seen_from(place, T_a_b, (700, 700), 0.05), T_a_b


def test_large_maps_are_searched_at_coarser_resolutions_and_by_more_keypoints(monkeypatch: pytest.MonkeyPatch) -> None:
    a, b, T_a_b = cluttered_building(seed=4)
    maps = prepare(a, 0.05), prepare(b, 0.05)
    result = fuse(*maps, FusionConfig())
    assert result.accepted, result.reason
    middle_m = b.centres_m(b.known).mean(axis=0)
    assert result.T_target_source is not None
    assert np.linalg.norm(result.T_target_source.apply(middle_m) - T_a_b.apply(middle_m)) < 0.025
    assert fuse(*maps, FusionConfig(), is_thorough=False).confidence < OUTLOOK  # vast maps are searched all the same
    with monkeypatch.context() as alone:
        alone.setattr(search, "have_many_walls", lambda *_: False)
        assert fuse(*maps, FusionConfig()).accepted
    monkeypatch.setattr(search, "_can_be_coarsened", lambda *_: False)
    assert fuse(*maps, FusionConfig()).accepted
    monkeypatch.setattr(search, "have_many_walls", lambda *_: False)
    assert not fuse(*maps, FusionConfig()).accepted


def test_maps_of_which_little_is_in_common_join_by_what_does_not_contradict() -> None:
    pair = make_pair("floor-plans", True, 52170)
    result = fuse(prepare(pair.target, 0.05), prepare(pair.source, 0.05), FusionConfig(), is_thorough=False)
    assert result.accepted, result.reason
    assert off_m(pair, result) < 0.1


@pytest.mark.parametrize("seed", [1, 2, 6])
def test_different_places_are_refused_with_a_reason(seed: int) -> None:
    result = fused(two_views(rooms(seed=seed))[0], two_views(rooms(seed=seed + 10))[1])
    assert not result.accepted
    assert result.reason
    assert result.confidence < 0.9


def test_exchanged_maps_give_the_inverse(prepared: tuple[PreparedMap, PreparedMap]) -> None:
    a, b = prepared
    forth, back = fuse(a, b, FusionConfig()), fuse(b, a, FusionConfig())
    assert forth.T_target_source is not None
    assert back.T_target_source is not None
    distance_m, angle_rad = forth.T_target_source.distance_to(back.T_target_source.inverse())
    assert distance_m < 1e-6
    assert angle_rad < 1e-9
    assert forth.confidence == back.confidence


def test_same_maps_give_the_same_result(views: tuple[OccupancyGrid, OccupancyGrid]) -> None:
    assert fused(*views).T_target_source == fused(*views).T_target_source


def test_frames_of_the_grids_are_honoured(views: tuple[OccupancyGrid, OccupancyGrid]) -> None:
    a, b = views
    T_a, T_b = SE2(7.0, -3.0, 0.4), SE2(-20.0, 11.0, -2.5)
    result = fused(replace(a, T_frame_grid=T_a), replace(b, T_frame_grid=T_b))
    truth = T_a @ T_PLACE_B @ T_b.inverse()
    assert result.accepted
    assert result.T_target_source is not None
    assert_near(T_a.inverse() @ result.T_target_source @ T_b, T_a.inverse() @ truth @ T_b, cells=0.5, degrees=0.2)


def test_flipped_cells_do_not_matter(views: tuple[OccupancyGrid, OccupancyGrid]) -> None:
    rng = np.random.default_rng(0)

    def flipped(grid: OccupancyGrid) -> OccupancyGrid:
        cells = grid.cells.copy()
        hit = (rng.random(cells.shape) < 0.03) & grid.known
        cells[hit] = 100 - cells[hit]
        return replace(grid, cells=cells)

    result = fused(flipped(views[0]), flipped(views[1]))
    assert result.accepted, result.reason
    assert_near(result.T_target_source, T_PLACE_B, cells=0.5, degrees=0.3)


def test_mixed_resolutions_join(views: tuple[OccupancyGrid, OccupancyGrid]) -> None:
    a, b = views
    fine = OccupancyGrid(np.kron(b.cells, np.ones((2, 2), np.int8)), RESOLUTION_M / 2, b.T_frame_grid)
    result = fused(a, fine)
    assert result.accepted
    assert result.resolution_m == RESOLUTION_M
    assert_near(result.T_target_source, T_PLACE_B, cells=0.5, degrees=0.2)


def test_probabilities_count_by_their_thresholds(views: tuple[OccupancyGrid, OccupancyGrid]) -> None:
    a, b = views
    cells = np.where(b.cells == 100, 80, np.where(b.cells == 0, 15, b.cells)).astype(np.int8)
    assert_near(fused(a, replace(b, cells=cells)).T_target_source, T_PLACE_B, cells=0.5, degrees=0.2)


def test_known_transform_is_verified_without_search(prepared: tuple[PreparedMap, PreparedMap]) -> None:
    a, b = prepared
    off = T_PLACE_B @ SE2(0.15, -0.1, 0.005)
    result = verify(a, b, off, FusionConfig())
    assert result.accepted
    assert_near(result.T_target_source, T_PLACE_B, cells=0.5, degrees=0.2)
    wrong = verify(a, b, T_PLACE_B @ SE2(3.0, 2.0, 0.8), FusionConfig())
    assert not wrong.accepted


def test_symmetric_place_is_ambiguous_and_names_the_rival() -> None:
    half = rooms(150, 320, seed=3)
    place = np.concatenate([half, np.rot90(half, 2)])
    result = fused(grid_of(place), grid_of(place))
    assert not result.accepted
    assert result.gate == "ambiguous"
    assert result.confidence <= 0.5
    assert result.rival is not None
    assert result.T_target_source is not None
    assert result.rival.distance_to(result.T_target_source)[1] == pytest.approx(math.pi, abs=0.01)


@pytest.mark.parametrize("edge", [600, 3000])
def test_rows_of_pillars_lie_as_well_one_row_further(edge: int) -> None:
    cells = np.zeros((edge, edge), np.int8)
    for row, column in product(range(3), repeat=2):
        cells[row::20, column::20] = 100
    part = cells[edge // 6 :, : edge - edge // 8]
    result = fuse(prepare(grid_of(cells), 0.1), prepare(grid_of(part), 0.1), FusionConfig())
    assert not result.accepted
    assert result.gate in ("ambiguous", "parts")


def test_two_copies_of_one_map_join_at_identity(views: tuple[OccupancyGrid, OccupancyGrid]) -> None:
    result = fused(views[0], replace(views[0]))
    assert result.accepted
    assert result.mae == pytest.approx(0.0, abs=0.5)
    assert_near(result.T_target_source, SE2.identity(), cells=0.05, degrees=0.01)


def test_straight_wall_fixes_nothing_along_itself() -> None:
    cells = flat(150, 260, 0)
    cells[70:73] = 100
    result = fused(grid_of(cells), grid_of(cells[20:, 30:].copy()))
    assert not result.accepted


def circle() -> Cells:
    y, x = np.indices((200, 200)) - 100
    cells = np.where(np.hypot(x, y) < 80, 0, -1).astype(np.int8)
    cells[np.abs(np.hypot(x, y) - 80) < 1.5] = 100
    return cells


@pytest.mark.parametrize(
    "cells",
    [
        flat(60, 60, 0),
        flat(60, 60, -1),
        flat(1, 1, 100),
        flat(60, 60, 100),
        flat(60, 60, 50),
        circle(),
    ],
    ids=["free", "unknown", "one cell", "solid", "undecided", "circle"],
)
def test_maps_that_say_too_little_are_refused(cells: Cells) -> None:
    result = fused(grid_of(cells), grid_of(cells))
    assert not result.accepted
    assert result.reason


def test_mae_is_a_hard_gate_where_asked_for(views: tuple[OccupancyGrid, OccupancyGrid]) -> None:
    free = fused(*views)
    assert free.mae is not None
    strict = fused(*views, config=FusionConfig(mae_threshold=free.mae / 2))
    assert (strict.accepted, strict.gate) == (False, "mae")


def test_covariance_is_of_the_size_of_the_error(views: tuple[OccupancyGrid, OccupancyGrid]) -> None:
    result = fused(*views)
    assert result.covariance is not None
    np.testing.assert_allclose(result.covariance, result.covariance.T, atol=1e-12)
    assert (np.linalg.eigvalsh(result.covariance) > 0.0).all()
    sigma_yaw = math.sqrt(result.covariance[2, 2])
    assert 1e-5 < sigma_yaw < math.radians(1.0)
