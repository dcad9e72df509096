"""Time per stage and peak memory of whole replays: `python benchmarks/replaying.py [RECORDING ...]`.

Without a recording it simulates three robots, a map every 2 s each, for 260 s, and the same four times as long. Every
replay runs in a process of its own.
"""

from __future__ import annotations

import argparse
import cProfile
import platform
import pstats
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

STAGES = {
    "reading, first pass": ("survey.py", "take_survey"),
    "reading, second pass": ("grid_stream.py", "stamped_grid_messages"),
    "searching pairs": ("fusion.py", "fuse"),
    "verifying joins": ("fusion.py", "verify"),
    "  of both preparing maps": ("fusion.py", "of"),
    "merging maps": ("merge.py", "merge_grids"),
    "writing": ("output.py", "write"),
    "finishing": ("output.py", "finish"),
}
"""Cumulative time of these functions, by module and name."""


def main() -> None:
    """Prints a table for each recording."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", nargs="*", type=Path)
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--profile", default="default")
    arguments = parser.parse_args()
    if arguments.one:
        measure(arguments.recordings[0], arguments.profile)
        return
    print(f"{platform.platform()}, Python {platform.python_version()}")
    with tempfile.TemporaryDirectory() as folder:
        for recording in arguments.recordings or simulated(Path(folder)):
            command = [sys.executable, __file__, "--one", str(recording), "--profile", arguments.profile]
            subprocess.run(command, check=True)


def simulated(folder: Path) -> list[Path]:
    """A mission and one four times as long."""
    from mapfusion.simulation.mission import simulate_mission
    from mapfusion.simulation.mission_config import MissionConfig
    from mapfusion_io.mission_writer import write_mission

    paths = []
    for duration_s in (260.0, 1040.0):
        path = folder / f"three_robots_{duration_s:.0f}s.mcap"
        config = MissionConfig(seed=1, num_robots=3, duration_s=duration_s, map_period_s=2.0, overlap=0.6)
        write_mission(simulate_mission(config), path, poses="tf")
        paths.append(path)
    return paths


def measure(recording: Path, profile: str) -> None:
    """Replays once for the time and once under the profiler for the stages."""
    from mapfusion_cli.replay_job import ReplayJob, run_job
    from mapfusion_io.mission import MissionOptions

    with tempfile.TemporaryDirectory() as folder:
        job = ReplayJob(
            inputs=(recording,),
            output=Path(folder) / "out.mcap",
            mission=MissionOptions(),
            settings={"reference": None},
            fusion={"profile": profile},
            world_frame="world",
            final_only=False,
            compression="zstd",
            include_inputs=False,
            strict=False,
            force=True,
            recorded_options={},
        )
        started_s = time.perf_counter()
        done = run_job(job, quiet=True)
        elapsed_s = time.perf_counter() - started_s
        peak_mib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        floor_s = reading_and_writing_s(recording, job.output)
        profiler = cProfile.Profile()
        profiler.runcall(run_job, job, quiet=True)
    lasted_s = (done.mission.last_ns - done.mission.first_ns) * 1e-9
    looks = sum(pair.num_looks for pair in done.summary.pairs.values())
    print(f"\n{recording.name}: {lasted_s:.0f} s of {len(done.mission.robots)} robots, {looks} looks at pairs")
    print(f"  whole replay {elapsed_s:.2f} s, {lasted_s / elapsed_s:.1f} times real time, peak {peak_mib:.0f} MiB")
    print(f"  reading, decoding and writing alone {floor_s:.2f} s: the whole is {elapsed_s / floor_s:.1f} times that")
    total_s = pstats.Stats(profiler).total_tt  # type: ignore[attr-defined]
    for stage, (module, function) in STAGES.items():
        print(f"  {stage:24s} {100 * cumulative_s(profiler, module, function) / total_s:5.1f} %")


def reading_and_writing_s(recording: Path, output: Path) -> float:
    """The least that a replay can take: its two passes over the input, and its output's messages written once more."""
    from mcap.reader import make_reader
    from mcap.writer import Writer

    from mapfusion_io.mission import open_recording

    with output.open("rb") as file:
        written = [
            (schema, channel, message.log_time, message.data)
            for schema, channel, message in make_reader(file).iter_messages()
            if schema is not None
        ]
    started_s = time.perf_counter()
    for _ in open_recording([recording]).events():
        pass
    with (output.parent / "floor.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        for schema, channel, log_time_ns, data in written:
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(channel.topic, "cdr", schemas[schema.id])
            writer.add_message(channels[channel.id], log_time_ns, data, log_time_ns)
        writer.finish()
    return time.perf_counter() - started_s


def cumulative_s(profiler: cProfile.Profile, module: str, function: str) -> float:
    """Time in a function and what it called."""
    rows = pstats.Stats(profiler).stats.items()  # type: ignore[attr-defined]
    return sum(row[3] for (path, _, name), row in rows if name == function and Path(path).name == module)


if __name__ == "__main__":
    main()
