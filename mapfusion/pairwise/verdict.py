"""Whether a fusion is to be trusted: in a number, and in words."""

from __future__ import annotations

import math

import numpy as np

from mapfusion.config import FusionConfig
from mapfusion.pairwise.agreement import Agreement
from mapfusion.pairwise.confidence import (
    MAX_FIRMNESS,
    MAX_MARGIN,
    MIN_CONFIDENCE,
    MIN_FIRMNESS,
    RIGID_RATIO,
    RIGID_TOLERANCE_CELLS,
    Figures,
    confidence,
    fits_better,
)
from mapfusion.pairwise.evidence import DEPENDENT_CELLS, MIN_EVIDENCE, TOLERANCES_CELLS
from mapfusion.pairwise.prepared import MIN_WALL_CELLS, PreparedMap
from mapfusion.pairwise.search import SLIDING_CONDITIONING, Finding
from mapfusion.result import PairFusion
from mapfusion.transform import SE2, FloatArray

MIN_CONDITIONING = 0.03
"""Least smallest / largest eigenvalue of what the agreeing walls fix of the translation."""
MIN_TURNING = 0.05
"""Least hold of the agreeing walls on the rotation: a square has 0.25, a circle drawn in cells 0.003."""
MAX_CONTRADICTION, SOME_CONTRADICTION = 0.6, 0.2
"""Most walls in the other map's free space, as a share of what chance would put there; the share from which on more
evidence is asked for."""
MAX_STRAY_M = 6.0
"""Longest run of wall that may stand in the other map's free space where walls agree within three cells: longer things
are not moved. Bent maps draw walls further apart."""
MIN_MARGIN, SLIDING_MARGIN = 0.5, 2.0
"""Least margin over the nearest different alignment: below it the two are the same to us. The second where the walls
hold one direction so weakly that the pose may slide."""
KNOWN_MARGIN = 3.0
"""Taken for a transform that is only verified, whose rivals were weighed when it was found."""
MIN_RATIO = 0.2
"""Least share of the walls in the common area that must agree, however few would by chance."""
SMALL_OVERLAP = 0.4
"""Maps that share less than this of the smaller one share little."""
MORE_EVIDENCE = 70.0
"""Few walls, or walls that agree loosely only, need so much evidence where maps share less than SMALL_OVERLAP of the
smaller one, as the less they share the more ways there are to share it, and where they contradict each other without
agreeing closely. So do few walls that agree loosely, which leave the pose loose."""
SURE = 0.92
"""Confidence from which on many walls that agree loosely need no more evidence though the maps contradict each other.
Maps that share little need it where they contradict each other too, or do not agree closely; and maps that are not bent
where they contradict each other and less than RIGID_RATIO of their walls agree: two buildings with a like outline."""
MUCH_OPPOSITE, VERY_SURE = 0.1, 0.95
"""With more than this share of walls on walls seen from the other side so much confidence is needed: either maps are so
noisy that their walls show both sides, and tell less, or these are neighbours' walls."""
FEW_LINES, FEW_LOOSE_LINES = 8.0, 12.0
"""Fewer walls are few: as many as two things have. The second where they agree loosely."""
MIN_RATIO_OF_FEW, MUCH_EVIDENCE = 0.9, 100.0
"""Where maps share little, and few walls of it, nearly all of the walls must agree, and not loosely, or long ones: two
things that stand alike in both are no place yet. Walls that agree closely need MORE_EVIDENCE only."""
LEAST_FIRMNESS = {1.5: 0.1, 3.0: 0.2, 6.0: 0.0}
"""Least firmness by the tolerance, cells, within which walls agree. Bent maps have little of it, and so have long
straight walls, whose parts stay nowhere; but those agree closely."""
MOST_RECURRING, MIN_REST_RATIO, LIKE_FIT = 0.5, 0.4, -3.0
"""Where more than the first of the walls that agree recur within one of the maps, at least the second of those that do
not must agree, and along DEPENDENT_CELLS of wall, unless all alignments that follow fit worse by more than the third:
in a maze every wall has its like, but together they fit nowhere else."""
SLIGHT_CONTRADICTION, STRONG_RIVAL = 0.02, 0.5
"""Maps that contradict each other by more than this share of chance, or have a rival with more than this share of the
evidence, are asked whether they repeat themselves."""
REFUSED_CONFIDENCE = 0.5
"""Most confidence that is left where a gate refuses: of two alignments that fit alike, at most one is right."""


