"""Which topics a mission's results stand on."""

from __future__ import annotations

import re
from collections.abc import Iterable

from mapfusion.steps import natural_key

TF_TOPIC = "/tf"
TF_STATIC_TOPIC = "/tf_static"
DIAGNOSTICS_TOPIC = "/diagnostics"

_RESERVED = ("map", "pairs")


def topic_names(robots: Iterable[str]) -> dict[str, str]:
    """What stands for each robot in topics, by robot, in natural order.

    Characters outside [A-Za-z0-9_] become `_`, a leading digit gets the prefix `r_`, and clashes get a number from 2
    on. Robots whose names need no change keep them; the others follow in natural order. `map` and `pairs` are taken.
    """
    names: dict[str, str] = {}
    ordered = sorted(set(robots), key=lambda robot: (natural_key(robot), robot))
    for robot in sorted(ordered, key=lambda robot: _legal(robot) != robot):
        name, number = _legal(robot), 2
        while name in names.values() or name in _RESERVED:
            name, number = f"{_legal(robot)}_{number}", number + 1
        names[robot] = name
    return {robot: names[robot] for robot in ordered}


def group_name(base: str, group: int) -> str:
    """A group's frame or root topic: group 1 has the plain name, group k has `_k` after it."""
    return base if group == 1 else f"{base}_{group}"


def is_result_topic(topic: str) -> bool:
    """Whether the topic is the results' alone, which `/tf` is not: the recordings' own transforms stand there too."""
    return topic == DIAGNOSTICS_TOPIC or re.match(r"/fused(_[0-9]+)?(/|$)", topic) is not None


def _legal(robot: str) -> str:
    name = re.sub(r"[^A-Za-z0-9_]", "_", robot)
    return name if re.match(r"[A-Za-z_]", name) else f"r_{name}"
