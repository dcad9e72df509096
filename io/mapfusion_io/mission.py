"""Several recordings as one mission: its robots, their poses, and their grids in the order of time."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np

from mapfusion.errors import ConfigError, MissionError
from mapfusion.grid import OccupancyGrid
from mapfusion.steps import Event, GridEvent, PoseSource, RobotEvent, StampArray, natural_key
from mapfusion.timeline import SILENCE_NS
from mapfusion.transform import FloatArray
from mapfusion_io.grid_stream import MissionRobot, stamped_grid_messages, whole_grid
from mapfusion_io.interfaces import Loss
from mapfusion_io.messages import GRID_TYPES
from mapfusion_io.poses import PoseOverrides, choose_poses, transform_tree
from mapfusion_io.read_errors import printable
from mapfusion_io.read_limits import ReadLimits
from mapfusion_io.robots import FoundRobots, MapTopic, PassedOver, RobotOverrides, find_robots
from mapfusion_io.sniff import open_one
from mapfusion_io.survey import SAME_CLOCK_NS, Clock, Survey, TopicSurvey, take_survey
from mapfusion_io.time_range import TimeRange


@dataclass(frozen=True, slots=True)
class MissionOptions:
    """What the user said about the recordings.

    Attributes:
        clock: Whose time counts: the messages' headers, or the recorder's log.
        align_start: Shift every recording to the start of the first.
        robots: Map topic by robot, as TOPIC or FILE:TOPIC.
        drop: Robots to leave out.
        poses: Pose topic by robot.
        base_frames: Base frame by robot.
        time_range: The part of the mission to use.
        limits: What the recordings may ask for.
    """

    clock: Clock = "header"
    align_start: bool = False
    robots: Mapping[str, str] = field(default_factory=dict)
    drop: Sequence[str] = ()
    poses: Mapping[str, str] = field(default_factory=dict)
    base_frames: Mapping[str, str] = field(default_factory=dict)
    time_range: TimeRange = field(default_factory=TimeRange)
    limits: ReadLimits = field(default_factory=ReadLimits)


class Mission:
    """Recordings that were read once. `events` reads them again, streaming.

    Attributes:
        surveys: The recordings, in natural order.
        robots: The robots, in natural order.
        limits: What the recordings may ask for.
        unique_frames: How the recordings' frames are made unique.
        frames: Every frame that the recordings' maps, transforms and poses name, made unique.
        passed_over: Topics that are not used, and why; map topics first.
        shifts_ns: Time added to the stamps of each recording, by its name.
        first_ns: First stamp that any robot's map or pose carries, on the mission's clock, within the time range.
        last_ns: The last one.
        reported_ns: How long anything was reported: the time between these two without longer silences.
        start_ns: Start of the time range, None where open.
        end_ns: End of the time range, exclusive, None where open.
    """

    def __init__(self, surveys: Sequence[Survey], options: MissionOptions) -> None:
        self.surveys = tuple(surveys)
        self.limits = options.limits
        found = find_robots(surveys, RobotOverrides(options.robots, options.drop), options.limits.robots)
        self._over_limit = found.over_limit
        self.unique_frames = found.unique_frames
        self.shifts_ns = _shifts_ns(surveys, options.align_start)
        tree = transform_tree(found.unique_frames, surveys, self.shifts_ns)
        poses = choose_poses(found, tree, PoseOverrides(options.poses, options.base_frames))
        self.robots = tuple(MissionRobot(robot, poses[robot.robot], _updates(robot)) for robot in found.robots)
        self.passed_over = (*found.passed_over, *_unused_topics(surveys, found, self._used_topics))
        map_frames = {robot.map_frame for robot in found.robots}
        self.frames = map_frames | {frame for frame in tree.frames if not frame.startswith("/")}
        self._bad_grids: Counter[tuple[str, str, str, str]] = Counter()
        stamps = self._stamps()
        self.first_ns, self.last_ns, self.start_ns, self.end_ns = _time_range(options.time_range, stamps)
        self.reported_ns = _reported_ns(stamps, self.start_ns, self.end_ns)

    def require_robots(self) -> None:
        """Raises:
        MissionError: Fewer than two robots, with what was found instead.
        """
        if len(self.robots) >= 2:
            return
        files = ", ".join(survey.recording.path.name for survey in self.surveys)
        if self.robots:
            raise MissionError(
                f"{files}: only one robot with a map ({self.robots[0].name}), a fusion needs two.\n"
                "Give the other robots' recordings as well, or name its map topic with --robot NAME=TOPIC; "
                "`mapfusion info` lists what was passed over."
            )
        maps = [item for item in self.passed_over if item.schema_name in GRID_TYPES]
        listed = [
            f"{printable(item.topic)} ({item.reason if maps else item.schema_name})"
            for item in maps or self.passed_over
        ]
        there = ", ".join(listed[:4]) + (f" and {len(listed) - 4} more" if len(listed) > 4 else "")
        raise MissionError(
            f"{files}: no robot's map in it (nav_msgs/OccupancyGrid), only {there or 'nothing'}.\n"
            "Record each robot's map topic; `mapfusion info` lists what is there."
        )

    def events(self) -> Iterator[Event]:
        """The robots, then their grids in the order of their stamps within the time range.

        Of the grids before its start the newest of each robot counts as well.
        """
        for robot in self.robots:
            source = robot.poses.source
            clipped = None if source is None else ClippedPoses(source, self.start_ns, self.end_ns)
            yield RobotEvent(robot.name, robot.found.map_frame, clipped)
        latched: dict[str, GridEvent] = {}
        for event in self._grid_events():
            if self.end_ns is not None and event.stamp_ns >= self.end_ns:
                break
            if self.start_ns is not None and event.stamp_ns < self.start_ns:
                latched[event.robot] = event
                continue
            yield from _in_order(latched)
            latched.clear()
            yield event
        yield from _in_order(latched)

    @property
    def losses(self) -> tuple[Loss, ...]:
        """What could not be read or believed of the topics in use; complete when `events` has ended."""
        used = self._used_topics
        losses: list[Loss] = []
        for survey in self.surveys:
            source = survey.recording.path.name
            losses.extend(loss for loss in survey.losses if not loss.topic or (survey.name, loss.topic) in used)
            for topic in survey.topics.values():
                if (survey.name, topic.topic) in used:
                    losses.extend(_refused(source, topic))
        for (source, kind, topic_name, reason), count in sorted(self._bad_grids.items()):
            losses.append(Loss(source, kind, topic_name, topic_name, count, reason))
        for item in self._over_limit:
            losses.append(Loss(item.source, "over limit", item.topic, item.topic, item.count, item.reason))
        return tuple(losses)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the user should know before trusting the times, each with what to do."""
        return (*_apart_in_time(self.surveys, self.robots, self.shifts_ns), *_clocks_apart(self.robots))

    @property
    def are_apart_in_time(self) -> bool:
        """Whether there are recordings that share no time."""
        return bool(_apart_in_time(self.surveys, self.robots, self.shifts_ns))

    @property
    def _used_topics(self) -> frozenset[tuple[str, str]]:
        """Recording's name and topic of everything that a robot needs."""
        maps = {(robot.found.survey.name, topic.topic) for robot in self.robots for topic in robot.grid_topics}
        poses = {(robot.found.survey.name, topic) for robot in self.robots for topic in robot.poses.topics}
        return frozenset(maps | poses)

    def _grid_events(self) -> Iterator[GridEvent]:
        """Every map of every robot, patches applied, in the order of their stamps."""
        self._bad_grids.clear()
        streams = [
            stamped_grid_messages(
                survey, robots, self.shifts_ns[survey.name], self.limits, partial(self._give_up, survey)
            )
            for survey in self.surveys
            if (robots := [robot for robot in self.robots if robot.found.survey is survey])
        ]
        newest: dict[str, OccupancyGrid] = {}
        for stamp_ns, robot, message in heapq.merge(*streams, key=lambda item: item[0]):
            try:
                grid = whole_grid(robot, message, newest.get(robot.name))
            except ValueError as error:
                topic = robot.grid_topics[not isinstance(message, OccupancyGrid)].topic
                source = robot.found.survey.recording.path.name
                self._bad_grids[source, "malformed message", topic, str(error)] += 1
                continue
            newest[robot.name] = grid
            yield GridEvent(robot.name, stamp_ns, grid)

    def _give_up(self, survey: Survey, topic: str) -> None:
        reason = f"more than {self.limits.held_cells} cells of later maps stand before it in the file"
        self._bad_grids[survey.recording.path.name, "over limit", topic, reason] += 1

    def _stamps(self) -> StampArray:
        """(N,) stamps of every map and pose of every robot, ascending."""
        stamps = [
            np.array(topic.stamps_ns, np.int64) + self.shifts_ns[robot.found.survey.name]
            for robot in self.robots
            for topic in robot.grid_topics
        ] + [robot.poses.source.stamps_ns for robot in self.robots if robot.poses.source is not None]
        found: StampArray = np.sort(np.concatenate([*stamps, np.empty(0, np.int64)]))
        return found


