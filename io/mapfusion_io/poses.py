"""Finding out where each robot was: through the transform tree, else by a pose or odometry topic of its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

from mapfusion.errors import ConfigError
from mapfusion.steps import natural_key
from mapfusion.tf import TransformBuffer, TransformChain
from mapfusion_io.read_errors import printable
from mapfusion_io.robots import FoundRobots, MapTopic, UniqueFrames
from mapfusion_io.survey import Survey
from mapfusion_io.topic_survey import TopicSurvey

BASE_FRAMES = ("base_link", "base_footprint")
"""Frames fixed to a robot's body. Source: REP-105."""
_NO_POSE_WORDS = ("goal", "initialpose", "initial_pose", "target", "waypoint")


@dataclass(frozen=True, slots=True, eq=False)
class PoseChoice:
    """Where a robot's poses come from.

    Attributes:
        source: The poses, None where nothing tells.
        origin: How, in words: `/tf:robot1/map.robot1/base_link` or a topic, with the way through TF where there is one;
            without a source, why there is none.
        topics: The topics that are used, of the robot's recording.
    """

    source: TransformChain | None
    origin: str
    topics: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class PoseOverrides:
    """What the user said about poses.

    Attributes:
        topics: Pose topic by robot.
        base_frames: Base frame by robot, as recorded or with the robot's prefix.
    """

    topics: Mapping[str, str]
    base_frames: Mapping[str, str]


def choose_poses(found: FoundRobots, tree: TransformBuffer, overrides: PoseOverrides) -> dict[str, PoseChoice]:
    """The pose source of every robot.

    Args:
        found: The robots.
        tree: What `transform_tree` made of their recordings.
        overrides: What the user said.

    Raises:
        ConfigError: An override names a robot, topic or frame that is not there.
    """
    known = {robot.robot for robot in found.robots}
    for option, given in (("--pose", overrides.topics), ("--base-frame", overrides.base_frames)):
        for robot in given:
            if robot not in known:
                raise ConfigError(f"{option} {robot}=...: there is no such robot; there are {', '.join(sorted(known))}")
    return {robot.robot: _choose(robot, tree, found, overrides) for robot in found.robots}


def transform_tree(frames: UniqueFrames, surveys: Sequence[Survey], shifts_ns: Mapping[str, int]) -> TransformBuffer:
    """One tree of all recordings, in unique frames; a pose topic hangs in it as a frame with a leading slash.

    Args:
        frames: How the recordings' frames are made unique.
        surveys: The recordings.
        shifts_ns: Time to add to the stamps of each, by its name.
    """
    tree = TransformBuffer()
    for survey in surveys:
        for topic in survey.topics.values():
            if topic.role in ("transform", "pose"):

                def unique(frame: str, survey: Survey = survey, topic: TopicSurvey = topic) -> str:
                    if topic.role == "pose" and frame == topic.topic:
                        return _pose_frame(survey, topic.topic)
                    return frames.unique(survey, topic.topic, frame)

                tree.absorb(topic.buffer, unique, shifts_ns[survey.name])
    return tree


def _pose_frame(survey: Survey, topic: str) -> str:
    """Name of a pose topic in the tree, which no recorded frame has: those carry no leading slash."""
    return f"/{survey.name}{topic}"


def _choose(robot: MapTopic, tree: TransformBuffer, found: FoundRobots, overrides: PoseOverrides) -> PoseChoice:
    if robot.robot in overrides.topics:
        return _from_given_topic(robot, overrides.topics[robot.robot], tree)
    if robot.robot in overrides.base_frames:
        return _from_given_frame(robot, overrides.base_frames[robot.robot], tree, found)
    misses = []
    for base in _base_frames(robot, tree):
        chain = _moving(tree.chain(robot.map_frame, base))
        if chain is not None:
            return _through_frame(robot, robot.map_frame, base, chain)
        static = tree.chain(robot.map_frame, base) is not None
        misses.append(f"{base} (only static transforms, which say no time)" if static else base)
    for topic in _pose_topics(robot):
        chain = _moving(tree.chain(robot.map_frame, _pose_frame(robot.survey, topic.topic)))
        if chain is not None:
            return _by_topic(robot, topic, chain)
        misses.append(f"{topic.topic} in {', '.join(sorted(topic.frames))}")
    shared = _shared_map_frame(robot, found)
    for base in _own_base_frames(robot, tree):
        chain = None if shared is None else _moving(tree.chain(shared, base))
        if shared is not None and chain is not None:
            return _through_frame(robot, shared, base, chain)
    if not misses:
        return PoseChoice(None, f"no base frame in /tf and no pose or odometry topic in {robot.map_frame}")
    return PoseChoice(None, f"nothing moving connects {robot.map_frame} to {', '.join(misses)}")


