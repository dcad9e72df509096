"""Small recordings made to take the machine, and what reading one costs."""

from __future__ import annotations

import struct
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import zstandard
from mcap.opcode import Opcode

from mapfusion_io.mcap_records import MAGIC

MEASURED = """
import sys, time
from mapfusion_io.mission import open_recording
from mapfusion.errors import LogReadError
import mapfusion_io.rosbag_reader, mapfusion_io.definitions
start = time.process_time()
try: words = str(open_recording([sys.argv[1]]).losses)
except LogReadError as error: words = str(error)
elapsed_s = time.process_time() - start
peak = [line.split()[1] for line in open('/proc/self/status') if line.startswith('VmHWM')]
print(elapsed_s, int(peak[0]) / 1024, words)
"""

MOST_S, MOST_MIB = 1.0, 300.0


class Cost(NamedTuple):
    """What opening a recording takes."""

    cpu_s: float
    peak_mib: float
    words: str
    """The losses, or the error."""


def record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def chunk(data: bytes, size: int, compression: bytes = b"zstd") -> bytes:
    head = struct.pack("<QQQII", 0, 0, size, 0, len(compression)) + compression
    return record(Opcode.CHUNK, head + struct.pack("<Q", len(data)) + data)


def zeroes(size: int) -> bytes:
    return zstandard.ZstdCompressor().compress(bytes(size))


FIRST = MAGIC + record(Opcode.HEADER, struct.pack("<II", 0, 0))
END = record(Opcode.DATA_END, bytes(4)) + record(Opcode.FOOTER, bytes(20)) + MAGIC
BOMBS = {
    "a zstd bomb": FIRST + chunk(zeroes(2**30), 2**30) + END,
    "a lying zstd bomb": FIRST + chunk(zeroes(2**28), 1000) + END,
    "a length of 2^62": FIRST + struct.pack("<BQ", Opcode.CHUNK, 2**62) + bytes(1000),
    "a size of 2^62": FIRST + chunk(b"x", 2**62) + END,
    "records of length 0": FIRST + record(0x80, b"") * 500_000 + END,
    "records of length 0 in a chunk": FIRST + chunk(record(0x80, b"") * 500_000, 9 * 500_000, b"") + END,
    "a bag's length of 2^32": b"#ROSBAG V2.0\n" + struct.pack("<I", 2**32 - 1) + bytes(1000),
}


def cost(recording: Path) -> Cost:
    """Opens a recording in a process of its own; Linux only."""
    ran = subprocess.run(
        [sys.executable, "-c", MEASURED, recording], capture_output=True, text=True, check=True, timeout=300
    )
    cpu_s, peak_mib, words = ran.stdout.split(maxsplit=2)
    return Cost(float(cpu_s), float(peak_mib), words)
