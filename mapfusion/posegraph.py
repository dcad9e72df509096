"""One placement of many robots from their pairwise transforms, of which some may be false."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from mapfusion.steps import natural_key
from mapfusion.transform import SE2, FloatArray, wrap_angle

Pair = tuple[str, str]

TOLERANCE_M, TOLERANCE_RAD = 0.3, math.radians(1.5)
"""A cycle of transforms is consistent when it closes within this, and within half of it more for every further edge."""
FLOOR_M, FLOOR_RAD = 0.03, math.radians(0.2)
"""No transform is held to be better than this: maps bend."""
MAX_ITERATIONS = 20
CONVERGED = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Edge:
    """A measured transform between two robots' maps.

    Attributes:
        T_a_b: Takes points of b's map frame to a's.
        confidence: [0, 1]; decides between edges that contradict each other and nothing else speaks.
        covariance: (3, 3) of (x_m, y_m, yaw_rad) of `T_a_b` in a's frame; None where it is not known.
        centre_b_m: (2,) middle of b's known area in b's frame: errors are judged there, for a map may lie far from the
            origin of its frame.
        is_fixed: Whether the edge holds whatever the others say.
    """

    T_a_b: SE2
    confidence: float
    covariance: FloatArray | None = None
    centre_b_m: FloatArray = field(default_factory=lambda: np.zeros(2))
    is_fixed: bool = False


class Misfit(NamedTuple):
    """How far an edge is from the placements, at the middle of b's area."""

    distance_m: float
    angle_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Placements of tied robots.

    Attributes:
        T_reference_robot: Pose of every robot's map frame in the reference's.
        dropped: Edges that contradict the others, with their misfit.
    """

    T_reference_robot: Mapping[str, SE2]
    dropped: Mapping[Pair, Misfit]


def components(pairs: Sequence[Pair]) -> list[tuple[str, ...]]:
    """Robots that pairs tie to each other; members and components in natural order."""
    component: dict[str, set[str]] = {}
    for a, b in pairs:
        merged = component.get(a, {a}) | component.get(b, {b})
        for robot in merged:
            component[robot] = merged
    members = {tuple(sorted(robots, key=natural_key)) for robots in component.values()}
    return sorted(members, key=lambda robots: [natural_key(robot) for robot in robots])


def separated(
    edges: Mapping[Pair, Edge], never: Collection[frozenset[str]], standing: Collection[Pair] = ()
) -> dict[Pair, Edge]:
    """The edges without those that would tie two robots of `never` over any number of others.

    Fixed edges are kept first, then `standing` ones, then the most confident (Kruskal's way, where a union that would
    bring such a pair together is skipped).
    """
    if not never:
        return dict(edges)
    members = {robot: frozenset({robot}) for pair in edges for robot in pair}

    def rank(pair: Pair) -> tuple[object, ...]:
        return not edges[pair].is_fixed, pair not in standing, -edges[pair].confidence, pair_key(pair)

    for pair in sorted(edges, key=rank):
        union = members[pair[0]] | members[pair[1]]
        if not any(apart <= union for apart in never):
            members |= dict.fromkeys(union, union)
    return {pair: edge for pair, edge in edges.items() if pair[1] in members[pair[0]]}


def brought_together(pair: Pair, edges: Collection[Pair], never: Collection[frozenset[str]]) -> tuple[str, ...]:
    """The first two robots of `never` that an edge would tie over others beside the `edges` there are; maybe none."""
    (union,) = (robots for robots in components([*edges, pair]) if pair[0] in robots)
    tied = (tuple(sorted(apart, key=natural_key)) for apart in never if apart <= set(union))
    return min(tied, key=lambda apart: [natural_key(robot) for robot in apart], default=())


def strongest(edges: Mapping[Pair, Edge], count: int) -> dict[Pair, Edge]:
    """The edges that tie everything together and the `count` most confident ones of each robot, in natural order."""
    ranked = sorted(edges, key=lambda pair: (-edges[pair].confidence, pair_key(pair)))
    kept = _tree(ranked)
    num_kept: Counter[str] = Counter()
    for pair in ranked:
        if min(num_kept[robot] for robot in pair) < count:
            kept.add(pair)
            num_kept.update(pair)
    return {pair: edges[pair] for pair in sorted(kept, key=pair_key)}


def solve(edges: Mapping[Pair, Edge], reference: str) -> Solution:
    """The placements that the largest consistent set of edges gives, by least squares.

    Edges are ranked by how many triangles they close (pairwise consistency, Mangelson et al., ICRA 2018, over the
    shortest cycles), then by confidence. The best ranked spanning tree is the start; edges that do not fit to the
    solution are dropped, those that do take part, until nothing changes. The tree keeps everything connected.

    Args:
        edges: Of one component that holds the reference.
        reference: The robot whose map frame stays where it is.
    """
    support = _support(edges)
    ranked = sorted(
        edges, key=lambda pair: (not edges[pair].is_fixed, -support[pair], -edges[pair].confidence, pair_key(pair))
    )
    fixed = {pair for pair in ranked if edges[pair].is_fixed}
    poses, hops = _span(edges, ranked, reference)
    kept: set[Pair] = set()
    for _ in range(MAX_ITERATIONS):
        fitting = {pair for pair in ranked if _fits(misfit(edges[pair], poses, pair), hops, pair)}
        tree = _tree([pair for pair in ranked if pair in fitting] + [pair for pair in ranked if pair not in fitting])
        if fixed | fitting | tree == kept:
            break
        kept = fixed | fitting | tree
        poses = _least_squares({pair: edges[pair] for pair in sorted(kept, key=pair_key)}, poses, reference)
    dropped = {pair: misfit(edges[pair], poses, pair) for pair in sorted(edges, key=pair_key) if pair not in kept}
    return Solution(poses, dropped)


def misfit(edge: Edge, poses: Mapping[str, SE2], pair: Pair) -> Misfit:
    """The distance between where an edge and where the placements see b, at the middle of its area."""
    predicted = poses[pair[0]].inverse() @ poses[pair[1]]
    apart = predicted.apply(edge.centre_b_m) - edge.T_a_b.apply(edge.centre_b_m)
    return Misfit(float(np.hypot(*apart)), abs(wrap_angle(predicted.yaw_rad - edge.T_a_b.yaw_rad)))


def _support(edges: Mapping[Pair, Edge]) -> dict[Pair, int]:
    """Number of triangles in which each edge agrees with the way over the third robot."""
    robots = sorted({robot for pair in edges for robot in pair}, key=natural_key)
    support = dict.fromkeys(edges, 0)
    for pair, edge in edges.items():
        a, b = pair
        for c in robots:
            T_a_c, T_c_b = _transform(edges, a, c), _transform(edges, c, b)
            if T_a_c is not None and T_c_b is not None:
                closing = misfit(edge, {a: SE2.identity(), b: T_a_c @ T_c_b}, pair)
                support[pair] += _within(closing, 2)
    return support


def _transform(edges: Mapping[Pair, Edge], a: str, b: str) -> SE2 | None:
    if (a, b) in edges:
        return edges[a, b].T_a_b
    return edges[b, a].T_a_b.inverse() if (b, a) in edges else None


def _fits(found: Misfit, hops: Mapping[str, int], pair: Pair) -> bool:
    return _within(found, max(1, hops[pair[0]] + hops[pair[1]]))


def _within(found: Misfit, num_edges: int) -> bool:
    slack = 1.0 + 0.5 * (num_edges - 1)
    return found.distance_m <= TOLERANCE_M * slack and found.angle_rad <= TOLERANCE_RAD * slack


def _tree(ranked: Sequence[Pair]) -> set[Pair]:
    """The spanning tree of the best ranked edges (Kruskal)."""
    root: dict[str, str] = {}

    def find(robot: str) -> str:
        while root.setdefault(robot, robot) != robot:
            robot = root[robot]
        return robot

    tree = set()
    for a, b in ranked:
        if find(a) != find(b):
            root[find(b)] = find(a)
            tree.add((a, b))
    return tree


def _span(edges: Mapping[Pair, Edge], ranked: Sequence[Pair], reference: str) -> tuple[dict[str, SE2], dict[str, int]]:
    """Placements along the best ranked tree, and how many edges each robot is away from the reference."""
    tree = _tree(ranked)
    poses, hops = {reference: SE2.identity()}, {reference: 0}
    queue = [reference]
    for robot in queue:  # breadth first; the queue grows while it is walked
        for a, b in sorted(tree, key=pair_key):
            other = b if a == robot else a if b == robot else None
            T_robot_other = None if other is None else _transform(edges, robot, other)
            if other is not None and T_robot_other is not None and other not in poses:
                poses[other], hops[other] = poses[robot] @ T_robot_other, hops[robot] + 1
                queue.append(other)
    return poses, hops


def _least_squares(edges: Mapping[Pair, Edge], start: Mapping[str, SE2], reference: str) -> dict[str, SE2]:
    """Gauss-Newton over all placements but the reference's, weighted by the edges' covariances.

    The residual of an edge is where the placements see the middle of b's area in a, less where the edge sees it, and
    the same for the angle. Source: Grisetti et al., A tutorial on graph-based SLAM, 2010.
    """
    robots = [robot for robot in sorted(start, key=natural_key) if robot != reference]
    index = {robot: 3 * number for number, robot in enumerate(robots)}
    poses = dict(start)
    weights = {pair: _information(edge) for pair, edge in edges.items()}
    for _ in range(MAX_ITERATIONS):
        H, g = np.zeros((3 * len(robots),) * 2), np.zeros(3 * len(robots))
        for pair, edge in edges.items():
            residual, jacobians = _linearised(edge, poses[pair[0]], poses[pair[1]])
            blocks = [(index[robot], J) for robot, J in zip(pair, jacobians, strict=True) if robot in index]
            for row, J_row in blocks:
                g[row : row + 3] += J_row.T @ weights[pair] @ residual
                for col, J_col in blocks:
                    H[row : row + 3, col : col + 3] += J_row.T @ weights[pair] @ J_col
        step = np.linalg.solve(H + 1e-9 * np.eye(len(H)), -g)
        for robot, row in index.items():
            pose, delta = poses[robot], step[row : row + 3]
            poses[robot] = SE2(pose.x_m + delta[0], pose.y_m + delta[1], pose.yaw_rad + delta[2])
        if float(np.abs(step).max(initial=0.0)) < CONVERGED:
            break
    return poses


def _linearised(edge: Edge, T_a: SE2, T_b: SE2) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
    """Residual (3,) of an edge and its (3, 3) Jacobians by the placements of a and of b."""
    centre = T_b.apply(edge.centre_b_m)
    arm = centre - np.array([T_a.x_m, T_a.y_m])
    lever = centre - np.array([T_b.x_m, T_b.y_m])
    c, s = math.cos(T_a.yaw_rad), math.sin(T_a.yaw_rad)
    to_a = np.array([[c, s], [-s, c]])
    apart = to_a @ arm - edge.T_a_b.apply(edge.centre_b_m)
    residual = np.array([*apart, wrap_angle(T_b.yaw_rad - T_a.yaw_rad - edge.T_a_b.yaw_rad)])
    J_a, J_b = np.zeros((3, 3)), np.zeros((3, 3))
    J_a[:2, :2], J_b[:2, :2] = -to_a, to_a
    J_a[:2, 2] = to_a @ np.array([arm[1], -arm[0]])
    J_b[:2, 2] = to_a @ np.array([-lever[1], lever[0]])
    J_a[2, 2], J_b[2, 2] = -1.0, 1.0
    return residual, (J_a, J_b)


def _information(edge: Edge) -> FloatArray:
    """(3, 3) weight of an edge's residual: its covariance at the middle of b's area, no better than the floor."""
    floor = np.diag([FLOOR_M**2, FLOOR_M**2, FLOOR_RAD**2])
    if edge.covariance is None:
        return np.linalg.inv(floor)
    lever = edge.T_a_b.apply(edge.centre_b_m) - np.array([edge.T_a_b.x_m, edge.T_a_b.y_m])
    J = np.array([[1.0, 0.0, -lever[1]], [0.0, 1.0, lever[0]], [0.0, 0.0, 1.0]])
    return np.linalg.inv(J @ edge.covariance @ J.T + floor)


def pair_key(pair: Pair) -> tuple[tuple[tuple[int, int, str], ...], ...]:
    """Sort key that puts pairs in natural order."""
    return natural_key(pair[0]), natural_key(pair[1])
