"""Right and wrong joins of views cut anew from pairs of one place: fresh ones with every seed.

    python benchmarks/views.py ../shared/data/pairs/real --views 40 --repeated 24 --places 50 --seed 9101

PAIRS are folders as `fit_verdict.py` reads them. Kinds of views are its: overlapping, without overlap, of different
places, and of places with a second wing like the first; and those of `places.py`. Nearly half are noisy. Almost right
is up to 15 cells and 6 degrees off: a false join that is counted by itself.
"""

from __future__ import annotations

import argparse
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import cv2
import numpy as np
from fit_verdict import Pair, compare, read_pairs, repeated_views, views, with_noise
from places import PLACES, repeating_views

from mapfusion import fuse_pair

COLUMNS = ("pairs", "right before the gate", "joined rightly", "almost rightly", "wrongly")


def attempt(pair: Pair) -> tuple[str, str, float, list[bool]]:
    """Kind and place of a pair, the confidence, and what holds of it, in the order of COLUMNS."""
    cv2.setNumThreads(1)
    result = fuse_pair(pair.a, pair.b)
    T, joined = result.T_target_source, result.accepted
    is_right, is_near = (False, False) if T is None else compare(pair, T)
    found = [True, is_right, joined and is_right, joined and is_near, joined and not is_right and not is_near]
    return pair.kind, pair.place, result.confidence, found


def main() -> None:
    """Prints a row a kind, and every join that is not right."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--views", type=int, default=40, help="of each pair")
    parser.add_argument("--repeated", type=int, default=24, help="views of places with a second wing, of each pair")
    parser.add_argument("--places", type=int, default=0, help="made-up places of each kind that repeat themselves")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    cv2.setNumThreads(1)  # processes that fork off must not inherit a pool of threads
    rng = np.random.default_rng(args.seed)
    whole = [pair for folder in args.folders for pair in read_pairs(folder) if pair.T_a_b is not None]
    cut = [
        with_noise(view, rng)
        for pair in whole
        for view in (*views(pair, whole, args.views, rng), *repeated_views(pair, args.repeated, rng))
    ]
    cut += [view for kind in PLACES for view in repeating_views(kind, args.places, rng)]
    rows: Counter[tuple[str, str]] = Counter()
    with ProcessPoolExecutor(args.jobs) as executor:
        for kind, place, confidence, found in executor.map(attempt, cut, chunksize=4):
            for name, holds in zip(COLUMNS, found, strict=True):
                rows[kind, name] += holds
            if any(found[3:]):
                print(f"    {place}, {kind}: {COLUMNS[3 if found[3] else 4]}, {confidence:.3f}", flush=True)
    for kind in dict.fromkeys(pair.kind for pair in cut):
        print(f"{kind:28} " + ", ".join(f"{name} {rows[kind, name]}" for name in COLUMNS), flush=True)


if __name__ == "__main__":
    main()
