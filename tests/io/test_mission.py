import numpy as np
import pytest

from mapfusion.errors import ConfigError, MissionError
from mapfusion.steps import GridEvent, RobotEvent
from mapfusion_io.interfaces import Loss
from mapfusion_io.mission import Mission, MissionOptions
from mapfusion_io.read_limits import ReadLimits
from mapfusion_io.time_range import TimeRange
from tests.io.fake_recordings import CELLS, Sender, grids, mission, ns, surveyed


def test_robots_come_first_then_grids_in_the_order_of_their_stamps() -> None:
    send = Sender()
    made = mission(
        send.grid("/a/map", 1.0, "a/map"),
        send.grid("/b/map", 5.0, "b/map", stamp_s=0.5),
        send.grid("/a/map", 6.0, "a/map", stamp_s=4.0),
        send.grid("/a/map", 7.0, "a/map", stamp_s=3.0),
        send.pose("/a/pose", 2.0, "a/map"),
    )
    events = list(made.events())
    assert [type(event) for event in events] == [RobotEvent] * 2 + [GridEvent] * 4
    assert grids(made) == [("b", 0.5), ("a", 1.0), ("a", 3.0), ("a", 4.0)]
    assert (made.first_ns, made.last_ns) == (ns(0.5), ns(4.0))
    assert grids(made) == grids(made)


def test_updates_are_laid_over_the_last_full_map() -> None:
    send = Sender()
    patch = np.full((2, 3), 100, np.int8)
    made = mission(
        send.update("/a/map_updates", 0.5, patch, 0, 0),
        send.grid("/a/map", 1.0),
        send.update("/a/map_updates", 2.0, patch, 1, 2),
        send.update("/a/map_updates", 3.0, patch, 4, 4),
        send.grid("/a/map", 4.0),
    )
    events = [event for event in made.events() if isinstance(event, GridEvent)]
    assert [event.stamp_ns for event in events] == [ns(1.0), ns(2.0), ns(4.0)]
    expected = CELLS.copy()
    expected[2:4, 1:4] = 100
    np.testing.assert_array_equal(events[1].grid.cells, expected)
    np.testing.assert_array_equal(events[2].grid.cells, CELLS)
    losses = {loss.detail: loss.count for loss in made.losses}
    assert losses["an update before the first map"] == 1
    assert any("beyond the grid" in detail for detail in losses)


def test_patches_on_too_many_cells_are_lost_by_name() -> None:
    send = Sender()
    patch = np.full((1, 1), 100, np.int8)
    updates = [send.update("/a/map_updates", 1.0 + step, patch, 0, 0) for step in range(4)]
    made = mission(send.grid("/a/map", 0.0), *updates, limits=ReadLimits(updated_cells=2 * CELLS.size))
    assert [stamp for _, stamp in grids(made)] == [0.0, 1.0, 2.0]
    assert [(loss.kind, loss.topic, loss.count) for loss in made.losses] == [("over limit", "/a/map_updates", 2)]


def test_zero_stamps_take_the_log_time_and_the_log_clock_takes_it_always() -> None:
    send = Sender()
    messages = [send.grid("/a/map", 3.0, stamp_s=-1_700_000_000.0), send.grid("/a/map", 5.0, stamp_s=2.0)]
    assert grids(mission(*messages)) == [("a", 2.0), ("a", 3.0)]
    one = Mission([surveyed("run", *messages)], MissionOptions())
    assert one.robots[0].found.topic.num_zero_stamps == 1


def test_messages_that_cannot_be_believed_are_lost_by_name() -> None:
    send = Sender()
    bad = send.grid("/a/map", 2.0, cells=np.full((2, 2), 120, np.int8))
    other_frame = send.grid("/a/map", 3.0, "elsewhere")
    made = mission(send.grid("/a/map", 1.0), bad, other_frame, send.grid("/a/map", 4.0))
    assert [stamp for _, stamp in grids(made)] == [1.0, 4.0]
    assert sum(loss.count or 0 for loss in made.losses) == 2
    assert {loss.topic for loss in made.losses} == {"/a/map"}


def test_a_time_range_keeps_what_was_latched_before_it() -> None:
    send = Sender()
    messages = [
        send.grid(f"/{robot}/map", time_s, f"{robot}/map")
        for robot, time_s in [("a", 0.0), ("b", 1.0), ("a", 2.0), ("a", 6.0), ("b", 9.0)]
    ]
    made = mission(*messages, time_range=TimeRange(start="5", end="9"))
    assert grids(made) == [("b", 1.0), ("a", 2.0), ("a", 6.0)]
    assert (made.start_ns, made.end_ns) == (ns(5.0), ns(9.0))
    with pytest.raises(ConfigError, match="nothing was recorded"):
        mission(*messages, time_range=TimeRange(start="50"))


def test_fewer_than_two_robots_are_no_mission() -> None:
    send = Sender()
    with pytest.raises(MissionError, match=r"run\.mcap: only one robot with a map \(a\)"):
        mission(send.grid("/a/map", 0.0, "a/map")).require_robots()
    with pytest.raises(MissionError, match="/chatter"):
        mission(send.text("/chatter", 0.0)).require_robots()
    lost = (Loss("run.mcap", "truncated", "byte 99"),)
    with pytest.raises(
        MissionError, match=r"only one robot.*\nWhat was there is lost in part \(truncated at byte 99\)"
    ):
        mission(send.grid("/a/map", 0.0, "a/map"), losses=lost).require_robots()
