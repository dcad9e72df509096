"""One pass over the messages of an MCAP file: what is intact is delivered, what is damaged is passed over and named."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import Channel as ChannelRecord
from mcap.records import Schema as SchemaRecord

from mapfusion_io.interfaces import Channel, Loss, RawMessage
from mapfusion_io.mcap_channels import ChannelTable
from mapfusion_io.mcap_chunks import chunk_contents
from mapfusion_io.mcap_records import (
    MAGIC,
    MESSAGE_HEAD,
    MESSAGE_RECORDS,
    DamagedError,
    Record,
    data_crc,
    framed,
    indexed_counts,
    parse,
    records_from,
)
from mapfusion_io.mcap_summary import Summary, read_summary
from mapfusion_io.read_errors import read_error
from mapfusion_io.read_limits import ReadLimits

_CHANNEL, _MESSAGE, _SCHEMA = int(Opcode.CHANNEL), int(Opcode.MESSAGE), int(Opcode.SCHEMA)
_CHUNK, _DATA_END, _INDEX = int(Opcode.CHUNK), int(Opcode.DATA_END), int(Opcode.MESSAGE_INDEX)


class McapPass:
    """One pass over the messages: definitions so far, what was delivered, what was lost."""

    def __init__(self, path: Path, limits: ReadLimits, channels: ChannelTable) -> None:
        self._path = path
        self._limits = limits
        self._channels = channels
        self._summary = Summary({}, {})
        self._counted: Counter[int] = Counter()
        self._orphans: Counter[int] = Counter()
        self._num_unsigned = 0
        self._num_inner = 0
        self._named: set[int] = set()
        self.losses: list[Loss] = []
        self.num_records = 0
        self.verified = True

    def messages(self, file: BinaryIO) -> Iterator[RawMessage]:
        """The whole pass."""
        size = file.seek(0, 2)
        self._summary = read_summary(file, size, self._limits)
        self._channels.set_summary(self._summary)
        self.verified = self._summary.is_whole
        for record in self._records(file, size):
            if record.opcode == _CHUNK:
                yield from self._chunk(file, record)
            elif record.opcode == _MESSAGE:
                yield from self._message(record)
            elif record.opcode in (_SCHEMA, _CHANNEL):
                self._define_or_lose(record.opcode, record.body, f"byte {record.offset}")
        self._finish(file)

    def lose(self, kind: str, where: str, topic: str = "", count: int | None = None, detail: str = "") -> None:
        """Notes a loss; those over the limit of losses share the last entry."""
        loss = Loss(self._path.name, kind, where, topic, count, detail)
        if len(self.losses) > self._limits.losses:
            total = (self.losses.pop().count or 0) + (count or 0)
            loss = Loss(self._path.name, "further losses", f"up to {where}", "", total, "too many to name each")
        self.losses.append(loss)

    def _records(self, file: BinaryIO, size: int) -> Iterator[Record]:
        """Every record that can be found: behind damage the walk goes on at the next chunk that the summary knows."""
        offset, data_ended = len(MAGIC), False
        starts = list(self._summary.chunk_ends)
        while True:
            try:
                for record in records_from(file, offset, size, self._limits, MESSAGE_RECORDS):
                    self.num_records += 1
                    offset = record.end
                    if record.opcode == _DATA_END and record.length == 4:
                        data_ended = True
                    elif record.opcode in (_CHUNK, _MESSAGE, _INDEX):
                        data_ended = False
                    elif data_ended:
                        continue  # a part of the summary
                    yield record
                    if record.offset == self._summary.data_end:
                        return
                return
            except DamagedError as error:
                if data_ended:
                    return  # only the index behind the data is damaged or cut off
                self._named.add(offset)
                later = bisect_right(starts, offset)
                resume = starts[later] if later < len(starts) else None
                if resume is None and not self.num_records:
                    raise read_error(
                        self._path, f"is no whole MCAP file: {error.detail}", "It was cut off or overwritten."
                    ) from error
                kind = "damaged record" if resume is not None else error.kind
                where = f"byte {offset}" if resume is None else f"bytes {offset} to {resume}"
                self.lose(kind, where, detail=error.detail)
                if resume is None:
                    return
                offset = resume

    def _chunk(self, file: BinaryIO, record: Record) -> Iterator[RawMessage]:
        where = f"chunk at byte {record.offset}"
        self._named.add(record.offset)
        try:
            if record.length > self._limits.record_bytes:
                raise DamagedError("over limit", self._over_bytes(record))
            if self._num_inner > self._limits.chunked_records:
                detail = f"the chunks before it hold more than {self._limits.chunked_records} records"
                raise DamagedError("over limit", detail)
            data, signed = chunk_contents(record.body, self._limits)
        except DamagedError as error:
            self._lose_chunk(indexed_counts(file, record.end), where, error)
            return
        wanted, counted, unpack = self._channels.wanted, self._counted, MESSAGE_HEAD.unpack_from
        num_before = counted.total()
        try:
            for opcode, start, end in framed(data, self._limits.idle_records):
                self._num_inner += 1
                if opcode == _MESSAGE:
                    if end - start < MESSAGE_HEAD.size:
                        self.lose("malformed record", where, detail="a message without its head")
                        continue
                    channel_id, _, log_time_ns, publish_time_ns = unpack(data, start)
                    channel = wanted[channel_id] if channel_id in wanted else self._wanted_late(channel_id)
                    if channel is not None:
                        counted[channel_id] += 1
                        yield RawMessage(channel, log_time_ns, publish_time_ns, data[start + MESSAGE_HEAD.size : end])
                elif opcode in (_CHANNEL, _SCHEMA):
                    self._define_or_lose(opcode, data[start:end], where)
        except DamagedError as error:
            self.lose(error.kind, where, detail=error.detail)
        if not signed:
            self._num_unsigned += counted.total() - num_before

    def _message(self, record: Record) -> Iterator[RawMessage]:
        """A message outside of any chunk."""
        where = f"byte {record.offset}"
        if record.length > self._limits.record_bytes:
            self.lose("over limit", where, count=1, detail=self._over_bytes(record))
            return
        if record.length < MESSAGE_HEAD.size:
            self.lose("malformed record", where, count=1, detail="a message without its head")
            return
        channel_id, _, log_time_ns, publish_time_ns = MESSAGE_HEAD.unpack_from(record.body)
        wanted = self._channels.wanted
        channel = wanted[channel_id] if channel_id in wanted else self._wanted_late(channel_id)
        if channel is not None:
            self._num_unsigned += 1
            self._counted[channel_id] += 1
            yield RawMessage(channel, log_time_ns, publish_time_ns, record.body[MESSAGE_HEAD.size :])

    def _over_bytes(self, record: Record) -> str:
        return f"it has {record.length} bytes, the limit is {self._limits.record_bytes}"

    def _define_or_lose(self, opcode: int, body: bytes, where: str) -> None:
        try:
            if opcode == _SCHEMA:
                self._channels.add_schema(parse(SchemaRecord.read, body))
            else:
                self._channels.add_channel(parse(ChannelRecord.read, body))
        except DamagedError as error:
            self.lose("damaged definition", where, detail=error.detail)

    def _wanted_late(self, channel_id: int) -> Channel | None:
        """A wanted channel that the data did not define before its message; without a definition it is an orphan."""
        if self._channels.find(channel_id) is None:
            self._orphans[channel_id] += 1
        return self._channels.wanted.get(channel_id)

    def _lose_chunk(self, counts: Mapping[int, int], where: str, error: DamagedError) -> None:
        """Notes a chunk that is lost; where its message indexes tell what was in it, by topic."""
        if not counts:
            self.lose(error.kind, where, detail=error.detail)
        for channel_id, count in counts.items():
            channel = self._channels.find(channel_id)
            if channel is not None and self._channels.wanted[channel_id] is None:
                continue
            self._counted[channel_id] += count
            self.lose(error.kind, where, "" if channel is None else channel.topic, count, error.detail)

    def _finish(self, file: BinaryIO) -> None:
        """What only the end can tell: orphans, messages missing without a trace, the data's checksum."""
        self._channels.find_rest()
        if self._channels.num_refused:
            detail = f"{self._channels.num_refused} definitions of topics or types are too many or too large"
            self.lose("over limit", "whole file", detail=detail)
        for start, end in self._summary.chunk_ends.items():
            if start not in self._named:
                error = DamagedError("missing chunk", "there is none where the file's own index has one")
                self._lose_chunk(indexed_counts(file, end), f"chunk at byte {start}", error)
        counts = self._summary.message_counts
        for channel_id, count in sorted(self._orphans.items()):
            if (
                counts is None or channel_id in counts
            ):  # else the id is damaged: a message of another channel is missing
                detail = "its channel or schema record is missing"
                self.lose("definition lost", f"channel {channel_id}", "", count, detail)
        for channel_id, expected in sorted((counts or {}).items()):
            self._compare(channel_id, expected)
        num_expected, num_found = self._summary.num_messages, self._counted.total() + self._orphans.total()
        if counts is None and num_expected is not None and num_found < num_expected and self._channels.are_all_wanted:
            detail = f"the file's own statistics count {num_expected}"
            self.lose("missing messages", "whole file", count=num_expected - num_found, detail=detail)
        if self._num_unsigned:
            self._check_unsigned(file)

    def _compare(self, channel_id: int, expected: int) -> None:
        """Compares what is accounted for with the file's own statistics."""
        channel = self._channels.find(channel_id)
        missing = expected - self._counted[channel_id] - self._orphans[channel_id]
        if missing == 0 or (channel is not None and self._channels.wanted[channel_id] is None):
            return
        topic = "" if channel is None else channel.topic
        detail = f"the file's own statistics count {expected}"
        if missing > 0:
            self.lose("missing messages", "whole file", topic, missing, detail)
        else:
            self.lose("extra messages", "whole file", topic, 0, f"{-missing} too many: {detail}")

    def _check_unsigned(self, file: BinaryIO) -> None:
        """Messages that no chunk's checksum vouches for: the data section's may."""
        if not self._summary.data_crc:
            self.verified = False
        elif data_crc(file, self._summary.data_end) != self._summary.data_crc:
            detail = "the checksum of the data section does not match; the messages were delivered as they stand"
            self.lose("data crc", "whole file", detail=detail)
