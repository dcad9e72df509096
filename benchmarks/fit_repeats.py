"""Fits `UNIQUENESS` of `mapfusion.pairwise.confidence` on places that repeat themselves, and says how it would do.

    python benchmarks/fit_repeats.py FOLDER --seed 9951

FOLDER has real pairs of maps with truth, as for fit_verdict.py. From them come views as there, with and without
overlap, and views of the same places with a second wing like the first; and from places.py halls of racks, corridors
of rooms and mazes. Fitted is on the pairs whose first verdict turns on what repeats itself: whether it is right. Places
are held out whole, in turn, when the model is judged. Real views count four times: places made up of copies are many
here, and few in the world.
"""

from __future__ import annotations

import argparse
import math
import zlib
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
from fit_verdict import (
    NUM_FOLDS,
    RESOLUTION_M,
    Pair,
    compare,
    fit_logistic,
    read_pairs,
    repeated_views,
    views,
    with_noise,
)
from places import PLACES, repeating_views

from mapfusion.config import FusionConfig
from mapfusion.pairwise.confidence import MIN_UNIQUENESS, UNIQUENESS, Figures, is_repeating, uniqueness_terms
from mapfusion.pairwise.default import prepare, single_verdict
from mapfusion.pairwise.verdict import too_little
from mapfusion.transform import FloatArray

NUM_VIEWS, NUM_PLACES = 24, 90
WEIGHT_OF_REAL = 4


class Asked(NamedTuple):
    """A pair whose maps were asked what of them repeats itself."""

    kind: str
    place: str
    figures: Figures
    is_right: bool


def asked(pair: Pair) -> Asked | None:
    """What a pair's first verdict says; None where it does not turn on what repeats itself, or is only nearly right."""
    cv2.setNumThreads(1)
    maps = [prepare(grid, RESOLUTION_M) for grid in (pair.a, pair.b)]
    if too_little(maps[0], maps[1]) is not None:
        return None
    is_swapped = maps[0].key > maps[1].key
    target, source = reversed(maps) if is_swapped else maps
    verdict = single_verdict(target, source, FusionConfig(), is_thorough=True)
    T = verdict.T_target_source
    if T is None or not is_repeating(verdict.evidence) or verdict.gate == "ambiguous":
        return None
    is_right, is_near = compare(pair, T.inverse() if is_swapped else T)
    return None if is_near else Asked(pair.kind, pair.place, verdict.evidence, is_right)


def report(pairs: Sequence[Asked]) -> None:
    """Prints the weights, and what would pass of places that were held out."""
    terms = np.array([list(uniqueness_terms(one.figures).values()) for one in pairs])
    right = np.array([one.is_right for one in pairs])
    is_real = np.array([":" not in one.kind and not one.kind.startswith("repeated") for one in pairs])
    weights = _fitted(terms, right, is_real)
    print("uniqueness", {name: round(float(w), 3) for name, w in zip(UNIQUENESS, weights, strict=True)})
    folds = np.array([zlib.crc32(one.place.encode()) % NUM_FOLDS for one in pairs])
    passes = np.zeros(len(pairs), np.bool_)
    for fold in range(NUM_FOLDS):
        kept, held = folds != fold, folds == fold
        passes[held] = terms[held] @ _fitted(terms[kept], right[kept], is_real[kept]) >= math.log(
            MIN_UNIQUENESS / (1.0 - MIN_UNIQUENESS)
        )
    rows = Counter((one.kind, one.is_right, bool(ok)) for one, ok in zip(pairs, passes, strict=True))
    print("\nplaces held out                 right  of them passed  wrong  of them passed")
    for kind in dict.fromkeys(one.kind for one in pairs):
        counts = [rows[kind, of, ok] for of in (True, False) for ok in (True, False)]
        print(f"{kind:30} {counts[0] + counts[1]:6} {counts[0]:15} {counts[2] + counts[3]:6} {counts[2]:15}")


def _fitted(terms: FloatArray, right: npt.NDArray[np.bool_], is_real: npt.NDArray[np.bool_]) -> FloatArray:
    """The weights, real pairs counted WEIGHT_OF_REAL times."""
    number = np.where(is_real, WEIGHT_OF_REAL, 1)
    return fit_logistic(terms.repeat(number, axis=0), right.repeat(number), np.ones(number.sum(), np.bool_))


def main() -> None:
    """Asks all pairs, then fits and reports."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    cv2.setNumThreads(1)  # processes that fork off must not inherit a pool of threads
    whole = [pair for pair in read_pairs(args.folder) if pair.T_a_b is not None]
    rng = np.random.default_rng(args.seed)
    real = [with_noise(view, rng) for pair in whole for view in views(pair, whole, NUM_VIEWS, rng)]
    wings = [with_noise(view, rng) for pair in whole for view in repeated_views(pair, NUM_VIEWS, rng)]
    made = [view for kind in PLACES for view in repeating_views(kind, NUM_PLACES, rng)]
    with ProcessPoolExecutor(args.jobs) as executor:
        found = executor.map(asked, [*real, *wings, *made], chunksize=4)
        report([one for one in found if one is not None])


if __name__ == "__main__":
    main()
