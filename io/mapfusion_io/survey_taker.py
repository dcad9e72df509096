"""Takes the messages of one recording, one by one, and keeps of each only what the mission needs."""

from __future__ import annotations

from collections import defaultdict
from itertools import count
from typing import Literal

from mapfusion.grid import OccupancyGrid
from mapfusion_io.decode import Decoder, MalformedMessageError
from mapfusion_io.interfaces import Channel, RawMessage
from mapfusion_io.messages import (
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
from mapfusion_io.topic_survey import Role, TopicSurvey, role_of

Clock = Literal["header", "log"]


class SurveyTaker:
    """Takes the messages of one recording.

    Args:
        clock: Whose time counts.
        limits: What the recording may ask for.
    """

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

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the user should know before trusting the messages."""
        return self._decoder.warnings

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
            topic.most_cells = max(topic.most_cells, found.cells.size)
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


def stamp_on(clock: Clock, stamp_ns: int, log_time_ns: int) -> int:
    """Time of a message on the chosen clock; a header's stamp of zero says nothing, so that the log time counts."""
    return stamp_ns if clock == "header" and stamp_ns != 0 else log_time_ns
