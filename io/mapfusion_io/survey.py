"""The first pass over a recording: what is in it and when, and every pose; of the grids only the newest is kept."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Literal

from mapfusion.grid import OccupancyGrid
from mapfusion.tf import TransformBuffer
from mapfusion_io.decode import Decoder, MalformedMessageError
from mapfusion_io.interfaces import Channel, Loss, Recording
from mapfusion_io.messages import (
    GRID_TYPES,
    POSE_TYPES,
    TRANSFORM_TYPES,
    UPDATE_TYPES,
    grid_update,
    occupancy_grid,
    pose,
    transforms,
)

Clock = Literal["header", "log"]
Role = Literal["grid", "update", "transform", "pose"]


@dataclass(slots=True)
class TopicSurvey:
    """What was seen on one topic of one recording, whatever its number of channels.

    Attributes:
        topic: As recorded.
        schema_name: Type of its messages.
        role: What it may serve for, None where its type is not one of ours.
        undecodable: Why its messages cannot be decoded, empty where they can.
        count: Number of messages.
        first_log_ns: Log time of the first message, and of the last one.
        stamps_ns: Grids and updates that can be believed: the stamp of each on the chosen clock, in file order.
        arrivals: Grids and updates that can be believed: the place of each among all of its recording, in file order.
        first_ns: Earliest stamp on the chosen clock, of any role but a static transform; None where there is none.
        last_ns: The latest one.
        frames: Grids and poses: how many name which frame, without leading slash.
        num_zero_stamps: Messages whose header's stamp is zero, so that their log time counts.
        malformed: Number of messages, or of transforms in them, that could not be believed, by reason.
        last_grid: Grids: the last one in file order that can be believed.
        buffer: Transforms and poses: their samples. A pose topic is an edge from the message's frame to the topic's
            name, whose leading slash keeps it apart from every frame.
    """

    topic: str
    schema_name: str
    role: Role | None
    undecodable: str
    count: int = 0
    first_log_ns: int = 0
    last_log_ns: int = 0
    stamps_ns: array[int] = field(default_factory=lambda: array("q"))
    arrivals: array[int] = field(default_factory=lambda: array("q"))
    first_ns: int | None = None
    last_ns: int | None = None
    frames: Counter[str] = field(default_factory=Counter)
    num_zero_stamps: int = 0
    malformed: Counter[str] = field(default_factory=Counter)
    last_grid: OccupancyGrid | None = None
    buffer: TransformBuffer = field(default_factory=TransformBuffer)

    def note_stamp(self, stamp_ns: int) -> None:
        """Widens the topic's range in time."""
        self.first_ns = stamp_ns if self.first_ns is None else min(self.first_ns, stamp_ns)
        self.last_ns = stamp_ns if self.last_ns is None else max(self.last_ns, stamp_ns)

    @property
    def namespace(self) -> str:
        """The topic without its last part and its outer slashes: `robot1` of `/robot1/map`."""
        return self.topic.strip("/").rpartition("/")[0]

    @property
    def num_malformed(self) -> int:
        """Messages that could not be believed."""
        return self.malformed.total()


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
    def first_ns(self) -> int | None:
        """Earliest stamp of anything that may serve, None where nothing may."""
        return min((topic.first_ns for topic in self.topics.values() if topic.first_ns is not None), default=None)

    @property
    def last_ns(self) -> int | None:
        """Latest stamp of anything that may serve, None where nothing may."""
        return max((topic.last_ns for topic in self.topics.values() if topic.last_ns is not None), default=None)


def take_survey(recording: Recording, name: str, clock: Clock) -> Survey:
    """Reads a recording once.

    Raises:
        LogReadError: Nothing at all can be read.
    """
    topics: dict[str, TopicSurvey] = {}
    by_channel: dict[Channel, TopicSurvey] = {}
    decoder = Decoder()
    arrivals = count()

    def note(channel: Channel) -> bool:
        role = role_of(channel)
        undecodable = (decoder.supported(channel) or "") if role else ""
        found = topics.setdefault(channel.topic, TopicSurvey(channel.topic, channel.schema_name, role, undecodable))
        by_channel[channel] = found
        return True

    for raw in recording.messages(note):
        topic = by_channel[raw.channel]
        if topic.count == 0:
            topic.first_log_ns = topic.last_log_ns = raw.log_time_ns
        topic.first_log_ns = min(topic.first_log_ns, raw.log_time_ns)
        topic.last_log_ns = max(topic.last_log_ns, raw.log_time_ns)
        topic.count += 1
        if topic.role is None or topic.undecodable:
            continue
        try:
            _TAKE[topic.role](decoder.decode(raw), raw.log_time_ns, topic, clock, arrivals)
        except MalformedMessageError as error:
            topic.malformed[error.reason] += 1
    losses = recording.losses
    is_own = any(record == "mapfusion" for record, _ in recording.metadata())
    return Survey(recording, name, _size_bytes(recording.path), topics, losses, is_own)


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


def _take_transforms(message: object, log_time_ns: int, topic: TopicSurvey, clock: Clock, _: Iterator[int]) -> None:
    is_static = topic.topic.endswith("tf_static")
    refused: list[str] = []
    for edge in transforms(message, refused):
        stamp_ns = stamp_on(clock, edge.stamp_ns, log_time_ns)
        topic.buffer.add(edge.parent, edge.child, stamp_ns, edge.translation_m, edge.quat_xyzw, is_static)
        if not is_static:
            topic.note_stamp(stamp_ns)
    topic.malformed.update(refused)


def _take_pose(message: object, log_time_ns: int, topic: TopicSurvey, clock: Clock, _: Iterator[int]) -> None:
    sample = pose(message)
    stamp_ns = stamp_on(clock, sample.stamp_ns, log_time_ns)
    topic.num_zero_stamps += sample.stamp_ns == 0
    topic.note_stamp(stamp_ns)
    topic.frames[sample.frame_id] += 1
    topic.buffer.add(sample.frame_id, topic.topic, stamp_ns, sample.translation_m, sample.quat_xyzw)


def _take_grid(message: object, log_time_ns: int, topic: TopicSurvey, clock: Clock, arrivals: Iterator[int]) -> None:
    grid = occupancy_grid(message)
    topic.frames[grid.frame_id] += 1
    topic.last_grid = grid
    _note_map(grid.stamp_ns, log_time_ns, topic, clock, arrivals)


def _take_update(message: object, log_time_ns: int, topic: TopicSurvey, clock: Clock, arrivals: Iterator[int]) -> None:
    _note_map(grid_update(message).stamp_ns, log_time_ns, topic, clock, arrivals)


def _note_map(stamp_ns: int, log_time_ns: int, topic: TopicSurvey, clock: Clock, arrivals: Iterator[int]) -> None:
    topic.num_zero_stamps += stamp_ns == 0
    topic.stamps_ns.append(stamp_on(clock, stamp_ns, log_time_ns))
    topic.arrivals.append(next(arrivals))
    topic.note_stamp(topic.stamps_ns[-1])


_TAKE: dict[Role, Callable[[object, int, TopicSurvey, Clock, Iterator[int]], None]] = {
    "grid": _take_grid,
    "update": _take_update,
    "transform": _take_transforms,
    "pose": _take_pose,
}
