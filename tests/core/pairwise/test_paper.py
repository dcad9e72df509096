from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from mapfusion.config import FusionConfig
from mapfusion.grid import Cells, OccupancyGrid, resample
from mapfusion.pairwise.paper import PaperMap, fuse, prepare
from mapfusion.result import PairFusion
from mapfusion.simulation.paper import PatchPair, negative_pair, positive_pair
from mapfusion.transform import SE2

CONFIG = FusionConfig(profile="paper")


def fused(target: OccupancyGrid, source: OccupancyGrid, config: FusionConfig = CONFIG) -> PairFusion:
    resolution_m = max(target.resolution_m, source.resolution_m)
    return fuse(prepare(target, resolution_m), prepare(source, resolution_m), config)


def clutter(seed: int, height: int = 420, width: int = 460) -> Cells:
    """A free plane with walls and boxes of all occupancies from 60 on."""
    rng = np.random.default_rng(seed)
    cells = np.zeros((height, width), np.int8)
    for _ in range(90):
        row, col = rng.integers(0, height - 30), rng.integers(0, width - 30)
        rows, cols = rng.integers(3, 30, 2)
        cells[row : row + rows, col : col + cols] = rng.integers(60, 101)
    return cells


def by_hand(points_px: np.ndarray, percent: int = 0, size: int = 100) -> PaperMap:
    """A map of one occupancy whose k-th keypoint matches the k-th of every other such map, and no other."""
    cells = np.full((size, size), percent, np.int8)
    image = np.full((size, size), round(2.55 * percent), np.uint8)
    descriptors = np.random.default_rng(0).integers(0, 256, (len(points_px), 32), np.uint8)
    return PaperMap(OccupancyGrid(cells, 0.05, SE2.identity()), image, points_px.astype(np.float32), descriptors)


def scattered(num: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).uniform(20.0, 80.0, (num, 2))


def assert_near(found: SE2 | None, truth: SE2 | None, tolerance_m: float, tolerance_deg: float) -> None:
    assert found is not None
    assert truth is not None
    distance_m, angle_rad = found.distance_to(truth)
    assert distance_m <= tolerance_m
    assert math.degrees(angle_rad) <= tolerance_deg


def corner_error_cells(pair: PatchPair, found: SE2 | None) -> float:
    if found is None or pair.T_target_source is None:
        return math.inf
    height, width = pair.source.cells.shape
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]]) * pair.source.resolution_m
    moved = found.apply(corners) - pair.T_target_source.apply(corners)
    return float(np.linalg.norm(moved, axis=1).mean()) / pair.source.resolution_m


def test_the_image_shows_obstacles_white_and_unknown_as_free() -> None:
    cells = np.array([[0, 100, -1], [50, 20, 99]], np.int8)
    image = prepare(OccupancyGrid(cells, 0.05, SE2.identity()), 0.05).image
    assert image.tolist() == [[128, 51, 252], [0, 255, 0]]  # the grid's last row on top


def test_unknown_never_becomes_a_grey_of_the_map_files() -> None:
    cells = clutter(0)
    cells[:, :200] = -1
    cells[cells > 0] = 100
    assert set(np.unique(prepare(OccupancyGrid(cells, 0.05, SE2.identity()), 0.05).image)) == {0, 255}


@pytest.mark.parametrize("quarter_turns", [0, 1, 2, 3])
def test_a_turned_part_of_a_map_is_found_again(quarter_turns: int) -> None:
    world = clutter(1)
    T_world_a, T_world_b = SE2(4.0, -2.0, 0.3), SE2(-7.0, 5.0, -2.2)  # frames of the maps, anywhere
    target = OccupancyGrid(world[:350, :400], 0.05, T_world_a.inverse())
    corner = SE2(80 * 0.05, 60 * 0.05, 0.0)
    turned = np.rot90(world[60:400, 80:440], quarter_turns)  # rows grow with +y: this turns clockwise
    side_m = {0: (0.0, 0.0), 1: (0.0, 360 * 0.05), 2: (360 * 0.05, 340 * 0.05), 3: (340 * 0.05, 0.0)}[quarter_turns]
    T_turned_corner = SE2(*side_m, -quarter_turns * math.pi / 2)
    source = OccupancyGrid(np.ascontiguousarray(turned), 0.05, T_world_b.inverse() @ corner @ T_turned_corner.inverse())
    found = fused(target, source)
    assert found.accepted
    assert (found.reason, found.gate) == ("", "")
    assert_near(T_world_a @ found.T_target_source @ T_world_b.inverse(), SE2.identity(), 0.1, 0.2)  # type: ignore[operator]
    assert found.mae is not None
    assert found.mae < 6.0
    assert found.confidence > 0.85
    assert found.overlap_ratio == pytest.approx(290 * 320 / (340 * 360), abs=0.01)
    assert found.scale == pytest.approx(1.0, abs=0.01)
    assert 0.2 < found.evidence["inlier_ratio"] <= 1.0
    assert found.evidence["matches"] == found.num_matches


