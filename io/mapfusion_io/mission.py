"""Several recordings as one mission: its robots, their poses, and their grids in the order of time."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from mapfusion.errors import MissionError
from mapfusion.grid import OccupancyGrid
from mapfusion.steps import Event, GridEvent, RobotEvent, natural_key
from mapfusion_io.grid_stream import MissionRobot, stamped_grid_messages, whole_grid
from mapfusion_io.interfaces import Loss
from mapfusion_io.messages import GRID_TYPES
from mapfusion_io.mission_times import (
    ClippedPoses,
    apart_in_time,
    clocks_apart,
    mission_stamps,
    recording_shifts_ns,
    reported_ns,
    resolved_range,
)
from mapfusion_io.mission_topics import losses_that_count, unused_topics, used_topics
from mapfusion_io.poses import PoseOverrides, choose_poses, transform_tree
from mapfusion_io.read_errors import printable
from mapfusion_io.read_limits import ReadLimits
from mapfusion_io.robots import MapTopic, RobotOverrides, find_robots
from mapfusion_io.sniff import open_one
from mapfusion_io.survey import Survey, take_survey
from mapfusion_io.survey_taker import Clock
from mapfusion_io.time_range import TimeRange
from mapfusion_io.topic_survey import TopicSurvey


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
        found = find_robots(surveys, RobotOverrides(options.robots, options.drop), options.limits)
        self._over_limit = found.over_limit
        self.unique_frames = found.unique_frames
        self.shifts_ns = recording_shifts_ns(surveys, options.align_start)
        tree = transform_tree(found.unique_frames, surveys, self.shifts_ns)
        poses = choose_poses(found, tree, PoseOverrides(options.poses, options.base_frames))
        self.robots = tuple(MissionRobot(robot, poses[robot.robot], _updates(robot)) for robot in found.robots)
        self.passed_over = (*found.passed_over, *unused_topics(surveys, found, used_topics(self.robots)))
        map_frames = {robot.map_frame for robot in found.robots}
        self.frames = map_frames | {frame for frame in tree.frames if not frame.startswith("/")}
        self._bad_grids: Counter[tuple[str, str, str, str]] = Counter()
        stamps = mission_stamps(self.robots, self.shifts_ns)
        self.first_ns, self.last_ns, self.start_ns, self.end_ns = resolved_range(options.time_range, stamps)
        self.reported_ns = reported_ns(stamps, self.start_ns, self.end_ns)

    def require_robots(self) -> None:
        """Raises:
        MissionError: Fewer than two robots, with what was found instead.
        """
        if len(self.robots) >= 2:
            return
        files = ", ".join(survey.recording.path.name for survey in self.surveys)
        losses = self.losses
        lost = f"What was there is lost in part ({losses[0].kind} at {printable(losses[0].where)}). " if losses else ""
        if self.robots:
            raise MissionError(
                f"{files}: only one robot with a map ({self.robots[0].name}), a fusion needs two.\n"
                f"{lost}Give the other robots' recordings as well, or name its map topic with --robot NAME=TOPIC; "
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
            f"{lost}Record each robot's map topic; `mapfusion info` lists what is there."
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
        losses = losses_that_count(self.surveys, self.robots, used_topics(self.robots))
        for (source, kind, topic_name, reason), count in sorted(self._bad_grids.items()):
            losses.append(Loss(source, kind, topic_name, topic_name, count, reason))
        for item in self._over_limit:
            losses.append(Loss(item.source, "over limit", item.topic, item.topic, item.count, item.reason))
        return tuple(losses)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the user should know before trusting the messages and their times."""
        read = [f"{survey.recording.path.name}: {warning}" for survey in self.surveys for warning in survey.warnings]
        return (*read, *apart_in_time(self.surveys, self.robots, self.shifts_ns), *clocks_apart(self.robots))

    @property
    def are_apart_in_time(self) -> bool:
        """Whether there are recordings that share no time."""
        return bool(apart_in_time(self.surveys, self.robots, self.shifts_ns))

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
        num_updated_cells = 0
        for stamp_ns, robot, message in heapq.merge(*streams, key=lambda item: item[0]):
            base, is_update = newest.get(robot.name), not isinstance(message, OccupancyGrid)
            topic, source = robot.grid_topics[is_update].topic, robot.found.survey.recording.path.name
            if is_update and base is not None:
                num_updated_cells += base.cells.size
                if num_updated_cells > self.limits.updated_cells:
                    reason = f"patches on more than {self.limits.updated_cells} cells of maps"
                    self._bad_grids[source, "over limit", topic, reason] += 1
                    continue
            try:
                grid = whole_grid(robot, message, base)
            except ValueError as error:
                self._bad_grids[source, "malformed message", topic, str(error)] += 1
                continue
            newest[robot.name] = grid
            yield GridEvent(robot.name, stamp_ns, grid)

    def _give_up(self, survey: Survey, topic: str) -> None:
        reason = f"more than {self.limits.held_cells} cells of later maps stand before it in the file"
        self._bad_grids[survey.recording.path.name, "over limit", topic, reason] += 1


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


def _in_order(latched: Mapping[str, GridEvent]) -> list[GridEvent]:
    return sorted(latched.values(), key=lambda event: (event.stamp_ns, natural_key(event.robot)))
