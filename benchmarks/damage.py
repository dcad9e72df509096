"""What maps suffer, done to maps with known truth: noise, bending, furniture that comes and goes, a second wing."""

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
MAX_CELLS_REPEATED = 4_000_000
MARGIN_M = 1.0


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


def repeated(
    one: OccupancyGrid, other: OccupancyGrid, T_one_other: SE2, rng: np.random.Generator
) -> tuple[OccupancyGrid, OccupancyGrid] | None:
    """Two maps of one place as maps of a place with a second wing like the first, in the first one's frame.

    The wing is the place turned by half about a point at its edge, or moved by about its length. Up to eight boxes
    that both maps show stand in one wing or the other. None where that would be too large.
    """
    r, points = one.resolution_m, one.centres_m(one.known)
    angle = rng.uniform(-math.pi, math.pi)
    along, across = np.array([math.cos(angle), math.sin(angle)]), np.array([-math.sin(angle), math.cos(angle)])
    forwards, sideways = points @ along, points @ across
    if rng.random() < 0.6:
        at = np.quantile(forwards, rng.uniform(0.9, 1.0)), np.quantile(sideways, rng.uniform(0.35, 0.65))
        centre = along * at[0] + across * at[1]
        wing = SE2(2.0 * centre[0], 2.0 * centre[1], math.pi)
    else:
        shift = along * np.ptp(forwards) * rng.uniform(0.8, 1.0)
        wing = SE2(float(shift[0]), float(shift[1]), 0.0)
    everywhere = np.concatenate([points, wing.apply(points)])
    low, high = everywhere.min(axis=0) - MARGIN_M, everywhere.max(axis=0) + MARGIN_M
    cols, rows = (math.ceil(v) for v in (high - low) / r)
    if rows * cols > MAX_CELLS_REPEATED:
        return None
    frame = SE2(float(low[0]), float(low[1]), 0.0)
    cells = []
    for grid, T in ((one, SE2.identity()), (other, T_one_other)):
        here, there = (_sampled(grid, where @ T, frame, (rows, cols)) for where in (SE2.identity(), wing))
        cells.append(np.where(here >= 0, here, there).astype(np.int8))
    free = np.argwhere((cells[0] == 0) & (cells[1] == 0))
    for _ in range(int(rng.integers(9)) if len(free) else 0):
        row, col = (int(v) for v in free[rng.integers(len(free))])
        patch = np.zeros((rows, cols), np.uint8)
        size = (float(rng.integers(4, 14)), float(rng.integers(4, 14)))
        box = cv2.boxPoints(((col, row), size, float(rng.uniform(0.0, 90.0))))
        cv2.drawContours(patch, [box.astype(np.int32)], 0, 1, 1)
        for image in cells:
            image[(patch == 1) & (image >= 0)] = 100
    first, second = (replace(one, cells=image, T_frame_grid=frame) for image in cells)
    return first, second


def _sampled(grid: OccupancyGrid, T: SE2, frame: SE2, shape: tuple[int, int]) -> Cells:
    """The map, moved by T, on a raster of `shape` at `frame`."""
    rows, cols = np.mgrid[: shape[0], : shape[1]]
    centres = (np.stack([cols.ravel(), rows.ravel()], -1) + 0.5) * grid.resolution_m
    there = (grid.T_frame_grid.inverse() @ T.inverse() @ frame).apply(centres) / grid.resolution_m
    col, row = np.floor(there).astype(np.int64).T
    inside = (col >= 0) & (row >= 0) & (col < grid.width) & (row < grid.height)
    cells: Cells = np.full(len(centres), -1, np.int8)
    cells[inside] = grid.cells[row[inside], col[inside]]
    return cells.reshape(shape)


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
