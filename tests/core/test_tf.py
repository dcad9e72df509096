import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from mapfusion.tf import TransformBuffer, TransformChain

IDENTITY = (0.0, 0.0, 0.0, 1.0)


def yaw_quat(yaw: float) -> tuple[float, float, float, float]:
    return (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))


def stamps(*values: int) -> np.ndarray:
    return np.array(values, np.int64)


def chain_of(buffer: TransformBuffer, target: str, source: str) -> TransformChain:
    chain = buffer.chain(target, source)
    assert chain is not None
    return chain


def test_translations_are_interpolated_linearly_and_never_extrapolated() -> None:
    buffer = TransformBuffer()
    buffer.add("map", "base", 100, (0.0, 0.0, 0.0), IDENTITY)
    buffer.add("map", "base", 200, (1.0, 2.0, 0.0), yaw_quat(1.0))
    poses = chain_of(buffer, "map", "base").poses_at(stamps(99, 100, 125, 200, 201))
    np.testing.assert_allclose(poses[1:4], np.array([[0, 0, 0], [0.25, 0.5, 0.25], [1, 2, 1]]), atol=1e-12)
    assert np.isnan(poses[[0, 4]]).all()


def test_rotations_are_interpolated_as_scipy_does() -> None:
    rng = np.random.default_rng(3)
    quats = Rotation.random(20, rng=rng).as_quat()
    times = np.arange(20) * 1000
    buffer = TransformBuffer()
    for time, quat in zip(times, quats, strict=True):
        buffer.add("map", "base", int(time), (0.0, 0.0, 0.0), quat)
    asked = rng.integers(0, 19000, 500).astype(np.int64)
    expected = Slerp(times, Rotation.from_quat(quats))(asked).as_matrix()
    yaw = chain_of(buffer, "map", "base").poses_at(asked)[:, 2]
    np.testing.assert_allclose(
        np.exp(1j * yaw), np.exp(1j * np.arctan2(expected[:, 1, 0], expected[:, 0, 0])), atol=1e-9
    )


def test_a_chain_goes_up_and_down_through_static_and_moving_edges() -> None:
    buffer = TransformBuffer()
    buffer.add("earth", "map", 0, (10.0, 0.0, 0.0), yaw_quat(math.pi / 2), is_static=True)
    buffer.add("earth", "odom", 0, (0.0, 5.0, 0.0), IDENTITY)
    buffer.add("earth", "odom", 100, (0.0, 5.0, 0.0), IDENTITY)
    buffer.add("odom", "base", 50, (1.0, 0.0, 0.0), IDENTITY)
    buffer.add("odom", "base", 150, (3.0, 0.0, 0.0), IDENTITY)
    chain = chain_of(buffer, "map", "base")
    # In earth base lies at (2, 5) at time 100; seen from map, which stands at (10, 0) and looks along +y: (5, 8).
    np.testing.assert_allclose(chain.poses_at(stamps(100)), [[5.0, 8.0, -math.pi / 2]], atol=1e-12)
    assert chain.stamps_ns.tolist() == [50, 100]


def test_of_samples_with_one_stamp_the_last_counts_in_any_order_of_arrival() -> None:
    buffer = TransformBuffer()
    for stamp, x in [(200, 2.0), (100, 7.0), (100, 1.0)]:
        buffer.add("map", "base", stamp, (x, 0.0, 0.0), IDENTITY)
    np.testing.assert_allclose(chain_of(buffer, "map", "base").poses_at(stamps(100, 150))[:, 0], [1.0, 1.5])


def test_frames_without_a_way_between_them() -> None:
    buffer = TransformBuffer()
    buffer.add("a", "b", 0, (0.0, 0.0, 0.0), IDENTITY)
    buffer.add("c", "d", 0, (0.0, 0.0, 0.0), IDENTITY)
    assert buffer.chain("a", "d") is None
    assert buffer.chain("a", "nowhere") is None


def test_loops_end() -> None:
    buffer = TransformBuffer()
    buffer.add("a", "b", 0, (1.0, 0.0, 0.0), IDENTITY)
    buffer.add("b", "c", 0, (1.0, 0.0, 0.0), IDENTITY)
    buffer.add("c", "a", 0, (1.0, 0.0, 0.0), IDENTITY)
    np.testing.assert_allclose(chain_of(buffer, "a", "c").poses_at(stamps(0))[0, 0], -1.0)
    assert buffer.chain("a", "elsewhere") is None


def test_absorbing_renames_and_shifts() -> None:
    inner = TransformBuffer()
    inner.add("map", "base", 100, (1.0, 0.0, 0.0), IDENTITY)
    outer = TransformBuffer()
    outer.absorb(inner, lambda frame: f"r1/{frame}", shift_ns=5)
    assert outer.frames == {"r1/map", "r1/base"}
    assert chain_of(outer, "r1/map", "r1/base").stamps_ns.tolist() == [105]


@pytest.mark.parametrize("norm", [0.9, 1.1])
def test_quaternions_are_normalised(norm: float) -> None:
    buffer = TransformBuffer()
    quat = tuple(norm * part for part in yaw_quat(0.4))
    buffer.add("map", "base", 0, (0.0, 0.0, 0.0), quat)
    np.testing.assert_allclose(chain_of(buffer, "map", "base").poses_at(stamps(0))[0], [0, 0, 0.4], atol=1e-12)


def test_stamps_that_do_not_hold_are_dropped_and_counted() -> None:
    buffer = TransformBuffer()
    for stamp in (10, 20, 30, 1000):
        buffer.add("map", "base", stamp, (float(stamp), 0.0, 0.0), IDENTITY)
    buffer.add("map", "other", 1000, (0.0, 0.0, 0.0), IDENTITY)
    buffer.add("world", "map", 1000, (0.0, 0.0, 0.0), IDENTITY, is_static=True)
    assert buffer.range_ns == (10, 1000)
    assert buffer.keep(lambda stamps_ns: stamps_ns < 100) == 2
    assert buffer.range_ns == (10, 30)
    assert buffer.frames == {"map", "base", "world"}
    np.testing.assert_allclose(chain_of(buffer, "world", "base").poses_at(stamps(15, 30))[:, 0], [15.0, 30.0])
    assert TransformBuffer().range_ns is None


def test_a_stray_sample_does_not_turn_a_loop_around() -> None:
    buffer = TransformBuffer()
    for stamp in (10, 20, 30):
        buffer.add("map", "base", stamp, (1.0, 0.0, 0.0), IDENTITY)
    buffer.add("base", "map", 15, (7.0, 0.0, 0.0), IDENTITY)
    np.testing.assert_allclose(chain_of(buffer, "map", "base").poses_at(stamps(10, 30))[:, 0], [1.0, 1.0])


def test_endless_ways_up_are_not_followed() -> None:
    buffer = TransformBuffer()
    for index in range(5000):
        buffer.add(f"frame{index}", f"frame{index + 1}", 0, (1.0, 0.0, 0.0), IDENTITY)
    np.testing.assert_allclose(chain_of(buffer, "frame0", "frame60").poses_at(stamps(0))[0, 0], 60.0)
    assert buffer.chain("frame0", "frame5000") is None
