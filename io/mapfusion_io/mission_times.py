"""When a mission happened: its recordings' clocks brought together, its time range, and what is odd about its times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from mapfusion.errors import ConfigError
from mapfusion.steps import PoseSource, StampArray
from mapfusion.timeline import SILENCE_NS
from mapfusion.transform import FloatArray
from mapfusion_io.grid_stream import MissionRobot
from mapfusion_io.survey import SAME_CLOCK_NS, Survey
from mapfusion_io.time_range import TimeRange


@dataclass(frozen=True, slots=True, eq=False)
class ClippedPoses:
    """A `PoseSource` within a time range.

    Attributes:
        source: All poses.
        start_ns: Start of the range, None where open.
        end_ns: End of the range, exclusive, None where open.
    """

    source: PoseSource
    start_ns: int | None
    end_ns: int | None

    @property
    def stamps_ns(self) -> StampArray:
        """(N,) times within the range."""
        stamps = self.source.stamps_ns
        low = 0 if self.start_ns is None else int(np.searchsorted(stamps, self.start_ns))
        high = stamps.size if self.end_ns is None else int(np.searchsorted(stamps, self.end_ns))
        return stamps[low:high]

    def poses_at(self, stamps_ns: StampArray) -> FloatArray:
        """(N, 3) of x_m, y_m, yaw_rad."""
        return self.source.poses_at(stamps_ns)


def recording_shifts_ns(surveys: Sequence[Survey], align_start: bool) -> dict[str, int]:
    """Time to add to each recording's stamps so that all start with the first one."""
    starts = {survey.name: survey.first_ns for survey in surveys if survey.first_ns is not None}
    if not align_start or not starts:
        return dict.fromkeys((survey.name for survey in surveys), 0)
    common_ns = next(iter(starts.values()))
    return {survey.name: common_ns - starts.get(survey.name, common_ns) for survey in surveys}


def mission_stamps(robots: Sequence[MissionRobot], shifts_ns: Mapping[str, int]) -> StampArray:
    """(N,) stamps of every map and pose of every robot, ascending."""
    stamps = [
        np.array(topic.stamps_ns, np.int64) + shifts_ns[robot.found.survey.name]
        for robot in robots
        for topic in robot.grid_topics
    ] + [robot.poses.source.stamps_ns for robot in robots if robot.poses.source is not None]
    found: StampArray = np.sort(np.concatenate([*stamps, np.empty(0, np.int64)]))
    return found


def resolved_range(time_range: TimeRange, stamps_ns: StampArray) -> tuple[int, int, int | None, int | None]:
    """First and last stamp, and start and end of the range.

    Raises:
        ConfigError: No stamp lies in the range.
    """
    if stamps_ns.size == 0:
        return 0, 0, None, None
    first_ns, last_ns = int(stamps_ns[0]), int(stamps_ns[-1])
    start_ns, end_ns = time_range.resolve(first_ns)
    if (start_ns is not None and start_ns > last_ns) or (end_ns is not None and end_ns <= first_ns):
        raise ConfigError(
            f"nothing was recorded in the time range; the mission lasts {(last_ns - first_ns) * 1e-9:.1f} s "
            f"from {_date(first_ns)}"
        )
    return first_ns, last_ns, start_ns, end_ns


def reported_ns(stamps_ns: StampArray, start_ns: int | None, end_ns: int | None) -> int:
    """Time between stamps (N,) within the range, of silences only as much as snapshots are made in."""
    low = 0 if start_ns is None else int(np.searchsorted(stamps_ns, start_ns))
    high = stamps_ns.size if end_ns is None else int(np.searchsorted(stamps_ns, end_ns))
    return int(np.minimum(np.diff(stamps_ns[low:high]), 2 * SILENCE_NS).sum())


def apart_in_time(
    surveys: Sequence[Survey], robots: Sequence[MissionRobot], shifts_ns: Mapping[str, int]
) -> tuple[str, ...]:
    """A warning where two recordings with robots share no time."""
    used = {robot.found.survey.name for robot in robots}
    spans = [
        (one.first_ns + shifts_ns[one.name], one.last_ns + shifts_ns[one.name], one.name)
        for one in surveys
        if one.name in used and one.first_ns is not None and one.last_ns is not None
    ]
    spans.sort()
    gaps = []
    end_ns, last = spans[0][1:] if spans else (0, "")
    for start_ns, stop_ns, name in spans[1:]:
        if start_ns > end_ns:
            gaps.append(f"{name} starts {_duration(start_ns - end_ns)} after {last} ends")
        if stop_ns > end_ns:
            end_ns, last = stop_ns, name
    if not gaps:
        return ()
    return (
        f"the recordings do not overlap in time: {'; '.join(gaps)}. "
        "Give --align-start to shift them to a common start.",
    )


def clocks_apart(robots: Sequence[MissionRobot]) -> list[str]:
    """A warning for each robot whose maps' headers and the recorder's log tell different times."""
    warnings = []
    for robot in robots:
        lag_ns = robot.found.topic.lag_ns
        if abs(lag_ns) > SAME_CLOCK_NS:
            where = "ahead of" if lag_ns > 0 else "behind"
            warnings.append(
                f"the clock of {robot.name} is {_duration(abs(lag_ns))} {where} the recorder's, by its maps' headers. "
                "Robots are compared at equal header times; --clock log takes the recorder's times instead."
            )
    return warnings


def _duration(span_ns: int) -> str:
    seconds = span_ns * 1e-9
    for unit, length in (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 2 * length:
            return f"{seconds / length:.1f} {unit}"
    return f"{seconds:.1f} s"


def _date(stamp_ns: int) -> str:
    return datetime.fromtimestamp(stamp_ns // 1_000_000_000, UTC).isoformat().replace("+00:00", "Z")
