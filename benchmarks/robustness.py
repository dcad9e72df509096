"""Recall and false joins on pairs of maps with known truth: as they are, noisy, turned, of another resolution.

    python benchmarks/robustness.py PAIRS... --variants flipped-1 flipped-3 jittered --draws 5
    python benchmarks/robustness.py PAIRS... --variants turned-15 turned-30 turned-45
    python benchmarks/robustness.py PAIRS... --variants coarse-b coarse-both

PAIRS are folders as `fit_verdict.py` reads them.
"""

from __future__ import annotations

import argparse
import math
import zlib
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from damage import flipped, jittered
from fit_verdict import Pair, compare, read_pairs, turned

from mapfusion import fuse_pair
from mapfusion.grid import resample

COARSE_M = 0.1


def varied(pair: Pair, variant: str, draw: int = 0) -> Pair:
    """The pair under a variant; its noise depends on the place and the number of the draw alone."""
    name, _, amount = variant.partition("-")
    place = zlib.crc32(pair.place.encode())
    rng = np.random.default_rng([place, draw] if draw else place)
    a, b = pair.a, pair.b
    if name == "flipped":
        a, b = (flipped(one, float(amount) / 100.0, rng) for one in (a, b))
    elif name == "jittered":
        a, b = (jittered(one, rng) for one in (a, b))
    elif name == "turned":
        b = turned(b, math.radians(float(amount)))
    elif name == "coarse":
        b = resample(b, COARSE_M)
        a = resample(a, COARSE_M) if amount == "both" else a
    elif name != "plain":
        raise SystemExit(f"no variant {variant}")
    return replace(pair, a=a, b=b)


def attempt(job: tuple[Pair, str, int]) -> tuple[bool, bool]:
    """Whether the pair under a variant and draw was joined, and whether the transform is right."""
    cv2.setNumThreads(1)
    pair = varied(*job)
    result = fuse_pair(pair.a, pair.b)
    T = result.T_target_source
    return result.accepted, T is not None and compare(pair, T)[0]


def main() -> None:
    """Prints a row a folder and variant."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--variants", nargs="*", default=[])
    parser.add_argument("--draws", type=int, default=1, help="how often noise is drawn")
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    cv2.setNumThreads(1)  # processes that fork off must not inherit a pool of threads
    with ProcessPoolExecutor(args.jobs) as executor:
        for folder in args.folders:
            pairs = list(read_pairs(folder))
            number = sum(pair.T_a_b is not None for pair in pairs)
            for variant in ["plain", *args.variants]:
                good, bad = [], 0
                for draw in range(args.draws if variant.startswith(("flipped", "jittered")) else 1):
                    found = list(executor.map(attempt, [(pair, variant, draw) for pair in pairs], chunksize=4))
                    good.append(sum(joined and right for joined, right in found))
                    bad += sum(joined and not right for joined, right in found)
                mean = f", in the mean {np.mean(good):.1f}" if len(good) > 1 else ""
                joined = ", ".join(map(str, good)) + mean
                print(
                    f"{folder.name:14} {variant:12} joined rightly {joined} of {number}; falsely {bad} in all",
                    flush=True,
                )


if __name__ == "__main__":
    main()
