"""What goes into the pipeline and what comes out of it, so that it runs from a plain list as well as from files."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt

from mapfusion.grid import OccupancyGrid
from mapfusion.result import PairFusion
from mapfusion.transform import SE2, FloatArray

StampArray = npt.NDArray[np.int64]


class PoseSource(Protocol):
    """Where a robot was in its own map frame."""

    @property
    def stamps_ns(self) -> StampArray:
        """(N,) times at which it was measured, ascending, without duplicates."""

    def poses_at(self, stamps_ns: StampArray) -> FloatArray:
        """(N, 3) of x_m, y_m, yaw_rad in the robot's map frame; a row of NaN where the source does not reach."""


@dataclass(frozen=True, slots=True)
class RobotEvent:
    """A robot takes part. Comes before the robot's first grid.

    Attributes:
        robot: Its name.
        map_frame: Frame of its grids, unique among the robots.
        poses: Where it was, for the whole mission; None where nothing tells.
    """

    robot: str
    map_frame: str
    poses: PoseSource | None = None


@dataclass(frozen=True, slots=True)
class GridEvent:
    """A robot's map changed.

    Attributes:
        robot: Name of a robot that was announced.
        stamp_ns: Time on the mission's clock; grids come in its order.
        grid: The whole map from now on.
    """

    robot: str
    stamp_ns: int
    grid: OccupancyGrid


Event = RobotEvent | GridEvent


@dataclass(frozen=True, slots=True)
class Placement:
    """Where a robot's map lies.

    Attributes:
        group: Number of the robot's group, from 1.
        T_group_map: Pose of the robot's map frame in the group's frame.
    """

    group: int
    T_group_map: SE2


@dataclass(frozen=True, slots=True)
class PairReport:
    """A pair of robots at a snapshot in which it was looked at.

    Attributes:
        a: The robot that comes first in natural order; target of the fusion.
        b: The other; source of the fusion.
        fusion: The verdict of this look.
        placed: Whether both are in one group after this snapshot.
        age_a_s: Age of a's grid at the snapshot.
        age_b_s: Age of b's grid at the snapshot.
    """

    a: str
    b: str
    fusion: PairFusion
    placed: bool
    age_a_s: float
    age_b_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """A robot's whole trajectory in its group's frame.

    Attributes:
        stamps_ns: (N,) ascending.
        poses: (N, 3) of x_m, y_m, yaw_rad.
    """

    stamps_ns: StampArray
    poses: FloatArray


@dataclass(frozen=True, slots=True)
class FusionStep:
    """The state of the mission at a snapshot.

    Attributes:
        stamp_ns: Time of the snapshot.
        is_last: Whether it is the last one.
        placements: By robot, those in a group only, in natural order.
        poses: By robot, those in a group whose pose is known at this time; in the group's frame.
        pairs: The pairs that were looked at, in natural order.
        maps: Merged map by group number, where one is due; their stamps are the snapshot's, `frame_id` is empty.
        changes: Joins that began or ended and groups that formed, met or parted at this snapshot, in words.
        paths: By robot, in the last step only.
        map_frames: By robot, of all that take part.
        left_out: By group number, the robots that are not in the group's merged map since it would be too large.
    """

    stamp_ns: int
    is_last: bool
    placements: Mapping[str, Placement]
    poses: Mapping[str, SE2]
    pairs: tuple[PairReport, ...]
    maps: Mapping[int, OccupancyGrid]
    changes: tuple[str, ...] = ()
    paths: Mapping[str, Path] = field(default_factory=dict)
    map_frames: Mapping[str, str] = field(default_factory=dict)
    left_out: Mapping[int, tuple[str, ...]] = field(default_factory=dict)


def natural_key(name: str) -> tuple[tuple[int, int, str], ...]:
    """Sort key that puts robot2 before robot10."""
    parts = re.findall(r"[0-9]+|[^0-9]+", name)
    return tuple((0, int(part), part) if part[0] in "0123456789" else (1, 0, part) for part in parts)
