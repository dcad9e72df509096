"""The code published with the paper against `profile="paper"`, on pairs of the paper's map generator.

    python benchmarks/published.py --pairs 300 --negatives 300

The published steps are rebuilt here from their description: free scale, an error over the pixels that are obstacle
in both maps only, subtracted as bytes, after the whole overlay was built. Right is a transform that moves the source's
four corners by no more than 5 pixels, on average, from where they belong.

    python benchmarks/published.py --times 40

What it takes to fuse two new maps, to verify a known transform between two new ones, and between a new one and one that
was looked at before, against the published steps on the same maps: pairs of the paper's generator, and of simulated
lidar robots.

    python benchmarks/published.py --sets PAIRS...

What it takes to fuse the pairs of folders, as `fit_verdict.py` reads them, against the published steps: those that are
joined, those that are refused though they show one place, and those that show two.
"""

from __future__ import annotations

import argparse
import math
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import combinations, count, islice
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from fit_verdict import read_pairs

from mapfusion.config import FusionConfig
from mapfusion.fusion import PairFuser, fuse_pair
from mapfusion.grid import OccupancyGrid
from mapfusion.pairwise import paper
from mapfusion.simulation.events import mission_events
from mapfusion.simulation.mission import simulate_mission
from mapfusion.simulation.mission_config import MissionConfig
from mapfusion.simulation.paper import PatchPair, negative_pair, positive_pair
from mapfusion.steps import GridEvent
from mapfusion.transform import SE2, FloatArray

RIGHT_PX = 5.0
ERROR_BELOW = 20.0
MIN_MATCHES = 25

Image = npt.NDArray[np.uint8]
KnownPair = tuple[OccupancyGrid, OccupancyGrid, SE2]


@dataclass(frozen=True, slots=True)
class Attempt:
    """One pair by one of the two: its error figure, verdict, and corner error in pixels (infinite where none)."""

    accepted: bool
    error: float
    corner_error_px: float

    @property
    def right(self) -> bool:
        return self.corner_error_px <= RIGHT_PX


def picture(grid: OccupancyGrid) -> Image:
    """As the authors' files have it: obstacle 255, free 0, the grid's last row on top."""
    return np.ascontiguousarray(np.where(grid.cells[::-1] == 100, 255, 0).astype(np.uint8))


def pixels_to_m(grid: OccupancyGrid) -> FloatArray:
    """(3, 3) from pixels of `picture` to the grid's frame, metres."""
    r = grid.resolution_m
    corner_to_point = np.array([[r, 0.0, 0.5 * r], [0.0, -r, (grid.height - 0.5) * r], [0.0, 0.0, 1.0]])
    return grid.T_frame_grid.matrix() @ corner_to_point


def published(target: Image, source: Image) -> tuple[FloatArray | None, float]:
    """(2, 3) matrix from the source's pixels to the target's, and the error; infinite where nothing can be counted."""
    orb = cv2.ORB.create()
    (keypoints_target, found_target), (keypoints_source, found_source) = (
        orb.detectAndCompute(image, None)  # type: ignore[call-overload]
        for image in (target, source)
    )
    if found_target is None or found_source is None:
        return None, math.inf
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(found_target, found_source)
    if len(matches) < MIN_MATCHES:
        return None, math.inf
    points_target = np.array([keypoints_target[m.queryIdx].pt for m in matches], np.float32)
    points_source = np.array([keypoints_source[m.trainIdx].pt for m in matches], np.float32)
    matrix, _ = cv2.estimateAffinePartial2D(points_source, points_target, method=cv2.RANSAC)
    if matrix is None:
        return None, math.inf
    return np.asarray(matrix, np.float64), _overlay_error(target, source, np.asarray(matrix, np.float64))


