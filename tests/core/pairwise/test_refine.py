"""Poses to a fraction of a cell."""

from __future__ import annotations

import numpy as np

from mapfusion.pairwise.poses import moved
from mapfusion.pairwise.prepared import prepare
from mapfusion.pairwise.refine import refine
from mapfusion.transform import SE2
from tests.fakes import flat, grid_of, rooms, seen_from

T_A_B = SE2(20.0, 8.0, 2.0)


def test_a_pose_some_cells_off_is_drawn_to_the_truth() -> None:
    place = rooms(seed=3)
    a, b = (prepare(seen_from(place, T, (220, 230)), 0.1) for T in (SE2.identity(), T_A_B))
    assert a.field is not None
    assert b.field is not None
    truth = T_A_B @ b.grid.T_frame_grid
    pose = np.array([[truth.x_m / 0.1, truth.y_m / 0.1, truth.yaw_rad]])
    starts = pose + np.array([[0.0, 0.0, 0.0], [4.0, -3.0, 0.0], [0.0, 0.0, 0.03]])
    poses, information = refine(a.field, b.field, starts, b.centre, (8.0, 8.0, 6.0, 4.0, 3.0, 3.0, 3.0), 600)
    inside = b.field.surface.points
    error = np.abs(moved(poses, inside) - moved(pose, inside)).max(axis=(1, 2))
    assert (error < 0.5).all(), error
    assert (np.linalg.eigvalsh(information) > 0.0).all()


def test_a_corridor_stays_where_it_is_along_itself() -> None:
    cells = flat(60, 400, -1)
    cells[20:40] = 0
    cells[[18, 19, 40, 41]] = 100
    a = prepare(grid_of(cells), 0.1)
    assert a.field is not None
    start = np.array([[30.0, 2.0, 0.0]])
    poses, information = refine(a.field, a.field, start, a.centre, (6.0, 5.0, 4.0, 3.0), 600)
    assert abs(poses[0, 1]) < 0.1
    assert abs(poses[0, 0] - 30.0) < 1.0
    assert information[0, 0, 0] < 0.05 * information[0, 1, 1]
