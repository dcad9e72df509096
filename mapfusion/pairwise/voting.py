"""Hypotheses from features: an oriented keypoint match alone fixes a rigid motion, so each match votes.

Votes are cast for the rotation and for where the source's centre comes to lie: an error of the angle then moves a
vote by at most half the map's diagonal times that error. Source: the Hough transform as Lowe (IJCV 2004) uses it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mapfusion.compiled import compiled
from mapfusion.pairwise.features import Features
from mapfusion.pairwise.poses import Poses, pose_from_centre

NUM_NEIGHBOURS = 3
"""Repeated corners look alike: the right partner need not be the nearest."""
MAX_DISTANCE_BITS = 80
_ONE, _TWO, _FOUR, _TOP_BYTE = np.uint64(1), np.uint64(2), np.uint64(4), np.uint64(56)
_ALTERNATE_BITS, _ALTERNATE_PAIRS = np.uint64(0x5555555555555555), np.uint64(0x3333333333333333)
_ALTERNATE_FOURS, _EACH_BYTE = np.uint64(0x0F0F0F0F0F0F0F0F), np.uint64(0x0101010101010101)
Words = npt.NDArray[np.uint64]
ANGLE_BINS = 60
POSITION_BIN = 16.0
"""Edge of a bin of the centre's position, cells."""
_HASH_FACTOR = 0x1E3779B97F4A7C15
"""Spreads keys of bins over a table: 2^64 over the golden ratio, as far as it is positive in 64 bits.
Source: Knuth, The Art of Computer Programming 3, section 6.4."""


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
    pairs = _neighbours(source.descriptors.view(np.uint64), target.descriptors.view(np.uint64))
    of_source, of_target = np.divmod(np.sort(pairs), len(target))
    return Matches(of_target, of_source)


@compiled
def _neighbours(some: Words, others: Words) -> npt.NDArray[np.int64]:
    """Which of N descriptors (N, 4) and M others (M, 4) are near: each one's NUM_NEIGHBOURS nearest, if near enough.

    Of equal ones the first is nearer. Pairs come as flat indices of (N, M), each once, in no order.
    """
    of_some, of_others = np.full((len(some), NUM_NEIGHBOURS), -1), np.full((len(others), NUM_NEIGHBOURS), -1)
    bits_of_some, bits_of_others = np.full(of_some.shape, 1 << 16), np.full(of_others.shape, 1 << 16)
    for i in range(len(some)):
        a, b, c, d = some[i, 0], some[i, 1], some[i, 2], some[i, 3]
        for j in range(len(others)):
            bits = _num_bits(a ^ others[j, 0]) + _num_bits(b ^ others[j, 1])
            bits += _num_bits(c ^ others[j, 2]) + _num_bits(d ^ others[j, 3])
            if bits <= MAX_DISTANCE_BITS:
                _insert(of_some[i], bits_of_some[i], j, bits)
                _insert(of_others[j], bits_of_others[j], i, bits)
    found, number = np.empty(of_some.size + of_others.size, np.int64), 0
    for i in range(len(some)):
        for j in of_some[i]:
            if j >= 0:
                found[number] = i * len(others) + j
                number += 1
    for j in range(len(others)):
        for i in of_others[j]:
            if i >= 0 and not (of_some[i] == j).any():
                found[number] = i * len(others) + j
                number += 1
    return found[:number].copy()


@compiled
def _num_bits(word: np.uint64) -> int:
    """How many bits of 64 are set; one instruction. Source: Warren, Hacker's Delight, figure 5-2."""
    word -= word >> _ONE & _ALTERNATE_BITS
    word = (word & _ALTERNATE_PAIRS) + (word >> _TWO & _ALTERNATE_PAIRS)
    word = word + (word >> _FOUR) & _ALTERNATE_FOURS
    return int(word * _EACH_BYTE >> _TOP_BYTE)


