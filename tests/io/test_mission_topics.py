import numpy as np
import pytest

from mapfusion_io.interfaces import Loss, RawMessage
from tests.io.fake_recordings import Sender, mission

BAD = np.full((2, 2), 120, np.int8)


def test_every_topic_is_used_or_passed_over_with_a_reason() -> None:
    send = Sender()
    made = mission(
        send.grid("/a/map", 0.0, "a/map"),
        send.transforms("/tf", 0.0, ("a/map", "a/base_link")),
        send.pose("/a/pose", 0.0, "a/map"),
        send.text("/chatter", 0.0),
    )
    assert {item.topic: item.reason for item in made.passed_over} == {
        "/a/pose": "no robot's poses are taken from it",
        "/chatter": "neither map, transform nor pose",
    }


def test_losses_of_topics_that_no_robot_needs_do_not_count() -> None:
    send = Sender()
    made = mission(
        send.grid("/a/map", 1.0),
        send.text("/chatter", 1.0),
        losses=(Loss("run.mcap", "chunk crc", "at 17", "/chatter", 3), Loss("run.mcap", "truncated", "at 99")),
    )
    assert [loss.kind for loss in made.losses] == ["truncated"]


WANTING = {
    "/b/map": lambda send: send.grid("/b/map", 1.0, cells=BAD),
    "/a/map_updates": lambda send: send.update("/a/map_updates", 1.0, BAD, 0, 0),
    "/a/pose": lambda send: send.pose("/a/pose", 1.0, "a/map", x=float("nan")),
    "/tf": lambda send: send.transforms("/tf", 1.0, ("a/map", "a/map")),
}
"""A bad message by its topic, the only one on it."""


@pytest.mark.parametrize("topic", WANTING)
def test_a_topic_of_which_nothing_is_left_is_a_loss_where_it_might_have_served(topic: str) -> None:
    send = Sender()
    made = mission(send.grid("/a/map", 0.0, "a/map"), WANTING[topic](send))
    assert [(loss.topic, loss.count) for loss in made.losses] == [(topic, 1)]


def test_a_topic_of_which_nothing_is_left_is_no_loss_where_others_serve() -> None:
    send = Sender()
    messages: list[RawMessage] = [
        send.grid("/a/map", 0.0, "a/map"),
        send.transforms("/tf", 0.0, ("a/map", "a/base_link")),
        send.grid("/a/raw_map", 1.0, cells=BAD),
        send.grid("/b/costmap", 1.0, cells=BAD),
        send.pose("/a/pose", 1.0, "a/map", x=float("nan")),
        send.update("/b/map_updates", 1.0, BAD, 0, 0),
    ]
    assert mission(*messages).losses == ()


def test_what_was_lost_of_a_robot_without_any_map_left_counts() -> None:
    send = Sender()
    lost = Loss("run.mcap", "chunk crc", "at 17", "/b/map", 3)
    empty = send.grid("/b/map", 1.0, cells=BAD)
    made = mission(send.grid("/a/map", 0.0, "a/map"), empty, losses=(lost,))
    assert lost in made.losses
