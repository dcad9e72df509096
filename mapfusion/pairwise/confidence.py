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
    "bias": -10.538,
    "net": 1.047,
    "gain": 0.382,
    "lines": 2.338,
    "crossing": -3.594,
    "margin": 0.850,
    "residual": -0.276,
    "opposite": -17.281,
    "disagreement": 0.510,
    "overlap": 2.895,
    "outside": 6.836,
    "conditioning": 1.082,
}
"""Weights of the logistic model of how probable it is that the best alignment of a pair is right."""

WALL_CELLS = 12.0
"""So many agreeing cells, of both maps together, count as one wall at most."""
MAX_MARGIN = 4.0
"""Plausibility over a rival's from which on it is none."""


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


def margin(best: Figures, rival: Figures | None) -> float:
    """Plausibility over that of the best different alignment, in [0, MAX_MARGIN]."""
    if rival is None:
        return MAX_MARGIN
    return min(max(plausibility(best) - plausibility(rival), 0.0), MAX_MARGIN)


def confidence_terms(figures: Figures, above_rival: float) -> dict[str, float]:
    """What the confidence is made of; each term is held to the range in which it tells right from wrong."""
    # A run of wall across free space is to be seen against the size of what is compared.
    crossing = figures["crossing_cells"] / (math.sqrt(max(figures["num_walls"], 1.0)) / 3.0)
    # A wall takes some cells: the rim of one round thing faces many ways and is no building.
    pieces = figures["ratio"] * figures["num_walls"] / WALL_CELLS
    return {
        "bias": 1.0,
        "net": _log(figures["net"]),
        "gain": _log_gain(figures),
        "lines": min(_log(min(figures["lines"], pieces)), 3.5),
        "crossing": math.log1p(crossing),
        "margin": above_rival,
        "residual": figures["residual_cells"],
        "opposite": figures["opposite"],
        "disagreement": math.log(1.05 - figures["agreement_weaker"]),
        "overlap": math.log(max(figures["mutual_ratio"], 0.01)),
        "outside": min(figures["outside"], 0.7),
        "conditioning": min(max(math.log(max(figures["conditioning"], 1e-3)), -3.5), -1.0),
    }


def confidence(figures: Figures, above_rival: float) -> float:
    """Probability that a pose with these figures is right, whose margin over its rival is `above_rival`."""
    terms = confidence_terms(figures, above_rival)
    return 1.0 / (1.0 + math.exp(-sum(CONFIDENCE[name] * value for name, value in terms.items())))


def _log(value: float) -> float:
    return math.log(max(value, 1.0))


def _log_gain(figures: Figures) -> float:
    """Logarithm of how many times more walls agree than by chance."""
    return math.log(max(figures["ratio"], 0.02) / max(figures["chance"], 0.01))
