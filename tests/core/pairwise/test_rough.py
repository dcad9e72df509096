"""Many poses told apart by a rough score."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from mapfusion.pairwise.poses import centre_moved, differ, pose_from_centre
from mapfusion.pairwise.prepared import PreparedMap, prepare
from mapfusion.pairwise.rough import (
    SAME_CELLS,
    SAME_DEGREES,
    TIGHT_STEPS,
    WIDE_STEPS,
    Steps,
    best_distinct,
    best_nearby,
    scored,
)
from mapfusion.transform import SE2
from tests.fakes import rooms, seen_from

T_A_B = SE2(20.0, 8.0, 2.0)


@pytest.fixture(scope="module")
def maps() -> tuple[PreparedMap, PreparedMap]:
    place = rooms(seed=3)
    a, b = (prepare(seen_from(place, T, (220, 230)), 0.1) for T in (SE2.identity(), T_A_B))
    return a, b


def displaced(source: PreparedMap, cells: tuple[float, float], degrees: float) -> npt.NDArray[np.float64]:
    """(1, 3) the true pose, moved and turned about the source's centre."""
    truth = T_A_B @ source.grid.T_frame_grid
    pose = np.array([[truth.x_m / 0.1, truth.y_m / 0.1, truth.yaw_rad]])
    at = centre_moved(pose, source.centre) + np.array(cells)
    return pose_from_centre(pose[:, 2] + np.radians(degrees), at, source.centre)


@pytest.mark.parametrize(
    ("steps", "cells", "degrees"), [(WIDE_STEPS, (6.0, -3.0), 4.0), (TIGHT_STEPS, (-4.0, 2.0), -3.0)]
)
def test_the_truth_is_found_on_the_lattice_around_a_pose(
    maps: tuple[PreparedMap, PreparedMap], steps: Steps, cells: tuple[float, float], degrees: float
) -> None:
    target, source = maps
    start = displaced(source, cells, degrees)
    best = best_nearby(target, source, start, steps)
    truth = displaced(source, (0.0, 0.0), 0.0)
    assert differ(truth, start, source.centre, 4.0, 2.5).all()
    assert not differ(truth, best, source.centre, steps.cells + 0.1, steps.degrees / 2).any()


def test_the_best_poses_come_first_and_none_is_like_another(maps: tuple[PreparedMap, PreparedMap]) -> None:
    target, source = maps
    far = [displaced(source, (60.0 * k, 0.0), 0.0) for k in range(1, 4)]
    truth, near = displaced(source, (0.0, 0.0), 0.0), displaced(source, (2.0, 0.0), 1.0)
    hypotheses = scored(target, source, np.concatenate([*far, near]), 400).joined(scored(target, source, truth, 400))
    poses = best_distinct(hypotheses, source.centre, 3)
    assert len(poses) == 3
    assert not differ(truth, poses[:1], source.centre, 2.1, 1.1).any()
    assert differ(poses, poses, source.centre, SAME_CELLS, SAME_DEGREES).sum() == 6
