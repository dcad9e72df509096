import pytest

from mapfusion.config import ReplayConfig
from mapfusion.steps import Event
from mapfusion.timeline import Snapshot, snapshots
from mapfusion.transform import SE2
from tests.fakes import SECOND_NS, StillPoses, flat, grid_event, grid_of, robot_event

GRID = grid_of(flat(2, 2, 0))


def taken(events: list[Event], **settings: float | int) -> list[Snapshot]:
    return list(snapshots(events, ReplayConfig(**settings)))  # type: ignore[arg-type]


def seconds(steps: list[Snapshot]) -> list[float]:
    return [step.stamp_ns / SECOND_NS for step in steps]


def test_snapshots_stand_on_a_lattice_from_the_first_stamp_and_at_the_last() -> None:
    steps = taken([robot_event("a"), grid_event("a", 10.0, GRID), grid_event("a", 12.5, GRID)])
    assert seconds(steps) == [10.0, 11.0, 12.0, 12.5]
    assert [step.is_last for step in steps] == [False, False, False, True]


def test_poses_count_as_stamps() -> None:
    poses = StillPoses(SE2.identity(), [8 * SECOND_NS, 14 * SECOND_NS])
    steps = taken([robot_event("a", poses), grid_event("a", 10.0, GRID)], interval_s=2.0)
    assert seconds(steps) == [8.0, 10.0, 12.0, 14.0]
    assert [len(step.grids) for step in steps] == [0, 1, 1, 1]


def test_a_snapshot_uses_the_newest_grid_up_to_its_time() -> None:
    events: list[Event] = [robot_event("a"), robot_event("b"), grid_event("a", 0.0, GRID), grid_event("b", 1.0, GRID)]
    steps = taken([*events, grid_event("a", 1.5, GRID), grid_event("a", 2.0, GRID)])
    assert [{robot: newest.version for robot, newest in step.grids.items()} for step in steps] == [
        {"a": 1},
        {"a": 1, "b": 1},
        {"a": 3, "b": 1},
    ]


def test_a_start_leaves_grids_from_before_it_in_force() -> None:
    events: list[Event] = [robot_event("a"), grid_event("a", 3.0, GRID), grid_event("a", 12.0, GRID)]
    steps = taken(events, start_ns=10 * SECOND_NS)
    assert seconds(steps) == [10.0, 11.0, 12.0]
    assert steps[0].grids["a"].stamp_ns == 3 * SECOND_NS


def test_silence_between_recordings_is_passed_over_on_the_same_lattice() -> None:
    events: list[Event] = [robot_event("a"), robot_event("b"), grid_event("a", 0.0, GRID), grid_event("b", 1e5, GRID)]
    stamps = seconds(taken(events))
    assert len(stamps) == 61 + 61
    assert stamps[60:62] == [60.0, 99940.0]
    assert stamps[-1] == 1e5


def test_poses_break_the_silence() -> None:
    poses = StillPoses(SE2.identity(), [0, 500 * SECOND_NS])
    steps = taken([robot_event("a", poses), grid_event("a", 0.0, GRID), grid_event("a", 1000.0, GRID)])
    assert 441.0 in seconds(steps)
    assert 300.0 not in seconds(steps)


def test_no_grid_no_snapshot() -> None:
    assert taken([robot_event("a")]) == []


def test_events_out_of_order_are_the_callers_mistake() -> None:
    with pytest.raises(ValueError, match="out of order"):
        taken([robot_event("a"), grid_event("a", 2.0, GRID), grid_event("a", 1.0, GRID)])
    with pytest.raises(ValueError, match="not announced"):
        taken([grid_event("a", 2.0, GRID)])
