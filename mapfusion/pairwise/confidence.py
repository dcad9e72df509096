"""How far an alignment is to be trusted, and by how much one is to be preferred to another: two fitted models.

Both are linear in a few terms of the figures that `evidence` and `scrutiny` give. `benchmarks/fit_verdict.py` fits them
on pairs with known truth; benchmarks/RESULTS.md says on which, and how they do on buildings that were held out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

Figures = Mapping[str, float]

PLAUSIBILITY = {"net": 0.902, "crossing": -1.315, "lines": 1.486, "gain": 1.647}
"""Weights that choose the right one among the candidates of a pair. Source: conditional logit, McFadden 1974."""

CONFIDENCE = {
    "bias": -11.162,
    "net": 0.778,
    "gain": 0.627,
    "lines": 2.557,
    "crossing": -3.388,
    "margin": 0.917,
    "ratio": 0.248,
    "residual": -0.241,
    "opposite": -19.668,
    "disagreement": 0.893,
    "overlap": 2.428,
    "outside": 6.271,
    "conditioning": 0.608,
}
"""Weights of the logistic model of how probable it is that the best alignment of a pair is right."""

MAX_MARGIN, MAX_LOG_RATIO = 4.0, 2.0
"""Plausibility and logarithm of net evidence over a rival's from which on it is none."""


def plausibility_terms(figures: Figures) -> dict[str, float]:
    """What the plausibility of a pose with these figures is made of."""
    return {
        "net": _log(figures["net"]),
        "crossing": math.log(figures["crossing"] + 0.01),
        "lines": _log(figures["lines"]),
        "gain": _log_gain(figures),
    }


def plausibility(figures: Figures) -> float:
    """By how much a pose is to be preferred, a log-odds; only differences between poses of one pair mean anything."""
    return sum(PLAUSIBILITY[name] * value for name, value in plausibility_terms(figures).items())


def distinctness(best: Figures, rival: Figures | None) -> tuple[float, float]:
    """Margin of plausibility and logarithm of the ratio of net evidence over those of the best different alignment."""
    if rival is None:
        return MAX_MARGIN, MAX_LOG_RATIO
    margin = plausibility(best) - plausibility(rival)
    log_ratio = _log(best["net"]) - _log(rival["net"])
    return min(max(margin, 0.0), MAX_MARGIN), min(max(log_ratio, -1.0), MAX_LOG_RATIO)


def confidence_terms(figures: Figures, margin: float, log_ratio: float) -> dict[str, float]:
    """What the confidence is made of; each term is held to the range in which it tells right from wrong."""
    # A run of wall across free space is to be seen against the size of what is compared.
    crossing = figures["crossing_cells"] / (math.sqrt(max(figures["num_walls"], 1.0)) / 3.0)
    return {
        "bias": 1.0,
        "net": _log(figures["net"]),
        "gain": _log_gain(figures),
        "lines": min(_log(figures["lines"]), 3.5),
        "crossing": math.log1p(crossing),
        "margin": margin,
        "ratio": log_ratio,
        "residual": figures["residual_cells"],
        "opposite": figures["opposite"],
        "disagreement": math.log(1.05 - figures["agreement_weaker"]),
        "overlap": math.log(max(figures["mutual_ratio"], 0.01)),
        "outside": figures["outside"],
        "conditioning": min(max(math.log(max(figures["conditioning"], 1e-3)), -3.5), -1.0),
    }


def confidence(figures: Figures, margin: float, log_ratio: float) -> float:
    """Probability that a pose with these figures, so far above its rival, is right."""
    terms = confidence_terms(figures, margin, log_ratio)
    return 1.0 / (1.0 + math.exp(-sum(CONFIDENCE[name] * value for name, value in terms.items())))


def _log(value: float) -> float:
    return math.log(max(value, 1.0))


def _log_gain(figures: Figures) -> float:
    """Logarithm of how many times more walls agree than by chance."""
    return math.log(max(figures["ratio"], 0.02) / max(figures["chance"], 0.01))
