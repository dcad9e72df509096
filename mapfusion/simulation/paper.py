"""The random maps of Zick et al. 2025 (section 3.2), their patches, and the exact transform between two patches.

Source: Zick, Martinelli, Schneider de Oliveira, Cremer Kalempa: ORB-Based Map Fusion with Position Transformation for
Enhanced Pairwise Connection, SCITEPRESS 2025; ranges and order of the draws as in its published program. A seed of
Python's `random` gives the map that the program gives for it.

Two conventions meet here. An image has row 0 on top, (x, y) = (column, row), y down. A grid has row 0 at its origin
and y up. A patch becomes a grid by turning the rows over, as map_server does, so both look alike on a screen; an angle
in the image is then the negative angle in the grid.
"""

from __future__ import annotations

import random
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from mapfusion.grid import Mask, OccupancyGrid
from mapfusion.transform import SE2, FloatArray

MAP_SIZE = 550
"""Edge length of a generated map in the paper's experiments, pixels."""
PATCH_EDGE = (250, 400)
"""Least and greatest edge length of a patch, pixels, both included."""

Image = npt.NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """A part of a generated map, cut out after the whole map was turned.

    Attributes:
        image: (rows, cols) uint8, 0 free and 1 obstacle, row 0 on top. Read-only.
        inside: (rows, cols) mask of the pixels that show the generated map and not what lies beyond it (0 there).
        T_patch_map_px: (3, 3) takes pixel coordinates (x, y) of the generated map to those of the patch; rigid.
    """

    image: Image
    inside: Mask
    T_patch_map_px: FloatArray

    def __post_init__(self) -> None:
        for array in (self.image, self.inside, self.T_patch_map_px):
            array.flags.writeable = False


@dataclass(frozen=True, slots=True, eq=False)
class PatchPair:
    """Two patches as grids, with the truth.

    Attributes:
        target: First patch, its corner at the origin of its own frame, axes parallel.
        source: Second patch, likewise.
        T_target_source: The exact transform between the two frames; None where the patches show different maps.
        overlap_ratio: Map area in both patches / map area in the smaller one; 0 where they show different maps.
    """

    target: OccupancyGrid
    source: OccupancyGrid
    T_target_source: SE2 | None
    overlap_ratio: float


