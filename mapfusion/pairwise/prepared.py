"""Everything about one map that fusing it with any other needs."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mapfusion.grid import Mask, OccupancyGrid, crop_to_known, resample
from mapfusion.pairwise.behind import Hidden, hidden_cells
from mapfusion.pairwise.features import NUM_FEATURES, Features, detect, num_features
from mapfusion.pairwise.poses import Poses
from mapfusion.pairwise.sketch import sketch
from mapfusion.pairwise.surface import (
    DIRECTION_BINS,
    Bytes,
    Indices,
    Points,
    SurfaceField,
    disc_around,
    extract_surface,
    remove_pockets,
    remove_speckle,
    smooth_walls,
    surface_field,
    widen_free,
)

MIN_WALL_CELLS = 40
"""A map with less wall than this beside free space says nothing."""
AREA_SAMPLES = 1500
"""About so many known cells stand for the known area where areas are compared."""


@dataclass(frozen=True, eq=False)
class PreparedMap:
    """One map, ready to be compared.

    Attributes:
        grid: The map at the resolution of the comparison, cropped to what it knows.
        walls: (H, W) mask of its walls without noise, as they are: smoothed ones lose keypoints.
        field: The rim of its walls as a field; None where it has no wall beside free space.
        area: (N, 2) float32 centres of known cells on a regular raster, cells.
        cells_per_area_sample: Known cells that each of `area` stands for.
        centre: (2,) mean of the surface's points, cells.
        key: Orders maps by their content, whatever their names and frames.
    """

    grid: OccupancyGrid
    walls: Mask
    field: SurfaceField | None
    area: Points
    cells_per_area_sample: float
    centre: Poses
    key: bytes

    @property
    def num_walls(self) -> int:
        """Cells of wall beside free space."""
        return 0 if self.field is None else len(self.field.surface)

    @cached_property
    def features(self) -> Features:
        """ORB keypoints of the walls, found when they are first asked for: verifying a transform needs none."""
        return detect(self.walls)

    @cached_property
    def more_features(self) -> Features:
        """As many as its walls call for; `features` where these are."""
        count = num_features(self.num_walls)
        return self.features if count == NUM_FEATURES else detect(self.walls, count)

    @cached_property
    def coarser(self) -> PreparedMap:
        """The same map at twice the cell size."""
        return prepare(self.grid, 2.0 * self.grid.resolution_m)

    @cached_property
    def facing_bins(self) -> Indices:
        """(N,) direction that each wall of the field faces, as a whole bin; only of maps that have a field."""
        assert self.field is not None
        bins: Indices = np.floor(self.field.surface.facing + 0.5).astype(np.int32) % DIRECTION_BINS
        return bins

    @cached_property
    def sketch(self) -> Bytes:
        """(H, W) codes of the field's cells, as in `sketch`; only of maps that have a field."""
        assert self.field is not None
        return sketch(self.field)

    @cached_property
    def hidden(self) -> Hidden:
        """What its walls hide from it; only of maps that have a field."""
        assert self.field is not None
        return hidden_cells(self.field)

    @cached_property
    def _near_keypoints(self) -> dict[int, Bytes]:
        return {}

    def near_keypoints(self, radius_cells: int) -> Bytes:
        """(H, W) 1 at the cells of the field, as in SurfaceField, within `radius_cells` of a keypoint."""
        if radius_cells not in self._near_keypoints:
            discs = disc_around(self.features.points, self.grid.cells.shape, radius_cells)
            self._near_keypoints[radius_cells] = discs
        return self._near_keypoints[radius_cells]


def prepare(grid: OccupancyGrid, resolution_m: float) -> PreparedMap:
    """Brings one map to `resolution_m`, finds its features and the field of its walls' surface."""
    grid = crop_to_known(resample(grid, resolution_m))
    rough_walls, clear = grid.walls, grid.free
    walls = remove_speckle(rough_walls, grid.known)
    smooth = smooth_walls(walls, clear)
    open_space = widen_free(smooth, clear | rough_walls)
    known = grid.known | open_space
    is_noisy = walls is not rough_walls  # noise leaves islands of wall as well as of free space
    free = remove_pockets(open_space) if is_noisy else open_space
    surface = extract_surface(smooth, free)
    field = surface_field(surface, free, known) if len(surface) else None
    area, cells_per_area_sample = _raster(known)
    return PreparedMap(
        grid=grid,
        walls=walls,
        field=field,
        area=area,
        cells_per_area_sample=cells_per_area_sample,
        centre=np.zeros(2) if field is None else field.surface.points.mean(axis=0).astype(np.float64),
        key=hashlib.sha256(grid.cells.tobytes()).digest(),
    )


def _raster(known: Mask) -> tuple[Points, float]:
    num_known = int(np.count_nonzero(known))
    step = max(1, int(np.sqrt(num_known / AREA_SAMPLES)))
    rows, cols = np.nonzero(known[step // 2 :: step, step // 2 :: step])
    points = np.stack([cols, rows], -1) * step + (step // 2 + 0.5)
    return points.astype(np.float32), num_known / max(1, len(points))
