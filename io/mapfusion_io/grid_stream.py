"""The second pass over a recording: its robots' maps in the order of their stamps, streaming."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

from mapfusion.errors import LogReadError
from mapfusion.grid import OccupancyGrid, apply_update
from mapfusion_io.decode import Decoder
from mapfusion_io.messages import GridUpdate
from mapfusion_io.poses import PoseChoice
from mapfusion_io.read_errors import read_error
from mapfusion_io.read_limits import ReadLimits
from mapfusion_io.robots import MapTopic
from mapfusion_io.survey import Survey
from mapfusion_io.survey_taker import map_message
from mapfusion_io.topic_survey import TopicSurvey

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
    survey: Survey,
    robots: Sequence[MissionRobot],
    shift_ns: int,
    limits: ReadLimits,
    lose: Callable[[str], None],
) -> Iterator[tuple[int, MissionRobot, GridMessage]]:
    """Maps and patches of a recording's robots, in the order of their stamps, at equal stamps in file order.

    A message that stands too late in the file is waited for, and only what overtakes it is held; where that gets too
    much, the late message is given up.

    Args:
        survey: The recording after its first pass.
        robots: Those of its robots that are wanted.
        shift_ns: Time to add to the stamps.
        limits: What may be held.
        lose: Takes the topic of each message that was given up.

    Raises:
        LogReadError: The recording is no longer what it was in the first pass.
    """
    owner = {topic.topic: (robot, topic) for robot in robots for topic in robot.grid_topics}
    order = sorted(
        (stamp_ns, arrival, topic.topic)
        for _, topic in owner.values()
        for stamp_ns, arrival in zip(topic.stamps_ns, topic.arrivals, strict=True)
    )
    arrival_of = {
        (topic.topic, number): arrival
        for _, topic in owner.values()
        for number, arrival in zip(topic.numbers, topic.arrivals, strict=True)
    }
    held: dict[int, tuple[MissionRobot, GridMessage]] = {}
    given_up: set[int] = set()
    seen: Counter[str] = Counter()
    turn, num_held_cells = 0, 0
    decoder = Decoder()
    for raw in survey.recording.messages(lambda channel: channel.topic in owner):
        robot, topic = owner[raw.channel.topic]
        seen[topic.topic] += 1
        arrival = arrival_of.pop((topic.topic, seen[topic.topic]), None)
        if arrival is None or arrival in given_up:
            continue  # counted by the survey, or by `lose`
        try:
            message = map_message(topic.role, decoder.decode(raw), limits)
        except LogReadError as error:
            raise _changed(survey) from error
        held[arrival] = robot, message
        num_held_cells += _num_cells(message)
        while turn < len(order) and (order[turn][1] in held or num_held_cells > limits.held_cells):
            stamp_ns, next_arrival, late_topic = order[turn]
            turn += 1
            if next_arrival in held:
                next_robot, next_message = held.pop(next_arrival)
                num_held_cells -= _num_cells(next_message)
                yield stamp_ns + shift_ns, next_robot, next_message
            else:
                given_up.add(next_arrival)
                lose(late_topic)
    if turn < len(order):
        raise _changed(survey)


def _num_cells(message: GridMessage) -> int:
    return message.cells.size if isinstance(message, OccupancyGrid) else message.patch.size


def _changed(survey: Survey) -> LogReadError:
    return read_error(survey.recording.path, "changed while it was read", "Wait until its recording has ended.")


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
