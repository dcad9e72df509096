import pytest

from mapfusion.result import PairFusion
from mapfusion.steps import FusionStep, PairReport, Placement
from mapfusion.summary import Summary
from mapfusion.transform import SE2

FAR, NEAR, FITS = (
    PairFusion(accepted=False, reason="far", gate="chance", confidence=0.1),
    PairFusion(accepted=False, reason="near", gate="confidence", confidence=0.7),
    PairFusion(accepted=True, confidence=0.9, T_target_source=SE2(1.0, 0.0, 0.0)),
)
TOGETHER = {"a": Placement(1, SE2.identity()), "b": Placement(1, SE2(1.0, 0.0, 0.0))}


@pytest.mark.parametrize(
    ("looks", "placed", "verdict", "shown", "reason"),
    [
        ([NEAR, FAR], False, "refused", NEAR, "near"),
        ([FAR, FITS], False, "refused", FITS, "found once, and nothing confirmed it"),
        ([FITS, FAR], False, "refused", FAR, "far"),
        ([FITS, FAR], True, "joined", FITS, ""),
        ([NEAR, FAR], True, "placed", FAR, "far"),
    ],
)
def test_the_look_that_is_shown_is_one_at_what_is_said(
    looks: list[PairFusion], placed: bool, verdict: str, shown: PairFusion, reason: str
) -> None:
    summary = Summary()
    for stamp_ns, look in enumerate(looks):
        is_last = stamp_ns == len(looks) - 1
        placements = TOGETHER if placed and is_last else {}
        report = PairReport("a", "b", look, bool(placements), 0.0, 0.0)
        summary.add(FusionStep(stamp_ns, is_last, placements, {}, (report,), {}))
    (pair,) = summary.pairs_in_order
    assert (pair.verdict, pair.reason) == (verdict, reason)
    assert pair.fusion is shown
