"""Whether a fusion is to be trusted: in a number, and in words."""

from __future__ import annotations

import numpy as np

from mapfusion.config import FusionConfig
from mapfusion.pairwise.agreement import Agreement
from mapfusion.pairwise.confidence import (
    MAX_FIRMNESS,
    MAX_MARGIN,
    MIN_CONFIDENCE,
    MIN_FIRMNESS,
    MIN_UNIQUENESS,
    Figures,
    confidence,
    fits_better,
    is_loose,
    is_repeating,
    share_behind,
    uniqueness,
)
from mapfusion.pairwise.evidence import MIN_EVIDENCE
from mapfusion.pairwise.prepared import MIN_WALL_CELLS, PreparedMap
from mapfusion.pairwise.search import SLIDING_CONDITIONING, Finding
from mapfusion.result import PairFusion
from mapfusion.transform import SE2, FloatArray

MIN_CONDITIONING = 0.03
"""Least smallest / largest eigenvalue of what the agreeing walls fix of the translation."""
MIN_TURNING = 0.05
"""Least hold of the agreeing walls on the rotation: a square has 0.25, a circle drawn in cells 0.003."""
MAX_CONTRADICTION = 0.6
"""Most walls in the other map's free space, as a share of what chance would put there."""
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
SMALL_OVERLAP, FEW_LINES, FEW_LOOSE_LINES, MORE_EVIDENCE = 0.4, 8.0, 12.0, 70.0
"""Fewer walls than the second, or where they agree loosely than the third, need the fourth where maps share less than
the first of the smaller one, and where they agree loosely: two or three things that stand alike in both are no place
yet, and leave a pose loose."""
WHOLE_OVERLAP = 0.9
"""A search needs as much of as few walls where maps share more than this of the smaller one: what lies wholly within
the other map can be laid over any place in it."""
LEAST_FIRMNESS, MOST_SEEN_BEHIND = 0.25, 0.03
"""Maps that are not bent are not joined where parts with less than the first of the walls stay and one map sees more
than the second behind the other's walls: half turns of a loop of corridors. Each alone is common."""
WEAK_CONDITIONING = 0.3
"""Where walls hold one direction by less than this share of the other, and less than MIN_FIRMNESS of them belongs to
parts that stay, the pose may have slid: maps of corridors were joined half a metre off."""
LEAST_STAYING = 0.02
"""Where parts with less than this of the walls stay, rows of things that are all alike lie as well one row further: of
some 4 000 right joins every one has more."""
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
    is_capped = gate not in ("", "confidence")
    return PairFusion(
        accepted=not gate,
        reason=reason,
        gate=gate,
        T_target_source=T_target_source,
        confidence=min(trust, REFUSED_CONFIDENCE) if is_capped else trust,
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
            **figures,
            "margin": _margin(finding),
            "rival_ratio": _rival_ratio(finding),
            "ungated_confidence": trust,
        },
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
    least = least_evidence(figures, finding.is_searched)
    if figures["net"] < least:
        return "chance", (
            "agreement is no better than what a search finds between unrelated maps: "
            f"{agreement} (evidence {figures['net']:.0f}, at least {least:.0f} is needed "
            f"with {figures['mutual_ratio']:.0%} of the smaller map in common and about {figures['lines']:.0f} "
            f"different walls within {figures['tolerance_cells']:g} cells)"
        )
    if figures["ratio"] < MIN_RATIO:
        return "chance", f"too few walls agree: {agreement}, at least {MIN_RATIO:.0%} must"
    if figures["contradiction"] > MAX_CONTRADICTION:
        return "contradiction", (
            f"walls stand in the other map's free space, {figures['contradiction']:.0%} of what chance would put there "
            f"(at most {MAX_CONTRADICTION:.0%}); {agreement}"
        )
    stray_m = figures["stray_cells"] * cells.resolution_m
    if stray_m > MAX_STRAY_M and not is_loose(figures):
        return "contradiction", (
            f"a wall of {stray_m:.1f} m strays through the other map's free space (at most {MAX_STRAY_M:g} m may), "
            f"while others agree within {figures['tolerance_cells']:g} cells; {agreement}"
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
    is_rivalled = _margin(finding) < least_margin(figures) or trust < MIN_CONFIDENCE <= confidence(figures, MAX_MARGIN)
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
            f"{figures['recurring']:.0%} of the walls that agree have their like elsewhere in the same map; of those "
            f"that have none {figures['rest_ratio']:.0%} agree, and walls stand in free space "
            f"{figures['contradiction']:.0%} as often as by chance: like parts of a place, but hardly the same "
            f"({uniqueness(figures):.2f}, at least {MIN_UNIQUENESS:g} is needed); {agreement}"
        )
    if has_slid(figures) or is_adrift(figures):
        why = (
            f"{least_staying(figures):.0%} where walls hold one direction by {figures['conditioning']:.0%} of the other"
            if has_slid(figures)
            else f"{LEAST_FIRMNESS:.0%} where more than {MOST_SEEN_BEHIND:.0%} of what walls hide is free in the other "
            f"map; is {share_behind(figures):.1%}"
        )
        return "parts", (
            "parts of the maps would lie as well some cells away: only those that hold "
            f"{figures['firmness']:.0%} of the walls in the common area stay where the alignment puts them (at least "
            f"{why}); {agreement}"
        )
    if trust < MIN_CONFIDENCE:
        rivals = (
            "no rivals were looked for"
            if finding.is_hopeless
            else f"the best different alignment has {_rival_ratio(finding):.2f} of the evidence"
        )
        return "confidence", (
            f"not sure enough ({trust:.2f}, at least {MIN_CONFIDENCE} is needed): {agreement}, along about "
            f"{figures['lines']:.0f} different walls; {figures['opposite']:.0%} lie on walls seen from the other "
            f"side, {figures['crossing_cells']:.0f} cells of wall cross the other's free space in one run; "
            f"{figures['mutual_ratio']:.0%} of the smaller map in common, {rivals}"
        )
    return "", ""


