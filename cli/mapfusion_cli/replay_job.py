"""The main job from open recordings to a complete output."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import cv2

from mapfusion.config import FusionConfig, ReplayConfig
from mapfusion.errors import ConfigError, LogReadError, MissionError
from mapfusion.pipeline import replay
from mapfusion.summary import Summary
from mapfusion.transform import SE2
from mapfusion.version import __version__
from mapfusion_cli.options import existing, real_paths, taken_frames
from mapfusion_cli.progress import StageProgress
from mapfusion_io.atomic import refuse_target
from mapfusion_io.input_copy import InputCopy
from mapfusion_io.interfaces import Loss
from mapfusion_io.mission import Mission, MissionOptions, open_recording
from mapfusion_io.mission_copy import mission_copy
from mapfusion_io.mission_summary import metadata_record, summary_document
from mapfusion_io.output import create_output

MAX_SNAPSHOTS = 1_000_000
"""Eleven days at one a second; damaged or made-up times may ask for any number."""


@dataclass(frozen=True, slots=True)
class ReplayJob:
    """What the command line asks for.

    Attributes:
        inputs: Recordings.
        output: The file to write.
        mission: How the recordings are to be understood.
        settings: Fields of `ReplayConfig`.
        fusion: Fields of `FusionConfig`.
        world_frame: Name of the merged frame.
        final_only: Whether the last snapshot alone is written, with the latest look at every pair.
        compression: Of the output.
        include_inputs: Whether the recordings' channels are copied.
        strict: Whether a loss is a failure.
        force: Whether an output that exists is replaced.
        recorded_options: The options that change the result, as they are recorded in the output.
    """

    inputs: tuple[Path, ...]
    output: Path
    mission: MissionOptions
    settings: Mapping[str, object]
    fusion: Mapping[str, object]
    world_frame: str
    final_only: bool
    compression: Literal["zstd", "lz4", "none"]
    include_inputs: bool
    strict: bool
    force: bool
    recorded_options: Mapping[str, object]


@dataclass(frozen=True, slots=True, eq=False)
class Done:
    """A finished replay.

    Attributes:
        mission: The recordings as they were understood, with their losses.
        summary: What came of it.
        losses: What could not be read, believed or made.
        warnings: What the user should know before trusting the result.
        document: The same as it stands in the output, ready for JSON.
        left_out: What `--include-inputs` could not copy, in words.
        elapsed_s: Wall time of each stage by name.
        output: The file that was written.
    """

    mission: Mission
    summary: Summary
    losses: tuple[Loss, ...]
    warnings: tuple[str, ...]
    document: Mapping[str, object]
    left_out: tuple[str, ...]
    elapsed_s: Mapping[str, float]
    output: Path


def run_job(job: ReplayJob, *, quiet: bool) -> Done:
    """Replays a mission into its output, which appears under its name only when it is complete.

    Raises:
        ConfigError: An option is impossible, the output is an input, or the world frame is taken.
        LogReadError: An input is missing or cannot be read at all, or something was lost and the job is strict.
        LogWriteError: The output exists or cannot be written.
        MissionError: No map, or one robot only.
    """
    started_s = time.perf_counter()
    cv2.setNumThreads(1)  # --jobs says how many cores are used; on maps OpenCV's own threads cost more than they gain
    _refuse_output_that_is_input(job)
    existing(job.inputs)
    refuse_target(job.output, force=job.force)  # before the reading, which may take long
    with StageProgress(quiet=quiet) as progress:
        progress.stage("reading")
        mission = open_recording(job.inputs, job.mission)
        read_s = time.perf_counter()
        mission.require_robots()
        config = _config(job, mission)
        _refuse_taken_frame(job.world_frame, mission)
        inputs = mission_copy(mission) if job.include_inputs else None
        summary = Summary()
        with create_output(
            job.output,
            world_frame=job.world_frame,
            compression=job.compression,
            force=job.force,
            inputs=inputs,
        ) as output:
            progress.stage("fusing", mission.first_ns, mission.last_ns)
            for step in replay(mission.events(), config):
                summary.add(step)
                if not job.final_only:
                    output.write(step)
                elif step.is_last:
                    output.write(replace(step, pairs=tuple(pair.latest for pair in summary.pairs_in_order)))
                progress.reached(step.stamp_ns)
            if not summary.num_snapshots:
                part = " from --start to --end" if (mission.start_ns, mission.end_ns) != (None, None) else ""
                lost = f"{len(mission.losses)} losses; " if mission.losses else ""
                raise MissionError(f"there is no map to use{part}.\n{lost}`mapfusion info` lists what there is.")
            output.copy_rest()
            losses = (*mission.losses, *_left_out_of_maps(summary, config.max_merged_cells))
            if job.strict and losses:
                loss = losses[0]
                raise LogReadError(f"{loss.source}: {loss.kind} at {loss.where} (--strict): {loss.detail}")
            warnings = (*mission.warnings, *_misread_starts(config, mission))
            document = summary_document(mission, summary, losses, job.world_frame) | {"warnings": list(warnings)}
            output.finish(document, metadata_record(mission, losses, __version__, job.recorded_options))
    elapsed_s = {"reading": read_s - started_s, "fusing and writing": time.perf_counter() - read_s}
    return Done(mission, summary, losses, warnings, document, _left_out(inputs), elapsed_s, job.output)


def _misread_starts(config: ReplayConfig, mission: Mission) -> list[str]:
    """A known start of the robot whose map frame is the world: it cannot hold as it stands."""
    reference = config.reference or mission.robots[0].name
    start = config.priors.get(reference)
    if start is None or (start.T_world_map == SE2.identity() and start.is_fixed):
        return []
    return [
        f"--prior {reference}: the world is the map frame of {reference}, which lies at its origin; its known start "
        "only says where those of others lie from there"
    ]


def _left_out_of_maps(summary: Summary, max_cells: int) -> list[Loss]:
    detail = "{} lies too far away, or is too large, for a merged map of {} cells with the others"
    return [
        Loss("output", "over limit", f"group {group}", count=count, detail=detail.format(robot, max_cells))
        for (group, robot), count in sorted(summary.left_out.items())
    ]


def _config(job: ReplayJob, mission: Mission) -> ReplayConfig:
    try:
        config = ReplayConfig(fusion=FusionConfig(**job.fusion), start_ns=mission.start_ns, **job.settings)  # type: ignore[arg-type]
        replace(config, reference=config.reference or mission.robots[0].name)  # known starts count from this one
    except ValueError as error:
        raise ConfigError(_in_options(str(error))) from error
    num_snapshots = mission.reported_ns * 1e-9 / config.interval_s
    if num_snapshots > MAX_SNAPSHOTS:
        raise ConfigError(
            f"{mission.reported_ns * 1e-9 / 3600.0:.0f} hours of reports ask for {num_snapshots:.0f} snapshots.\n"
            f"More than {MAX_SNAPSHOTS} are not made: give a larger --interval, or a part with --start and --duration."
        )
    known = [robot.name for robot in mission.robots]
    named = {
        "--reference": [config.reference or known[0]],
        "--prior": config.priors,
        "--never": frozenset().union(*config.never),
    }
    for option, names in named.items():
        for name in sorted(set(names) - set(known)):
            raise ConfigError(f"{option} {name}: there is no such robot; there are {', '.join(known)}")
    return config


def _in_options(words: str) -> str:
    """An error about a field, in terms of the option that sets it."""
    fields, colon, robots = words.partition(": ")
    for name in (
        "map_interval_s",
        "interval_s",
        "max_age_s",
        "resolution_m",
        "mae_threshold",
        "max_merged_cells",
        "jobs",
        "never",
        "priors",
    ):
        option = "prior" if name == "priors" else name.removesuffix("_s").removesuffix("_m").replace("_", "-")
        fields = re.sub(rf"\b{name}\b", f"--{option}", fields)
    return fields + colon + robots


def _refuse_output_that_is_input(job: ReplayJob) -> None:
    if str(job.output) == "-":
        raise ConfigError("-: the output must be a file; it is completed before it gets its name")
    inputs = real_paths(job.inputs)
    target = Path(os.path.realpath(job.output))
    for path in inputs:
        if target == path or path in target.parents:
            raise ConfigError(f"{job.output}: the output is an input. The last argument is the file to write.")


def _refuse_taken_frame(world_frame: str, mission: Mission) -> None:
    if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_/]*", world_frame):
        raise ConfigError(f"--world-frame {world_frame!r}: must be letters, digits, _ and /, and not begin with /")
    taken = taken_frames(world_frame, mission.frames)
    if taken:
        raise ConfigError(f"the recordings already have a frame {taken[0]!r}; choose another name with --world-frame")


def _left_out(inputs: InputCopy | None) -> tuple[str, ...]:
    if inputs is None:
        return ()
    return tuple(f"{item.source} {item.topic}: {item.reason} ({item.count} messages)" for item in inputs.left_out)
