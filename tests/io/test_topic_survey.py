from array import array

from mapfusion_io.interfaces import Channel
from mapfusion_io.read_limits import ReadLimits
from mapfusion_io.stamp_census import StampRanges
from mapfusion_io.topic_survey import TopicSurvey, role_of


def topic(**limits: int) -> TopicSurvey:
    return TopicSurvey("/robot1/map", "nav_msgs/msg/OccupancyGrid", "grid", "", ReadLimits(**limits))


def test_the_type_says_what_a_channel_may_serve_for() -> None:
    names = [
        "nav_msgs/msg/OccupancyGrid",
        "map_msgs/msg/OccupancyGridUpdate",
        "tf/msg/tfMessage",
        "nav_msgs/msg/Odometry",
    ]
    roles = [role_of(Channel("/any", name, "", b"", "cdr")) for name in [*names, "sensor_msgs/msg/Image"]]
    assert roles == ["grid", "update", "transform", "pose", None]


def test_reasons_beyond_the_limit_share_an_entry() -> None:
    found = topic(losses=2)
    for reason in "abcda":
        found.refuse("malformed message", reason)
    assert found.refused == {
        ("malformed message", "a"): 2,
        ("malformed message", "b"): 1,
        ("malformed message", "for further reasons"): 2,
    }
    assert found.num_refused == 5


def test_stamps_that_cannot_be_believed_go_with_their_places() -> None:
    found = topic()
    found.stamps_ns, found.arrivals, found.numbers = (
        array("q", [5, 900, 7]),
        array("q", [0, 1, 2]),
        array("q", [1, 2, 3]),
    )
    found.settle(StampRanges(((0, 100),)))
    assert (list(found.stamps_ns), list(found.arrivals), list(found.numbers)) == ([5, 7], [0, 2], [1, 3])
    assert (found.first_ns, found.last_ns, found.num_refused) == (5, 7, 1)


def test_namespace_and_lag() -> None:
    found = topic()
    assert (found.namespace, found.lag_ns) == ("robot1", 0)
    found.lags_ns.extend([10, 30, 1000])
    assert found.lag_ns == 30
