"""Hypotheses from features."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mapfusion.pairwise.features import Features, detect
from mapfusion.pairwise.poses import moved
from mapfusion.pairwise.voting import MAX_DISTANCE_BITS, NUM_NEIGHBOURS, match, vote


def features(points: np.ndarray, angles: np.ndarray, seed: int = 0) -> Features:
    rng = np.random.default_rng(seed)
    descriptors = rng.integers(0, 256, (len(points), 32)).astype(np.uint8)
    return Features(points.astype(np.float32), angles.astype(np.float32), descriptors)


def test_votes_of_moved_keypoints_peak_at_the_motion() -> None:
    rng = np.random.default_rng(1)
    points, angles = rng.uniform(0, 300, (60, 2)), rng.uniform(0, 2 * math.pi, 60)
    pose = np.array([[40.0, 120.0, 2.1]])
    source = features(points, angles)
    target = Features(
        moved(pose, source.points)[0].T.copy(),
        np.remainder(source.angles_rad + np.float32(2.1), np.float32(2 * math.pi)),
        source.descriptors,
    )
    matches = match(target, source)
    best = vote(target, source, matches, points.mean(axis=0), 5)[0]
    there, expected = moved(best[None], source.points), moved(pose, source.points)
    assert np.abs(there - expected).max() < 3.0


@pytest.mark.parametrize("numbers", [(1, 1), (1, 5), (2, 7), (40, 30)])
def test_matches_are_the_nearest_of_either_side_within_the_limit(numbers: tuple[int, int]) -> None:
    rng = np.random.default_rng(sum(numbers))
    target, source = (features(np.zeros((n, 2)), np.zeros(n), seed) for seed, n in enumerate(numbers))
    for k in range(len(source)):  # near relatives, some of them a bit too far
        flipped = rng.choice(256, size=int(rng.integers(60, 95)), replace=False)
        bits = np.unpackbits(target.descriptors[k % len(target)])
        bits[flipped] ^= 1
        source.descriptors[k] = np.packbits(bits)
    source.descriptors[0] = target.descriptors[0] ^ 255  # all 256 bits differ
    bits = np.array([[int(np.unpackbits(a ^ b).sum()) for b in source.descriptors] for a in target.descriptors])
    expected = {(i, int(j)) for i, row in enumerate(bits) for j in np.argsort(row, kind="stable")[:NUM_NEIGHBOURS]}
    expected |= {(int(i), j) for j, row in enumerate(bits.T) for i in np.argsort(row, kind="stable")[:NUM_NEIGHBOURS]}
    matches = match(target, source)
    found = list(zip(matches.target.tolist(), matches.source.tolist(), strict=True))
    assert len(found) == len(set(found))
    assert set(found) == {(i, j) for i, j in expected if bits[i, j] <= MAX_DISTANCE_BITS}


def test_no_features_give_no_hypotheses() -> None:
    none = detect(np.zeros((50, 50), np.bool_))
    some = features(np.array([[10.0, 10.0]]), np.zeros(1))
    assert len(none) == 0
    assert len(match(none, some)) == len(match(some, none)) == 0
    assert vote(none, some, match(none, some), np.zeros(2), 10).shape == (0, 3)


def test_keypoints_are_counted_from_the_corner_of_the_map() -> None:
    walls = np.zeros((120, 160), np.bool_)
    walls[40:80, 60:110] = True
    points = detect(walls).points
    corners = np.array([[60.0, 40.0], [110.0, 40.0], [60.0, 80.0], [110.0, 80.0]])
    away = np.linalg.norm(points[:, None] - corners[None], axis=-1)
    assert (away.min(axis=0) < 4.0).all()
