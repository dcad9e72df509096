"""What is inside a chunk of an MCAP file, unpacked within bounds and checked."""

from __future__ import annotations

import zlib

import lz4.frame
import zstandard
from mcap.records import Chunk

from mapfusion_io.mcap_records import DamagedError, parse
from mapfusion_io.read_errors import words
from mapfusion_io.read_limits import ReadLimits


def chunk_contents(body: bytes, limits: ReadLimits) -> tuple[bytes, bool]:
    """The records inside a chunk, and whether a checksum vouches for them.

    Sizes are compared before anything is decompressed.

    Raises:
        DamagedError: The chunk cannot be believed, is compressed in an unknown way, or is over the limit.
    """
    chunk = parse(Chunk.read, body)
    size = chunk.uncompressed_size
    if size > limits.record_bytes:
        raise DamagedError("over limit", f"it would take {size} bytes, the limit is {limits.record_bytes}")
    try:
        if chunk.compression == "zstd":
            data = _unzstd(chunk.data, size)
        elif chunk.compression == "lz4":
            data = _unlz4(chunk.data, size)
        elif chunk.compression == "":
            data = chunk.data
        else:
            raise DamagedError(
                "unknown compression", f"compression {chunk.compression[:20]!r}: only zstd and lz4 are known"
            )
    except (zstandard.ZstdError, RuntimeError, ValueError, MemoryError) as error:
        raise DamagedError("damaged chunk", f"it cannot be decompressed ({words(error)})") from error
    if chunk.uncompressed_crc:
        if zlib.crc32(data) != chunk.uncompressed_crc:
            raise DamagedError("chunk crc", "its checksum does not match")
        return data, True
    if len(data) != size:
        raise DamagedError("damaged chunk", f"it holds {len(data)} bytes instead of {size}")
    return data, False


def _unzstd(data: bytes, size: int) -> bytes:
    declared = zstandard.frame_content_size(data)
    if declared not in (-1, size):
        raise DamagedError("damaged chunk", f"its zstd frame holds {declared} bytes instead of {size}")
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=max(size, 1))


def _unlz4(data: bytes, size: int) -> bytes:
    declared = lz4.frame.get_frame_info(data)["content_size"]
    if declared not in (0, size):
        raise DamagedError("damaged chunk", f"its lz4 frame holds {declared} bytes instead of {size}")
    # the frame's own figure does not bound lz4.frame.decompress, which unpacks everything before it compares
    contents: bytes = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    return contents
