from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from mapfusion.evaluation import attempts
from mapfusion.evaluation.attempts import Study, attempt_pair, run_study
from mapfusion.evaluation.pairs import StudyPair
from mapfusion.grid import OccupancyGrid
from mapfusion.result import PairFusion
from mapfusion.transform import SE2

SMALL = Study(generators=("paper",), num_related=3, num_unrelated=2, seed=11, profiles=("paper",))


def test_attempts_come_in_order_and_from_their_own_seeds() -> None:
    found = list(run_study(SMALL))
    assert len(found) == SMALL.num_attempts == 5
    assert [a.related for a in found] == [True] * 3 + [False] * 2
    assert len({a.seed for a in found}) == 5
    longer = list(run_study(replace(SMALL, num_related=4, num_unrelated=0)))
    assert longer[:3] == found[:3]


def test_an_executor_changes_nothing() -> None:
    with ThreadPoolExecutor(3) as executor:
        assert list(run_study(SMALL, executor)) == list(run_study(SMALL))


def test_unrelated_pairs_have_no_errors_and_are_never_right() -> None:
    (attempt,) = attempt_pair(("paper", False, 0), ("paper",))
    assert attempt.errors is None
    assert not attempt.right
    assert (attempt.overlap_ratio, attempt.rotation_deg) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("off", "corners_cells", "centre_cells", "angle_deg", "right"),
    [
        (SE2(0.0, 0.0, 0.0), 0.0, 0.0, 0.0, True),
        (SE2(0.15, -0.20, 0.0), 5.0, 5.0, 0.0, False),
        (SE2(0.09, 0.12, 0.0), 3.0, 3.0, 0.0, True),
        (SE2(0.0, 0.0, math.radians(1.0)), None, 0.0, 1.0, True),
        (SE2(0.0, 0.0, math.radians(-179.0)), None, 0.0, 179.0, False),
    ],
)
def test_errors_are_those_of_the_transform(
    monkeypatch: pytest.MonkeyPatch,
    off: SE2,
    corners_cells: float | None,
    centre_cells: float,
    angle_deg: float,
    right: bool,
) -> None:
    # A map of 80 x 40 known cells whose middle is the origin of its frame, and a robot 3 m off it.
    cells = np.full((60, 100), -1, np.int8)
    cells[10:50, 10:90] = 0
    source = OccupancyGrid(cells, 0.05, SE2(-2.5, -1.5, 0.0))
    truth = SE2(4.0, 5.0, 0.6)
    pair = StudyPair(source, source, truth, 0.5, SE2(3.0, 0.0, 1.0))
    result = PairFusion(accepted=True, T_target_source=truth @ off, mae=1.0, confidence=0.9)
    monkeypatch.setattr(attempts, "make_pair", lambda *which: pair)
    monkeypatch.setattr(attempts, "fuse_pair", lambda *maps: result)

    (attempt,) = attempt_pair(("paper", True, 0), ("paper",))
    errors = attempt.errors
    assert errors is not None
    turn = 2.0 * math.sin(abs(off.yaw_rad) / 2.0)
    expected_corners = turn * math.hypot(40, 20) if corners_cells is None else corners_cells
    assert errors.corners_cells == pytest.approx(expected_corners, abs=1e-6)
    assert errors.centre_cells == pytest.approx(centre_cells, abs=1e-6)
    assert errors.angle_deg == pytest.approx(angle_deg, abs=1e-6)
    assert errors.robot_m == pytest.approx(math.hypot(off.x_m, off.y_m) + turn * 3.0, abs=1e-6)
    assert errors.robot_cells == pytest.approx(errors.robot_m / 0.05, abs=1e-6)
    assert attempt.right is right
    assert attempt.rotation_deg == pytest.approx(math.degrees(0.6))


@pytest.mark.parametrize("field", ["num_related", "num_unrelated", "seed"])
def test_negative_numbers_are_the_callers_mistake(field: str) -> None:
    with pytest.raises(ValueError, match="must not be negative"):
        Study(**{field: -1})  # type: ignore[arg-type]
