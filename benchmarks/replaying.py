"""Time per stage and peak memory of whole replays: `python benchmarks/replaying.py [RECORDING ...]`.

Without a recording it simulates three robots, a map every 2 s each, for 260 s; the same robots, who then drive their
way back, there again and back, 1040 s in all over maps that hardly grow any more; and twenty robots, a map every 5 s
each, for 200 s. Every replay runs in a process of its own. Times are CPU seconds, which other work on the machine
disturbs less, with the elapsed ones beside them.
"""

from __future__ import annotations

import argparse
import cProfile
import heapq
import os
import platform
import pstats
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import NamedTuple

import numpy as np
from mcap.reader import make_reader
from mcap.writer import Writer

from mapfusion.simulation.explore import resample_path
from mapfusion.simulation.floor_plan import random_floor_plan
from mapfusion.simulation.messages import Mission, MissionMessage
from mapfusion.simulation.mission import simulate_mission
from mapfusion.simulation.mission_config import MissionConfig, generator
from mapfusion.simulation.robot import explore, travelling_robot
from mapfusion_cli.replay_job import ReplayJob, run_job
from mapfusion_io.mission import MissionOptions, open_recording
from mapfusion_io.mission_writer import write_mission

STAGES = {
    "reading, first pass": ("survey.py", "take_survey"),
    "reading, second pass": ("grid_stream.py", "stamped_grid_messages"),
    "preparing maps": ("prepared.py", "prepare"),
    "searching pairs": ("fusion.py", "fuse"),
    "verifying joins": ("fusion.py", "verify"),
    "solving groups": ("groups.py", "update"),
    "what changed in maps": ("newest.py", "of"),
    "merging maps": ("merge.py", "merge_grids"),
    "writing": ("output.py", "write"),
    "finishing": ("output.py", "finish"),
}
"""Cumulative time of these functions, by module and name."""
NUM_ROUNDS = 3


