"""The first pass over a recording: what is in it and when, and every pose; of the grids only the newest is kept."""

from __future__ import annotations

from array import array
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Literal

import numpy as np

from mapfusion.grid import OccupancyGrid
from mapfusion.tf import TransformBuffer
from mapfusion_io.decode import Decoder, MalformedMessageError
from mapfusion_io.interfaces import Channel, Loss, RawMessage, Recording
from mapfusion_io.messages import (
    GRID_TYPES,
    POSE_TYPES,
    TRANSFORM_TYPES,
    UPDATE_TYPES,
    GridUpdate,
    OverLimitError,
    believed,
    grid_update,
    occupancy_grid,
    pose,
    transforms,
)
from mapfusion_io.read_errors import printable
from mapfusion_io.read_limits import ReadLimits
from mapfusion_io.stamp_census import END_OF_TIME_NS, StampCensus, StampRanges

Clock = Literal["header", "log"]
SAME_CLOCK_NS = 10_000_000_000
"""Maps may be this old when they are recorded; stamps further from the log time are of another clock."""
Role = Literal["grid", "update", "transform", "pose"]


@dataclass(slots=True)
class TopicSurvey:
    """What was seen on one topic of one recording, whatever its number of channels.

    Attributes:
        topic: As recorded.
        schema_name: Type of its messages.
        role: What it may serve for, None where its type is not one of ours.
        undecodable: Why its messages cannot be decoded, empty where they can.
        limits: What it may ask for.
        count: Number of messages.
        first_log_ns: Log time of the first message, and of the last one.
        stamps_ns: Grids and updates that can be believed: the stamp of each on the chosen clock, in file order.
        arrivals: Grids and updates that can be believed: the place of each among all of its recording, in file order.
        numbers: Grids and updates that can be believed: the place of each among the topic's messages, from 1.
        lags_ns: Grids and updates: how far each stamp lies after its log time.
        first_ns: Earliest stamp on the chosen clock, of any role but a static transform; None where there is none.
        last_ns: The latest one.
        frames: Grids and poses: how many name which frame, without leading slash.
        num_zero_stamps: Messages whose header's stamp is zero, so that their log time counts.
        refused: Number of messages, or of transforms in them, that were not taken, by kind of loss and reason.
        last_grid: Grids: the last one in file order that can be believed.
        buffer: Transforms and poses: their samples. A pose topic is an edge from the message's frame to the topic's
            name, whose leading slash keeps it apart from every frame.
    """

    topic: str
    schema_name: str
    role: Role | None
    undecodable: str
    limits: ReadLimits = field(default_factory=ReadLimits)
    count: int = 0
    first_log_ns: int = 0
    last_log_ns: int = 0
    stamps_ns: array[int] = field(default_factory=lambda: array("q"))
    arrivals: array[int] = field(default_factory=lambda: array("q"))
    numbers: array[int] = field(default_factory=lambda: array("q"))
    lags_ns: array[int] = field(default_factory=lambda: array("q"))
    first_ns: int | None = None
    last_ns: int | None = None
    frames: Counter[str] = field(default_factory=Counter)
    num_zero_stamps: int = 0
    refused: Counter[tuple[str, str]] = field(default_factory=Counter)
    last_grid: OccupancyGrid | None = None
    buffer: TransformBuffer = field(default_factory=TransformBuffer)

    def refuse(self, kind: str, reason: str, count: int = 1) -> None:
        """Takes note of messages that are not taken; rare reasons share an entry when there are too many."""
        if (kind, reason) not in self.refused and len(self.refused) >= self.limits.losses:
            reason = "for further reasons"
        self.refused[kind, reason] += count

    def settle(self, believable: StampRanges) -> None:
        """Drops what lies far from everything else in time, once all of the recording is known."""
        stamps = np.array(self.stamps_ns, np.int64)
        kept = believable.hold(stamps)
        self.stamps_ns, self.arrivals, self.numbers = (
            array("q", np.array(values, np.int64)[kept].tolist())
            for values in (self.stamps_ns, self.arrivals, self.numbers)
        )
        num_far = int(kept.size - kept.sum()) + self.buffer.keep(believable.hold)
        if num_far:
            self.refuse("malformed message", "its stamp lies days away from everything else", num_far)
        ranges = [(int(stamps[kept].min()), int(stamps[kept].max()))] if kept.any() else []
        ranges += [self.buffer.range_ns] if self.buffer.range_ns else []
        if ranges:
            self.first_ns, self.last_ns = min(first for first, _ in ranges), max(last for _, last in ranges)

    @property
    def lag_ns(self) -> int:
        """Grids and updates: how far their stamps usually lie after their log times."""
        return int(np.median(np.array(self.lags_ns, np.int64))) if self.lags_ns else 0

    @property
    def namespace(self) -> str:
        """The topic without its last part and its outer slashes: `robot1` of `/robot1/map`."""
        return self.topic.strip("/").rpartition("/")[0]

    @property
    def num_refused(self) -> int:
        """Messages, or transforms in them, that were not taken."""
        return self.refused.total()


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """One recording after its first pass.

    Attributes:
        recording: The recording.
        name: Its base name without suffix, unique among the mission's recordings.
        size_bytes: Of the file, or of all files of the folder.
        topics: By topic, in the order of their first message.
        losses: What could not be read.
        is_own_output: Whether mapfusion wrote it.
    """

    recording: Recording
    name: str
    size_bytes: int
    topics: dict[str, TopicSurvey]
    losses: tuple[Loss, ...]
    is_own_output: bool

    @property
    def clock_lag_ns(self) -> int:
        """How far the robots' clocks lie after the recorder's, by the maps; 0 where they tell the same time."""
        lags_ns = [topic.lag_ns for topic in self.topics.values() if topic.lags_ns]
        lag_ns = int(np.median(lags_ns)) if lags_ns else 0
        return lag_ns if abs(lag_ns) > SAME_CLOCK_NS else 0

    @property
    def first_ns(self) -> int | None:
        """Earliest stamp of anything that may serve, None where nothing may."""
        return min((topic.first_ns for topic in self.topics.values() if topic.first_ns is not None), default=None)

    @property
    def last_ns(self) -> int | None:
        """Latest stamp of anything that may serve, None where nothing may."""
        return max((topic.last_ns for topic in self.topics.values() if topic.last_ns is not None), default=None)


