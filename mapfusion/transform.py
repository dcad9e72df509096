"""Rigid motions of the plane."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


def wrap_angle(angle_rad: float) -> float:
    """The same angle in (-pi, pi]."""
    wrapped = math.remainder(angle_rad, 2.0 * math.pi)
    return math.pi if wrapped == -math.pi else wrapped


def yaw_from_quaternion(x: float, y: float, z: float, w: float) -> float:
    """Heading about +z of a quaternion, in radians; the quaternion need not have norm 1.

    Source: REP-103; the ZYX Euler angle psi.
    """
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


@dataclass(frozen=True, slots=True)
class SE2:
    """A rigid motion of the plane; as `T_target_source` it takes points of the source frame to the target frame.

    Attributes:
        x_m: Translation along the target's x, metres.
        y_m: Translation along the target's y, metres.
        yaw_rad: Rotation, radians, counter-clockwise, kept in (-pi, pi].
    """

    x_m: float
    y_m: float
    yaw_rad: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.x_m) and math.isfinite(self.y_m) and math.isfinite(self.yaw_rad)):
            raise ValueError(f"SE2 needs finite numbers, not ({self.x_m}, {self.y_m}, {self.yaw_rad})")
        object.__setattr__(self, "x_m", float(self.x_m))
        object.__setattr__(self, "y_m", float(self.y_m))
        object.__setattr__(self, "yaw_rad", wrap_angle(float(self.yaw_rad)))

    @classmethod
    def identity(cls) -> SE2:
        """The motion that leaves every point where it is."""
        return cls(0.0, 0.0, 0.0)

    @classmethod
    def from_matrix(cls, matrix: FloatArray) -> SE2:
        """From a (2, 3) or (3, 3) matrix [R | t]; a uniform scale in R is dropped."""
        return cls(float(matrix[0, 2]), float(matrix[1, 2]), math.atan2(float(matrix[1, 0]), float(matrix[0, 0])))

    def matrix(self) -> FloatArray:
        """The (3, 3) homogeneous matrix."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return np.array([[c, -s, self.x_m], [s, c, self.y_m], [0.0, 0.0, 1.0]])

    def __matmul__(self, other: SE2) -> SE2:
        """Composition: `T_a_c = T_a_b @ T_b_c`."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return SE2(
            self.x_m + c * other.x_m - s * other.y_m,
            self.y_m + s * other.x_m + c * other.y_m,
            self.yaw_rad + other.yaw_rad,
        )

    def inverse(self) -> SE2:
        """`T_b_a` of a `T_a_b`."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return SE2(-c * self.x_m - s * self.y_m, s * self.x_m - c * self.y_m, -self.yaw_rad)

    def apply(self, points_m: FloatArray) -> FloatArray:
        """Points (N, 2) of the source frame, in metres, in the target frame."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        x, y = points_m[..., 0], points_m[..., 1]
        return np.stack([c * x - s * y + self.x_m, s * x + c * y + self.y_m], axis=-1)

    def distance_to(self, other: SE2) -> tuple[float, float]:
        """How far two motions lie apart: translation in metres, rotation in radians, both >= 0."""
        return math.hypot(self.x_m - other.x_m, self.y_m - other.y_m), abs(wrap_angle(self.yaw_rad - other.yaw_rad))
