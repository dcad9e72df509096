"""A simulated mission as a recording, with the truth about it in a file beside."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal, NamedTuple, cast, get_args

import numpy as np
from rosbags import rosbag1
from rosbags.interfaces import Connection
from rosbags.typesys.stores import ros2_humble as ros

from mapfusion.errors import ConfigError, LogWriteError
from mapfusion.grid import OccupancyGrid, apply_update
from mapfusion.simulation.messages import MapMessage, MapUpdateMessage, Mission, PoseMessage
from mapfusion.simulation.truth import mission_truth
from mapfusion.transform import SE2
from mapfusion_io.atomic import AtomicFile
from mapfusion_io.definitions import default_store
from mapfusion_io.encode import OCCUPANCY_GRID, POSE_STAMPED, TF_MESSAGE, Encoder, MessageType
from mapfusion_io.topic_writer import Compression, OutgoingMessage, TopicWriter, qos

MissionFormat = Literal["mcap", "bag"]
MissionCompression = Literal["zstd", "lz4", "bz2", "none"]
PoseSource = Literal["tf", "odom", "pose"]

ODOMETRY = "nav_msgs/msg/Odometry"
GRID_UPDATE = "map_msgs/msg/OccupancyGridUpdate"

_COMPRESSIONS: dict[MissionFormat, tuple[MissionCompression, ...]] = {
    "mcap": ("zstd", "lz4", "none"),
    "bag": ("none", "lz4", "bz2"),
}
"""What each format can be compressed with, its default first."""


class WrittenMission(NamedTuple):
    """What was written; `final_overlap` as the truth has it, by `A-B`."""

    recording: Path
    truth: Path
    num_maps: int
    num_updates: int
    num_poses: int
    final_overlap: dict[str, float]


class _Message(NamedTuple):
    """A message in CDR, its log time that of its header."""

    topic: str
    type_name: str
    latched: bool
    data: bytes
    stamp_ns: int


_Write = Callable[[_Message], None]


def write_mission(
    mission: Mission,
    path: Path,
    *,
    poses: PoseSource = "tf",
    format: MissionFormat | None = None,  # noqa: A002
    compression: MissionCompression | None = None,
    force: bool = False,
) -> WrittenMission:
    """Runs a mission and writes its recording and its truth; the same mission gives the same bytes.

    Maps stand on `/NAME/map` and `/NAME/map_updates`, and poses, by `poses`, on `/tf` as `NAME/map` -> `NAME/odom` ->
    `NAME/base_link`, on `/NAME/odom` in the frame `NAME/odom` with `NAME/map` -> `NAME/odom` on `/tf`, or on
    `/NAME/pose` in the frame `NAME/map`. A `NAME/odom` that never moves in its map stands on `/tf_static` instead.

    Args:
        mission: The mission.
        path: The recording; the truth goes to `truth_path(path)`.
        poses: How the robots' poses are told.
        format: MCAP of ROS 2 or bag of ROS 1; None: by the suffix of `path`.
        compression: Of the chunks; None: zstd for MCAP, none for a bag.
        force: Replace files that already have the names.

    Raises:
        ConfigError: The suffix says no format, or the format has no such compression.
        LogWriteError: A file exists and is not to be replaced, or cannot be written.
    """
    container = format or format_of(path)
    if compression is not None and compression not in _COMPRESSIONS[container]:
        known = ", ".join(_COMPRESSIONS[container])
        raise ConfigError(f"{path}: a {container} has no {compression} compression; give one of {known}")
    chosen = compression or _COMPRESSIONS[container][0]
    last_maps: dict[str, OccupancyGrid] = {}
    num_maps = num_updates = num_poses = 0
    encoder = _MessageEncoder(poses)
    with AtomicFile(truth_path(path), force=force) as truth_file, AtomicFile(path, force=force) as file:
        with _mcap_sink(file, chosen) if container == "mcap" else _bag_sink(file, path, chosen) as write:
            if mission.exact_odometry and poses != "pose":
                write(encoder.exact_odometry(mission))
            for message in mission.messages():
                if isinstance(message, MapMessage):
                    num_maps += 1
                    last_maps[message.robot] = message.grid
                    write(encoder.map(message))
                elif isinstance(message, MapUpdateMessage):
                    num_updates += 1
                    before = last_maps[message.robot]
                    last_maps[message.robot] = apply_update(
                        before, message.col, message.row, message.cells, message.stamp_ns
                    )
                    write(encoder.update(message))
                else:
                    num_poses += 1
                    for encoded in encoder.pose(message, with_odometry=not mission.exact_odometry):
                        write(encoded)
        truth = mission_truth(mission, last_maps)
        truth_file.write(json.dumps(truth, separators=(",", ":")).encode() + b"\n")
    return WrittenMission(path, truth_path(path), num_maps, num_updates, num_poses, truth["final_overlap"])


def truth_path(path: Path) -> Path:
    """Where the truth about a recording stands."""
    return path.with_name(f"{path.stem}.truth.json")


def format_of(path: Path) -> MissionFormat:
    """The format that a suffix says.

    Raises:
        ConfigError: It says none.
    """
    for container in get_args(MissionFormat):
        if path.suffix.lower() == f".{container}":
            known: MissionFormat = container
            return known
    raise ConfigError(f"{path}: the suffix says no format; name it .mcap or .bag, or give --format")


class _MessageEncoder:
    """Mission messages as CDR, under the topics and frames of the chosen pose source."""

    def __init__(self, poses: PoseSource) -> None:
        self._poses = poses
        self._encoder = Encoder()
        self._store = default_store("cdr")

    def map(self, message: MapMessage) -> _Message:
        grid = message.grid
        data = self._encoder.occupancy_grid(grid, grid.frame_id, grid.stamp_ns)
        return _Message(f"/{message.robot}/map", OCCUPANCY_GRID, True, data, grid.stamp_ns)

    def update(self, message: MapUpdateMessage) -> _Message:
        height, width = message.cells.shape
        update = self._store.types[GRID_UPDATE](
            header=_header(message.frame_id, message.stamp_ns),
            x=message.col,
            y=message.row,
            width=width,
            height=height,
            data=message.cells.ravel(),
        )
        data = bytes(self._store.serialize_cdr(update, GRID_UPDATE, little_endian=True))
        return _Message(f"/{message.robot}/map_updates", GRID_UPDATE, False, data, message.stamp_ns)

    def pose(self, message: PoseMessage, with_odometry: bool) -> Iterator[_Message]:
        robot, stamp_ns = message.robot, message.stamp_ns
        map_frame, odom_frame, base_frame = (f"{robot}/{frame}" for frame in ("map", "odom", "base_link"))
        if self._poses == "pose":
            data = self._encoder.pose(message.T_map_odom @ message.T_odom_base, map_frame, stamp_ns)
            yield _Message(f"/{robot}/pose", POSE_STAMPED, False, data, stamp_ns)
            return
        transforms = [(map_frame, odom_frame, message.T_map_odom)] if with_odometry else []
        if self._poses == "tf":
            transforms.append((odom_frame, base_frame, message.T_odom_base))
        if transforms:
            yield _Message("/tf", TF_MESSAGE, False, self._encoder.transforms(transforms, stamp_ns), stamp_ns)
        if self._poses == "odom":
            yield _Message(f"/{robot}/odom", ODOMETRY, False, self._odometry(message, odom_frame, base_frame), stamp_ns)

    def exact_odometry(self, mission: Mission) -> _Message:
        """Every `NAME/map` -> `NAME/odom`, all of them in one message, at the first stamp."""
        first_ns = min(int(robot.trajectory.stamps_ns[0]) for robot in mission.robots)
        transforms = [(robot.map_frame, f"{robot.name}/odom", SE2.identity()) for robot in mission.robots]
        return _Message("/tf_static", TF_MESSAGE, True, self._encoder.transforms(transforms, first_ns), first_ns)

    def _odometry(self, message: PoseMessage, odom_frame: str, base_frame: str) -> bytes:
        T = message.T_odom_base
        zero = ros.geometry_msgs__msg__Vector3(x=0.0, y=0.0, z=0.0)
        pose = ros.geometry_msgs__msg__Pose(
            position=ros.geometry_msgs__msg__Point(x=T.x_m, y=T.y_m, z=0.0),
            orientation=ros.geometry_msgs__msg__Quaternion(
                x=0.0, y=0.0, z=float(np.sin(T.yaw_rad / 2)), w=float(np.cos(T.yaw_rad / 2))
            ),
        )
        odometry = ros.nav_msgs__msg__Odometry(
            header=_header(odom_frame, message.stamp_ns),
            child_frame_id=base_frame,
            pose=ros.geometry_msgs__msg__PoseWithCovariance(pose=pose, covariance=np.zeros(36)),
            twist=ros.geometry_msgs__msg__TwistWithCovariance(
                twist=ros.geometry_msgs__msg__Twist(linear=zero, angular=zero), covariance=np.zeros(36)
            ),
        )
        return bytes(self._store.serialize_cdr(odometry, ODOMETRY, little_endian=True))


@contextmanager
def _mcap_sink(file: AtomicFile, compression: MissionCompression) -> Iterator[_Write]:
    store = default_store("cdr")
    writer = TopicWriter(file, cast("Compression", compression))
    types: dict[str, MessageType] = {}

    def write(message: _Message) -> None:
        name = message.type_name
        if name not in types:
            text = store.generate_msgdef(name, ros_version=2)[0]
            types[name] = MessageType(name, "ros2msg", text.encode(), store.hash_rihs01(name))
        offered = qos(latched=message.latched, depth=1 if message.latched else 100)
        stamp_ns = message.stamp_ns
        writer.write(OutgoingMessage(message.topic, types[name], offered, message.data, stamp_ns, stamp_ns))

    yield write
    writer.finish()


@contextmanager
def _bag_sink(file: AtomicFile, path: Path, compression: MissionCompression) -> Iterator[_Write]:
    """rosbags' writer wants a path of its own, so the bag grows in a folder beside and is copied when it is whole."""
    ros2_store, ros1_store = default_store("cdr"), default_store("ros1")
    with tempfile.TemporaryDirectory(prefix=f".{path.name}.mapfusion-", dir=path.resolve().parent) as folder:
        writer = rosbag1.Writer(Path(folder, path.name))
        if compression != "none":
            writer.set_compression(rosbag1.Writer.CompressionFormat[compression.upper()])
        connections: dict[str, Connection] = {}

        def write(message: _Message) -> None:
            topic, name = message.topic, message.type_name
            if topic not in connections:
                connections[topic] = writer.add_connection(
                    topic, name, typestore=ros1_store, callerid="/mapfusion", latching=int(message.latched)
                )
            writer.write(connections[topic], message.stamp_ns, ros2_store.cdr_to_ros1(message.data, name))

        try:
            with writer:
                yield write
            with writer.path.open("rb") as whole:
                shutil.copyfileobj(whole, file)
        except OSError as error:
            raise LogWriteError(f"{path}: cannot be written: {error.strerror or error}") from error


def _header(frame_id: str, stamp_ns: int) -> ros.std_msgs__msg__Header:
    sec, nanosec = divmod(stamp_ns, 10**9)
    return ros.std_msgs__msg__Header(
        stamp=ros.builtin_interfaces__msg__Time(sec=sec, nanosec=nanosec), frame_id=frame_id
    )
