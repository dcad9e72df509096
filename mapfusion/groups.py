"""Robots that are tied to each other by joins form a group with one frame that never moves."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass

from mapfusion.posegraph import Edge, Misfit, Pair, components, solve
from mapfusion.steps import Placement, natural_key
from mapfusion.transform import SE2

MAX_STEP_M = 0.25
"""A placed robot moves by at most this much between two snapshots of an unchanged group."""
REPLACED_M = 1.0
"""A robot whose place turns out to be further off than this leaves its group, and comes back at its new place."""


@dataclass(frozen=True, slots=True, eq=False)
class GroupUpdate:
    """The groups at a snapshot.

    Attributes:
        placements: By robot, those in a group, in natural order.
        changes: Groups that formed, met or parted, in words.
        dropped: Joins that contradict the others, with their misfit.
    """

    placements: Mapping[str, Placement]
    changes: tuple[str, ...]
    dropped: Mapping[Pair, Misfit]


class Groups:
    """Numbers groups as they form and places their members.

    A group's number belongs to its reference robot, in whose map frame the group lives, for the group's life. Groups
    that meet take the lowest number; a group that parts leaves its number with the reference.
    """

    def __init__(self) -> None:
        self._reference: dict[int, str] = {}
        self._num_formed = 0
        self._placements: dict[str, Placement] = {}
        self._solved: tuple[object, dict[str, Placement], dict[Pair, Misfit]] | None = None

    def update(self, joins: Mapping[Pair, Edge], reference: str | None = None) -> GroupUpdate:
        """The groups that follow from the joins; the robot `reference` is that of the group it is in."""
        asked = dict(joins), reference
        if self._solved is None or self._solved[0] != asked:
            self._solved = (asked, *self._solve(joins, reference))
        _, goals, dropped = self._solved
        goals = _without_singles({robot: goal for robot, goal in goals.items() if not self._is_elsewhere(robot, goal)})
        changes = self._changes(goals)
        placements = goals if changes else {robot: self._approach(robot, goal) for robot, goal in goals.items()}
        self._placements = {robot: placements[robot] for robot in sorted(placements, key=natural_key)}
        return GroupUpdate(self._placements, changes, dropped)

    def _solve(
        self, joins: Mapping[Pair, Edge], reference: str | None
    ) -> tuple[dict[str, Placement], dict[Pair, Misfit]]:
        """Where the joins place every robot, and the joins that contradict the others."""
        goals: dict[str, Placement] = {}
        dropped: dict[Pair, Misfit] = {}
        for members in components(list(joins)):
            number = self._number(members, reference)
            mine = {pair: edge for pair, edge in joins.items() if pair[0] in members}
            solution = solve(mine, self._reference[number])
            goals |= {robot: Placement(number, T) for robot, T in solution.T_reference_robot.items()}
            dropped |= solution.dropped
        return goals, dropped

    def _number(self, members: tuple[str, ...], preferred: str | None) -> int:
        owned = sorted(number for number, reference in self._reference.items() if reference in members)
        if owned:
            number = owned[0]
        else:
            self._num_formed += 1
            number = self._num_formed
            self._reference[number] = members[0]
        for retired in owned[1:]:
            del self._reference[retired]
        if preferred in members:
            self._reference[number] = preferred
        return number

    def _is_elsewhere(self, robot: str, goal: Placement) -> bool:
        """Whether a robot of this group turns out to have been placed wrongly."""
        now = self._placements.get(robot)
        return (
            now is not None
            and now.group == goal.group
            and self._frame_stayed(goal.group)
            and now.T_group_map.distance_to(goal.T_group_map)[0] > REPLACED_M
        )

    def _frame_stayed(self, number: int) -> bool:
        """Whether a group's frame is the one it had at the last snapshot."""
        return self._placements.get(self._reference[number]) == Placement(number, SE2.identity())

    def _changes(self, goals: Mapping[str, Placement]) -> tuple[str, ...]:
        before, after = _by_group(self._placements), _by_group(goals)
        changes = []
        for number in sorted(before.keys() | after.keys()):
            old, new = before.get(number, frozenset()), after.get(number, frozenset())
            joined, left = sorted(new - old, key=natural_key), sorted(old - new, key=natural_key)
            if not old:
                changes.append(f"group {number} formed: {', '.join(joined)}")
            elif joined:
                changes.append(f"joined group {number}: {', '.join(joined)}")
            if left and not new:
                changes.append(f"group {number} ended: {', '.join(left)}")
            elif left:
                changes.append(f"left group {number}: {', '.join(left)}")
            if old and new and not self._frame_stayed(number):
                changes.append(f"group {number} lives in the map frame of {self._reference[number]} from now on")
        return tuple(changes)

    def _approach(self, robot: str, goal: Placement) -> Placement:
        """A step of at most `MAX_STEP_M` from where the robot was placed towards the goal."""
        now, end = self._placements[robot].T_group_map, goal.T_group_map
        distance_m, _ = now.distance_to(end)
        if distance_m <= MAX_STEP_M:
            return goal
        ratio = MAX_STEP_M / distance_m
        turn = SE2(0.0, 0.0, end.yaw_rad - now.yaw_rad).yaw_rad
        return Placement(
            goal.group,
            SE2(
                now.x_m + ratio * (end.x_m - now.x_m),
                now.y_m + ratio * (end.y_m - now.y_m),
                now.yaw_rad + ratio * turn,
            ),
        )


def _without_singles(goals: Mapping[str, Placement]) -> dict[str, Placement]:
    groups = _by_group(goals)
    return {robot: goal for robot, goal in goals.items() if len(groups[goal.group]) > 1}


def _by_group(placements: Mapping[str, Placement]) -> dict[int, frozenset[str]]:
    groups: dict[int, set[str]] = defaultdict(set)
    for robot, placement in placements.items():
        groups[placement.group].add(robot)
    return {number: frozenset(members) for number, members in groups.items()}
