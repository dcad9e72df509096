"""Fits PLAUSIBILITY and CONFIDENCE of `mapfusion.pairwise.confidence` on pairs of maps with known truth.

It says how they would do, too.

    python benchmarks/fit_verdict.py PAIRS... --simulated 200

PAIRS are folders of map pairs with truth (pairs.json with id, a, b, M, kp_a, kp_b, same_plan, and images). To the pairs
themselves come views cut from them by half planes, the second one turned at random: of one place with overlap, of
one place without (whatever is claimed there is wrong), and of different places; views of a map and of a bent copy of
it; and pairs of both generators of `mapfusion evaluate`. Nearly half of all these are noisy, and the folders' pairs of
real and hand-held maps come once more with noise. Buildings are held out whole, in turn, when the models are judged.
Views of places with a second wing like the first are judged too, but nothing is fitted on them. The margin takes which
rivals are sure enough alone from the confidence as it stands: after a large change fit twice. Joined is what one
verdict joins: close calls are not asked again here.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import zlib
from collections import defaultdict
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from damage import bent_copy, noisy, repeated
from scipy.optimize import minimize

from mapfusion.evaluation.pairs import make_pair
from mapfusion.grid import Cells, OccupancyGrid
from mapfusion.pairwise import search
from mapfusion.pairwise.confidence import (
    CONFIDENCE,
    MIN_CONFIDENCE,
    PLAUSIBILITY,
    confidence_terms,
    margin,
    plausibility_terms,
)
from mapfusion.pairwise.default import prepare
from mapfusion.pairwise.poses import Poses, between_frames, differ
from mapfusion.pairwise.verdict import (
    MIN_MARGIN,
    MIN_RATIO,
    SLIDING_MARGIN,
    has_slid,
    is_adrift,
    least_evidence,
    too_little,
)
from mapfusion.pairwise.voting import match
from mapfusion.transform import SE2, FloatArray

RESOLUTION_M = 0.05
RIGHT_CELLS, RIGHT_DEGREES, RIGHT_KEY_POINT_CELLS = 5.0, 2.0, 30.0
NEAR_CELLS, NEAR_DEGREES = 15.0, 6.0
"""A pose this near is neither right nor wrong: it is left out of the fit."""
NUM_FOLDS = 8
FEWEST_KNOWN = 3000
RIDGE_CHOICE, RIDGE_CONFIDENCE = 0.02, 1e-2


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Two maps and what is true of them.

    Attributes:
        kind: Where the pair comes from.
        place: What is held out together.
        a: The target.
        b: The source.
        T_a_b: Truth, None where nothing that is claimed would be right.
        key_points: (2, N, 2) m, the same points in a and b, where they judge instead of `T_a_b`.
    """

    kind: str
    place: str
    a: OccupancyGrid
    b: OccupancyGrid
    T_a_b: SE2 | None
    key_points: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """The candidates of a pair, the most plausible first, the polished best one in front of them.

    Attributes:
        kind: Where the pair comes from.
        place: What is held out together.
        figures: Of each candidate.
        is_right: Of each candidate.
        is_near: Of each candidate.
        is_apart: (K, K) which candidates are distinctly different answers.
    """

    kind: str
    place: str
    figures: list[dict[str, float]] = field(default_factory=list)
    is_right: list[bool] = field(default_factory=list)
    is_near: list[bool] = field(default_factory=list)
    is_apart: npt.NDArray[np.bool_] | None = None


def read_pairs(folder: Path) -> Iterator[Pair]:
    """The pairs of a folder, pixels turned into metres of frames at the images' lower left corners."""
    binary = is_binary(folder)
    for record in json.loads((folder / "pairs.json").read_text()):
        if record.get("same_plan"):
            continue
        a, b = (read_grid(folder / record[side], binary) for side in "ab")
        T, points = None, None
        if record["M"] is not None:
            matrix = _pixels_to_m(a) @ np.vstack([record["M"], [0, 0, 1]]) @ np.linalg.inv(_pixels_to_m(b))
            T = SE2(matrix[0, 2], matrix[1, 2], math.atan2(matrix[1, 0], matrix[0, 0]))
        if "kp_a" in record:
            points = np.stack([_points_m(a, record["kp_a"]), _points_m(b, record["kp_b"])])
        yield Pair(folder.name, _place(folder, record["a"]), a, b, T, points)


