"""Robots that are tied to each other by joins form a group with one frame that never moves."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping

from mapfusion.joins import Join, Pair
from mapfusion.steps import Placement, natural_key
from mapfusion.transform import SE2

MAX_STEP_M = 0.25
"""A placed robot moves by at most this much between two snapshots of an unchanged group."""


class Groups:
    """Numbers groups as they form and places their members.

    A group's number belongs to its reference robot, in whose map frame the group lives, for the group's life. Groups
    that meet take the lowest number; a group that parts leaves its number with the reference.
    """

    def __init__(self, reference: str | None = None) -> None:
        self._preferred = reference
        self._reference: dict[int, str] = {}
        self._num_formed = 0
        self._placements: dict[str, Placement] = {}

    def update(self, joins: Mapping[Pair, Join]) -> tuple[Mapping[str, Placement], tuple[str, ...]]:
        """The placements that follow from the joins, in natural order, and what changed, in words."""
        placements: dict[str, Placement] = {}
        for members in _components(joins):
            number = self._number(members)
            reference = self._reference[number]
            for robot, T_reference_robot in _spanning_tree(joins, members, reference).items():
                placements[robot] = Placement(number, T_reference_robot)
        changes = self._changes(placements)
        if not changes:
            placements = {robot: self._approach(robot, placement) for robot, placement in placements.items()}
        self._placements = {robot: placements[robot] for robot in sorted(placements, key=natural_key)}
        return self._placements, changes

    def _number(self, members: tuple[str, ...]) -> int:
        owned = sorted(number for number, reference in self._reference.items() if reference in members)
        if owned:
            number = owned[0]
        else:
            self._num_formed += 1
            number = self._num_formed
            self._reference[number] = members[0]
        for retired in owned[1:]:
            del self._reference[retired]
        if self._preferred in members:
            self._reference[number] = self._preferred
        return number

    def _changes(self, placements: Mapping[str, Placement]) -> tuple[str, ...]:
        before, after = _by_group(self._placements), _by_group(placements)
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


def _by_group(placements: Mapping[str, Placement]) -> dict[int, frozenset[str]]:
    groups: dict[int, set[str]] = defaultdict(set)
    for robot, placement in placements.items():
        groups[placement.group].add(robot)
    return {number: frozenset(members) for number, members in groups.items()}


def _components(pairs: Iterable[Pair]) -> list[tuple[str, ...]]:
    """Connected components of the joined robots, members and components in natural order."""
    component: dict[str, set[str]] = {}
    for a, b in pairs:
        merged = component.get(a, {a}) | component.get(b, {b})
        for robot in merged:
            component[robot] = merged
    members = {tuple(sorted(robots, key=natural_key)) for robots in component.values()}
    return sorted(members, key=lambda robots: [natural_key(robot) for robot in robots])


def _spanning_tree(joins: Mapping[Pair, Join], members: tuple[str, ...], reference: str) -> dict[str, SE2]:
    """T_reference_robot of every member along the most confident joins (Prim's maximum spanning tree)."""
    placed = {reference: SE2.identity()}
    while len(placed) < len(members):
        inside, outside, join = max(
            (
                (a, b, join) if a in placed else (b, a, Join(join.T_a_b.inverse(), join.confidence))
                for (a, b), join in joins.items()
                if (a in placed) != (b in placed) and a in members
            ),
            key=lambda edge: edge[2].confidence,
        )
        placed[outside] = placed[inside] @ join.T_a_b
    return placed
