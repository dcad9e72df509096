"""What the diagnostics say of a pair."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mapfusion.result import PairFusion
from mapfusion.steps import FusionStep, Placement
from mapfusion.transform import SE2
from mapfusion_io.pair_report import groups_status, pair_covariance, pair_fields, pair_status
from tests.io.fake_steps import START_NS, make_acceptance, make_pair, make_refusal


@pytest.mark.parametrize(
    ("fusion", "placed", "ok", "message"),
    [
        (make_acceptance(), True, True, "joined"),
        (make_refusal(), True, True, "joined, though not by this look: only 3 matches, 10 are needed"),
        (make_acceptance(), False, False, "not joined yet: this look fits, and a second one has to find the same"),
        (make_refusal(), False, False, "only 3 matches, 10 are needed"),
    ],
)
def test_a_pair_is_fine_when_it_is_joined(fusion: PairFusion, placed: bool, ok: bool, message: str) -> None:
    status = pair_status(make_pair("robot1", "robot2", fusion, placed=placed))
    assert (status.name, status.ok, status.message) == ("mapfusion/robot1/robot2", ok, message)


def test_values_are_short_and_empty_where_there_is_none() -> None:
    fusion = PairFusion(
        accepted=False,
        reason="r",
        gate="g",
        T_target_source=SE2(1 / 3, -0.0, math.pi),
        overlap_cells=1_234_567,
        covariance=np.diag([1e-4, 2.5e-5, 0.0]),
        evidence={"share": np.float64(0.1) + 0.2, "count": 12_345_678},
    )
    values = pair_status(make_pair("a", "b", fusion)).values
    assert (values["x_m"], values["y_m"], values["yaw_deg"]) == ("0.333333", "0", "180")
    assert (values["overlap_cells"], values["accepted"], values["gate"]) == ("1234567", "false", "g")
    assert values["covariance"] == "0.0001 0 0 0 2.5e-05 0 0 0 0"
    assert (values["evidence.share"], values["evidence.count"]) == ("0.3", "12345678")
    assert values["mae"] == values["scale"] == values["rival_x_m"] == ""


def test_no_candidate_has_no_numbers() -> None:
    report = make_pair("a", "b", make_refusal())
    fields = pair_fields(report)
    assert all(math.isnan(float(fields[name])) for name in ("mae", "scale", "x_m", "y_m", "yaw_deg", "rival_yaw_deg"))
    assert np.isnan(pair_covariance(report)).all()
    assert pair_status(report).values["covariance"] == ""


def test_groups_name_their_members() -> None:
    placements = {
        "r1": Placement(1, SE2.identity()),
        "r2": Placement(2, SE2.identity()),
        "r3": Placement(1, SE2(1, 2, 0)),
    }
    status = groups_status(FusionStep(START_NS, False, placements, {}, (), {}, changes=("r3 joins", "r2 parts")))
    assert (status.name, status.ok, status.message) == ("mapfusion/groups", True, "r3 joins; r2 parts")
    assert status.values == {"group 1": "r1, r3", "group 2": "r2"}
