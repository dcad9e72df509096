"""How far the agreement of two maps lies above what chance would give.

For a tolerance, n points of one map's walls fall into the area that the other map knows, a share r of them within
the tolerance of a wall seen from the same side; a point put there at random would meet one with probability p.
The evidence of this direction is n KL(r || p) / c, with c the length over which neighbouring wall cells are not
independent (Chernoff's bound on the tail of the binomial distribution). Both directions must speak for a pose: their
geometric mean counts. Walls that stand in the other map's free space speak against it: with x times as many as by
chance, (1 - x)^2 of the evidence is left.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from mapfusion.pairwise.poses import Poses, inverse, moved
from mapfusion.pairwise.prepared import PreparedMap
from mapfusion.pairwise.refine import SAME_SIDE_COSINE, encounters
from mapfusion.pairwise.surface import DIRECTION_BINS, NOT_KNOWN, Floats, Indices, Surface

TOLERANCES_CELLS = (1.5, 3.0, 6.0)
DEPENDENT_CELLS = 12.0
"""Length of wall over which neighbouring cells agree or disagree together, an estimate."""
MIN_EVIDENCE = 20.0
"""Net evidence below which agreement is no better than what a search finds between any two maps."""
DEEP_TOLERANCES = 2.0
"""A wall this many tolerances inside the other map's free space contradicts it."""
MIN_DEEP_CHANCE = 0.2
"""Where hardly any free space is wide enough to be deep, contradictions are counted against this share."""
_SQUARED_TOLERANCES = np.square(np.array(TOLERANCES_CELLS, np.float32))[:, None, None]
_FAR = DEEP_TOLERANCES * np.array(TOLERANCES_CELLS)[:, None, None]
_DEPTHS, _SQUARED_FAR = _FAR.astype(np.uint8), np.square(_FAR).astype(np.float32)
_BIN_ANGLES = np.arange(DIRECTION_BINS) * (2.0 * np.pi / DIRECTION_BINS)
FACING_ALIKE = (np.cos(_BIN_ANGLES[:, None] - _BIN_ANGLES) > SAME_SIDE_COSINE - 1e-6).astype(np.float64)
"""Which bins of direction count as the same side."""
Figures = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What speaks for and against each of K poses; arrays are (K,).

    Attributes:
        net: Evidence against chance of both directions, less what contradicts; at the tolerance where it is highest.
        tolerance_cells: The tolerance.
        ratio: Share of the walls in the mutual area that agree.
        chance: Share that would agree by chance.
        contradiction: Walls deep in the other map's free space / those that would be by chance.
        num_walls: Wall cells in the mutual area, of both maps.
        mutual_cells: Cells known in both.
        mutual_ratio: The same / known cells of the smaller map.
        conditioning: Smallest / largest eigenvalue of what the agreeing walls say about the translation, [0, 1].
        residual_cells: Root mean square distance of the agreeing points from their walls, cells.
    """

    net: Figures
    tolerance_cells: Figures
    ratio: Figures
    chance: Figures
    contradiction: Figures
    num_walls: Figures
    mutual_cells: Figures
    mutual_ratio: Figures
    conditioning: Figures
    residual_cells: Figures

    def of(self, index: int) -> dict[str, float]:
        """The figures of one pose by name."""
        return {f.name: float(getattr(self, f.name)[index]) for f in fields(self)}

    def joined(self, other: Evidence) -> Evidence:
        """This evidence followed by that for other poses."""
        return Evidence(*(np.concatenate([getattr(self, f.name), getattr(other, f.name)]) for f in fields(self)))


@dataclass(frozen=True, slots=True, eq=False)
class _Direction:
    """One direction, (K,) or (K, T) for T tolerances: what the points of one map meet in the field of the other.

    Attributes:
        n: Wall cells in the mutual area.
        agreeing: (K, T) of them agree.
        chance: (K, T) share of them that would by chance.
        deep: (K, T) of them stand deep in free space.
        deep_chance: (K, T) share of them that would by chance.
        mutual: Cells known in both.
        squares: Sum of the squared gaps of the points that agree within the widest tolerance.
        scatter: (K, 2, 2) sum of n n^T over the normals of the agreeing walls.
    """

    n: Figures
    agreeing: Figures
    chance: Figures
    deep: Figures
    deep_chance: Figures
    mutual: Figures
    squares: Figures
    scatter: Figures


def weigh(target: PreparedMap, source: PreparedMap, poses: Poses, num_points: int) -> Evidence:
    """The evidence for poses (K, 3) of `source` in `target`; both need a surface."""
    assert target.field is not None
    assert source.field is not None
    forward = _direction(target, source, poses, num_points)
    backward = _direction(source, target, inverse(poses), num_points)
    n = forward.n + backward.n
    safe = np.maximum(n, 1.0)[:, None]
    both = forward, backward
    each = against_chance(
        np.stack([d.n for d in both])[..., None],
        np.stack([d.agreeing for d in both]),
        np.stack([d.chance for d in both]),
    )
    total = 2.0 * np.sqrt(each[0] * each[1])
    deep_chance = _pooled(forward.deep_chance, backward.deep_chance, forward.n, backward.n)
    contradiction = (forward.deep + backward.deep) / safe / np.maximum(deep_chance, MIN_DEEP_CHANCE)
    net = discounted(total, contradiction)
    at = np.arange(len(poses)), net.argmax(axis=-1)
    agreeing = forward.agreeing + backward.agreeing
    mutual = (forward.mutual + backward.mutual) / 2.0
    known = min(len(m.area) * m.cells_per_area_sample for m in (target, source))
    # The backward normals are seen from the source; eigenvalues do not mind.
    fixed = np.linalg.eigvalsh(np.stack([d.scatter for d in both])).sum(axis=0)
    return Evidence(
        net=net[at],
        tolerance_cells=np.asarray(TOLERANCES_CELLS)[at[1]],
        ratio=(agreeing / safe)[at],
        chance=_pooled(forward.chance, backward.chance, forward.n, backward.n)[at],
        contradiction=contradiction[at],
        num_walls=n,
        mutual_cells=mutual,
        mutual_ratio=mutual / max(known, 1.0),
        conditioning=np.maximum(fixed[:, 0], 0.0) / np.maximum(fixed[:, 1], 1e-9),
        residual_cells=np.sqrt((forward.squares + backward.squares) / np.maximum(agreeing[:, -1], 1.0)),
    )


def _pooled(forward: Figures, backward: Figures, n_forward: Figures, n_backward: Figures) -> Figures:
    """Mean of two (K, T) shares, weighted by the (K,) counts they belong to."""
    weight = n_forward / np.maximum(n_forward + n_backward, 1.0)
    mean: Figures = forward * weight[:, None] + backward * (1.0 - weight[:, None])
    return mean


def against_chance(n: Figures, agreeing: Figures, chance: Figures) -> Figures:
    """n KL(agreeing / n || chance) / DEPENDENT_CELLS where there is more agreement than by chance, else 0."""
    n = np.maximum(n, 1.0)
    p = np.clip(chance, 0.5 / n, 1.0 - 1e-3)
    r = np.clip(agreeing / n, 1e-9, 1.0 - 1e-9)
    divergence = r * np.log(r / p) + (1.0 - r) * np.log((1.0 - r) / (1.0 - p))
    evidence: Figures = np.where(r > p, n * np.maximum(divergence, 0.0), 0.0) / DEPENDENT_CELLS
    return evidence


def discounted(evidence: Figures, contradiction: Figures) -> Figures:
    """What contradictions leave of the evidence; none where there are as many as by chance."""
    result: Figures = evidence * np.square(np.maximum(1.0 - contradiction, 0.0))
    return result


def _direction(there: PreparedMap, here: PreparedMap, poses: Poses, num_points: int) -> _Direction:
    """What the walls of `here` meet in `there` under poses (K, 3); masks are (T, K, N) for T tolerances."""
    assert there.field is not None
    assert here.field is not None
    field = there.field
    surface = here.field.surface.thinned(num_points)
    scale = len(here.field.surface) / len(surface)
    found = encounters(field, surface, poses)
    depth = field.depth.ravel().take(found.cells)
    known = depth != NOT_KNOWN
    agrees = (known & found.same_side) & (found.squared <= _SQUARED_TOLERANCES)
    deep = known & (depth > _DEPTHS) & (found.squared > _SQUARED_FAR)

    area = moved(poses, here.area)
    area_cells = field.cells_below(area)
    area_depth = field.depth.ravel().take(area_cells)
    area_known = area_depth != NOT_KNOWN
    hit = field.nearest.ravel().take(area_cells)
    wall = field.walls[:2].take(hit, axis=1)
    squared = np.square(area[:, 0] - wall[0]) + np.square(area[:, 1] - wall[1])
    near = area_known & (squared <= _SQUARED_TOLERANCES)
    area_deep = area_known & (area_depth > _DEPTHS) & (squared > _SQUARED_FAR)
    num_area = np.maximum(area_known.sum(axis=-1), 1)
    alike = _chance_of_same_side(there.facing_bins.take(hit), near[-1], surface, poses, known)

    return _Direction(
        n=known.sum(axis=-1) * scale,
        agreeing=agrees.sum(axis=-1).T * scale,
        chance=near.sum(axis=-1).T * (alike / num_area)[:, None],
        deep=deep.sum(axis=-1).T * scale,
        deep_chance=area_deep.sum(axis=-1).T / num_area[:, None],
        mutual=area_known.sum(axis=-1) * here.cells_per_area_sample,
        squares=(np.square(found.gap) * agrees[-1]).sum(axis=-1) * scale,
        scatter=_second_moment(found.lines, agrees[1].astype(np.float32)) * scale,
    )


def _chance_of_same_side(
    hit_bins: Indices,
    near: npt.NDArray[np.bool_],
    here: Surface,
    poses: Poses,
    known: npt.NDArray[np.bool_],
) -> Figures:
    """(K,) probability that a wall of the mutual area and the wall near a random cell of it face alike.

    Args:
        hit_bins: (K, A) direction of one map's wall that is nearest to each cell of the mutual area, as a whole bin.
        near: (K, A) which of those cells are near it.
        here: N walls of the other map.
        poses: (K, 3).
        known: (K, N) which of `here` lie in the mutual area.
    """
    turns = poses[:, 2, None] * (DIRECTION_BINS / (2.0 * np.pi))
    source_bins = np.floor(here.facing() + (turns + 0.5)).astype(np.int32) % DIRECTION_BINS
    target_share = _histograms(hit_bins, near)
    source_share = _histograms(source_bins, known)
    result: Figures = ((target_share @ FACING_ALIKE) * source_share).sum(axis=-1)
    return result


def _histograms(bins: Indices, mask: npt.NDArray[np.bool_]) -> Figures:
    """(K, DIRECTION_BINS) shares of the masked (K, N) bins."""
    rows = len(mask)
    at = bins + np.arange(rows, dtype=np.int32)[:, None] * DIRECTION_BINS
    counts = np.bincount(at[mask], minlength=rows * DIRECTION_BINS).reshape(rows, DIRECTION_BINS)
    shares: Figures = counts / np.maximum(counts.sum(axis=-1, keepdims=True), 1)
    return shares


def _second_moment(vectors: Floats, weight: Floats) -> Figures:
    """(K, 2, 2) sum of weight v v^T over (K, 2, N) vectors."""
    return ((vectors * weight[:, None]) @ vectors.transpose(0, 2, 1)).astype(np.float64)
