from __future__ import annotations

import numpy as np
import pytest

from mapfusion.evaluation.pairs import LEAST_OVERLAP, Generator, make_pair
from mapfusion.pairwise.agreement import agreement

GENERATORS: tuple[Generator, ...] = ("paper", "floor-plans")


@pytest.mark.parametrize("generator", GENERATORS)
def test_related_maps_agree_under_the_truth(generator: Generator) -> None:
    pair = make_pair(generator, related=True, seed=3)
    assert pair.T_target_source is not None
    found = agreement(pair.target, pair.source, pair.T_target_source)
    assert found.mae is not None
    assert found.mae < 10.0
    assert found.overlap_ratio == pytest.approx(pair.overlap_ratio, abs=0.25)  # patches have corners beyond their map
    assert LEAST_OVERLAP <= pair.overlap_ratio <= 1.0


@pytest.mark.parametrize("generator", GENERATORS)
def test_unrelated_maps_have_no_truth(generator: Generator) -> None:
    pair = make_pair(generator, related=False, seed=4)
    assert pair.T_target_source is None
    assert pair.overlap_ratio == 0.0


@pytest.mark.parametrize("generator", GENERATORS)
def test_the_robot_stands_on_free_ground(generator: Generator) -> None:
    pair = make_pair(generator, related=True, seed=5)
    robot_m = np.array([[pair.T_source_robot.x_m, pair.T_source_robot.y_m]])
    col, row = np.floor(pair.source.T_frame_grid.inverse().apply(robot_m)[0] / pair.source.resolution_m).astype(int)
    assert pair.source.cells[row, col] == 0


@pytest.mark.parametrize("generator", GENERATORS)
def test_a_seed_gives_one_pair(generator: Generator) -> None:
    one, same, other = (make_pair(generator, related=True, seed=seed) for seed in (6, 6, 7))
    assert np.array_equal(one.target.cells, same.target.cells)
    assert np.array_equal(one.source.cells, same.source.cells)
    assert one.T_target_source == same.T_target_source
    assert one.T_source_robot == same.T_source_robot
    assert one.T_target_source != other.T_target_source
