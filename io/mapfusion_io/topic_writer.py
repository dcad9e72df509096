"""ROS 2 messages into an MCAP that every reader accepts: one channel a topic, indexes, statistics and CRCs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import IO, Any, Literal, NamedTuple, cast

from mcap.writer import CompressionType, Writer

from mapfusion.version import __version__
from mapfusion_io.atomic import AtomicFile
from mapfusion_io.encode import MessageType

Compression = Literal["zstd", "lz4", "none"]

_CHUNK_BYTES = 1024 * 1024


def qos(*, latched: bool, depth: int) -> str:
    """`offered_qos_profiles` of a reliable publisher that keeps its last `depth` messages, for late comers if latched.

    Integers for the policies are the form that every version of rosbag2 reads.
    """
    forever = "\n    sec: 9223372036\n    nsec: 854775807"
    return (
        f"- history: 1\n  depth: {depth}\n  reliability: 1\n  durability: {1 if latched else 2}\n"
        f"  deadline:{forever}\n  lifespan:{forever}\n  liveliness: 1\n  liveliness_lease_duration:{forever}\n"
        "  avoid_ros_namespace_conventions: false"
    )


LATCHED = qos(latched=True, depth=1)
"""Of a topic whose newest message is the whole truth."""
LATCHED_STATICS = qos(latched=True, depth=100)
"""Of `/tf_static` where several recordings' static transforms stand on it, each in its own messages."""
STREAMED = qos(latched=False, depth=100)
"""Of a topic on which each message stands for its moment."""


class OutgoingMessage(NamedTuple):
    """A CDR message on its way into the file."""

    topic: str
    kind: MessageType
    qos: str
    data: bytes | memoryview
    log_time_ns: int
    publish_time_ns: int


@dataclass(slots=True)
class _Channel:
    id: int
    type_name: str
    num_messages: int = 0


class TopicWriter:
    """Writes to `stream`, which it does not close. A topic's channel is made by the topic's first message."""

    def __init__(self, stream: AtomicFile, compression: Compression = "zstd") -> None:
        self._writer = Writer(
            cast("IO[Any]", stream),
            chunk_size=_CHUNK_BYTES,
            compression=CompressionType[compression.upper()],
            enable_data_crcs=True,
        )
        self._schema_ids: dict[MessageType, int] = {}
        self._channels: dict[str, _Channel] = {}
        self._writer.start(profile="ros2", library=f"mapfusion/{__version__}")

    def write(self, message: OutgoingMessage) -> None:
        """Appends a message. What the topic's first message says of QoS and definition holds for the topic.

        Raises:
            ValueError: The topic has carried another type.
        """
        topic, kind = message.topic, message.kind
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._channels[topic] = _Channel(self._register(topic, kind, message.qos), kind.name)
        if channel.type_name != kind.name:
            raise ValueError(f"{topic} carries {channel.type_name}, not {kind.name}")
        self._writer.add_message(
            channel.id,
            message.log_time_ns,
            cast("bytes", message.data),
            publish_time=message.publish_time_ns,
            sequence=channel.num_messages,
        )
        channel.num_messages += 1

    def attach(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Appends a file, dated `time_ns` on the mission's clock."""
        self._writer.add_attachment(time_ns, time_ns, name, media_type, data)

    def add_metadata(self, name: str, content: Mapping[str, str]) -> None:
        """Appends a metadata record."""
        self._writer.add_metadata(name, dict(sorted(content.items())))

    def finish(self) -> None:
        """Writes what is left and the summary; nothing can be added afterwards."""
        self._writer.finish()  # type: ignore[no-untyped-call]

    def _register(self, topic: str, kind: MessageType, qos: str) -> int:
        if kind not in self._schema_ids:
            self._schema_ids[kind] = self._writer.register_schema(kind.name, kind.encoding, kind.definition)
        metadata = {"offered_qos_profiles": qos, "topic_type_hash": kind.type_hash}
        return self._writer.register_channel(topic, "cdr", self._schema_ids[kind], metadata)
