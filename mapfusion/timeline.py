"""From events in the order of their stamps to the state of every robot at regular times."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from mapfusion.config import ReplayConfig
from mapfusion.newest import NewestGrid
from mapfusion.steps import Event, GridEvent, RobotEvent

SILENCE_NS = 60_000_000_000
"""Snapshots further than this from anything that any robot reported are passed over: recordings made hours apart."""


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The mission at a time: each robot's newest grid.

    Attributes:
        stamp_ns: The time.
        is_last: Whether nothing comes after it.
        robots: The robots announced so far, by name.
        grids: By robot, those that have one.
    """

    stamp_ns: int
    is_last: bool
    robots: Mapping[str, RobotEvent]
    grids: Mapping[str, NewestGrid]


def snapshots(events: Iterable[Event], config: ReplayConfig) -> Iterator[Snapshot]:
    """Snapshots at t0 + k x interval, t0 the first stamp used, and one at the last stamp.

    Args:
        events: Robots before their grids, grids in the order of their stamps.
        config: The interval, and the time of the first snapshot where it is given.

    Raises:
        ValueError: A grid of a robot that was not announced, or out of order.
    """
    robots: dict[str, RobotEvent] = {}
    grids: dict[str, NewestGrid] = {}
    reports = _Reports()
    clock: _SnapshotClock | None = None
    for event in events:
        if isinstance(event, RobotEvent):
            robots[event.robot] = event
            reports.add_robot(event)
            continue
        if event.robot not in robots:
            raise ValueError(f"a grid of robot {event.robot!r}, which was not announced")
        if clock is None:
            clock = _SnapshotClock(_start_ns(reports, event, config), round(config.interval_s * 1e9), reports)
        elif event.stamp_ns < reports.last_grid_ns:
            raise ValueError(
                f"a grid of robot {event.robot!r} is {reports.last_grid_ns - event.stamp_ns} ns out of order"
            )
        for due_ns in clock.due_before(event.stamp_ns):
            yield Snapshot(due_ns, False, dict(robots), dict(grids))
        before = grids.get(event.robot)
        grids[event.robot] = NewestGrid.of(event.stamp_ns, event.grid, before)
        reports.last_grid_ns = event.stamp_ns
    if clock is None:
        return
    last_ns = max(reports.last_pose_ns, reports.last_grid_ns, clock.start_ns)
    for due_ns in clock.due_before(last_ns):
        yield Snapshot(due_ns, False, dict(robots), dict(grids))
    yield Snapshot(last_ns, True, dict(robots), dict(grids))


def _start_ns(reports: _Reports, first_grid: GridEvent, config: ReplayConfig) -> int:
    first_ns = min(reports.first_pose_ns, first_grid.stamp_ns)
    return first_ns if config.start_ns is None else max(first_ns, config.start_ns)


class _Reports:
    """When anything was reported: poses of all robots, known ahead, and the newest grid."""

    def __init__(self) -> None:
        self._pose_stamps = np.empty(0, np.int64)
        self.last_grid_ns = np.iinfo(np.int64).min

    def add_robot(self, robot: RobotEvent) -> None:
        if robot.poses is not None:
            self._pose_stamps = np.union1d(self._pose_stamps, robot.poses.stamps_ns)

    @property
    def first_pose_ns(self) -> int:
        return int(self._pose_stamps[0]) if self._pose_stamps.size else np.iinfo(np.int64).max

    @property
    def last_pose_ns(self) -> int:
        return int(self._pose_stamps[-1]) if self._pose_stamps.size else np.iinfo(np.int64).min

    def silent_until(self, stamp_ns: int, next_grid_ns: int) -> int:
        """Until when nothing was reported within `SILENCE_NS` around; `stamp_ns` itself where something was."""
        after = int(np.searchsorted(self._pose_stamps, stamp_ns - SILENCE_NS))
        next_pose_ns = int(self._pose_stamps[after]) if after < self._pose_stamps.size else next_grid_ns
        if stamp_ns - self.last_grid_ns <= SILENCE_NS:
            return stamp_ns
        return max(stamp_ns, min(next_grid_ns, next_pose_ns) - SILENCE_NS)


class _SnapshotClock:
    """When the next snapshot is due."""

    def __init__(self, start_ns: int, interval_ns: int, reports: _Reports) -> None:
        self.start_ns = self.due_ns = start_ns
        self._interval_ns = interval_ns
        self._reports = reports

    def due_before(self, until_ns: int) -> Iterator[int]:
        """Times of the snapshots due before the next grid at `until_ns`, silent ones left out."""
        while self.due_ns < until_ns:
            resume_ns = self._reports.silent_until(self.due_ns, until_ns)
            if resume_ns <= self.due_ns:
                yield self.due_ns
                self.due_ns += self._interval_ns
            else:
                self.due_ns += -(-(resume_ns - self.due_ns) // self._interval_ns) * self._interval_ns
