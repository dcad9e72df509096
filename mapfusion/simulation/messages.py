"""What a simulated mission consists of, and what its robots send."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from mapfusion.grid import Cells, OccupancyGrid
from mapfusion.simulation.explore import Trajectory
from mapfusion.transform import SE2


@dataclass(frozen=True, slots=True)
class MapMessage:
    """A robot's whole map."""

    robot: str
    grid: OccupancyGrid

    @property
    def stamp_ns(self) -> int:
        """Time of the map."""
        return self.grid.stamp_ns


@dataclass(frozen=True, slots=True, eq=False)
class MapUpdateMessage:
    """A rectangle of a robot's last whole map that changed, its first cell at (row, col)."""

    robot: str
    frame_id: str
    stamp_ns: int
    col: int
    row: int
    cells: Cells


@dataclass(frozen=True, slots=True)
class PoseMessage:
    """Where a robot believes to be, as the two transforms of REP-105."""

    robot: str
    stamp_ns: int
    T_map_odom: SE2
    T_odom_base: SE2


MissionMessage = MapMessage | MapUpdateMessage | PoseMessage


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedRobot:
    """A robot with the truth about it.

    Attributes:
        name: `robot1`, `robot2`, ...
        building: Number of its building, from 0.
        resolution_m: Edge length of its map's cells.
        T_world_map: Pose of its map frame in the world of its building.
        trajectory: Where it was in that world, at every pose that is recorded.
    """

    name: str
    building: int
    resolution_m: float
    T_world_map: SE2
    trajectory: Trajectory

    @property
    def map_frame(self) -> str:
        """Frame of its maps."""
        return f"{self.name}/map"


@dataclass(frozen=True, slots=True, eq=False)
class Mission:
    """A simulated mission.

    Attributes:
        robots: The robots, in order of their numbers.
        exact_odometry: Whether every `T_map_odom` is the identity throughout.
        messages: Gives the mission's messages in order of their stamps, made while they are asked for; the same ones
            at every call.
    """

    robots: tuple[SimulatedRobot, ...]
    exact_odometry: bool
    messages: Callable[[], Iterator[MissionMessage]]