def take_survey(recording: Recording, name: str, clock: Clock, limits: ReadLimits | None = None) -> Survey:
    """Reads a recording once.

    Raises:
        LogReadError: Nothing at all can be read.
    """
    taker = _Taker(clock, limits or ReadLimits())
    for raw in recording.messages(taker.note_channel):
        taker.take(raw)
    losses = recording.losses
    is_own = any(record == "mapfusion" for record, _ in recording.metadata())
    return Survey(recording, name, _size_bytes(recording.path), taker.settled(), losses, is_own)


class _Taker:
    """Takes the messages of one recording."""

    def __init__(self, clock: Clock, limits: ReadLimits) -> None:
        self._clock = clock
        self._limits = limits
        self._topics: dict[str, TopicSurvey] = {}
        self._by_channel: dict[Channel, TopicSurvey] = {}
        self._decoder = Decoder()
        self._census = StampCensus()
        self._arrivals = count()
        self._edges: defaultdict[str, set[tuple[str, str]]] = defaultdict(set)
        self._num_taken = 0

    def note_channel(self, channel: Channel) -> bool:
        """Makes a topic of a channel; of several channels on a topic the first one of use says what it is."""
        role = role_of(channel)
        undecodable = (self._decoder.supported(channel) or "") if role else ""
        found = self._topics.get(channel.topic)
        if found is None:
            found = TopicSurvey(channel.topic, channel.schema_name, role, undecodable, self._limits)
            self._topics[channel.topic] = found
        elif role and not undecodable and (found.role is None or found.undecodable):
            found.role, found.schema_name, found.undecodable = role, channel.schema_name, ""
        self._by_channel[channel] = found
        return True

    def take(self, raw: RawMessage) -> None:
        """Takes a message, or takes note of why not."""
        topic = self._by_channel[raw.channel]
        if topic.count == 0:
            topic.first_log_ns = topic.last_log_ns = raw.log_time_ns
        topic.first_log_ns = min(topic.first_log_ns, raw.log_time_ns)
        topic.last_log_ns = max(topic.last_log_ns, raw.log_time_ns)
        topic.count += 1
        if topic.role is None or topic.undecodable:
            return
        try:
            self._take_role(raw, topic)
        except OverLimitError as error:
            topic.refuse("over limit", error.reason)
        except MalformedMessageError as error:
            topic.refuse("malformed message", error.reason)

    def _take_role(self, raw: RawMessage, topic: TopicSurvey) -> None:
        role = role_of(raw.channel)
        problem = (
            self._decoder.supported(raw.channel) if role == topic.role else f"not a {printable(topic.schema_name)}"
        )
        if problem is not None:
            raise MalformedMessageError("", 0, problem)
        if self._num_taken >= self._limits.messages:
            raise OverLimitError("", 0, f"more than {self._limits.messages} maps, transforms and poses")
        if role in ("transform", "pose") and len(raw.data) > self._limits.sample_bytes:
            raise OverLimitError("", 0, f"a message of more than {self._limits.sample_bytes} bytes")
        message = self._decoder.decode(raw)
        if role == "transform":
            self._take_transforms(message, raw.log_time_ns, topic)
        elif role == "pose":
            self._take_pose(message, raw.log_time_ns, topic)
        else:
            self._take_map(message, raw.log_time_ns, topic)

    def settled(self) -> dict[str, TopicSurvey]:
        """The topics, when all has been taken."""
        believable = self._census.believable()
        for topic in self._topics.values():
            topic.settle(believable.get(topic.topic, StampRanges()))
        return self._topics

    def _take_transforms(self, message: object, log_time_ns: int, topic: TopicSurvey) -> None:
        is_static = topic.topic.endswith("tf_static")
        refused: list[str] = []
        for edge in believed(transforms, message, refused):
            try:
                stamp_ns = 0 if is_static else self._stamp(edge.stamp_ns, log_time_ns, topic)
            except MalformedMessageError as error:
                refused.append(error.reason)
                continue
            self._require_room_for_edge(topic, edge.parent, edge.child)
            topic.buffer.add(edge.parent, edge.child, stamp_ns, edge.translation_m, edge.quat_xyzw, is_static)
            self._num_taken += 1
        for reason in refused:
            topic.refuse("malformed message", reason)

    def _take_pose(self, message: object, log_time_ns: int, topic: TopicSurvey) -> None:
        sample = believed(pose, message)
        stamp_ns = self._stamp(sample.stamp_ns, log_time_ns, topic)
        self._require_room_for_edge(topic, sample.frame_id, topic.topic)
        topic.num_zero_stamps += sample.stamp_ns == 0
        topic.frames[sample.frame_id] += 1
        topic.buffer.add(sample.frame_id, topic.topic, stamp_ns, sample.translation_m, sample.quat_xyzw)
        self._num_taken += 1

    def _take_map(self, message: object, log_time_ns: int, topic: TopicSurvey) -> None:
        found = map_message(topic.role, message, self._limits)
        stamp_ns = self._stamp(found.stamp_ns, log_time_ns, topic)
        if isinstance(found, OccupancyGrid):
            if found.frame_id not in topic.frames and len(topic.frames) >= self._limits.frames:
                raise OverLimitError("", 0, f"more than {self._limits.frames} frames")
            topic.frames[found.frame_id] += 1
            topic.last_grid = found
        topic.num_zero_stamps += found.stamp_ns == 0
        topic.stamps_ns.append(stamp_ns)
        topic.lags_ns.append(stamp_ns - log_time_ns)
        topic.arrivals.append(next(self._arrivals))
        topic.numbers.append(topic.count)
        self._num_taken += 1

    def _stamp(self, stamp_ns: int, log_time_ns: int, topic: TopicSurvey) -> int:
        """A message's time on the chosen clock.

        Raises:
            MalformedMessageError: It lies before 1970 or after what ROS can say.
        """
        chosen_ns = stamp_on(self._clock, stamp_ns, log_time_ns)
        if not (0 <= chosen_ns < END_OF_TIME_NS and 0 <= log_time_ns < END_OF_TIME_NS):
            raise MalformedMessageError("", 0, "its time lies before 1970 or after 2038")
        self._census.add(topic.topic, chosen_ns, log_time_ns)
        return chosen_ns

    def _require_room_for_edge(self, topic: TopicSurvey, parent: str, child: str) -> None:
        edges = self._edges[topic.topic]
        if (parent, child) not in edges:
            if len(edges) >= self._limits.frames:
                raise OverLimitError("", 0, f"more than {self._limits.frames} frames")
            edges.add((parent, child))


def map_message(role: Role | None, message: object, limits: ReadLimits) -> OccupancyGrid | GridUpdate:
    """A decoded message of a map topic, or of its topic of updates.

    Raises:
        MalformedMessageError: It cannot be believed.
    """
    return believed(occupancy_grid, message, limits) if role == "grid" else believed(grid_update, message, limits)


def _size_bytes(path: Path) -> int:
    files = path.rglob("*") if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files if file.is_file())


def role_of(channel: Channel) -> Role | None:
    """What a channel may serve for, by the type of its messages."""
    return _ROLES.get(channel.schema_name)


def stamp_on(clock: Clock, stamp_ns: int, log_time_ns: int) -> int:
    """Time of a message on the chosen clock; a header's stamp of zero says nothing, so that the log time counts."""
    return stamp_ns if clock == "header" and stamp_ns != 0 else log_time_ns


_ROLES: dict[str, Role] = {
    **dict.fromkeys(GRID_TYPES, "grid"),
    **dict.fromkeys(UPDATE_TYPES, "update"),
    **dict.fromkeys(TRANSFORM_TYPES, "transform"),
    **dict.fromkeys(POSE_TYPES, "pose"),
}
