"""Core types as ROS 2 messages in CDR, and the types' definitions as MCAP schemas carry them."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from importlib import resources

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore
from rosbags.typesys.stores import ros2_humble as ros

from mapfusion.grid import OccupancyGrid
from mapfusion.steps import PairReport, Path, StampArray
from mapfusion.transform import SE2, FloatArray
from mapfusion_io.pair_report import Status, pair_covariance, pair_fields

OCCUPANCY_GRID = "nav_msgs/msg/OccupancyGrid"
PATH = "nav_msgs/msg/Path"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
TF_MESSAGE = "tf2_msgs/msg/TFMessage"
DIAGNOSTIC_ARRAY = "diagnostic_msgs/msg/DiagnosticArray"
PAIR_FUSION = "mapfusion_msgs/msg/PairFusion"
TYPES = (OCCUPANCY_GRID, PATH, POSE_STAMPED, TF_MESSAGE, DIAGNOSTIC_ARRAY, PAIR_FUSION)
"""All types of the results."""


@dataclass(frozen=True, slots=True)
class MessageType:
    """A message type as an MCAP schema and its channels carry it.

    Attributes:
        name: In ROS 2's three parts.
        encoding: `ros2msg` or `ros2idl`.
        definition: The full text with the definitions of all types within, UTF-8.
        type_hash: The definition's REP-2011 hash, `RIHS01_...`.
    """

    name: str
    encoding: str
    definition: bytes
    type_hash: str


class Encoder:
    """Encodes as ROS 2 Humble defines the messages; later distributions define these types alike."""

    def __init__(self) -> None:
        self._store, self._pair_text = _types()

    def message_type(self, name: str) -> MessageType:
        """Definition and hash of one of the types named above."""
        text = self._store.generate_msgdef(name, ros_version=2)[0]
        if name == PAIR_FUSION:  # generated text has no comments, and here they hold the units
            separator = "=" * 80
            text = self._pair_text + separator + text.partition(separator)[2]
        return MessageType(name, "ros2msg", text.encode(), self._store.hash_rihs01(name))

    def occupancy_grid(self, grid: OccupancyGrid, frame_id: str, stamp_ns: int) -> bytes:
        """nav_msgs/msg/OccupancyGrid of `grid` in `frame_id`."""
        info = ros.nav_msgs__msg__MapMetaData(
            map_load_time=_time(stamp_ns),
            resolution=grid.resolution_m,
            width=grid.width,
            height=grid.height,
            origin=_pose(grid.T_frame_grid),
        )
        message = ros.nav_msgs__msg__OccupancyGrid(
            header=_header(frame_id, stamp_ns), info=info, data=grid.cells.reshape(-1)
        )
        return bytes(self._store.serialize_cdr(message, OCCUPANCY_GRID, little_endian=True))

    def pose(self, pose: SE2, frame_id: str, stamp_ns: int) -> bytes:
        """geometry_msgs/msg/PoseStamped."""
        message = ros.geometry_msgs__msg__PoseStamped(header=_header(frame_id, stamp_ns), pose=_pose(pose))
        return bytes(self._store.serialize_cdr(message, POSE_STAMPED, little_endian=True))

    def transforms(self, transforms: Iterable[tuple[str, str, SE2]], stamp_ns: int) -> bytes:
        """tf2_msgs/msg/TFMessage of (parent frame, child frame, T_parent_child)."""
        stamped = []
        for parent, child, T_parent_child in transforms:
            pose = _pose(T_parent_child)
            translation = ros.geometry_msgs__msg__Vector3(x=pose.position.x, y=pose.position.y, z=0.0)
            transform = ros.geometry_msgs__msg__Transform(translation=translation, rotation=pose.orientation)
            stamped.append(
                ros.geometry_msgs__msg__TransformStamped(
                    header=_header(parent, stamp_ns), child_frame_id=child, transform=transform
                )
            )
        message = ros.tf2_msgs__msg__TFMessage(transforms=stamped)
        return bytes(self._store.serialize_cdr(message, TF_MESSAGE, little_endian=True))

    def path(self, path: Path, frame_id: str, stamp_ns: int) -> bytes:
        """nav_msgs/msg/Path.

        Written with numpy: rosbags takes 11 us a pose, and a long mission has many. Each PoseStamped ends on a
        multiple of 8 bytes, so all but the first have one layout.
        """
        frame = frame_id.encode() + b"\0"
        head = struct.pack("<iII", *divmod(stamp_ns, 10**9), len(frame)) + frame
        head += bytes(-len(head) % 4) + struct.pack("<I", len(path.stamps_ns))
        first = _stamped_poses(path.stamps_ns[:1], path.poses[:1], frame, len(head))
        return b"\x00\x01\x00\x00" + head + first + _stamped_poses(path.stamps_ns[1:], path.poses[1:], frame, 0)

    def pair(self, report: PairReport, frame_id: str, stamp_ns: int) -> bytes:
        """mapfusion_msgs/msg/PairFusion; `frame_id` is a's map frame."""
        message = self._store.types[PAIR_FUSION](
            header=_header(frame_id, stamp_ns),
            **pair_fields(report),
            covariance=pair_covariance(report),
            evidence_names=list(report.fusion.evidence),
            evidence_values=np.array([*report.fusion.evidence.values()], dtype=np.float64),
        )
        return bytes(self._store.serialize_cdr(message, PAIR_FUSION, little_endian=True))

    def diagnostics(self, statuses: Iterable[Status], stamp_ns: int) -> bytes:
        """diagnostic_msgs/msg/DiagnosticArray."""
        kind = ros.diagnostic_msgs__msg__DiagnosticStatus
        status = [
            kind(
                level=kind.OK if line.ok else kind.WARN,
                name=line.name,
                message=line.message,
                hardware_id="",
                values=[ros.diagnostic_msgs__msg__KeyValue(key=k, value=v) for k, v in line.values.items()],
            )
            for line in statuses
        ]
        message = ros.diagnostic_msgs__msg__DiagnosticArray(header=_header("", stamp_ns), status=status)
        return bytes(self._store.serialize_cdr(message, DIAGNOSTIC_ARRAY, little_endian=True))


