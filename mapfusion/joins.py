"""What is known about every pair of robots over time: looked at when, joined or not, and whether that still holds."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from mapfusion.newest import NewestGrid
from mapfusion.pairwise.verdict import REFUSED_CONFIDENCE
from mapfusion.posegraph import Edge, Pair, pair_key, strongest
from mapfusion.result import PairFusion
from mapfusion.steps import Placement, natural_key
from mapfusion.timeline import Snapshot
from mapfusion.transform import SE2

OVERWHELMING = 0.999
"""From this confidence on a fusion joins at once; below it a second look must agree."""
LET_GO_CONFIDENCE = 0.2
"""A held join whose transform falls below this is contradicted. Lower than what joins: hysteresis."""
MAX_CONTRADICTIONS = 2
"""So many contradicted looks in a row end a join, and so many searches in a row that do not find it again, where maps
repeat themselves."""
SAME_M, SAME_RAD = 0.5, np.radians(5.0)
"""Two looks within this, at the middle of b's area, found the same transform."""
GROWTH = 0.1
SEARCH_AGAIN_NS = 10_000_000_000
NEAR_MISS_CONFIDENCE = 0.2
"""A refused pair is searched again when one of its maps has changed its known area by this share, but not before this
time, unless the refusal was as near as this to a join: young maps grow fast, and share too little yet."""
THOROUGH_GROWTH = 7.0
"""A search is thorough where one of the maps has grown by this share since the pair's last thorough search or its
first one, where it is to confirm a candidate or to find a doubted join again, and where no map changes any more."""
SEARCH_HELD_GROWTH = 1.0
"""A joined pair is searched again when one of its maps has grown by this share: what is only verified stands against no
rivals, and those of a small map may not have been in it."""
CONFIRM_REPEATING_GROWTH = 1.0
"""Where maps repeat themselves, a second look that finds the same confirms it only when one of them has grown by this
share since the first: before that it sees the same parts once more."""
MAX_THOROUGH = 2
"""So many searches of a snapshot are thorough."""
MAX_LAST_THOROUGH = 16
"""So many of the last snapshot."""
NUM_TIES = 3
"""So many joins of a robot are followed; with more, every further one costs and adds hardly anything."""
MAX_SEARCHES = 4
"""So many pairs are searched at a snapshot, those of which most has changed; the others wait. Bounds N squared work."""
DISPUTED_OVERLAP = 0.2
DISPUTING_GATES = ("contradiction", "mae")
"""Maps that overlap this far where other robots place them, and contradict each other there, are searched as well."""
AMBIGUOUS_GATES = ("ambiguous", "repeats")
"""A search that one of these gates refuses found another transform as likely."""
REPEATING, NEAR_LIKE_FIT = 0.35, -1.0
"""Maps repeat themselves where more than the first of the walls that agree have their like elsewhere in one map. Where
an alignment that follows from that fits no worse than by the second, later maps will say which of them it is."""
FOLLOW_NEW, FOLLOW_TURNED = 0.1, 0.25
FOLLOW_NS = 30_000_000_000
"""A join is verified anew when this share of a map is new, when walls came and went in known cells that are this share
of its walls, and at the latest after this time."""
SETTLED_NS = 10_000_000_000
"""A fusion that nothing confirmed or contradicted for this long, because no map changed, joins."""


class Look(NamedTuple):
    """What is to be done about a pair: search for a transform, or verify a known one.

    Attributes:
        pair: The robots, the fusion's target first.
        T_a_b: The transform to verify, None for a search.
        found: The search that found the transform, where it was one.
        is_thorough: Whether a thorough search is to follow where a quick one finds nothing.
    """

    pair: Pair
    T_a_b: SE2 | None
    found: PairFusion | None = None
    is_thorough: bool = False


