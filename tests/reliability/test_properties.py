"""Whatever shape they have: grids, poses, transform trees and bytes end as a message, or as one that is refused."""

import math
from contextlib import suppress

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mapfusion.errors import MalformedMessageError
from mapfusion.tf import TransformBuffer
from mapfusion_io.decode import Decoder
from mapfusion_io.messages import StampedPose, StampedTransform, believed, grid_update, occupancy_grid, pose, transforms
from mapfusion_io.stamp_census import DAY_NS, END_OF_TIME_NS, StampCensus
from tests.io.making import cdr, grid_message, raw_message, tf_message, update_message
from tests.reliability.missions import GRID, POSE, TF
from tests.reliability.missions import pose as pose_message

EXAMPLES = settings(max_examples=60)
NUMBERS = st.floats(width=64)
CELLS = hnp.arrays(np.int8, hnp.array_shapes(min_dims=2, max_dims=2, max_side=12), elements=st.integers(-128, 127))
STAMPS = st.integers(0, END_OF_TIME_NS - 1)
READERS = {GRID: occupancy_grid, TF: transforms, POSE: pose, "map_msgs/msg/OccupancyGridUpdate": grid_update}


@EXAMPLES
@given(CELLS, st.floats(width=32), NUMBERS, st.tuples(NUMBERS, NUMBERS, NUMBERS, NUMBERS), st.text())
def test_grids(
    cells: np.ndarray, resolution_m: float, x: float, quat: tuple[float, float, float, float], frame: str
) -> None:
    message = grid_message(cells, resolution_m, frame, x=x, quat=quat)
    try:
        grid = believed(occupancy_grid, message)
    except MalformedMessageError:
        return
    assert (grid.cells == cells).all()
    assert cells.min() >= -1
    assert cells.max() <= 100
    assert 0.0 < grid.resolution_m < 1e3
    assert math.isfinite(grid.T_frame_grid.x_m + grid.T_frame_grid.yaw_rad)


@EXAMPLES
@given(st.tuples(NUMBERS, NUMBERS, NUMBERS, NUMBERS), NUMBERS, st.text(max_size=3), st.text(max_size=3))
def test_poses_and_transforms(quat: tuple[float, float, float, float], x: float, parent: str, child: str) -> None:
    transform = tf_message((parent, child), quat=quat)
    transform.transforms[0].transform.translation.x = x
    samples: list[StampedPose | StampedTransform] = []
    with suppress(MalformedMessageError):
        samples.extend(believed(transforms, transform))
    with suppress(MalformedMessageError):
        samples.append(believed(pose, pose_message("a", x=x, quat=quat)))
    for sample in samples:
        assert math.isclose(math.hypot(*sample.quat_xyzw), 1.0)
        assert math.isfinite(sum(sample.translation_m))


@EXAMPLES
@given(st.binary(max_size=300), st.sampled_from(sorted(READERS)), st.integers(0, 7), st.data())
def test_any_bytes(data: bytes, name: str, kind: int, draw: st.DataObject) -> None:
    whole = {
        GRID: grid_message(np.zeros((3, 4), np.int8)),
        TF: tf_message(("a", "b"), ("b", "c")),
        POSE: pose_message("a"),
    }.get(name) or update_message(np.zeros((2, 2), np.int8), 0, 0)
    damaged = bytearray(cdr(whole))
    for _ in range(kind):
        damaged[draw.draw(st.integers(0, len(damaged) - 1))] = draw.draw(st.integers(0, 255))
    for content in (data, bytes(damaged), bytes(damaged[: len(data)]), b"\0\1\0\0" + data):
        with suppress(MalformedMessageError):  # nothing else may leave
            believed(READERS[name], Decoder().decode(raw_message(name, content)))  # type: ignore[arg-type]


@EXAMPLES
@given(
    st.lists(st.tuples(st.integers(0, 7), st.integers(0, 7), st.integers(0, 20), st.booleans()), max_size=40),
    st.integers(0, 7),
    st.integers(0, 7),
)
def test_transform_trees(edges: list[tuple[int, int, int, bool]], target: int, source: int) -> None:
    buffer = TransformBuffer()
    for parent, child, stamp_ns, is_static in edges:
        buffer.add(str(parent), str(child), stamp_ns, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), is_static)
    chain = buffer.chain(str(target), str(source))
    assert (chain is not None) == buffer.are_connected(str(target), str(source))
    back = buffer.chain(str(source), str(target))
    assert (chain is None) == (back is None)
    if chain is not None:
        assert np.isfinite(chain.poses_at(chain.stamps_ns)).all()
        assert (np.diff(chain.stamps_ns) > 0).all()


@EXAMPLES
@given(
    st.lists(
        st.tuples(st.sampled_from("abc"), st.integers(0, END_OF_TIME_NS - 1), st.integers(0, DAY_NS)), max_size=30
    ),
    st.integers(0, 20_000),
)
def test_stamps(messages: list[tuple[str, int, int]], day: int) -> None:
    census = StampCensus()
    good = [(topic, day * DAY_NS + step) for topic, _, step in messages]
    for topic, stamp_ns in good * 10:
        census.add(topic, stamp_ns, stamp_ns)
    for topic, stamp_ns, step in messages:
        census.add(topic, stamp_ns, day * DAY_NS + step)
    believable = census.believable()
    assert all(believable[topic].hold(np.array([stamp_ns])).all() for topic, stamp_ns in good)
