"""What a recording is to the rest of the package, whatever its container."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, Protocol


@dataclass(frozen=True, slots=True, eq=False)
class Channel:
    """A stream of messages of one type on one topic. Several channels may share a topic: compare by identity.

    Attributes:
        topic: Topic as recorded.
        schema_name: Message type in ROS 2's three parts where it is a ROS type (`nav_msgs/msg/OccupancyGrid`, also
            for ROS 1 recordings), else as recorded.
        schema_encoding: `ros2msg`, `ros2idl`, `ros1msg`, `protobuf`, `jsonschema`, ... or empty where the container
            holds no definition.
        schema_data: The definition as recorded, empty where the container holds none.
        message_encoding: `cdr`, `ros1`, `json`, `protobuf`, ...
        metadata: The channel's own metadata; for ROS 2 with `offered_qos_profiles` where the container has it.
    """

    topic: str
    schema_name: str
    schema_encoding: str
    schema_data: bytes
    message_encoding: str
    metadata: Mapping[str, str] = field(default_factory=dict)


class RawMessage(NamedTuple):
    """A message as its container holds it."""

    channel: Channel
    log_time_ns: int
    publish_time_ns: int
    data: bytes | memoryview


class Attachment(NamedTuple):
    """A file inside a recording."""

    name: str
    media_type: str
    log_time_ns: int
    create_time_ns: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Loss:
    """Something that a recording held and that could not be had.

    Attributes:
        source: Base name of the file.
        kind: Short stable name, such as `truncated`, `chunk crc`, `malformed message`.
        where: Offset, chunk, topic or time: where it happened, in words.
        topic: The topic concerned, empty where it cannot be known.
        count: Number of messages lost, None where it cannot be known.
        detail: What was wrong, in words.
    """

    source: str
    kind: str
    where: str
    topic: str = ""
    count: int | None = None
    detail: str = ""


class Recording(Protocol):
    """One input: a file or a rosbag2 folder. Every call of `messages` reads it anew from its start, streaming."""

    @property
    def path(self) -> Path:
        """Where it lies."""

    @property
    def container(self) -> str:
        """`mcap`, `rosbag1`, `rosbag2-sqlite3` or `rosbag2-mcap`."""

    @property
    def integrity_verifiable(self) -> bool:
        """False where the container carries no checksums (known after a full pass of `messages`)."""

    @property
    def losses(self) -> tuple[Loss, ...]:
        """What the latest pass of `messages` could not deliver; complete when that pass has ended."""

    def messages(self, keep: Callable[[Channel], bool]) -> Iterator[RawMessage]:
        """The messages of the channels that `keep` wants, in file order, without decoding them.

        `keep` is asked once per channel and pass, in the order in which channels appear; a channel object is the same
        one in every pass over this Recording. Channels without messages are asked about as well, where the container
        tells of them.

        Raises:
            LogReadError: Nothing at all can be read.
        """

    def attachments(self) -> Iterator[Attachment]:
        """The files inside, in file order (none but in MCAP)."""

    def metadata(self) -> Iterator[tuple[str, Mapping[str, str]]]:
        """The metadata records inside, name and content, in file order (none but in MCAP)."""
