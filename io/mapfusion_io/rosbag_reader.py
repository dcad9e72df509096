"""ROS 1 bags and rosbag2 recordings, through the readers of rosbags. None of these containers carries a checksum."""

from __future__ import annotations

import bz2
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from urllib.parse import quote

import lz4.frame
from rosbags.interfaces import Connection, ConnectionExtRosbag1, ConnectionExtRosbag2, MessageDefinitionFormat
from rosbags.rosbag1 import Reader as LibraryRosbag1
from rosbags.rosbag2.metadata import dump_qos_v8
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader as LibrarySqlite3

from mapfusion_io.interfaces import Attachment, Channel, Loss, RawMessage
from mapfusion_io.mcap_channels import Keep, three_part_name
from mapfusion_io.read_errors import os_error, read_error, words
from mapfusion_io.read_limits import ReadLimits

_DEFINITION_ENCODINGS = {MessageDefinitionFormat.MSG: "ros2msg", MessageDefinitionFormat.IDL: "ros2idl"}


_Library = LibraryRosbag1 | LibrarySqlite3


class _LibraryRecording(ABC):
    """A `Recording` behind a reader of rosbags. Whatever that raises leaves as a `LogReadError` or as a `Loss`."""

    container: str
    _repair: str
    integrity_verifiable = False

    def __init__(self, path: Path, limits: ReadLimits | None = None) -> None:
        self._path = path
        self._limits = limits or ReadLimits()
        self._channels: dict[tuple[int, str, str], Channel] = {}
        self._losses: list[Loss] = []

    @property
    def path(self) -> Path:
        """Where it lies."""
        return self._path

    @property
    def losses(self) -> tuple[Loss, ...]:
        """What the latest pass could not deliver."""
        return tuple(self._losses)

    def messages(self, keep: Keep) -> Iterator[RawMessage]:
        """The messages of the channels that `keep` wants, in the order of their log times.

        Raises:
            LogReadError: Nothing at all can be read.
        """
        self._losses = []
        library, channels = self._opened()
        try:
            wanted = [item for item in library.connections if keep(channels[item.id])]
            if wanted:
                yield from self._delivered(library, wanted, channels)
        finally:
            with suppress(Exception):
                library.close()

    def attachments(self) -> Iterator[Attachment]:
        """None: the container has no such thing."""
        return iter(())

    def metadata(self) -> Iterator[tuple[str, Mapping[str, str]]]:
        """None: the container has no such thing."""
        return iter(())

    @abstractmethod
    def _open(self) -> _Library:
        """A reader for the file, open."""

    @abstractmethod
    def _described(self, connection: Connection) -> Channel:
        """The channel that a connection is."""

    def _opened(self) -> tuple[_Library, Mapping[int, Channel]]:
        try:
            library = self._open()
            return library, {item.id: self._channel(item) for item in library.connections}
        except OSError as error:
            raise os_error(self._path, error) from error
        except Exception as error:  # the library lets errors of many kinds through
            raise read_error(self._path, f"is damaged or was cut off ({words(error)})", self._repair) from error

    def _channel(self, connection: Connection) -> Channel:
        """The same object for the same connection in every pass."""
        key = (connection.id, connection.topic, connection.msgtype)
        if not (isinstance(connection.topic, str) and isinstance(connection.msgtype, str)):
            raise TypeError("a topic or type that is no text")
        if key not in self._channels:
            self._channels[key] = self._described(connection)
        return self._channels[key]

    def _delivered(
        self, library: _Library, wanted: Collection[Connection], channels: Mapping[int, Channel]
    ) -> Iterator[RawMessage]:
        left = Counter({item.id: item.msgcount for item in wanted})
        reason = "the container's own index counts more"
        try:
            for connection, log_time_ns, data in library.messages(wanted):
                if not (isinstance(log_time_ns, int) and isinstance(data, bytes)):
                    continue  # stays in `left`
                left[connection.id] -= 1
                yield RawMessage(channels[connection.id], log_time_ns, log_time_ns, data)
        except Exception as error:  # the library lets errors of many kinds through
            reason = words(error)
        for connection_id, count in left.items():
            if count > 0:
                topic = channels[connection_id].topic
                self._lose("missing messages", "whole file", topic, count, reason)

    def _lose(self, kind: str, where: str, topic: str, count: int | None, detail: str) -> None:
        self._losses.append(Loss(self._path.name, kind, where, topic, count, detail))


class Rosbag1Recording(_LibraryRecording):
    """A ROS 1 bag, version 2.0."""

    container = "rosbag1"
    _repair = "Repair it with `rosbag reindex`."

    def _open(self) -> _Library:
        library = LibraryRosbag1(self._path)
        library.open()
        for offset, chunk in library.chunks.items():
            library.chunks[offset] = chunk._replace(decompressor=self._bounded(chunk.decompressor))
        return library

    def _bounded(self, decompressor: Callable[[bytes], bytes]) -> Callable[[bytes], bytes]:
        """The decompressor of a chunk, with a limit to what comes out."""
        limit = self._limits.record_bytes
        if decompressor is bz2.decompress:
            return lambda data: _within(limit, bz2.BZ2Decompressor().decompress(data, max_length=limit + 1))
        if decompressor is lz4.frame.decompress:
            return lambda data: _within(limit, lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=limit + 1))
        return decompressor

    def _described(self, connection: Connection) -> Channel:
        metadata = {"md5sum": connection.digest}
        if isinstance(connection.ext, ConnectionExtRosbag1):
            metadata["latching"] = "1" if connection.ext.latching else "0"
        definition = connection.msgdef.data.encode()
        return Channel(connection.topic, connection.msgtype, "ros1msg", definition, "ros1", metadata)


class Sqlite3Recording(_LibraryRecording):
    """A .db3 file of rosbag2."""

    container = "rosbag2-sqlite3"
    _repair = "Repair it with `sqlite3 FILE .recover`."

    def _open(self) -> _Library:
        # rosbags puts the path into a URI as it stands, where % ? # have a meaning
        library = LibrarySqlite3(Path(quote(str(self._path.absolute()))))
        library.open()
        ownerless = library.metadata.message_count - sum(item.msgcount for item in library.connections)
        if ownerless > 0:
            self._lose("definition lost", "table messages", "", ownerless, "their topic is missing from the file")
        journal = self._path.with_name(self._path.name + "-wal")
        if journal.exists() and journal.stat().st_size:
            detail = f"{journal.name} was never merged; open the database once with sqlite3 to do so"
            self._lose("unmerged journal", journal.name, "", None, detail)
        return library

    def _described(self, connection: Connection) -> Channel:
        encoding = _DEFINITION_ENCODINGS.get(connection.msgdef.format, "")
        name = three_part_name(connection.msgtype, {"cdr"})
        metadata, message_encoding = {}, "cdr"
        if isinstance(connection.ext, ConnectionExtRosbag2):
            metadata["offered_qos_profiles"] = dump_qos_v8(connection.ext.offered_qos_profiles)
            message_encoding = connection.ext.serialization_format
        if connection.digest:
            metadata["topic_type_hash"] = connection.digest
        definition = connection.msgdef.data.encode() if encoding else b""
        return Channel(connection.topic, name, encoding, definition, message_encoding, metadata)


def _within(limit: int, data: bytes) -> bytes:
    if len(data) > limit:
        raise ValueError(f"a chunk of more than {limit} bytes")
    return data
