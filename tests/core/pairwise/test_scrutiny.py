"""What a closer look at a pose finds, on walls drawn for it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mapfusion.grid import Cells, Mask
from mapfusion.pairwise.prepared import prepare
from mapfusion.pairwise.scrutiny import Scrutiny, _runs, scrutinise
from mapfusion.pairwise.surface import SurfaceField
from tests.fakes import flat, grid_of, rooms

AS_IT_IS = np.zeros(3)


def field_of(cells: Cells) -> SurfaceField:
    field = prepare(grid_of(cells), 0.1).field
    assert field is not None
    return field


def look(target: Cells, source: Cells) -> Scrutiny:
    return scrutinise(field_of(target), field_of(source), AS_IT_IS, 1.5)


def corridor(width: int = 20) -> Cells:
    """A corridor of 200 cells along x, its walls 3 cells thick, with open ends."""
    cells = flat(width + 6, 200, 0)
    cells[:3] = cells[-3:] = 100
    return cells


def test_a_map_agrees_with_itself() -> None:
    found = look(rooms(seed=3), rooms(seed=3))
    assert (found.crossing, found.crossing_cells, found.opposite, found.outside) == (0.0, 0.0, 0.0, 0.0)
    assert found.lines > 12.0


def test_a_corner_is_two_walls_however_long() -> None:
    for length in (60, 200):
        corner = flat(length + 20, length + 20, -1)
        corner[3:length, 3:length] = 0
        corner[:3, :length] = corner[:length, :3] = 100
        assert look(corner, corner).lines == pytest.approx(2.0, abs=0.3)


def test_a_round_thing_holds_no_rotation_and_a_square_one_does() -> None:
    rows, cols = np.mgrid[:200, :200] - 99.5
    round_room, square_room = flat(200, 200, -1), flat(200, 200, -1)
    for room, radius in ((round_room, np.hypot(rows, cols)), (square_room, np.maximum(np.abs(rows), np.abs(cols)))):
        room[radius < 73] = 100
        room[radius < 70] = 0
    assert look(round_room, round_room).turning < 0.02
    assert look(square_room, square_room).turning == pytest.approx(0.25, abs=0.05)


def test_roughness_does_not_multiply_walls() -> None:
    place = rooms(seed=3)
    rows, cols = np.nonzero(place == 100)
    rough = []
    for seed in (0, 1):
        rng = np.random.default_rng(seed)
        cells = np.where(place == 100, 0, place).astype(np.int8)
        moved = [
            (at + rng.integers(-1, 2, len(at))).clip(0, n - 1) for at, n in zip((rows, cols), place.shape, strict=True)
        ]
        cells[moved[0], moved[1]] = 100
        rough.append(cells)
    assert look(rough[0], rough[1]).lines < 2.5 * look(place, place).lines


def test_nothing_agrees_where_maps_do_not_meet() -> None:
    field = field_of(rooms(seed=3))
    found = scrutinise(field, field, np.array([1000.0, 0.0, 0.0]), 1.5)
    assert (found.lines, found.outside) == (0.0, 1.0)


def test_a_wall_across_a_passage_is_a_run_of_its_length() -> None:
    closed = corridor(30)
    closed[3:-3, 100:103] = 100
    found = look(corridor(30), closed)
    # What lies within NEAR_CELLS of the corridor's walls does not count: 30 - 2 x 4, seen from both sides.
    assert 20 <= found.crossing_cells <= 52
    assert found.crossing > 0.02
    assert look(corridor(30), corridor(30)).crossing == 0.0


def test_a_wall_that_moved_sideways_does_not_cross() -> None:
    moved = corridor(40)
    moved[3:11] = 100  # the lower wall stands 8 cells further in
    found = look(corridor(40), moved)
    assert found.crossing_cells < 8


@pytest.mark.parametrize("length", [40, 150])
def test_a_wall_in_the_open_strays_however_it_lies(length: int) -> None:
    hall = corridor(60)
    walled = hall.copy()
    walled[30:32, 20 : 20 + length] = 100  # along the hall, where no wall is near
    found = look(hall, walled)
    assert found.crossing_cells < 8
    assert found.stray_cells == pytest.approx(length, abs=6)
    assert look(walled, hall).stray_cells == found.stray_cells
    assert look(walled, walled).stray_cells == 0.0


def test_a_wall_a_few_cells_off_does_not_stray() -> None:
    moved = corridor(60)
    moved[3:9] = 100
    assert look(corridor(60), moved).stray_cells == 0.0


def test_walls_seen_from_the_other_side_are_counted() -> None:
    inside, outside = corridor(20), flat(26, 200, 0)
    outside[3:-3] = 100  # the same two faces, with the free space where the other one has wall
    outside[:3] = outside[-3:] = 0
    assert look(inside, outside).opposite > 0.8
    assert look(inside, inside).opposite == 0.0


@given(hnp.arrays(np.bool_, hnp.array_shapes(min_dims=2, max_dims=2, max_side=24), fill=st.just(False)))
def test_runs_are_walls_connected_over_gaps(mask: Mask) -> None:
    rows, columns = np.nonzero(mask)
    points = np.stack([columns, rows], axis=-1).astype(np.float32) + np.float32(0.5)
    wide = np.pad(mask, 2).view(np.uint8)
    _, labels = cv2.connectedComponents(cv2.dilate(wide, np.ones((3, 3), np.uint8)), connectivity=8)
    of_points = labels[2:-2, 2:-2][mask]
    runs = [points[of_points == label] for label in np.unique(of_points)]
    expected = sorted((len(run), round(float(np.hypot(*np.ptp(run, axis=0))), 3)) for run in runs)
    counts, lengths = _runs(points, np.arange(len(points)))
    assert sorted(zip(counts.tolist(), lengths.round(3).tolist(), strict=True)) == expected
