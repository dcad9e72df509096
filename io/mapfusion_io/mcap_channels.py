"""The channels of an MCAP file as they become known, and which of them are wanted."""

from __future__ import annotations

from collections.abc import Callable

from mcap.records import Channel as ChannelRecord
from mcap.records import Schema as SchemaRecord

from mapfusion_io.interfaces import Channel
from mapfusion_io.mcap_summary import Summary
from mapfusion_io.read_limits import ReadLimits

Keep = Callable[[Channel], bool]
ChannelObjects = dict[tuple[object, ...], Channel]
"""Every channel object of a recording by what defines it, so that each pass uses the same ones."""

_ROS_ENCODINGS = frozenset({"ros1msg", "ros2msg", "ros2idl", "ros1", "cdr"})


class ChannelTable:
    """Channels by id, for one pass over the file.

    Args:
        objects: The recording's channel objects so far; grows.
        limits: How many there may be, and how large.
        keep: Says whether a channel is wanted; asked once per channel.

    Attributes:
        wanted: By id, the channel, or None where it is not wanted. Ids that are not in it are not defined yet.
        num_refused: Definitions that were passed over because they are too many or too large.
    """

    def __init__(self, objects: ChannelObjects, limits: ReadLimits, keep: Keep) -> None:
        self.wanted: dict[int, Channel | None] = {}
        self.num_refused = 0
        self._objects = objects
        self._limits = limits
        self._num_bytes = 0
        self._keep = keep
        self._asked: dict[Channel, bool] = {}
        self._defined: dict[int, Channel] = {}
        self._schemas: dict[int, SchemaRecord] = {}
        self._summary = Summary({}, {})

    def set_summary(self, summary: Summary) -> None:
        """Where definitions come from that are missing from the data, lost with a chunk."""
        self._summary = summary

    def add_schema(self, record: SchemaRecord) -> None:
        """A definition for the channels that follow."""
        if self._schemas.get(record.id) == record:
            return
        if not self._has_room(record.name, len(record.data)):
            self.num_refused += 1
            self._schemas.pop(record.id, None)
            return
        self._schemas[record.id] = record

    def add_channel(self, record: ChannelRecord) -> None:
        """Defines a channel; in other words than before, it is another channel from here on.

        One whose schema is missing stays undefined, since nobody could tell what its messages are.
        """
        schema = self._schemas.get(record.schema_id) or self._summary.schemas.get(record.schema_id)
        if schema is None and record.schema_id != 0:
            return
        name, encoding, data = ("", "", b"") if schema is None else (schema.name, schema.encoding, schema.data)
        key = (record.id, record.topic, name, encoding, data, record.message_encoding, tuple(record.metadata.items()))
        channel = self._objects.get(key)
        if channel is None:
            size = len(record.topic) + sum(len(key) + len(value) for key, value in record.metadata.items())
            if len(self._objects) >= self._limits.definitions or not self._has_room(record.topic, size):
                self.num_refused += 1
                self._defined.pop(record.id, None)
                self.wanted.pop(record.id, None)
                return
            name = three_part_name(name, {encoding, record.message_encoding})
            channel = Channel(record.topic, name, encoding, data, record.message_encoding, record.metadata)
            self._objects[key] = channel
        if channel not in self._asked:
            self._asked[channel] = self._keep(channel)
        self._defined[record.id] = channel
        self.wanted[record.id] = channel if self._asked[channel] else None

    def _has_room(self, name: str, num_bytes: int) -> bool:
        """Whether a definition may be kept, which then counts."""
        if len(name) > self._limits.name_characters or self._num_bytes + num_bytes > self._limits.definition_bytes:
            return False
        self._num_bytes += num_bytes
        return True

    def find(self, channel_id: int) -> Channel | None:
        """The channel of an id, wanted or not; None where neither the data nor the summary defines it."""
        if channel_id not in self._defined and channel_id in self._summary.channels:
            self.add_channel(self._summary.channels[channel_id])
        return self._defined.get(channel_id)

    @property
    def are_all_wanted(self) -> bool:
        """Whether no channel that was defined so far is unwanted."""
        return all(self._asked.values())

    def find_rest(self) -> None:
        """Asks about the channels that only the summary defines."""
        for channel_id in sorted(self._summary.channels):
            self.find(channel_id)


def three_part_name(name: str, encodings: set[str]) -> str:
    """A ROS type in ROS 2's three parts: `nav_msgs/msg/OccupancyGrid` for `nav_msgs/OccupancyGrid`."""
    if encodings & _ROS_ENCODINGS and name.count("/") == 1:
        return name.replace("/", "/msg/")
    return name
