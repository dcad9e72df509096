"""The whole method, from events to fused maps."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace

import numpy as np

from mapfusion.ahead import ahead
from mapfusion.canvas import fitting
from mapfusion.config import ReplayConfig
from mapfusion.fusion import PairFuser
from mapfusion.grid import OccupancyGrid
from mapfusion.groups import Groups
from mapfusion.joins import Joins, Look, held_back
from mapfusion.merge import MergedMapTooLargeError, merge_grids
from mapfusion.posegraph import Edge, Misfit, Pair, brought_together, pair_key, separated
from mapfusion.priors import Priors, checked
from mapfusion.result import PairFusion
from mapfusion.steps import Event, FusionStep, PairReport, Path, Placement, PoseSource, StampArray
from mapfusion.timeline import Snapshot, snapshots
from mapfusion.transform import SE2, FloatArray
from mapfusion.witnesses import checked_by, witnesses
from mapfusion.workers import Fuser, Map, Workers

NUM_AHEAD = 3
"""So many snapshots are read, and looked at, before they are asked for: each holds its maps in memory."""


def replay(events: Iterable[Event], config: ReplayConfig | None = None) -> Iterator[FusionStep]:
    """Fuses a mission over time.

    Args:
        events: Robots before their grids, grids in the order of their stamps; taken one by one, never held. With
            several jobs they are taken in a thread of its own, a little ahead.
        config: Settings; the defaults where None.

    Returns:
        The state at every snapshot; nothing without a grid.
        The same events and settings give the same steps, whatever `config.jobs`.

    Raises:
        ValueError: Events out of order.
    """
    config = config or ReplayConfig()
    maps, poses = _MergedMaps(config), _Poses(config.interval_s)
    with ExitStack() as stack:
        for state in _states(events, config, stack):
            snapshot, placements = state.snapshot, state.placements
            merged, left_out = maps.due(snapshot, placements)
            yield FusionStep(
                stamp_ns=snapshot.stamp_ns,
                is_last=snapshot.is_last,
                placements=placements,
                poses=poses.at(snapshot, placements),
                pairs=tuple(_report(pair, fusion, snapshot, placements) for pair, fusion in state.fusions.items()),
                maps=merged,
                changes=state.changes,
                paths=_paths(snapshot, placements) if snapshot.is_last else {},
                map_frames={robot: event.map_frame for robot, event in snapshot.robots.items()},
                left_out=left_out,
            )


@dataclass(frozen=True, slots=True)
class _State:
    """What is known at a snapshot: who lies where, and the looks that were taken at pairs."""

    snapshot: Snapshot
    placements: Mapping[str, Placement]
    fusions: Mapping[Pair, PairFusion]
    changes: tuple[str, ...]


def _states(events: Iterable[Event], config: ReplayConfig, stack: ExitStack) -> Iterator[_State]:
    """The state at every snapshot; with several jobs reading, looking at pairs and the rest go on side by side."""
    read = snapshots(events, config)
    if config.jobs == 1:
        return _looked_at(read, config, PairFuser(config.fusion), map)
    workers = Workers(config.fusion, config.jobs)
    try:
        states = _looked_at(stack.enter_context(ahead(read, NUM_AHEAD)), config, workers, workers.each)
        return stack.enter_context(ahead(states, NUM_AHEAD))
    finally:
        stack.callback(workers.close)  # closed first of all: whoever waits for an answer must not wait any longer


def _looked_at(read: Iterator[Snapshot], config: ReplayConfig, fuser: Fuser, each: Map) -> Iterator[_State]:
    """Looks at the pairs of every snapshot and places the robots."""
    groups, priors = Groups(), Priors(config.priors, config.reference)
    joins = Joins(config.never, has_thorough=config.fusion.profile == "default")
    placements: Mapping[str, Placement] = {}
    barred: Mapping[Pair, str] = {}
    for snapshot in read:
        fusions, pair_changes = _look_at_pairs(snapshot, placements, joins, fuser, priors, config, each)
        ties = priors.fixed_edges(snapshot.grids, snapshot.robots)
        tied = joins.held | ties
        kept = separated(tied, config.never, {pair for pair in tied if _are_together(pair, placements)})
        update = groups.update(kept, config.reference or priors.world(ties, snapshot.robots))
        placements = update.placements
        contradicted = [_contradicted(pair, misfit) for pair, misfit in update.dropped.items()]
        for pair in update.dropped:
            joins.drop(pair)
        before, barred = barred, {pair: _why_barred(pair, kept, config.never) for pair in tied if pair not in kept}
        newly = {pair: why for pair, why in barred.items() if pair not in before}
        fusions = _with_barred(fusions, barred, {pair: joins.found(pair) for pair in newly})
        held_apart = [f"{pair[0]} and {pair[1]} are held apart: {why}" for pair, why in newly.items()]
        yield _State(snapshot, placements, fusions, (*pair_changes, *contradicted, *held_apart, *update.changes))


def _look_at_pairs(
    snapshot: Snapshot,
    placements: Mapping[str, Placement],
    joins: Joins,
    fuser: Fuser,
    priors: Priors,
    config: ReplayConfig,
    each: Map,
) -> tuple[dict[Pair, PairFusion], list[str]]:
    """Verifies or searches every pair that is due, and takes note in `joins`; says which joins began or ended."""
    looks = joins.due(snapshot, placements)
    fuser.forget_all_but(newest.grid for newest in snapshot.grids.values())

    def take(look: Look) -> PairFusion:
        a, b = (snapshot.grids[robot].grid for robot in look.pair)
        if look.T_a_b is not None:
            return _with_matches(fuser.verify(a, b, look.T_a_b), look.found)
        too_old = _too_old(look.pair, snapshot, config)
        if too_old is not None:
            return too_old
        prior = priors.of_pair(look.pair, snapshot.robots)
        if prior is None:
            return held_back(fuser.fuse(a, b, look.is_thorough))
        near = checked(fuser.verify(a, b, prior.T_a_b), prior)
        return near if near.accepted else checked(held_back(fuser.fuse(a, b, look.is_thorough)), prior)

    fusions = {look.pair: fusion for look, fusion in zip(looks, each(take, looks), strict=True)}
    changes = [joins.record(look, fusions[look.pair], snapshot) for look in looks]
    for pair, fusion in joins.ripe(snapshot).items():
        asked = witnesses(pair, fusion, snapshot, placements)
        verdict = checked_by(fusion, asked, list(each(take, asked)))
        if verdict.accepted:
            changes.append(joins.join(pair, verdict, snapshot))
        else:
            joins.refuse(pair, verdict)
            fusions[pair] = verdict
    fusions = {pair: fusions[pair] for pair in sorted(fusions, key=pair_key)}
    return fusions, [change for change in changes if change]


def _with_matches(verified: PairFusion, found: PairFusion | None) -> PairFusion:
    """A verified transform with the matches that it was found by: verifying looks at walls and not at features."""
    if found is None:
        return verified
    return replace(
        verified,
        num_keypoints_target=found.num_keypoints_target,
        num_keypoints_source=found.num_keypoints_source,
        num_matches=found.num_matches,
        num_inliers=found.num_inliers,
        scale=found.scale,
    )


def _why_barred(pair: Pair, kept: Mapping[Pair, Edge], never: Collection[frozenset[str]]) -> str:
    """Why a join ties nobody: beside the joins that are kept it would tie two robots that must stay apart."""
    one, other = brought_together(pair, list(kept), never)
    return f"it would bring {one} and {other} into one group, which must not be (--never)"


def _with_barred(
    fusions: Mapping[Pair, PairFusion], barred: Mapping[Pair, str], found: Mapping[Pair, PairFusion | None]
) -> dict[Pair, PairFusion]:
    """The looks of a snapshot, refused where their joins tie nobody, and those of other pairs that are to be told."""
    told = {pair: fusion for pair, fusion in found.items() if fusion is not None} | dict(fusions)
    for pair, why in barred.items():
        if pair in told and told[pair].accepted:
            told[pair] = replace(told[pair], accepted=False, gate="never", reason=why)
    return {pair: told[pair] for pair in sorted(told, key=pair_key)}


def _contradicted(pair: Pair, misfit: Misfit) -> str:
    return (
        f"the join of {pair[0]} and {pair[1]} ends: the other joins place them {misfit.distance_m:.2f} m and "
        f"{np.degrees(misfit.angle_rad):.1f} degrees differently"
    )


def _too_old(pair: Pair, snapshot: Snapshot, config: ReplayConfig) -> PairFusion | None:
    """A refusal where a grid is too old to start a join."""
    for robot in pair:
        age_s = _age_s(robot, snapshot)
        if config.max_age_s is not None and age_s > config.max_age_s:
            reason = f"the newest map of {robot} is {age_s:.1f} s old, more than the {config.max_age_s:g} s allowed"
            return PairFusion(accepted=False, reason=reason, gate="old map")
    return None


def _age_s(robot: str, snapshot: Snapshot) -> float:
    return (snapshot.stamp_ns - snapshot.grids[robot].stamp_ns) * 1e-9


def _report(pair: Pair, fusion: PairFusion, snapshot: Snapshot, placements: Mapping[str, Placement]) -> PairReport:
    a, b = pair
    return PairReport(a, b, fusion, _are_together(pair, placements), _age_s(a, snapshot), _age_s(b, snapshot))


def _are_together(pair: Pair, placements: Mapping[str, Placement]) -> bool:
    a, b = (placements.get(robot) for robot in pair)
    return a is not None and b is not None and a.group == b.group


class _Poses:
    """Poses at snapshots, looked up ahead for many of them: a look-up costs as much for one time as for many."""

    NUM_AHEAD = 256

    def __init__(self, interval_s: float) -> None:
        self._interval_ns = round(interval_s * 1e9)
        self._known: dict[str, tuple[StampArray, FloatArray]] = {}

    def at(self, snapshot: Snapshot, placements: Mapping[str, Placement]) -> dict[str, SE2]:
        """Poses with heading in the group's frame (Zick et al. 2025, 3.5), of the robots whose pose is known."""
        poses = {}
        for robot, placement in placements.items():
            source = snapshot.robots[robot].poses
            if source is not None:
                x_m, y_m, yaw_rad = self._pose(robot, source, snapshot.stamp_ns)
                if np.isfinite(x_m + y_m + yaw_rad):
                    poses[robot] = placement.T_group_map @ SE2(x_m, y_m, yaw_rad)
        return poses

    def _pose(self, robot: str, source: PoseSource, stamp_ns: int) -> FloatArray:
        if robot not in self._known or stamp_ns not in self._known[robot][0]:
            stamps_ns = stamp_ns + self._interval_ns * np.arange(self.NUM_AHEAD, dtype=np.int64)
            self._known[robot] = (stamps_ns, source.poses_at(stamps_ns))
        stamps_ns, poses = self._known[robot]
        pose: FloatArray = poses[np.searchsorted(stamps_ns, stamp_ns)]
        return pose