def test_unknown_surroundings_do_not_count() -> None:
    cells = clutter(2)
    seen = cells.copy()
    seen[:, 300:] = -1
    found = fused(OccupancyGrid(seen, 0.05, SE2.identity()), OccupancyGrid(cells, 0.05, SE2.identity()))
    assert found.accepted
    assert found.mae == pytest.approx(0.0, abs=0.5)
    assert found.overlap_cells == pytest.approx(420 * 300, rel=0.01)
    assert found.overlap_ratio == pytest.approx(1.0, abs=0.01)


def test_different_resolutions_are_brought_to_the_coarser_one() -> None:
    fine = OccupancyGrid(np.kron(clutter(3), np.ones((2, 2), np.int8)), 0.05, SE2(1.0, 2.0, 0.5))
    coarse = replace(resample(fine, 0.10), T_frame_grid=SE2(-3.0, 1.0, -1.0))
    found = fused(fine, coarse)
    assert found.accepted
    assert found.resolution_m == 0.10
    assert_near(found.T_target_source, fine.T_frame_grid @ coarse.T_frame_grid.inverse(), 0.01, 0.05)


def test_swapped_maps_give_the_inverse() -> None:
    pair = positive_pair(3)
    found, swapped = fused(pair.target, pair.source), fused(pair.source, pair.target)
    assert found.accepted
    assert swapped.accepted
    assert swapped.T_target_source is not None
    assert_near(swapped.T_target_source.inverse(), found.T_target_source, 0.1, 0.3)


@pytest.mark.parametrize(
    "cells",
    [
        np.zeros((300, 300), np.int8),
        np.full((300, 300), -1, np.int8),
        np.zeros((1, 1), np.int8),
        clutter(0)[:2],
        clutter(0)[:40, :40],
        clutter(0)[:, :1],
    ],
)
def test_maps_with_nothing_to_see_are_refused_with_a_reason(cells: Cells) -> None:
    empty = OccupancyGrid(np.ascontiguousarray(cells), 0.05, SE2.identity())
    other = OccupancyGrid(clutter(4), 0.05, SE2.identity())
    for found in (fused(empty, other), fused(other, empty), fused(empty, empty)):
        assert not found.accepted
        assert found.gate == "few keypoints"
        assert found.reason.startswith("too few keypoints: ")
        assert found.T_target_source is None
        assert found.mae is None
        assert found.confidence == 0.0


def test_few_matches_are_refused_before_anything_is_fitted() -> None:
    one, other = by_hand(scattered(30)), by_hand(scattered(60))
    found = fuse(one, replace(other, descriptors=np.repeat(other.descriptors[:20], 3, axis=0)), CONFIG)
    assert found.gate == "few matches"
    assert found.reason == "too few matches: 20, 25 are needed"
    assert (found.num_keypoints_target, found.num_keypoints_source, found.num_matches) == (30, 60, 20)
    assert "published_error" not in found.evidence


def test_matches_at_one_spot_give_no_transform() -> None:
    found = fuse(by_hand(scattered(40)), by_hand(np.full((40, 2), 50.0)), CONFIG)
    assert found.gate == "no transform"
    assert found.reason == "no transform fits the 40 matches"


def test_no_common_known_cell_is_a_refusal_and_not_a_number() -> None:
    one, other = by_hand(scattered(40)), by_hand(scattered(40))
    left, right = np.zeros((100, 100), np.int8), np.zeros((100, 100), np.int8)
    left[:, 50:], right[:, :50] = -1, -1
    found = fuse(
        replace(one, grid=replace(one.grid, cells=left)), replace(other, grid=replace(other.grid, cells=right)), CONFIG
    )
    assert found.gate == "no overlap"
    assert found.mae is None
    assert found.overlap_cells == 0
    assert found.T_target_source is not None