def least_margin(figures: Figures) -> float:
    """The margin over the nearest different alignment that a pose with these figures needs."""
    return SLIDING_MARGIN if figures["conditioning"] < SLIDING_CONDITIONING else MIN_MARGIN


def lacks_only_confidence(verdict: PairFusion) -> bool:
    """Whether a refusal was made for too little confidence alone, be it that a rival comes near, but not too near."""
    figures = verdict.evidence
    is_unsure = verdict.gate == "ambiguous" and figures["margin"] >= least_margin(figures)
    return (is_unsure or verdict.gate == "confidence") and not (has_slid(figures) or is_adrift(figures))


def least_evidence(figures: Figures, is_searched: bool) -> float:
    """The net evidence that a pose with these figures needs, which was searched for or known before."""
    if figures["lines"] >= (FEW_LOOSE_LINES if is_loose(figures) else FEW_LINES):
        return MIN_EVIDENCE
    is_anywhere = is_searched and figures["mutual_ratio"] > WHOLE_OVERLAP
    is_doubtful = is_loose(figures) or figures["mutual_ratio"] < SMALL_OVERLAP or is_anywhere
    return MORE_EVIDENCE if is_doubtful else MIN_EVIDENCE


def may_turn_on_parts(finding: Finding) -> bool:
    """Whether a finding would have confidence and evidence enough if all parts stayed, and not if hardly any did."""
    worst, best = (_is_enough(finding, {"firmness": one}) for one in (MIN_FIRMNESS, MAX_FIRMNESS))
    return best and not worst


def _is_enough(finding: Finding, supposed: Figures) -> bool:
    """Whether evidence and confidence would suffice if the best pose had the supposed figures."""
    figures = {**finding.best.figures, **supposed}
    is_supported = figures["net"] >= least_evidence(figures, finding.is_searched)
    return is_supported and confidence(figures, _margin(finding)) >= MIN_CONFIDENCE


def may_repeat_itself(finding: Finding) -> bool:
    """Whether the maps are to be asked whether they repeat themselves: walls that stand where the other map has free
    space, or a strong rival, speak for it."""
    figures = finding.best.figures
    is_contradicted = figures["crossing"] > 0.0 or figures["contradiction"] > SLIGHT_CONTRADICTION
    return is_contradicted or _rival_ratio(finding) > STRONG_RIVAL


def repeats_itself(figures: Figures) -> bool:
    """Whether walls agree because they repeat themselves, as far as they were asked."""
    return is_repeating(figures) and uniqueness(figures) < MIN_UNIQUENESS


def least_staying(figures: Figures) -> float:
    """The firmness below which nothing holds a pose with these figures, or nothing in one direction."""
    return MIN_FIRMNESS if figures["conditioning"] < WEAK_CONDITIONING else LEAST_STAYING


def has_slid(figures: Figures) -> bool:
    """Whether nothing holds the pose, or nothing in one direction, as far as parts were looked at."""
    return figures.get("firmness", MIN_FIRMNESS) < least_staying(figures)


def is_adrift(figures: Figures) -> bool:
    """Whether too few parts of the maps stay where the pose puts them, as far as parts were looked at."""
    is_firm = figures.get("firmness", LEAST_FIRMNESS) >= LEAST_FIRMNESS
    return not (is_firm or is_loose(figures)) and share_behind(figures) > MOST_SEEN_BEHIND


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
