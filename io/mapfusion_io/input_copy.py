"""The recordings' own messages, made fit to stand beside the results."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from rosbags.interfaces.typing import Fielddefs
from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.metadata import parse_qos

from mapfusion_io import encode
from mapfusion_io.frame_edits import FrameEdits, FrameNames
from mapfusion_io.interfaces import Channel, RawMessage, Recording
from mapfusion_io.read_errors import printable
from mapfusion_io.ros2_form import NoRos2FormError, Ros2Form, ros2_form
from mapfusion_io.stamp_census import END_OF_TIME_NS
from mapfusion_io.topic_names import TF_STATIC_TOPIC, TF_TOPIC, is_result_topic
from mapfusion_io.topic_writer import LATCHED, LATCHED_STATICS, STREAMED, OutgoingMessage

_MAX_QOS_CHARACTERS = 65_536
MAX_DEFINITIONS = 500
"""Most different definitions that are copied: each takes some ten milliseconds and 200 kB."""

CUT = "transforms in it that give a robot's map frame a parent, which is the merged frame as soon as it is joined"


@dataclass(frozen=True, slots=True, eq=False)
class CopySource:
    """A recording to copy, and how.

    Attributes:
        recording: Read by nobody else while it is copied: two passes at once would mix up its losses.
        topic_for: Where a channel's messages shall stand; not asked about transforms, which all go to `/tf` and
            `/tf_static`.
        frame_names_for: The new names of the frames in a channel's messages; None leaves them as they are.
        time_shift_ns: Added to header stamps.
        log_shift_ns: Added to log times, which puts the messages beside the results of their time.
        hung_for: Of the frames in a channel's transforms, by their new names, those that hang in the results' frames:
            transforms that would hang them elsewhere too are left out.
    """

    recording: Recording
    topic_for: Callable[[Channel], str]
    frame_names_for: Callable[[Channel], FrameNames | None]
    time_shift_ns: int = 0
    log_shift_ns: int = 0
    hung_for: Callable[[Channel], frozenset[str]] = lambda channel: frozenset()


@dataclass(frozen=True, slots=True, order=True)
class LeftOut:
    """Messages that were not copied, or not wholly.

    Attributes:
        source: Base name of the recording.
        topic: As recorded.
        type_name: As recorded.
        reason: Why not, in words.
        count: Number of messages.
    """

    source: str
    topic: str
    type_name: str
    reason: str
    count: int


@dataclass(frozen=True, slots=True, eq=False)
class _Route:
    """Where a channel's messages go, and in which form."""

    topic: str
    qos: str
    form: Ros2Form
    edits: FrameEdits | None


