"""Options that several verbs share: how to read recordings."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mapfusion.errors import ConfigError

if TYPE_CHECKING:
    from mapfusion_io.mission import MissionOptions


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
    start: str | None = None,
    end: str | None = None,
    duration: float | None = None,
) -> MissionOptions:
    """The options of a command line for `open_recording`.

    Raises:
        ConfigError: One of them is not NAME=VALUE.
    """
    from mapfusion_io.mission import MissionOptions
    from mapfusion_io.time_range import TimeRange

    return MissionOptions(
        clock="log" if clock is Clock.log else "header",
        align_start=align_start,
        robots=named_values("--robot", robot),
        drop=tuple(drop or ()),
        poses=named_values("--pose", pose),
        base_frames=named_values("--base-frame", base_frame),
        time_range=TimeRange(start, end, duration),
    )


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

    for path in paths:
        if not path.exists():
            raise LogReadError(f"{path}: there is no such file or folder")
