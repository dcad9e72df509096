"""Thousands of replays of damaged recordings in one process: its memory stays flat.

Run: python benchmarks/soak.py [--minutes 20]

Prints the resident memory every minute. Ends with 1 where a replay ends otherwise than it may, or where the
most memory of the last fifth of the time lies more than a twentieth above that of the second fifth. Linux only.
"""

from __future__ import annotations

import argparse
import gc
import os
import random
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the tests' own makers of recordings

from tests.io.making import mcap_bytes
from tests.reliability.missions import mission
from tests.reliability.running import command, complaint_about
from tests.reliability.sweeping import flips, smears

GROWTH = 1.05


def resident_mib() -> float:
    """Memory of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=20.0)
    lasts_s = 60.0 * parser.parse_args().minutes
    chosen = random.Random(0)
    contents = [mcap_bytes(mission(seconds), chunk_size=2000) for seconds in (1, 2, 4)]
    codes: Counter[int] = Counter()
    samples: list[tuple[float, float]] = []
    failures = 0
    began_s, told_s = time.monotonic(), 0.0
    with tempfile.TemporaryDirectory() as scratch:
        recording, output = Path(scratch) / "run.mcap", Path(scratch) / "out" / "fused.mcap"
        output.parent.mkdir()
        while (elapsed_s := time.monotonic() - began_s) < lasts_s:
            damage = chosen.choice((flips, smears))
            recording.write_bytes(next(damage(chosen.choice(contents), 1, chosen.getrandbits(32))))
            output.unlink(missing_ok=True)
            options = chosen.choice((("--profile", "paper"), ("--include-inputs",), ("--final-only",), ("--jobs", "2")))
            ran = command("replay", recording, output, "--json", *options)
            codes[ran.code] += 1
            if complaint := complaint_about(ran, output):
                print(f"    {complaint}")
                failures += 1
            if codes.total() % 20 == 0:
                gc.collect()
                samples.append((elapsed_s, resident_mib()))
            if elapsed_s - told_s >= 60.0:
                told_s = elapsed_s
                print(f"{elapsed_s:6.0f} s  {codes.total():6} replays  {resident_mib():7.1f} MiB", flush=True)
    early = [mib for elapsed_s, mib in samples if 0.2 * lasts_s <= elapsed_s < 0.4 * lasts_s]
    late = [mib for elapsed_s, mib in samples if elapsed_s >= 0.8 * lasts_s]
    exits = ", ".join(f"{count} with exit {code}" for code, count in sorted(codes.items()))
    print(f"{codes.total()} replays: {exits}; {failures} failures")
    if not early or not late:
        print("too short to judge its memory")
        return 1 if failures else 0
    print(f"memory: at most {max(early):.1f} MiB in the second fifth, {max(late):.1f} MiB in the last one")
    return 1 if failures or max(late) > GROWTH * max(early) else 0


if __name__ == "__main__":
    raise SystemExit(main())
