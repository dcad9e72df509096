"""A join ties whole groups: the other robots of both groups are asked whether their maps agree where it puts them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from mapfusion.joins import Look
from mapfusion.posegraph import Pair, pair_key
from mapfusion.result import PairFusion
from mapfusion.steps import Placement, natural_key
from mapfusion.timeline import Snapshot
from mapfusion.transform import SE2

MAX_WITNESSES = 6
"""So many pairs are asked about a join, those that it places nearest to each other."""
DISPUTED_OVERLAP = 0.3
DISPUTING_GATES = ("chance", "contradiction", "mae")
"""Maps that overlap this far and that one of these gates refuses dispute the place that they are given: maps that are
placed rightly may be refused for want of confidence, or where they have little in common."""


def witnesses(pair: Pair, fusion: PairFusion, snapshot: Snapshot, placements: Mapping[str, Placement]) -> list[Look]:
    """The pairs across the groups of two robots, with the transforms that follow from joining them by the fusion."""
    a, b = pair
    of_a, of_b = _relative_to(a, placements), _relative_to(b, placements)
    if b in of_a or fusion.T_target_source is None:
        return []
    looks: list[tuple[float, Look]] = []
    for one, T_a_one in of_a.items():
        for other, T_b_other in of_b.items():
            if (one, other) != pair:
                T = T_a_one.inverse() @ fusion.T_target_source @ T_b_other
                look = (
                    Look((one, other), T) if natural_key(one) < natural_key(other) else Look((other, one), T.inverse())
                )
                looks.append((_apart_m(look, snapshot), look))
    nearest = sorted(looks, key=lambda item: (item[0], pair_key(item[1].pair)))[:MAX_WITNESSES]
    return [look for _, look in nearest]


def checked_by(fusion: PairFusion, looks: Sequence[Look], verdicts: Sequence[PairFusion]) -> PairFusion:
    """The fusion, refused where more of its witnesses dispute it than agree."""
    disputing = [look.pair for look, verdict in zip(looks, verdicts, strict=True) if _disputes(verdict)]
    if len(disputing) <= sum(verdict.accepted for verdict in verdicts):
        return fusion
    named = ", ".join(f"{one} and {other}" for one, other in sorted(disputing, key=pair_key))
    reason = f"it would put maps onto each other that do not fit there: those of {named}"
    return replace(fusion, accepted=False, gate="witnesses", reason=reason)


def _disputes(verdict: PairFusion) -> bool:
    return verdict.gate in DISPUTING_GATES and verdict.overlap_ratio >= DISPUTED_OVERLAP


def _relative_to(robot: str, placements: Mapping[str, Placement]) -> dict[str, SE2]:
    """T_robot_member of every member of the robot's group, itself included."""
    if robot not in placements:
        return {robot: SE2.identity()}
    T_group_robot, group = placements[robot].T_group_map, placements[robot].group
    return {
        member: T_group_robot.inverse() @ placement.T_group_map
        for member, placement in placements.items()
        if placement.group == group
    }


def _apart_m(look: Look, snapshot: Snapshot) -> float:
    """Distance between the middles of two maps under the look's transform."""
    assert look.T_a_b is not None
    middle_a, middle_b = (snapshot.grids[robot].middle_m for robot in look.pair)
    return float(np.hypot(*(look.T_a_b.apply(middle_b) - middle_a)))
