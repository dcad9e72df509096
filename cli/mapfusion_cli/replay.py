"""`mapfusion replay`: recordings of several robots in, one merged mission out."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from mapfusion_cli.config_file import config_callback, options_in_effect, print_config
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
    DurationOption,
    EndOption,
    MaxAllCellsOption,
    MaxChunkOption,
    MaxMapCellsOption,
    MaxMergedCellsOption,
    MaxMessagesOption,
    MaxRobotsOption,
    NeverOption,
    PoseOption,
    PriorOption,
    RobotOption,
    StartOption,
    mission_options,
    pairs_apart,
    priors,
)

DONE_WITH_LOSSES = 3
"""Exit code where bytes or messages of a used topic were lost."""

NOT_IN_RESULT = ("paths", "config", "print_config_", "jobs", "force", "json", "quiet", "verbose", "strict")
"""Parameters that do not change what the output holds."""


class Profile(StrEnum):
    """How two maps are fused."""

    default = "default"
    paper = "paper"


class Blend(StrEnum):
    """How cells that several maps know are combined."""

    log_odds = "log-odds"
    max = "max"
    paper = "paper"


class Compression(StrEnum):
    """Of the output's chunks."""

    zstd = "zstd"
    lz4 = "lz4"
    none = "none"


def replay(
    ctx: typer.Context,
    paths: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="INPUT... OUTPUT.mcap",
            help="Recordings, and last the file to write.",
            readable=False,  # whether an input can be read is not a matter of usage
        ),
    ] = None,
    interval: Annotated[float, typer.Option(metavar="SECONDS", help="Time between snapshots.")] = 1.0,
    clock: ClockOption = Clock.header,
    start: StartOption = None,
    end: EndOption = None,
    duration: DurationOption = None,
    max_age: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="A map older than this starts no join.")
    ] = None,
    align_start: AlignStartOption = False,
    robot: RobotOption = None,
    drop: DropOption = None,
    pose: PoseOption = None,
    base_frame: BaseFrameOption = None,
    world_frame: Annotated[str, typer.Option(metavar="FRAME", help="Name of the merged frame.")] = WORLD_FRAME,
    reference: Annotated[
        str | None, typer.Option(metavar="ROBOT", help="The robot whose map frame its group lives in.")
    ] = None,
    prior: PriorOption = None,
    never: NeverOption = None,
    profile: Annotated[
        Profile, typer.Option(help="`paper` keeps to the method of Zick et al. 2025.")
    ] = Profile.default,
    mae_threshold: Annotated[
        float | None, typer.Option(metavar="GREY", help="Refuse fusions with a MAE from here on (0..255).")
    ] = None,
    blend: Annotated[Blend, typer.Option(help="How cells that several maps know are combined.")] = Blend.log_odds,
    resolution: Annotated[
        float | None,
        typer.Option(metavar="METRES", help="Cell size of merged maps; the finest of the maps by default."),
    ] = None,
    final_only: Annotated[bool, typer.Option("--final-only", help="Write the last snapshot only.")] = False,
    map_interval: Annotated[float, typer.Option(metavar="SECONDS", help="Time between merged maps.")] = 5.0,
    include_inputs: Annotated[
        bool, typer.Option("--include-inputs", help="Copy the recordings' own channels beside the results.")
    ] = False,
    compression: Annotated[Compression, typer.Option(help="Compression of the output.")] = Compression.zstd,
    jobs: Annotated[
        int,
        typer.Option(
            metavar="N", help="Processes that fuse pairs, from 2 on beside this one. Never changes the result."
        ),
    ] = 1,
    seed: Annotated[int, typer.Option(metavar="N", help="Seed of everything random.")] = 0,
    max_chunk: MaxChunkOption = MAX_CHUNK_MIB,
    max_map_cells: MaxMapCellsOption = MAX_MAP_CELLS,
    max_all_cells: MaxAllCellsOption = MAX_ALL_CELLS,
    max_messages: MaxMessagesOption = MAX_MESSAGES,
    max_robots: MaxRobotsOption = MAX_ROBOTS,
    max_merged_cells: MaxMergedCellsOption = 25_000_000,
    config: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.toml", callback=config_callback, is_eager=True, help="Options from a file; given ones win."
        ),
    ] = None,
    print_config_: Annotated[
        bool, typer.Option("--print-config", help="Print the options in effect as a configuration file, and stop.")
    ] = False,
    strict: Annotated[bool, typer.Option("--strict", help="A loss is a failure: exit 1, nothing written.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an output that exists.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Say more, such as what was passed over.")] = False,
) -> None:
    """Read recordings of several robots, fuse their maps over time, and write one MCAP.

    Inputs are .mcap and .bag files, rosbag2 folders and .db3 files. The last argument is the output.

    Exit codes: 0 done, 1 failed and nothing written, 2 wrong usage, 3 done but messages were lost.
    """
    from mapfusion.config import MAX_SPAN_S
    from mapfusion_cli.printing import show
    from mapfusion_cli.replay_job import ReplayJob, run_job
    from mapfusion_cli.result import result_json, result_text

    if print_config_:
        print_config(ctx)
        return
    job = ReplayJob(
        *_inputs_and_output(paths or []),
        mission=mission_options(
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
            start=start,
            end=end,
            duration=duration,
        ),
        settings={
            "interval_s": interval,
            "max_age_s": max_age,
            "map_interval_s": MAX_SPAN_S if final_only else map_interval,
            "reference": reference,
            "blend": blend.value,
            "resolution_m": resolution,
            "jobs": jobs,
            "max_merged_cells": max_merged_cells,
            "priors": priors(prior),
            "never": pairs_apart(never),
        },
        fusion={"profile": profile.value, "mae_threshold": mae_threshold, "seed": seed},
        world_frame=world_frame,
        final_only=final_only,
        compression=compression.value,
        include_inputs=include_inputs,
        strict=strict,
        force=force,
        recorded_options=options_in_effect(ctx, NOT_IN_RESULT),
    )
    done = run_job(job, quiet=quiet)
    if json:
        show(result_json(done))
    elif not quiet:
        show(result_text(done, verbose=verbose))
    if done.losses:
        raise typer.Exit(DONE_WITH_LOSSES)


def _inputs_and_output(paths: list[Path]) -> tuple[tuple[Path, ...], Path]:
    """Raises:
    UsageError: Fewer than two paths.
    """
    if len(paths) < 2:
        raise typer.BadParameter(
            "give one recording or more, and last the file to write", param_hint="INPUT... OUTPUT.mcap"
        )
    return tuple(paths[:-1]), paths[-1]
