"""How far the agreement of two maps lies above what chance would give."""

from __future__ import annotations

import numpy as np
import pytest

from mapfusion.grid import Cells
from mapfusion.pairwise.evidence import DEPENDENT_CELLS, Evidence, against_chance, discounted, weigh
from mapfusion.pairwise.prepared import prepare
from tests.fakes import flat, grid_of, rooms


def weighed(a: Cells, b: Cells, *poses: tuple[float, float, float]) -> Evidence:
    return weigh(prepare(grid_of(a), 0.1), prepare(grid_of(b), 0.1), np.array(poses), 2000)


def test_agreement_at_chance_or_below_is_no_evidence() -> None:
    evidence = against_chance(np.full(3, 100.0), np.array([10.0, 30.0, 80.0]), 0.3)
    assert evidence[:2].tolist() == [0.0, 0.0]
    expected = 100.0 * (0.8 * np.log(0.8 / 0.3) + 0.2 * np.log(0.2 / 0.7)) / DEPENDENT_CELLS
    assert evidence[2] == pytest.approx(expected)


def test_contradictions_as_many_as_by_chance_leave_nothing() -> None:
    left = discounted(np.full(4, 8.0), np.array([0.0, 0.5, 1.0, 1.5]))
    assert left.tolist() == [8.0, 2.0, 0.0, 0.0]


def test_a_map_agrees_with_itself_where_it_lies_and_nowhere_else() -> None:
    place = rooms(seed=3)
    evidence = weighed(place, place, (0.0, 0.0, 0.0), (25.0, 0.0, 0.0), (0.0, 20.0, 0.3))
    assert evidence.ratio[0] == pytest.approx(1.0)
    assert evidence.contradiction[0] == 0.0
    assert evidence.mutual_ratio[0] == pytest.approx(1.0, abs=0.02)
    assert (evidence.net[1:] < 0.2 * evidence.net[0]).all()
    assert (evidence.contradiction[1:] > 0.3).all()


def test_evidence_of_poses_can_be_joined() -> None:
    place = rooms(seed=3)
    poses = (0.0, 0.0, 0.0), (25.0, 0.0, 0.0), (0.0, 20.0, 0.3)
    joined = weighed(place, place, *poses[:1]).joined(weighed(place, place, *poses[1:]))
    whole = weighed(place, place, *poses)
    for k in range(3):
        assert joined.of(k) == pytest.approx(whole.of(k))


def test_rooms_back_to_back_at_one_wall_do_not_agree() -> None:
    room = flat(100, 200, -1)
    room[20:, :] = 0
    room[16:20, :] = 100
    back = room[::-1].copy()
    evidence = weighed(room, back, (0.0, -64.0, 0.0))
    assert evidence.net[0] < 1.0


def test_a_lone_wall_is_conditioned_in_one_direction_only() -> None:
    cells = flat(100, 300, 0)
    cells[48:52] = 100
    place = rooms(seed=3)
    assert weighed(cells, cells, (0.0, 0.0, 0.0)).conditioning[0] < 0.01
    assert weighed(place, place, (0.0, 0.0, 0.0)).conditioning[0] > 0.3
