"""Hypotheses from the walls as a whole."""

from __future__ import annotations

import math

import numpy as np

from mapfusion.pairwise.correlation import correlate, likely_rotations
from mapfusion.pairwise.poses import differ
from mapfusion.pairwise.prepared import PreparedMap, prepare
from mapfusion.pairwise.surface import Surface
from mapfusion.transform import SE2
from tests.fakes import rooms, seen_from

T_A_B = SE2(20.0, 8.0, 2.0)


def surfaces() -> tuple[Surface, Surface, PreparedMap]:
    place = rooms(seed=3)
    a, b = (prepare(seen_from(place, T, (220, 230)), 0.1) for T in (SE2.identity(), T_A_B))
    assert a.field is not None
    assert b.field is not None
    return a.field.surface, b.field.surface, b


def test_right_pose_is_among_the_best() -> None:
    target, source, prepared = surfaces()
    poses = correlate(target, source, prepared.centre, 20, 30)
    corner_b = prepared.grid.T_frame_grid
    truth = T_A_B @ corner_b
    pose = np.array([truth.x_m / 0.1, truth.y_m / 0.1, truth.yaw_rad])
    assert len(poses) == 30
    assert not differ(pose[None], poses, prepared.centre, 8.0, 3.0).all()


def test_likely_rotations_are_all_rotations_the_right_one_early() -> None:
    target, source, _ = surfaces()
    rotations = likely_rotations(target, source)
    assert np.unique(rotations).size == 120
    away = np.abs(np.remainder(rotations[:8] - 2.0 + math.pi, 2 * math.pi) - math.pi)
    assert away.min() < math.radians(2.0)
