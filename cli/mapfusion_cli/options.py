"""Options that several verbs share: how to read recordings."""

from __future__ import annotations

import math
import os
from collections.abc import Collection, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mapfusion.errors import ConfigError

if TYPE_CHECKING:
    from mapfusion.config import Prior
    from mapfusion_io.mission import MissionOptions


_LIMITS = "Limits: what is over one is passed over and named as a loss"

WORLD_FRAME = "world"
"""Usual name of the merged frame."""


class Clock(StrEnum):
    """Whose time counts."""

    header = "header"
    log = "log"


ClockOption = Annotated[
    Clock,
    typer.Option(help="Whose time counts: the messages' headers (log time where the header's is zero), or the log."),
]
AlignStartOption = Annotated[
    bool, typer.Option("--align-start", help="Shift recordings that were made at different times to a common start.")
]
RobotOption = Annotated[
    list[str] | None,
    typer.Option("--robot", metavar="NAME=[FILE:]TOPIC", help="Name a robot's map topic yourself. May be repeated."),
]
DropOption = Annotated[
    list[str] | None, typer.Option("--drop", metavar="NAME", help="Leave a robot out. May be repeated.")
]
PoseOption = Annotated[
    list[str] | None,
    typer.Option("--pose", metavar="NAME=TOPIC", help="Take a robot's poses from this topic. May be repeated."),
]
BaseFrameOption = Annotated[
    list[str] | None,
    typer.Option("--base-frame", metavar="NAME=FRAME", help="Frame of a robot's body in TF. May be repeated."),
]
PriorOption = Annotated[
    list[str] | None,
    typer.Option(
        "--prior",
        metavar="NAME=X,Y,YAW[,SIGMA_M,SIGMA_DEG]",
        help="Known start: pose of the robot's map frame in the world, metres and radians. Fixed, or as sure as the "
        "sigmas (metres, degrees) say. The world is the map frame of --reference, or of the first robot. May be "
        "repeated.",
    ),
]
NeverOption = Annotated[
    list[str] | None,
    typer.Option("--never", metavar="A,B", help="Two robots that must not come into one group. May be repeated."),
]
MaxChunkOption = Annotated[
    int,
    typer.Option("--max-chunk", metavar="MIB", min=1, help="Largest chunk or message.", rich_help_panel=_LIMITS),
]
MaxMapCellsOption = Annotated[
    int, typer.Option("--max-map-cells", metavar="N", min=1, help="Largest map.", rich_help_panel=_LIMITS)
]
MaxAllCellsOption = Annotated[
    int,
    typer.Option(
        "--max-all-cells",
        metavar="N",
        min=1,
        help="Most cells of all robots' maps together, of each its largest; further robots are left out.",
        rich_help_panel=_LIMITS,
    ),
]
MaxMessagesOption = Annotated[
    int,
    typer.Option(
        "--max-messages",
        metavar="N",
        min=1,
        help="Most maps, transforms and poses of a recording.",
        rich_help_panel=_LIMITS,
    ),
]
MaxMergedCellsOption = Annotated[
    int,
    typer.Option(
        "--max-merged-cells",
        metavar="N",
        min=1,
        help="Largest merged map; the farthest robots are left out of a larger one.",
    ),
]
MaxRobotsOption = Annotated[
    int, typer.Option("--max-robots", metavar="N", min=1, help="Most robots.", rich_help_panel=_LIMITS)
]
MAX_CHUNK_MIB, MAX_MAP_CELLS, MAX_ALL_CELLS, MAX_MESSAGES, MAX_ROBOTS = 256, 32 * 2**20, 128 * 2**20, 10_000_000, 100
"""The defaults of `mapfusion_io.read_limits.ReadLimits`, which takes too long to import for `--help`."""
StartOption = Annotated[
    str | None,
    typer.Option(metavar="TIME", help="Use nothing from before: seconds from the start, unix seconds, or RFC 3339."),
]
EndOption = Annotated[str | None, typer.Option(metavar="TIME", help="Use nothing from this time on.")]
DurationOption = Annotated[float | None, typer.Option(metavar="SECONDS", help="Use this much from the start on.")]


