"""The databases of rosbag2, through the reader of rosbags. They carry no checksum."""

from __future__ import annotations

import re
import sqlite3
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from contextlib import closing, suppress
from pathlib import Path
from urllib.parse import quote

from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinitionFormat
from rosbags.rosbag2.metadata import dump_qos_v8
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader as LibrarySqlite3

from mapfusion_io.definitions import MAX_DEFINITION_BYTES
from mapfusion_io.interfaces import Attachment, Channel, Loss, RawMessage
from mapfusion_io.mcap_channels import Keep, three_part_name
from mapfusion_io.read_errors import os_error, read_error, words
from mapfusion_io.read_limits import ReadLimits

_DEFINITION_ENCODINGS = {MessageDefinitionFormat.MSG: "ros2msg", MessageDefinitionFormat.IDL: "ros2idl"}
_REPAIR = "Repair it with `sqlite3 FILE .recover`."
_QOS_CHARACTERS = 2**19
"""Of all topics together; the library's parser takes five seconds for so many."""
_TOPICS_TIMES_DEFINITIONS = 10_000_000
"""The library looks through all definitions for each topic; a second for so many."""
_COMPUTED = re.compile(r"\bVIRTUAL\b|\bGENERATED\b|\bAS\s*\(", re.IGNORECASE)


class Sqlite3Recording:
    """A .db3 file of rosbag2. Whatever rosbags raises leaves as a `LogReadError` or as a `Loss`.

    Args:
        path: The file.
        limits: What the file may ask for.
    """

    container = "rosbag2-sqlite3"
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
            for item in library.connections:
                if item.id not in channels:
                    self._lose("over limit", "whole file", "", item.msgcount, "its topic is one too many or too large")
            wanted = [item for item in library.connections if item.id in channels and keep(channels[item.id])]
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

    def _opened(self) -> tuple[LibrarySqlite3, Mapping[int, Channel]]:
        try:
            library = self._open()
            named = [item for item in library.connections if self._is_within_limits(item)]
            return library, {item.id: self._channel(item) for item in named[: self._limits.definitions]}
        except OSError as error:
            raise os_error(self._path, error) from error
        except Exception as error:  # the library lets errors of many kinds through
            raise read_error(self._path, f"is damaged or was cut off ({words(error)})", _REPAIR) from error

    def _is_within_limits(self, connection: Connection) -> bool:
        if not (isinstance(connection.topic, str) and isinstance(connection.msgtype, str)):
            raise TypeError("a topic or type that is no text")
        longest = max(len(connection.topic), len(connection.msgtype))
        return longest <= self._limits.name_characters and len(connection.msgdef.data) <= MAX_DEFINITION_BYTES

    def _channel(self, connection: Connection) -> Channel:
        """The same object for the same connection in every pass."""
        key = (connection.id, connection.topic, connection.msgtype)
        if key not in self._channels:
            self._channels[key] = self._described(connection)
        return self._channels[key]

    def _delivered(
        self, library: LibrarySqlite3, wanted: Collection[Connection], channels: Mapping[int, Channel]
    ) -> Iterator[RawMessage]:
        left = Counter({item.id: item.msgcount for item in wanted})
        reason = "the container's own index counts more"
        try:
            for connection, log_time_ns, data in library.messages(wanted):
                if not (isinstance(log_time_ns, int) and isinstance(data, bytes)):
                    continue  # stays in `left`
                left[connection.id] -= 1
                if len(data) > self._limits.record_bytes:
                    topic = channels[connection.id].topic
                    detail = f"it has {len(data)} bytes, the limit is {self._limits.record_bytes}"
                    self._lose("over limit", f"the message of {log_time_ns / 1e9:.3f} s", topic, 1, detail)
                    continue
                yield RawMessage(channels[connection.id], log_time_ns, log_time_ns, data)
        except Exception as error:  # the library lets errors of many kinds through
            reason = words(error)
        for connection_id, count in left.items():
            if count > 0:
                topic = channels[connection_id].topic
                self._lose("missing messages", "whole file", topic, count, reason)

    def _lose(self, kind: str, where: str, topic: str, count: int | None, detail: str) -> None:
        self._losses.append(Loss(self._path.name, kind, where, topic, count, detail))

    def _open(self) -> LibrarySqlite3:
        # rosbags puts the path into a URI as it stands, where % ? # have a meaning
        quoted = quote(str(self._path.absolute()))
        _refuse_computed_tables(quoted)
        library = LibrarySqlite3(Path(quoted))
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


def _refuse_computed_tables(quoted_path: str) -> None:
    """Nothing in the database may be worked out while it is read: such a table could be without end.

    Raises:
        ValueError: A view, a virtual table or a computed column; or more topics and settings than the library can take.
    """
    with closing(sqlite3.connect(f"file:{quoted_path}?immutable=1", uri=True)) as database:
        tables = set()
        for kind, name, sql in database.execute("SELECT type, name, sql FROM sqlite_master"):
            if kind == "view" or (kind == "table" and _COMPUTED.search(str(sql))):
                raise ValueError(f"{name} is no plain table")
            tables.add(name)
        columns = [name for _, name, *_ in database.execute("PRAGMA table_info(topics)")]
        if "offered_qos_profiles" in columns:
            ((length,),) = database.execute("SELECT total(length(offered_qos_profiles)) FROM topics")
            if length > _QOS_CHARACTERS:
                raise ValueError(f"QoS profiles of {length:.0f} characters")
        if "message_definitions" in tables:
            ((num_pairs,),) = database.execute(
                "SELECT (SELECT count(*) FROM topics) * (SELECT count(*) FROM message_definitions)"
            )
            if num_pairs > _TOPICS_TIMES_DEFINITIONS:
                raise ValueError("too many topics and definitions")