def is_binary(folder: Path) -> bool:
    """Whether the images of a folder say wall or free only, as its set.json has it."""
    settings = folder / "set.json"
    return settings.exists() and bool(json.loads(settings.read_text()).get("binary", False))


def _place(folder: Path, image: str) -> str:
    """What an image's name begins with, before any digit; the folder and the name where that is nothing."""
    letters = re.match("[A-Za-z_]*", image.removeprefix("neg_"))
    return (letters.group().strip("_") if letters else "") or f"{folder.name} {image}"


def read_grid(path: Path, binary: bool = False) -> OccupancyGrid:
    """An 8-bit image as a map: dark is wall, bright is free; of binary ones bright is wall and the rest free."""
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise SystemExit(f"{path} is no image")
    cells: Cells = np.full(image.shape, -1, np.int8)
    if binary:
        cells[:] = np.where(image > 127, 100, 0)
    else:
        cells[image > 230], cells[image < 100] = 0, 100
    return OccupancyGrid(np.ascontiguousarray(cells[::-1]), RESOLUTION_M, SE2.identity(), "map", 0)


def _pixels_to_m(grid: OccupancyGrid) -> FloatArray:
    """(3, 3) from pixels, x right and y down, to the grid's frame."""
    r = grid.resolution_m
    return np.array([[r, 0.0, r / 2.0], [0.0, -r, (grid.height - 0.5) * r], [0.0, 0.0, 1.0]])


def _points_m(grid: OccupancyGrid, points_px: Sequence[Sequence[float]]) -> FloatArray:
    px = np.asarray(points_px, np.float64)
    return np.column_stack([px, np.ones(len(px))]) @ _pixels_to_m(grid)[:2].T


def views(pair: Pair, others: Sequence[Pair], number: int, rng: np.random.Generator) -> Iterator[Pair]:
    """Views cut from a pair of one place, and against a view of another one."""
    for _ in range(number):
        for kind, gap in (("overlapping views", None), ("views without overlap", rng.uniform(0.2, 1.5))):
            a, b = _halves(pair, gap, rng)
            if min(np.count_nonzero(one.known) for one in (a, b)) < FEWEST_KNOWN:
                continue
            if kind == "overlapping views" and pair.key_points is None:
                yield replace(pair, kind=kind, a=a, b=b)
            elif gap is not None:
                yield replace(pair, kind=kind, a=a, b=b, T_a_b=None, key_points=None)
    other = others[int(rng.integers(len(others)))]
    if other.place != pair.place:
        yield Pair("views of different places", pair.place, _halves(pair, None, rng)[0], other.b, None)


def bent_views(pair: Pair, number: int, rng: np.random.Generator) -> Iterator[Pair]:
    """Overlapping views of the first map of a pair and of a bent copy of it."""
    for _ in range(number):
        copy = bent_copy(pair.a, rng)
        if copy is not None:
            whole = Pair("views of bent copies", pair.place, pair.a, *copy)
            a, b = _halves(whole, None, rng)
            if min(np.count_nonzero(one.known) for one in (a, b)) >= FEWEST_KNOWN:
                yield replace(whole, a=a, b=b)


def repeated_views(pair: Pair, number: int, rng: np.random.Generator) -> Iterator[Pair]:
    """Views of the place of a pair with a second wing like it: with overlap, or apart, where any claim is wrong.

    None of bent maps, which no wing fits.
    """
    assert pair.T_a_b is not None
    for _ in range(number if pair.key_points is None else 0):
        maps = repeated(pair.a, pair.b, pair.T_a_b, rng)
        if maps is None:
            continue
        angle = rng.uniform(-math.pi, math.pi)
        normal = np.array([math.cos(angle), math.sin(angle)])
        along = [one.centres_m(one.known) @ normal for one in maps]
        high, low = np.quantile(along[0], rng.uniform(0.4, 0.85)), np.quantile(along[1], rng.uniform(0.15, 0.6))
        a = cut(maps[0], along[0] >= high)
        b = turned(cut(maps[1], along[1] <= low), rng.uniform(-math.pi, math.pi))
        if min(np.count_nonzero(one.known) for one in (a, b)) >= FEWEST_KNOWN:
            kind, T = ("repeated views", SE2.identity()) if low < high else ("repeated views apart", None)
            yield Pair(kind, pair.place, a, b, T)


