"""ORB keypoints on a graded image of the walls."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from mapfusion.grid import Mask
from mapfusion.pairwise.surface import Bytes, Points

BORDER = 32
"""Background around the image, cells: ORB is blind in a frame of its patch."""
BLUR_SIGMA = 1.5
"""Blur of the wall image, cells: binary staircases carry no gradient worth describing."""
_KERNEL = cv2.getGaussianKernel(9, BLUR_SIGMA, cv2.CV_32F)
NUM_FEATURES, MOST_FEATURES = 500, 4000
MANY_WALLS, WALLS_PER_FEATURE = 5000, 5
"""Of maps with at least the first, cells, a thorough search takes a keypoint for each of the second, up to
MOST_FEATURES: of the best few of a large map hardly any lie in a small part that another map has in common with it."""
NUM_LEVELS = 2
SCALE_FACTOR = 1.6
FAST_THRESHOLD = 5


def num_features(num_walls: int) -> int:
    """As many as a map with so many wall cells calls for."""
    return min(num_walls // WALLS_PER_FEATURE, MOST_FEATURES) if num_walls >= MANY_WALLS else NUM_FEATURES


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """Keypoints of one map.

    Attributes:
        points: (N, 2) float32, x and y in cells from the grid's corner.
        angles_rad: (N,) float32, direction of the keypoint, from +x towards +y.
        descriptors: (N, 32) uint8.
    """

    points: Points
    angles_rad: npt.NDArray[np.float32]
    descriptors: Bytes

    def __len__(self) -> int:
        return len(self.points)


def detect(walls: Mask, count: int = NUM_FEATURES) -> Features:
    """The best keypoints of the blurred walls: where unknown meets free tells of the robot, not of the place."""
    image = cv2.copyMakeBorder(
        walls.astype(np.uint8) * 255, BORDER, BORDER, BORDER, BORDER, cv2.BORDER_CONSTANT, value=0
    )
    orb = cv2.ORB.create(
        nfeatures=count,
        nlevels=NUM_LEVELS,
        scaleFactor=SCALE_FACTOR,
        edgeThreshold=16,
        fastThreshold=FAST_THRESHOLD,
    )
    keypoints, descriptors = orb.detectAndCompute(cv2.sepFilter2D(image, cv2.CV_8U, _KERNEL, _KERNEL), None)
    if not keypoints:
        return Features(np.zeros((0, 2), np.float32), np.zeros(0, np.float32), np.zeros((0, 32), np.uint8))
    if len(keypoints) > MOST_FEATURES:  # of things that are all alike it keeps all
        response = np.array([k.response for k in keypoints])
        kept = np.sort(np.argsort(-response, kind="stable")[:MOST_FEATURES])
        keypoints, descriptors = [keypoints[k] for k in kept], descriptors[kept]
    points = np.asarray(cv2.KeyPoint.convert(keypoints), np.float32) - np.float32(BORDER - 0.5)
    angles = np.radians(np.array([k.angle for k in keypoints], np.float32))
    return Features(points, angles, descriptors.astype(np.uint8, copy=False))
