import pytest

from mapfusion.newest import NewestGrid
from mapfusion.result import PairFusion
from mapfusion.steps import Placement
from mapfusion.timeline import Snapshot
from mapfusion.transform import SE2
from mapfusion.witnesses import MAX_WITNESSES, checked_by, witnesses
from tests.fakes import flat, grid_of

T = SE2(3.0, -1.0, 0.4)
FOUND = PairFusion(accepted=True, T_target_source=T, confidence=0.92)
AGREES = PairFusion(accepted=True, T_target_source=T, confidence=0.99, overlap_ratio=0.5)
DISPUTES = PairFusion(accepted=False, reason="walls in free space", gate="contradiction", overlap_ratio=0.5)
CHANCE = PairFusion(accepted=False, reason="no better than chance", gate="chance", overlap_ratio=0.5)
SMALL = PairFusion(accepted=False, reason="no better than chance", gate="chance", overlap_ratio=0.1)
DOUBTS = PairFusion(accepted=False, reason="not sure enough", gate="confidence", overlap_ratio=0.5, confidence=0.2)
SAYS_NOTHING = PairFusion(accepted=False, reason="nothing in common", gate="no overlap")

NAMES = ("r1", "r2", "r3", "r4", "r10")
SNAPSHOT = Snapshot(0, False, {}, {name: NewestGrid.of(0, grid_of(flat(10, 10, 0))) for name in NAMES})
PLACEMENTS = {
    "r1": Placement(1, SE2.identity()),
    "r3": Placement(1, SE2(5.0, 1.0, 0.7)),
    "r2": Placement(2, SE2.identity()),
    "r10": Placement(2, SE2(-2.0, 8.0, -1.0)),
}


def test_robots_of_no_group_have_no_witnesses() -> None:
    assert witnesses(("r1", "r2"), FOUND, SNAPSHOT, {}) == []


def test_robots_of_one_group_have_no_witnesses() -> None:
    assert witnesses(("r1", "r3"), FOUND, SNAPSHOT, PLACEMENTS) == []


def test_the_other_pairs_across_two_groups_are_asked_where_the_join_puts_them() -> None:
    looks = {look.pair: look.T_a_b for look in witnesses(("r1", "r10"), FOUND, SNAPSHOT, PLACEMENTS)}
    assert set(looks) == {("r1", "r2"), ("r2", "r3"), ("r3", "r10")}
    T_1_2 = T @ PLACEMENTS["r10"].T_group_map.inverse()
    expected = {
        ("r1", "r2"): T_1_2,
        ("r2", "r3"): T_1_2.inverse() @ PLACEMENTS["r3"].T_group_map,
        ("r3", "r10"): PLACEMENTS["r3"].T_group_map.inverse() @ T,
    }
    for pair, T_a_b in expected.items():
        found = looks[pair]
        assert found is not None
        assert found.distance_to(T_a_b) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_of_many_witnesses_those_nearest_to_each_other_are_asked() -> None:
    names = [f"r{number}" for number in range(1, 12)]
    snapshot = Snapshot(0, False, {}, {name: NewestGrid.of(0, grid_of(flat(10, 10, 0))) for name in names})
    placements = {name: Placement(1, SE2(10.0 * number, 0.0, 0.0)) for number, name in enumerate(names[:10])}
    join = PairFusion(accepted=True, T_target_source=SE2.identity(), confidence=0.92)
    looks = witnesses(("r1", "r11"), join, snapshot, placements)
    assert [look.pair[0] for look in looks] == [f"r{number}" for number in range(2, 2 + MAX_WITNESSES)]


@pytest.mark.parametrize(
    ("verdicts", "accepted"),
    [
        ([], True),
        ([AGREES, DISPUTES], True),
        ([SAYS_NOTHING, SAYS_NOTHING], True),
        ([DISPUTES, SAYS_NOTHING], False),
        ([CHANCE, SAYS_NOTHING], False),
        ([SMALL, DOUBTS], True),
        ([DISPUTES, AGREES, DISPUTES], False),
    ],
)
def test_a_join_is_refused_where_more_witnesses_dispute_it_than_agree(
    verdicts: list[PairFusion], accepted: bool
) -> None:
    looks = witnesses(("r1", "r10"), FOUND, SNAPSHOT, PLACEMENTS)[: len(verdicts)]
    checked = checked_by(FOUND, looks, verdicts)
    assert checked.accepted == accepted
    if not accepted:
        assert checked.gate == "witnesses"
        assert looks[0].pair[0] in checked.reason
        assert checked.T_target_source == T