def with_noise(pair: Pair, rng: np.random.Generator) -> Pair:
    """The pair as it is, or with noise on both maps."""
    a, b = noisy(pair.a, pair.b, rng)
    return replace(pair, a=a, b=b)


def _halves(pair: Pair, gap_m: float | None, rng: np.random.Generator) -> tuple[OccupancyGrid, OccupancyGrid]:
    """Both maps, each cut by a line: looking away from each other, overlapping or a gap apart."""
    assert pair.T_a_b is not None
    angle = rng.uniform(-math.pi, math.pi)
    normal = np.array([math.cos(angle), math.sin(angle)])
    along_a = pair.a.centres_m(pair.a.known) @ normal
    along_b = pair.T_a_b.apply(pair.b.centres_m(pair.b.known)) @ normal
    if gap_m is None:
        high, low = np.quantile(along_a, rng.uniform(0.5, 0.85)), np.quantile(along_b, rng.uniform(0.15, 0.5))
    else:
        high = np.quantile(along_a, rng.uniform(0.3, 0.6))
        low = high + gap_m
    return cut(pair.a, along_a >= high), turned(cut(pair.b, along_b <= low), rng.uniform(-math.pi, math.pi))


def cut(grid: OccupancyGrid, gone: npt.NDArray[np.bool_]) -> OccupancyGrid:
    """The map without those of its N known cells, row by row, that are `gone` (N,)."""
    cells = grid.cells.copy()
    cells[grid.known] = np.where(gone, -1, cells[grid.known])
    return replace(grid, cells=cells)


