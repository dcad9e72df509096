"""From many hypotheses to the best pose and its rival."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mapfusion.evaluation.pairs import make_pair
from mapfusion.pairwise import search
from mapfusion.pairwise.correlation import PEAKS_PER_ROTATION, STEP_DEGREES, correlate
from mapfusion.pairwise.evidence import weigh
from mapfusion.pairwise.poses import Poses
from mapfusion.pairwise.prepared import MIN_WALL_CELLS, PreparedMap, prepare
from mapfusion.pairwise.refine import refine
from mapfusion.pairwise.rough import Hypotheses
from mapfusion.pairwise.scrutiny import scrutinise
from mapfusion.pairwise.search import (
    LARGE_CELLS,
    NUM_FIRST_LOOKS,
    QUICK,
    THOROUGH,
    Candidate,
    Effort,
    Finding,
    are_alike,
    examine,
    have_many_walls,
    propose,
    refine_best,
    with_rivals_of,
)
from mapfusion.pairwise.surface import SurfaceField
from mapfusion.pairwise.voting import match
from tests.core.pairwise.test_verdict import GOOD
from tests.fakes import grid_of, rooms


@pytest.fixture(scope="module")
def place() -> PreparedMap:
    return prepare(grid_of(rooms(seed=3)), 0.1)


def candidate(x_cells: float, lines: float) -> Candidate:
    return Candidate(np.array([x_cells, 0.0, 0.0]), GOOD | {"lines": lines})


def test_the_nearest_rival_of_either_search_counts(place: PreparedMap) -> None:
    best, weak, strong = candidate(0.0, 30.0), candidate(60.0, 5.0), candidate(120.0, 20.0)
    finding = Finding(best, np.eye(3), weak, is_searched=True)
    other = Finding(candidate(1.0, 31.0), np.eye(3), strong, is_searched=True)
    assert with_rivals_of(finding, other, place, place).rival is strong
    assert with_rivals_of(finding, Finding(strong, np.eye(3), best), place, place).rival is strong


def test_a_rival_with_as_much_evidence_is_nearer_than_a_more_plausible_one_with_little(place: PreparedMap) -> None:
    best, much, little = candidate(0.0, 30.0), candidate(60.0, 19.0), candidate(120.0, 20.0)
    little = replace(little, figures=little.figures | {"net": 105.0})
    assert little.plausibility > much.plausibility
    for first, second in ((much, little), (little, much)):
        finding = Finding(best, np.eye(3), first, is_searched=True)
        assert with_rivals_of(finding, Finding(best, np.eye(3), second), place, place).rival is much


def test_findings_are_alike_unless_they_are_different_answers(place: PreparedMap) -> None:
    one = Finding(candidate(0.0, 30.0), np.eye(3), candidate(60.0, 30.0))
    assert are_alike(one, Finding(candidate(3.0, 5.0), np.eye(3)), place, place)
    assert not are_alike(one, Finding(candidate(60.0, 30.0), np.eye(3), one.best), place, place)


def test_what_is_the_same_alignment_is_no_rival(place: PreparedMap) -> None:
    finding = Finding(candidate(0.0, 30.0), np.eye(3), None, is_searched=True)
    other = Finding(candidate(2.0, 31.0), np.eye(3), candidate(3.0, 20.0), is_searched=True)
    assert with_rivals_of(finding, other, place, place).rival is None


def test_what_walls_fix_belongs_to_the_pose_that_is_kept(place: PreparedMap, monkeypatch: pytest.MonkeyPatch) -> None:
    def favouring_the_last(*args: Any) -> Any:
        evidence = weigh(*args)
        return replace(
            evidence, net=evidence.net * np.where(np.arange(len(evidence.net)) + 1 < len(evidence.net), 0.01, 1.0)
        )

    assert place.field is not None
    beside = np.array([2.0, 0.0, 0.0])
    polished = search.recheck(place, place, beside)
    monkeypatch.setattr(search, "weigh", favouring_the_last)
    kept = search.recheck(place, place, beside)
    assert np.array_equal(kept.best.pose, beside)
    assert not np.array_equal(polished.best.pose, beside)
    _, (there,) = refine(
        place.field, place.field, beside[None], place.centre, search.POLISH_REACHES[-1:], search.POLISH_POINTS
    )
    assert np.array_equal(kept.information, there)
    assert not np.array_equal(kept.information, polished.information)


def test_where_walls_fix_nothing_the_covariance_is_large_and_finite() -> None:
    nothing = Finding(Candidate(np.zeros(3), GOOD | {"residual_cells": 0.0, "num_walls": 40.0}), np.zeros((3, 3)))
    exact = replace(nothing, information=1000.0 * np.eye(3))
    assert np.allclose(np.diag(nothing.covariance), 12.0 * 0.3**2 / 1e-3)
    assert np.allclose(np.diag(exact.covariance), 12.0 * 0.3**2 / 1000.0, rtol=1e-3)


@pytest.mark.parametrize(
    ("tolerance_cells", "lines", "cells_as_one"),
    [(3.0, 5.0, 80.0), (6.0, 20.0, 20.0), (6.0, 100.0, 12.0), (1.5, 5.0, 12.0)],
)
def test_cells_of_one_wall_that_do_not_agree_closely_fix_a_pose_together(
    tolerance_cells: float, lines: float, cells_as_one: float
) -> None:
    figures = GOOD | {"residual_cells": 2.0, "num_walls": 800.0, "ratio": 0.5, "lines": lines}
    figures["tolerance_cells"] = tolerance_cells
    found = Finding(Candidate(np.zeros(3), figures), 400.0 * np.eye(3))
    assert np.allclose(np.diag(found.covariance), cells_as_one * 2.0**2 / 400.0, rtol=1e-3)


def test_a_large_map_with_too_few_walls_for_a_coarser_resolution_is_turned_as_often_as_any() -> None:
    cells = np.zeros((LARGE_CELLS + 100, 80), np.int8)
    cells[20:36, 20:22], cells[20:22, 20:28] = 100, 100
    sparse = prepare(grid_of(cells), 0.1)
    assert sparse.num_walls >= MIN_WALL_CELLS > sparse.coarser.num_walls
    hypotheses = propose(sparse, sparse, match(sparse.features, sparse.features), THOROUGH)
    assert len(hypotheses) >= THOROUGH.num_rotations * 2 * PEAKS_PER_ROTATION


def test_a_thorough_search_goes_all_the_way_round(place: PreparedMap, monkeypatch: pytest.MonkeyPatch) -> None:
    """The likely rotations and every other one of the rest, none twice by a quick search and the one after it."""
    tried: list[list[int]] = []

    def noting(target: SurfaceField, source: SurfaceField, centre: Poses, rotations: Poses) -> Poses:
        tried.append(sorted(round(degrees) for degrees in np.degrees(rotations)))
        return correlate(target, source, centre, rotations[:1])

    monkeypatch.setattr(search, "correlate", noting)
    matches = match(place.features, place.features)
    propose(place, place, matches, QUICK)
    propose(place, place, matches, THOROUGH, before=QUICK)
    quick, thorough = tried
    assert len(quick) == QUICK.num_rotations
    assert len(set(quick + thorough)) == len(quick) + len(thorough)
    assert set(range(0, 360, 2 * STEP_DEGREES)) <= set(quick + thorough)
    assert len(quick) + len(thorough) < 360 // STEP_DEGREES


def test_of_large_maps_a_pose_that_keypoints_speak_for_is_refined_whatever_its_walls_say(
    place: PreparedMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    far = [[100.0 + 10.0 * i, 200.0 * (-1) ** j, 0.1 * j] for i in range(10) for j in range(8)]
    hypotheses = Hypotheses(np.array([*far, [1.0, -1.0, 0.01]]), np.array([*range(1, len(far) + 1), 0.0]))

    def is_found(effort: Effort = THOROUGH) -> bool:
        poses = refine_best(place, place, hypotheses, effort)
        return bool((np.abs(poses) < [0.5, 0.5, 0.01]).all(axis=1).any())

    assert not is_found()
    monkeypatch.setattr(search, "have_many_walls", lambda *_: True)
    assert is_found()
    assert not is_found(QUICK)


def test_votes_of_more_keypoints_are_refined_before_they_are_ranked(
    place: PreparedMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    matches = match(place.features, place.features)
    assert not have_many_walls(place, place)
    monkeypatch.setattr(search, "have_many_walls", lambda *_: True)
    monkeypatch.setattr(search, "correlate", lambda *_: np.zeros((0, 3)))
    hypotheses = propose(place, place, matches, THOROUGH, before=QUICK)
    assert (np.abs(hypotheses.poses[hypotheses.scores.argmax()]) < [0.1, 0.1, 0.002]).all()


def searched(is_related: bool, worth: float, monkeypatch: pytest.MonkeyPatch) -> tuple[Finding, int]:
    """What a quick search of a pair finds, and how many poses it looks at closely."""
    pair = make_pair("paper", is_related, 900202)
    target, source = prepare(pair.target, 0.05), prepare(pair.source, 0.05)
    matches = match(target.features, source.features)
    hypotheses = propose(target, source, matches, QUICK)
    looks = 0

    def counted(*args: Any) -> Any:
        nonlocal looks
        looks += 1
        return scrutinise(*args)

    monkeypatch.setattr(search, "scrutinise", counted)
    return examine(target, source, hypotheses, matches, QUICK, worth), looks


def test_a_search_that_cannot_come_to_anything_ends_after_the_first_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    whole, num_looks = searched(False, 0.0, monkeypatch)
    assert not whole.is_hopeless
    assert num_looks >= QUICK.num_scrutinised + 1  # once more after the polish; slides may come before first looks
    early, num_looks = searched(False, 0.05, monkeypatch)
    assert early.is_hopeless
    assert num_looks == NUM_FIRST_LOOKS
    assert "firmness" not in early.best.figures  # its parts were not looked at
    assert 0.0 <= whole.best.figures["firmness"] <= 1.0
    assert np.linalg.eigvalsh(early.information).min() > 0.0


def test_a_search_that_may_come_to_something_is_the_same_as_a_whole_one(monkeypatch: pytest.MonkeyPatch) -> None:
    (whole, num_looks), (other, num_other) = (searched(True, worth, monkeypatch) for worth in (0.0, 0.9))
    assert not other.is_hopeless
    assert num_other == num_looks  # none of them twice
    assert other.best.figures == whole.best.figures
    assert np.array_equal(other.best.pose, whole.best.pose)