@dataclass(frozen=True, slots=True, eq=False)
class ClippedPoses:
    """A `PoseSource` within a time range.

    Attributes:
        source: All poses.
        start_ns: Start of the range, None where open.
        end_ns: End of the range, exclusive, None where open.
    """

    source: PoseSource
    start_ns: int | None
    end_ns: int | None

    @property
    def stamps_ns(self) -> StampArray:
        """(N,) times within the range."""
        stamps = self.source.stamps_ns
        low = 0 if self.start_ns is None else int(np.searchsorted(stamps, self.start_ns))
        high = stamps.size if self.end_ns is None else int(np.searchsorted(stamps, self.end_ns))
        return stamps[low:high]

    def poses_at(self, stamps_ns: StampArray) -> FloatArray:
        """(N, 3) of x_m, y_m, yaw_rad."""
        return self.source.poses_at(stamps_ns)


def _time_range(time_range: TimeRange, stamps_ns: StampArray) -> tuple[int, int, int | None, int | None]:
    """First and last stamp, and start and end of the range.

    Raises:
        ConfigError: No stamp lies in the range.
    """
    if stamps_ns.size == 0:
        return 0, 0, None, None
    first_ns, last_ns = int(stamps_ns[0]), int(stamps_ns[-1])
    start_ns, end_ns = time_range.resolve(first_ns)
    if (start_ns is not None and start_ns > last_ns) or (end_ns is not None and end_ns <= first_ns):
        raise ConfigError(
            f"nothing was recorded in the time range; the mission lasts {(last_ns - first_ns) * 1e-9:.1f} s "
            f"from {_date(first_ns)}"
        )
    return first_ns, last_ns, start_ns, end_ns


