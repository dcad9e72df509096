"""Small recordings made to take the machine: each is refused in under a second of CPU time and 300 MiB.

Run: python benchmarks/bombs.py [--runs 5]
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the tests' own makers of recordings

from tests.reliability.bombs import BOMBS, MOST_MIB, MOST_S, cost


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=5)
    num_runs = parser.parse_args().runs
    is_over = False
    print(f"{'':32s}{'s':>8s}{'MiB':>8s}   (medians of {num_runs})")
    with tempfile.TemporaryDirectory() as scratch:
        recording = Path(scratch) / "run.mcap"
        for name, content in BOMBS.items():
            recording.write_bytes(content)
            costs = [cost(recording) for _ in range(num_runs)]
            cpu_s = statistics.median(found.cpu_s for found in costs)
            peak_mib = statistics.median(found.peak_mib for found in costs)
            is_over |= cpu_s >= MOST_S or peak_mib >= MOST_MIB
            print(f"{name:32s}{cpu_s:8.3f}{peak_mib:8.0f}")
    return 1 if is_over else 0


if __name__ == "__main__":
    raise SystemExit(main())
