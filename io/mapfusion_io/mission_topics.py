"""Which topics of its recordings a mission uses, which it does not and why, and what was lost of those that count."""

from __future__ import annotations

from collections.abc import Sequence

from mapfusion_io.grid_stream import MissionRobot
from mapfusion_io.interfaces import Loss
from mapfusion_io.poses import may_tell_poses
from mapfusion_io.robots import FoundRobots, PassedOver, foreign_map
from mapfusion_io.survey import Survey
from mapfusion_io.topic_survey import TopicSurvey

TopicKey = tuple[str, str]
"""Recording's name and topic."""


def used_topics(robots: Sequence[MissionRobot]) -> frozenset[TopicKey]:
    """Everything that a robot needs."""
    maps = {(robot.found.survey.name, topic.topic) for robot in robots for topic in robot.grid_topics}
    poses = {(robot.found.survey.name, topic) for robot in robots for topic in robot.poses.topics}
    return frozenset(maps | poses)


def unused_topics(surveys: Sequence[Survey], found: FoundRobots, used: frozenset[TopicKey]) -> list[PassedOver]:
    """Topics that no robot needs, other than the maps that `found` tells of."""
    reasons = {
        "transform": "no robot's poses come through it",
        "pose": "no robot's poses are taken from it",
        "update": "no robot's map has this name",
    }
    told = {(item.source, item.topic) for item in found.passed_over} | used
    return [
        PassedOver(
            survey.name,
            topic.topic,
            topic.schema_name,
            topic.count,
            topic.undecodable or reasons.get(topic.role or "", "neither map, transform nor pose"),
        )
        for survey in surveys
        for topic in survey.topics.values()
        if (survey.name, topic.topic) not in told
    ]


def losses_that_count(
    surveys: Sequence[Survey], robots: Sequence[MissionRobot], used: frozenset[TopicKey]
) -> list[Loss]:
    """What could not be read or believed of the topics in use, and of those that would be if less had been lost."""
    losses: list[Loss] = []
    for survey in surveys:
        counting = {
            name: topic
            for name, topic in survey.topics.items()
            if (survey.name, name) in used or _is_wanting(survey, topic, robots)
        }
        losses.extend(loss for loss in survey.losses if loss.topic in counting or loss.topic not in survey.topics)
        for topic in counting.values():
            losses.extend(_refused(survey.recording.path.name, topic))
    return losses


def _is_wanting(survey: Survey, topic: TopicSurvey, robots: Sequence[MissionRobot]) -> bool:
    """Whether a topic that is not in use might have given a robot, a robot's patches or its poses."""
    if topic.undecodable or topic.role is None:
        return False
    mine = [robot for robot in robots if robot.found.survey is survey]
    if topic.role == "grid":
        has_robot = any(robot.found.namespace == topic.namespace for robot in mine)
        return not (topic.stamps_ns or has_robot or foreign_map(survey, topic))
    if topic.role == "update":
        maps = {robot.found.topic.topic for robot in mine}
        return not topic.stamps_ns and topic.topic.removesuffix("_updates") in maps
    lost = [robot for robot in mine if robot.poses.source is None]
    return bool(lost) if topic.role == "transform" else any(may_tell_poses(robot.found, topic) for robot in lost)


def _refused(source: str, topic: TopicSurvey) -> list[Loss]:
    return [
        Loss(source, kind, topic.topic, topic.topic, count, reason)
        for (kind, reason), count in sorted(topic.refused.items())
    ]
