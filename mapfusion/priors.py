"""What the user knows of where robots started."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from mapfusion.config import Prior
from mapfusion.posegraph import Edge, Pair
from mapfusion.result import PairFusion
from mapfusion.steps import natural_key
from mapfusion.transform import SE2

NUM_SIGMAS = 4.0
"""A fusion further than this from a soft prior is refused."""
FIXED_SIGMA_M, FIXED_SIGMA_RAD = 0.001, math.radians(0.01)


@dataclass(frozen=True, slots=True)
class RelativePrior:
    """Where b's map frame is held to be in a's.

    Attributes:
        T_a_b: The transform.
        sigma_m: Standard deviation of b's position in a, 0 where both are fixed.
        sigma_rad: Standard deviation of the angle, 0 where both are fixed.
    """

    T_a_b: SE2
    sigma_m: float
    sigma_rad: float

    @property
    def is_fixed(self) -> bool:
        """Whether it holds whatever the maps say."""
        return self.sigma_m == 0.0 and self.sigma_rad == 0.0


class Priors:
    """Known starts of robots in the world, which is the reference's map frame.

    Args:
        priors: By robot.
        reference: The reference; where it has no prior of its own, it stands at the world's origin.
    """

    def __init__(self, priors: Mapping[str, Prior], reference: str | None) -> None:
        self._priors = dict(priors)
        self._reference = reference

    def reference(self, robots: Collection[str]) -> str | None:
        """The robot whose map frame is the world, the first of all that take part unless it was named; None where
        neither a name nor a prior says that there is one."""
        if self._reference is None and self._priors:
            return min(robots, key=natural_key)
        return self._reference

    def world(self, ties: Collection[Pair], robots: Collection[str]) -> str | None:
        """The reference, where it is tied to another robot by fixed priors: these place both in its map frame."""
        reference = self.reference(robots)
        return reference if any(reference in pair for pair in ties) else None

    def of_pair(self, pair: Pair, robots: Collection[str]) -> RelativePrior | None:
        """What the priors of two of all robots say of each other, None where one of them has none."""
        reference = self.reference(robots)
        if reference is None or not self._priors:
            return None
        known = {reference: Prior(SE2.identity()), **self._priors}
        if pair[0] not in known or pair[1] not in known:
            return None
        a, b = known[pair[0]], known[pair[1]]
        return RelativePrior(
            a.T_world_map.inverse() @ b.T_world_map,
            math.hypot(a.sigma_m, b.sigma_m),
            math.hypot(a.sigma_rad, b.sigma_rad),
        )

    def fixed_edges(self, mapped: Collection[str], robots: Collection[str]) -> dict[Pair, Edge]:
        """The ties that hold whatever the maps say, between those of all robots that have maps."""
        if not self._priors:
            return {}
        covariance = np.diag([FIXED_SIGMA_M**2, FIXED_SIGMA_M**2, FIXED_SIGMA_RAD**2])
        edges = {}
        for pair in combinations(sorted(mapped, key=natural_key), 2):
            prior = self.of_pair(pair, robots)
            if prior is not None and prior.is_fixed:
                edges[pair] = Edge(prior.T_a_b, 1.0, covariance, is_fixed=True)
        return edges


def checked(fusion: PairFusion, prior: RelativePrior) -> PairFusion:
    """The fusion, refused where it contradicts what is known of the start."""
    if not fusion.accepted or fusion.T_target_source is None or prior.is_fixed:
        return fusion
    distance_m, angle_rad = fusion.T_target_source.distance_to(prior.T_a_b)
    if distance_m <= NUM_SIGMAS * prior.sigma_m and angle_rad <= NUM_SIGMAS * prior.sigma_rad:
        return fusion
    reason = (
        f"{distance_m:.2f} m and {math.degrees(angle_rad):.1f} degrees from the known start, more than "
        f"{NUM_SIGMAS:g} sigmas of {prior.sigma_m:g} m and {math.degrees(prior.sigma_rad):g} degrees"
    )
    return replace(fusion, accepted=False, gate="prior", reason=reason)
