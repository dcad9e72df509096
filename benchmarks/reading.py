"""Reading and decoding a recording of about 320 MB of payload, against a bare loop of mcap and rosbags.

Run: python benchmarks/reading.py [--compression zstd|lz4|none]

Each way runs in a process of its own, several times; the best time counts. Aims: at most 1.3 times the bare loop, less
than 300 MiB.
"""

from __future__ import annotations

import argparse
import platform
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore
from rosbags.typesys.stores import ros2_humble as ros

NUM_GRIDS, GRID_CELLS, NUM_SAMPLES = 300, 1000, 20_000
REPEATS = 3


def write_recording(path: Path, compression: CompressionType) -> None:
    """300 grids of 1000 x 1000, 20 000 transforms and 20 000 odometries over 300 s, in the order of time."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    rng = np.random.default_rng(0)
    with path.open("wb") as file:
        writer: Any = Writer(file, compression=compression)
        writer.start(profile="ros2")
        channels = {}
        for topic, name in (
            ("/map", "nav_msgs/msg/OccupancyGrid"),
            ("/tf", "tf2_msgs/msg/TFMessage"),
            ("/odom", "nav_msgs/msg/Odometry"),
        ):
            definition = store.generate_msgdef(name, ros_version=2)[0].encode()
            schema = writer.register_schema(name, "ros2msg", definition)
            channels[topic] = writer.register_channel(topic, "cdr", schema)

        def add(topic: str, stamp_ns: int, message: object) -> None:
            data = bytes(store.serialize_cdr(message, type(message).__msgtype__))  # type: ignore[attr-defined]
            writer.add_message(channels[topic], stamp_ns, data, stamp_ns)

        cells = np.full((GRID_CELLS, GRID_CELLS), -1, np.int8)
        for index in range(NUM_SAMPLES):
            stamp_ns = 1_700_000_000_000_000_000 + index * 15_000_000
            x = index * 1e-3
            if index % (NUM_SAMPLES // NUM_GRIDS) == 0 and index // (NUM_SAMPLES // NUM_GRIDS) < NUM_GRIDS:
                row, col = rng.integers(0, GRID_CELLS - 100, 2)
                cells[row : row + 100, col : col + 100] = rng.choice(np.array([0, 0, 0, 100], np.int8), (100, 100))
                add("/map", stamp_ns, grid_message(stamp_ns, cells))
            transform = ros.geometry_msgs__msg__Transform(ros.geometry_msgs__msg__Vector3(x, 0.0, 0.0), rotation())
            stamped = ros.geometry_msgs__msg__TransformStamped(header(stamp_ns, "odom"), "base_link", transform)
            add("/tf", stamp_ns, ros.tf2_msgs__msg__TFMessage([stamped]))
            pose = ros.geometry_msgs__msg__Pose(ros.geometry_msgs__msg__Point(x, 0.0, 0.0), rotation())
            zero = ros.geometry_msgs__msg__Vector3(0.0, 0.0, 0.0)
            twist = ros.geometry_msgs__msg__Twist(zero, zero)
            odometry = ros.nav_msgs__msg__Odometry(
                header(stamp_ns, "odom"),
                "base_link",
                ros.geometry_msgs__msg__PoseWithCovariance(pose, np.zeros(36)),
                ros.geometry_msgs__msg__TwistWithCovariance(twist, np.zeros(36)),
            )
            add("/odom", stamp_ns, odometry)
        writer.finish()


def header(stamp_ns: int, frame_id: str) -> ros.std_msgs__msg__Header:
    """A message header."""
    return ros.std_msgs__msg__Header(ros.builtin_interfaces__msg__Time(*divmod(stamp_ns, 10**9)), frame_id)


def rotation() -> ros.geometry_msgs__msg__Quaternion:
    """No rotation."""
    return ros.geometry_msgs__msg__Quaternion(0.0, 0.0, 0.0, 1.0)


def grid_message(stamp_ns: int, cells: np.ndarray[tuple[int, ...], np.dtype[np.int8]]) -> object:
    """A grid message of square cells of 5 cm."""
    size = cells.shape[0]
    time_stamp = ros.builtin_interfaces__msg__Time(*divmod(stamp_ns, 10**9))
    origin = ros.geometry_msgs__msg__Pose(ros.geometry_msgs__msg__Point(0.0, 0.0, 0.0), rotation())
    info = ros.nav_msgs__msg__MapMetaData(time_stamp, 0.05, size, size, origin)
    return ros.nav_msgs__msg__OccupancyGrid(header(stamp_ns, "map"), info, cells.ravel())


def bare(path: Path) -> int:
    """The loop that anyone would write: mcap's reader with its defaults, every message decoded by rosbags."""
    stores: dict[int, Typestore] = {}
    num = 0
    with path.open("rb") as file:
        for schema, _, message in make_reader(file).iter_messages():
            assert schema is not None
            store = stores.get(schema.id)
            if store is None:
                store = stores[schema.id] = get_typestore(Stores.EMPTY)
                store.register(get_types_from_msg(schema.data.decode(), schema.name))
            store.deserialize_cdr(message.data, schema.name)
            num += 1
    return num


