import math

import numpy as np
import pytest

from mapfusion.posegraph import Edge, Pair, brought_together, components, separated, solve, strongest
from mapfusion.transform import SE2


def anywhere(rng: np.random.Generator) -> SE2:
    x_m, y_m, yaw_rad = rng.uniform([-40, -40, -3], [40, 40, 3])
    return SE2(x_m, y_m, yaw_rad)


def robots(count: int, seed: int) -> dict[str, SE2]:
    """True poses of map frames, the first at the identity."""
    rng = np.random.default_rng(seed)
    poses = {f"r{i + 1}": anywhere(rng) for i in range(count)}
    return poses | {"r1": SE2.identity()}


def measured(
    truth: dict[str, SE2], pairs: list[Pair], seed: int = 0, noise_m: float = 0.01, noise_rad: float = 1e-3
) -> dict[Pair, Edge]:
    rng = np.random.default_rng(seed)
    edges = {}
    for a, b in pairs:
        T = truth[a].inverse() @ truth[b]
        x_m, y_m, yaw_rad = rng.normal([T.x_m, T.y_m, T.yaw_rad], [noise_m, noise_m, noise_rad])
        noisy = SE2(x_m, y_m, yaw_rad)
        edges[a, b] = Edge(noisy, 0.95, np.diag([noise_m**2, noise_m**2, noise_rad**2]))
    return edges


def all_pairs(count: int) -> list[Pair]:
    return [(f"r{i}", f"r{j}") for i in range(1, count + 1) for j in range(i + 1, count + 1)]


def worst_error(found: dict[str, SE2], truth: dict[str, SE2]) -> tuple[float, float]:
    errors = [found[robot].distance_to(truth[robot]) for robot in truth]
    return max(e[0] for e in errors), math.degrees(max(e[1] for e in errors))


