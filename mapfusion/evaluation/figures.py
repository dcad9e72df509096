"""What many attempts say about a profile: recall, false merges, accuracy, and how far its confidence can be trusted."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mapfusion.config import Profile
from mapfusion.evaluation.attempts import Attempt
from mapfusion.evaluation.pairs import Generator

OVERLAP_EDGES = (0.0, 0.15, 0.3, 0.4, 0.5, 0.6, 0.7, 1.0)
ROTATION_EDGES_DEG = tuple(float(edge) for edge in range(0, 181, 15))
CONFIDENCE_EDGES = tuple(k / 10 for k in range(11))
ROC_CONFIDENCES = tuple(k / 100 for k in range(100, -1, -1))


@dataclass(frozen=True, slots=True)
class Bin:
    """Attempts whose value lies in [low, high), the last bin with its upper edge, and how many of them are right.

    Attributes:
        low: Lower edge.
        high: Upper edge.
        num: Attempts.
        num_right: Those of them that count as right.
        mean: Mean of their values; None without one.
    """

    low: float
    high: float
    num: int
    num_right: int
    mean: float | None

    @property
    def ratio(self) -> float | None:
        """Share of the right ones; None without an attempt."""
        return self.num_right / self.num if self.num else None


@dataclass(frozen=True, slots=True)
class Quantiles:
    """Of a sample of `num` values."""

    num: int
    p05: float
    p25: float
    median: float
    p75: float
    p95: float


@dataclass(frozen=True, slots=True)
class RocPoint:
    """What would follow if joins were made from this confidence on.

    Attributes:
        confidence: Least confidence of a join.
        recall: Right joins / related pairs; None without a related pair.
        false_merge_rate: Joins of unrelated pairs / unrelated pairs; None without one.
        precision: Right joins / joins of any pair; None without a join.
    """

    confidence: float
    recall: float | None
    false_merge_rate: float | None
    precision: float | None


@dataclass(frozen=True, slots=True)
class PublishedVerdict:
    """What the paper's published code makes of candidates by its own error figure.

    Attributes:
        num_right: Related pairs that it would have joined rightly.
        num_wrong: Related pairs that it would have joined wrongly.
        num_false_merges: Unrelated pairs that it would have joined.
        error_right: Its error of right candidates, grey levels.
        error_wrong: Its error of wrong candidates of related pairs.
        error_unrelated: Its error of the candidates of unrelated pairs.
    """

    num_right: int
    num_wrong: int
    num_false_merges: int
    error_right: Quantiles | None
    error_wrong: Quantiles | None
    error_unrelated: Quantiles | None


@dataclass(frozen=True, slots=True)
class Refusals:
    """How many pairs a gate refused."""

    gate: str
    num_related: int
    num_unrelated: int


@dataclass(frozen=True, slots=True)
class Figures:
    """A profile on the pairs of a generator.

    Attributes:
        generator: Where the pairs come from.
        profile: Who fused them.
        num_related: Pairs of one place.
        num_unrelated: Pairs of two places.
        num_right_candidates: Related pairs whose best candidate was right, accepted or not.
        num_right: Related pairs that were joined rightly.
        num_wrong: Related pairs that were joined wrongly.
        num_false_merges: Unrelated pairs that were joined.
        num_right_by_corners: Related pairs that were joined with a corner error of at most 5 cells.
        recall_by_overlap: Right joins by overlap of the maps.
        recall_by_rotation: Right joins by rotation between the maps, degrees.
        corner_error_cells: Of the right joins (experiment 4.1).
        centre_error_cells: Of the right joins.
        angle_error_deg: Of the right joins.
        robot_error_cells: Of all joins of related pairs, wrong ones too (experiment 4.2).
        robot_error_m: Likewise.
        scale_right: Scale that the matches of right candidates would like; the truth is 1.
        mae_right: MAE of right candidates, accepted or not.
        mae_wrong: MAE of wrong candidates of related pairs.
        mae_unrelated: MAE of the candidates of unrelated pairs.
        published: The verdict of the paper's published code on the same candidates; None where the profile does not
            give it.
        refusals: How often each gate refused.
        roc: For thresholds of the confidence from 1 down to 0.
        reliability: Candidates by confidence, and how many of them are right.
    """

    generator: Generator
    profile: Profile
    num_related: int
    num_unrelated: int
    num_right_candidates: int
    num_right: int
    num_wrong: int
    num_false_merges: int
    num_right_by_corners: int
    recall_by_overlap: tuple[Bin, ...]
    recall_by_rotation: tuple[Bin, ...]
    corner_error_cells: Quantiles | None
    centre_error_cells: Quantiles | None
    angle_error_deg: Quantiles | None
    robot_error_cells: Quantiles | None
    robot_error_m: Quantiles | None
    scale_right: Quantiles | None
    mae_right: Quantiles | None
    mae_wrong: Quantiles | None
    mae_unrelated: Quantiles | None
    published: PublishedVerdict | None
    refusals: tuple[Refusals, ...]
    roc: tuple[RocPoint, ...]
    reliability: tuple[Bin, ...]

    @property
    def recall(self) -> float | None:
        """Right joins / related pairs; None without a related pair."""
        return self.num_right / self.num_related if self.num_related else None

    @property
    def precision(self) -> float | None:
        """Right joins / joins of any pair; None without a join."""
        num_joined = self.num_right + self.num_wrong + self.num_false_merges
        return self.num_right / num_joined if num_joined else None

    @property
    def false_merge_rate(self) -> float | None:
        """Joins of unrelated pairs / unrelated pairs; None without one."""
        return self.num_false_merges / self.num_unrelated if self.num_unrelated else None


def figures(attempts: Iterable[Attempt], generator: Generator, profile: Profile) -> Figures:
    """The figures of one profile on one generator's pairs; other attempts are passed over."""
    mine = [a for a in attempts if a.generator == generator and a.profile == profile]
    related, unrelated = [a for a in mine if a.related], [a for a in mine if not a.related]
    joined = [a for a in related if a.accepted and a.errors is not None]
    right = [a for a in joined if a.right]
    candidates = [a for a in mine if a.mae is not None]
    return Figures(
        generator=generator,
        profile=profile,
        num_related=len(related),
        num_unrelated=len(unrelated),
        num_right_candidates=sum(a.right for a in related),
        num_right=len(right),
        num_wrong=len(joined) - len(right),
        num_false_merges=sum(a.accepted for a in unrelated),
        num_right_by_corners=sum(a.errors is not None and a.errors.corners_cells <= 5.0 for a in joined),
        recall_by_overlap=_bins(related, OVERLAP_EDGES, lambda a: a.overlap_ratio, _rightly_joined),
        recall_by_rotation=_bins(related, ROTATION_EDGES_DEG, lambda a: a.rotation_deg, _rightly_joined),
        corner_error_cells=_quantiles(a.errors.corners_cells for a in right if a.errors),
        centre_error_cells=_quantiles(a.errors.centre_cells for a in right if a.errors),
        angle_error_deg=_quantiles(a.errors.angle_deg for a in right if a.errors),
        robot_error_cells=_quantiles(a.errors.robot_cells for a in joined if a.errors),
        robot_error_m=_quantiles(a.errors.robot_m for a in joined if a.errors),
        scale_right=_quantiles(a.scale for a in related if a.scale is not None and a.right),
        mae_right=_quantiles(a.mae for a in related if a.mae is not None and a.right),
        mae_wrong=_quantiles(a.mae for a in related if a.mae is not None and not a.right),
        mae_unrelated=_quantiles(a.mae for a in unrelated if a.mae is not None),
        published=_published(mine),
        refusals=_refusals(mine),
        roc=_roc(candidates, len(related), len(unrelated)),
        reliability=_bins(candidates, CONFIDENCE_EDGES, lambda a: a.confidence, lambda a: a.right),
    )