def _overlay_error(target: Image, source: Image, matrix: FloatArray) -> float:
    """The error on a canvas around both images, whose edges are cut towards zero."""
    (rows, cols), (rows_source, cols_source) = target.shape, source.shape
    moved = matrix @ np.array([[0, cols_source, cols_source, 0], [0, 0, rows_source, rows_source], [1, 1, 1, 1]])
    corners = np.concatenate([moved.T, [[0, 0], [cols, rows]]])
    left, top = (corners.min(axis=0) - 0.5).astype(int)
    right, bottom = (corners.max(axis=0) + 0.5).astype(int)
    shifted = matrix - np.array([[0.0, 0.0, left], [0.0, 0.0, top]])
    canvas_source = cv2.warpAffine(source, shifted, (int(right - left), int(bottom - top)))
    canvas_target = np.zeros_like(canvas_source)
    canvas_target[-top : rows - top, -left : cols - left] = target
    both = (canvas_target > 0) & (canvas_source > 0)
    return float(np.mean(canvas_target[both] - canvas_source[both])) if both.any() else math.inf


def corner_error_px(pair: PatchPair, matrix: FloatArray | None) -> float:
    """Mean displacement of the source picture's corners, pixels; `matrix` as `published` gives it."""
    if matrix is None or pair.T_target_source is None:
        return math.inf
    truth = np.linalg.inv(pixels_to_m(pair.target)) @ pair.T_target_source.matrix() @ pixels_to_m(pair.source)
    right, bottom = pair.source.width - 1.0, pair.source.height - 1.0
    corners = np.array([[0.0, right, right, 0.0], [0.0, 0.0, bottom, bottom], [1.0, 1.0, 1.0, 1.0]])
    return float(np.linalg.norm((matrix[:2] - truth[:2]) @ corners, axis=0).mean())


def attempt_published(pair: PatchPair) -> Attempt:
    """The pair as the published code sees it."""
    matrix, error = published(picture(pair.target), picture(pair.source))
    return Attempt(error < ERROR_BELOW, error, corner_error_px(pair, matrix))


def attempt_profile(pair: PatchPair) -> Attempt:
    """The pair as `profile="paper"` sees it."""
    prepared = (paper.prepare(grid, pair.target.resolution_m) for grid in (pair.target, pair.source))
    result = paper.fuse(*prepared, FusionConfig(profile="paper"))
    if result.T_target_source is None:
        return Attempt(False, math.inf, math.inf)
    matrix = np.linalg.inv(pixels_to_m(pair.target)) @ result.T_target_source.matrix() @ pixels_to_m(pair.source)
    return Attempt(result.accepted, math.inf if result.mae is None else result.mae, corner_error_px(pair, matrix))


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=300)
    parser.add_argument("--negatives", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0, help="seed of the first pair of each kind")
    parser.add_argument("--times", type=int, default=0, help="pairs of each kind to time instead of the table")
    parser.add_argument(
        "--sets", type=Path, nargs="*", default=[], help="folders of pairs to time instead of the table"
    )
    args = parser.parse_args()
    if args.sets:
        for folder in args.sets:
            print_times_of(folder)
        return
    if args.times:
        print_times(args.times, args.seed)
        return
    positives = [positive_pair(args.seed + i) for i in range(args.pairs)]
    negatives = [negative_pair(args.seed + i) for i in range(args.negatives)]

    print(f"OpenCV {cv2.__version__}, {len(positives)} pairs of one map, {len(negatives)} of two")
    print("                accepted  right (recall)  wrong  false merges   right before the gate   median error of")
    print(
        "                                                                                        right/wrong/unrelated"
    )
    for name, attempt in (("published code", attempt_published), ("profile paper", attempt_profile)):
        start = time.perf_counter()
        on_positives, on_negatives = [attempt(p) for p in positives], [attempt(p) for p in negatives]
        ms = 1e3 * (time.perf_counter() - start) / max(1, len(positives) + len(negatives))
        accepted = [a for a in on_positives if a.accepted]
        num_right = sum(a.right for a in accepted)
        num_false = sum(a.accepted for a in on_negatives)
        errors = (
            [a.error for a in on_positives if a.right],
            [a.error for a in on_positives if not a.right and math.isfinite(a.error)],
            [a.error for a in on_negatives if math.isfinite(a.error)],
        )
        print(
            f"{name:14}  {len(accepted):8}  {num_right:5} ({_percent(num_right, len(positives))})  "
            f"{len(accepted) - num_right:5}  {num_false:4} ({_percent(num_false, len(negatives))})   "
            f"{_percent(sum(a.right for a in on_positives), len(positives)):>21}   "
            + " / ".join(f"{np.median(e):.1f}" if e else "-" for e in errors)
            + f"   {ms:.1f} ms a pair"
        )