def _moving(chain: TransformChain | None) -> TransformChain | None:
    """The chain, where it has a time at which it holds."""
    return chain if chain is not None and chain.stamps_ns.size else None


def _shared_map_frame(robot: MapTopic, found: FoundRobots) -> str | None:
    """What transforms call the robot's map frame where several robots of a recording map in one frame; else None.

    Each has got a map frame of its own then. Transforms in the robot's own namespace name that one.
    """
    if not any(
        other is not robot and other.survey is robot.survey and other.frame == robot.frame for other in found.robots
    ):
        return None
    transforms = [topic for topic in robot.survey.topics.values() if topic.role == "transform"]
    if any(topic.topic.strip("/").startswith(f"{robot.namespace}/") for topic in transforms):
        return None
    names = (
        found.unique_frames.unique(robot.survey, topic.topic, robot.frame)
        for topic in transforms
        if robot.frame in topic.buffer.frames
    )
    return next(names, None)


def _through_frame(robot: MapTopic, root: str, base: str, chain: TransformChain) -> PoseChoice:
    return PoseChoice(chain, f"/tf:{root}.{base}", _transform_topics(robot))


def _by_topic(robot: MapTopic, topic: TopicSurvey, chain: TransformChain) -> PoseChoice:
    if len(chain.up) + len(chain.down) == 1:
        return PoseChoice(chain, topic.topic, frozenset({topic.topic}))
    origin = f"{topic.topic} through /tf to {robot.map_frame}"
    return PoseChoice(chain, origin, _transform_topics(robot) | {topic.topic})


def _transform_topics(robot: MapTopic) -> frozenset[str]:
    return frozenset(topic.topic for topic in robot.survey.topics.values() if topic.role == "transform")


def _base_frames(robot: MapTopic, tree: TransformBuffer) -> list[str]:
    """Base frames under the robot's prefix, else the only ones that hang below its map frame."""
    under_prefix = _own_base_frames(robot, tree)
    if under_prefix:
        return under_prefix
    return sorted(
        (
            frame
            for frame in tree.frames
            if frame.rpartition("/")[2] in BASE_FRAMES and tree.are_connected(robot.map_frame, frame)
        ),
        key=natural_key,
    )[:1]


def _own_base_frames(robot: MapTopic, tree: TransformBuffer) -> list[str]:
    """Base frames under the robot's prefix."""
    frame = robot.map_frame
    prefix = frame.removesuffix("map") if frame.endswith("map") else f"{frame.rpartition('/')[0]}/".lstrip("/")
    return [prefix + base for base in BASE_FRAMES if prefix + base in tree.frames]


def may_tell_poses(robot: MapTopic, topic: TopicSurvey) -> bool:
    """Whether a topic is a pose or odometry topic of the robot's namespace; goals are no poses."""
    return (
        topic.role == "pose"
        and not topic.undecodable
        and (not robot.namespace or topic.topic.strip("/").startswith(robot.namespace + "/"))
        and not any(word in topic.topic.lower() for word in _NO_POSE_WORDS)
    )


def _pose_topics(robot: MapTopic) -> list[TopicSurvey]:
    """The robot's pose and odometry topics that tell anything, poses before odometry."""
    topics = [
        topic for topic in robot.survey.topics.values() if topic.first_ns is not None and may_tell_poses(robot, topic)
    ]
    return sorted(topics, key=lambda topic: (topic.schema_name.endswith("Odometry"), natural_key(topic.topic)))


def _from_given_topic(robot: MapTopic, name: str, tree: TransformBuffer) -> PoseChoice:
    topic = next((t for t in robot.survey.topics.values() if t.topic.strip("/") == name.strip("/")), None)
    if topic is None or topic.role != "pose":
        what = "there is no such topic" if topic is None else f"{printable(topic.schema_name)} is no pose"
        raise ConfigError(f"--pose {robot.robot}={name}: {what} in {robot.survey.name}")
    chain = _moving(tree.chain(robot.map_frame, _pose_frame(robot.survey, topic.topic)))
    if chain is None:
        frames = printable(", ".join(sorted(topic.frames)) or "no frame")
        raise ConfigError(f"--pose {robot.robot}={name}: its poses are in {frames}, not connected to {robot.map_frame}")
    return _by_topic(robot, topic, chain)


def _from_given_frame(robot: MapTopic, name: str, tree: TransformBuffer, found: FoundRobots) -> PoseChoice:
    frames = (name.strip("/"), found.unique_frames.unique(robot.survey, robot.topic.topic, name.strip("/")))
    roots = (robot.map_frame, _shared_map_frame(robot, found))
    for root, frame in product(roots, frames):
        chain = None if root is None else _moving(tree.chain(root, frame))
        if root is not None and chain is not None:
            return _through_frame(robot, root, frame, chain)
    raise ConfigError(f"--base-frame {robot.robot}={name}: no transforms connect it to {robot.map_frame}")