def turned(grid: OccupancyGrid, angle_rad: float) -> OccupancyGrid:
    """The same map in the same frame, sampled on a grid that is turned."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    corners = np.array([[c, -s], [s, c]]) @ np.array([[0, grid.width, 0, grid.width], [0, 0, grid.height, grid.height]])
    shift = -corners.min(axis=1)
    width, height = (math.ceil(v) for v in corners.max(axis=1) + shift)
    # Between centres of cells, not corners.
    middle = np.array([[c, -s], [s, c]]) @ np.array([0.5, 0.5]) + shift - 0.5
    matrix = np.array([[c, -s, middle[0]], [s, c, middle[1]]])
    cells = cv2.warpAffine(grid.cells, matrix, (width, height), flags=cv2.INTER_NEAREST, borderValue=-1)
    r = grid.resolution_m
    T_grid_turned = SE2(shift[0] * r, shift[1] * r, angle_rad).inverse()
    return replace(grid, cells=cells.astype(np.int8), T_frame_grid=grid.T_frame_grid @ T_grid_turned)


def simulated(num_related: int, num_unrelated: int) -> Iterator[Pair]:
    """Pairs of both generators."""
    for generator in ("paper", "floor-plans"):
        for is_related, number in ((True, num_related), (False, num_unrelated)):
            for seed in range(700_000, 700_000 + number):
                made = make_pair(generator, is_related, seed)  # type: ignore[arg-type]
                yield Pair(
                    f"{generator}, {'one place' if is_related else 'two'}",
                    f"{generator} {is_related} {seed}",
                    made.target,
                    made.source,
                    made.T_target_source,
                )


def judge(pair: Pair) -> Judged:
    """Searches a pair thoroughly and compares every candidate with the truth."""
    cv2.setNumThreads(1)
    maps = [prepare(grid, RESOLUTION_M) for grid in (pair.a, pair.b)]
    judged = Judged(pair.kind, pair.place)
    if too_little(maps[0], maps[1]) is not None:
        return judged
    is_swapped = maps[0].key > maps[1].key
    target, source = reversed(maps) if is_swapped else maps
    matches = match(target.features, source.features)
    hypotheses = search.propose(target, source, matches, search.THOROUGH)
    candidates = search.refine_and_rank(target, source, hypotheses, matches, search.THOROUGH)
    polished = search.recheck(target, source, candidates[0].pose, matches)
    candidates = [search.with_firmness(polished, target, source).best, *candidates]
    poses: Poses = np.array([one.pose for one in candidates])
    cells = search.distinct_cells(target, source)
    apart = differ(poses, poses, source.centre, cells, search.DISTINCT_DEGREES)
    for one in candidates:
        T = between_frames(one.pose, target.grid, source.grid)
        is_right, is_near = compare(pair, T.inverse() if is_swapped else T)
        judged.figures.append(one.figures)
        judged.is_right.append(is_right)
        judged.is_near.append(is_near)
    return replace(judged, is_apart=apart)


def compare(pair: Pair, T: SE2) -> tuple[bool, bool]:
    """Whether a transform is right, and whether it is only near that."""
    if pair.T_a_b is None:
        return False, False
    middle = pair.b.centres_m(pair.b.known).mean(axis=0)
    off = float(np.hypot(*(T.apply(middle) - pair.T_a_b.apply(middle)))) / RESOLUTION_M
    turn = math.degrees(T.distance_to(pair.T_a_b)[1])
    is_right = off < RIGHT_CELLS and turn < RIGHT_DEGREES
    near_cells, near_degrees = NEAR_CELLS, NEAR_DEGREES
    if pair.key_points is not None:
        apart = np.linalg.norm(T.apply(pair.key_points[1]) - pair.key_points[0], axis=1)
        is_right = bool(np.median(apart) / RESOLUTION_M <= RIGHT_KEY_POINT_CELLS)
        near_cells, near_degrees = 2 * RIGHT_KEY_POINT_CELLS, 8.0
    return is_right, not is_right and off < near_cells and turn < near_degrees


def fit_plausibility(all_judged: Sequence[Judged]) -> dict[str, float]:
    """Weights under which right candidates are chosen among those of their pair: conditional logit with a ridge."""
    names = list(PLAUSIBILITY)
    gaps = []
    for one in all_judged:
        terms = np.array([[plausibility_terms(f)[name] for name in names] for f in one.figures])
        right = [k for k in range(1, len(terms)) if one.is_right[k]]
        wrong = [k for k in range(1, len(terms)) if not one.is_right[k] and not one.is_near[k]]
        if right and wrong:
            best = max(right, key=lambda k: one.figures[k]["net"])
            gaps.append(terms[wrong] - terms[best])
    scale = np.concatenate(gaps).std(axis=0)

    def loss(w: FloatArray) -> float:
        return float(
            np.mean([np.logaddexp.reduce(np.append(gap / scale @ w, 0.0)) for gap in gaps]) + RIDGE_CHOICE * w @ w / 2
        )

    weights = minimize(loss, np.zeros(len(names)), method="L-BFGS-B").x / scale
    return dict(zip(names, weights.tolist(), strict=True))


def table(all_judged: Sequence[Judged]) -> tuple[FloatArray, npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """(N, terms) of the confidence, whether the chosen one is right, and whether it may be counted as wrong."""
    rows, right, counts = [], [], []
    for one in all_judged:
        assert one.is_apart is not None
        rivals = [one.figures[k] for k in range(1, len(one.figures)) if one.is_apart[0, k]] or [None]
        least_margin = min(margin(one.figures[0], rival) for rival in rivals)
        rows.append(list(confidence_terms(one.figures[0], least_margin).values()))
        right.append(one.is_right[0])
        counts.append(not one.is_near[0])
    return np.array(rows), np.array(right), np.array(counts)


def fit_logistic(terms: FloatArray, right: npt.NDArray[np.bool_], counts: npt.NDArray[np.bool_]) -> FloatArray:
    """Logistic regression by Newton's method, with a ridge on all weights but the bias, which comes first."""
    x, y = terms[counts].copy(), right[counts].astype(np.float64)
    mean, scale = x.mean(axis=0), x.std(axis=0) + 1e-9
    mean[0], scale[0] = 0.0, 1.0
    x = (x - mean) / scale
    ridge = np.full(x.shape[1], RIDGE_CONFIDENCE * len(x) / 100.0)
    ridge[0] = 1e-6
    w = np.zeros(x.shape[1])
    for _ in range(30):
        p = 1.0 / (1.0 + np.exp(-np.clip(x @ w, -30.0, 30.0)))
        w -= np.linalg.solve((x * (p * (1 - p))[:, None]).T @ x + np.diag(ridge), x.T @ (p - y) + ridge * w)
    weights: FloatArray = w / scale
    weights[0] = w[0] - float((w[1:] * mean[1:] / scale[1:]).sum())
    return weights


