"""The summary at the end of an MCAP file: believed where its checksum holds, done without where it does not."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Footer, Schema, Statistics

from mapfusion_io.mcap_records import HEAD, MAGIC, DamagedError, framed, parse
from mapfusion_io.read_limits import ReadLimits


@dataclass(frozen=True, slots=True)
class Summary:
    """What the end of the file says about the rest. All empty where there is no summary that can be believed.

    Attributes:
        schemas: By id.
        channels: By id.
        chunk_ends: Where each chunk ends, by where it starts, ascending.
        message_counts: Number of messages by channel id, None where it holds no statistics, or such that do not add up.
        num_messages: Number of all messages, None where it holds no statistics.
        data_crc: CRC of everything before the DataEnd record, 0 where there is none.
        data_end: Offset of the DataEnd record, 0 where it is not known.
        is_whole: Whether the end of the file is as it was written; where it is not, nothing tells what is missing.
    """

    schemas: dict[int, Schema]
    channels: dict[int, Channel]
    chunk_ends: Mapping[int, int] = field(default_factory=dict)
    message_counts: dict[int, int] | None = None
    num_messages: int | None = None
    data_crc: int = 0
    data_end: int = 0
    is_whole: bool = False


def read_summary(file: BinaryIO, size: int, limits: ReadLimits) -> Summary:
    """The summary at the end of the file; an empty one where it is missing or damaged."""
    summary = Summary({}, {})
    footer_offset = size - len(MAGIC) - 20 - HEAD.size
    if footer_offset < len(MAGIC):
        return summary
    file.seek(footer_offset)
    tail = file.read()
    if tail[: HEAD.size] != HEAD.pack(Opcode.FOOTER, 20) or not tail.endswith(MAGIC):
        return summary
    footer = parse(Footer.read, tail[HEAD.size : HEAD.size + 20])
    start = footer.summary_start or footer_offset
    if not len(MAGIC) <= start <= footer_offset or footer_offset - start > limits.record_bytes:
        return summary
    file.seek(start)
    section = file.read(footer_offset - start)
    if footer.summary_crc and zlib.crc32(section + tail[: HEAD.size + 16]) != footer.summary_crc:
        return summary
    data_end = start - HEAD.size - 4
    if data_end >= len(MAGIC):
        file.seek(data_end)
        data_end_record = file.read(HEAD.size + 4)
        if data_end_record[: HEAD.size] == HEAD.pack(Opcode.DATA_END, 4):
            summary = Summary(
                {}, {}, data_crc=int.from_bytes(data_end_record[HEAD.size :], "little"), data_end=data_end
            )
    try:
        return _parsed_summary(section, summary)
    except DamagedError:
        return summary


def _parsed_summary(section: bytes, found: Summary) -> Summary:
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    chunk_ends: dict[int, int] = {}
    statistics: Statistics | None = None
    for opcode, start, end in framed(section, max_idle=len(section)):
        body = section[start:end]
        if opcode == Opcode.SCHEMA:
            schema = parse(Schema.read, body)
            schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = parse(Channel.read, body)
            channels[channel.id] = channel
        elif opcode == Opcode.CHUNK_INDEX:
            index = parse(ChunkIndex.read, body)
            chunk_ends[index.chunk_start_offset] = index.chunk_start_offset + index.chunk_length
        elif opcode == Opcode.STATISTICS:
            statistics = parse(Statistics.read, body)
    counts = statistics.channel_message_counts if statistics is not None else None
    num_messages = statistics.message_count if statistics is not None else None
    return Summary(
        schemas,
        channels,
        dict(sorted(chunk_ends.items())),
        counts if counts is not None and sum(counts.values()) == num_messages else None,
        num_messages,
        found.data_crc,
        found.data_end,
        is_whole=True,
    )
