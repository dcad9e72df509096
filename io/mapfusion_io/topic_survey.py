"""What was seen on one topic of a recording."""

from __future__ import annotations

from array import array
from collections import Counter
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from mapfusion.grid import OccupancyGrid
from mapfusion.tf import TransformBuffer
from mapfusion_io.interfaces import Channel
from mapfusion_io.messages import GRID_TYPES, POSE_TYPES, TRANSFORM_TYPES, UPDATE_TYPES
from mapfusion_io.read_limits import ReadLimits
from mapfusion_io.stamp_census import StampRanges

Role = Literal["grid", "update", "transform", "pose"]


@dataclass(slots=True)
class TopicSurvey:
    """What was seen on one topic of one recording, whatever its number of channels.

    Attributes:
        topic: As recorded.
        schema_name: Type of its messages.
        role: What it may serve for, None where its type is not one of ours.
        undecodable: Why its messages cannot be decoded, empty where they can.
        limits: What it may ask for.
        count: Number of messages.
        first_log_ns: Log time of the first message, and of the last one.
        stamps_ns: Grids and updates that can be believed: the stamp of each on the chosen clock, in file order.
        arrivals: Grids and updates that can be believed: the place of each among all of its recording, in file order.
        numbers: Grids and updates that can be believed: the place of each among the topic's messages, from 1.
        lags_ns: Grids and updates: how far each stamp lies after its log time.
        first_ns: Earliest stamp on the chosen clock, of any role but a static transform; None where there is none.
        last_ns: The latest one.
        frames: Grids and poses: how many name which frame, without leading slash.
        num_zero_stamps: Messages whose header's stamp is zero, so that their log time counts.
        refused: Number of messages, or of transforms in them, that were not taken, by kind of loss and reason.
        last_grid: Grids: the last one in file order that can be believed.
        most_cells: Grids: number of cells of the largest that can be believed.
        buffer: Transforms and poses: their samples. A pose topic is an edge from the message's frame to the topic's
            name, whose leading slash keeps it apart from every frame.
    """

    topic: str
    schema_name: str
    role: Role | None
    undecodable: str
    limits: ReadLimits = field(default_factory=ReadLimits)
    count: int = 0
    first_log_ns: int = 0
    last_log_ns: int = 0
    stamps_ns: array[int] = field(default_factory=lambda: array("q"))
    arrivals: array[int] = field(default_factory=lambda: array("q"))
    numbers: array[int] = field(default_factory=lambda: array("q"))
    lags_ns: array[int] = field(default_factory=lambda: array("q"))
    first_ns: int | None = None
    last_ns: int | None = None
    frames: Counter[str] = field(default_factory=Counter)
    num_zero_stamps: int = 0
    refused: Counter[tuple[str, str]] = field(default_factory=Counter)
    last_grid: OccupancyGrid | None = None
    most_cells: int = 0
    buffer: TransformBuffer = field(default_factory=TransformBuffer)

    def refuse(self, kind: str, reason: str, count: int = 1) -> None:
        """Takes note of messages that are not taken; rare reasons share an entry when there are too many."""
        if (kind, reason) not in self.refused and len(self.refused) >= self.limits.losses:
            reason = "for further reasons"
        self.refused[kind, reason] += count

    def settle(self, believable: StampRanges) -> None:
        """Drops what lies far from everything else in time, once all of the recording is known."""
        stamps = np.array(self.stamps_ns, np.int64)
        kept = believable.hold(stamps)
        self.stamps_ns, self.arrivals, self.numbers = (
            array("q", np.array(values, np.int64)[kept].tolist())
            for values in (self.stamps_ns, self.arrivals, self.numbers)
        )
        num_far = int(kept.size - kept.sum()) + self.buffer.keep(believable.hold)
        if num_far:
            self.refuse("malformed message", "its stamp lies days away from everything else", num_far)
        ranges = [(int(stamps[kept].min()), int(stamps[kept].max()))] if kept.any() else []
        ranges += [self.buffer.range_ns] if self.buffer.range_ns else []
        if ranges:
            self.first_ns, self.last_ns = min(first for first, _ in ranges), max(last for _, last in ranges)

    @property
    def lag_ns(self) -> int:
        """Grids and updates: how far their stamps usually lie after their log times."""
        return int(np.median(np.array(self.lags_ns, np.int64))) if self.lags_ns else 0

    @property
    def namespace(self) -> str:
        """The topic without its last part and its outer slashes: `robot1` of `/robot1/map`."""
        return self.topic.strip("/").rpartition("/")[0]

    @property
    def num_refused(self) -> int:
        """Messages, or transforms in them, that were not taken."""
        return self.refused.total()


def role_of(channel: Channel) -> Role | None:
    """What a channel may serve for, by the type of its messages."""
    return _ROLES.get(channel.schema_name)


_ROLES: dict[str, Role] = {
    **dict.fromkeys(GRID_TYPES, "grid"),
    **dict.fromkeys(UPDATE_TYPES, "update"),
    **dict.fromkeys(TRANSFORM_TYPES, "transform"),
    **dict.fromkeys(POSE_TYPES, "pose"),
}