def _published(attempts: Sequence[Attempt]) -> PublishedVerdict | None:
    judged = [a for a in attempts if a.published_accepted is not None]
    if not judged:
        return None
    with_error = [(a, a.published_error) for a in judged if a.published_error is not None]
    return PublishedVerdict(
        num_right=sum(bool(a.published_accepted) and a.right for a in judged),
        num_wrong=sum(bool(a.published_accepted) and a.related and not a.right for a in judged),
        num_false_merges=sum(bool(a.published_accepted) and not a.related for a in judged),
        error_right=_quantiles(error for a, error in with_error if a.right),
        error_wrong=_quantiles(error for a, error in with_error if a.related and not a.right),
        error_unrelated=_quantiles(error for a, error in with_error if not a.related),
    )


def _refusals(attempts: Sequence[Attempt]) -> tuple[Refusals, ...]:
    refused = [(a.gate, a.related) for a in attempts if not a.accepted]
    gates = sorted({gate for gate, _ in refused})
    return tuple(Refusals(gate, refused.count((gate, True)), refused.count((gate, False))) for gate in gates)


def _rightly_joined(attempt: Attempt) -> bool:
    return attempt.accepted and attempt.right


def _bins(
    attempts: Sequence[Attempt],
    edges: Sequence[float],
    value: Callable[[Attempt], float],
    right: Callable[[Attempt], bool],
) -> tuple[Bin, ...]:
    bins = []
    for low, high in pairwise(edges):
        inside = [a for a in attempts if low <= value(a) < high or (high == edges[-1] and value(a) == high)]
        mean = float(np.mean([value(a) for a in inside])) if inside else None
        bins.append(Bin(low, high, len(inside), sum(map(right, inside)), mean))
    return tuple(bins)


def _quantiles(values: Iterable[float]) -> Quantiles | None:
    sample = np.array(list(values))
    if sample.size == 0:
        return None
    return Quantiles(sample.size, *(float(q) for q in np.quantile(sample, (0.05, 0.25, 0.5, 0.75, 0.95))))


def _roc(candidates: Sequence[Attempt], num_related: int, num_unrelated: int) -> tuple[RocPoint, ...]:
    points = []
    for confidence in ROC_CONFIDENCES:
        joined = [a for a in candidates if a.confidence >= confidence]
        num_right = sum(a.right for a in joined)
        points.append(
            RocPoint(
                confidence=confidence,
                recall=num_right / num_related if num_related else None,
                false_merge_rate=sum(not a.related for a in joined) / num_unrelated if num_unrelated else None,
                precision=num_right / len(joined) if joined else None,
            )
        )
    return tuple(points)
