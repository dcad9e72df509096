"""The records of an MCAP file, framed and bounded: nothing in the file decides how much memory or time it takes.

The parsers of single records are the `mcap` package's. Its `StreamReader` is not used: it believes every length inside
a record (one flipped bit in a message index can make it collect the rest of the file), notices a short read only when
nothing at all was read, and decodes message indexes, which a reader in file order has no use for.

Source: the MCAP specification, https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from typing import BinaryIO, NamedTuple, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode

from mapfusion_io.read_errors import words
from mapfusion_io.read_limits import ReadLimits

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
"""Opcode and length, in front of every record."""
MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Channel id, sequence, log time, publish time, in front of a message's data."""

PARSE_ERRORS = (McapError, struct.error, ValueError, KeyError, TypeError, OverflowError, MemoryError)
"""What the `mcap` package raises on damaged records; UnicodeDecodeError is a ValueError."""

MESSAGE_RECORDS = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.CHUNK, Opcode.MESSAGE})
"""Opcodes of what reading messages needs."""

_CHUNK, _FOOTER, _MESSAGE = int(Opcode.CHUNK), int(Opcode.FOOTER), int(Opcode.MESSAGE)
_T = TypeVar("_T")


class DamagedError(Exception):
    """A record or chunk cannot be believed. `kind` is a `Loss.kind`."""

    def __init__(self, kind: str, detail: str) -> None:
        super().__init__(detail)
        self.kind = kind
        self.detail = detail


class Record(NamedTuple):
    """A record at the top level of the file; `body` is empty where the reader did not ask for it."""

    offset: int
    opcode: int
    length: int
    body: bytes

    @property
    def end(self) -> int:
        """Offset of what follows it."""
        return self.offset + HEAD.size + self.length


class _WholeReads(ReadDataStream):
    """A stream over one record in which a short read is an error."""

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) != length:
            raise EndOfFile
        return data


def parse(reader: Callable[[ReadDataStream], _T], body: bytes) -> _T:
    """A record of the `mcap` package from its body.

    Raises:
        DamagedError: The body does not hold such a record.
    """
    try:
        return reader(_WholeReads(BytesIO(body)))
    except PARSE_ERRORS as error:
        raise DamagedError("damaged record", f"it cannot be parsed ({words(error)})") from error


def records_from(
    file: BinaryIO, offset: int, size: int, limits: ReadLimits, wanted: frozenset[Opcode]
) -> Iterator[Record]:
    """Records from `offset` to the footer.

    Args:
        file: The file.
        offset: Where the first record starts.
        size: Length of the file in bytes.
        limits: Records over the limit come without body.
        wanted: Opcodes whose bodies are wanted.

    Raises:
        DamagedError: From here on no record can be found; `truncated` where the file merely ends.
    """
    num_idle = 0
    head_size, unpack = HEAD.size, HEAD.unpack  # a flood of empty records is bounded by their number: each is cheap
    offset = min(offset, size)
    while True:
        file.seek(offset)
        head = file.read(head_size)
        if len(head) < head_size:
            raise DamagedError("truncated", "the file ends without its footer")
        opcode, length = unpack(head)
        if opcode == 0:
            raise DamagedError("damaged record", "no record has opcode 0")
        end = offset + head_size + length
        if end > size:
            raise DamagedError("truncated", f"a record of {length} bytes reaches beyond the end of the file")
        is_read = opcode in wanted and length <= limits.record_bytes
        body = file.read(length) if is_read else b""
        if is_read and len(body) != length:
            raise DamagedError("truncated", "the file ends within a record")
        record = Record(offset, opcode, length, body)
        if opcode == _FOOTER:
            file.seek(end)
            if length == 20 and file.read(len(MAGIC)) == MAGIC:
                yield record
                return
            raise DamagedError("damaged record", "a footer that is not at the end of the file")
        num_idle = 0 if opcode in (_CHUNK, _MESSAGE) else num_idle + 1
        if num_idle > limits.idle_records:
            raise DamagedError("over limit", f"more than {limits.idle_records} records in a row hold no message")
        yield record
        offset = end


def framed(data: bytes, max_idle: int) -> Iterator[tuple[int, int, int]]:
    """Opcode, start and end of the body of each record in a decompressed chunk or in the summary.

    Args:
        data: The records.
        max_idle: Most records in a row that hold no message.

    Raises:
        DamagedError: From here on no record can be found.
    """
    position, size, num_idle = 0, len(data), 0
    unpack = HEAD.unpack_from
    while position < size:
        if size - position < HEAD.size:
            raise DamagedError("damaged record", "it ends within a record")
        opcode, length = unpack(data, position)
        start = position + HEAD.size
        position = start + length
        if position > size or opcode == 0:
            raise DamagedError("damaged record", "its records do not fit into each other")
        if opcode == _MESSAGE:
            num_idle = 0
        else:
            num_idle += 1
            if num_idle > max_idle:
                raise DamagedError("over limit", f"more than {max_idle} records in a row hold no message")
        yield opcode, start, position


def indexed_counts(file: BinaryIO, offset: int) -> dict[int, int]:
    """Number of messages by channel id in a chunk, from the message indexes that follow it at `offset`; maybe none."""
    counts: dict[int, int] = {}
    head = struct.Struct("<BQHI")
    while True:
        file.seek(min(offset, 2**62))  # a chunk's length may be anything
        found = file.read(head.size)
        if len(found) < head.size:
            return counts
        opcode, length, channel_id, entries_bytes = head.unpack(found)
        if opcode != Opcode.MESSAGE_INDEX or channel_id in counts or not entries_bytes + 6 <= length < 2**40:
            return counts
        counts[channel_id] = entries_bytes // 16
        offset += HEAD.size + length


def data_crc(file: BinaryIO, data_end: int) -> int:
    """CRC of the file up to `data_end`, as the DataEnd record means it."""
    crc, left = 0, data_end
    file.seek(0)
    while left and (block := file.read(min(left, 2**20))):
        crc, left = zlib.crc32(block, crc), left - len(block)
    return crc