@compiled
def _insert(nearest: npt.NDArray[np.int64], bits: npt.NDArray[np.int64], one: int, bits_of_one: int) -> None:
    """Puts one among the nearest, behind those that are as near."""
    at = len(nearest)
    while at > 0 and bits_of_one < bits[at - 1]:
        at -= 1
        if at + 1 < len(nearest):
            nearest[at + 1], bits[at + 1] = nearest[at], bits[at]
        nearest[at], bits[at] = one, bits_of_one


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
    turned = np.stack([c * lever[:, 0] - s * lever[:, 1], s * lever[:, 0] + c * lever[:, 1]], -1)
    centres = turned + target.points[matches.target].astype(np.float64)
    bins, slots, shares = _cast(theta, centres, centres.min(axis=0) - POSITION_BIN)
    best = _highest(bins, count)
    sin, cos, at = _means(theta, centres, slots, shares, best, len(bins))
    return pose_from_centre(np.arctan2(sin, cos), at, centre)


@compiled
def _cast(theta: Poses, centres: Poses, corner: Poses) -> tuple[Poses, npt.NDArray[np.int64], Poses]:
    """Votes for M rotations and places of the source's centre.

    Each is shared among the eight bins around it, so that a peak on a bin's border is not split.

    Args:
        theta: (M,) rotations, radians.
        centres: (M, 2) places, cells.
        corner: (2,) of the bins.

    Returns:
        (B,) sums of the shares in the bins that have any, in the order in which they were first voted for; (M, 8) bins
        that each vote is shared among, as indices of these; and its (M, 8) shares.
    """
    slots, shares = np.empty((len(theta), 8), np.int64), np.empty((len(theta), 8))
    size = 1
    while size < 16 * len(theta):
        size *= 2
    keys, index = np.full(size, -1), np.empty(size, np.int64)  # a hash table: most of the bins there might be are empty
    totals, number = np.empty(8 * len(theta)), 0
    for i in range(len(theta)):
        turn = theta[i] / (2.0 * math.pi) * ANGLE_BINS - 0.5
        at_x, at_y = (centres[i, 0] - corner[0]) / POSITION_BIN - 0.5, (centres[i, 1] - corner[1]) / POSITION_BIN - 0.5
        first_a, first_x, first_y = math.floor(turn), math.floor(at_x), math.floor(at_y)
        for which in range(8):
            da, dx, dy = which >> 2, which >> 1 & 1, which & 1
            share = abs(1 - da - (turn - first_a)) * abs(1 - dx - (at_x - first_x)) * abs(1 - dy - (at_y - first_y))
            key = (int(first_x + dx) << 32 | int(first_y + dy)) * ANGLE_BINS + int(first_a + da) % ANGLE_BINS
            slot = (key * _HASH_FACTOR >> 16) & size - 1
            while keys[slot] >= 0 and keys[slot] != key:
                slot = slot + 1 & size - 1
            if keys[slot] < 0:
                keys[slot], index[slot], totals[number] = key, number, 0.0
                number += 1
            totals[index[slot]] += share
            slots[i, which], shares[i, which] = index[slot], share
    return totals[:number].copy(), slots, shares


@compiled
def _means(
    theta: Poses,
    centres: Poses,
    slots: npt.NDArray[np.int64],
    shares: Poses,
    best: npt.NDArray[np.intp],
    num_bins: int,
) -> tuple[Poses, Poses, Poses]:
    """Weighted sums of the sines and cosines (K,) and means of the places (K, 2) of what voted for the best bins."""
    rank = np.full(num_bins, -1)
    rank[best] = np.arange(len(best))
    sin, cos, mass, at = np.zeros(len(best)), np.zeros(len(best)), np.zeros(len(best)), np.zeros((len(best), 2))
    for i in range(len(theta)):
        s, c = math.sin(theta[i]), math.cos(theta[i])
        for which in range(8):
            k, share = rank[slots[i, which]], shares[i, which]
            if k >= 0:
                sin[k] += share * s
                cos[k] += share * c
                mass[k] += share
                at[k, 0] += share * centres[i, 0]
                at[k, 1] += share * centres[i, 1]
    return sin, cos, at / np.maximum(mass, 1e-9).reshape(-1, 1)


def _highest(values: npt.NDArray[np.float64], count: int) -> npt.NDArray[np.intp]:
    """Indices of up to `count` of the values (N,), highest first; of equal ones the first is higher."""
    if len(values) > count:
        chosen = np.flatnonzero(values >= np.partition(values, -count)[-count])
    else:
        chosen = np.arange(len(values))
    return chosen[np.argsort(-values[chosen], kind="stable")][:count]