@pytest.mark.parametrize("count", [4, 8, 20])
@pytest.mark.parametrize("seed", range(5))
def test_a_quarter_of_false_measurements_is_found_and_the_rest_is_accurate(count: int, seed: int) -> None:
    truth, pairs = robots(count, seed), all_pairs(count)
    edges = measured(truth, pairs, seed)
    rng = np.random.default_rng(seed + 100)
    # In a graph of four, two false edges may support each other as well as the truth does: one is false there.
    num_false = max(1, len(pairs) // 4) if count > 4 else 1
    false = {pairs[i] for i in rng.choice(len(pairs), num_false, replace=False)}
    for pair in false:
        edges[pair] = Edge(anywhere(rng), 0.95, edges[pair].covariance)
    solution = solve(edges, "r1")
    assert set(solution.dropped) == false
    distance_m, angle_deg = worst_error(dict(solution.T_reference_robot), truth)
    assert distance_m < 0.05
    assert angle_deg < 0.3


def test_least_squares_averages_what_single_edges_say() -> None:
    truth = robots(6, 3)
    edges = measured(truth, all_pairs(6), seed=5, noise_m=0.05, noise_rad=2e-3)
    solved = worst_error(dict(solve(edges, "r1").T_reference_robot), truth)[0]
    star = {pair: edge for pair, edge in edges.items() if pair[0] == "r1"}
    assert solved < worst_error(dict(solve(star, "r1").T_reference_robot), truth)[0]


def test_the_reference_may_be_any_robot_and_never_moves() -> None:
    truth = robots(5, 1)
    solution = solve(measured(truth, all_pairs(5), noise_m=1e-6, noise_rad=1e-7), "r3")
    assert solution.T_reference_robot["r3"] == SE2.identity()
    expected = truth["r3"].inverse() @ truth["r5"]
    assert solution.T_reference_robot["r5"].distance_to(expected)[0] < 1e-3


def test_in_a_lone_triangle_the_least_confident_edge_gives_way() -> None:
    truth = robots(3, 2)
    edges = measured(truth, all_pairs(3))
    edges["r1", "r3"] = Edge(SE2(1.0, 2.0, 3.0), 0.91)
    solution = solve(edges, "r1")
    assert list(solution.dropped) == [("r1", "r3")]
    assert solution.dropped["r1", "r3"].distance_m > 1.0
    assert worst_error(dict(solution.T_reference_robot), truth)[0] < 0.1


def test_a_chain_is_followed_as_it_is() -> None:
    truth = robots(6, 4)
    pairs = [(f"r{i}", f"r{i + 1}") for i in range(1, 6)]
    solution = solve(measured(truth, pairs, noise_m=1e-6, noise_rad=1e-8), "r1")
    assert not solution.dropped
    assert worst_error(dict(solution.T_reference_robot), truth)[0] < 1e-3


def test_errors_are_judged_where_the_map_is_and_not_at_its_far_origin() -> None:
    truth = {"r1": SE2.identity(), "r2": SE2(1.0, 2.0, 0.3), "r3": SE2(-3.0, 1.0, -0.4)}
    middle = np.array([400.0, 300.0])  # of the place, seen from r1's far origin
    edges = {}
    for a, b in all_pairs(3):
        T = truth[a].inverse() @ truth[b]
        centre = truth[b].inverse().apply(middle)
        yaw_rad = T.yaw_rad + 0.004  # 2 m at 500 m, unless the turn is about the middle
        shift = T.apply(centre) - SE2(0.0, 0.0, yaw_rad).apply(centre)
        edges[a, b] = Edge(SE2(float(shift[0]), float(shift[1]), yaw_rad), 0.9, None, centre)
    assert not solve(edges, "r1").dropped


def test_components_are_ordered_naturally() -> None:
    assert components([("r10", "r2"), ("x", "y"), ("r1", "r2")]) == [("r1", "r2", "r10"), ("x", "y")]


def test_the_order_of_edges_does_not_matter() -> None:
    edges = measured(robots(6, 8), all_pairs(6), noise_m=0.05)
    one, other = solve(edges, "r1"), solve(dict(reversed(edges.items())), "r1")
    assert one.T_reference_robot == other.T_reference_robot


def test_a_fixed_edge_is_never_dropped() -> None:
    truth = robots(4, 9)
    edges = measured(truth, all_pairs(4))
    edges["r1", "r2"] = Edge(SE2(1.0, 2.0, 3.0), 1.0, np.eye(3) * 1e-8, is_fixed=True)
    solution = solve(edges, "r1")
    assert ("r1", "r2") not in solution.dropped
    assert solution.T_reference_robot["r2"].distance_to(SE2(1.0, 2.0, 3.0))[0] < 0.01


def test_robots_that_must_stay_apart_are_cut_at_the_least_confident_tie() -> None:
    edges = {
        ("a", "b"): Edge(SE2.identity(), 0.99),
        ("b", "c"): Edge(SE2.identity(), 0.91),
        ("c", "d"): Edge(SE2.identity(), 0.95),
        ("x", "y"): Edge(SE2.identity(), 0.9),
    }
    kept = separated(edges, [frozenset({"a", "d"})])
    assert set(kept) == {("a", "b"), ("c", "d"), ("x", "y")}
    assert separated(edges, []) == edges


def test_what_stands_is_kept_before_what_is_more_confident() -> None:
    edges = {("a", "b"): Edge(SE2.identity(), 0.9), ("b", "c"): Edge(SE2.identity(), 0.99)}
    never = [frozenset({"a", "c"})]
    assert set(separated(edges, never)) == {("b", "c")}
    assert set(separated(edges, never, standing=[("a", "b")])) == {("a", "b")}
    fixed = edges | {("b", "c"): Edge(SE2.identity(), 1.0, is_fixed=True)}
    assert set(separated(fixed, never, standing=[("a", "b")])) == {("b", "c")}


def test_whom_an_edge_would_bring_together() -> None:
    never = [frozenset({"d", "a"}), frozenset({"x", "y"})]
    assert brought_together(("b", "c"), [("a", "b"), ("c", "d"), ("x", "z")], never) == ("a", "d")
    assert brought_together(("a", "d"), [], never) == ("a", "d")
    assert brought_together(("b", "c"), [("a", "b"), ("x", "z")], never) == ()


def test_of_many_edges_the_strongest_of_each_robot_and_a_tree_remain() -> None:
    rng = np.random.default_rng(0)
    edges = {pair: Edge(SE2.identity(), float(rng.uniform(0.9, 1.0))) for pair in all_pairs(20)}
    kept = strongest(edges, 3)
    assert len(kept) <= 3 * 20
    assert components(list(kept)) == components(list(edges))
    for robot in {robot for pair in edges for robot in pair}:
        best = max((pair for pair in edges if robot in pair), key=lambda pair: edges[pair].confidence)
        assert best in kept
    few = {pair: edge for pair, edge in edges.items() if pair in all_pairs(4)}
    assert strongest(few, 3) == few
