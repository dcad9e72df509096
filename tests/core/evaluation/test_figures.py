from __future__ import annotations

import pytest

from mapfusion.evaluation.attempts import Attempt, Errors
from mapfusion.evaluation.figures import figures


def attempt(
    *,
    off_cells: float | None,
    accepted: bool = True,
    overlap_ratio: float = 0.5,
    rotation_deg: float = 0.0,
    confidence: float = 0.5,
    mae: float | None = 5.0,
    published_error: float | None = None,
) -> Attempt:
    """A related pair whose candidate is off by so much, or an unrelated one (None)."""
    return Attempt(
        generator="paper",
        seed=0,
        related=off_cells is not None,
        overlap_ratio=overlap_ratio if off_cells is not None else 0.0,
        rotation_deg=rotation_deg,
        profile="paper",
        accepted=accepted,
        gate="" if accepted else "mae",
        confidence=confidence,
        mae=mae,
        scale=1.0,
        published_error=published_error,
        published_accepted=None if published_error is None else published_error < 20.0,
        errors=None
        if off_cells is None
        else Errors(2.0 * off_cells, off_cells, 0.1 * off_cells, off_cells, 0.05 * off_cells),
    )


ATTEMPTS = [
    attempt(off_cells=1.0, overlap_ratio=0.8, rotation_deg=10.0, confidence=0.9, mae=2.0),
    attempt(off_cells=2.0, overlap_ratio=0.8, rotation_deg=180.0, confidence=0.8, mae=4.0),
    attempt(off_cells=4.0, overlap_ratio=0.2, rotation_deg=10.0, confidence=0.7, mae=6.0),
    attempt(off_cells=3.0, overlap_ratio=0.8, accepted=False, confidence=0.3, mae=25.0),
    attempt(off_cells=40.0, overlap_ratio=1.0, confidence=0.6, mae=18.0),
    attempt(off_cells=None, confidence=0.55, mae=19.0),
    attempt(off_cells=None, accepted=False, confidence=0.0, mae=60.0),
    attempt(off_cells=None, accepted=False, confidence=0.0, mae=None),
]


def test_counts() -> None:
    found = figures(ATTEMPTS, "paper", "paper")
    assert (found.num_related, found.num_unrelated) == (5, 3)
    assert (found.num_right, found.num_wrong, found.num_false_merges) == (3, 1, 1)
    assert found.num_right_candidates == 4
    assert found.num_right_by_corners == 2
    assert found.recall == pytest.approx(3 / 5)
    assert found.precision == pytest.approx(3 / 5)
    assert found.false_merge_rate == pytest.approx(1 / 3)


def test_bins_hold_every_related_pair_once() -> None:
    found = figures(ATTEMPTS, "paper", "paper")
    assert sum(b.num for b in found.recall_by_overlap) == 5
    assert [(b.num, b.num_right) for b in found.recall_by_overlap if b.num] == [(1, 1), (4, 2)]
    assert found.recall_by_overlap[-1].mean == pytest.approx((0.8 + 0.8 + 0.8 + 1.0) / 4)
    assert [(b.num, b.num_right) for b in found.recall_by_rotation if b.num] == [(4, 2), (1, 1)]
    assert found.recall_by_rotation[3].ratio is None


def test_quantiles() -> None:
    found = figures(ATTEMPTS, "paper", "paper")
    assert found.centre_error_cells is not None
    assert found.centre_error_cells.median == 2.0
    assert found.corner_error_cells is not None
    assert found.corner_error_cells.num == 3
    assert found.robot_error_cells is not None  # wrong joins count here
    assert found.robot_error_cells.num == 4
    assert found.robot_error_cells.p95 > 30.0
    assert found.mae_right is not None
    assert (found.mae_right.num, found.mae_right.median) == (4, 5.0)
    assert found.mae_wrong is not None
    assert found.mae_wrong.median == 18.0
    assert found.mae_unrelated is not None
    assert found.mae_unrelated.num == 2


def test_roc_counts_what_a_threshold_would_join() -> None:
    by_confidence = {p.confidence: p for p in figures(ATTEMPTS, "paper", "paper").roc}
    strict, middling, open_to_all = by_confidence[0.95], by_confidence[0.58], by_confidence[0.0]
    assert (strict.recall, strict.false_merge_rate, strict.precision) == (0.0, 0.0, None)
    assert middling.recall == pytest.approx(3 / 5)
    assert middling.false_merge_rate == 0.0
    assert middling.precision == pytest.approx(3 / 4)
    assert open_to_all.recall == pytest.approx(4 / 5)
    assert open_to_all.false_merge_rate == pytest.approx(2 / 3)


def test_reliability_compares_confidence_with_what_came_true() -> None:
    bins = {b.low: b for b in figures(ATTEMPTS, "paper", "paper").reliability}
    assert (bins[0.9].num, bins[0.9].num_right) == (1, 1)
    assert (bins[0.5].num, bins[0.5].num_right, bins[0.5].mean) == (1, 0, 0.55)
    assert sum(b.num for b in bins.values()) == 7


def test_refusals_are_counted_by_gate() -> None:
    (refusals,) = figures(ATTEMPTS, "paper", "paper").refusals
    assert (refusals.gate, refusals.num_related, refusals.num_unrelated) == ("mae", 1, 2)


def test_the_published_verdict_is_counted_apart() -> None:
    assert figures(ATTEMPTS, "paper", "paper").published is None
    judged = [
        attempt(off_cells=1.0, published_error=10.0),
        attempt(off_cells=1.0, published_error=21.0),
        attempt(off_cells=40.0, published_error=15.0, accepted=False),
        attempt(off_cells=None, published_error=12.0, accepted=False),
    ]
    found = figures(judged, "paper", "paper").published
    assert found is not None
    assert (found.num_right, found.num_wrong, found.num_false_merges) == (1, 1, 1)
    assert found.error_right is not None
    assert found.error_right.median == pytest.approx(15.5)


def test_other_profiles_and_generators_are_passed_over() -> None:
    found = figures(ATTEMPTS, "paper", "default")
    assert found.num_related == 0
    assert found.recall is None
    assert found.precision is None
    assert found.false_merge_rate is None
    assert found.mae_right is None
    assert all(p.recall is None for p in found.roc)
