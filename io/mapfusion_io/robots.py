"""Finding the robots of a mission: which map topic is whose, how it is named, and which frames are its own."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from mapfusion.errors import ConfigError
from mapfusion.steps import natural_key
from mapfusion_io.read_errors import printable
from mapfusion_io.read_limits import ReadLimits
from mapfusion_io.survey import Survey
from mapfusion_io.topic_survey import TopicSurvey


@dataclass(frozen=True, slots=True, eq=False)
class MapTopic:
    """A robot as it was found.

    Attributes:
        robot: Its name.
        survey: The recording that holds its maps.
        topic: Its map topic.
        frame: Frame of its maps as recorded.
        map_frame: The same, unique among the robots.
    """

    robot: str
    survey: Survey
    topic: TopicSurvey
    frame: str
    map_frame: str

    @property
    def namespace(self) -> str:
        """Namespace of its topics, without outer slashes; empty where there is none."""
        return self.topic.namespace


@dataclass(frozen=True, slots=True)
class PassedOver:
    """A topic that is not used.

    Attributes:
        source: Name of the recording.
        topic: The topic.
        schema_name: Type of its messages.
        count: Number of its messages.
        reason: Why it is not used, in words.
    """

    source: str
    topic: str
    schema_name: str
    count: int
    reason: str


@dataclass(frozen=True, slots=True)
class RobotOverrides:
    """What the user said about the robots.

    Attributes:
        maps: Topic by robot name, as TOPIC or FILE:TOPIC.
        drop: Names of robots to leave out.
    """

    maps: Mapping[str, str] = field(default_factory=dict)
    drop: Sequence[str] = ()


@dataclass(frozen=True, slots=True, eq=False)
class UniqueFrames:
    """Makes the frames of several recordings unique.

    Attributes:
        of_recording: Prefix of all frames of a recording, by its name; empty for most.
        of_namespace: By recording and namespace, where topics are namespaced and frames are not.
    """

    of_recording: Mapping[str, str]
    of_namespace: Mapping[tuple[str, str], str]

    def unique(self, survey: Survey, topic: str, frame: str) -> str:
        """The frame that a message on `topic` means when it says `frame`."""
        prefix = self._namespace_prefix(survey, topic)
        inner = frame if frame.startswith(prefix) else prefix + frame
        return self.of_recording[survey.name] + inner

    def changes(self, survey: Survey, topic: str) -> bool:
        """Whether frames on `topic` get another name at all."""
        return bool(self.of_recording[survey.name] or self._namespace_prefix(survey, topic))

    def _namespace_prefix(self, survey: Survey, topic: str) -> str:
        namespace = topic.strip("/").rpartition("/")[0]
        while namespace:  # a namespace inside another one has the other's prefix
            if (survey.name, namespace) in self.of_namespace:
                return self.of_namespace[survey.name, namespace]
            namespace = namespace.rpartition("/")[0]
        return ""


@dataclass(frozen=True, slots=True, eq=False)
class FoundRobots:
    """The robots in natural order, how frames are made unique, and the map topics that are no robot's.

    Attributes:
        over_limit: Those of `passed_over` that are one robot, or one map, too many.
    """

    robots: tuple[MapTopic, ...]
    unique_frames: UniqueFrames
    passed_over: tuple[PassedOver, ...]
    over_limit: tuple[PassedOver, ...] = ()


def find_robots(surveys: Sequence[Survey], overrides: RobotOverrides, limits: ReadLimits | None = None) -> FoundRobots:
    """A robot is a map topic, named after its namespace, or after its file where topics or frames of files collide.

    Robots whose maps would be over a limit together with those before them in natural order are left out.

    Raises:
        ConfigError: An override names a topic or a robot that is not there, or a name twice.
    """
    limits = limits or ReadLimits()
    chosen, passed_over = _choose(surveys, overrides)
    of_namespace = _namespace_prefixes(surveys, chosen)
    colliding = _colliding(chosen, of_namespace)
    of_recording = {survey.name: f"{survey.name}/" if survey.name in colliding else "" for survey in surveys}
    frames = UniqueFrames(of_recording, of_namespace)
    named, replaced = _names(chosen, colliding, overrides)
    passed_over.extend(replaced)
    for robot in overrides.drop:
        if robot not in named:
            known = _listed(sorted(named, key=natural_key))
            raise ConfigError(f"--drop {robot}: there is no such robot; there are {known}")
    robots: list[MapTopic] = []
    over_limit: list[PassedOver] = []
    num_cells = 0
    for robot in sorted(named, key=natural_key):
        survey, topic = named[robot]
        if robot in overrides.drop:
            passed_over.append(_passed(survey, topic, "dropped by --drop"))
            continue
        if len(robots) == limits.robots:
            over_limit.append(_passed(survey, topic, f"more than {limits.robots} robots"))
            continue
        if num_cells + topic.most_cells > limits.all_cells:
            over_limit.append(
                _passed(survey, topic, f"more than {limits.all_cells} cells in all robots' maps together")
            )
            continue
        num_cells += topic.most_cells
        map_frame = frames.unique(survey, topic.topic, _frame(topic))
        if any(map_frame == other.map_frame for other in robots):
            map_frame = f"{robot}/{map_frame}"
        robots.append(MapTopic(robot, survey, topic, _frame(topic), map_frame))
    return FoundRobots(tuple(robots), frames, (*passed_over, *over_limit), tuple(over_limit))


_Choice = tuple[Survey, TopicSurvey]


def _choose(surveys: Sequence[Survey], overrides: RobotOverrides) -> tuple[list[_Choice], list[PassedOver]]:
    """One map topic for each namespace of each recording."""
    given = [id(_override(surveys, value)[1]) for value in overrides.maps.values()]
    if len(set(given)) < len(given):
        raise ConfigError("--robot: two names for one map topic")
    explicit = set(given)
    chosen: list[_Choice] = []
    passed_over: list[PassedOver] = []
    for survey in surveys:
        by_namespace: dict[str, list[TopicSurvey]] = defaultdict(list)
        for topic in survey.topics.values():
            if topic.role != "grid":
                continue
            reason = "" if id(topic) in explicit else _no_robots_map(survey, topic)
            if reason:
                passed_over.append(_passed(survey, topic, reason))
            elif id(topic) in explicit:
                chosen.append((survey, topic))
            else:
                by_namespace[topic.namespace].append(topic)
        taken = {topic.namespace for _, topic in chosen if survey.topics.get(topic.topic) is topic}
        for namespace, topics in by_namespace.items():
            best = min(topics, key=lambda topic: (topic.topic.rpartition("/")[2] != "map", natural_key(topic.topic)))
            others = topics if namespace in taken else [topic for topic in topics if topic is not best]
            if namespace not in taken:
                chosen.append((survey, best))
            reason = "its namespace has another map; --robot NAME={} takes this one"
            passed_over.extend(_passed(survey, topic, reason.format(topic.topic)) for topic in others)
    return chosen, passed_over


def foreign_map(survey: Survey, topic: TopicSurvey) -> str:
    """Why a topic with maps is no robot's, whatever its messages hold; empty where it may be one's."""
    if topic.undecodable:
        return topic.undecodable
    if "costmap" in topic.topic:
        return "a costmap, not a map"
    if survey.is_own_output and topic.topic.startswith("/fused"):
        return "an earlier result of mapfusion"
    return ""


def _no_robots_map(survey: Survey, topic: TopicSurvey) -> str:
    if topic.stamps_ns:
        return foreign_map(survey, topic)
    return foreign_map(survey, topic) or ("no message that can be believed" if topic.count else "no messages")


def _colliding(chosen: Sequence[_Choice], of_namespace: Mapping[tuple[str, str], str]) -> set[str]:
    """Names of the recordings with robots that share a map topic or any frame with another one."""
    within = UniqueFrames({survey.name: "" for survey, _ in chosen}, of_namespace)
    used: dict[tuple[str, str], set[str]] = defaultdict(set)
    for survey, topic in chosen:
        used["topic", topic.topic].add(survey.name)
        used["frame", within.unique(survey, topic.topic, _frame(topic))].add(survey.name)
    for survey in {survey.name: survey for survey, _ in chosen}.values():
        for other in survey.topics.values():
            for frame in other.buffer.frames - {other.topic}:
                used["frame", within.unique(survey, other.topic, frame)].add(survey.name)
    return {name for names in used.values() if len(names) > 1 for name in names}


def _namespace_prefixes(surveys: Sequence[Survey], chosen: Sequence[_Choice]) -> dict[tuple[str, str], str]:
    """Prefixes of the frames of namespaces in which topics are namespaced and frames are not.

    Those are namespaces with transforms of their own, and those of robots that share a map frame.
    """
    prefixes = {}
    for survey in surveys:
        mine = [topic for owner, topic in chosen if owner is survey]
        frames = Counter(_frame(topic) for topic in mine)
        shared = {topic.namespace for topic in mine if frames[_frame(topic)] > 1}
        with_transforms = {topic.namespace for topic in survey.topics.values() if topic.role == "transform"}
        for namespace in (shared | with_transforms) - {""}:
            prefixes[survey.name, namespace] = namespace + "/"
    return prefixes


def _names(
    chosen: Sequence[_Choice], colliding: set[str], overrides: RobotOverrides
) -> tuple[dict[str, _Choice], list[PassedOver]]:
    """Map topics by robot name, and those whose name the user gave to another topic."""
    surveys = [survey for survey, _ in chosen]
    given = {id(_override(surveys, value)[1]): robot for robot, value in overrides.maps.items()}
    per_recording = Counter(survey.name for survey, _ in chosen)
    named = {given[id(topic)]: (survey, topic) for survey, topic in chosen if id(topic) in given}
    replaced = []
    for survey, topic in chosen:
        if id(topic) in given:
            continue
        namespace = topic.namespace or _frame(topic).rpartition("/")[0]
        if survey.name in colliding:
            name = survey.name if per_recording[survey.name] == 1 or not namespace else f"{survey.name}/{namespace}"
        else:
            name = namespace or survey.name
        name = printable(name)  # it goes into tables, diagnostics and pages
        if name in overrides.maps:
            replaced.append(_passed(survey, topic, f"--robot {name}={overrides.maps[name]} takes its place"))
        else:
            named[_unused(name, named)] = (survey, topic)
    return named, replaced


def _override(surveys: Sequence[Survey], value: str) -> _Choice:
    """The map topic that TOPIC or FILE:TOPIC means."""
    file, colon, topic = value.rpartition(":")
    found = [
        (survey, survey.topics[name])
        for survey in dict.fromkeys(surveys)
        for name in survey.topics
        if name.strip("/") == topic.strip("/")
        and (not colon or file in (survey.name, survey.recording.path.name, str(survey.recording.path)))
    ]
    maps = [choice for choice in found if choice[1].role == "grid"]
    if len(maps) == 1:
        if not maps[0][1].stamps_ns:
            raise ConfigError(f"--robot ...={value}: it holds no map that can be believed")
        return maps[0]
    if found and not maps:
        raise ConfigError(f"--robot ...={value}: {found[0][1].schema_name}, not a map")
    if maps:
        raise ConfigError(f"--robot ...={value}: in several recordings; say which as {maps[0][0].name}:{topic}")
    known = [name for survey in surveys for name, found_topic in survey.topics.items() if found_topic.role == "grid"]
    raise ConfigError(f"--robot ...={value}: no such topic; the map topics are {_listed(known)}")


def _unused(name: str, taken: Mapping[str, object]) -> str:
    number, unused = 2, name
    while unused in taken:
        unused, number = f"{name}_{number}", number + 1
    return unused


def _frame(topic: TopicSurvey) -> str:
    """The frame that most of a topic's grids name, the first of equals."""
    return topic.frames.most_common(1)[0][0]


def _passed(survey: Survey, topic: TopicSurvey, reason: str) -> PassedOver:
    return PassedOver(survey.name, topic.topic, topic.schema_name, topic.count, reason)


def _listed(names: Sequence[str]) -> str:
    return ", ".join(map(printable, names)) if names else "none"
