"""The second pass over a recording: its robots' maps in the order of their stamps, streaming."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from mapfusion.grid import OccupancyGrid, apply_update
from mapfusion_io.decode import Decoder, MalformedMessageError
from mapfusion_io.interfaces import RawMessage
from mapfusion_io.messages import GridUpdate, grid_update, occupancy_grid
from mapfusion_io.poses import PoseChoice
from mapfusion_io.robots import MapTopic
from mapfusion_io.survey import Clock, Survey, TopicSurvey, role_of

GridMessage = OccupancyGrid | GridUpdate


@dataclass(frozen=True, slots=True, eq=False)
class MissionRobot:
    """A robot of the mission and what is used of it.

    Attributes:
        found: Its map topic, recording and frame.
        poses: Where its poses come from.
        updates: The topic of patches to its maps, None where there is none.
    """

    found: MapTopic
    poses: PoseChoice
    updates: TopicSurvey | None

    @property
    def name(self) -> str:
        """The robot's name."""
        return self.found.robot

    @property
    def grid_topics(self) -> tuple[TopicSurvey, ...]:
        """The topics that make up its map."""
        return (self.found.topic,) if self.updates is None else (self.found.topic, self.updates)


def stamped_grid_messages(
    survey: Survey, robots: Sequence[MissionRobot], clock: Clock, shift_ns: int
) -> Iterator[tuple[int, MissionRobot, GridMessage]]:
    """Maps and patches of a recording's robots, in the order of their stamps, at equal stamps in file order.

    A message that stands too late in the file is waited for, and only what overtakes it is held.
    """
    owner = {topic.topic: (robot, topic) for robot in robots for topic in robot.grid_topics}
    order = sorted(
        (stamp_ns, arrival)
        for _, topic in owner.values()
        for stamp_ns, arrival in zip(topic.stamps_ns, topic.arrivals, strict=True)
    )
    held: dict[int, tuple[MissionRobot, GridMessage]] = {}
    seen: Counter[str] = Counter()
    turn = 0
    decoder = Decoder()
    for raw in survey.recording.messages(lambda channel: channel.topic in owner and role_of(channel) is not None):
        robot, topic = owner[raw.channel.topic]
        try:
            message = _decoded(raw, decoder)
        except MalformedMessageError:
            continue  # counted by the survey
        held[topic.arrivals[seen[topic.topic]]] = robot, message
        seen[topic.topic] += 1
        while turn < len(order) and order[turn][1] in held:
            stamp_ns, arrival = order[turn]
            yield (stamp_ns + shift_ns, *held.pop(arrival))
            turn += 1


def _decoded(raw: RawMessage, decoder: Decoder) -> GridMessage:
    message = decoder.decode(raw)
    return occupancy_grid(message) if role_of(raw.channel) == "grid" else grid_update(message)


def whole_grid(robot: MissionRobot, message: GridMessage, base: OccupancyGrid | None) -> OccupancyGrid:
    """The robot's map after a message.

    Raises:
        ValueError: The message does not fit to what came before.
    """
    usual = robot.found.frame
    if message.frame_id != usual:
        raise ValueError(f"in frame {message.frame_id!r} instead of {usual!r}")
    if isinstance(message, OccupancyGrid):
        return replace(message, frame_id=robot.found.map_frame)
    if base is None:
        raise ValueError("an update before the first map")
    return apply_update(base, message.col, message.row, message.patch, message.stamp_ns)
