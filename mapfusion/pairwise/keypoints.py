"""How the keypoints of two maps fall together under a pose: evidence of corners beside that of walls.

A corner that one robot saw is a corner in the other's map as well, near the same place and of a like look. The first is
counted as in `evidence`, against what chance would bring together; the second by the matches that a pose explains.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from mapfusion.compiled import compiled
from mapfusion.pairwise.features import Features
from mapfusion.pairwise.poses import Poses, inverse
from mapfusion.pairwise.prepared import PreparedMap
from mapfusion.pairwise.refine import cells_below
from mapfusion.pairwise.surface import NOT_KNOWN, Bytes, Floats, Indices, Points
from mapfusion.pairwise.voting import Matches

REPEATED_CELLS = {1.5: 2, 3.0: 4, 6.0: 8}
"""How near a keypoint of the other map must lie, cells, by the tolerance at which walls agree: maps bend."""
PRIOR_KEYPOINTS = 6.0
"""As many keypoints that behave like chance are added to those that are counted."""
NEAR_INLIER_CELLS, WIDE_INLIER_CELLS = 2.0, 8.0
MAX_TURN_RAD = 0.5
"""Most by which the directions of matched keypoints may differ from the pose's."""


class KeypointAgreement(NamedTuple):
    """What keypoints say of a pose.

    Attributes:
        keypoints: Log-odds that a keypoint in the area known in both has one of the other map beside it, over the
            log-odds that a random cell of it has.
        inliers_near: Keypoints of both maps with a match that the pose explains within NEAR_INLIER_CELLS.
        inliers_wide: The same within WIDE_INLIER_CELLS.
    """

    keypoints: float
    inliers_near: int
    inliers_wide: int


def keypoint_agreement(
    target: PreparedMap, source: PreparedMap, pose: Poses, matches: Matches, tolerance_cells: float
) -> KeypointAgreement:
    """Looks at the keypoints of both maps under `pose` (3,) of the source in the target."""
    radius_cells = REPEATED_CELLS[tolerance_cells]
    forward = _repeated(target, source, pose, radius_cells)
    backward = _repeated(source, target, inverse(pose[None])[0], radius_cells)
    n, k = forward.number + backward.number, forward.repeated + backward.repeated
    chance = (forward.chance * forward.number + backward.chance * backward.number) / max(n, 1)
    odds = (k + PRIOR_KEYPOINTS * chance + 1.0) / (n - k + PRIOR_KEYPOINTS * (1.0 - chance) + 1.0)
    off = squared_offsets(target.features, source.features, matches, pose)
    return KeypointAgreement(
        keypoints=math.log(odds) - math.log((chance + 0.02) / (1.02 - chance)),
        inliers_near=_inliers(target.features, source.features, matches, off, NEAR_INLIER_CELLS),
        inliers_wide=_inliers(target.features, source.features, matches, off, WIDE_INLIER_CELLS),
    )


class _Repeated(NamedTuple):
    """One direction: keypoints in the area known in both, how many lie beside one of the other map, share by chance."""

    number: int
    repeated: int
    chance: float


def _repeated(there: PreparedMap, here: PreparedMap, pose: Poses, radius_cells: int) -> _Repeated:
    assert there.field is not None
    depth, near = there.field.depth.ravel(), there.near_keypoints(radius_cells).ravel()
    number, repeated = _counted(depth, NOT_KNOWN, near, cells_below(there.field, here.features.points, pose[None]))
    num_area, near_by_chance = _counted(depth, NOT_KNOWN, near, cells_below(there.field, here.area, pose[None]))
    return _Repeated(number, repeated, near_by_chance / num_area if num_area else 1.0)


@compiled
def _counted(depth: Bytes, not_known: int, near: Bytes, cells: Indices) -> tuple[int, int]:
    """How many of some cells (1, N) are known, and how many of these are near; both tell of all of a map's cells."""
    num_known, num_near = 0, 0
    for cell in cells[0]:
        if depth[cell] != not_known:
            num_known += 1
            num_near += int(near[cell])
    return num_known, num_near


def squared_offsets(target: Features, source: Features, matches: Matches, pose: Poses) -> Floats:
    """(M,) squared cells by which `pose` (3,) misses each match; infinite where their directions differ too much."""
    return _squared_offsets(
        target.points, target.angles_rad, source.points, source.angles_rad, matches.target, matches.source, pose
    )


@compiled
def _squared_offsets(
    target: Points,
    target_angles: Floats,
    source: Points,
    source_angles: Floats,
    of_target: npt.NDArray[np.intp],
    of_source: npt.NDArray[np.intp],
    pose: Poses,
) -> Floats:
    x, y, theta = pose
    c, s = math.cos(theta), math.sin(theta)
    off = np.full(len(of_target), np.inf, np.float32)
    for k in range(len(of_target)):
        i, j = of_target[k], of_source[k]
        if _turn_alike(target_angles[i], source_angles[j], theta):
            dx = c * source[j, 0] - s * source[j, 1] + x - target[i, 0]
            dy = s * source[j, 0] + c * source[j, 1] + y - target[i, 1]
            off[k] = dx * dx + dy * dy
    return off


@compiled
def _turn_alike(of_target: float, of_source: float, theta: float) -> bool:
    """Whether two directions differ by about `theta`, radians."""
    turn = of_target - of_source - theta
    return bool(abs((turn + math.pi) % (2.0 * math.pi) - math.pi) < MAX_TURN_RAD)


def num_explained(target: Features, source: Features, matches: Matches, poses: Poses) -> npt.NDArray[np.int64]:
    """(K,) how many matches each of the poses (K, 3) explains within WIDE_INLIER_CELLS."""
    there, here = matches.target, matches.source
    matched = target.points[there], target.angles_rad[there], source.points[here], source.angles_rad[here]
    return _num_explained(*matched, np.ascontiguousarray(poses), WIDE_INLIER_CELLS**2)


@compiled
def _num_explained(
    there: Points, facing_there: Floats, here: Points, facing_here: Floats, poses: Poses, squared_cells: float
) -> npt.NDArray[np.int64]:
    """The same for M matches. Where they lie is looked at first: that takes less time, and few lie near."""
    explained = np.zeros(len(poses), np.int64)
    for p in range(len(poses)):
        x, y, theta = poses[p]
        c, s = math.cos(theta), math.sin(theta)
        for k in range(len(here)):
            dx = c * here[k, 0] - s * here[k, 1] + x - there[k, 0]
            dy = s * here[k, 0] + c * here[k, 1] + y - there[k, 1]
            if dx * dx + dy * dy <= squared_cells and _turn_alike(facing_there[k], facing_here[k], theta):
                explained[p] += 1
    return explained


def _inliers(target: Features, source: Features, matches: Matches, off: Floats, cells: float) -> int:
    return sum(
        _num_within(off, cells * cells, one, len(features))
        for one, features in ((matches.target, target), (matches.source, source))
    )


@compiled
def _num_within(squared: Floats, limit: float, of_map: npt.NDArray[np.intp], num_features: int) -> int:
    """How many of a map's keypoints have a match (M,) up to a limit."""
    is_within = np.zeros(num_features, np.bool_)
    for k in range(len(squared)):
        if squared[k] <= limit:
            is_within[of_map[k]] = True
    return int(is_within.sum())
