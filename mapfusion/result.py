"""What comes out of looking at two maps: a verdict with its evidence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from mapfusion.transform import SE2, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PairFusion:
    """The outcome of one attempt to fuse two maps. A refusal is an ordinary outcome.

    Attributes:
        accepted: Whether the fusion is held to be real.
        reason: Why not, in words for the user; empty when accepted.
        gate: Short stable name of the gate that refused (`few keypoints`, `few matches`, `no transform`,
            `no overlap`, `mae`, ...); empty when accepted.
        T_target_source: Takes points of the source's frame to the target's; the best candidate even when refused,
            None where there was none.
        confidence: How far the fusion is to be trusted, [0, 1].
        mae: Mean absolute error over the cells known in both, grey levels 0..255; None without a common cell.
        overlap_ratio: Cells known in both / known cells of the smaller map, [0, 1].
        overlap_cells: Number of cells known in both, at `resolution_m`.
        num_keypoints_target: Keypoints found in the target map.
        num_keypoints_source: Keypoints found in the source map.
        num_matches: Descriptor matches that were used.
        num_inliers: Matches that agree with `T_target_source`.
        scale: Scale that the matches would like, 1 where the resolutions are right; None where it was not fitted.
        covariance: (3, 3) of (x_m, y_m, yaw_rad) of `T_target_source`, in the target's frame; None without a candidate.
        resolution_m: Cell size at which the two maps were compared.
        rival: The distinctly different transform that comes nearest, where it came close enough to matter.
        evidence: Further figures by name, with the unit in the name where there is one.
    """

    accepted: bool
    reason: str = ""
    gate: str = ""
    T_target_source: SE2 | None = None
    confidence: float = 0.0
    mae: float | None = None
    overlap_ratio: float = 0.0
    overlap_cells: int = 0
    num_keypoints_target: int = 0
    num_keypoints_source: int = 0
    num_matches: int = 0
    num_inliers: int = 0
    scale: float | None = None
    covariance: FloatArray | None = None
    resolution_m: float = 0.0
    rival: SE2 | None = None
    evidence: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.accepted and self.T_target_source is None:
            raise ValueError("an accepted fusion needs a transform")
        if self.accepted == bool(self.reason):
            raise ValueError("a refusal needs a reason, and an acceptance has none")

    def swapped(self) -> PairFusion:
        """The same finding with target and source exchanged."""
        T = self.T_target_source
        return replace(
            self,
            T_target_source=None if T is None else T.inverse(),
            rival=None if self.rival is None else self.rival.inverse(),
            covariance=None if T is None or self.covariance is None else _inverse_covariance(T, self.covariance),
            num_keypoints_target=self.num_keypoints_source,
            num_keypoints_source=self.num_keypoints_target,
        )


def _inverse_covariance(T: SE2, covariance: FloatArray) -> FloatArray:
    """Covariance of T^-1 by first order propagation through (x, y, yaw) -> (-R^T t, -yaw)."""
    inverse, (c, s) = T.inverse(), (np.cos(T.yaw_rad), np.sin(T.yaw_rad))
    jacobian = np.array([[-c, -s, inverse.y_m], [s, -c, -inverse.x_m], [0.0, 0.0, -1.0]])
    result: FloatArray = jacobian @ covariance @ jacobian.T
    return result
