from __future__ import annotations

import cv2
import numpy as np
import pytest

from mapfusion.simulation.furniture import furnish
from mapfusion.simulation.plan import PLAN_RESOLUTION_M, Raster


def furnished(seed: int, corridor: bool = False) -> tuple[Raster, Raster]:
    """A room of 8 by 6 m and what was to be kept clear in it."""
    room, keep_clear = np.zeros((120, 160), np.uint8), np.zeros((120, 160), np.uint8)
    cv2.circle(keep_clear, (0, 60), 20, (1.0,), cv2.FILLED)
    furnish(room, keep_clear, corridor, np.random.default_rng(seed))
    return room, keep_clear


@pytest.mark.parametrize("seed", range(5))
def test_furniture_stands_apart_and_clear_of_doors(seed: int) -> None:
    room, keep_clear = furnished(seed)
    assert 0.005 < room.mean() < 0.3
    assert not np.any(room & keep_clear)
    num_items, labels = cv2.connectedComponents(room)
    for k in range(1, num_items):
        others = ((labels != k) & (room > 0)).astype(np.uint8)
        if others.any():
            gap = cv2.distanceTransform(1 - others, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[labels == k].min()
            assert gap * PLAN_RESOLUTION_M > 0.7


def test_middle_of_a_corridor_stays_free() -> None:
    for seed in range(5):
        room, _ = furnished(seed, corridor=True)
        assert not room[6:-6, 6:-6].any()
