"""False merges among maps of different places: every map of a folder against every other place's.

Run: python benchmarks/strangers.py ../shared/data/pairs/real \
    --one-building gdc carkit rail jsk_eng2 jsk_eng6 jsk_eng8 kobuki
Or:  python benchmarks/strangers.py ../shared/data/pairs/real --against ../shared/data/pairs/lidar --every 6

Maps are 8-bit images as the bench has them. Those whose names differ by a last number show one place; names that begin
alike as `--one-building` says may, and are not compared either. With `--against` they are compared with those of a
folder that shows other places only.
"""

from __future__ import annotations

import argparse
import itertools
import math
import zlib
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import cv2
import numpy as np
from damage import flipped, jittered
from fit_verdict import cut, is_binary, read_grid, turned

from mapfusion import OccupancyGrid, PairFusion, fuse_pair

VARIANTS = ("plain", "turned", "views", "jittered", "flipped", "views jittered", "views flipped")
"""As they are; turned; two parts of them, turned; with walls jittered by a cell or 3 % of the cells flipped."""
FLIPPED_SHARE = 0.03
Job = tuple[Path, Path, str, int]


def place(name: str, buildings: Sequence[str]) -> str:
    """What maps of one place have in common."""
    head, _, number = name.rpartition("_")
    return next((one for one in buildings if name.startswith(one)), head if number.isdigit() else name)


def varied(grid: OccupancyGrid, variant: str, rng: np.random.Generator) -> OccupancyGrid:
    """The map under a variant."""
    if "views" in variant:
        rows, columns = np.nonzero(grid.known)
        angle_rad = rng.uniform(-math.pi, math.pi)
        along = columns * math.cos(angle_rad) + rows * math.sin(angle_rad)
        grid = cut(grid, along > np.quantile(along, rng.uniform(0.4, 0.7)))
    if "views" in variant or "turned" in variant:
        grid = turned(grid, rng.uniform(-math.pi, math.pi))
    if "jittered" in variant:
        grid = jittered(grid, rng)
    return flipped(grid, FLIPPED_SHARE, rng) if "flipped" in variant else grid


def attempt(job: Job) -> PairFusion:
    """Fuses two maps of different places."""
    cv2.setNumThreads(1)
    a, b, variant, seed = job
    rng = np.random.default_rng(zlib.crc32(f"{a.stem} {b.stem} {variant} {seed}".encode()))
    target, source = (varied(read_grid(path, is_binary(path.parent)), variant, rng) for path in (a, b))
    return fuse_pair(target, source)


def main() -> None:
    """Prints a row a variant, and every join."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--one-building", nargs="*", default=[])
    parser.add_argument("--against", type=Path, help="folder of maps that all show other places")
    parser.add_argument("--every", type=int, default=1, help="take one of so many maps of that folder")
    parser.add_argument("--variants", nargs="*", default=VARIANTS)
    parser.add_argument("--seeds", nargs="*", type=int, default=[0])
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    if (args.against and args.one_building) or (args.every > 1 and not args.against):
        parser.error("--every goes with --against, and --one-building without")
    cv2.setNumThreads(1)  # processes that fork off must not inherit a pool of threads
    maps = sorted(args.folder.glob("*.png"))
    if args.against:
        pairs = list(itertools.product(maps, sorted(args.against.glob("*.png"))[:: args.every]))
    else:
        names = {path: place(path.stem, args.one_building) for path in maps}
        pairs = [(a, b) for a, b in itertools.combinations(maps, 2) if names[a] != names[b]]
    if not pairs:
        raise SystemExit("no two maps of different places")
    with ProcessPoolExecutor(args.jobs) as executor:
        for variant in args.variants:
            seeds = args.seeds[:1] if variant == "plain" else args.seeds
            jobs = [(a, b, variant, seed) for seed in seeds for a, b in pairs]
            found = list(executor.map(attempt, jobs, chunksize=16))
            surest = max((one.confidence for one in found if not one.accepted), default=0.0)
            num_joined = sum(one.accepted for one in found)
            print(f"{variant:15} {len(jobs)} pairs, {num_joined} joined, surest other {surest:.2f}", flush=True)
            for (a, b, _, seed), one in zip(jobs, found, strict=True):
                if one.accepted:
                    figures = {name: round(value, 2) for name, value in one.evidence.items()}
                    print(f"    {a.stem} {b.stem} {seed} {one.confidence:.3f} {figures}", flush=True)


if __name__ == "__main__":
    main()
