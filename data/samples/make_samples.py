"""Makes the sample recordings beside this file: `python data/samples/make_samples.py [FOLDER]`."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from mapfusion.simulation.mission import simulate_mission
from mapfusion.simulation.mission_config import MissionConfig
from mapfusion_io.mission_writer import MissionCompression, PoseSource, WrittenMission, write_mission


@dataclass(frozen=True, slots=True)
class Sample:
    """A mission and how it is recorded."""

    config: MissionConfig
    poses: PoseSource
    compression: MissionCompression


SAMPLES = {
    "three_robots.mcap": Sample(MissionConfig(seed=22, num_robots=3, duration_s=120.0, overlap=0.55), "tf", "zstd"),
    "two_robots.bag": Sample(
        MissionConfig(seed=12, num_robots=2, duration_s=90.0, overlap=0.55, updates=True), "odom", "bz2"
    ),
}


def make_sample(name: str, folder: Path) -> WrittenMission:
    """Writes one of the samples and its truth into a folder, over what stands there."""
    sample = SAMPLES[name]
    mission = simulate_mission(sample.config)
    return write_mission(mission, folder / name, poses=sample.poses, compression=sample.compression, force=True)


if __name__ == "__main__":
    for name in SAMPLES:
        print(make_sample(name, Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent))
