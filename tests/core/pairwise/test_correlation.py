"""Hypotheses from the walls as a whole."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapfusion.evaluation.pairs import make_pair
from mapfusion.pairwise import correlation
from mapfusion.pairwise.correlation import PEAKS_PER_ROTATION, correlate, likely_rotations
from mapfusion.pairwise.poses import differ, from_se2
from mapfusion.pairwise.prepared import PreparedMap, prepare
from mapfusion.pairwise.surface import DIRECTION_BINS, Surface, SurfaceField
from mapfusion.transform import SE2
from tests.fakes import grid_of, rooms, seen_from

T_A_B = SE2(20.0, 8.0, 2.0)
NO_TURNS = np.zeros(0)


def fields() -> tuple[SurfaceField, SurfaceField, PreparedMap]:
    place = rooms(seed=3)
    a, b = (prepare(seen_from(place, T, (220, 230)), 0.1) for T in (SE2.identity(), T_A_B))
    assert a.field is not None
    assert b.field is not None
    return a.field, b.field, b


def by_walls(target: SurfaceField, source: SurfaceField, number: int) -> npt.NDArray[np.float64]:
    """The first rotations of those for which the walls alone speak."""
    return likely_rotations(target.surface, source.surface, NO_TURNS)[:number]


def facing(degrees: npt.NDArray[np.intp]) -> Surface:
    """Walls that face some directions, wherever they are."""
    angles = np.radians(degrees + 0.5)
    normals = np.stack([np.cos(angles), np.sin(angles)], -1).astype(np.float32)
    bins = (angles * DIRECTION_BINS / (2.0 * np.pi)).astype(np.float32)
    return Surface(np.zeros_like(normals), normals, bins)


def test_right_pose_is_among_the_peaks() -> None:
    target, source, prepared = fields()
    poses = correlate(target, source, prepared.centre, by_walls(target, source, 5))
    corner_b = prepared.grid.T_frame_grid
    truth = T_A_B @ corner_b
    pose = np.array([truth.x_m / 0.1, truth.y_m / 0.1, truth.yaw_rad])
    assert len(poses) >= 5 * 2 * PEAKS_PER_ROTATION
    assert not differ(pose[None], poses, prepared.centre, 8.0, 3.0).all()


def test_likely_rotations_are_all_rotations_the_right_one_early() -> None:
    target, source, _ = fields()
    rotations = likely_rotations(target.surface, source.surface, NO_TURNS)
    assert np.unique(rotations).size == 120
    away = np.abs(np.remainder(rotations[:8] - 2.0 + math.pi, 2 * math.pi) - math.pi)
    assert away.min() < math.radians(2.0)


def test_a_long_wall_that_one_map_has_alone_does_not_decide_the_rotation() -> None:
    shared = [10, 33, 75, 140, 201, 260, 312]

    def surface(long_wall: int, turn: int) -> Surface:
        return facing(np.repeat(np.array([*shared, long_wall]) + turn, [30] * len(shared) + [100]))

    first = likely_rotations(surface(100, 0), surface(225, -90), NO_TURNS)[0]
    assert math.degrees(first) == pytest.approx(90.0)


def test_keypoints_tell_quarter_turns_apart_that_walls_do_not() -> None:
    room = facing(np.repeat([0, 90, 180, 270], 50))
    turns_rad = np.radians(np.concatenate([np.linspace(0.0, 360.0, 100), np.full(12, 91.0 - 360.0)]))
    first = np.degrees(likely_rotations(room, room, turns_rad))
    assert first[0] == pytest.approx(90.0)
    off_quarter = np.abs(np.remainder(first[:12] + 45.0, 90.0) - 45.0)
    assert off_quarter.max() <= 6.0  # whatever walls allow comes before anything else
    assert np.degrees(likely_rotations(room, room, NO_TURNS))[0] == pytest.approx(0.0)


def test_keypoints_decide_where_walls_say_nothing() -> None:
    circle = facing(np.arange(360))
    assert math.degrees(likely_rotations(circle, circle, np.full(9, math.radians(90.5)))[0]) == pytest.approx(90.0)


def test_rotations_can_be_tried_in_parts() -> None:
    target, source, prepared = fields()
    rotations = likely_rotations(target.surface, source.surface, NO_TURNS)
    right = int(np.abs(np.remainder(rotations - T_A_B.yaw_rad + math.pi, 2 * math.pi) - math.pi).argmin())
    poses = correlate(target, source, prepared.centre, rotations[[right]])
    assert set(poses[:, 2]) == {rotations[right]}
    truth = from_se2(T_A_B @ prepared.grid.T_frame_grid, 0.1)
    assert not differ(truth[None], poses, prepared.centre, 8.0, 3.0).all()


@pytest.mark.parametrize("at", [(0, 260), (260, 0), (0, 320), (320, 0)])
def test_ends_of_long_maps_are_told_apart_though_images_wrap_around(at: tuple[int, int]) -> None:
    place = np.hstack([rooms(90, 130, seed) for seed in (1, 2, 3, 4, 5, 6)])
    a, b = (prepare(grid_of(place[:, start : start + 390]), 0.1) for start in at)
    assert a.field is not None
    assert b.field is not None
    poses = correlate(a.field, b.field, b.centre, by_walls(a.field, b.field, 5))
    truth = np.array([float(at[1] - at[0]), 0.0, 0.0])
    assert not differ(truth[None], poses, b.centre, 6.0, 3.0).all()


@settings(max_examples=25)
@given(shapes=st.tuples(*[st.integers(3, 200)] * 4), seed=st.integers(0, 1000))
def test_maps_of_any_shape_can_be_correlated(shapes: tuple[int, ...], seed: int) -> None:
    rng = np.random.default_rng(seed)
    maps = [
        prepare(grid_of(rng.choice([100, 0, -1], shape).astype(np.int8)), 0.1) for shape in (shapes[:2], shapes[2:])
    ]
    if maps[0].field is not None and maps[1].field is not None:
        rotations = by_walls(maps[0].field, maps[1].field, 3)
        poses = correlate(maps[0].field, maps[1].field, maps[1].centre, rotations)
        assert len(poses) >= 3 * 2 * PEAKS_PER_ROTATION
        assert np.isfinite(poses).all()


@pytest.mark.parametrize("seed", [52170, 61344, 61452])
def test_maps_that_share_little_are_found_by_what_does_not_contradict(
    monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    pair = make_pair("floor-plans", True, seed)
    assert pair.T_target_source is not None
    target, source = prepare(pair.target, 0.05), prepare(pair.source, 0.05)
    assert target.field is not None
    assert source.field is not None
    truth = from_se2(target.grid.T_frame_grid.inverse() @ pair.T_target_source @ source.grid.T_frame_grid, 0.05)
    rotations = by_walls(target.field, source.field, 12)
    poses = correlate(target.field, source.field, source.centre, rotations)
    assert not differ(truth[None], poses, source.centre, 10.0, 5.0).all()
    monkeypatch.setattr(correlation, "CONTRADICTION_WEIGHT", 0.0)
    poses = correlate(target.field, source.field, source.centre, rotations)
    assert differ(truth[None], poses, source.centre, 10.0, 5.0).all()


def test_peaks_at_the_seam_are_told_apart_as_anywhere_else() -> None:
    place = rooms(seed=3)
    prepared = prepare(grid_of(place), 0.1)
    assert prepared.field is not None
    poses = correlate(prepared.field, prepared.field, prepared.centre, np.zeros(1))
    near = ~differ(np.zeros((1, 3)), poses, prepared.centre, 6.0, 1.0)[0]
    assert near.sum() == 2  # one of each correlation
