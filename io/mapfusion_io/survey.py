"""The first pass over a recording: what is in it and when, and every pose; of the grids only the newest is kept."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mapfusion_io.interfaces import Loss, Recording
from mapfusion_io.read_limits import ReadLimits
from mapfusion_io.survey_taker import Clock, SurveyTaker
from mapfusion_io.topic_survey import TopicSurvey

SAME_CLOCK_NS = 10_000_000_000
"""Maps may be this old when they are recorded; stamps further from the log time are of another clock."""


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """One recording after its first pass.

    Attributes:
        recording: The recording.
        name: Its base name without suffix, unique among the mission's recordings.
        size_bytes: Of the file, or of all files of the folder.
        topics: By topic, in the order of their first message.
        losses: What could not be read.
        is_own_output: Whether mapfusion wrote it.
        warnings: What the user should know before trusting its messages.
    """

    recording: Recording
    name: str
    size_bytes: int
    topics: dict[str, TopicSurvey]
    losses: tuple[Loss, ...]
    is_own_output: bool
    warnings: tuple[str, ...] = ()

    @property
    def clock_lag_ns(self) -> int:
        """How far the robots' clocks lie after the recorder's, by the maps; 0 where they tell the same time."""
        lags_ns = [topic.lag_ns for topic in self.topics.values() if topic.lags_ns]
        lag_ns = int(np.median(lags_ns)) if lags_ns else 0
        return lag_ns if abs(lag_ns) > SAME_CLOCK_NS else 0

    @property
    def first_ns(self) -> int | None:
        """Earliest stamp of anything that may serve, None where nothing may."""
        return min((topic.first_ns for topic in self.topics.values() if topic.first_ns is not None), default=None)

    @property
    def last_ns(self) -> int | None:
        """Latest stamp of anything that may serve, None where nothing may."""
        return max((topic.last_ns for topic in self.topics.values() if topic.last_ns is not None), default=None)


def take_survey(recording: Recording, name: str, clock: Clock, limits: ReadLimits | None = None) -> Survey:
    """Reads a recording once.

    Raises:
        LogReadError: Nothing at all can be read.
    """
    taker = SurveyTaker(clock, limits or ReadLimits())
    for raw in recording.messages(taker.note_channel):
        taker.take(raw)
    losses = recording.losses
    is_own = any(record == "mapfusion" for record, _ in recording.metadata())
    return Survey(recording, name, _size_bytes(recording.path), taker.settled(), losses, is_own, taker.warnings)


def _size_bytes(path: Path) -> int:
    files = path.rglob("*") if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files if file.is_file())