@dataclass(slots=True)
class _PairState:
    """What is known of one pair.

    Attributes:
        versions: Of the two grids when the pair was looked at last.
        looked_ns: When that was.
        looked_changes: By then, `num_new` and `num_turned` of the two robots' grids, see `NewestGrid`.
        searched_ns: When it was searched last.
        searched_cells: Known cells of the two grids then.
        thorough_cells: The same of its last thorough search, of its first search before there was one.
        was_thorough: Whether its last search was thorough.
        is_near_miss: Whether its last search came near to a join.
        candidate: An accepted fusion that waits for confirmation, and since when.
        candidate_cells: Known cells of the two grids when it was found first.
        is_confirmed: Whether it has it, or needs none.
        edge: The join, while it holds.
        found: The search that led to it.
        contradictions: Looks in a row that contradicted it.
        ambiguities: Searches in a row that did not find it again, of maps that repeat themselves.
        is_repeating: Whether a search found that the maps repeat themselves, or fit another way as well: a transform
            that is only verified is worth nothing then.
        is_disputed: Whether the place that its join, or other robots, give the two does not look right between them.
    """

    versions: tuple[int, int] = (0, 0)
    looked_ns: int = 0
    looked_changes: tuple[int, ...] = (0, 0, 0, 0)
    searched_ns: int = 0
    searched_cells: tuple[int, int] | None = None
    thorough_cells: tuple[int, int] | None = None
    was_thorough: bool = False
    is_near_miss: bool = False
    candidate: tuple[PairFusion, int] | None = None
    candidate_cells: tuple[int, int] = (0, 0)
    is_confirmed: bool = False
    edge: Edge | None = None
    found: PairFusion | None = None
    contradictions: int = 0
    ambiguities: int = 0
    is_repeating: bool = False
    is_disputed: bool = False