def too_little(target: PreparedMap, source: PreparedMap) -> PairFusion | None:
    """The refusal of maps that cannot be compared at all; None where they can."""
    for prepared, name in ((target, "one"), (source, "other")):
        if prepared.num_walls < MIN_WALL_CELLS:
            return PairFusion(
                accepted=False,
                reason=f"too few walls: the {name} map has {prepared.num_walls} wall cells beside free space, "
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
    figures = finding.best.figures
    trust = confidence(figures, _margin(finding))
    gate, reason = _refusal(config, finding, trust, cells)
    if gate and gate != "confidence":
        trust = min(trust, REFUSED_CONFIDENCE)
    return PairFusion(
        accepted=not gate,
        reason=reason,
        gate=gate,
        T_target_source=T_target_source,
        confidence=trust,
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
        evidence={**figures, "margin": _margin(finding), "rival_ratio": _rival_ratio(finding)},
    )


def _margin(finding: Finding) -> float:
    return finding.margin if finding.is_searched else KNOWN_MARGIN


def _rival_ratio(finding: Finding) -> float:
    """Net evidence of the rival / that of the best alignment; 0 without a rival."""
    return 0.0 if finding.rival is None else finding.rival.figures["net"] / max(finding.best.figures["net"], 1.0)


def _refusal(config: FusionConfig, finding: Finding, trust: float, cells: Agreement) -> tuple[str, str]:
    """Gate and reason; both empty where nothing speaks against the fusion."""
    figures = finding.best.figures
    agreement = f"{figures['ratio']:.0%} of the walls in the common area agree, {figures['chance']:.0%} would by chance"
    if cells.mae is None:
        return "no overlap", "the best alignment leaves no cell that both maps know"
    if config.mae_threshold is not None and cells.mae >= config.mae_threshold:
        return "mae", f"mean absolute error {cells.mae:.1f} grey levels, not below {config.mae_threshold:g}"
    least = least_evidence(figures, trust)
    if figures["net"] < least:
        return "chance", (
            "agreement is no better than what a search finds between unrelated maps: "
            f"{agreement} (evidence {figures['net']:.0f}, at least {least:.0f} is needed "
            f"with {figures['mutual_ratio']:.0%} of the smaller map in common, walls in the other's free space at "
            f"{figures['contradiction']:.0%} of chance, about {figures['lines']:.0f} different walls within "
            f"{figures['tolerance_cells']:g} cells)"
        )
    if figures["ratio"] < MIN_RATIO:
        return "chance", f"too few walls agree: {agreement}, at least {MIN_RATIO:.0%} must"
    if figures["contradiction"] > MAX_CONTRADICTION:
        return "contradiction", (
            f"walls stand in the other map's free space, {figures['contradiction']:.0%} of what chance would put there "
            f"(at most {MAX_CONTRADICTION:.0%}); {agreement}"
        )
    stray_m = figures["stray_cells"] * cells.resolution_m
    if stray_m > MAX_STRAY_M and not _is_loose(figures):
        return "contradiction", (
            f"a wall of {stray_m:.1f} m strays through the other map's free space (at most {MAX_STRAY_M:g} m may), "
            f"while others agree within {figures['tolerance_cells']:g} cells; {agreement}"
        )
    if are_few_things(figures):
        return "chance", (
            f"one or two things that stand alike in both maps: about {figures['lines']:.0f} different walls agree and "
            f"{figures['mutual_ratio']:.0%} of the smaller map is in common, so {MIN_RATIO_OF_FEW:.0%} of the walls "
            f"would have to, or the evidence to be {MUCH_EVIDENCE:.0f} (is {figures['net']:.0f}); {agreement}"
        )
    if figures["conditioning"] < MIN_CONDITIONING:
        return "one direction", (
            "walls agree in one direction only: a straight wall or corridor fixes nothing along itself "
            f"(constraint along / across {figures['conditioning']:.3f}, at least {MIN_CONDITIONING} is needed)"
        )
    if figures["turning"] < MIN_TURNING:
        return "one direction", (
            "what agrees is round: it fixes no rotation "
            f"(hold on the rotation {figures['turning']:.3f}, at least {MIN_TURNING} is needed)"
        )
    least_margin = SLIDING_MARGIN if figures["conditioning"] < SLIDING_CONDITIONING else MIN_MARGIN
    least_trust = least_confidence(figures)
    is_rivalled = _margin(finding) < least_margin or trust < least_trust <= confidence(figures, MAX_MARGIN)
    if finding.rival is not None and is_rivalled:
        how_well = "explains the maps almost as well"
        if fits_better(finding.rival.figures, figures):
            is_repeat = "repeats" in finding.rival.figures
            why = "follows from what one of the maps repeats" if is_repeat else "would be sure enough by itself"
            how_well = f"{why}, and fits better where it lays the maps over each other"
        return "ambiguous", (
            f"a second, different alignment {how_well} ({_rival_ratio(finding):.2f} of the evidence); the best: "
            f"{agreement}"
        )
    if repeats_itself(figures):
        return "repeats", (
            f"{figures['recurring']:.0%} of the walls that agree have their like elsewhere in the same map, and of "
            f"the other {figures['rest_cells']:.0f} wall cells {figures['rest_ratio']:.0%} agree (at least "
            f"{MIN_REST_RATIO:.0%} and {DEPENDENT_CELLS:.0f} cells must): like parts of a place, but hardly the same; "
            f"{agreement}"
        )
    if is_adrift(figures):
        return "parts", (
            "parts of the maps would lie as well some cells away: only those that hold "
            f"{figures['firmness']:.0%} of the walls in the common area stay where the alignment puts them "
            f"(at least {_least_firmness(figures):.0%} where walls agree within {figures['tolerance_cells']:g} cells); "
            f"{agreement}"
        )
    if trust < least_trust:
        rivals = (
            "no rivals were looked for"
            if finding.is_hopeless
            else f"the best different alignment has {_rival_ratio(finding):.2f} of the evidence"
        )
        return "confidence", (
            f"not sure enough ({trust:.2f}, at least {least_trust} is needed): {agreement}, along about "
            f"{figures['lines']:.0f} different walls; {figures['opposite']:.0%} lie on walls seen from the other "
            f"side, {figures['crossing_cells']:.0f} cells of wall cross the other's free space in one run; "
            f"{figures['mutual_ratio']:.0%} of the smaller map in common, {rivals}"
        )
    return "", ""


def least_evidence(figures: Figures, trust: float) -> float:
    """The net evidence that a pose with these figures and this confidence needs."""
    is_few, is_loose = _are_few(figures), _is_loose(figures)
    is_little, is_contradicted = _doubts(figures)
    is_sure = not is_few and (not is_loose or trust >= SURE)
    is_doubted = (is_little and (is_few or is_loose)) or (is_contradicted and not is_sure and not _is_close(figures))
    return MORE_EVIDENCE if (is_few and is_loose) or is_doubted else MIN_EVIDENCE


def least_confidence(figures: Figures) -> float:
    """The confidence that a pose with these figures needs."""
    if figures["opposite"] > MUCH_OPPOSITE:
        return VERY_SURE
    is_little, is_contradicted = _doubts(figures)
    is_half = is_contradicted and not _is_loose(figures) and figures["ratio"] < RIGID_RATIO
    return SURE if is_half or (is_little and (is_contradicted or not _is_close(figures))) else MIN_CONFIDENCE


def _doubts(figures: Figures) -> tuple[bool, bool]:
    """Whether the maps share little, and whether they contradict each other."""
    return figures["mutual_ratio"] < SMALL_OVERLAP, figures["contradiction"] > SOME_CONTRADICTION


def are_few_things(figures: Figures) -> bool:
    """Whether what agrees may be one or two things that stand alike in two places."""
    if _is_close(figures) or figures["mutual_ratio"] >= SMALL_OVERLAP or not _are_few(figures):
        return False
    agree = figures["ratio"] >= MIN_RATIO_OF_FEW and not _is_loose(figures)
    return not agree and figures["net"] < MUCH_EVIDENCE


def _are_few(figures: Figures) -> bool:
    return figures["lines"] < (FEW_LOOSE_LINES if _is_loose(figures) else FEW_LINES)


def may_turn_on_parts(finding: Finding) -> bool:
    """Whether a finding would have confidence and evidence enough if all parts stayed, and not if hardly any did."""
    worst, best = (_is_enough(finding, {"firmness": one}) for one in (MIN_FIRMNESS, MAX_FIRMNESS))
    return best and not worst


def _is_enough(finding: Finding, supposed: Figures) -> bool:
    """Whether evidence and confidence would suffice if the best pose had the supposed figures."""
    figures = {**finding.best.figures, **supposed}
    trust = confidence(figures, _margin(finding))
    return trust >= least_confidence(figures) and figures["net"] >= least_evidence(figures, trust)


def may_repeat_itself(finding: Finding) -> bool:
    """Whether the maps are to be asked whether they repeat themselves: walls that stand where the other map has free
    space, or a strong rival, speak for it."""
    figures = finding.best.figures
    is_contradicted = figures["crossing"] > 0.0 or figures["contradiction"] > SLIGHT_CONTRADICTION
    return is_contradicted or _rival_ratio(finding) > STRONG_RIVAL


def repeats_itself(figures: Figures) -> bool:
    """Whether walls agree because they repeat themselves, as far as they were asked; bent maps disagree anyway."""
    if figures.get("like_fit", -math.inf) <= LIKE_FIT or figures["recurring"] <= MOST_RECURRING or _is_loose(figures):
        return False
    is_little = figures["rest_cells"] * figures["rest_ratio"] < DEPENDENT_CELLS
    return is_little or figures["rest_ratio"] < MIN_REST_RATIO


def is_adrift(figures: Figures) -> bool:
    """Whether too few parts of the maps stay where the pose puts them, as far as parts were looked at."""
    return "firmness" in figures and figures["firmness"] < _least_firmness(figures)


def _least_firmness(figures: Figures) -> float:
    return LEAST_FIRMNESS[figures["tolerance_cells"]]


def _is_close(figures: Figures) -> bool:
    """Whether walls agree closely, as those of one rigid place do."""
    return figures["tolerance_cells"] <= RIGID_TOLERANCE_CELLS


def _is_loose(figures: Figures) -> bool:
    """Whether walls agree at the widest tolerance only, as those of bent maps do."""
    return figures["tolerance_cells"] >= max(TOLERANCES_CELLS)


def _covariance(target: PreparedMap, source: PreparedMap, finding: Finding, T_target_source: SE2) -> FloatArray:
    """(3, 3) of (x_m, y_m, yaw_rad) in the target's frame."""
    resolution_m = target.grid.resolution_m
    turn = SE2(0.0, 0.0, target.grid.T_frame_grid.yaw_rad).matrix()
    to_metres = turn * np.array([resolution_m, resolution_m, 1.0])
    # The centre's position and the yaw were estimated; the translation follows as centre - R(yaw) arm.
    centre = source.grid.T_frame_grid.apply(source.centre * resolution_m)
    arm = SE2(0.0, 0.0, T_target_source.yaw_rad).apply(centre)
    lever = np.array([[1.0, 0.0, arm[1]], [0.0, 1.0, -arm[0]], [0.0, 0.0, 1.0]])
    jacobian = lever @ to_metres
    result: FloatArray = jacobian @ finding.covariance @ jacobian.T
    return (result + result.T) / 2.0  # sums of 32-bit floats leave the information symmetric to seven digits only
