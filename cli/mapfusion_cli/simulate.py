"""`mapfusion simulate`: a mission with ground truth."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Kind(StrEnum):
    """What the maps show."""

    MISSION = "mission"
    PAPER = "paper"


class Poses(StrEnum):
    """How poses are told."""

    TF = "tf"
    ODOM = "odom"
    POSE = "pose"


class Format(StrEnum):
    """Container of the recording."""

    MCAP = "mcap"
    BAG = "bag"


class ChunkCompression(StrEnum):
    """Compression of the recording's chunks."""

    ZSTD = "zstd"
    LZ4 = "lz4"
    BZ2 = "bz2"
    NONE = "none"


def simulate(
    out: Annotated[
        Path,
        typer.Argument(
            help="Recording to write, .mcap (ROS 2) or .bag (ROS 1); the truth goes beside it to NAME.truth.json.",
            metavar="OUT",
        ),
    ],
    kind: Annotated[
        Kind, typer.Option(help="mission: lidar robots explore floor plans; paper: patches of the paper's random maps.")
    ] = Kind.MISSION,
    robots: Annotated[int, typer.Option(min=1, help="Number of robots.")] = 3,
    buildings: Annotated[
        int, typer.Option(min=1, help="Number of buildings; the robots are dealt out to them in turn.")
    ] = 1,
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = 0,
    duration: Annotated[float, typer.Option(help="Length of the mission, seconds.")] = 100.0,
    resolution: Annotated[
        str,
        typer.Option(
            help="Cell size of the maps in metres: one, or one for each robot, separated by commas.", metavar="M[,M...]"
        ),
    ] = "0.05",
    poses: Annotated[
        Poses, typer.Option(help="Source of the poses: TF, nav_msgs/Odometry with TF, or PoseStamped.")
    ] = Poses.TF,
    updates: Annotated[bool, typer.Option("--updates", help="Send map_updates between the whole maps.")] = False,
    graded: Annotated[
        bool, typer.Option("--graded", help="Give probabilities from 0 to 100 instead of 0 and 100.")
    ] = False,
    map_period: Annotated[float, typer.Option(help="Time between two maps of a robot, seconds.")] = 5.0,
    pose_period: Annotated[float, typer.Option(help="Time between two poses of a robot, seconds.")] = 0.2,
    overlap: Annotated[
        float,
        typer.Option(min=0.0, max=1.0, help="Overlap with another robot that tours are chosen for; reached about."),
    ] = 0.5,
    noise: Annotated[float, typer.Option(help="Standard deviation of the lidar's ranges, metres.")] = 0.02,
    odometry_noise: Annotated[float, typer.Option(help="Relative error of the odometry; 0 for none.")] = 0.02,
    max_range: Annotated[float, typer.Option(help="Range of the lidar, metres.")] = 10.0,
    compression: Annotated[
        ChunkCompression | None, typer.Option(help="MCAP: zstd (default), lz4, none; bag: none (default), lz4, bz2.")
    ] = None,
    format: Annotated[Format | None, typer.Option(help="Format of OUT where its suffix does not say it.")] = None,  # noqa: A002
    force: Annotated[bool, typer.Option("--force", help="Replace existing files.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing.")] = False,
) -> None:
    """Makes a mission of several robots, each mapping in its own frame, with ground truth."""
    from mapfusion.simulation.lidar import LidarConfig
    from mapfusion.simulation.mission import simulate_mission
    from mapfusion.simulation.mission_config import MissionConfig
    from mapfusion.simulation.paper_mission import simulate_paper_mission
    from mapfusion_cli.printing import show
    from mapfusion_io.mission_writer import write_mission

    resolutions_m = _resolutions_m(resolution)
    if kind is Kind.PAPER and (updates or graded):
        raise typer.BadParameter(
            "the paper's maps never change and know no probabilities: leave out --updates, --graded"
        )
    try:
        config = MissionConfig(
            seed=seed,
            num_robots=robots,
            num_buildings=buildings,
            duration_s=duration,
            resolutions_m=resolutions_m,
            map_period_s=map_period,
            pose_period_s=pose_period,
            overlap=overlap,
            odometry_noise=odometry_noise,
            updates=updates,
            graded=graded,
            lidar=LidarConfig(max_range_m=max_range, range_noise_m=noise),
        )
        mission = (simulate_mission if kind is Kind.MISSION else simulate_paper_mission)(config)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error
    written = write_mission(
        mission,
        out,
        poses=poses.value,
        format=None if format is None else format.value,
        compression=None if compression is None else compression.value,
        force=force,
    )
    if as_json:
        report = {
            "recording": str(written.recording),
            "truth": str(written.truth),
            "maps": written.num_maps,
            "updates": written.num_updates,
            "poses": written.num_poses,
            "final_overlap": written.final_overlap,
        }
        show(json.dumps(report, indent=2))
    elif not quiet:
        show(f"{written.recording}: {robots} robots, {written.num_maps} maps, {written.num_poses} poses")
        show(f"{written.truth}: overlap of the last maps")
        for pair, ratio in written.final_overlap.items():
            show(f"  {pair}  {ratio:.0%}")


def _resolutions_m(text: str) -> tuple[float, ...]:
    """Cell sizes out of a list with commas; typer.BadParameter where one is no number."""
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"--resolution wants metres, separated by commas, not {text!r}") from None
