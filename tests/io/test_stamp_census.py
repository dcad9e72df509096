import numpy as np

from mapfusion_io.stamp_census import DAY_NS, END_OF_TIME_NS, StampCensus

TODAY_NS = 19_000 * DAY_NS + 12_345


def census(*messages: tuple[str, int, int]) -> StampCensus:
    """Of (topic, stamp, log time) in nanoseconds."""
    made = StampCensus()
    for message in messages:
        made.add(*message)
    return made


def holds(made: StampCensus, topic: str, *stamps_ns: int) -> list[bool]:
    return [bool(held) for held in made.believable()[topic].hold(np.array(stamps_ns, np.int64))]


def test_stamps_near_the_time_of_recording_hold() -> None:
    made = census(*[("/a", TODAY_NS + step, TODAY_NS + step) for step in range(20)])
    assert holds(made, "/a", TODAY_NS, TODAY_NS + DAY_NS, TODAY_NS - DAY_NS) == [True, True, True]
    assert holds(made, "/a", 5, TODAY_NS + 4 * DAY_NS, END_OF_TIME_NS - 1) == [False, False, False]


def test_a_robot_with_a_clock_of_its_own_is_believed() -> None:
    usual = [("/a", TODAY_NS, TODAY_NS)] * 50
    made = census(*usual, *[("/b", 77, TODAY_NS)] * 3)
    assert holds(made, "/b", 77, TODAY_NS) == [True, True]
    assert holds(made, "/a", 77, TODAY_NS) == [False, True]


def test_a_single_odd_stamp_among_few_of_its_topic() -> None:
    made = census(*[("/tf", TODAY_NS, TODAY_NS)] * 40, *[("/map", TODAY_NS, TODAY_NS)] * 2, ("/map", 77, TODAY_NS))
    assert holds(made, "/map", 77, TODAY_NS) == [False, True]


def test_a_damaged_log_time_does_not_widen_the_range_and_a_second_session_does() -> None:
    week = 7 * DAY_NS
    usual = [("/a", TODAY_NS, TODAY_NS)] * 500
    assert holds(census(*usual, ("/a", TODAY_NS + week, TODAY_NS + week)), "/a", TODAY_NS + week) == [False]
    later = [("/a", TODAY_NS + week, TODAY_NS + week)] * 10
    assert holds(census(*usual, *later), "/a", TODAY_NS + week) == [True]


def test_of_too_many_times_of_recording_those_with_the_most_messages_count() -> None:
    days = [2 * number * DAY_NS for number in range(3000)]
    made = census(*[("/a", day, day) for day in days for _ in range(10)], *[("/a", days[2000], days[2000])] * 5)
    held = made.believable()["/a"].hold(np.array(days, np.int64))
    assert held[2000]
    assert 200 <= held.sum() <= 3 * 200


def test_a_topic_without_stamps_is_not_in_it() -> None:
    assert StampCensus().believable() == {}