@dataclass(slots=True)
class Joins:
    """Joins of all pairs over time.

    Attributes:
        never: Pairs that are not looked at.
        has_thorough: Whether there is a thorough search.
    """

    never: Collection[frozenset[str]] = ()
    has_thorough: bool = True
    _states: dict[Pair, _PairState] = field(default_factory=dict)

    def due(self, snapshot: Snapshot, placements: Mapping[str, Placement]) -> list[Look]:
        """The pairs that are to be looked at, in natural order.

        A pair is looked at when enough of a map of it changed: a joined one is verified, as is one whose robots are
        tied over others while they have few joins; any other is searched, a few pairs at a time, and searched
        thoroughly when nothing changes any more. So is one whose join the last look did not find right, or whose maps
        repeat themselves: a transform that is only verified stands against no rivals, and these come with the maps'
        growth. The last snapshot looks at every pair of which anything changed.
        """
        held = self.held
        num_ties = Counter(robot for pair in held for robot in pair)
        looks: list[Look] = []
        searches: list[tuple[float, Pair]] = []
        for pair in combinations(sorted(snapshot.grids, key=natural_key), 2):
            state = self._states.setdefault(pair, _PairState())
            if frozenset(pair) in self.never:
                continue
            T_a_b = held[pair].T_a_b if pair in held else _predicted(pair, placements)
            if state.versions == _versions(pair, snapshot):
                if T_a_b is None and self.has_thorough and _is_settled(state, snapshot):
                    searches.append((0.0, pair))
                continue
            growth = math.inf if state.searched_cells is None else _grown(state.searched_cells, pair, snapshot)
            may_search = state.is_near_miss or snapshot.stamp_ns - state.searched_ns >= SEARCH_AGAIN_NS
            has_grown = growth > GROWTH and (may_search or state.searched_cells is None)
            is_waiting = state.candidate is not None and (has_grown or not state.is_repeating)
            if pair in held:
                is_to_search = self.has_thorough and _is_worth_searching(state, snapshot, growth, has_grown)
            else:
                is_doubted = state.is_disputed and has_grown and (state.edge is None or self.has_thorough)
                is_to_search = is_doubted or is_waiting
            if T_a_b is not None:
                is_wanted = pair in held or min(num_ties[robot] for robot in pair) < NUM_TIES
                if snapshot.is_last or (is_wanted and _is_worth_following(state, pair, snapshot)):
                    looks.append(Look(pair, T_a_b, state.found))
            if is_to_search or (T_a_b is None and (snapshot.is_last or is_waiting or has_grown)):
                searches.append((growth, pair))
        chosen = self._searches(searches, snapshot)
        searched = {look.pair for look in chosen}
        looks = [look for look in looks if look.pair not in searched] + chosen
        return sorted(looks, key=lambda look: pair_key(look.pair))

    def _searches(self, wanted: list[tuple[float, Pair]], snapshot: Snapshot) -> list[Look]:
        """The wanted searches that a snapshot has time for, those of which most has changed; the others stay due."""
        wanted = sorted(wanted, key=lambda search: -search[0])
        chosen = [pair for _, pair in wanted][: None if snapshot.is_last else MAX_SEARCHES]
        worth_all = [pair for pair in chosen if self.has_thorough and _is_worth_all(self._states[pair], pair, snapshot)]
        thorough = worth_all[: MAX_LAST_THOROUGH if snapshot.is_last else MAX_THOROUGH]
        # A quick search of maps that did not change would find what it found before.
        changed = [pair for pair in chosen if self._states[pair].versions != _versions(pair, snapshot)]
        return [
            Look(pair, None, is_thorough=pair in thorough) for pair in chosen if pair in thorough or pair in changed
        ]

    def record(self, look: Look, fusion: PairFusion, snapshot: Snapshot) -> str:
        """Takes note of a look; says so where a join ended."""
        state = self._states[look.pair]
        state.versions = _versions(look.pair, snapshot)
        if state.edge is None or look.T_a_b is not None or fusion.accepted:  # else the join is still to be verified
            state.looked_ns, state.looked_changes = snapshot.stamp_ns, _changes(look.pair, snapshot)
        if state.edge is not None and look.T_a_b is not None:
            return self._follow(state, look.pair, fusion, snapshot)
        if look.T_a_b is not None:  # tied over others: a fusion that holds is one more measurement
            is_one_more = fusion.accepted and not state.is_repeating
            state.edge = _edge(look.pair, fusion, snapshot) if is_one_more else None
            state.is_disputed = fusion.gate in DISPUTING_GATES and fusion.overlap_ratio >= DISPUTED_OVERLAP
            return ""
        state.searched_ns = snapshot.stamp_ns
        state.searched_cells, state.was_thorough = _known_cells(look.pair, snapshot), look.is_thorough
        if look.is_thorough or state.thorough_cells is None:
            state.thorough_cells = state.searched_cells
        if "recurring" in fusion.evidence:
            state.is_repeating = fusion.evidence["recurring"] > REPEATING
        if state.edge is not None:
            return self._challenge(state, look, fusion, snapshot)
        self._consider(look.pair, fusion, snapshot)
        return ""

    def ripe(self, snapshot: Snapshot) -> dict[Pair, PairFusion]:
        """The candidates that may join: confirmed, or nothing will confirm them, as no map changes or the mission ends.

        In natural order.
        """
        ripe = {}
        for pair, state in self._states.items():
            if state.candidate is not None:
                fusion, since_ns = state.candidate
                is_settled = snapshot.stamp_ns - since_ns >= SETTLED_NS
                if state.is_repeating:  # that nobody had time for it is not enough
                    is_settled &= state.versions == _versions(pair, snapshot)
                if state.is_confirmed or snapshot.is_last or is_settled:
                    ripe[pair] = fusion
        return {pair: ripe[pair] for pair in sorted(ripe, key=pair_key)}

    def join(self, pair: Pair, fusion: PairFusion, snapshot: Snapshot) -> str:
        """Joins a pair by a fusion; says so."""
        state = self._states[pair]
        state.candidate, state.contradictions, state.ambiguities, state.found = None, 0, 0, fusion
        state.is_near_miss = state.is_disputed = False
        state.edge = _edge(pair, fusion, snapshot)
        return f"{pair[0]} and {pair[1]} join"

    def refuse(self, pair: Pair, fusion: PairFusion) -> None:
        """Takes note of a refusal, so that the pair is searched again when enough has changed."""
        state = self._states[pair]
        state.candidate = None
        state.is_near_miss = fusion.confidence >= NEAR_MISS_CONFIDENCE

    @property
    def held(self) -> dict[Pair, Edge]:
        """The joins that hold, in natural order; of many, those that tie everything and each robot's strongest."""
        edges = {pair: state.edge for pair, state in self._states.items() if state.edge is not None}
        return strongest(edges, NUM_TIES)

    def found(self, pair: Pair) -> PairFusion | None:
        """The search that a pair's join came of; None where there was none."""
        return self._states[pair].found if pair in self._states else None

    def drop(self, pair: Pair) -> None:
        """Ends a join, so that the pair is searched anew."""
        state = self._states[pair]
        self._states[pair] = _PairState(versions=state.versions, is_repeating=state.is_repeating)

    def _consider(self, pair: Pair, fusion: PairFusion, snapshot: Snapshot) -> None:
        state = self._states[pair]
        if fusion.accepted:
            is_found_again = _confirms(state, pair, fusion, snapshot)
            if not is_found_again:
                state.candidate_cells = _known_cells(pair, snapshot)
            if state.is_repeating:
                has_grown = _grown(state.candidate_cells, pair, snapshot) >= CONFIRM_REPEATING_GROWTH
                state.is_confirmed = is_found_again and has_grown
            else:
                state.is_confirmed = is_found_again or fusion.confidence >= OVERWHELMING
            state.candidate = (fusion, snapshot.stamp_ns)
        else:
            self.refuse(pair, fusion)

    def _follow(self, state: _PairState, pair: Pair, fusion: PairFusion, snapshot: Snapshot) -> str:
        state.is_disputed = not fusion.accepted
        if fusion.accepted:
            state.edge, state.contradictions = _edge(pair, fusion, snapshot), 0
        elif fusion.confidence >= LET_GO_CONFIDENCE:
            state.contradictions = 0
        else:
            state.contradictions += 1
            if state.contradictions >= MAX_CONTRADICTIONS:
                self.drop(pair)
                return f"the join of {pair[0]} and {pair[1]} ends: {fusion.reason}"
        return ""

    def _challenge(self, state: _PairState, look: Look, fusion: PairFusion, snapshot: Snapshot) -> str:
        """Takes note of a search of a joined pair."""
        assert state.edge is not None
        pair, ends = look.pair, f"the join of {look.pair[0]} and {look.pair[1]} ends: "
        is_same = _is_same(state.edge.T_a_b, fusion.T_target_source, pair, snapshot)
        if fusion.accepted and is_same:
            state.found, state.ambiguities = fusion, 0
            return self._follow(state, pair, fusion, snapshot)
        if fusion.accepted:
            self.drop(pair)
            self._consider(pair, fusion, snapshot)
            self._states[pair].is_confirmed = False  # by nobody but itself
            return ends + "a search puts them elsewhere"
        is_lost = look.is_thorough and fusion.T_target_source is not None and not is_same
        state.is_repeating |= fusion.gate in AMBIGUOUS_GATES
        state.ambiguities += state.is_repeating and (fusion.gate in AMBIGUOUS_GATES or is_lost)
        if state.ambiguities >= MAX_CONTRADICTIONS:
            self.drop(pair)
            return ends + fusion.reason
        return ""


