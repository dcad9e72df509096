"""A transform tree over time, with the meaning that tf2 gives it."""

from __future__ import annotations

from array import array
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from mapfusion.grid import Mask
from mapfusion.steps import StampArray
from mapfusion.transform import FloatArray

_Link = tuple[str, str]
MAX_DEPTH = 64
"""Longest way up from a frame that is followed; real trees are less than 20 deep."""


@dataclass(frozen=True, slots=True, eq=False)
class Edge:
    """Samples of `T_parent_child` over time.

    Attributes:
        stamps_ns: (N,) strictly ascending; empty for a static edge.
        translations_m: (N, 3), or (1, 3) for a static edge.
        quats_xyzw: (N, 4) of norm 1, or (1, 4) for a static edge.
    """

    stamps_ns: StampArray
    translations_m: FloatArray
    quats_xyzw: FloatArray

    @property
    def is_static(self) -> bool:
        """Whether the edge holds at every time."""
        return self.stamps_ns.size == 0

    def at(self, stamps_ns: StampArray) -> tuple[FloatArray, FloatArray]:
        """(M, 3) translations by lerp and (M, 4) quaternions by slerp; NaN outside the samples.

        Source: tf2 `TimeCache::getData`: interpolation between the two neighbours, no extrapolation.
        """
        count = stamps_ns.size
        if self.is_static:
            return np.repeat(self.translations_m, count, axis=0), np.repeat(self.quats_xyzw, count, axis=0)
        after = np.searchsorted(self.stamps_ns, stamps_ns, side="left").clip(0, self.stamps_ns.size - 1)
        exact = self.stamps_ns[after] == stamps_ns
        before = np.where(exact, after, (after - 1).clip(0))
        span = self.stamps_ns[after] - self.stamps_ns[before]
        ratio = np.where(span > 0, (stamps_ns - self.stamps_ns[before]) / np.maximum(span, 1), 0.0)[:, None]
        translations = self.translations_m[before] * (1.0 - ratio) + self.translations_m[after] * ratio
        quats = _slerp(self.quats_xyzw[before], self.quats_xyzw[after], ratio)
        outside = (stamps_ns < self.stamps_ns[0]) | (stamps_ns > self.stamps_ns[-1])
        translations[outside] = np.nan
        quats[outside] = np.nan
        return translations, quats


@dataclass(slots=True)
class _Samples:
    """What was heard of one edge, in the order of arrival; `values` holds translation and quaternion, 7 a sample."""

    stamps_ns: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))
    is_static: bool = False


