from mapfusion.joins import Joins
from mapfusion.result import PairFusion
from mapfusion.timeline import NewestGrid
from mapfusion.transform import SE2
from tests.fakes import flat, grid_of

GRID = grid_of(flat(2, 2, 0))
ACCEPTED = PairFusion(accepted=True, T_target_source=SE2(1.0, 2.0, 0.3), confidence=0.9)
REFUSED = PairFusion(accepted=False, reason="no overlap", gate="no overlap")


def newest(**versions: int) -> dict[str, NewestGrid]:
    return {robot: NewestGrid(0, version, GRID) for robot, version in versions.items()}


def test_a_pair_is_due_until_it_was_looked_at_and_again_when_a_map_changed() -> None:
    joins = Joins()
    grids = newest(r1=1, r10=1, r2=1)
    assert joins.due(grids) == [("r1", "r2"), ("r1", "r10"), ("r2", "r10")]
    for pair in joins.due(grids):
        joins.record(pair, grids, REFUSED)
    assert joins.due(grids) == []
    assert joins.due(newest(r1=1, r10=2, r2=1)) == [("r1", "r10"), ("r2", "r10")]


def test_a_join_outlasts_a_refused_look() -> None:
    joins, grids = Joins(), newest(a=1, b=1)
    joins.record(("a", "b"), grids, ACCEPTED)
    joins.record(("a", "b"), newest(a=2, b=1), REFUSED)
    assert joins.guess(("a", "b")) == SE2(1.0, 2.0, 0.3)
    assert list(joins.held) == [("a", "b")]


def test_a_refused_pair_has_no_guess() -> None:
    joins = Joins()
    joins.record(("a", "b"), newest(a=1, b=1), REFUSED)
    assert joins.guess(("a", "b")) is None
    assert not joins.held