def report(all_judged: Sequence[Judged]) -> None:
    """Prints the weights, and what would be joined of places that were held out."""
    is_made = np.array([one.kind.startswith("repeated") for one in all_judged])
    ranked = [one for one, made in zip(all_judged, is_made, strict=True) if not made]
    print("plausibility", {name: round(value, 3) for name, value in fit_plausibility(ranked).items()})
    terms, right, counts = table(all_judged)
    fits = counts & ~is_made
    print(
        "confidence",
        {n: round(float(w), 3) for n, w in zip(CONFIDENCE, fit_logistic(terms, right, fits), strict=True)},
    )
    folds = np.array([zlib.crc32(one.place.encode()) % NUM_FOLDS for one in all_judged])
    sure = np.zeros(len(terms))
    for fold in range(NUM_FOLDS):
        kept, held = folds != fold, folds == fold
        weights = fit_logistic(terms[kept], right[kept], fits[kept])
        sure[held] = 1.0 / (1.0 + np.exp(-(terms[held] @ weights)))
    best = [one.figures[0] for one in all_judged]
    joined = sure >= MIN_CONFIDENCE
    joined &= np.array([f["net"] >= least_evidence(f, is_searched=True) for f in best])
    joined &= np.array([not (has_slid(f) or is_adrift(f)) for f in best])
    joined &= np.array([f["ratio"] for f in best]) >= MIN_RATIO
    sliding = np.array([figures["conditioning"] < search.SLIDING_CONDITIONING for figures in best])
    joined &= terms[:, list(CONFIDENCE).index("margin")] >= np.where(sliding, SLIDING_MARGIN, MIN_MARGIN)
    rows: dict[str, list[int]] = defaultdict(lambda: [0, 0, 0, 0])
    for i, one in enumerate(all_judged):
        for k, value in enumerate((1, right[i], right[i] and joined[i], joined[i] and not right[i] and counts[i])):
            rows[one.kind][k] += int(value)
    print("\nplaces held out                pairs  best one right  joined rightly  wrongly")
    for kind, (number, found, good, bad) in rows.items():
        print(f"{kind:30} {number:6} {found:15} {good:15} {bad:8}")


def main() -> None:
    """Searches all pairs, then fits and reports."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--views", type=int, default=8, help="views cut from each pair with truth")
    parser.add_argument("--simulated", type=int, default=100, help="pairs of each generator that show one place")
    parser.add_argument("--unrelated", type=int, default=300, help="pairs of each generator that show two")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    cv2.setNumThreads(1)  # processes that fork off must not inherit a pool of threads
    rng = np.random.default_rng(args.seed)
    whole = [pair for folder in args.folders for pair in read_pairs(folder)]
    of_one_place = [pair for pair in whole if pair.T_a_b is not None]
    parts = [
        view
        for pair in of_one_place
        if pair.kind not in ("paper", "lidar")
        for view in views(pair, of_one_place, args.views, rng)
    ]
    bent = [view for pair in of_one_place if pair.kind != "paper" for view in bent_views(pair, 2, rng)]
    wings = [view for pair in of_one_place if pair.kind == "real" for view in repeated_views(pair, args.views, rng)]
    again = [pair for pair in whole if pair.kind not in ("paper", "lidar")]
    of_generators = simulated(args.simulated, args.unrelated)
    made = [with_noise(pair, rng) for pair in (*again, *parts, *bent, *wings, *of_generators)]
    with ProcessPoolExecutor(args.jobs) as executor:
        judged = list(executor.map(judge, [*whole, *made], chunksize=4))
    report([one for one in judged if one.figures])


if __name__ == "__main__":
    main()