def random_map(rng: random.Random, size: int = MAP_SIZE) -> Image:
    """A (size, size) map, 0 free and 1 obstacle, row 0 on top."""
    image = np.zeros((size, size), np.uint8)
    for _ in range(rng.randint(1, 4)):
        side = rng.randint(size // 10, size // 5)
        x, y = rng.randint(0, size - side), rng.randint(0, size - side)
        _paint_rectangle(image, x, y, side, side, rng.randint(0, 360))
    for _ in range(rng.randint(6, 12)):
        width = rng.randint(5, 10)
        x, y = rng.randint(0, size - width), rng.randint(0, size - width)
        angle_deg = rng.randint(0, 360)
        vertical = rng.choice([True, False])
        _paint_rectangle(image, x, y, width if vertical else size, size if vertical else width, angle_deg)
    for _ in range(rng.randint(15, 30)):
        side = rng.randint(10, 20)
        x, y = rng.randint(0, size - side), rng.randint(0, size - side)
        _paint_rectangle(image, x, y, side, side, rng.randint(0, 360))
    for _ in range(rng.randint(5, 10)):
        shape = rng.choice(["circle", "ellipse"])
        x, y = rng.randint(10, size - 10), rng.randint(10, size - 10)
        if shape == "circle":
            _paint_circle(image, x, y, rng.randint(5, 15))
        else:
            _paint_ellipse(image, x, y, rng.randint(10, 20), rng.randint(5, 15), rng.randint(0, 360))
    return image


def random_patch(rng: random.Random, image: Image) -> Patch:
    """A patch of a generated map of at least 400 x 400 pixels, turned by whole degrees."""
    size = image.shape[0]
    rows, cols, angle_deg = rng.randint(*PATCH_EDGE), rng.randint(*PATCH_EDGE), rng.randint(0, 360)
    top, left = rng.randint(0, size - rows), rng.randint(0, size - cols)
    rotation = cv2.getRotationMatrix2D((size // 2, size // 2), angle_deg, 1.0)
    crop = slice(top, top + rows), slice(left, left + cols)
    turned = cv2.warpAffine(image, rotation, (size, size))
    inside = cv2.warpAffine(np.full_like(image, 255), rotation, (size, size))
    T_patch_map_px = np.array([[1.0, 0.0, -left], [0.0, 1.0, -top], [0.0, 0.0, 1.0]]) @ np.vstack([rotation, [0, 0, 1]])
    return Patch(np.ascontiguousarray(turned[crop], np.uint8), inside[crop] > 127, T_patch_map_px)


def positive_pair(seed: int, size: int = MAP_SIZE, resolution_m: float = 0.05) -> PatchPair:
    """Two patches of one map, with the truth."""
    rng = random.Random(seed)
    image = random_map(rng, size)
    target, source = random_patch(rng, image), random_patch(rng, image)
    T_target_source_px = target.T_patch_map_px @ np.linalg.inv(source.T_patch_map_px)
    target_frame = _frame_from_pixels(target.image.shape[0], resolution_m)
    source_frame = _frame_from_pixels(source.image.shape[0], resolution_m)
    return PatchPair(
        patch_grid(target, resolution_m, "target"),
        patch_grid(source, resolution_m, "source"),
        SE2.from_matrix(target_frame @ T_target_source_px @ np.linalg.inv(source_frame)),
        _overlap_ratio(target, source, T_target_source_px),
    )


def negative_pair(seed: int, size: int = MAP_SIZE, resolution_m: float = 0.05) -> PatchPair:
    """Patches of two different maps."""
    rng = random.Random(seed)
    target = random_patch(rng, random_map(rng, size))
    source = random_patch(rng, random_map(rng, size))
    return PatchPair(patch_grid(target, resolution_m, "target"), patch_grid(source, resolution_m, "source"), None, 0.0)


def patch_grid(patch: Patch, resolution_m: float, frame_id: str = "", T_frame_grid: SE2 | None = None) -> OccupancyGrid:
    """The patch as a grid, 0 and 100, its rows turned over; no cell is unknown, as in the paper."""
    cells = np.where(patch.image[::-1] > 0, 100, 0).astype(np.int8)
    return OccupancyGrid(cells, resolution_m, T_frame_grid or SE2.identity(), frame_id)


def pose_in_map(patch: Patch, resolution_m: float, size: int = MAP_SIZE) -> SE2:
    """`T_map_grid`: pose of a patch's grid in the generated map, as a grid with its corner at the origin."""
    world, grid = _frame_from_pixels(size, resolution_m), _frame_from_pixels(patch.image.shape[0], resolution_m)
    return SE2.from_matrix(world @ np.linalg.inv(patch.T_patch_map_px) @ np.linalg.inv(grid))


def _frame_from_pixels(rows: int, resolution_m: float) -> FloatArray:
    """(3, 3) from pixel coordinates (whole numbers at pixel centres, y down) to metres from the lower left corner."""
    r = resolution_m
    return np.array([[r, 0.0, 0.5 * r], [0.0, -r, (rows - 0.5) * r], [0.0, 0.0, 1.0]])


def _overlap_ratio(target: Patch, source: Patch, T_target_source_px: FloatArray) -> float:
    rows, cols = target.image.shape
    shown = cv2.warpAffine(source.inside.astype(np.uint8) * 255, T_target_source_px[:2], (cols, rows)) > 127
    smaller = min(np.count_nonzero(target.inside), np.count_nonzero(source.inside))
    return float(np.count_nonzero(shown & target.inside) / smaller)


def _paint_rectangle(image: Image, x: int, y: int, width: int, height: int, angle_deg: int) -> None:
    corners = np.array([(x, y), (x + width, y), (x + width, y + height), (x, y + height)], float)
    if angle_deg != 0:
        rotation = cv2.getRotationMatrix2D((x + width / 2, y + height / 2), angle_deg, 1.0)
        corners = corners @ rotation[:, :2].T + rotation[:, 2]
    # Clipping each coordinate bends shapes at the border; the published program does so, and it shapes its maps.
    clipped = np.clip(np.round(corners), 0, image.shape[0] - 1).astype(np.int32)
    cv2.fillConvexPoly(image, clipped, (1.0,))


def _paint_circle(image: Image, x: int, y: int, radius: int) -> None:
    rows, cols = np.ogrid[: image.shape[0], : image.shape[1]]
    image[(cols - x) ** 2 + (rows - y) ** 2 <= radius**2] = 1


def _paint_ellipse(image: Image, x: int, y: int, radius_x: int, radius_y: int, angle_deg: int) -> None:
    rows, cols = np.ogrid[: image.shape[0], : image.shape[1]]
    mask = ((cols - x) ** 2 / radius_x**2 + (rows - y) ** 2 / radius_y**2 <= 1).astype(np.uint8)
    # Turned on the map's own canvas: what lay beyond the border is already lost, as in the published program.
    rotation = cv2.getRotationMatrix2D((x, y), angle_deg, 1.0)
    np.maximum(image, cv2.warpAffine(mask, rotation, image.shape[::-1]), out=image)