def held_back(fusion: PairFusion) -> PairFusion:
    """The fusion of a search, refused where maps repeat themselves and the like of what agrees fits nearly as well.

    Of two maps alone nothing more will be known, but a mission's maps grow.
    """
    evidence = fusion.evidence
    like_fit = evidence.get("like_fit", -np.inf)
    if not fusion.accepted or evidence.get("recurring", 0.0) <= REPEATING or like_fit <= NEAR_LIKE_FIT:
        return fusion
    reason = (
        f"{evidence['recurring']:.0%} of the walls that agree have their like elsewhere in the same map, and an "
        f"alignment that follows from that fits nearly as well (by {like_fit:.1f}, at most {NEAR_LIKE_FIT:g} is wanted)"
    )
    trust = min(fusion.confidence, REFUSED_CONFIDENCE)
    return replace(fusion, accepted=False, gate="alike", reason=reason, confidence=trust)


def _is_settled(state: _PairState, snapshot: Snapshot) -> bool:
    """Whether a pair of which nothing has changed since it was searched in vain is to be searched thoroughly."""
    waited = snapshot.is_last or snapshot.stamp_ns - state.looked_ns >= SETTLED_NS
    return waited and not state.was_thorough and state.candidate is None


def _is_worth_all(state: _PairState, pair: Pair, snapshot: Snapshot) -> bool:
    """Whether a search of the pair is to be thorough."""
    is_to_be_sure = state.candidate is not None or (
        state.edge is not None and (state.is_disputed or state.is_repeating)
    )
    if snapshot.is_last or is_to_be_sure or state.versions == _versions(pair, snapshot):
        return True
    return state.thorough_cells is not None and _grown(state.thorough_cells, pair, snapshot) >= THOROUGH_GROWTH


