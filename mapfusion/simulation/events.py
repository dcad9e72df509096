"""A simulated mission as the pipeline takes it, without any file between."""

from __future__ import annotations

from collections.abc import Iterator

from mapfusion.grid import OccupancyGrid, apply_update
from mapfusion.simulation.messages import MapMessage, MapUpdateMessage, Mission
from mapfusion.steps import Event, GridEvent, RobotEvent


def mission_events(mission: Mission) -> Iterator[Event]:
    """The robots, without poses, and every map they send, updates laid over the last whole map."""
    for robot in mission.robots:
        yield RobotEvent(robot.name, robot.map_frame)
    newest: dict[str, OccupancyGrid] = {}
    for message in mission.messages():
        if isinstance(message, MapMessage):
            newest[message.robot] = message.grid
        elif isinstance(message, MapUpdateMessage):
            base = newest[message.robot]
            newest[message.robot] = apply_update(base, message.col, message.row, message.cells, message.stamp_ns)
        else:
            continue
        yield GridEvent(message.robot, message.stamp_ns, newest[message.robot])
