"""The main job from open recordings to a complete output."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from mapfusion.config import FusionConfig, ReplayConfig
from mapfusion.errors import ConfigError, LogReadError
from mapfusion.pipeline import replay
from mapfusion.summary import Summary
from mapfusion.version import __version__
from mapfusion_cli.options import existing
from mapfusion_cli.progress import StageProgress
from mapfusion_io.atomic import refuse_target
from mapfusion_io.input_copy import InputCopy
from mapfusion_io.mission import Mission, MissionOptions, open_recording
from mapfusion_io.mission_copy import mission_copy
from mapfusion_io.mission_summary import metadata_record, summary_document
from mapfusion_io.output import create_output


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
        document: The same as it stands in the output, ready for JSON.
        left_out: What `--include-inputs` could not copy, in words.
        elapsed_s: Wall time of each stage by name.
        output: The file that was written.
    """

    mission: Mission
    summary: Summary
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
                output.write(step)
                summary.add(step)
                progress.reached(step.stamp_ns)
            output.copy_rest()
            if job.strict and mission.losses:
                loss = mission.losses[0]
                raise LogReadError(f"{loss.source}: {loss.kind} at {loss.where} (--strict): {loss.detail}")
            document = summary_document(mission, summary)
            output.finish(document, metadata_record(mission, __version__, job.recorded_options))
    elapsed_s = {"reading": read_s - started_s, "fusing and writing": time.perf_counter() - read_s}
    return Done(mission, summary, document, _left_out(inputs), elapsed_s, job.output)


def _config(job: ReplayJob, mission: Mission) -> ReplayConfig:
    reference = job.settings["reference"]
    names = [robot.name for robot in mission.robots]
    if reference is not None and reference not in names:
        raise ConfigError(f"--reference {reference}: there is no such robot; there are {', '.join(names)}")
    try:
        return ReplayConfig(fusion=FusionConfig(**job.fusion), start_ns=mission.start_ns, **job.settings)  # type: ignore[arg-type]
    except ValueError as error:
        raise ConfigError(str(error)) from error


def _refuse_output_that_is_input(job: ReplayJob) -> None:
    target = job.output.resolve()
    for path in job.inputs:
        if target == path.resolve() or path.resolve() in target.parents:
            raise ConfigError(f"{job.output}: the output is an input. The last argument is the file to write.")


def _refuse_taken_frame(world_frame: str, mission: Mission) -> None:
    if not world_frame.strip("/"):
        raise ConfigError("--world-frame must not be empty")
    taken = [frame for frame in mission.frames if frame == world_frame or _is_group_frame(frame, world_frame)]
    if taken:
        raise ConfigError(f"the recordings already have a frame {min(taken)!r}; choose another name with --world-frame")


def _is_group_frame(frame: str, world_frame: str) -> bool:
    return frame.startswith(world_frame + "_") and frame.removeprefix(world_frame + "_").isdecimal()


def _left_out(inputs: InputCopy | None) -> tuple[str, ...]:
    return () if inputs is None else tuple(str(item) for item in inputs.left_out)