class TransformBuffer:
    """Collects transforms in any order and resolves chains of frames.

    A child that was published under several parents keeps them all; a chain takes the shortest way, at equal length
    over the edges with the most samples. Loops are never followed.
    """

    def __init__(self) -> None:
        self._samples: dict[str, dict[str, _Samples]] = defaultdict(lambda: defaultdict(_Samples))

    def add(
        self,
        parent: str,
        child: str,
        stamp_ns: int,
        translation_m: Iterable[float],
        quat_xyzw: Iterable[float],
        is_static: bool = False,
    ) -> None:
        """Adds a sample of `T_parent_child`; of several with one stamp, or of several static ones, the last counts."""
        samples = self._samples[child][parent]
        samples.is_static |= is_static
        samples.stamps_ns.append(stamp_ns)
        samples.values.extend(translation_m)
        samples.values.extend(quat_xyzw)

    def absorb(self, other: TransformBuffer, rename: Callable[[str], str], shift_ns: int = 0) -> None:
        """Adds all of another buffer's samples under other frame names, moved in time."""
        for child, parents in other._samples.items():
            for parent, heard in parents.items():
                samples = self._samples[rename(child)][rename(parent)]
                samples.is_static |= heard.is_static
                samples.stamps_ns.extend(stamp_ns + shift_ns for stamp_ns in heard.stamps_ns)
                samples.values.extend(heard.values)

    def keep(self, holds: Callable[[StampArray], Mask]) -> int:
        """Drops the samples of moving edges whose stamps (N,) do not hold, and tells how many those were."""
        num_dropped = 0
        for child, parents in list(self._samples.items()):
            for parent, samples in list(parents.items()):
                if samples.is_static:
                    continue
                kept = holds(np.array(samples.stamps_ns, np.int64))
                if kept.all():
                    continue
                num_dropped += int(kept.size - kept.sum())
                if kept.any():
                    values = np.array(samples.values).reshape(-1, 7)[kept]
                    stamps = np.array(samples.stamps_ns, np.int64)[kept]
                    parents[parent] = _Samples(array("q", stamps.tolist()), array("d", values.ravel().tolist()))
                else:
                    del parents[parent]
            if not parents:
                del self._samples[child]
        return num_dropped

    @property
    def range_ns(self) -> tuple[int, int] | None:
        """First and last stamp of all moving edges, None where there is none."""
        moving = [
            np.array(samples.stamps_ns, np.int64)
            for parents in self._samples.values()
            for samples in parents.values()
            if not samples.is_static
        ]
        return (int(min(map(np.min, moving))), int(max(map(np.max, moving)))) if moving else None

    @property
    def frames(self) -> frozenset[str]:
        """Every frame that was named."""
        return frozenset(self._samples) | {parent for parents in self._samples.values() for parent in parents}

    def parents(self, child: str) -> tuple[str, ...]:
        """Parents under which a frame was published, the one with the most samples first."""
        found = self._samples.get(child, {})
        return tuple(sorted(found, key=lambda parent: (-len(found[parent].stamps_ns), parent)))

    def chain(self, target: str, source: str) -> TransformChain | None:
        """The way from `source` up to a common ancestor and down to `target`, or None where they are not connected."""
        ways = self._ways(target, source)
        if ways is None:
            return None
        return TransformChain(*(tuple(self._edge(parent, child) for parent, child in way) for way in ways))

    def are_connected(self, target: str, source: str) -> bool:
        """Whether there is a chain between two frames."""
        return self._ways(target, source) is not None

    def _ways(self, target: str, source: str) -> tuple[list[_Link], list[_Link]] | None:
        """(parent, child) links from the target and from the source up to where they meet."""
        from_target, from_source = self._ancestors(target), self._ancestors(source)
        common = [frame for frame in from_source if frame in from_target]
        if not common:
            return None
        shortest = min(from_source[frame][0] + from_target[frame][0] for frame in common)
        ways = [
            (_way_up(from_target, frame), _way_up(from_source, frame))
            for frame in common
            if from_source[frame][0] + from_target[frame][0] == shortest
        ]
        return max(ways, key=lambda way: min((self._num_samples(link) for link in (*way[0], *way[1])), default=0))

    def _num_samples(self, link: _Link) -> int:
        parent, child = link
        return len(self._samples[child][parent].stamps_ns)

    def _ancestors(self, frame: str) -> dict[str, tuple[int, str]]:
        """Every frame above `frame` (itself included): how far up it is, and the frame below it on the way there."""
        found = {frame: (0, "")}
        queue = [frame]
        for child in queue:  # breadth first; the queue grows while it is walked
            depth = found[child][0] + 1
            for parent in self.parents(child) if depth <= MAX_DEPTH else ():
                if parent not in found:
                    found[parent] = (depth, child)
                    queue.append(parent)
        return found

    def _edge(self, parent: str, child: str) -> Edge:
        samples = self._samples[child][parent]
        values = np.array(samples.values).reshape(-1, 7)
        stamps: StampArray = np.array(samples.stamps_ns, np.int64)
        if samples.is_static:
            stamps, values = stamps[:0], values[-1:]
        else:
            order = np.argsort(stamps, kind="stable")
            last_of_stamp = np.append(np.diff(stamps[order]) > 0, True)
            order = order[last_of_stamp]
            stamps, values = stamps[order], values[order]
        quats = values[:, 3:]
        return Edge(stamps, values[:, :3], quats / np.linalg.norm(quats, axis=1, keepdims=True))


