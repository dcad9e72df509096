"""How the keypoints of two maps fall together under a pose: evidence of corners beside that of walls.

A corner that one robot saw is a corner in the other's map as well, near the same place and of a like look. The first is
counted as in `evidence`, against what chance would bring together; the second by the matches that a pose explains.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mapfusion.pairwise.features import Features
from mapfusion.pairwise.poses import Poses, inverse, moved
from mapfusion.pairwise.prepared import PreparedMap
from mapfusion.pairwise.surface import NOT_KNOWN
from mapfusion.pairwise.voting import Matches

REPEATED_CELLS = {1.5: 2, 3.0: 4, 6.0: 8}
"""How near a keypoint of the other map must lie, cells, by the tolerance at which walls agree: maps bend."""
PRIOR_KEYPOINTS = 6.0
"""As many keypoints that behave like chance are added to those that are counted."""
NEAR_INLIER_CELLS, WIDE_INLIER_CELLS = 2.0, 8.0
MAX_TURN_RAD = 0.5
"""Most by which the directions of matched keypoints may differ from the pose's."""


@dataclass(frozen=True, slots=True)
class KeypointAgreement:
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
        inliers_near=_inliers(matches, off <= NEAR_INLIER_CELLS**2),
        inliers_wide=_inliers(matches, off <= WIDE_INLIER_CELLS**2),
    )


@dataclass(frozen=True, slots=True)
class _Repeated:
    """One direction: keypoints in the area known in both, how many lie beside one of the other map, share by chance."""

    number: int
    repeated: int
    chance: float


def _repeated(there: PreparedMap, here: PreparedMap, pose: Poses, radius_cells: int) -> _Repeated:
    assert there.field is not None
    depth, near = there.field.depth.ravel(), there.near_keypoints(radius_cells).ravel()
    found = []
    for points in (here.features.points, here.area):
        cells = there.field.cells_below(moved(pose[None], points))[0]
        found.append(near.take(cells[depth.take(cells) != NOT_KNOWN]))
    keypoints, area = found
    return _Repeated(len(keypoints), int(np.count_nonzero(keypoints)), float(area.mean()) if len(area) else 1.0)


def squared_offsets(target: Features, source: Features, matches: Matches, pose: Poses) -> npt.NDArray[np.float32]:
    """(M,) squared cells by which `pose` (3,) misses each match; infinite where their directions differ too much."""
    gap = moved(pose[None], source.points[matches.source])[0].T - target.points[matches.target]
    turn = target.angles_rad[matches.target] - source.angles_rad[matches.source] - pose[2]
    is_like = np.abs(np.remainder(turn + math.pi, 2.0 * math.pi) - math.pi) < MAX_TURN_RAD
    return np.where(is_like, np.square(gap).sum(axis=-1), np.float32(np.inf))


def _inliers(matches: Matches, is_explained: npt.NDArray[np.bool_]) -> int:
    return len(np.unique(matches.target[is_explained])) + len(np.unique(matches.source[is_explained]))
