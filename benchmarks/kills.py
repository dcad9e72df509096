"""Random kills during a replay: the file under the output's name is always whole.

Run: python benchmarks/kills.py [--kills 200]
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the tests' own makers of recordings

from tests.io.making import mcap_bytes
from tests.reliability.killing import complaints
from tests.reliability.missions import mission


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=200)
    kills = parser.parse_args().kills
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        recording = folder / "run.mcap"
        recording.write_bytes(mcap_bytes(mission(8)))
        wrong, num_killed = complaints(recording, folder, kills, seed=1)
    print(f"{kills} signals, {num_killed} runs killed before their end, {len(wrong)} complaints")
    for complaint in wrong:
        print(f"    {complaint}")
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