def print_times(num_pairs: int, seed: int) -> None:
    """CPU time of fusing, and of verifying known transforms, beside that of the published steps.

    OpenCV is held to one thread for both, as a replay holds it.
    """
    cv2.setNumThreads(1)
    patches = [positive_pair(seed + i) for i in range(num_pairs)]
    sets: dict[str, Iterable[KnownPair]] = {
        "paper": [(p.target, p.source, p.T_target_source) for p in patches if p.T_target_source is not None],
        "lidar": islice(lidar_pairs(seed), num_pairs),
    }
    for name, pairs in sets.items():
        total = np.zeros(4)
        for pair in pairs:
            total += np.min([times_s(*pair) for _ in range(3)], axis=0)
        steps, fusing, both_new, one_new = 1e3 * total / num_pairs
        print(
            f"{name}: published steps {steps:.1f} ms; fusing two new maps {fusing:.1f} ms "
            f"({fusing / steps:.2f} times), verifying two new maps {both_new:.1f} ms ({both_new / steps:.2f} "
            f"times), a new one and a known one {one_new:.1f} ms ({one_new / steps:.2f} times)"
        )


def print_times_of(folder: Path) -> None:
    """CPU time of fusing the pairs of a folder beside that of the published steps, the better of two."""
    cv2.setNumThreads(1)
    times: dict[str, list[FloatArray]] = defaultdict(list)
    for pair in read_pairs(folder):
        best = np.full(2, math.inf)
        accepted = False
        for _ in range(2):
            started_s = time.process_time()
            published(picture(pair.a), picture(pair.b))
            steps_s = time.process_time()
            accepted = fuse_pair(pair.a, pair.b).accepted
            best = np.minimum(best, [steps_s - started_s, time.process_time() - steps_s])
        of_one_place = "joined" if accepted else "of one place, refused"
        times["of two places" if pair.T_a_b is None else of_one_place].append(best)
    everything = [one for some in times.values() for one in some]
    if not everything:
        raise SystemExit(f"{folder} has no pairs")
    for kind, some in (*times.items(), ("all", everything)):
        steps, fusing = 1e3 * np.mean(some, axis=0)
        print(
            f"{folder.name}, {kind}: {len(some)} pairs, published steps {steps:.1f} ms, fusing {fusing:.1f} ms "
            f"({fusing / steps:.2f} times)"
        )


def lidar_pairs(seed: int) -> Iterator[KnownPair]:
    """Last maps of the robots of simulated missions, two by two."""
    for number in count(seed):
        mission = simulate_mission(MissionConfig(seed=number, num_robots=3, duration_s=80.0))
        grids = {event.robot: event.grid for event in mission_events(mission) if isinstance(event, GridEvent)}
        for a, b in combinations(mission.robots, 2):
            yield grids[a.name], grids[b.name], a.T_world_map.inverse() @ b.T_world_map


def times_s(target: OccupancyGrid, source: OccupancyGrid, T_target_source: SE2) -> tuple[float, float, float, float]:
    """CPU seconds: the published steps, fusing, verifying with both maps new, and with the source new alone."""
    pictures = picture(target), picture(source)
    new, known = PairFuser(FusionConfig()), PairFuser(FusionConfig())
    known.verify(target, target, SE2.identity())
    started_s = time.process_time()
    published(*pictures)
    steps_s = time.process_time()
    PairFuser(FusionConfig()).fuse(target, source)
    fused_s = time.process_time()
    new.verify(target, source, T_target_source)
    both_s = time.process_time()
    known.verify(target, source, T_target_source)
    return steps_s - started_s, fused_s - steps_s, both_s - fused_s, time.process_time() - both_s


def _percent(part: int, whole: int) -> str:
    return f"{100.0 * part / max(1, whole):.1f} %"


if __name__ == "__main__":
    main()
