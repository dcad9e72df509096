"""What is known about every pair of robots: when it was looked at last, and whether it is joined."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

from mapfusion.result import PairFusion
from mapfusion.steps import natural_key
from mapfusion.timeline import NewestGrid
from mapfusion.transform import SE2

Pair = tuple[str, str]


@dataclass(frozen=True, slots=True)
class Join:
    """An accepted fusion that holds.

    Attributes:
        T_a_b: Takes points of b's map frame to a's.
        confidence: Of the fusion it rests on, [0, 1].
    """

    T_a_b: SE2
    confidence: float


class Joins:
    """Joins of all pairs over time. A refused look does not end a join: the maps were seen to agree before."""

    def __init__(self) -> None:
        self._joins: dict[Pair, Join] = {}
        self._seen: dict[Pair, tuple[int, int]] = {}

    def due(self, grids: Mapping[str, NewestGrid]) -> list[Pair]:
        """Pairs of which a map changed since they were looked at, in natural order."""
        robots = sorted(grids, key=natural_key)
        return [
            (a, b) for a, b in combinations(robots, 2) if self._seen.get((a, b)) != (grids[a].version, grids[b].version)
        ]

    def record(self, pair: Pair, grids: Mapping[str, NewestGrid], fusion: PairFusion) -> None:
        """Takes note of a look at a pair, its first robot being the fusion's target."""
        self._seen[pair] = (grids[pair[0]].version, grids[pair[1]].version)
        if fusion.accepted and fusion.T_target_source is not None:
            self._joins[pair] = Join(fusion.T_target_source, fusion.confidence)

    @property
    def held(self) -> Mapping[Pair, Join]:
        """The joins that hold, by pair."""
        return self._joins

    def guess(self, pair: Pair) -> SE2 | None:
        """T_a_b from an earlier snapshot."""
        join = self._joins.get(pair)
        return None if join is None else join.T_a_b