def _paths(snapshot: Snapshot, placements: Mapping[str, Placement]) -> dict[str, Path]:
    """Whole trajectories under the last placements."""
    paths = {}
    for robot, placement in placements.items():
        source = snapshot.robots[robot].poses
        if source is not None and source.stamps_ns.size:
            paths[robot] = _path(source, placement.T_group_map)
    return paths


def _path(source: PoseSource, T_group_map: SE2) -> Path:
    stamps_ns = source.stamps_ns
    poses = source.poses_at(stamps_ns)
    yaw_rad = (poses[:, 2] + T_group_map.yaw_rad + np.pi) % (2.0 * np.pi) - np.pi
    return Path(stamps_ns, np.column_stack([T_group_map.apply(poses[:, :2]), yaw_rad]))


class _MergedMaps:
    """Merges a group's maps when something changed, at most every `map_interval_s`, and at the last snapshot."""

    def __init__(self, config: ReplayConfig) -> None:
        self._config = config
        self._merged: dict[int, tuple[int, object]] = {}

    def due(
        self, snapshot: Snapshot, placements: Mapping[str, Placement]
    ) -> tuple[dict[int, OccupancyGrid], dict[int, tuple[str, ...]]]:
        """The merged maps that are due by group number, and the robots that they would be too large with."""
        members: dict[int, list[str]] = {}
        for robot, placement in placements.items():
            members.setdefault(placement.group, []).append(robot)
        merged, left_out = {}, {}
        for group, robots in sorted(members.items()):
            if self._is_due(group, robots, snapshot, placements):
                self._merged[group] = (snapshot.stamp_ns, self._state(robots, snapshot, placements))
                try:
                    merged[group] = self._merge(robots, snapshot, placements)
                except MergedMapTooLargeError:
                    near = self._near(robots, snapshot, placements)
                    left_out[group] = tuple(robot for robot in robots if robot not in near)
                    if near:
                        merged[group] = self._merge(near, snapshot, placements)
        return merged, left_out

    def _is_due(self, group: int, robots: list[str], snapshot: Snapshot, placements: Mapping[str, Placement]) -> bool:
        if group not in self._merged:
            return True
        stamp_ns, state = self._merged[group]
        changed = state != self._state(robots, snapshot, placements)
        waited = (snapshot.stamp_ns - stamp_ns) * 1e-9 >= self._config.map_interval_s
        return snapshot.is_last or (changed and waited)

    def _near(self, robots: list[str], snapshot: Snapshot, placements: Mapping[str, Placement]) -> list[str]:
        """The robots whose maps fit into one merged map."""
        grids = [snapshot.grids[robot].grid for robot in robots]
        T_group_maps = [placements[robot].T_group_map for robot in robots]
        chosen = fitting(grids, T_group_maps, self._config.resolution_m, self._config.max_merged_cells)
        return [robots[index] for index in chosen]

    def _merge(self, robots: list[str], snapshot: Snapshot, placements: Mapping[str, Placement]) -> OccupancyGrid:
        return merge_grids(
            [snapshot.grids[robot].grid for robot in robots],
            [placements[robot].T_group_map for robot in robots],
            self._config.blend,
            self._config.resolution_m,
            snapshot.stamp_ns,
            [snapshot.grids[robot].since_ns for robot in robots],
            self._config.max_merged_cells,
        )

    @staticmethod
    def _state(robots: list[str], snapshot: Snapshot, placements: Mapping[str, Placement]) -> object:
        return tuple((robot, snapshot.grids[robot].version, placements[robot]) for robot in robots)
