"""How far an alignment is to be trusted, by how much one is to be preferred to another, and whether it is no like part
of a place that repeats itself: three fitted models.

All are linear in a few terms of the figures that `evidence`, `scrutiny`, `keypoints`, `firmness` and `repeats` give.
`benchmarks/fit_verdict.py` fits the first two on pairs with known truth and `benchmarks/fit_repeats.py` the third;
benchmarks/RESULTS.md says on which, and how they do on places that were held out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

Figures = Mapping[str, float]

PLAUSIBILITY = {
    "net": 0.771,
    "crossing": -0.547,
    "run": -0.367,
    "lines": 2.24,
    "gain": 1.985,
    "inliers_wide": 0.495,
    "keypoints": 1.016,
    "inliers_near": 0.635,
    "behind": -0.945,
    "far_behind": -0.733,
}
"""Weights that choose the right one among the candidates of a pair. Source: conditional logit, McFadden 1974."""

CONFIDENCE = {
    "bias": -34.258,
    "net": 2.726,
    "gain": 1.09,
    "lines": 4.199,
    "run": -0.365,
    "crossing": -1.966,
    "margin": 0.882,
    "opposite": -5.787,
    "overlap": 2.97,
    "outside": 7.337,
    "keypoints": 0.302,
    "firm": 8.174,
    "rigid": 2.0,
    "close": 3.0,
    "behind": -0.3,
    "far_behind": -0.2,
}
"""Weights of the logistic model of how probable it is that the best alignment of a pair is right. Those of `rigid` and
`close` are a quarter and half of what is fitted: hardly any wrong alignment of those pairs holds them down, but others
would."""

UNIQUENESS = {
    "bias": -13.231,
    "rest": 3.314,
    "crossing": -0.592,
    "contradiction": -2.471,
    "like_fit": -0.437,
    "lines": 0.84,
    "firm_lead": 7.929,
}
"""Weights of the logistic model of how probable it is that an alignment that is sure enough otherwise is right, where
the maps were asked what of them repeats itself."""
MIN_UNIQUENESS = 0.5
"""Uniqueness from which on a pose is no like part of a place that repeats itself."""
MIN_RECURRING = 0.2
"""Where no more of the walls that agree recur, a place does not repeat itself."""
LEAST_CONTRADICTION, LEAST_LIKE_FIT = 0.02, -12.0
"""Walls that stand where the other map has free space, as a share of chance, speak more the more they are than the
first; alignments that follow and fit worse than by the second tell no more."""

MAX_NET = 30.0
"""More evidence than this tells no more of a pose: what repeats itself has it too."""
MAX_RANKED_NET, MAX_RANKED_LINES, MAX_RANKED_WIDE, MAX_RANKED_NEAR = 50.0, 40.0, 200.0, 100.0
"""More evidence, walls and explained matches than these tell no more of two poses either: they grow with the area that
a pose has in common, and where a place repeats itself the right pose need not have most of it."""
WIDE_BY_CHANCE, NEAR_BY_CHANCE = 15.0, 6.0
"""About as many matches are explained by wrong poses as well."""
MAX_LINES = 20.0
"""More walls than these tell no more."""
MAX_OUTSIDE = 0.7
"""More walls outside the common area than this tell no more."""
MAX_MARGIN = 4.0
"""Margin over a rival from which on it is none."""
BEHIND_SHARE, BEHIND_WEIGHT = 0.5, 3.0
"""A rival with less than the first of the best one's evidence falls behind by the second for each natural logarithm,
down to MAX_RANKED_NET: below that, plausibility sees it."""
FIT = ("crossing", "run", "gain", "keypoints", "behind", "far_behind")
"""Terms of the plausibility that hardly grow with the area in common."""
USUAL_BEHIND, LEAST_BEHIND = 0.02, 0.003
"""As much free space of one map behind the other's walls speaks neither for nor against a pose; less than the second
tells no more."""
LOOSE_TOLERANCE_CELLS, LOOSE_WEIGHT = 3.0, 0.5
"""Of walls that agree within more than the first only, those of bent maps, what lies behind counts by the second: their
walls stand in front of each other anyway."""
BETTER_FIT = 0.5
"""A rival that is sure enough alone and fits better than the best pose by more than this may well be right: a place
that repeats itself may have more in common where it does not belong."""
MIN_CONFIDENCE = 0.8
"""Confidence from which on a pose is sure enough."""
MIN_FIRMNESS, MAX_FIRMNESS = 0.1, 0.4
"""Less firmness than the first and more than the second tells no more."""
LITTLE_OVERLAP, ENOUGH_OVERLAP, MAX_FIRMNESS_OF_LITTLE = 0.3, 0.5, 0.2
"""Where maps share less than the first of the smaller one, more firmness than the third tells no more: the few things
that stand alike in two places are firm as well. From the second on they need no such caution."""
RIGID_TOLERANCE_CELLS, RIGID_LINES, RIGID_RATIO, LEAST_RIGID, MOST_RIGID = 1.5, 6.0, 0.6, 0.25, 0.35
"""Walls that agree within the first, along at least the second, and at least the third of them all, of which the fourth
to the fifth belong to parts that stay, agree as those of one rigid place do."""
RIGID_BEHIND, MOST_RIGID_BEHIND = 0.06, 0.1
"""But less so where one map sees more than the first behind the other's walls, and not from the second on."""
CLOSE_RATIOS, CLOSE_NETS = (0.9, 0.97), (100.0, 300.0)
"""Shares of walls that agree within RIGID_TOLERANCE_CELLS, and evidence, from which on they count as one and the same
place, and above which they count as no more."""
KNOWN_KEYPOINTS, KNOWN_FIRMNESS = 2.5, MAX_FIRMNESS
"""Taken for a transform that is only verified: its keypoints were counted when it was found, and its parts are looked
at where they may decide."""