def _is_worth_searching(state: _PairState, snapshot: Snapshot, growth: float, has_grown: bool) -> bool:
    """Whether a joined pair is to be searched again; one that a look contradicted is to be looked at as it is first."""
    if state.contradictions and not state.is_repeating:
        return False
    if state.is_disputed or state.is_repeating:
        return has_grown or snapshot.is_last
    return state.searched_cells is not None and growth >= SEARCH_HELD_GROWTH


def _is_worth_following(state: _PairState, pair: Pair, snapshot: Snapshot) -> bool:
    if snapshot.stamp_ns - state.looked_ns >= FOLLOW_NS or state.contradictions > 0:
        return True
    new_a, turned_a, new_b, turned_b = np.subtract(_changes(pair, snapshot), state.looked_changes)
    a, b = (snapshot.grids[robot] for robot in pair)
    return bool(_is_changed(a, new_a, turned_a) or _is_changed(b, new_b, turned_b))


def _is_changed(newest: NewestGrid, num_new: int, num_turned: int) -> bool:
    return num_new > FOLLOW_NEW * newest.num_known or num_turned > FOLLOW_TURNED * newest.num_walls


def _confirms(state: _PairState, pair: Pair, fusion: PairFusion, snapshot: Snapshot) -> bool:
    """Whether a fusion found what the waiting candidate found."""
    if state.candidate is None:
        return False
    return _is_same(state.candidate[0].T_target_source, fusion.T_target_source, pair, snapshot)


def _is_same(one: SE2 | None, other: SE2 | None, pair: Pair, snapshot: Snapshot) -> bool:
    """Whether two looks found the same transform."""
    if one is None or other is None:
        return False
    middle = snapshot.grids[pair[1]].middle_m
    apart_m = float(np.hypot(*(one.apply(middle) - other.apply(middle))))
    return apart_m <= SAME_M and one.distance_to(other)[1] <= SAME_RAD


def _edge(pair: Pair, fusion: PairFusion, snapshot: Snapshot) -> Edge:
    if fusion.T_target_source is None:
        raise ValueError("an accepted fusion needs a transform")
    return Edge(fusion.T_target_source, fusion.confidence, fusion.covariance, snapshot.grids[pair[1]].middle_m)


def _predicted(pair: Pair, placements: Mapping[str, Placement]) -> SE2 | None:
    """T_a_b of two robots of one group."""
    a, b = (placements.get(robot) for robot in pair)
    if a is None or b is None or a.group != b.group:
        return None
    return a.T_group_map.inverse() @ b.T_group_map


def _grown(before: tuple[int, int], pair: Pair, snapshot: Snapshot) -> float:
    """By which share the known area of one of the two maps has changed, the larger share."""
    now = _known_cells(pair, snapshot)
    return max(abs(n - old) / max(old, 1) for n, old in zip(now, before, strict=True))


def _versions(pair: Pair, snapshot: Snapshot) -> tuple[int, int]:
    return snapshot.grids[pair[0]].version, snapshot.grids[pair[1]].version


def _known_cells(pair: Pair, snapshot: Snapshot) -> tuple[int, int]:
    return snapshot.grids[pair[0]].num_known, snapshot.grids[pair[1]].num_known


def _changes(pair: Pair, snapshot: Snapshot) -> tuple[int, ...]:
    a, b = (snapshot.grids[robot] for robot in pair)
    return a.num_new, a.num_turned, b.num_new, b.num_turned
