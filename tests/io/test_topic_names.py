"""Topics of robots with any name."""

from __future__ import annotations

import re

import pytest

from mapfusion_io.topic_names import group_name, is_result_topic, topic_names


def test_plain_names_stay_and_come_in_natural_order() -> None:
    assert list(topic_names(["robot10", "robot2", "robot1"]).items()) == [
        ("robot1", "robot1"),
        ("robot2", "robot2"),
        ("robot10", "robot10"),
    ]


@pytest.mark.parametrize(
    ("robot", "name"),
    [
        ("1", "r_1"),
        ("2nd floor", "r_2nd_floor"),
        ("fleet/a", "fleet_a"),
        ("Jäger", "J_ger"),
        ("٣", "_"),
        ("map", "map_2"),
        ("pairs", "pairs_2"),
        ("", "r_"),
    ],
)
def test_what_topics_cannot_hold_is_replaced(robot: str, name: str) -> None:
    assert topic_names([robot]) == {robot: name}


def test_clashes_get_a_number_and_legal_names_stay() -> None:
    names = topic_names(["a b", "a-b", "a_b", "a/b", "a_b_2"])
    assert names["a_b"] == "a_b"
    assert names["a_b_2"] == "a_b_2"
    assert names == {"a b": "a_b_3", "a-b": "a_b_4", "a/b": "a_b_5", "a_b": "a_b", "a_b_2": "a_b_2"}
    assert all(re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name) for name in names.values())


def test_groups_after_the_first_have_a_number() -> None:
    assert [group_name("world", group) for group in (1, 2, 3)] == ["world", "world_2", "world_3"]


@pytest.mark.parametrize("topic", ["/fused/map", "/fused_2/robot1/pose", "/fused/pairs/a/b", "/diagnostics", "/fused"])
def test_result_topics(topic: str) -> None:
    assert is_result_topic(topic)


@pytest.mark.parametrize("topic", ["/tf", "/tf_static", "/fused_map", "/robot1/fused/map", "/robot1/diagnostics"])
def test_other_topics(topic: str) -> None:
    assert not is_result_topic(topic)