def plausibility_terms(figures: Figures) -> dict[str, float]:
    """What the plausibility of a pose with these figures is made of."""
    return {
        "net": _log(min(figures["net"], MAX_RANKED_NET)),
        "crossing": _log_crossing(figures),
        "run": math.log1p(figures["crossing_cells"]),
        "lines": _log(min(figures["lines"], MAX_RANKED_LINES)),
        "gain": _log_gain(figures),
        "inliers_wide": math.log(min(figures["inliers_wide"], MAX_RANKED_WIDE) + WIDE_BY_CHANCE),
        "keypoints": figures["keypoints"],
        "inliers_near": math.log(min(figures["inliers_near"], MAX_RANKED_NEAR) + NEAR_BY_CHANCE),
        "behind": _log_behind(figures, "behind"),
        "far_behind": _log_behind(figures, "far_behind"),
    }


def plausibility(figures: Figures) -> float:
    """By how much a pose is to be preferred, a log-odds; only differences between poses of one pair mean anything."""
    return sum(PLAUSIBILITY[name] * value for name, value in plausibility_terms(figures).items())


def fit(figures: Figures) -> float:
    """The part of the plausibility that hardly grows with the area in common."""
    terms = plausibility_terms(figures)
    return sum(PLAUSIBILITY[name] * terms[name] for name in FIT)


def confidence_alone(figures: Figures) -> float:
    """The confidence that a pose with these figures would have without rivals, if all its parts stayed."""
    return confidence({**figures, "firmness": MAX_FIRMNESS}, MAX_MARGIN)


def fits_better(rival: Figures, best: Figures) -> bool:
    """Whether a rival that is to be taken seriously fits better than the best pose.

    It is where it is sure enough alone, or follows from the best pose by what repeats itself within one of the maps,
    which then has `repeats` among its figures.
    """
    is_serious = "repeats" in rival or confidence_alone(rival) >= MIN_CONFIDENCE
    return is_serious and fit(rival) - fit(best) > BETTER_FIT


def margin(best: Figures, rival: Figures | None) -> float:
    """How clearly the best pose is to be preferred to a different one, in [0, MAX_MARGIN].

    Their difference in plausibility, a log-odds, and how far the rival falls behind in evidence that plausibility no
    longer counts. Without a rival MAX_MARGIN; 0 over a serious one that fits better.
    """
    if rival is None:
        return MAX_MARGIN
    if fits_better(rival, best):
        return 0.0
    ahead = plausibility(best) - plausibility(rival)
    still_seen = max(rival["net"], MAX_RANKED_NET)
    ahead += BEHIND_WEIGHT * _log(BEHIND_SHARE * best["net"] / still_seen)
    return min(max(ahead, 0.0), MAX_MARGIN)


def confidence_terms(figures: Figures, above_rival: float) -> dict[str, float]:
    """What the confidence is made of; each term is held to the range in which it tells right from wrong."""
    # A run of wall across free space is to be seen against the size of what is compared.
    run = figures["crossing_cells"] / (math.sqrt(max(figures["num_walls"], 1.0)) / 3.0)
    share_of_most = _ramp(figures["mutual_ratio"], LITTLE_OVERLAP, ENOUGH_OVERLAP)
    most_firmness = MAX_FIRMNESS_OF_LITTLE + share_of_most * (MAX_FIRMNESS - MAX_FIRMNESS_OF_LITTLE)
    return {
        "bias": 1.0,
        "net": _log(min(figures["net"], MAX_NET)),
        "gain": _log_gain(figures),
        "lines": _log(min(figures["lines"], MAX_LINES)),
        "run": math.log1p(run),
        "crossing": _log_crossing(figures),
        "margin": above_rival,
        "opposite": figures["opposite"],
        "overlap": math.log(max(figures["mutual_ratio"], 0.01)),
        "outside": min(figures["outside"], MAX_OUTSIDE),
        "keypoints": figures.get("keypoints", KNOWN_KEYPOINTS),
        "firm": min(max(figures.get("firmness", KNOWN_FIRMNESS), MIN_FIRMNESS), most_firmness),
        "rigid": rigidity(figures),
        "close": closeness(figures),
        "behind": _log_behind(figures, "behind"),
        "far_behind": _log_behind(figures, "far_behind"),
    }


