"""Whether a fusion is to be trusted: in a number, and in words."""

from __future__ import annotations

import math

import numpy as np

from mapfusion.config import FusionConfig
from mapfusion.pairwise.agreement import Agreement
from mapfusion.pairwise.evidence import DEPENDENT_CELLS
from mapfusion.pairwise.prepared import PreparedMap
from mapfusion.pairwise.search import Finding
from mapfusion.result import PairFusion
from mapfusion.transform import SE2, FloatArray

MIN_WALL_CELLS = 40
"""A map with less wall than this beside free space says nothing."""
MIN_EVIDENCE = 25.0
"""Net evidence below which agreement is no better than what a search finds between any two maps."""
MIN_CONDITIONING = 0.03
"""Least smallest / largest eigenvalue of what the agreeing walls fix of the translation."""
MAX_CONTRADICTION = 0.45
"""Most walls in the other map's free space, as a share of what chance would put there."""
MIN_DISTINCTNESS = 2.2
"""A different alignment with more than 1 / this of the evidence makes a pair ambiguous, whatever the confidence.

Measured on views of loops that look alike after half a turn: there the wrong alignment reaches 2.1 times the evidence
of the right one.
"""
KNOWN_DISTINCTNESS = 3.0
"""Taken for a transform that is only verified, whose rivals were weighed when it was found."""
MAX_SLACK_DEGREES = 2.0
"""Most rotation that may be open where the maps, bent or small, are explained as well by neighbouring alignments."""
ENOUGH_LINES = 32.0
"""More walls than this say nothing more: large maps have many, wherever they lie."""
ENOUGH_DISTINCTNESS = 4.0
"""A rival with less than 1 / this of the evidence is none."""
MIN_CONFIDENCE = 0.9
REFUSED_CONFIDENCE = 0.5
"""Most confidence that is left where a gate refuses: of two alignments that fit alike, at most one is right."""
MIN_RESIDUAL_CELLS = 0.3
"""Cells are no points: walls are not placed better than this."""

BIAS = -11.85
WEIGHT_EVIDENCE = 0.418
WEIGHT_DISTINCTNESS = 4.146
WEIGHT_AGREEMENT = 3.39
WEIGHT_CONTRADICTION = -4.31
WEIGHT_CRISP_CONTRADICTION = -6.0
WEIGHT_OVERLAP = 1.017
WEIGHT_LINES = 2.0
"""Weights of the logistic model of `confidence`; benchmarks/RESULTS.md says what they were fitted on."""


def too_little(target: PreparedMap, source: PreparedMap) -> PairFusion | None:
    """The refusal of maps that cannot be compared at all; None where they can."""
    for prepared, name in ((target, "one"), (source, "other")):
        walls = 0 if prepared.field is None else len(prepared.field.surface)
        if walls < MIN_WALL_CELLS:
            return PairFusion(
                accepted=False,
                reason=f"too few walls: the {name} map has {walls} wall cells beside free space, "
                f"at least {MIN_WALL_CELLS} are needed",
                gate="few walls",
                resolution_m=target.grid.resolution_m,
            )
    return None


def judge(
    target: PreparedMap,
    source: PreparedMap,
    config: FusionConfig,
    finding: Finding,
    T_target_source: SE2,
    rival: SE2 | None,
    cells: Agreement,
) -> PairFusion:
    """The verdict on the best pose that was found, `T_target_source`, and its rival."""
    confidence = _confidence(finding)
    gate, reason = _refusal(config, finding, confidence, cells)
    if gate and gate != "confidence":
        confidence = min(confidence, REFUSED_CONFIDENCE)
    return PairFusion(
        accepted=not gate,
        reason=reason,
        gate=gate,
        T_target_source=T_target_source,
        confidence=confidence,
        mae=cells.mae,
        overlap_ratio=cells.overlap_ratio,
        overlap_cells=cells.overlap_cells,
        num_keypoints_target=finding.num_keypoints[0],
        num_keypoints_source=finding.num_keypoints[1],
        num_matches=finding.num_matches,
        num_inliers=finding.num_inliers,
        covariance=_covariance(target, source, finding, T_target_source),
        resolution_m=target.grid.resolution_m,
        rival=rival if gate == "ambiguous" else None,
        evidence={
            **finding.figures,
            "distinctness": _distinctness(finding),
            "slack_deg": math.degrees(finding.slack_rad),
        },
    )


def _distinctness(finding: Finding) -> float:
    """Net evidence over that of the best different alignment, at most ENOUGH_DISTINCTNESS."""
    if finding.rival_net is None:
        return KNOWN_DISTINCTNESS
    return min(max(finding.figures["net"], 1e-9) / max(finding.rival_net, 1e-9), ENOUGH_DISTINCTNESS)