@cache
def _types() -> tuple[Typestore, str]:
    """The types and PairFusion's definition, made once: rosbags makes classes, which cost time and memory anew."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    text = resources.files(__package__).joinpath("pair_fusion.msg").read_text(encoding="utf-8")
    store.register(get_types_from_msg(text, PAIR_FUSION))
    return store, text


def _stamped_poses(stamps_ns: StampArray, poses: FloatArray, frame: bytes, offset: int) -> bytes:
    """CDR of PoseStamped messages of one layout, the first of which begins `offset` bytes into its message."""
    padding = -(offset + 12 + len(frame)) % 8
    layout = [
        ("sec", "<i4"),
        ("nanosec", "<u4"),
        ("length", "<u4"),
        ("frame", f"S{len(frame) + padding}"),
        ("position", "<f8", 3),
        ("orientation", "<f8", 4),
    ]
    records = np.zeros(len(stamps_ns), dtype=layout)
    records["sec"], records["nanosec"] = np.divmod(stamps_ns, 10**9)
    records["length"], records["frame"] = len(frame), frame
    records["position"][:, :2] = poses[:, :2]
    records["orientation"][:, 2], records["orientation"][:, 3] = np.sin(poses[:, 2] / 2), np.cos(poses[:, 2] / 2)
    return records.tobytes()


def _time(stamp_ns: int) -> ros.builtin_interfaces__msg__Time:
    sec, nanosec = divmod(stamp_ns, 10**9)
    return ros.builtin_interfaces__msg__Time(sec=sec, nanosec=nanosec)


def _header(frame_id: str, stamp_ns: int) -> ros.std_msgs__msg__Header:
    return ros.std_msgs__msg__Header(stamp=_time(stamp_ns), frame_id=frame_id)


def _pose(T: SE2) -> ros.geometry_msgs__msg__Pose:
    return ros.geometry_msgs__msg__Pose(
        position=ros.geometry_msgs__msg__Point(x=T.x_m, y=T.y_m, z=0.0),
        orientation=ros.geometry_msgs__msg__Quaternion(
            x=0.0, y=0.0, z=math.sin(T.yaw_rad / 2), w=math.cos(T.yaw_rad / 2)
        ),
    )
