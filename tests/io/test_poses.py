import numpy as np
import pytest

from mapfusion.errors import ConfigError
from mapfusion_io.interfaces import RawMessage
from mapfusion_io.poses import PoseChoice, PoseOverrides, choose_poses, transform_tree
from mapfusion_io.robots import RobotOverrides, find_robots
from mapfusion_io.survey import Survey
from tests.io.fake_recordings import Sender, ns, surveyed


def chosen(
    *surveys: Survey, topics: dict[str, str] | None = None, frames: dict[str, str] | None = None
) -> dict[str, PoseChoice]:
    found = find_robots(surveys, RobotOverrides())
    tree = transform_tree(found.unique_frames, surveys, dict.fromkeys((one.name for one in surveys), 0))
    return choose_poses(found, tree, PoseOverrides(topics or {}, frames or {}))


def x_at(choice: PoseChoice, time_s: float) -> float:
    assert choice.source is not None
    return float(choice.source.poses_at(np.array([ns(time_s)], np.int64))[0, 0])


def moving(send: Sender, topic: str, *edges: tuple[str, str]) -> list[RawMessage]:
    return [send.transforms(topic, time_s, *edges) for time_s in (0.0, 1.0)]


def test_transforms_come_first_and_the_prefix_tells_whose_they_are() -> None:
    send = Sender()
    one = surveyed(
        "run",
        send.grid("/a/map", 0.0, "a/map"),
        send.grid("/b/map", 0.0, "b/map"),
        *moving(send, "/tf", ("a/map", "a/odom"), ("a/odom", "a/base_link"), ("b/map", "b/base_footprint")),
        send.pose("/a/pose", 0.0, "a/map"),
    )
    choices = chosen(one)
    assert choices["a"].origin == "/tf:a/map.a/base_link"
    assert choices["b"].origin == "/tf:b/map.b/base_footprint"
    assert x_at(choices["a"], 0.5) == pytest.approx(2.0)  # both edges are (1, 2)
    assert x_at(choices["b"], 0.5) == pytest.approx(1.0)


def test_namespaced_transforms_with_bare_frames() -> None:
    send = Sender()
    one = surveyed(
        "run",
        *(send.grid(f"/{robot}/map", 0.0, "map") for robot in "ab"),
        *(raw for robot in "ab" for raw in moving(send, f"/{robot}/tf", ("map", "base_link"))),
    )
    choices = chosen(one)
    assert choices["b"].origin == "/tf:b/map.b/base_link"
    assert x_at(choices["b"], 0.0) == pytest.approx(1.0)


def test_robots_that_map_in_one_frame_are_told_apart_by_their_base_frames() -> None:
    send = Sender()
    edges = [(parent, f"{robot}/base_link") for robot, parent in (("a", "map"), ("b", "b/odom"))]
    one = surveyed(
        "run",
        *(send.grid(f"/{robot}/map", 0.0, "map") for robot in "ab"),
        *moving(send, "/tf", *edges, ("map", "b/odom")),
        *moving(send, "/tf", ("map", "c")),
    )
    choices = chosen(one)
    assert {robot: choice.origin for robot, choice in choices.items()} == {
        "a": "/tf:map.a/base_link",
        "b": "/tf:map.b/base_link",
    }
    assert x_at(choices["a"], 0.5) == pytest.approx(1.0)
    assert x_at(choices["b"], 0.5) == pytest.approx(2.0)
    given = chosen(one, frames={"a": "c"})
    assert given["a"].origin == "/tf:map.c"


def test_a_shared_frame_comes_after_what_the_robot_has_of_its_own() -> None:
    send = Sender()
    own_pose = surveyed(
        "run",
        *(send.grid(f"/{robot}/map", 0.0, "map") for robot in "ab"),
        *moving(send, "/tf", ("map", "a/odom"), ("map", "b/odom")),
        *(raw for robot in "ab" for raw in moving(send, f"/{robot}/tf", ("odom", "base_link"))),
        *(send.pose(f"/{robot}/pose", time_s, "map") for robot in "ab" for time_s in (0.0, 1.0)),
    )
    assert {choice.origin for choice in chosen(own_pose).values()} == {"/a/pose", "/b/pose"}
    send = Sender()
    own_base = surveyed(
        "run",
        *(send.grid(f"/{robot}/map", 0.0, "map") for robot in "ab"),
        *(raw for robot in "ab" for raw in moving(send, f"/{robot}/tf", ("map", "base_footprint"))),
        *moving(send, "/tf", ("map", "a/base_link"), ("map", "b/base_link")),
    )
    assert chosen(own_base)["a"].origin == "/tf:a/map.a/base_footprint"


