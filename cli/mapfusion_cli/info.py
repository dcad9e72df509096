"""`mapfusion info`: what replay would use of recordings, and why."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mapfusion_cli.options import (
    MAX_ALL_CELLS,
    MAX_CHUNK_MIB,
    MAX_MAP_CELLS,
    MAX_MESSAGES,
    MAX_ROBOTS,
    WORLD_FRAME,
    AlignStartOption,
    BaseFrameOption,
    Clock,
    ClockOption,
    DropOption,
    MaxAllCellsOption,
    MaxChunkOption,
    MaxMapCellsOption,
    MaxMessagesOption,
    MaxRobotsOption,
    PoseOption,
    RobotOption,
    existing,
    mission_options,
    real_paths,
    taken_frames,
)

if TYPE_CHECKING:
    from mapfusion_io.mission import Mission


def info(
    inputs: Annotated[list[Path], typer.Argument(metavar="INPUT...", help="Recordings.", readable=False)],
    clock: ClockOption = Clock.header,
    align_start: AlignStartOption = False,
    robot: RobotOption = None,
    drop: DropOption = None,
    pose: PoseOption = None,
    base_frame: BaseFrameOption = None,
    max_chunk: MaxChunkOption = MAX_CHUNK_MIB,
    max_map_cells: MaxMapCellsOption = MAX_MAP_CELLS,
    max_all_cells: MaxAllCellsOption = MAX_ALL_CELLS,
    max_messages: MaxMessagesOption = MAX_MESSAGES,
    max_robots: MaxRobotsOption = MAX_ROBOTS,
    json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Show what replay would use of recordings and why, what it would pass over, and the command to run.

    Exit codes: 0 done, 1 a recording cannot be read, 2 wrong usage, 3 messages were lost.
    """
    import json as json_library

    from mapfusion_cli.printing import show
    from mapfusion_cli.replay import DONE_WITH_LOSSES
    from mapfusion_io.mission import open_recording
    from mapfusion_io.mission_summary import mission_document

    real_paths(inputs)
    existing(inputs)
    options = mission_options(
        clock=clock,
        align_start=align_start,
        robot=robot,
        drop=drop,
        pose=pose,
        base_frame=base_frame,
        max_chunk=max_chunk,
        max_map_cells=max_map_cells,
        max_all_cells=max_all_cells,
        max_messages=max_messages,
        max_robots=max_robots,
    )
    mission = open_recording(inputs, options)
    for _ in mission.events():  # so that maps which do not fit to each other are found as well
        pass
    flags = ["--align-start"] if align_start or mission.are_apart_in_time else []
    flags += ["--clock", "log"] if clock is Clock.log else []
    free = next(name for name in _world_frames() if not taken_frames(name, mission.frames))
    flags += [] if free == WORLD_FRAME else ["--world-frame", free]
    command = _replay_command(inputs, flags, robot=robot, drop=drop, pose=pose, base_frame=base_frame)
    if json:
        document = {**mission_document(mission, mission.losses), "replay_command": command}
        show(json_library.dumps(document, indent=2, sort_keys=True, allow_nan=False))
    else:
        show(info_text(mission, command))
    if mission.losses:
        raise typer.Exit(DONE_WITH_LOSSES)


def info_text(mission: Mission, command: str) -> str:
    """The mission for a person to read."""
    from mapfusion_cli.printing import one_line
    from mapfusion_cli.result import losses_text, table

    lines = []
    for survey in mission.surveys:
        count = sum(topic.count for topic in survey.topics.values())
        lines.append(
            f"{survey.recording.path.name}: {survey.recording.container}, {survey.size_bytes / 1e6:.1f} MB, "
            f"{count} messages{'' if survey.recording.integrity_verifiable else ', integrity not verifiable'}"
        )
    if mission.robots:
        lines += ["", f"robots ({len(mission.robots)}), {(mission.last_ns - mission.first_ns) * 1e-9:.1f} s:"]
        rows = [("name", "recording", "map topic", "frame", "maps", "updates", "last map", "poses from")]
        for robot in mission.robots:
            grid = robot.found.topic.last_grid
            rows.append(
                (
                    robot.name,
                    robot.found.survey.recording.path.name,
                    robot.found.topic.topic,
                    robot.found.map_frame,
                    str(len(robot.found.topic.stamps_ns)),
                    "-" if robot.updates is None else str(len(robot.updates.stamps_ns)),
                    "-" if grid is None else f"{grid.width} x {grid.height} at {grid.resolution_m:.3g} m",
                    robot.poses.origin if robot.poses.source is not None else f"none: {robot.poses.origin}",
                )
            )
        lines += table(rows)
    passed = [(item.source, item.topic, str(item.count), item.schema_name, item.reason) for item in mission.passed_over]
    if passed:
        lines += ["", "passed over:", *table([("recording", "topic", "messages", "type", "reason"), *passed])]
    lines += [f"warning: {warning}" for warning in mission.warnings]
    lines += losses_text(mission.losses)
    if len(mission.robots) >= 2:
        lines += ["", "replay with:", f"  {command}"]
    else:
        lines += ["", f"nothing to fuse: {len(mission.robots)} robots with a map, two are needed"]
    return "\n".join(map(one_line, lines))


def _world_frames() -> Iterator[str]:
    """Names for the merged frame, the usual one first."""
    yield WORLD_FRAME
    yield "fused"
    yield from (f"fused{number}" for number in count(2))


def _replay_command(inputs: list[Path], flags: list[str], **repeated: list[str] | None) -> str:
    """A line to paste, with the options that were given."""
    options = list(flags)
    for name, values in repeated.items():
        for value in values or ():
            options += [f"--{name.replace('_', '-')}", value]
    return shlex.join(["mapfusion", "replay", *map(str, inputs), "fused.mcap", *options])
