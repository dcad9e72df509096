"""Bytes of messages, read back with rosbags and with mcap-ros2-support."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore
from rosbags.typesys.stores import ros2_humble as ros

from mapfusion.grid import OccupancyGrid
from mapfusion.result import PairFusion
from mapfusion.steps import PairReport, Path
from mapfusion.transform import SE2, yaw_from_quaternion
from mapfusion_io import encode
from mapfusion_io.encode import Encoder
from mapfusion_io.pair_report import Status

STAMP_NS = 1_700_000_000_123_456_789


@pytest.fixture(scope="module")
def encoder() -> Encoder:
    return Encoder()


def store_of(encoder: Encoder, type_name: str) -> Typestore:
    """Knows what the definition that goes into the file says, and nothing else."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(encoder.message_type(type_name).definition.decode(), type_name))
    return store


def decode(encoder: Encoder, type_name: str, data: bytes) -> Any:
    return store_of(encoder, type_name).deserialize_cdr(data, type_name)


def decode_elsewhere(encoder: Encoder, type_name: str, data: bytes) -> Any:
    kind = encoder.message_type(type_name)
    decoder = DecoderFactory().decoder_for("cdr", Schema(1, kind.definition, kind.encoding, kind.name))
    assert decoder is not None
    return decoder(data)


def make_header(frame_id: str, stamp_ns: int) -> ros.std_msgs__msg__Header:
    return ros.std_msgs__msg__Header(ros.builtin_interfaces__msg__Time(*divmod(stamp_ns, 10**9)), frame_id)


def yaw(orientation: Any) -> float:
    return yaw_from_quaternion(orientation.x, orientation.y, orientation.z, orientation.w)


def make_report(fusion: PairFusion) -> PairReport:
    return PairReport("robot1", "robot2", fusion, placed=fusion.accepted, age_a_s=0.5, age_b_s=2.0)


