"""Fusing pairs with known truth, and how far each result is off."""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial

import numpy as np

from mapfusion.config import FusionConfig, Profile
from mapfusion.evaluation.pairs import Generator, StudyPair, make_pair
from mapfusion.fusion import fuse_pair
from mapfusion.grid import OccupancyGrid, crop_to_known
from mapfusion.transform import SE2, FloatArray

RIGHT_CELLS = 5.0
"""A transform is right when it puts the middle of the source's known area less than this many cells off ..."""
RIGHT_DEG = 2.0
"""... and turns it by less than this many degrees too far."""


@dataclass(frozen=True, slots=True)
class Study:
    """What is tried.

    Attributes:
        generators: Where the pairs come from.
        num_related: Pairs of one place, for each generator.
        num_unrelated: Pairs of two places, for each generator.
        seed: Seed of all pairs, >= 0. A pair depends on it, its generator, kind and number only.
        profiles: Profiles that fuse every pair.
    """

    generators: tuple[Generator, ...] = ("paper", "floor-plans")
    num_related: int = 200
    num_unrelated: int = 200
    seed: int = 0
    profiles: tuple[Profile, ...] = ("paper", "default")

    def __post_init__(self) -> None:
        if self.num_related < 0 or self.num_unrelated < 0 or self.seed < 0:
            raise ValueError(
                f"pairs ({self.num_related} and {self.num_unrelated}) and seed ({self.seed}) must not be negative"
            )

    @property
    def num_attempts(self) -> int:
        """Pairs times profiles."""
        return len(self.generators) * (self.num_related + self.num_unrelated) * len(self.profiles)


@dataclass(frozen=True, slots=True)
class Errors:
    """How far a transform is off the truth, accepted or not.

    Attributes:
        corners_cells: Mean displacement of the corners of the source's known area (experiment 4.1).
        centre_cells: Displacement of the middle (mean) of the source's known cells.
        angle_deg: Rotation too much or too little, >= 0.
        robot_cells: Displacement of a robot somewhere in the source (experiment 4.2).
        robot_m: The same in metres.
    """

    corners_cells: float
    centre_cells: float
    angle_deg: float
    robot_cells: float
    robot_m: float

    @property
    def right(self) -> bool:
        """Whether the maps are joined as they should be."""
        return self.centre_cells < RIGHT_CELLS and self.angle_deg < RIGHT_DEG


@dataclass(frozen=True, slots=True)
class Attempt:
    """One pair by one profile.

    Attributes:
        generator: Where the pair comes from.
        seed: The pair's own seed, for `make_pair`.
        related: Whether both maps show one place.
        overlap_ratio: Area known in both / known area of the smaller map; 0 for unrelated maps.
        rotation_deg: True rotation between the maps' grids, [0, 180]; 0 for unrelated maps.
        profile: Who tried.
        accepted: Whether the maps were joined.
        gate: Which gate refused.
        confidence: As the profile gave it.
        mae: As the profile gave it, grey levels; None without a common cell.
        scale: As the matches would like it; None where it was not fitted.
        published_error: The error by the paper's published code, grey levels; None where the profile does not give it.
        published_accepted: Whether that code would have joined the maps; None where the profile does not say.
        errors: How far the best candidate is off; None for unrelated maps and where there was no candidate.
    """

    generator: Generator
    seed: int
    related: bool
    overlap_ratio: float
    rotation_deg: float
    profile: Profile
    accepted: bool
    gate: str
    confidence: float
    mae: float | None
    scale: float | None
    published_error: float | None
    published_accepted: bool | None
    errors: Errors | None

    @property
    def right(self) -> bool:
        """Whether the best candidate is right, accepted or not."""
        return self.errors is not None and self.errors.right


def run_study(study: Study, executor: Executor | None = None) -> Iterator[Attempt]:
    """All attempts of a study, one after the other in a fixed order, with or without an executor.

    A pair's attempts follow each other in the order of `study.profiles`; related pairs come before unrelated ones.
    """
    pairs = [
        (generator, related, _pair_seed(study.seed, generator, related, number))
        for generator in study.generators
        for related, count in ((True, study.num_related), (False, study.num_unrelated))
        for number in range(count)
    ]
    work = partial(attempt_pair, profiles=study.profiles)
    chunks = map(work, pairs) if executor is None else executor.map(work, pairs, chunksize=4)
    for attempts in chunks:
        yield from attempts


def attempt_pair(which: tuple[Generator, bool, int], profiles: tuple[Profile, ...]) -> tuple[Attempt, ...]:
    """Makes the pair of (generator, related, seed) and lets every profile try it."""
    pair = make_pair(*which)
    return tuple(_attempt(which, pair, profile) for profile in profiles)


def _attempt(which: tuple[Generator, bool, int], pair: StudyPair, profile: Profile) -> Attempt:
    generator, related, seed = which
    result = fuse_pair(pair.target, pair.source, FusionConfig(profile=profile))
    published = result.evidence.get("published_accepted")
    truth, found = pair.T_target_source, result.T_target_source
    return Attempt(
        generator=generator,
        seed=seed,
        related=related,
        overlap_ratio=pair.overlap_ratio,
        rotation_deg=0.0 if truth is None else _rotation_deg(pair, truth),
        profile=profile,
        accepted=result.accepted,
        gate=result.gate,
        confidence=result.confidence,
        mae=result.mae,
        scale=result.scale,
        published_error=result.evidence.get("published_error"),
        published_accepted=None if published is None else published > 0.5,
        errors=None if truth is None or found is None else _errors(pair, truth, found),
    )


def _pair_seed(seed: int, generator: Generator, related: bool, number: int) -> int:
    return int(np.random.SeedSequence([seed, number, int(related), *generator.encode()]).generate_state(1)[0])


def _rotation_deg(pair: StudyPair, truth: SE2) -> float:
    """Rotation between the grids: what the images see, wherever the frames are."""
    between_grids = pair.target.T_frame_grid.inverse() @ truth @ pair.source.T_frame_grid
    return math.degrees(abs(between_grids.yaw_rad))


def _errors(pair: StudyPair, truth: SE2, found: SE2) -> Errors:
    source, cell_m = pair.source, pair.source.resolution_m

    def off_m(points_m: FloatArray) -> float:
        return float(np.linalg.norm(found.apply(points_m) - truth.apply(points_m), axis=-1).mean())

    robot_m = off_m(np.array([[pair.T_source_robot.x_m, pair.T_source_robot.y_m]]))
    return Errors(
        corners_cells=off_m(_corners_m(crop_to_known(source))) / cell_m,
        centre_cells=off_m(source.centres_m(source.known).mean(axis=0, keepdims=True)) / cell_m,
        angle_deg=math.degrees(found.distance_to(truth)[1]),
        robot_cells=robot_m / cell_m,
        robot_m=robot_m,
    )


def _corners_m(grid: OccupancyGrid) -> FloatArray:
    """(4, 2) outer corners of a grid in its frame, metres."""
    corners = np.array([[0, 0], [grid.width, 0], [grid.width, grid.height], [0, grid.height]], float)
    return grid.T_frame_grid.apply(corners * grid.resolution_m)
