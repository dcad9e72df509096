import math

import pytest

from mapfusion.config import Prior
from mapfusion.priors import Priors, checked
from mapfusion.result import PairFusion
from mapfusion.transform import SE2


def test_a_prior_is_relative_to_the_references() -> None:
    priors = Priors({"r1": Prior(SE2(1.0, 0.0, math.pi / 2)), "r2": Prior(SE2(1.0, 3.0, math.pi / 2))}, None)
    between = priors.of_pair(("r1", "r2"), ["r1", "r2", "r3"])
    assert between is not None
    assert between.is_fixed
    assert between.T_a_b.distance_to(SE2(3.0, 0.0, 0.0))[0] < 1e-12
    assert priors.of_pair(("r2", "r3"), ["r1", "r2", "r3"]) is None


def test_a_reference_without_a_prior_stands_at_the_origin() -> None:
    priors = Priors({"r1": Prior(SE2(5.0, 0.0, 0.0))}, "r2")
    between = priors.of_pair(("r1", "r2"), ["r1", "r2"])
    assert between is not None
    assert between.T_a_b == SE2(-5.0, 0.0, 0.0)


def test_fixed_priors_tie_robots_and_soft_ones_do_not() -> None:
    priors = Priors({"r2": Prior(SE2(5.0, 0.0, 0.0)), "r3": Prior(SE2(1.0, 0.0, 0.0), 0.5, 0.1)}, None)
    edges = priors.fixed_edges(["r1", "r2", "r3"], ["r1", "r2", "r3"])
    assert list(edges) == [("r1", "r2")]
    assert edges["r1", "r2"].is_fixed


def test_a_fusion_far_from_a_soft_prior_is_refused() -> None:
    soft = Priors({"r2": Prior(SE2(5.0, 0.0, 0.0), 0.5, 0.1)}, None).of_pair(("r1", "r2"), ["r1", "r2"])
    assert soft is not None
    near = PairFusion(accepted=True, T_target_source=SE2(5.9, 0.0, 0.2), confidence=0.95)
    far = PairFusion(accepted=True, T_target_source=SE2(9.0, 0.0, 0.2), confidence=0.95)
    assert checked(near, soft) is near
    assert (checked(far, soft).accepted, checked(far, soft).gate) == (False, "prior")


@pytest.mark.parametrize("sigmas", [(0.5, 0.0), (0.0, 0.1), (-1.0, 0.1), (math.nan, 0.1)])
def test_sigmas_come_together(sigmas: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match="sigmas"):
        Prior(SE2.identity(), *sigmas)
