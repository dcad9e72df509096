"""The records of a ROS 1 bag, framed and bounded: nothing in the file decides how much memory or time it takes.

Source: the bag format 2.0, http://wiki.ros.org/Bags/Format/2.0
"""

from __future__ import annotations

import bz2
import struct
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import BinaryIO, NamedTuple

import lz4.frame

from mapfusion_io.mcap_records import DamagedError
from mapfusion_io.read_errors import words

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7
"""Values of the field `op`, which says what a record is."""

_MAX_HEAD_BYTES = 2**20
_LENGTH = struct.Struct("<I")
_TIME = struct.Struct("<II")
_COUNT = struct.Struct("<II")


class BagRecord(NamedTuple):
    """A record; `data` is empty where the reader did not ask for it or where it is over the limit."""

    offset: int
    fields: Mapping[bytes, bytes]
    length: int
    data: bytes
    end: int

    @property
    def op(self) -> int:
        """What it is."""
        return number(self.fields, b"op", 1)


@dataclass(frozen=True, slots=True)
class BagIndex:
    """What the end of a bag says about the rest.

    Attributes:
        offset: Where it starts; 0 for a bag that was never closed.
        connections: Connection records.
        chunk_counts: Number of messages by connection, by offset of the chunk they are in.
        is_whole: Whether it holds as many chunks and connections as the bag's header says.
    """

    offset: int
    connections: tuple[BagRecord, ...] = ()
    chunk_counts: Mapping[int, Mapping[int, int]] = field(default_factory=dict)
    is_whole: bool = False


def records(file: BinaryIO, offset: int, end: int, max_bytes: int, ops: frozenset[int]) -> Iterator[BagRecord]:
    """Records from `offset` to `end`.

    Args:
        file: The bag, or the records of a chunk.
        offset: Where the first record starts.
        end: Where the last one ends.
        max_bytes: Records with more data come without it.
        ops: What data are wanted of.

    Raises:
        DamagedError: From here on no record can be found; `truncated` where the file merely ends.
    """
    while offset < end:
        file.seek(offset)
        head = file.read(_read_length(file, end - offset - 8, _MAX_HEAD_BYTES))
        fields = _fields(head)
        length = _read_length(file, end - offset - len(head) - 8, end)
        is_read = number(fields, b"op", 1) in ops and length <= max_bytes
        data = file.read(length) if is_read else b""
        if is_read and len(data) != length:
            raise DamagedError("truncated", "the file ends within a record")
        record = BagRecord(offset, fields, length, data, offset + len(head) + 8 + length)
        yield record
        offset = record.end


def inside_cut_chunk(file: BinaryIO, offset: int, end: int) -> int | None:
    """Where the records start within an uncompressed chunk at `offset` that the end of the file cuts off; else None."""
    file.seek(offset)
    try:
        head = file.read(_read_length(file, end - offset - 8, _MAX_HEAD_BYTES))
        fields = _fields(head)
        is_plain = number(fields, b"op", 1) == CHUNK and fields.get(b"compression") == b"none"
    except DamagedError:
        return None
    return offset + len(head) + 8 if is_plain else None


def number(fields: Mapping[bytes, bytes], name: bytes, num_bytes: int) -> int:
    """An unsigned field.

    Raises:
        DamagedError: It is missing, or of another size.
    """
    value = fields.get(name, b"")
    if len(value) != num_bytes:
        raise DamagedError("damaged record", f"a record without its field {name.decode()!r}")
    return int.from_bytes(value, "little")


def time_ns(fields: Mapping[bytes, bytes]) -> int:
    """When a message was recorded.

    Raises:
        DamagedError: It does not say.
    """
    number(fields, b"time", 8)
    sec, nanosec = _TIME.unpack(fields[b"time"])
    return int(sec) * 1_000_000_000 + int(nanosec)


def connection_fields(record: BagRecord) -> dict[bytes, bytes]:
    """Type, definition and more of a connection, which are its data.

    Raises:
        DamagedError: They cannot be parsed.
    """
    return _fields(record.data)


def chunk_contents(record: BagRecord, max_bytes: int) -> bytes:
    """The records inside a chunk. Sizes are compared before anything is decompressed.

    Raises:
        DamagedError: The chunk cannot be believed, is compressed in an unknown way, or is over the limit.
    """
    size = number(record.fields, b"size", 4)
    if max(size, record.length) > max_bytes:
        raise DamagedError("over limit", f"it would take {max(size, record.length)} bytes, the limit is {max_bytes}")
    compression = record.fields.get(b"compression", b"")
    try:
        if compression == b"none":
            data = record.data
        elif compression == b"bz2":
            data = bz2.BZ2Decompressor().decompress(record.data, max_length=size + 1)
        elif compression == b"lz4":
            data = lz4.frame.LZ4FrameDecompressor().decompress(record.data, max_length=size + 1)
        else:
            raise DamagedError("unknown compression", f"compression {compression[:20]!r}: only bz2 and lz4 are known")
    except (OSError, RuntimeError, ValueError, EOFError, MemoryError) as error:
        raise DamagedError("damaged chunk", f"it cannot be decompressed ({words(error)})") from error
    if len(data) != size:
        raise DamagedError("damaged chunk", f"it holds {len(data)} bytes instead of {size}")
    return data


def read_index(file: BinaryIO, header: BagRecord, size: int) -> BagIndex:
    """The end of the bag, as far as it can be believed.

    Raises:
        DamagedError: The bag's header cannot be.
    """
    offset = number(header.fields, b"index_pos", 8)
    expected = number(header.fields, b"conn_count", 4), number(header.fields, b"chunk_count", 4)
    if not header.end <= offset <= size:
        return BagIndex(0 if offset < header.end else offset)
    connections: list[BagRecord] = []
    chunk_counts: dict[int, Mapping[int, int]] = {}
    try:
        for record in records(file, offset, size, size, frozenset({CONNECTION, CHUNK_INFO})):
            if record.op == CONNECTION:
                connections.append(record)
            elif record.op == CHUNK_INFO:
                counts: Counter[int] = Counter()
                for connection, count in _COUNT.iter_unpack(record.data[: record.length // 8 * 8]):
                    counts[connection] += count
                chunk_counts[number(record.fields, b"chunk_pos", 8)] = counts
    except DamagedError:
        return BagIndex(offset, tuple(connections), chunk_counts)
    return BagIndex(offset, tuple(connections), chunk_counts, expected == (len(connections), len(chunk_counts)))


def _read_length(file: BinaryIO, left: int, limit: int) -> int:
    found = file.read(_LENGTH.size)
    if len(found) < _LENGTH.size:
        raise DamagedError("truncated", "the file ends within a record")
    length: int = _LENGTH.unpack(found)[0]
    if length > left:
        raise DamagedError("truncated", f"a record of {length} bytes reaches beyond the end")
    if length > limit:
        raise DamagedError("damaged record", f"a record's head of {length} bytes")
    return length


def _fields(head: bytes) -> dict[bytes, bytes]:
    fields: dict[bytes, bytes] = {}
    position = 0
    while position < len(head):
        if len(head) - position < _LENGTH.size:
            raise DamagedError("damaged record", "its fields do not fit into it")
        (length,) = _LENGTH.unpack_from(head, position)
        start = position + _LENGTH.size
        position = start + length
        name, equals, value = head[start:position].partition(b"=")
        if position > len(head) or not equals:
            raise DamagedError("damaged record", "its fields do not fit into it")
        fields[name] = value
    return fields
