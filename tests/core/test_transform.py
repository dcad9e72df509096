import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapfusion.transform import SE2, wrap_angle, yaw_from_quaternion

lengths_m = st.floats(-1e3, 1e3)
angles_rad = st.floats(-10.0, 10.0)
motions = st.builds(SE2, lengths_m, lengths_m, angles_rad)


def assert_close(a: SE2, b: SE2, tolerance: float = 1e-9) -> None:
    distance_m, angle_rad = a.distance_to(b)
    assert distance_m < tolerance
    assert angle_rad < tolerance


@given(motions)
def test_the_inverse_undoes_a_motion(T: SE2) -> None:
    assert_close(T @ T.inverse(), SE2.identity())
    assert_close(T.inverse() @ T, SE2.identity())


@given(motions, motions, motions)
def test_composition_is_associative_and_that_of_matrices(a: SE2, b: SE2, c: SE2) -> None:
    assert_close((a @ b) @ c, a @ (b @ c), 1e-8)
    np.testing.assert_allclose((a @ b).matrix(), a.matrix() @ b.matrix(), atol=1e-8)


@given(motions, lengths_m, lengths_m)
def test_points_move_as_by_the_matrix(T: SE2, x: float, y: float) -> None:
    moved = T.apply(np.array([[x, y]]))[0]
    np.testing.assert_allclose([*moved, 1.0], T.matrix() @ [x, y, 1.0], atol=1e-8)


def test_a_quarter_turn_takes_x_to_y() -> None:
    np.testing.assert_allclose(SE2(1.0, 2.0, math.pi / 2).apply(np.array([[1.0, 0.0]])), [[1.0, 3.0]], atol=1e-12)


def test_from_matrix_drops_scale() -> None:
    T = SE2(1.0, -2.0, 2.5)
    scaled = T.matrix()
    scaled[:2, :2] *= 1.7
    assert_close(SE2.from_matrix(scaled[:2]), T)


@given(angles_rad)
def test_wrapped_angles_lie_in_one_turn_and_mean_the_same(angle: float) -> None:
    wrapped = wrap_angle(angle)
    assert -math.pi < wrapped <= math.pi
    assert math.isclose(math.cos(wrapped), math.cos(angle), abs_tol=1e-9)
    assert math.isclose(math.sin(wrapped), math.sin(angle), abs_tol=1e-9)


def test_minus_pi_becomes_pi() -> None:
    assert SE2(0.0, 0.0, -math.pi).yaw_rad == math.pi


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_motion_must_be_finite(bad: float) -> None:
    with pytest.raises(ValueError, match="finite"):
        SE2(bad, 0.0, 0.0)


@given(angles_rad, st.floats(0.1, 3.0))
def test_yaw_of_a_quaternion_about_z_whatever_its_norm(yaw: float, norm: float) -> None:
    got = yaw_from_quaternion(0.0, 0.0, norm * math.sin(yaw / 2), norm * math.cos(yaw / 2))
    assert abs(wrap_angle(got - yaw)) < 1e-9