def mission_options(
    *,
    clock: Clock,
    align_start: bool,
    robot: Sequence[str] | None,
    drop: Sequence[str] | None,
    pose: Sequence[str] | None,
    base_frame: Sequence[str] | None,
    max_chunk: int,
    max_map_cells: int,
    max_all_cells: int,
    max_messages: int,
    max_robots: int,
    start: str | None = None,
    end: str | None = None,
    duration: float | None = None,
) -> MissionOptions:
    """The options of a command line for `open_recording`.

    Raises:
        ConfigError: One of them is not NAME=VALUE.
    """
    from mapfusion_io.mission import MissionOptions
    from mapfusion_io.read_limits import ReadLimits
    from mapfusion_io.time_range import TimeRange

    return MissionOptions(
        clock="log" if clock is Clock.log else "header",
        align_start=align_start,
        robots=named_values("--robot", robot),
        drop=tuple(drop or ()),
        poses=named_values("--pose", pose),
        base_frames=named_values("--base-frame", base_frame),
        time_range=TimeRange(start, end, duration),
        limits=ReadLimits(
            record_bytes=max_chunk * 2**20,
            map_cells=max_map_cells,
            all_cells=max_all_cells,
            messages=max_messages,
            robots=max_robots,
        ),
    )


def priors(values: Sequence[str] | None) -> dict[str, Prior]:
    """--prior options by robot.

    Raises:
        ConfigError: One is not NAME=X,Y,YAW or NAME=X,Y,YAW,SIGMA_M,SIGMA_DEG.
    """
    from mapfusion.config import Prior
    from mapfusion.transform import SE2

    found = {}
    for name, text in named_values("--prior", values).items():
        try:
            x_m, y_m, yaw_rad, *sigmas = (float(part) for part in text.split(","))
            sigma_m, sigma_deg = sigmas or (0.0, 0.0)
            found[name] = Prior(SE2(x_m, y_m, yaw_rad), sigma_m, math.radians(sigma_deg))
        except ValueError as error:
            raise ConfigError(
                f"--prior {name}={text}: must be X,Y,YAW or X,Y,YAW,SIGMA_M,SIGMA_DEG ({error})"
            ) from error
    return found


def pairs_apart(values: Sequence[str] | None) -> frozenset[frozenset[str]]:
    """--never options.

    Raises:
        ConfigError: One is not two different names.
    """
    pairs = [frozenset(value.split(",")) for value in values or ()]
    for pair, value in zip(pairs, values or (), strict=True):
        if len(pair) != 2 or not all(pair):
            raise ConfigError(f"--never {value}: must be two robots, A,B")
    return frozenset(pairs)


def named_values(option: str, values: Sequence[str] | None) -> dict[str, str]:
    """NAME=VALUE options by name.

    Raises:
        ConfigError: No `=`, an empty side, or a name given twice.
    """
    named: dict[str, str] = {}
    for value in values or ():
        name, equals, rest = value.partition("=")
        if not (name and equals and rest):
            raise ConfigError(f"{option} {value}: must be NAME=VALUE")
        if name in named:
            raise ConfigError(f"{option} {value}: {name} was given twice")
        named[name] = rest
    return named


def existing(paths: Sequence[Path]) -> None:
    """Raises:
    LogReadError: An input is not there.
    """
    from mapfusion.errors import LogReadError
    from mapfusion_io.read_errors import os_error

    for path in paths:
        try:
            is_there = path.exists()
        except OSError as error:  # a name that is too long, a folder that may not be entered
            raise os_error(path, error) from error
        if not is_there:
            raise LogReadError(f"{path}: there is no such file or folder")


def real_paths(inputs: Sequence[Path]) -> list[Path]:
    """Where the inputs lie.

    Raises:
        ConfigError: An input is given twice.
    """
    paths = [Path(os.path.realpath(path)) for path in inputs]  # Path.resolve fails on links in a circle
    if len(set(paths)) < len(paths):
        raise ConfigError("an input is given twice")
    return paths


def taken_frames(world_frame: str, frames: Collection[str]) -> list[str]:
    """The recordings' frames that have the name of a group's frame, sorted."""
    prefix = f"{world_frame}_"
    return sorted(
        frame
        for frame in frames
        if frame == world_frame or (frame.startswith(prefix) and frame.removeprefix(prefix).isdecimal())
    )
