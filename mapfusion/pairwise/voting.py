"""Hypotheses from features: an oriented keypoint match alone fixes a rigid motion, so each match votes.

Votes are cast for the rotation and for where the source's centre comes to lie: an error of the angle then moves a
vote by at most half the map's diagonal times that error. Source: the Hough transform as Lowe (IJCV 2004) uses it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mapfusion.pairwise.features import Features
from mapfusion.pairwise.poses import Poses, pose_from_centre

NUM_NEIGHBOURS = 3
"""Repeated corners look alike: the right partner need not be the nearest."""
MAX_DISTANCE_BITS = 80
ANGLE_BINS = 60
POSITION_BIN = 16.0
"""Edge of a bin of the centre's position, cells."""


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """Pairs of keypoints that look alike.

    Attributes:
        target: (M,) index into the target's features.
        source: (M,) index into the source's features.
    """

    target: npt.NDArray[np.intp]
    source: npt.NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.target)


def match(target: Features, source: Features) -> Matches:
    """The nearest neighbours in both directions, each pair once."""
    if not len(target) or not len(source):
        none = np.zeros(0, np.intp)
        return Matches(none, none)
    bits = _differing_bits(source, target)
    pairs = np.concatenate([_nearest(bits), _nearest(np.ascontiguousarray(bits.T))[:, ::-1]])
    of_source, of_target = np.divmod(np.unique(pairs[:, 0] * len(target) + pairs[:, 1]), len(target))
    return Matches(of_target, of_source)


def _differing_bits(some: Features, others: Features) -> npt.NDArray[np.uint16]:
    """(N, M) in how many bits the descriptors of N features differ from those of M others."""
    here, there = (np.ascontiguousarray(one.descriptors.view(np.uint64).T) for one in (some, others))
    bits = np.zeros((len(some), len(others)), np.uint16)
    for word, other in zip(here, there, strict=True):
        bits += np.bitwise_count(word[:, None] ^ other)
    return bits


def _nearest(bits: npt.NDArray[np.uint16]) -> npt.NDArray[np.intp]:
    """(K, 2) row and column of the NUM_NEIGHBOURS least of each row of (N, M), as far as they are near enough."""
    left, rows = bits.copy(), np.arange(len(bits))
    found = []
    for _ in range(NUM_NEIGHBOURS):
        columns = left.argmin(axis=1)
        near = left[rows, columns] <= MAX_DISTANCE_BITS
        found.append(np.stack([rows[near], columns[near]], -1))
        left[rows, columns] = np.iinfo(left.dtype).max
    return np.concatenate(found)


def turns(target: Features, source: Features, matches: Matches) -> npt.NDArray[np.float64]:
    """(M,) by how much matched keypoints turn from the source to the target, radians, not reduced to a whole turn."""
    return (target.angles_rad[matches.target] - source.angles_rad[matches.source]).astype(np.float64)


def vote(target: Features, source: Features, matches: Matches, centre: Poses, count: int) -> Poses:
    """Up to `count` poses (K, 3) with the most votes, best first; `centre` (2,) is the source's, in cells."""
    if not len(matches):
        return np.zeros((0, 3))
    theta = turns(target, source, matches)
    c, s = np.cos(theta), np.sin(theta)
    lever = centre - source.points[matches.source]
    centres = target.points[matches.target] + np.stack(
        [c * lever[:, 0] - s * lever[:, 1], s * lever[:, 0] + c * lever[:, 1]], -1
    )
    angle_at = np.remainder(theta, 2 * math.pi) * (ANGLE_BINS / (2 * math.pi))
    corner = centres.min(axis=0) - POSITION_BIN
    place_at = (centres - corner) / POSITION_BIN
    num_x, num_y = (int(n) + 3 for n in place_at.max(axis=0))
    keys, shares = [], []
    # Each vote is shared among the eight bins around it, so that a peak on a bin's border is not split.
    for da in (0, 1):
        a = np.floor(angle_at - 0.5).astype(np.int64) + da
        wa = 1.0 - np.abs(angle_at - 0.5 - a)
        for dx in (0, 1):
            x = np.floor(place_at[:, 0] - 0.5).astype(np.int64) + dx
            wx = wa * (1.0 - np.abs(place_at[:, 0] - 0.5 - x))
            for dy in (0, 1):
                y = np.floor(place_at[:, 1] - 0.5).astype(np.int64) + dy
                keys.append((np.remainder(a, ANGLE_BINS) * num_x + x) * num_y + y)
                shares.append(wx * (1.0 - np.abs(place_at[:, 1] - 0.5 - y)))
    key, weight = np.concatenate(keys), np.concatenate(shares)
    bins, inverse = np.unique(key, return_inverse=True)
    total = np.bincount(inverse, weight)
    best = _highest(np.asarray(total, np.float64), count)
    rank = np.full(len(bins), -1)
    rank[best] = np.arange(len(best))
    slot = rank[inverse]
    inside = slot >= 0
    slot, weight = slot[inside], weight[inside]
    member = np.tile(np.arange(len(theta)), 8)[inside]
    mass = np.maximum(np.bincount(slot, weight, len(best)), 1e-9)
    mean_x, mean_y = (np.bincount(slot, weight * centres[member, i], len(best)) / mass for i in (0, 1))
    sin, cos = (np.bincount(slot, weight * f(theta[member]), len(best)) for f in (np.sin, np.cos))
    return pose_from_centre(np.arctan2(sin, cos), np.stack([mean_x, mean_y], -1), centre)


def _highest(values: npt.NDArray[np.float64], count: int) -> npt.NDArray[np.intp]:
    """Indices of up to `count` of the values (N,), highest first; of equal ones the first is higher."""
    if len(values) > count:
        chosen = np.flatnonzero(values >= np.partition(values, -count)[-count])
    else:
        chosen = np.arange(len(values))
    return chosen[np.argsort(-values[chosen], kind="stable")][:count]