@dataclass(frozen=True, slots=True, eq=False)
class TransformChain:
    """`T_target_source` over time, through a common ancestor of both frames; a `PoseSource`.

    Attributes:
        down: Edges between the ancestor and the target, the target's own first.
        up: Edges between the ancestor and the source, the source's own first.
    """

    down: tuple[Edge, ...]
    up: tuple[Edge, ...]

    @property
    def stamps_ns(self) -> StampArray:
        """(N,) times at which an edge of the chain was measured and all of them reach."""
        dynamic = [edge.stamps_ns for edge in (*self.down, *self.up) if not edge.is_static]
        if not dynamic:
            return np.empty(0, np.int64)
        first, last = max(stamps[0] for stamps in dynamic), min(stamps[-1] for stamps in dynamic)
        stamps: StampArray = np.unique(np.concatenate(dynamic))
        inside: StampArray = stamps[(stamps >= first) & (stamps <= last)]
        return inside

    def poses_at(self, stamps_ns: StampArray) -> FloatArray:
        """(M, 3) of x_m, y_m, yaw_rad of the source frame in the target frame; NaN where an edge does not reach."""
        t_up, q_up = _compose(self.up, stamps_ns)
        t_down, q_down = _compose(self.down, stamps_ns)
        q_inverse = q_down * np.array([-1.0, -1.0, -1.0, 1.0])
        t = _rotate(q_inverse, t_up - t_down)
        x, y, z, w = _multiply(q_inverse, q_up).T
        yaw = np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
        return np.stack([t[:, 0], t[:, 1], yaw], axis=1)


def _way_up(ancestors: Mapping[str, tuple[int, str]], top: str) -> list[_Link]:
    """The (parent, child) links from the frame at the bottom up to `top`, the lowest first."""
    links: list[_Link] = []
    while ancestors[top][0]:
        below = ancestors[top][1]
        links.append((top, below))
        top = below
    return links[::-1]


def _compose(edges: tuple[Edge, ...], stamps_ns: StampArray) -> tuple[FloatArray, FloatArray]:
    """T_ancestor_frame (M, 3), (M, 4) of edges that lead from a frame up to its ancestor."""
    t = np.zeros((stamps_ns.size, 3))
    q = np.tile(np.array([0.0, 0.0, 0.0, 1.0]), (stamps_ns.size, 1))
    for edge in edges:
        t_edge, q_edge = edge.at(stamps_ns)
        t = _rotate(q_edge, t) + t_edge
        q = _multiply(q_edge, q)
    return t, q


def _multiply(a: FloatArray, b: FloatArray) -> FloatArray:
    """Hamilton products (M, 4) of quaternions in x, y, z, w order."""
    ax, ay, az, aw = a.T
    bx, by, bz, bw = b.T
    return np.stack(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ],
        axis=1,
    )


def _rotate(q: FloatArray, v: FloatArray) -> FloatArray:
    """Vectors (M, 3) rotated by quaternions (M, 4) of norm 1."""
    u, w = q[:, :3], q[:, 3:]
    twice_cross = 2.0 * np.cross(u, v)
    rotated: FloatArray = v + w * twice_cross + np.cross(u, twice_cross)
    return rotated


def _slerp(a: FloatArray, b: FloatArray, ratio: FloatArray) -> FloatArray:
    """Spherical interpolation (M, 4) along the shorter arc; `ratio` is (M, 1) in [0, 1].

    Source: Shoemake, Animating rotation with quaternion curves, SIGGRAPH 1985.
    """
    dot: npt.NDArray[np.float64] = np.sum(a * b, axis=1, keepdims=True)
    b = np.where(dot < 0.0, -b, b)
    angle = np.arccos(np.abs(dot).clip(0.0, 1.0))
    sine = np.sin(angle)
    near = sine < 1e-9
    safe = np.where(near, 1.0, sine)
    weight_a = np.where(near, 1.0 - ratio, np.sin((1.0 - ratio) * angle) / safe)
    weight_b = np.where(near, ratio, np.sin(ratio * angle) / safe)
    return weight_a * a + weight_b * b