def _reported_ns(stamps_ns: StampArray, start_ns: int | None, end_ns: int | None) -> int:
    """Time between stamps (N,) within the range, of silences only as much as snapshots are made in."""
    low = 0 if start_ns is None else int(np.searchsorted(stamps_ns, start_ns))
    high = stamps_ns.size if end_ns is None else int(np.searchsorted(stamps_ns, end_ns))
    return int(np.minimum(np.diff(stamps_ns[low:high]), 2 * SILENCE_NS).sum())


def open_recording(paths: Sequence[Path | str], options: MissionOptions | None = None) -> Mission:
    """Reads recordings, one after the other, as one mission.

    Args:
        paths: Files or rosbag2 folders.
        options: What is known about them.

    Raises:
        LogReadError: One of them cannot be read at all.
        ConfigError: The options name what is not there.
    """
    options = options or MissionOptions()
    recordings = [open_one(Path(path), options.limits) for path in paths]
    names = _unique_names([recording.path for recording in recordings])
    surveys = [
        take_survey(recording, name, options.clock, options.limits)
        for recording, name in zip(recordings, names, strict=True)
    ]
    return Mission(sorted(surveys, key=lambda one: natural_key(one.name)), options)


def _unique_names(paths: Sequence[Path]) -> list[str]:
    """Base names without suffix; a number sets equal ones apart."""
    names: list[str] = []
    for path in paths:
        stem = path.resolve().name if path.is_dir() else path.stem
        name, number = stem, 2
        while name in names:
            name, number = f"{stem}_{number}", number + 1
        names.append(name)
    return names