@pytest.mark.parametrize(("percent", "band"), [(7, ""), (8, "doubtful"), (11, "doubtful"), (12, "failed")])
def test_the_error_decides_and_its_band_is_named(percent: int, band: str) -> None:
    found = fuse(by_hand(scattered(40)), by_hand(scattered(40), percent), CONFIG)
    assert found.mae == pytest.approx(2.55 * percent, abs=0.1)
    assert found.accepted == (band == "")
    assert found.confidence == pytest.approx(max(0.0, 1.0 - 2.55 * percent / 40.0), abs=0.01)
    if band:
        assert found.gate == "mae"
        assert found.reason.endswith(f"is not below 20 ({band})")


def test_the_threshold_can_be_set() -> None:
    maps = by_hand(scattered(40)), by_hand(scattered(40), 9)
    assert fuse(*maps, replace(CONFIG, mae_threshold=23.0)).accepted
    assert not fuse(*maps, replace(CONFIG, mae_threshold=22.9)).accepted


def test_the_scale_is_reported_and_not_applied() -> None:
    points = scattered(40)
    found = fuse(by_hand(points), by_hand(50.0 + 0.9 * (points - 50.0)), CONFIG)
    assert found.scale == pytest.approx(1.0 / 0.9, abs=1e-3)
    assert_near(found.T_target_source, SE2.identity(), 0.05, 0.1)


def test_the_published_error_wraps_around_and_counts_obstacles_only() -> None:
    found = fuse(by_hand(scattered(40), 4), by_hand(scattered(40), 5), CONFIG)
    assert found.accepted
    assert found.mae == pytest.approx(2.55, abs=0.1)
    assert found.evidence["published_error"] == pytest.approx(253.0, abs=0.01)  # 10 - 13 as bytes
    assert found.evidence["published_accepted"] == 0.0
    against_free = fuse(by_hand(scattered(40), 100), by_hand(scattered(40), 0), CONFIG)
    assert against_free.mae == pytest.approx(255.0)
    assert "published_error" not in against_free.evidence
    assert against_free.evidence["published_accepted"] == 0.0


def test_the_covariance_is_the_spread_of_the_estimates() -> None:
    points, sigma_px = scattered(60), 0.5
    T_frame_grid = SE2(10.0, -3.0, 0.8)
    one, other = (
        replace(made, grid=replace(made.grid, T_frame_grid=T_frame_grid)) for made in (by_hand(points), by_hand(points))
    )
    found, predicted = [], []
    for seed in range(150):
        noise = np.random.default_rng(seed).normal(0.0, sigma_px, points.shape)
        result = fuse(replace(one, points_px=(points + noise).astype(np.float32)), other, CONFIG)
        assert result.T_target_source is not None
        assert result.covariance is not None
        T = result.T_target_source
        found.append((T.x_m, T.y_m, T.yaw_rad))
        predicted.append(result.covariance)
    spread, mean = np.cov(np.array(found).T), np.mean(predicted, axis=0)
    assert np.allclose(np.sqrt(np.diag(mean)), np.sqrt(np.diag(spread)), rtol=0.25)
    correlation, expected = (c / np.sqrt(np.outer(np.diag(c), np.diag(c))) for c in (spread, mean))
    assert np.allclose(correlation, expected, atol=0.15)


def test_threads_and_seeds_change_nothing() -> None:
    pairs = [positive_pair(seed) for seed in range(4)]

    def figures(index: int) -> tuple[object, ...]:
        pair = pairs[index % 4]
        found = fused(pair.target, pair.source, replace(CONFIG, seed=index))
        covariance = None if found.covariance is None else found.covariance.tobytes()
        return found.T_target_source, found.mae, found.scale, found.num_inliers, covariance, dict(found.evidence)

    alone = [figures(index) for index in range(4)]
    with ThreadPoolExecutor(4) as threads:
        together = list(threads.map(figures, range(16)))
    assert together == alone * 4


def test_pairs_of_the_papers_generator() -> None:
    """The figures to be had from hundreds of pairs are 78 % right, 5 % wrong and 0.4 % of the unrelated accepted."""
    right = wrong = 0
    for seed in range(1000, 1020):
        pair = positive_pair(seed)
        found = fused(pair.target, pair.source)
        correct = corner_error_cells(pair, found.T_target_source) <= 5.0
        right += found.accepted and correct
        wrong += found.accepted and not correct
    unrelated = sum(fused(pair.target, pair.source).accepted for pair in map(negative_pair, range(1000, 1015)))
    assert right >= 12
    assert wrong <= 3
    assert unrelated <= 1
