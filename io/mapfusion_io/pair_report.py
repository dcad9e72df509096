"""What is told about a pair of robots, under one set of names wherever it is told."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mapfusion.steps import FusionStep, PairReport
from mapfusion.transform import SE2, FloatArray

Value = bool | int | float | str


@dataclass(frozen=True, slots=True)
class Status:
    """A line of the diagnostics.

    Attributes:
        name: Whom it is about.
        ok: Whether all is as one would like it.
        message: In words.
        values: Figures as text by name, an empty text where there is none.
    """

    name: str
    ok: bool
    message: str
    values: Mapping[str, str]


def pair_fields(report: PairReport) -> dict[str, Value]:
    """The scalar fields of mapfusion_msgs/msg/PairFusion by name, in its units; NaN for what does not exist."""
    fusion = report.fusion
    return {
        "a": report.a,
        "b": report.b,
        "accepted": fusion.accepted,
        "placed": report.placed,
        "reason": fusion.reason,
        "gate": fusion.gate,
        "confidence": fusion.confidence,
        "mae": math.nan if fusion.mae is None else fusion.mae,
        "overlap_ratio": fusion.overlap_ratio,
        "overlap_cells": fusion.overlap_cells,
        "keypoints_a": fusion.num_keypoints_target,
        "keypoints_b": fusion.num_keypoints_source,
        "matches": fusion.num_matches,
        "inliers": fusion.num_inliers,
        "scale": math.nan if fusion.scale is None else fusion.scale,
        **_transform_fields("", fusion.T_target_source),
        "age_a_s": report.age_a_s,
        "age_b_s": report.age_b_s,
        "resolution_m": fusion.resolution_m,
        **_transform_fields("rival_", fusion.rival),
    }


def pair_covariance(report: PairReport) -> FloatArray:
    """(9,) covariance of (x_m, y_m, yaw_rad) of T_a_b, row major; NaN where there is none."""
    covariance = report.fusion.covariance
    return np.full(9, math.nan) if covariance is None else np.asarray(covariance, dtype=np.float64).reshape(9)


def pair_status(report: PairReport) -> Status:
    """The pair's line: fine when both robots are in one group, whether by this look or by others."""
    fusion = report.fusion
    values = {name: _text(value) for name, value in pair_fields(report).items()}
    values["covariance"] = " ".join(_text(float(value)) for value in pair_covariance(report)).strip()
    values |= {f"evidence.{name}": _text(value) for name, value in fusion.evidence.items()}
    if report.placed:
        message = "joined" if fusion.accepted else f"joined, though not by this look: {fusion.reason}"
    else:
        message = (
            "not joined yet: this look fits, and a second one has to find the same"
            if fusion.accepted
            else fusion.reason
        )
    return Status(f"mapfusion/{report.a}/{report.b}", report.placed, message, values)


def groups_status(step: FusionStep) -> Status:
    """The line for a snapshot at which groups formed, met or parted: what changed, and who is together now."""
    members: dict[str, list[str]] = {}
    for robot, placement in step.placements.items():
        members.setdefault(f"group {placement.group}", []).append(robot)
    return Status("mapfusion/groups", True, "; ".join(step.changes), {k: ", ".join(v) for k, v in members.items()})


def _transform_fields(prefix: str, T: SE2 | None) -> dict[str, Value]:
    x_m, y_m, yaw_rad = (math.nan, math.nan, math.nan) if T is None else (T.x_m, T.y_m, T.yaw_rad)
    return {f"{prefix}x_m": x_m, f"{prefix}y_m": y_m, f"{prefix}yaw_deg": math.degrees(yaw_rad)}


def _text(value: Value) -> str:
    """A short form that depends on the value only; empty for NaN."""
    if isinstance(value, str):
        return value
    if isinstance(value, bool):
        return "true" if value else "false"
    if math.isnan(value):
        return ""
    return f"{value + 0.0:.6g}" if isinstance(value, float) else str(value)  # + 0.0 turns -0 into 0