def main() -> None:
    """Prints a table for each recording."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", nargs="*", type=Path)
    parser.add_argument("--floor", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.floor is not None:
        read_and_write(arguments.recordings[0], arguments.floor)
        return
    print(f"{platform.platform()}, Python {platform.python_version()}")
    with tempfile.TemporaryDirectory() as folder:
        for recording in arguments.recordings or simulated(Path(folder)):
            measure(recording, Path(folder) / "out.mcap")


def simulated(folder: Path) -> list[Path]:
    """The three missions."""
    three = MissionConfig(seed=1, num_robots=3, duration_s=260.0, map_period_s=2.0, overlap=0.6)
    missions = {
        "three_robots_260s": simulate_mission(three),
        "three_robots_1040s": there_and_back(three, 4),
        "twenty_robots_200s": simulate_mission(MissionConfig(seed=1, num_robots=20, duration_s=200.0)),
    }
    paths = []
    for name, mission in missions.items():
        paths.append(folder / f"{name}.mcap")
        write_mission(mission, paths[-1], poses="tf")
    return paths


def there_and_back(config: MissionConfig, num_times: int) -> Mission:
    """The mission of `config`, whose robots then drive their way back and there again: `num_times` as long in all."""
    plans = [random_floor_plan(generator(config, "plan", k)) for k in range(config.num_buildings)]
    longer = replace(config, duration_s=num_times * config.duration_s)
    robots = []
    for k, robot in enumerate(simulate_mission(config).robots):
        way = resample_path(robot.trajectory.poses[:, :2])
        ways = [way if number % 2 == 0 else way[::-1] for number in range(num_times)]
        path = resample_path(np.concatenate(ways))
        robots.append(travelling_robot(longer, k, path, float(robot.trajectory.poses[0, 2])))

    def messages() -> Iterator[MissionMessage]:
        streams = (explore(longer, k, robot, plans[robot.building]) for k, robot in enumerate(robots))
        return heapq.merge(*streams, key=lambda message: message.stamp_ns)

    return Mission(tuple(robots), config.odometry_noise == 0.0, messages)


class Usage(NamedTuple):
    """What a process took."""

    cpu_s: float
    elapsed_s: float
    peak_mib: float


def run(*arguments: str) -> Usage:
    """Runs Python with these arguments to its end."""
    started_s = time.perf_counter()
    pid = os.posix_spawn(sys.executable, [sys.executable, *arguments], os.environ)
    _, status, usage = os.wait4(pid, 0)
    if status != 0:
        raise SystemExit(f"{' '.join(arguments)} ended with {os.waitstatus_to_exitcode(status)}")
    return Usage(usage.ru_utime + usage.ru_stime, time.perf_counter() - started_s, usage.ru_maxrss / 1024)


def measure(recording: Path, output: Path) -> None:
    """Replays with one and two jobs, reads and writes alone, each in a process of its own; and profiles once more.

    The medians of NUM_ROUNDS that take turns: what else the machine does then falls on all of them.
    """
    replay = ["-m", "mapfusion_cli", "replay", str(recording), str(output), "--force", "--quiet", "--jobs"]
    commands = [*replay, "1"], [*replay, "2"], [__file__, str(recording), "--floor", str(output)]
    rounds = [[run(*command) for command in commands] for _ in range(NUM_ROUNDS)]
    single, double, floor = (Usage(*map(median, zip(*usages, strict=True))) for usages in zip(*rounds, strict=True))
    profiler = cProfile.Profile()
    done = profiler.runcall(run_job, job_of(recording, output), quiet=True)
    lasted_s = (done.mission.last_ns - done.mission.first_ns) * 1e-9
    looks = sum(pair.num_looks for pair in done.summary.pairs.values())
    print(f"\n{recording.name}: {lasted_s:.0f} s of {len(done.mission.robots)} robots, {looks} looks at pairs")
    for name, usage in (("--jobs 1", single), ("--jobs 2", double), ("reading, decoding, writing alone", floor)):
        print(
            f"  {name:32s} {usage.cpu_s:6.2f} s of CPU ({usage.elapsed_s:.2f} s elapsed), "
            f"{lasted_s / usage.cpu_s:.1f} ({lasted_s / usage.elapsed_s:.1f}) times real time, "
            f"peak {usage.peak_mib:.0f} MiB"
        )
    print(f"  the whole is {single.cpu_s / floor.cpu_s:.1f} times reading, decoding and writing")
    total_s = pstats.Stats(profiler).total_tt  # type: ignore[attr-defined]
    for stage, (module, function) in STAGES.items():
        print(f"  {stage:24s} {100 * cumulative_s(profiler, module, function) / total_s:5.1f} %")


def job_of(recording: Path, output: Path) -> ReplayJob:
    """What `mapfusion replay` does by default."""
    return ReplayJob(
        inputs=(recording,),
        output=output,
        mission=MissionOptions(),
        settings={"reference": None},
        fusion={},
        world_frame="world",
        final_only=False,
        compression="zstd",
        include_inputs=False,
        strict=False,
        force=True,
        recorded_options={},
    )


def read_and_write(recording: Path, output: Path) -> None:
    """The least that a replay can do: its two passes over the input, and its output's messages written once more."""
    for _ in open_recording([recording]).events():
        pass
    with output.open("rb") as file, output.with_suffix(".copy").open("wb") as copy:
        writer = Writer(copy)
        writer.start("ros2")
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        for schema, channel, message in make_reader(file).iter_messages():
            if schema is not None and schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
            if schema is not None and channel.id not in channels:
                channels[channel.id] = writer.register_channel(channel.topic, "cdr", schemas[schema.id])
            writer.add_message(channels[channel.id], message.log_time, message.data, message.log_time)
        writer.finish()  # type: ignore[no-untyped-call]


def cumulative_s(profiler: cProfile.Profile, module: str, function: str) -> float:
    """Time in a function and what it called."""
    rows = pstats.Stats(profiler).stats.items()  # type: ignore[attr-defined]
    return sum(float(row[3]) for (path, _, name), row in rows if name == function and Path(path).name == module)


if __name__ == "__main__":
    main()