def ours(path: Path) -> int:
    """Our reader, with checksums and counts checked, and our decoder."""
    from mapfusion_io.decode import Decoder
    from mapfusion_io.sniff import open_one

    decoder = Decoder()
    recording = open_one(path)
    num = 0
    for raw in recording.messages(lambda channel: True):
        decoder.decode(raw)
        num += 1
    assert not recording.losses
    return num


def converted(path: Path) -> int:
    """Our reader and decoder, and every message validated and turned into our own types."""
    from mapfusion_io.decode import Decoder
    from mapfusion_io.messages import GRID_TYPES, TRANSFORM_TYPES, occupancy_grid, pose, transforms
    from mapfusion_io.sniff import open_one

    decoder = Decoder()
    num = 0
    for raw in open_one(path).messages(lambda channel: True):
        message = decoder.decode(raw)
        if raw.channel.schema_name in GRID_TYPES:
            occupancy_grid(message)
        elif raw.channel.schema_name in TRANSFORM_TYPES:
            transforms(message)
        else:
            pose(message)
        num += 1
    return num


WAYS: dict[str, Callable[[Path], int]] = {"bare": bare, "ours": ours, "converted": converted}


def measure(way: str, path: Path) -> tuple[float, float]:
    """Best time in seconds and highest memory in MiB of a way, in processes of its own."""
    runs = [
        subprocess.run([sys.executable, __file__, "--way", way, str(path)], check=True, capture_output=True, text=True)
        for _ in range(REPEATS)
    ]
    figures = [tuple(float(word) for word in run.stdout.split()) for run in runs]
    return min(figure[0] for figure in figures), max(figure[1] for figure in figures)


def main() -> None:
    """Prints the table, or, in a process of its own, time and memory of one way."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--compression", choices=[kind.name.lower() for kind in CompressionType], default="zstd")
    parser.add_argument("--way", nargs=2, metavar=("WAY", "FILE"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.way:
        start = time.perf_counter()
        num = WAYS[arguments.way[0]](Path(arguments.way[1]))
        assert num == NUM_GRIDS + 2 * NUM_SAMPLES, num
        print(time.perf_counter() - start, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
        return
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.mcap"
        write_recording(path, CompressionType[arguments.compression.upper()])
        packages = ", ".join(f"{name} {version(name)}" for name in ("mcap", "rosbags", "numpy"))
        print(f"{platform.machine()}, Python {platform.python_version()}, {packages}")
        print(f"{path.stat().st_size / 1e6:.0f} MB ({arguments.compression}), {NUM_GRIDS + 2 * NUM_SAMPLES} messages")
        figures = {way: measure(way, path) for way in WAYS}
    for way, (seconds, mebibytes) in figures.items():
        print(f"{way:10} {seconds:6.2f} s  {seconds / figures['bare'][0]:5.2f} x bare  {mebibytes:6.0f} MiB")


if __name__ == "__main__":
    main()