def closeness(figures: Figures) -> float:
    """How surely walls with these figures are the same, however few there are, in [0, 1].

    Much evidence alone tells little, as what repeats itself has it too, and so does a large share of walls that agree,
    as any corner fits any other. Of wrong poses hardly any has both.
    """
    if figures["tolerance_cells"] > RIGID_TOLERANCE_CELLS:
        return 0.0
    of_net = _ramp(math.log(max(figures["net"], 1.0)), *map(math.log, CLOSE_NETS))
    return _ramp(figures["ratio"], *CLOSE_RATIOS) * of_net


def rigidity(figures: Figures) -> float:
    """How surely a pose with these figures puts one rigid place onto itself, in [0, 1].

    Hardly any wrong pose has all at once: most of many walls agree, within a cell or so, and parts stay. Where parts
    were not looked at it is 0.
    """
    is_tight = figures["tolerance_cells"] <= RIGID_TOLERANCE_CELLS and figures["ratio"] >= RIGID_RATIO
    if not is_tight or figures["lines"] < RIGID_LINES:
        return 0.0
    of_behind = 1.0 - _ramp(share_behind(figures), RIGID_BEHIND, MOST_RIGID_BEHIND)
    return of_behind * _ramp(figures.get("firmness", 0.0), LEAST_RIGID, MOST_RIGID)


def is_repeating(figures: Figures) -> bool:
    """Whether the uniqueness of a pose with these figures counts; bent maps disagree anyway."""
    return figures.get("recurring", 0.0) > MIN_RECURRING and not is_loose(figures)


def uniqueness_terms(figures: Figures) -> dict[str, float]:
    """What the uniqueness is made of, of maps that were asked what of them repeats itself, see `repeats`."""
    return {
        "bias": 1.0,
        "rest": figures["rest_ratio"],
        "crossing": _log_crossing(figures),
        "contradiction": math.log(figures["contradiction"] + LEAST_CONTRADICTION),
        "like_fit": max(figures.get("like_fit", LEAST_LIKE_FIT), LEAST_LIKE_FIT),
        "lines": _log(min(figures["lines"], MAX_RANKED_LINES)),
        "firm_lead": figures["firm_lead"],
    }


def uniqueness(figures: Figures) -> float:
    """Probability that a pose with these figures, sure enough otherwise, is right and no like part of the place."""
    terms = uniqueness_terms(figures)
    return logistic(sum(UNIQUENESS[name] * value for name, value in terms.items()))


def share_behind(figures: Figures) -> float:
    """What is seen behind walls, near and far, as shares of what they hide there."""
    return figures["behind"] + figures["far_behind"]


def is_loose(figures: Figures) -> bool:
    """Whether walls agree within more than LOOSE_TOLERANCE_CELLS only, as those of bent maps do."""
    return figures["tolerance_cells"] > LOOSE_TOLERANCE_CELLS


def _ramp(value: float, low: float, high: float) -> float:
    """From 0 at `low` to 1 at `high`."""
    return min(max((value - low) / (high - low), 0.0), 1.0)


def confidence(figures: Figures, above_rival: float) -> float:
    """Probability that a pose with these figures is right, whose margin over its rival is `above_rival`."""
    terms = confidence_terms(figures, above_rival)
    return logistic(sum(CONFIDENCE[name] * value for name, value in terms.items()))


def logistic(log_odds: float) -> float:
    """The probability with these log-odds."""
    return 1.0 / (1.0 + math.exp(-log_odds))


def _log(value: float) -> float:
    return math.log(max(value, 1.0))


def _log_crossing(figures: Figures) -> float:
    return math.log(figures["crossing"] + 0.01)


def _log_behind(figures: Figures, strip: str) -> float:
    """Logarithm of how much more is seen in a strip behind walls than USUAL_BEHIND; LOOSE_WEIGHT of it of bent maps."""
    weight = LOOSE_WEIGHT if is_loose(figures) else 1.0
    return weight * math.log((figures[strip] + LEAST_BEHIND) / (USUAL_BEHIND + LEAST_BEHIND))


def _log_gain(figures: Figures) -> float:
    """Logarithm of how many times more walls agree than by chance."""
    return math.log(max(figures["ratio"], 0.02) / max(figures["chance"], 0.01))
