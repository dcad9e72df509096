"""What a whole replay came to: every robot, group and pair in figures."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace

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
        latest: The latest look.
        num_looks: Snapshots in which the pair was looked at.
        num_accepted: Looks that accepted the fusion.
        joined_ns: Since when both are in one group, None where they are not.
        fitting: The latest look that accepted, None where none did.
        closest: Of the looks that refused, the latest one with the highest confidence; None where none did.
    """

    latest: PairReport
    num_looks: int = 0
    num_accepted: int = 0
    joined_ns: int | None = None
    fitting: PairFusion | None = None
    closest: PairFusion | None = None

    @property
    def a(self) -> str:
        """The robot that comes first in natural order."""
        return self.latest.a

    @property
    def b(self) -> str:
        """The other."""
        return self.latest.b

    @property
    def placed(self) -> bool:
        """Whether both are in one group after the last snapshot."""
        return self.joined_ns is not None

    @property
    def verdict(self) -> str:
        """`joined` by a fusion of its own, `placed` over other robots, or `refused`."""
        if not self.placed:
            return "refused"
        return "joined" if self.num_accepted else "placed"

    @property
    def fusion(self) -> PairFusion:
        """The look that speaks for the verdict.

        The latest one that accepted where the pair is joined; the latest one where it is placed over others, which is
        one at where they are placed as soon as a map has changed since, or where it fits and waits to be confirmed;
        else the one that came closest.
        """
        if self.verdict == "joined":
            return self.fitting or self.latest.fusion
        if self.placed or self.latest.fusion.accepted:
            return self.latest.fusion
        return self.closest or self.latest.fusion

    @property
    def reason(self) -> str:
        """Why the pair is not joined, in words; empty where it is."""
        if self.verdict == "joined":
            return ""
        return self.fusion.reason or "found once, and nothing confirmed it"


@dataclass(slots=True)
class Summary:
    """Gathers the steps of a replay.

    Attributes:
        num_snapshots: Number of steps.
        first_ns: Time of the first step.
        last_ns: Time of the last one.
        robots: By name.
        pairs: By the names of the two.
        changes: Joins that began or ended and groups that formed, met or parted, with their times.
        left_out: By group and robot, how many merged maps are without the robot, since they were too large with it.
    """

    num_snapshots: int = 0
    first_ns: int = 0
    last_ns: int = 0
    robots: dict[str, RobotSummary] = field(default_factory=dict)
    pairs: dict[tuple[str, str], PairSummary] = field(default_factory=dict)
    changes: list[tuple[int, str]] = field(default_factory=list)
    left_out: Counter[tuple[int, str]] = field(default_factory=Counter)

    def add(self, step: FusionStep) -> None:
        """Takes note of a step; steps come in the order of time."""
        if self.num_snapshots == 0:
            self.first_ns = step.stamp_ns
        self.num_snapshots += 1
        self.last_ns = step.stamp_ns
        self.changes.extend((step.stamp_ns, change) for change in step.changes)
        self.left_out.update((group, robot) for group, robots in step.left_out.items() for robot in robots)
        for robot in self.robots.keys() | step.placements.keys():
            self.robots[robot] = _robot(self.robots.get(robot, RobotSummary()), robot, step)
        for report in step.pairs:
            self.pairs[report.a, report.b] = _looked(self.pairs.get((report.a, report.b)), report)
        for pair, known in self.pairs.items():
            self.pairs[pair] = _since(known, step)

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
        return [self.pairs[pair] for pair in ordered]

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


def _looked(before: PairSummary | None, report: PairReport) -> PairSummary:
    """The pair after one more look."""
    known, fusion = before or PairSummary(report), report.fusion
    is_closer = known.closest is None or fusion.confidence >= known.closest.confidence
    return replace(
        known,
        latest=report,
        num_looks=known.num_looks + 1,
        num_accepted=known.num_accepted + fusion.accepted,
        fitting=fusion if fusion.accepted else known.fitting,
        closest=fusion if not fusion.accepted and is_closer else known.closest,
    )


def _since(pair: PairSummary, step: FusionStep) -> PairSummary:
    """The pair with the time since when it is in one group."""
    a, b = step.placements.get(pair.a), step.placements.get(pair.b)
    together = a is not None and b is not None and a.group == b.group
    if together == pair.placed:
        return pair
    return replace(pair, joined_ns=step.stamp_ns if together else None)
