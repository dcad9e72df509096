"""What real maps suffer, done to maps with known truth: noise, bending, furniture that comes and goes."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import numpy.typing as npt

from mapfusion.grid import Cells, OccupancyGrid
from mapfusion.transform import SE2

BEND_EVERY_CELLS = 150
MAX_BEND_SIGMA_CELLS = 8.0
MAX_THINGS = 11


def flipped(grid: OccupancyGrid, share: float, rng: np.random.Generator) -> OccupancyGrid:
    """A share of the known cells says the opposite."""
    flip = grid.known & (rng.random(grid.cells.shape) < share)
    return replace(grid, cells=np.where(flip, 100 - grid.cells, grid.cells).astype(np.int8))


def jittered(grid: OccupancyGrid, rng: np.random.Generator) -> OccupancyGrid:
    """Every wall cell moved by up to a cell; what it leaves is free."""
    cells = np.where(grid.walls, 0, grid.cells).astype(np.int8)
    rows, cols = np.nonzero(grid.walls)
    rows = (rows + rng.integers(-1, 2, len(rows))).clip(0, grid.height - 1)
    cols = (cols + rng.integers(-1, 2, len(cols))).clip(0, grid.width - 1)
    cells[rows, cols] = 100
    return replace(grid, cells=cells)


def noisy(one: OccupancyGrid, other: OccupancyGrid, rng: np.random.Generator) -> tuple[OccupancyGrid, OccupancyGrid]:
    """Two maps as they are, with 1 % or 3 % of their cells flipped, or jittered: 55, 15, 15 and 15 % of the pairs."""
    kind = int(rng.choice(4, p=(0.55, 0.15, 0.15, 0.15)))
    if kind == 0:
        return one, other
    if kind == 3:
        return jittered(one, rng), jittered(other, rng)
    share = (0.01, 0.03)[kind - 1]
    return flipped(one, share, rng), flipped(other, share, rng)


def bent_copy(grid: OccupancyGrid, rng: np.random.Generator) -> tuple[OccupancyGrid, SE2] | None:
    """The map bent by up to some cells, things removed and added, and the rigid transform that brings it back best.

    None where nothing of it is left.
    """
    height, width = grid.cells.shape
    nodes = max(2, max(height, width) // BEND_EVERY_CELLS + 1) + 1
    reach = rng.uniform(1.0, MAX_BEND_SIGMA_CELLS)
    bend_x, bend_y = (
        cv2.resize(
            rng.normal(size=(nodes, nodes)).astype(np.float32) * np.float32(reach),
            (width, height),
            interpolation=cv2.INTER_CUBIC,
        )
        for _ in range(2)
    )
    rows, cols = np.mgrid[:height, :width].astype(np.float32)
    furnished, border = _refurnished(grid.cells, rng), cv2.BORDER_CONSTANT
    cells = cv2.remap(
        furnished, cols + bend_x, rows + bend_y, cv2.INTER_NEAREST, borderMode=border, borderValue=-1
    ).astype(np.int8)
    bent = replace(grid, cells=cells)
    at = np.nonzero(bent.known)
    if len(at[0]) < 100:
        return None
    here = bent.centres_m(bent.known)
    moved = np.stack([bend_x[at], bend_y[at]], -1).astype(np.float64) * grid.resolution_m
    there = here + SE2(0.0, 0.0, grid.T_frame_grid.yaw_rad).apply(moved)
    return bent, _rigid(here, there)


def _refurnished(cells: Cells, rng: np.random.Generator) -> Cells:
    """Some round patches of wall gone, some boxes put in."""
    result = cells.copy()
    free = np.argwhere(cells == 0)
    for _ in range(int(rng.integers(MAX_THINGS + 1)) if len(free) else 0):
        row, col = (int(v) for v in free[rng.integers(len(free))])
        patch = np.zeros(cells.shape, np.uint8)
        size = int(rng.integers(3, 14))
        if rng.random() < 0.5:
            cv2.circle(patch, (col, row), size, 1, -1)
            result[(patch == 1) & (result == 100)] = 0
        else:
            box = cv2.boxPoints(((col, row), (size, float(rng.integers(3, 14))), float(rng.uniform(0.0, 90.0))))
            cv2.drawContours(patch, [box.astype(np.int32)], 0, 1, 1 if rng.random() < 0.5 else -1)
            result[(patch == 1) & (result >= 0)] = 100
    return result


def _rigid(here: npt.NDArray[np.float64], there: npt.NDArray[np.float64]) -> SE2:
    """The motion of points (N, 2) nearest to where they belong. Source: Kabsch 1976."""
    middle, target = here.mean(axis=0), there.mean(axis=0)
    spread = (here - middle).T @ (there - target)
    angle = math.atan2(spread[0, 1] - spread[1, 0], spread[0, 0] + spread[1, 1])
    x, y = target - SE2(0.0, 0.0, angle).apply(middle)
    return SE2(float(x), float(y), angle)
