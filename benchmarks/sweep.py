"""Damaged recordings by the ten thousand, through the reader and through the command line.

Run: python benchmarks/sweep.py [--quick]

The full form of what tests/reliability shows on less: every layout of MCAP and every container, cut at every byte (or
near its borders), bits turned, blocks lost. Ends with 1 where a case ends otherwise than all there, salvaged with
losses counted, or with one clean error.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from io import BytesIO
from itertools import chain, islice
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the tests' own makers of recordings

from mcap.writer import CompressionType
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import StoragePlugin

from mapfusion_io.mcap_records import MAGIC, records_from
from mapfusion_io.read_limits import ReadLimits
from mapfusion_io.sniff import open_one
from tests.io.making import (
    Sent,
    delivered,
    mcap_bytes,
    mission_messages,
    ros1_grid,
    small_cells,
    write_rosbag1,
    write_rosbag2,
)
from tests.reliability.missions import mission
from tests.reliability.running import command, complaint_about
from tests.reliability.sweeping import Message, cuts, flips, smears, sweep

LAYOUTS: dict[str, dict[str, Any]] = {
    "zstd": {},
    "lz4": {"compression": CompressionType.LZ4},
    "not compressed": {"compression": CompressionType.NONE},
    "no chunks, data checksum": {"use_chunking": False, "enable_data_crcs": True},
    "no chunks, no checksum": {"use_chunking": False, "enable_crcs": False},
    "no checksums": {"enable_crcs": False},
}


def record_borders(content: bytes) -> list[int]:
    """Where the records of an MCAP file start."""
    file = BytesIO(content)
    return [record.offset for record in records_from(file, len(MAGIC), len(content), ReadLimits(), frozenset())]


def sweep_container(
    name: str, content: bytes, messages: list[Message], path: Path, size: int, signed: bool, borders: Sequence[int] = ()
) -> int:
    """Prints what came of every kind of damage and returns the number of failures."""
    failures = 0
    for kind, cases in (
        ("cut", cuts(content, borders, 1)),
        ("bits", flips(content, size, 2)),
        ("blocks", smears(content, size // 4, 3)),
    ):
        began_s = time.perf_counter()
        outcomes = sweep(cases, path, messages, is_signed=signed)
        print(f"{name:26} {kind:7} {time.perf_counter() - began_s:6.1f} s  {outcomes}", flush=True)
        for failure in outcomes.failures[:5]:
            print(f"    {failure}")
        failures += len(outcomes.failures)
    return failures


def sweep_command(count: int, folder: Path) -> int:
    """The same through `mapfusion replay`."""
    content = mcap_bytes(mission(2), chunk_size=2000)
    recording, output = folder / "run.mcap", folder / "out" / "fused.mcap"
    output.parent.mkdir()
    step = max(3 * len(content) // count, 1)
    cases = chain(
        islice(cuts(content, [], 1), 0, None, step), flips(content, count // 3, 5), smears(content, count // 3, 6)
    )
    codes: Counter[int] = Counter()
    failures = 0
    began_s = time.perf_counter()
    for number, damaged in enumerate(cases):
        recording.write_bytes(damaged)
        output.unlink(missing_ok=True)
        ran = command("replay", recording, output, "--profile", "paper", "--final-only", "--json")
        codes[ran.code] += 1
        if complaint := complaint_about(ran, output):
            print(f"    case {number}: {complaint}")
            failures += 1
    exits = ", ".join(f"{count} with exit {code}" for code, count in sorted(codes.items()))
    print(f"command line: {codes.total()} cases in {time.perf_counter() - began_s:.1f} s: {exits}; {failures} failures")
    return failures


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a tenth of the cases")
    size = 500 if parser.parse_args().quick else 5000
    failures = 0
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for name, options in LAYOUTS.items():
            messages = mission_messages(80)
            content = mcap_bytes(messages, **options)
            signed = options.get("enable_crcs", True)
            borders = record_borders(content)
            failures += sweep_container(
                f"MCAP, {name}", content, list(messages), folder / "x.mcap", size, signed, borders
            )
        grids = [
            Sent(f"/robot{index % 2}/map", "nav_msgs/msg/OccupancyGrid", 10**9 * index, ros1_grid(small_cells(index)))
            for index in range(40)
        ]
        for compression in (None, Rosbag1Writer.CompressionFormat.LZ4, Rosbag1Writer.CompressionFormat.BZ2):
            bag = folder / f"{compression}.bag"
            write_rosbag1(bag, grids, compression, chunk_bytes=1000)
            whole = delivered(open_one(bag))
            name = f"bag, {compression.name.lower() if compression else 'not compressed'}"
            failures += sweep_container(name, bag.read_bytes(), whole, folder / "x.bag", size // 2, False)
        write_rosbag2(folder / "run", mission_messages(80), StoragePlugin.SQLITE3)
        database = next((folder / "run").glob("*.db3"))
        whole = delivered(open_one(database))
        content = database.read_bytes()
        pages = range(0, len(content), 4096)
        failures += sweep_container("db3", content, whole, folder / "x.db3", size // 2, False, pages)
        failures += sweep_command(size // 5, folder)
    return 1 if failures else 0


if __name__ == "__main__":
    raise SystemExit(main())