def test_grid_has_its_cells_and_its_corner(encoder: Encoder) -> None:
    cells = np.arange(-1, 5, dtype=np.int8).reshape(2, 3)
    grid = OccupancyGrid(cells, 0.05, SE2(-1.5, 2.5, 0.75), "not this", 5)
    message = decode(encoder, encode.OCCUPANCY_GRID, encoder.occupancy_grid(grid, "world", STAMP_NS))
    assert (message.header.frame_id, message.header.stamp.sec) == ("world", STAMP_NS // 10**9)
    assert message.header.stamp.nanosec == STAMP_NS % 10**9
    assert (message.info.width, message.info.height) == (3, 2)
    assert message.info.resolution == pytest.approx(0.05, abs=1e-8)
    np.testing.assert_array_equal(message.data, [-1, 0, 1, 2, 3, 4])
    assert (message.info.origin.position.x, message.info.origin.position.y) == (-1.5, 2.5)
    assert yaw(message.info.origin.orientation) == pytest.approx(0.75, abs=1e-12)


def test_pose_has_its_heading(encoder: Encoder) -> None:
    data = encoder.pose(SE2(1.0, -2.0, -3.0), "world_2", STAMP_NS)
    for message in (decode(encoder, encode.POSE_STAMPED, data), decode_elsewhere(encoder, encode.POSE_STAMPED, data)):
        assert message.header.frame_id == "world_2"
        assert (message.pose.position.x, message.pose.position.y, message.pose.position.z) == (1.0, -2.0, 0.0)
        assert yaw(message.pose.orientation) == pytest.approx(-3.0, abs=1e-12)


def test_transforms_go_from_child_to_parent(encoder: Encoder) -> None:
    data = encoder.transforms([("world", "robot1/map", SE2.identity()), ("world", "m", SE2(1.0, 2.0, 0.5))], STAMP_NS)
    for message in (decode(encoder, encode.TF_MESSAGE, data), decode_elsewhere(encoder, encode.TF_MESSAGE, data)):
        first, second = message.transforms
        assert (first.header.frame_id, first.child_frame_id, first.transform.rotation.w) == ("world", "robot1/map", 1.0)
        assert (second.child_frame_id, second.transform.translation.x, second.transform.translation.y) == (
            "m",
            1.0,
            2.0,
        )
        assert yaw(second.transform.rotation) == pytest.approx(0.5, abs=1e-12)


@pytest.mark.parametrize("num_poses", [0, 1, 2, 50])
@pytest.mark.parametrize("frame_id", [*("w" * length for length in range(1, 9)), "Welt_ü"])
def test_path_has_the_bytes_rosbags_would_write(encoder: Encoder, num_poses: int, frame_id: str) -> None:
    poses = np.random.default_rng(1).uniform(-3.0, 3.0, (num_poses, 3))
    stamps_ns = STAMP_NS + 333_333_333 * np.arange(num_poses, dtype=np.int64)
    rotations = np.stack([np.sin(poses[:, 2] / 2), np.cos(poses[:, 2] / 2)], axis=1)
    stamped = [
        ros.geometry_msgs__msg__PoseStamped(
            make_header(frame_id, stamp_ns),
            ros.geometry_msgs__msg__Pose(
                ros.geometry_msgs__msg__Point(x_m, y_m, 0.0), ros.geometry_msgs__msg__Quaternion(0.0, 0.0, z, w)
            ),
        )
        for stamp_ns, (x_m, y_m, _), (z, w) in zip(stamps_ns.tolist(), poses.tolist(), rotations.tolist(), strict=True)
    ]
    message = ros.nav_msgs__msg__Path(make_header(frame_id, STAMP_NS), stamped)
    expected = get_typestore(Stores.ROS2_HUMBLE).serialize_cdr(message, encode.PATH, little_endian=True)
    assert encoder.path(Path(stamps_ns, poses), frame_id, STAMP_NS) == expected


def test_pair_has_every_figure(encoder: Encoder) -> None:
    fusion = PairFusion(
        accepted=True,
        T_target_source=SE2(1.0, 2.0, math.radians(90.0)),
        confidence=0.875,
        mae=12.5,
        overlap_ratio=0.5,
        overlap_cells=1234,
        num_keypoints_target=300,
        num_keypoints_source=200,
        num_matches=80,
        num_inliers=40,
        scale=1.01,
        covariance=np.arange(9.0).reshape(3, 3),
        resolution_m=0.05,
        rival=SE2(-1.0, 0.0, math.radians(-45.0)),
        evidence={"wall_share": 0.25, "gap_m": 1.5},
    )
    data = encoder.pair(make_report(fusion), "robot1/map", STAMP_NS)
    for message in (decode(encoder, encode.PAIR_FUSION, data), decode_elsewhere(encoder, encode.PAIR_FUSION, data)):
        assert (message.header.frame_id, message.a, message.b) == ("robot1/map", "robot1", "robot2")
        assert (message.accepted, message.placed, message.reason, message.gate) == (True, True, "", "")
        assert (message.confidence, message.mae, message.overlap_ratio, message.overlap_cells) == (
            0.875,
            12.5,
            0.5,
            1234,
        )
        assert (message.keypoints_a, message.keypoints_b, message.matches, message.inliers) == (300, 200, 80, 40)
        assert (message.scale, message.x_m, message.y_m) == (1.01, 1.0, 2.0)
        assert message.yaw_deg == pytest.approx(90.0, abs=1e-9)
        assert (message.age_a_s, message.age_b_s, message.resolution_m) == (0.5, 2.0, 0.05)
        assert list(message.covariance) == list(range(9))
        assert (message.rival_x_m, message.rival_y_m) == (-1.0, 0.0)
        assert message.rival_yaw_deg == pytest.approx(-45.0, abs=1e-9)
        assert list(message.evidence_names) == ["wall_share", "gap_m"]
        assert list(message.evidence_values) == [0.25, 1.5]


def test_pair_says_nan_for_what_there_is_not(encoder: Encoder) -> None:
    data = encoder.pair(make_report(PairFusion(False, "too few matches", "few matches")), "m", STAMP_NS)
    message = decode(encoder, encode.PAIR_FUSION, data)
    names = ("mae", "scale", "x_m", "y_m", "yaw_deg", "rival_x_m", "rival_y_m", "rival_yaw_deg")
    assert all(math.isnan(getattr(message, name)) for name in names)
    assert np.isnan(message.covariance).all()
    assert (message.reason, message.gate, len(message.evidence_names)) == ("too few matches", "few matches", 0)


def test_diagnostics_have_levels_and_values(encoder: Encoder) -> None:
    statuses = [Status("mapfusion/a/b", False, "no overlap", {"mae": ""}), Status("x", True, "joined", {})]
    data = encoder.diagnostics(statuses, STAMP_NS)
    for message in (
        decode(encoder, encode.DIAGNOSTIC_ARRAY, data),
        decode_elsewhere(encoder, encode.DIAGNOSTIC_ARRAY, data),
    ):
        assert message.header.stamp.sec == STAMP_NS // 10**9
        assert [(status.name, status.level, status.message) for status in message.status] == [
            ("mapfusion/a/b", 1, "no overlap"),
            ("x", 0, "joined"),
        ]
        assert [(pair.key, pair.value) for pair in message.status[0].values] == [("mae", "")]


@pytest.mark.parametrize("name", encode.TYPES)
def test_hash_is_that_of_the_definition_in_the_file(encoder: Encoder, name: str) -> None:
    kind = encoder.message_type(name)
    assert kind.type_hash == store_of(encoder, name).hash_rihs01(name)
    assert (kind.name, kind.encoding) == (name, "ros2msg")


def test_every_field_of_a_pair_says_its_unit(encoder: Encoder) -> None:
    text = encoder.message_type(encode.PAIR_FUSION).definition.decode().partition("=" * 80)[0]
    fields = [line for line in text.splitlines() if line and not line.startswith("#")]
    defined = store_of(encoder, encode.PAIR_FUSION).fielddefs[encode.PAIR_FUSION][1]
    assert [line.split()[1] for line in fields] == [name for name, _ in defined]
    units = ("(no unit)", "metres", "degrees", "seconds", "grey levels", "count", "rad^2", "stamp:", "units of")
    for line in fields:
        assert any(unit in line.partition("#")[2] for unit in units), line
