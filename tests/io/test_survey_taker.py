import numpy as np

from mapfusion_io.interfaces import RawMessage
from mapfusion_io.read_limits import ReadLimits
from mapfusion_io.survey_taker import SurveyTaker, stamp_on
from mapfusion_io.topic_survey import TopicSurvey
from tests.io.fake_recordings import Sender, ns


def taken(*messages: RawMessage, **limits: int) -> dict[str, TopicSurvey]:
    taker = SurveyTaker("header", ReadLimits(**limits))
    for raw in messages:
        assert taker.note_channel(raw.channel)
        taker.take(raw)
    return taker.settled()


def test_of_several_channels_on_a_topic_the_first_of_use_says_what_it_is() -> None:
    send = Sender()
    topics = taken(send.text("/map", 0.0), send.grid("/map", 1.0), send.pose("/map", 2.0), send.grid("/map", 3.0))
    found = topics["/map"]
    assert (found.role, found.count, list(found.stamps_ns)) == ("grid", 4, [ns(1.0), ns(3.0)])
    assert found.refused == {("malformed message", "not a nav_msgs/msg/OccupancyGrid"): 1}


def test_maps_leave_their_places_and_the_size_of_the_largest() -> None:
    send = Sender()
    large = np.zeros((30, 20), np.int8)
    topics = taken(send.grid("/a/map", 0.0), send.grid("/b/map", 1.0), send.grid("/a/map", 2.0, cells=large))
    assert (list(topics["/a/map"].arrivals), list(topics["/a/map"].numbers)) == ([0, 2], [1, 2])
    assert topics["/a/map"].most_cells == 600
    assert topics["/b/map"].most_cells == 20


def test_what_is_over_a_limit_is_refused_by_name() -> None:
    send = Sender()
    maps = [send.grid("/a/map", time_s, f"frame{time_s}") for time_s in (0.0, 1.0, 2.0, 3.0)]
    assert taken(*maps, messages=3)["/a/map"].refused == {("over limit", "more than 3 maps, transforms and poses"): 1}
    assert taken(*maps, frames=2)["/a/map"].refused == {("over limit", "more than 2 frames"): 2}
    edges = [send.transforms("/tf", 0.0, ("a", str(child)), ("a", str(child))) for child in range(3)]
    assert taken(*edges, frames=2)["/tf"].refused == {("over limit", "more than 2 frames"): 1}


def test_a_stamp_of_zero_says_nothing() -> None:
    assert [stamp_on("header", 7, 9), stamp_on("header", 0, 9), stamp_on("log", 7, 9)] == [7, 9, 9]
