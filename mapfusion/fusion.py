"""Fusing two maps: one call, whatever the profile."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Generic, TypeVar

from mapfusion.config import FusionConfig
from mapfusion.grid import OccupancyGrid
from mapfusion.pairwise import default, paper
from mapfusion.result import PairFusion
from mapfusion.transform import SE2

PreparedT = TypeVar("PreparedT")


def fuse_pair(target: OccupancyGrid, source: OccupancyGrid, config: FusionConfig | None = None) -> PairFusion:
    """Looks for the transform between two maps whose frames are unknown to each other, and judges it.

    Args:
        target: Map into whose frame the source is to be brought.
        source: The other map.
        config: Profile, thresholds and seed; the defaults where None.

    Returns:
        The verdict with its evidence; the same inputs give the same result.
    """
    return PairFuser(config or FusionConfig()).fuse(target, source)


class PairFuser:
    """Fuses pairs and keeps what was worked out about each map, so that its features are detected once."""

    def __init__(self, config: FusionConfig) -> None:
        self._config = config
        self._paper_maps = _Prepared(paper.prepare)
        self._default_maps = _Prepared(default.prepare)

    def fuse(self, target: OccupancyGrid, source: OccupancyGrid, is_thorough: bool = True) -> PairFusion:
        """As `fuse_pair`; unless it is to be thorough, what a quick search does not find is not found."""
        resolution_m = max(target.resolution_m, source.resolution_m)
        if self._config.profile == "paper":
            maps = self._paper_maps
            return paper.fuse(maps.of(target, resolution_m), maps.of(source, resolution_m), self._config)
        prepared = self._default_maps
        maps_there = prepared.of(target, resolution_m), prepared.of(source, resolution_m)
        return default.fuse(*maps_there, self._config, is_thorough)

    def verify(self, target: OccupancyGrid, source: OccupancyGrid, T_target_source: SE2) -> PairFusion:
        """Judges a transform that is known from before, without looking for another one."""
        resolution_m = max(target.resolution_m, source.resolution_m)
        if self._config.profile == "paper":
            maps = self._paper_maps
            return paper.verify(
                maps.of(target, resolution_m), maps.of(source, resolution_m), T_target_source, self._config
            )
        prepared = self._default_maps
        return default.verify(
            prepared.of(target, resolution_m), prepared.of(source, resolution_m), T_target_source, self._config
        )

    def forget_all_but(self, grids: Iterable[OccupancyGrid]) -> None:
        """Drops what was worked out about maps that are no longer in use."""
        kept = frozenset(grids)
        self._paper_maps.forget_all_but(kept)
        self._default_maps.forget_all_but(kept)


class _Prepared(Generic[PreparedT]):
    """What was worked out about maps, by grid and cell size."""

    def __init__(self, prepare: Callable[[OccupancyGrid, float], PreparedT]) -> None:
        self._prepare = prepare
        self._by_grid: dict[tuple[OccupancyGrid, float], PreparedT] = {}

    def of(self, grid: OccupancyGrid, resolution_m: float) -> PreparedT:
        key = (grid, resolution_m)
        if key not in self._by_grid:
            self._by_grid[key] = self._prepare(grid, resolution_m)
        return self._by_grid[key]

    def forget_all_but(self, grids: frozenset[OccupancyGrid]) -> None:
        self._by_grid = {key: prepared for key, prepared in self._by_grid.items() if key[0] in grids}