class InputCopy:
    """Streams the messages of several recordings in the order of their log times.

    CDR messages stay as they are, byte for byte, unless a frame or a stamp has to change; ROS 1 messages become CDR.
    A channel stays out where ROS 2 has no form for it, where its topic is one of the results', or where topic or type
    already stand for something else in the file: readers take one definition of a type for all of a file.
    """

    def __init__(self, sources: Sequence[CopySource]) -> None:
        self._messages = heapq.merge(*map(self._stream, sources), key=lambda message: message.log_time_ns)
        self._next: OutgoingMessage | None = None
        self._left_out: Counter[tuple[str, str, str, str]] = Counter()
        self._topic_types = {TF_TOPIC: encode.TF_MESSAGE, TF_STATIC_TOPIC: encode.TF_MESSAGE}
        self._fields: dict[str, Fielddefs] = {}
        self._definitions: set[tuple[str, bytes]] = set()
        encoder = encode.Encoder()
        for name in encode.TYPES:
            kind = encoder.message_type(name)
            self._fields |= ros2_form(Channel("", name, kind.encoding, kind.definition, "cdr")).fields()

    @property
    def left_out(self) -> tuple[LeftOut, ...]:
        """What was met and not copied so far, sorted."""
        return tuple(sorted(LeftOut(*key, count) for key, count in self._left_out.items()))

    def until(self, log_time_ns: int | None) -> Iterator[OutgoingMessage]:
        """The messages not yet given with log times up to this one; all that are left for None.

        Raises:
            LogReadError: A recording cannot be read.
        """
        while True:
            message = self._next or next(self._messages, None)
            self._next = message
            if message is None or (log_time_ns is not None and message.log_time_ns > log_time_ns):
                return
            self._next = None
            yield message

    def _stream(self, source: CopySource) -> Iterator[OutgoingMessage]:
        routes: dict[Channel, _Route | str] = {}
        for raw in source.recording.messages(lambda channel: True):
            if raw.channel not in routes:
                routes[raw.channel] = self._route_or_reason(source, raw.channel)
            route = routes[raw.channel]
            num_cut, num_emptied = _nums_cut(route)
            copied = _copied(raw, route, source.log_shift_ns)
            if isinstance(copied, OutgoingMessage):
                if _nums_cut(route)[0] > num_cut:
                    self._leave_out(source, raw.channel, CUT)
                if _nums_cut(route)[1] == num_emptied:
                    yield copied
            else:
                self._leave_out(source, raw.channel, copied)

    def _leave_out(self, source: CopySource, channel: Channel, reason: str) -> None:
        self._left_out[source.recording.path.name, channel.topic, channel.schema_name, reason] += 1

    def _route_or_reason(self, source: CopySource, channel: Channel) -> _Route | str:
        """Where a channel goes, or why it stays out."""
        self._definitions.add((channel.schema_name, channel.schema_data))
        if len(self._definitions) > MAX_DEFINITIONS:
            return f"the recordings hold more than {MAX_DEFINITIONS} definitions"
        try:
            form = ros2_form(channel)
        except NoRos2FormError as reason:
            return str(reason)
        topic = _transform_topic(channel, form) or source.topic_for(channel)
        if printable(topic) != topic:
            return "its topic is no plain text"
        if is_result_topic(topic):
            return f"{topic} is a topic of the results"
        if self._topic_types.get(topic, form.kind.name) != form.kind.name:
            return f"{topic} holds {self._topic_types[topic]}"
        fields = form.fields()
        if any(self._fields.get(name, known) != known for name, known in fields.items()):
            return "the type or one within is defined otherwise elsewhere in the file"
        self._fields |= fields
        self._topic_types[topic] = form.kind.name
        rename = source.frame_names_for(channel)
        if rename is None and form.recorded_as_ros1:
            rename = str  # the edits drop leading slashes
        hung = source.hung_for(channel) if topic in (TF_TOPIC, TF_STATIC_TOPIC) else frozenset()
        is_edited = rename or source.time_shift_ns or hung
        edits = FrameEdits(form.store, rename or str, source.time_shift_ns, hung) if is_edited else None
        return _Route(topic, _qos(channel, topic, form), form, edits)


def _nums_cut(route: _Route | str) -> tuple[int, int]:
    """Messages of which transforms were cut off so far, and those of which nothing is left."""
    return (0, 0) if isinstance(route, str) or route.edits is None else (route.edits.num_cut, route.edits.num_emptied)


def _transform_topic(channel: Channel, form: Ros2Form) -> str:
    """The topic for transforms, also those on a namespace's own topic; empty for other messages."""
    topic = f"/{channel.topic.rpartition('/')[2]}"
    return topic if topic in (TF_TOPIC, TF_STATIC_TOPIC) and form.kind.name == encode.TF_MESSAGE else ""


def _copied(raw: RawMessage, route: _Route | str, shift_ns: int) -> OutgoingMessage | str:
    """A message on its way, or why it stays out."""
    if isinstance(route, str):
        return route
    try:
        data = route.form.cdr(raw.data, route.edits)
    except NoRos2FormError as reason:
        return str(reason)
    log_time_ns, publish_time_ns = (max(time_ns + shift_ns, 0) for time_ns in (raw.log_time_ns, raw.publish_time_ns))
    if max(log_time_ns, publish_time_ns) >= END_OF_TIME_NS:
        return "recorded at an impossible time"
    return OutgoingMessage(route.topic, route.form.kind, route.qos, data, log_time_ns, publish_time_ns)


def _qos(channel: Channel, topic: str, form: Ros2Form) -> str:
    """As recorded; what fits the topic where several recordings share it or nothing readable is recorded."""
    if topic == TF_STATIC_TOPIC:
        return LATCHED_STATICS
    recorded = channel.metadata.get("offered_qos_profiles", "")
    if topic != TF_TOPIC and _is_readable(recorded):
        return recorded
    latched = form.kind.name == encode.OCCUPANCY_GRID or channel.metadata.get("latching") == "1"
    return LATCHED if latched else STREAMED


def _is_readable(qos: str) -> bool:
    """Whether rosbags makes sense of it: what it cannot read makes it refuse the whole file."""
    try:
        return len(qos) <= _MAX_QOS_CHARACTERS and bool(parse_qos(qos))
    except (ReaderError, KeyError, TypeError, ValueError, AttributeError):
        return False
