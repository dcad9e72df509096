from __future__ import annotations

import hashlib
import random
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import pytest

from mapfusion.grid import OccupancyGrid
from mapfusion.simulation.paper import (
    MAP_SIZE,
    negative_pair,
    patch_grid,
    pose_in_map,
    positive_pair,
    random_map,
    random_patch,
)
from mapfusion.transform import SE2


class RecordingRandom(random.Random):
    """Notes every draw with its range."""

    def __init__(self, seed: int) -> None:
        super().__init__(seed)
        self.ranges: list[tuple[int, int] | str] = []

    def randint(self, a: int, b: int) -> int:
        self.ranges.append((a, b))
        return super().randint(a, b)

    def choice(self, seq: Sequence[Any]) -> Any:  # type: ignore[override]
        self.ranges.append("choice")
        return super().choice(seq)


def share_that_agrees(target: OccupancyGrid, source: OccupancyGrid, T_target_source: SE2) -> float:
    """Share of the source's obstacle cells within the target that are obstacles there."""
    points_m = (target.T_frame_grid.inverse() @ T_target_source).apply(source.centres_m(source.walls))
    cols, rows = np.floor(points_m / target.resolution_m).astype(int).T
    inside = (rows >= 0) & (rows < target.height) & (cols >= 0) & (cols < target.width)
    assert inside.sum() > 1000
    return float(np.mean(target.walls[rows[inside], cols[inside]]))


def test_map_draws_the_papers_ranges_in_the_papers_order() -> None:
    rng = RecordingRandom(7)
    random_map(rng)
    replayed = random.Random(7)
    draws = iter(rng.ranges)

    def expect(low: int, high: int) -> int:
        assert next(draws) == (low, high)
        return replayed.randint(low, high)

    def expect_choice(of: list[Any]) -> Any:
        assert next(draws) == "choice"
        return replayed.choice(of)

    for _ in range(expect(1, 4)):
        side = expect(55, 110)
        expect(0, 550 - side), expect(0, 550 - side), expect(0, 360)
    for _ in range(expect(6, 12)):
        width = expect(5, 10)
        expect(0, 550 - width), expect(0, 550 - width), expect(0, 360)
        expect_choice([True, False])
    for _ in range(expect(15, 30)):
        side = expect(10, 20)
        expect(0, 550 - side), expect(0, 550 - side), expect(0, 360)
    for _ in range(expect(5, 10)):
        shape = expect_choice(["circle", "ellipse"])
        expect(10, 540), expect(10, 540)
        if shape == "circle":
            expect(5, 15)
        else:
            expect(10, 20), expect(5, 15), expect(0, 360)
    assert next(draws, None) is None


def test_patch_draws_after_the_map() -> None:
    rng = RecordingRandom(3)
    image = np.zeros((MAP_SIZE, MAP_SIZE), np.uint8)
    patch = random_patch(rng, image)
    rows, cols = patch.image.shape
    assert rng.ranges == [(250, 400), (250, 400), (0, 360), (0, 550 - rows), (0, 550 - cols)]


def test_seeded_draws_are_python_s() -> None:
    """The generator of the paper's program is Python's: these draws are the same wherever Python runs."""
    rng = RecordingRandom(0)
    random_map(rng)
    digest = hashlib.sha256(repr((len(rng.ranges), rng.random())).encode()).hexdigest()
    assert digest[:16] == "0167d4a2246c9210"


def test_map_is_binary_and_its_shapes_are_where_they_were_drawn() -> None:
    image = random_map(random.Random(0))
    assert image.shape == (550, 550)
    assert set(np.unique(image)) == {0, 1}
    assert 0.05 < image.mean() < 0.5
    np.testing.assert_array_equal(image, random_map(random.Random(0)))
    assert not np.array_equal(image, random_map(random.Random(1)))


def test_circle_includes_its_border() -> None:
    class OneCircle(RecordingRandom):
        """Draws nothing but one circle of radius 5 about (100, 200)."""

        def randint(self, a: int, b: int) -> int:
            scripted = {(5, 10): 1 if len(self.ranges) == 3 else 5, (10, 540): 100 if len(self.ranges) == 5 else 200}
            self.ranges.append((a, b))
            return scripted.get((a, b), 5 if (a, b) == (5, 15) else 0)

        def choice(self, seq: Sequence[Any]) -> Any:  # type: ignore[override]
            self.ranges.append("choice")
            return "circle"

    image = random_map(OneCircle(0))
    ys, xs = np.nonzero(image)
    assert {tuple(p) for p in np.stack([xs - 100, ys - 200]).T} == {
        (x, y) for x in range(-5, 6) for y in range(-5, 6) if x * x + y * y <= 25
    }


@pytest.mark.parametrize("seed", [0, 3, 4])
def test_positive_pair_lies_on_itself_under_the_truth(seed: int) -> None:
    pair = positive_pair(seed)
    assert pair.T_target_source is not None
    # Rows are turned over, angles change their sign: with any of it wrong the share would be about a fifth.
    assert share_that_agrees(pair.target, pair.source, pair.T_target_source) > 0.95


def test_truth_scales_with_the_resolution() -> None:
    fine, coarse = positive_pair(5).T_target_source, positive_pair(5, resolution_m=0.1).T_target_source
    assert fine is not None
    assert coarse is not None
    assert (coarse.x_m, coarse.y_m, coarse.yaw_rad) == pytest.approx((2 * fine.x_m, 2 * fine.y_m, fine.yaw_rad))


def test_overlaps_are_spread_as_in_the_paper() -> None:
    overlaps = [positive_pair(seed).overlap_ratio for seed in range(60)]
    assert np.median(overlaps) == pytest.approx(0.66, abs=0.12)
    assert np.quantile(overlaps, [0.1, 0.9]) == pytest.approx([0.35, 0.89], abs=0.12)


def test_negative_pair_shows_two_maps() -> None:
    pair = negative_pair(2)
    assert pair.T_target_source is None
    assert pair.overlap_ratio == 0.0
    np.testing.assert_array_equal(pair.target.cells, positive_pair(2).target.cells)
    assert pair.source.cells.shape != positive_pair(2).source.cells.shape


def test_grid_looks_like_the_image() -> None:
    rng = random.Random(1)
    patch = random_patch(rng, random_map(rng))
    grid = patch_grid(patch, 0.05)
    assert grid.cells[0, 0] == 100 * patch.image[-1, 0]
    np.testing.assert_array_equal(grid.cells[::-1], 100 * patch.image.astype(np.int8))


def test_pose_in_map_puts_a_patch_onto_its_map() -> None:
    rng = random.Random(4)
    image = random_map(rng)
    patch = random_patch(rng, image)
    whole = OccupancyGrid((100 * image[::-1]).astype(np.int8), 0.05, SE2.identity())
    assert share_that_agrees(whole, patch_grid(patch, 0.05), pose_in_map(patch, 0.05)) > 0.95


def test_corners_beyond_the_map_are_marked() -> None:
    rng = random.Random(9)
    image = np.ones((MAP_SIZE, MAP_SIZE), np.uint8)
    patch = random_patch(rng, image)
    np.testing.assert_array_equal(patch.inside, patch.image > 0)
    rotation = patch.T_patch_map_px[:2, :2]
    assert rotation @ rotation.T == pytest.approx(np.eye(2))
    assert cv2.determinant(rotation) == pytest.approx(1.0)
