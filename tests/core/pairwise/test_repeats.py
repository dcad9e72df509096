"""What repeats itself within one map, on rows of rooms drawn for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mapfusion.grid import Cells
from mapfusion.pairwise import search
from mapfusion.pairwise.poses import after
from mapfusion.pairwise.prepared import PreparedMap, prepare
from mapfusion.pairwise.repeats import repeats, weighed_against_repeats
from mapfusion.pairwise.search import Candidate, Finding
from mapfusion.pairwise.verdict import may_repeat_itself, repeats_itself
from mapfusion.pairwise.voting import match
from tests.fakes import flat, grid_of, rooms

RESOLUTION_M = 0.1
PITCH, DEPTH, CORRIDOR = 60, 70, 30


def row_of_rooms(number: int, before: int = 0, after: int = 0) -> Cells:
    """Rooms of one plan along a corridor, their doors all alike, with so many cells of corridor before and after."""
    cells = flat(DEPTH + CORRIDOR + 4, before + number * PITCH + after + 2, 0)
    cells[[0, 1, -2, -1]] = cells[:, [0, 1, -2, -1]] = 100
    cells[DEPTH : DEPTH + 2] = 100
    for k in range(number + 1):
        left = before + k * PITCH
        cells[:DEPTH, left : left + 2] = 100
        if k < number:
            cells[DEPTH : DEPTH + 2, left + 15 : left + 30] = 0
            cells[20:34, left + 40 : left + 50] = 100
    return cells


def map_of(cells: Cells) -> PreparedMap:
    return prepare(grid_of(cells), RESOLUTION_M)


def found_at(target: PreparedMap, source: PreparedMap, x: float) -> Finding:
    """What a search says of the source moved along x, without a rival."""
    matches = match(target.features, source.features)
    found = search.recheck(target, source, np.array([x, 0.0, 0.0]), matches)
    return replace(search.with_firmness(found, target, source), is_searched=True)


@pytest.fixture(scope="module")
def row() -> PreparedMap:
    return map_of(row_of_rooms(6))


def test_a_row_of_rooms_repeats_itself_by_whole_rooms(row: PreparedMap) -> None:
    found = repeats(row)
    assert len(found.poses) >= 4
    unturned = found.poses[np.abs(np.sin(found.poses[:, 2])) < 0.01]
    rooms_off = unturned[:, 0] / PITCH
    np.testing.assert_allclose(rooms_off, np.round(rooms_off), atol=0.04)
    assert (np.abs(np.round(rooms_off)) >= 1).all()
    assert {-1, 1} <= set(np.round(rooms_off).astype(int).tolist())
    there, back = np.split(found.poses, 2)
    np.testing.assert_allclose(after(there, back), 0.0, atol=1e-9)


def test_only_walls_with_their_like_elsewhere_recur(row: PreparedMap) -> None:
    assert row.field is not None
    found = repeats(row)
    assert found.recurs.mean() > 0.9
    place = row_of_rooms(6)
    place[-20:-8, 100:130] = 100  # a thing of its own, in the corridor
    marked = map_of(place)
    assert marked.field is not None
    (x, y), recurs = marked.field.surface.points.T, repeats(marked).recurs
    at_thing = (x > 98) & (x < 132) & (y > place.shape[0] - 22) & (y < place.shape[0] - 6)
    assert recurs[at_thing].mean() < 0.3
    assert recurs[~at_thing].mean() > 0.8


def test_a_place_without_two_like_parts_does_not_repeat_itself() -> None:
    one = map_of(rooms(seed=3)[:230, :250])  # not all of it: the outer wall lies on itself after half a turn
    found = repeats(one)
    assert found.recurs.mean() < 0.1


def test_rooms_that_agree_with_others_are_no_sign_of_the_same_rooms() -> None:
    target, source = map_of(row_of_rooms(6)), map_of(row_of_rooms(4, after=40))
    finding = found_at(target, source, 0.0)
    weighed = weighed_against_repeats(finding, target, source, match(target.features, source.features))
    assert finding.best.figures["ratio"] > 0.9
    figures = weighed.best.figures
    assert figures["recurring"] > 0.9
    assert figures["like_fit"] > -1.0
    assert repeats_itself(figures)
    np.testing.assert_array_equal(weighed.best.pose, finding.best.pose)


def test_walls_that_do_not_recur_are_such_a_sign() -> None:
    place = row_of_rooms(6, before=50)
    for at, height in ((20, 12), (130, 8), (300, 16)):
        place[-24 : -24 + height, at : at + 25] = 100  # things of their own, in the corridor
    target, source = map_of(place), map_of(place[:, :300])
    weighed = weighed_against_repeats(
        found_at(target, source, 0.0), target, source, match(target.features, source.features)
    )
    figures = weighed.best.figures
    assert figures["recurring"] > 0.5
    assert figures["like_fit"] < -1.0
    assert figures["rest_ratio"] > 0.9
    assert not repeats_itself(figures)


def test_what_follows_and_fits_better_is_the_rival() -> None:
    place = row_of_rooms(6, before=50, after=90)
    target, source = map_of(place), map_of(place)
    matches = match(target.features, source.features)
    off_by_a_room = found_at(target, source, float(PITCH))
    assert off_by_a_room.rival is None
    assert may_repeat_itself(off_by_a_room)
    rival = weighed_against_repeats(off_by_a_room, target, source, matches).rival
    assert rival is not None
    assert rival.figures["repeats"] == 1.0
    np.testing.assert_allclose(rival.pose, np.zeros(3), atol=0.1)


def test_the_right_pose_has_no_such_rival() -> None:
    place = row_of_rooms(6, before=50, after=90)
    target, source = map_of(place), map_of(place)
    finding = found_at(target, source, 0.0)
    assert weighed_against_repeats(finding, target, source, match(target.features, source.features)).rival is None
    stronger = Candidate(np.array([9.0, 9.0, 0.0]), finding.best.figures)
    known = replace(finding, rival=stronger)
    assert weighed_against_repeats(known, target, source, match(target.features, source.features)).rival is stronger


def test_a_wall_that_agrees_with_one_that_recurs_is_no_such_sign() -> None:
    room = row_of_rooms(1)
    room[-24:-4, 5:58] = 100  # a thing of its own, which the other map does not have
    target, source = map_of(row_of_rooms(4)), map_of(room)
    assert repeats(source).recurs.mean() < 0.1
    found = found_at(target, source, 0.0)
    assert found.best.figures["ratio"] > 0.6
    figures = weighed_against_repeats(found, target, source, match(target.features, source.features)).best.figures
    assert figures["rest_ratio"] < 0.2


def test_few_walls_of_their_own_are_not_all_there_is() -> None:
    both = []
    for width in (0, 3, 30):
        place = row_of_rooms(4)
        place[-20:-8, 100 : 100 + width] = 100  # a thing of its own, in the corridor
        same = map_of(place)
        found = found_at(same, same, 0.0)
        both.append(weighed_against_repeats(found, same, same, match(same.features, same.features)).best.figures)
    none, few, more = (figures["rest_ratio"] for figures in both)
    assert none == 0.0
    assert 0.3 < few < 0.95  # all agree: 6 more are reckoned with
    assert few < more < 1.0


def test_the_map_of_which_more_agrees_says_how_much_does() -> None:
    place = row_of_rooms(4)
    place[-24:-12, 100:125] = 100  # a thing that both have
    other = place.copy()
    other[-24:-8, 30:90] = 100  # and one that only the second has
    target, source = map_of(place), map_of(other)
    for maps in ((target, source), (source, target)):
        found = found_at(*maps, 0.0)
        figures = weighed_against_repeats(found, *maps, match(maps[0].features, maps[1].features)).best.figures
        assert figures["rest_ratio"] > 0.8


def test_a_rival_s_parts_are_told_from_the_best_one_s() -> None:
    target, source = map_of(row_of_rooms(6, before=50)), map_of(row_of_rooms(4, before=50))
    matches = match(target.features, source.features)
    best = found_at(target, source, 0.0)
    room_off = found_at(target, source, float(PITCH)).best
    weighed = weighed_against_repeats(replace(best, rival=room_off), target, source, matches)
    assert weighed.rival is not None
    rival_s = search.with_firmness(replace(best, best=weighed.rival), target, source).best.figures["firmness"]
    assert weighed.best.figures["firm_lead"] == best.best.figures["firmness"] - rival_s


def test_where_there_is_neither_rival_nor_like_all_parts_lead() -> None:
    place = map_of(rooms(seed=3)[:230, :250])
    best = found_at(place, place, 0.0)
    weighed = weighed_against_repeats(best, place, place, match(place.features, place.features))
    assert weighed.best.figures["firm_lead"] == best.best.figures["firmness"] > 0.5
    assert weighed.best.figures["recurring"] < 0.1