def _confidence(finding: Finding) -> float:
    """Logistic model; each figure is held to the range in which it tells right from wrong."""
    figures = finding.figures
    # Walls that fit to a cell have no bend to excuse what contradicts.
    crispness = min(figures["ratio_fine"] / max(figures["ratio"], 1e-3), 1.0)
    x = (
        BIAS
        + WEIGHT_EVIDENCE * math.log(max(figures["net"], 1.0))
        + WEIGHT_DISTINCTNESS * math.log(_distinctness(finding))
        + WEIGHT_AGREEMENT * figures["ratio"]
        + WEIGHT_CONTRADICTION * figures["contradiction"]
        + WEIGHT_CRISP_CONTRADICTION * figures["contradiction_fine"] * crispness**2
        + WEIGHT_OVERLAP * math.log(min(max(figures["mutual_ratio"], 0.01), 0.6))
        + WEIGHT_LINES * math.log(min(max(figures["lines"], 1.0), ENOUGH_LINES))
    )
    return 1.0 / (1.0 + math.exp(-x))


def _refusal(config: FusionConfig, finding: Finding, confidence: float, cells: Agreement) -> tuple[str, str]:
    """Gate and reason; both empty where nothing speaks against the fusion."""
    figures, distinctness = finding.figures, _distinctness(finding)
    agreement = f"{figures['ratio']:.0%} of the walls in the common area agree, {figures['chance']:.0%} would by chance"
    if cells.mae is None:
        return "no overlap", "the best alignment leaves no cell that both maps know"
    if config.mae_threshold is not None and cells.mae >= config.mae_threshold:
        return "mae", f"mean absolute error {cells.mae:.1f} grey levels, not below {config.mae_threshold:g}"
    if figures["net"] < MIN_EVIDENCE:
        return "chance", f"agreement is no better than what a search finds between unrelated maps: {agreement}"
    if figures["contradiction"] > MAX_CONTRADICTION:
        return "contradiction", (
            f"walls stand in the other map's free space, {figures['contradiction']:.0%} of what chance would put there "
            f"(at most {MAX_CONTRADICTION:.0%}); {agreement}"
        )
    if figures["conditioning"] < MIN_CONDITIONING:
        return "one direction", (
            "walls agree in one direction only: a straight wall or corridor fixes nothing along itself "
            f"(constraint along / across {figures['conditioning']:.3f}, at least {MIN_CONDITIONING} is needed)"
        )
    if distinctness < MIN_DISTINCTNESS:
        return "ambiguous", (
            "a second, different alignment explains the maps almost as well "
            f"({1.0 / distinctness:.2f} of the evidence, at most {1.0 / MIN_DISTINCTNESS:.2f}); the best: {agreement}"
        )
    if finding.slack_rad > math.radians(MAX_SLACK_DEGREES):
        return "imprecise", (
            f"alignments that differ by {math.degrees(finding.slack_rad):.1f} degrees fit equally well "
            f"(at most {MAX_SLACK_DEGREES:g}): the maps are bent, or their common area is too small to fix the rotation"
        )
    if confidence < MIN_CONFIDENCE:
        return "confidence", (
            f"not sure enough ({confidence:.2f}, at least {MIN_CONFIDENCE} is needed): {agreement}, along about "
            f"{figures['lines']:.0f} different wall faces, "
            f"{figures['mutual_ratio']:.0%} of the smaller map in common, walls in the other's free space "
            f"{figures['contradiction']:.0%} of chance, the best different alignment has "
            f"{1.0 / distinctness:.2f} of the evidence"
        )
    return "", ""


def _covariance(target: PreparedMap, source: PreparedMap, finding: Finding, T_target_source: SE2) -> FloatArray:
    """(3, 3) of (x_m, y_m, yaw_rad) in the target's frame.

    The information matrix counts wall cells; neighbouring ones err together, so DEPENDENT_CELLS of them count as one.
    """
    resolution_m = target.grid.resolution_m
    variance = DEPENDENT_CELLS * max(finding.figures["residual_cells"], MIN_RESIDUAL_CELLS) ** 2
    at_centre = variance * np.linalg.inv(finding.information + 1e-3 * np.eye(3))
    turn = SE2(0.0, 0.0, target.grid.T_frame_grid.yaw_rad).matrix()
    to_metres = turn * np.array([resolution_m, resolution_m, 1.0])
    # The centre's position and the yaw were estimated; the translation follows as centre - R(yaw) arm.
    centre = source.grid.T_frame_grid.apply(source.centre * resolution_m)
    arm = SE2(0.0, 0.0, T_target_source.yaw_rad).apply(centre)
    lever = np.array([[1.0, 0.0, arm[1]], [0.0, 1.0, -arm[0]], [0.0, 0.0, 1.0]])
    jacobian = lever @ to_metres
    result: FloatArray = jacobian @ at_centre @ jacobian.T
    return result
