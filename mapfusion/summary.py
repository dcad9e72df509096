"""What a whole replay came to: every robot, group and pair in figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from mapfusion.result import PairFusion
from mapfusion.steps import FusionStep, PairReport, Placement, natural_key


@dataclass(frozen=True, slots=True)
class RobotSummary:
    """A robot that was in a group at any time, or is now.

    Attributes:
        placement: Where its map lies after the last snapshot, None where it is in no group.
        num_poses: Snapshots in which its pose was known while it was in a group.
        num_missing_poses: Snapshots in which it was in a group and no source told its pose.
    """

    placement: Placement | None = None
    num_poses: int = 0
    num_missing_poses: int = 0


@dataclass(frozen=True, slots=True)
class PairSummary:
    """A pair that was looked at.

    Attributes:
        a: The robot that comes first in natural order.
        b: The other.
        num_looks: Snapshots in which the pair was looked at.
        num_accepted: Looks that accepted the fusion.
        placed: Whether both are in one group after the last snapshot.
        joined_ns: Time of the first look that accepted, None where none did.
        fusion: The latest look that accepted, or where none did the latest one with the highest confidence.
    """

    a: str
    b: str
    num_looks: int
    num_accepted: int
    placed: bool
    joined_ns: int | None
    fusion: PairFusion

    @property
    def verdict(self) -> str:
        """`joined` by a fusion of its own, `placed` over other robots, or `refused`."""
        if not self.placed:
            return "refused"
        return "joined" if self.num_accepted else "placed"


@dataclass(slots=True)
class Summary:
    """Gathers the steps of a replay.

    Attributes:
        num_snapshots: Number of steps.
        first_ns: Time of the first step.
        last_ns: Time of the last one.
        robots: By name.
        pairs: By the names of the two, in natural order once `pairs_in_order` is asked.
        changes: Groups that formed, met or parted, with their times.
    """

    num_snapshots: int = 0
    first_ns: int = 0
    last_ns: int = 0
    robots: dict[str, RobotSummary] = field(default_factory=dict)
    pairs: dict[tuple[str, str], PairSummary] = field(default_factory=dict)
    changes: list[tuple[int, str]] = field(default_factory=list)

    def add(self, step: FusionStep) -> None:
        """Takes note of a step; steps come in the order of time."""
        if self.num_snapshots == 0:
            self.first_ns = step.stamp_ns
        self.num_snapshots += 1
        self.last_ns = step.stamp_ns
        self.changes.extend((step.stamp_ns, change) for change in step.changes)
        for robot in self.robots.keys() | step.placements.keys():
            self.robots[robot] = _robot(self.robots.get(robot, RobotSummary()), robot, step)
        for report in step.pairs:
            self.pairs[report.a, report.b] = _pair(self.pairs.get((report.a, report.b)), report, step.stamp_ns)

    @property
    def groups(self) -> dict[int, tuple[str, ...]]:
        """Members by group number after the last step, in natural order."""
        groups: dict[int, list[str]] = {}
        for robot in sorted(self.robots, key=natural_key):
            placement = self.robots[robot].placement
            if placement is not None:
                groups.setdefault(placement.group, []).append(robot)
        return {number: tuple(groups[number]) for number in sorted(groups)}

    @property
    def pairs_in_order(self) -> list[PairSummary]:
        """The pairs in natural order, as they are after the last step."""
        ordered = sorted(self.pairs, key=lambda pair: (natural_key(pair[0]), natural_key(pair[1])))
        return [_as_placed(self.pairs[pair], self.robots) for pair in ordered]

    @property
    def nearest_miss(self) -> PairSummary | None:
        """The refused pair that came closest, None where every pair is placed or none had a candidate."""
        candidates = [
            pair
            for pair in self.pairs_in_order
            if pair.verdict == "refused" and pair.fusion.T_target_source is not None
        ]
        return max(candidates, key=lambda pair: pair.fusion.confidence, default=None)


def _robot(before: RobotSummary, robot: str, step: FusionStep) -> RobotSummary:
    placement = step.placements.get(robot)
    return RobotSummary(
        placement,
        before.num_poses + (robot in step.poses),
        before.num_missing_poses + (placement is not None and robot not in step.poses),
    )


def _pair(before: PairSummary | None, report: PairReport, stamp_ns: int) -> PairSummary:
    fusion, joined_ns, num_looks, num_accepted = report.fusion, None, 0, 0
    if before is not None:
        joined_ns, num_looks, num_accepted = before.joined_ns, before.num_looks, before.num_accepted
        kept = (before.fusion.accepted, before.fusion.confidence)
        if not report.fusion.accepted and kept > (False, report.fusion.confidence):
            fusion = before.fusion
    if report.fusion.accepted and joined_ns is None:
        joined_ns = stamp_ns
    return PairSummary(
        report.a, report.b, num_looks + 1, num_accepted + report.fusion.accepted, report.placed, joined_ns, fusion
    )


def _as_placed(pair: PairSummary, robots: Mapping[str, RobotSummary]) -> PairSummary:
    a, b = (robots.get(robot, RobotSummary()).placement for robot in (pair.a, pair.b))
    placed = a is not None and b is not None and a.group == b.group
    return PairSummary(pair.a, pair.b, pair.num_looks, pair.num_accepted, placed, pair.joined_ns, pair.fusion)