def _updates(robot: MapTopic) -> TopicSurvey | None:
    topic = robot.survey.topics.get(robot.topic.topic + "_updates")
    return topic if topic is not None and topic.role == "update" and topic.stamps_ns else None


def _unused_topics(surveys: Sequence[Survey], found: FoundRobots, used: frozenset[tuple[str, str]]) -> list[PassedOver]:
    """Topics that no robot needs, other than the maps that `found` tells of."""
    reasons = {
        "transform": "no robot's poses come through it",
        "pose": "no robot's poses are taken from it",
        "update": "no robot's map has this name",
    }
    told = {(item.source, item.topic) for item in found.passed_over} | used
    return [
        PassedOver(
            survey.name,
            topic.topic,
            topic.schema_name,
            topic.count,
            topic.undecodable or reasons.get(topic.role or "", "neither map, transform nor pose"),
        )
        for survey in surveys
        for topic in survey.topics.values()
        if (survey.name, topic.topic) not in told
    ]


def _in_order(latched: Mapping[str, GridEvent]) -> list[GridEvent]:
    return sorted(latched.values(), key=lambda event: (event.stamp_ns, natural_key(event.robot)))


def _shifts_ns(surveys: Sequence[Survey], align_start: bool) -> dict[str, int]:
    """Time to add to each recording's stamps so that all start with the first one."""
    starts = {survey.name: survey.first_ns for survey in surveys if survey.first_ns is not None}
    if not align_start or not starts:
        return dict.fromkeys((survey.name for survey in surveys), 0)
    common_ns = next(iter(starts.values()))
    return {survey.name: common_ns - starts.get(survey.name, common_ns) for survey in surveys}


def _refused(source: str, topic: TopicSurvey) -> list[Loss]:
    return [
        Loss(source, kind, topic.topic, topic.topic, count, reason)
        for (kind, reason), count in sorted(topic.refused.items())
    ]


def _apart_in_time(
    surveys: Sequence[Survey], robots: Sequence[MissionRobot], shifts_ns: Mapping[str, int]
) -> tuple[str, ...]:
    """A warning where two recordings with robots share no time."""
    used = {robot.found.survey.name for robot in robots}
    spans = [
        (one.first_ns + shifts_ns[one.name], one.last_ns + shifts_ns[one.name], one.name)
        for one in surveys
        if one.name in used and one.first_ns is not None and one.last_ns is not None
    ]
    spans.sort()
    gaps = []
    end_ns, last = spans[0][1:] if spans else (0, "")
    for start_ns, stop_ns, name in spans[1:]:
        if start_ns > end_ns:
            gaps.append(f"{name} starts {_duration(start_ns - end_ns)} after {last} ends")
        if stop_ns > end_ns:
            end_ns, last = stop_ns, name
    if not gaps:
        return ()
    return (
        f"the recordings do not overlap in time: {'; '.join(gaps)}. "
        "Give --align-start to shift them to a common start.",
    )


def _clocks_apart(robots: Sequence[MissionRobot]) -> list[str]:
    """A warning for each robot whose maps' headers and the recorder's log tell different times."""
    warnings = []
    for robot in robots:
        lag_ns = robot.found.topic.lag_ns
        if abs(lag_ns) > SAME_CLOCK_NS:
            where = "ahead of" if lag_ns > 0 else "behind"
            warnings.append(
                f"the clock of {robot.name} is {_duration(abs(lag_ns))} {where} the recorder's, by its maps' headers. "
                "Robots are compared at equal header times; --clock log takes the recorder's times instead."
            )
    return warnings


def _duration(span_ns: int) -> str:
    seconds = span_ns * 1e-9
    for unit, length in (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 2 * length:
            return f"{seconds / length:.1f} {unit}"
    return f"{seconds:.1f} s"


def _date(stamp_ns: int) -> str:
    return datetime.fromtimestamp(stamp_ns // 1_000_000_000, UTC).isoformat().replace("+00:00", "Z")
