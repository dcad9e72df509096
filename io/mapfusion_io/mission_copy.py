"""How a mission's recordings are copied beside its results: which topics and frames get whose prefix."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable

from mapfusion_io.frame_edits import FrameNames
from mapfusion_io.input_copy import CopySource, InputCopy
from mapfusion_io.interfaces import Channel
from mapfusion_io.mission import Mission
from mapfusion_io.sniff import open_one
from mapfusion_io.survey import Survey
from mapfusion_io.topic_names import topic_names


def mission_copy(mission: Mission) -> InputCopy:
    """The inputs' channels; a topic that several recordings have gets its recording's name in front."""
    roots = topic_names(survey.name for survey in mission.surveys)
    owners: dict[str, set[str]] = defaultdict(set)
    for survey in mission.surveys:
        for topic in survey.topics:
            owners[topic].add(survey.name)
    return InputCopy(
        [
            CopySource(
                open_one(
                    survey.recording.path, mission.limits
                ),  # a recording of its own: the mission reads at the same time
                _topics(roots[survey.name], owners),
                _frames(mission, survey),
                mission.shifts_ns[survey.name],
                mission.shifts_ns[survey.name] + survey.clock_lag_ns,
                _hung(mission, survey),
            )
            for survey in mission.surveys
        ]
    )


def _topics(root: str, owners: dict[str, set[str]]) -> Callable[[Channel], str]:
    def topic_for(channel: Channel) -> str:
        return channel.topic if len(owners[channel.topic]) == 1 else f"/{root}/{channel.topic.lstrip('/')}"

    return topic_for


def _frames(mission: Mission, survey: Survey) -> Callable[[Channel], FrameNames | None]:
    def frame_names_for(channel: Channel) -> FrameNames | None:
        if not mission.unique_frames.changes(survey, channel.topic):
            return None
        return lambda frame: mission.unique_frames.unique(survey, channel.topic, frame)

    return frame_names_for


def _hung(mission: Mission, survey: Survey) -> Callable[[Channel], frozenset[str]]:
    map_frames = {robot.found.map_frame for robot in mission.robots}

    def hung_for(channel: Channel) -> frozenset[str]:
        buffer = survey.topics[channel.topic].buffer
        children = {frame for frame in buffer.frames if buffer.parents(frame)}
        return frozenset(mission.unique_frames.unique(survey, channel.topic, frame) for frame in children) & map_frames

    return hung_for
