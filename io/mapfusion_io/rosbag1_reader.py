"""ROS 1 bags, read in file order, with or without their index; what is damaged is passed over and named.

rosbags' own reader is not used: it refuses a bag without index, which is what a robot that lost power leaves, and
gives up at the first damage.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mapfusion.errors import LogReadError
from mapfusion_io.definitions import MAX_DEFINITION_BYTES
from mapfusion_io.interfaces import Attachment, Channel, Loss, RawMessage
from mapfusion_io.mcap_channels import Keep, three_part_name
from mapfusion_io.mcap_records import DamagedError
from mapfusion_io.read_errors import os_error, read_error
from mapfusion_io.read_limits import ReadLimits
from mapfusion_io.rosbag1_records import (
    BAG_HEADER,
    CHUNK,
    CONNECTION,
    MAGIC,
    MESSAGE,
    BagIndex,
    BagRecord,
    chunk_contents,
    connection_fields,
    inside_cut_chunk,
    number,
    read_index,
    records,
    time_ns,
)

_WANTED = frozenset({CHUNK, MESSAGE, CONNECTION, BAG_HEADER})


class Rosbag1Recording:
    """A ROS 1 bag, version 2.0. It carries no checksum.

    Args:
        path: The file.
        limits: What the file may ask for.
    """

    container = "rosbag1"
    integrity_verifiable = False

    def __init__(self, path: Path, limits: ReadLimits | None = None) -> None:
        self._path = path
        self._limits = limits or ReadLimits()
        self._channels: dict[tuple[object, ...], Channel] = {}
        self._latest: _Pass | None = None

    @property
    def path(self) -> Path:
        """Where it lies."""
        return self._path

    @property
    def losses(self) -> tuple[Loss, ...]:
        """What the latest pass could not deliver."""
        return () if self._latest is None else tuple(self._latest.losses)

    def messages(self, keep: Keep) -> Iterator[RawMessage]:
        """The messages of the channels that `keep` wants, in file order.

        Raises:
            LogReadError: Nothing at all can be read.
        """
        self._latest = latest = _Pass(self._path, self._limits, self._channels, keep)
        try:
            with self._path.open("rb") as file:
                yield from latest.messages(file)
        except OSError as error:
            if not latest.num_found:
                raise os_error(self._path, error) from error
            latest.lose("read error", "after the last record read", detail=str(error))

    def attachments(self) -> Iterator[Attachment]:
        """None: the container has no such thing."""
        return iter(())

    def metadata(self) -> Iterator[tuple[str, Mapping[str, str]]]:
        """None: the container has no such thing."""
        return iter(())


class _Pass:
    """One pass over the messages: definitions so far, what was delivered, what was lost."""

    def __init__(self, path: Path, limits: ReadLimits, channels: dict[tuple[object, ...], Channel], keep: Keep) -> None:
        self._path = path
        self._limits = limits
        self._channels = channels
        self._keep = keep
        self._wanted: dict[int, Channel | None] = {}
        self._topics: dict[int, str] = {}
        self._counted: Counter[int] = Counter()
        self._orphans: Counter[int] = Counter()
        self._num_inner = 0
        self.losses: list[Loss] = []
        self.num_found = 0

    def messages(self, file: BinaryIO) -> Iterator[RawMessage]:
        """The whole pass."""
        size = file.seek(0, 2)
        try:
            header = next(records(file, len(MAGIC), size, self._limits.record_bytes, _WANTED), None)
            if header is None or header.op != BAG_HEADER:
                raise DamagedError("truncated", "it has no header")
            if header.fields.get(b"encryptor"):
                raise DamagedError("encrypted", "its chunks are encrypted")
            index = read_index(file, header, size)
        except DamagedError as error:
            raise self._nothing(error.detail) from error
        for record in index.connections:
            self._connect(record)
        yield from self._data(file, header.end, min(index.offset or size, size), index)
        self._finish(index, size)

    def lose(self, kind: str, where: str, topic: str = "", count: int | None = None, detail: str = "") -> None:
        """Notes a loss; those over the limit of losses share the last entry."""
        loss = Loss(self._path.name, kind, where, topic, count, detail)
        if len(self.losses) > self._limits.losses:
            total = (self.losses.pop().count or 0) + (count or 0)
            loss = Loss(self._path.name, "further losses", f"up to {where}", "", total, "too many to name each")
        self.losses.append(loss)

    def _data(self, file: BinaryIO, offset: int, end: int, index: BagIndex) -> Iterator[RawMessage]:
        """The bag up to its index; behind damage the walk goes on at the next chunk that the index knows."""
        starts = sorted(index.chunk_counts)
        while True:
            try:
                for record in records(file, offset, end, self._limits.record_bytes, _WANTED):
                    offset = record.end
                    if record.op == CHUNK:
                        yield from self._chunk(record, index)
                    else:  # what stands outside of chunks was being written when the recorder stopped
                        yield from self._inner(record, f"byte {record.offset}")
                return
            except DamagedError as error:
                later = bisect_right(starts, offset)
                resume = starts[later] if later < len(starts) else None
                if resume is None:
                    if error.kind == "truncated":
                        yield from self._cut_chunk(file, offset, end)
                    self.lose(error.kind, f"byte {offset}", detail=error.detail)
                    return
                self.lose("damaged record", f"bytes {offset} to {resume}", detail=error.detail)
                offset = resume

    def _chunk(self, record: BagRecord, index: BagIndex) -> Iterator[RawMessage]:
        where = f"chunk at byte {record.offset}"
        try:
            if self._num_inner > self._limits.chunked_records:
                detail = f"the chunks before it hold more than {self._limits.chunked_records} records"
                raise DamagedError("over limit", detail)
            data = chunk_contents(record, self._limits.record_bytes)
        except DamagedError as error:
            self._lose_chunk(index.chunk_counts.get(record.offset, {}), where, error)
            return
        self.num_found += 1
        try:
            for inner in records(BytesIO(data), 0, len(data), self._limits.record_bytes, _WANTED):
                self._num_inner += 1
                yield from self._inner(inner, where)
        except DamagedError as error:
            self.lose("damaged record", where, detail=error.detail)

    def _cut_chunk(self, file: BinaryIO, offset: int, end: int) -> Iterator[RawMessage]:
        """What is whole within the last chunk of a bag that was cut off."""
        start = inside_cut_chunk(file, offset, end)
        with suppress(DamagedError):
            for inner in () if start is None else records(file, start, end, self._limits.record_bytes, _WANTED):
                yield from self._inner(inner, f"chunk at byte {offset}")

    def _inner(self, record: BagRecord, where: str) -> Iterator[RawMessage]:
        if record.op == CONNECTION:
            self._connect(record)
        elif record.op == MESSAGE:
            self.num_found += 1
            connection = number(record.fields, b"conn", 4)
            if connection not in self._wanted:
                self._orphans[connection] += 1
                return
            channel = self._wanted[connection]
            self._counted[connection] += 1
            if channel is None:
                return
            if record.length > self._limits.record_bytes:
                detail = f"it has {record.length} bytes, the limit is {self._limits.record_bytes}"
                self.lose("over limit", where, channel.topic, 1, detail)
                return
            stamp_ns = time_ns(record.fields)
            yield RawMessage(channel, stamp_ns, stamp_ns, record.data)

    def _connect(self, record: BagRecord) -> None:
        """Takes note of a connection, whose record stands in every chunk that has messages of it."""
        try:
            connection = number(record.fields, b"conn", 4)
            if connection in self._wanted:
                return
            self.num_found += 1
            channel = self._channel(connection, record)
        except (DamagedError, UnicodeDecodeError) as error:
            kind = "over limit" if getattr(error, "kind", "") == "over limit" else "damaged definition"
            self.lose(kind, f"byte {record.offset}", detail=str(error))
            return
        self._topics[connection] = channel.topic
        self._wanted[connection] = channel if self._keep(channel) else None

    def _channel(self, connection: int, record: BagRecord) -> Channel:
        """The same object for the same connection in every pass."""
        fields = connection_fields(record)
        topic, name = record.fields.get(b"topic", b"").decode(), fields.get(b"type", b"").decode()
        definition = fields.get(b"message_definition", b"")
        key = (connection, topic, name, definition)
        if key not in self._channels:
            longest = max(len(topic), len(name))
            if longest > self._limits.name_characters or len(definition) > MAX_DEFINITION_BYTES:
                raise DamagedError("over limit", "its names or its definition are too long")
            if len(self._channels) >= self._limits.definitions:
                raise DamagedError("over limit", f"more than {self._limits.definitions} connections")
            metadata = {"md5sum": fields.get(b"md5sum", b"").decode()}
            metadata["latching"] = "1" if fields.get(b"latching") == b"1" else "0"
            three_parts = three_part_name(name, {"ros1"})
            self._channels[key] = Channel(topic, three_parts, "ros1msg", definition, "ros1", metadata)
        return self._channels[key]

    def _lose_chunk(self, counts: Mapping[int, int], where: str, error: DamagedError) -> None:
        """Notes a chunk that is lost; where the index tells what was in it, by topic."""
        if not counts:
            self.lose(error.kind, where, detail=error.detail)
        for connection, count in counts.items():
            self._counted[connection] += count
            if connection not in self._wanted or self._wanted[connection] is not None:
                self.lose(error.kind, where, self._topics.get(connection, ""), count, error.detail)

    def _finish(self, index: BagIndex, size: int) -> None:
        """What only the end can tell."""
        if not self.num_found and (not index.offset or index.offset > size or self.losses):
            raise self._nothing("no message and no connection is left of it")
        if not index.offset:
            self.lose("truncated", "end of the file", detail="it was never closed: what came last is missing")
        elif index.offset > size and not self.losses:
            self.lose("truncated", f"byte {size}", detail="the file ends before its index")
        for connection, count in sorted(self._orphans.items()):
            self.lose("definition lost", f"connection {connection}", "", count, "its connection record is missing")
        if not index.is_whole:
            return
        expected: Counter[int] = Counter()
        for counts in index.chunk_counts.values():
            expected.update(counts)
        for connection, count in sorted(expected.items()):
            missing = count - self._counted[connection] - self._orphans[connection]
            is_wanted = connection not in self._wanted or self._wanted[connection] is not None
            if missing and is_wanted:
                kind = "missing messages" if missing > 0 else "extra messages"
                detail = f"the bag's own index counts {count}"
                self.lose(kind, "whole file", self._topics.get(connection, ""), max(missing, 0), detail)

    def _nothing(self, detail: str) -> LogReadError:
        return read_error(self._path, f"is damaged or was cut off: {detail}", "Nothing can be read from it.")