def test_another_recordings_frame_of_the_same_name_is_not_shared() -> None:
    send = Sender()
    first = surveyed(
        "one",
        *(send.grid(f"/{robot}/map", 0.0, "map") for robot in "ab"),
        *moving(send, "/a/tf", ("map", "body")),
    )
    send = Sender()
    second = surveyed("two", send.grid("/map", 0.0, "map"), *moving(send, "/tf", ("map", "base_link")))
    with pytest.raises(ConfigError, match="no transforms connect it"):
        chosen(first, second, frames={"a": "base_link"})


def test_one_bag_for_each_robot_with_the_same_frames() -> None:
    files = []
    for name in ("1", "2"):
        send = Sender()
        files.append(surveyed(name, send.grid("/map", 0.0), *moving(send, "/tf", ("map", "base_link"))))
    assert chosen(*files)["2"].origin == "/tf:2/map.2/base_link"


def test_poses_are_preferred_to_odometry_and_goals_are_no_poses() -> None:
    send = Sender()
    one = surveyed(
        "run",
        send.grid("/a/map", 0.0, "a/map"),
        send.pose("/a/goal_pose", 0.0, "a/map", 9.0),
        send.odometry("/a/odom", 0.0, "a/map", 5.0),
        send.pose("/a/slam_pose", 0.0, "a/map", 3.0),
    )
    assert chosen(one)["a"].origin == "/a/slam_pose"
    assert x_at(chosen(one)["a"], 0.0) == pytest.approx(3.0)
    assert chosen(one, topics={"a": "/a/odom"})["a"].origin == "/a/odom"


def test_odometry_in_another_frame_goes_through_the_transforms() -> None:
    send = Sender()
    one = surveyed(
        "run",
        send.grid("/a/map", 0.0, "a/map"),
        *moving(send, "/tf", ("a/map", "a/odom")),
        send.odometry("/a/odom", 0.0, "a/odom", 5.0),
        send.odometry("/a/odom", 1.0, "a/odom", 7.0),
    )
    choice = chosen(one)["a"]
    assert choice.origin == "/a/odom through /tf to a/map"
    assert x_at(choice, 0.5) == pytest.approx(7.0)
    assert choice.topics == {"/tf", "/a/odom"}


def test_a_pose_that_is_not_connected_is_no_pose_and_the_reason_says_so() -> None:
    send = Sender()
    one = surveyed("run", send.grid("/a/map", 0.0, "a/map"), send.odometry("/a/odom", 0.0, "wheel"))
    choice = chosen(one)["a"]
    assert choice.source is None
    assert choice.origin == "nothing moving connects a/map to /a/odom in wheel"
    with pytest.raises(ConfigError, match="not connected"):
        chosen(one, topics={"a": "/a/odom"})


def test_another_base_frame() -> None:
    send = Sender()
    one = surveyed("run", send.grid("/a/map", 0.0, "a/map"), *moving(send, "/tf", ("a/map", "a/laser")))
    assert chosen(one)["a"].source is None
    assert chosen(one, frames={"a": "a/laser"})["a"].origin == "/tf:a/map.a/laser"
    with pytest.raises(ConfigError, match="no transforms connect"):
        chosen(one, frames={"a": "a/arm"})


@pytest.mark.parametrize("option", ["topics", "frames"])
def test_overrides_for_a_robot_that_is_not_there(option: str) -> None:
    one = surveyed("run", Sender().grid("/a/map", 0.0, "a/map"))
    with pytest.raises(ConfigError, match="there are a"):
        chosen(one, **{option: {"z": "x"}})


@pytest.mark.parametrize("map_topic", ["/a/map", "/a/slam/map"])
def test_namespaced_transforms_with_bare_frames_under_a_prefixed_map(map_topic: str) -> None:
    send = Sender()
    one = surveyed(
        "run", send.grid(map_topic, 0.0, "a/map"), *moving(send, "/a/tf", ("a/map", "odom"), ("odom", "base_link"))
    )
    (choice,) = chosen(one).values()
    assert choice.origin == "/tf:a/map.a/base_link"


def test_transforms_that_say_no_time_are_no_pose() -> None:
    send = Sender()
    one = surveyed("run", send.grid("/a/map", 0.0, "a/map"), *moving(send, "/tf_static", ("a/map", "a/base_link")))
    assert "only static transforms" in chosen(one)["a"].origin
