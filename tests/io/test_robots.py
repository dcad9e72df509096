import pytest

from mapfusion.errors import ConfigError
from mapfusion_io.robots import FoundRobots, RobotOverrides, find_robots
from tests.io.fake_recordings import Sender, surveyed


def names(found: FoundRobots) -> list[tuple[str, str, str]]:
    return [(robot.robot, robot.topic.topic, robot.map_frame) for robot in found.robots]


def reasons(found: FoundRobots) -> dict[str, str]:
    return {item.topic: item.reason for item in found.passed_over}


def test_robots_are_named_after_their_namespaces_in_natural_order() -> None:
    send = Sender()
    one = surveyed(
        "run", *(send.grid(f"/{robot}/map", 0.0, f"{robot}/map") for robot in ("robot10", "robot2", "fleet/r1"))
    )
    assert names(find_robots([one], RobotOverrides())) == [
        ("fleet/r1", "/fleet/r1/map", "fleet/r1/map"),
        ("robot2", "/robot2/map", "robot2/map"),
        ("robot10", "/robot10/map", "robot10/map"),
    ]


def test_robots_with_the_same_topics_are_named_after_their_files_and_their_frames_prefixed() -> None:
    files = [surveyed(name, Sender().grid("/map", 0.0, "map")) for name in ("1", "2", "10")]
    assert names(find_robots(files, RobotOverrides())) == [
        ("1", "/map", "1/map"),
        ("2", "/map", "2/map"),
        ("10", "/map", "10/map"),
    ]


def test_files_that_share_only_a_frame_collide_too() -> None:
    files = [surveyed(name, Sender().grid(f"/{name}_bot/map", 0.0, "map")) for name in ("x", "y")]
    assert names(find_robots(files, RobotOverrides())) == [("x", "/x_bot/map", "x/map"), ("y", "/y_bot/map", "y/map")]


def test_files_that_share_nothing_keep_their_names() -> None:
    files = [
        surveyed("monday", Sender().grid("/a/map", 0.0, "a/map")),
        surveyed("tuesday", Sender().grid("/b/map", 0.0, "b/map")),
    ]
    assert names(find_robots(files, RobotOverrides())) == [("a", "/a/map", "a/map"), ("b", "/b/map", "b/map")]


def test_two_sessions_of_two_robots_are_four_robots() -> None:
    files = []
    for session in ("s1", "s2"):
        send = Sender()
        files.append(surveyed(session, send.grid("/a/map", 0.0, "a/map"), send.grid("/b/map", 0.0, "b/map")))
    assert names(find_robots(files, RobotOverrides())) == [
        ("s1/a", "/a/map", "s1/a/map"),
        ("s1/b", "/b/map", "s1/b/map"),
        ("s2/a", "/a/map", "s2/a/map"),
        ("s2/b", "/b/map", "s2/b/map"),
    ]


def test_namespaced_topics_with_bare_frames_get_prefixed_frames() -> None:
    send = Sender()
    one = surveyed("run", send.grid("/a/map", 0.0, "map"), send.grid("/b/map", 0.0, "map"))
    found = find_robots([one], RobotOverrides())
    assert names(found) == [("a", "/a/map", "a/map"), ("b", "/b/map", "b/map")]
    assert found.unique_frames.unique(one, "/a/tf", "odom") == "a/odom"
    assert found.unique_frames.unique(one, "/tf", "odom") == "odom"


def test_a_map_without_namespace_is_named_after_its_frame_or_its_file() -> None:
    by_frame = surveyed("run", Sender().grid("/map", 0.0, "robot7/map"))
    by_file = surveyed("hall", Sender().grid("/map", 0.0, "map"))
    found = find_robots([by_frame, by_file], RobotOverrides())
    assert [robot.robot for robot in found.robots] == ["hall", "run"]  # both topics are /map
    assert [robot.robot for robot in find_robots([by_frame], RobotOverrides()).robots] == ["robot7"]
    assert [robot.robot for robot in find_robots([by_file], RobotOverrides()).robots] == ["hall"]


def test_costmaps_and_second_maps_are_passed_over() -> None:
    send = Sender()
    one = surveyed(
        "run",
        send.grid("/a/global_costmap/costmap", 0.0, "a/map"),
        send.grid("/a/map_raw", 0.0, "a/map"),
        send.grid("/a/map", 0.0, "a/map"),
    )
    found = find_robots([one], RobotOverrides())
    assert names(found) == [("a", "/a/map", "a/map")]
    assert reasons(found)["/a/global_costmap/costmap"] == "a costmap, not a map"
    assert "its namespace has another map" in reasons(found)["/a/map_raw"]


def test_overrides_add_rename_and_replace() -> None:
    send = Sender()
    one = surveyed("run", *(send.grid(f"/{name}/map", 0.0, f"{name}/map") for name in ("a", "b")))
    two = surveyed("more", Sender().grid("/b/global_costmap/costmap", 0.0, "c/map"))
    found = find_robots([one, two], RobotOverrides({"z": "/a/map", "b": "more:/b/global_costmap/costmap"}))
    assert [(robot.robot, robot.topic.topic) for robot in found.robots] == [
        ("b", "/b/global_costmap/costmap"),
        ("z", "/a/map"),
    ]
    assert reasons(found) == {"/b/map": "--robot b=more:/b/global_costmap/costmap takes its place"}


@pytest.mark.parametrize(
    ("value", "message"),
    [("/nowhere", "no such topic"), ("/chatter", "not a map"), ("/map", "in several recordings")],
)
def test_impossible_overrides_say_what_is_there(value: str, message: str) -> None:
    send = Sender()
    files = [
        surveyed("run", send.grid("/map", 0.0), send.text("/chatter", 0.0)),
        surveyed("more", Sender().grid("/map", 0.0)),
    ]
    with pytest.raises(ConfigError, match=message):
        find_robots(files, RobotOverrides({"a": value}))


def test_two_maps_of_one_frame_get_frames_of_their_own() -> None:
    send = Sender()
    one = surveyed("run", send.grid("/left", 0.0), send.grid("/right", 0.0))
    found = find_robots([one], RobotOverrides({"l": "/left", "r": "/right"}))
    assert len({robot.map_frame for robot in found.robots}) == 2


def test_drop_leaves_a_robot_out_and_knows_the_names() -> None:
    send = Sender()
    one = surveyed("run", *(send.grid(f"/{name}/map", 0.0, f"{name}/map") for name in ("a", "b")))
    found = find_robots([one], RobotOverrides(drop=["a"]))
    assert names(found) == [("b", "/b/map", "b/map")]
    assert reasons(found) == {"/a/map": "dropped by --drop"}
    with pytest.raises(ConfigError, match="there are a, b"):
        find_robots([one], RobotOverrides(drop=["c"]))


def test_files_that_share_any_frame_collide() -> None:
    files = []
    for name in ("r1", "r2"):
        send = Sender()
        files.append(
            surveyed(
                f"file_{name}",
                send.grid(f"/{name}/map", 0.0, f"{name}/map"),
                send.transforms("/tf", 0.0, (f"{name}/map", "odom"), ("odom", "base_link")),
            )
        )
    found = find_robots(files, RobotOverrides())
    assert names(found) == [("file_r1", "/r1/map", "file_r1/r1/map"), ("file_r2", "/r2/map", "file_r2/r2/map")]


def test_two_names_for_one_topic() -> None:
    one = surveyed("run", Sender().grid("/map", 0.0))
    with pytest.raises(ConfigError, match="two names"):
        find_robots([one], RobotOverrides({"a": "/map", "b": "/map"}))
