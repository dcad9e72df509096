"""The paper's experiments with ground truth instead of the eye, and the accept/reject study that it lacks."""

from mapfusion.evaluation.attempts import Attempt, Study, run_study
from mapfusion.evaluation.figures import Bin, Figures, PublishedVerdict, Quantiles, Refusals, RocPoint, figures
from mapfusion.evaluation.pairs import Generator, StudyPair, make_pair

__all__ = [
    "Attempt",
    "Bin",
    "Figures",
    "Generator",
    "PublishedVerdict",
    "Quantiles",
    "Refusals",
    "RocPoint",
    "Study",
    "StudyPair",
    "figures",
    "make_pair",
    "run_study",
]
