"""Placements against optima known by other means: brute force, Weiszfeld's iteration, smallest circles."""

import itertools

import jax.numpy as jnp
import numpy as np
import pytest

from plr_jax import Placement, VisibilityGraph, Workspace, construct_pairs, place, scenes
from plr_jax.optimize import OptimizationInterrupted
from plr_jax.optimize.placement import place as driver

SQUARE = Workspace(((0, 0), (1, 1)))
MAZE = scenes.maze().workspace
TWO_ROOMS = Workspace(((0, 0), (3, 1)), [[(1, 0), (2, 0), (2, 1), (1, 1)]])


def euclidean(x, y):
    return jnp.sqrt(((x - y) ** 2).sum(axis=-1))  # without a gradient for a point and itself


@pytest.fixture(scope="module")
def pairs():
    return construct_pairs(MAZE, max_bytes=2048)


@pytest.fixture(scope="module")
def exact():
    return VisibilityGraph(MAZE, scenes.maze().goals[0])


def random_points(seed, n=20):
    return np.random.default_rng(seed).random((n, 2))


def geometric_median_cost(points, weights):
    x = points.mean(axis=0)
    for _ in range(3000):
        pull = weights / np.linalg.norm(points - x, axis=1)
        x = pull @ points / pull.sum()
    return float(weights @ np.linalg.norm(points - x, axis=1))


def smallest_circle_radius(points):
    """The largest of the smallest circles of all three points, or two, which is that of all."""
    radius = 0.0
    for a, b, c in itertools.combinations(points, 3):
        sides = [np.linalg.norm(p - q) for p, q in ((a, b), (b, c), (c, a))]
        longest = max(sides)
        is_obtuse = 2 * longest**2 >= sum(side**2 for side in sides)
        twice_area = abs((b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0])
        radius = max(radius, longest / 2 if is_obtuse else np.prod(sides) / (2 * twice_area))
    return radius


@pytest.mark.parametrize("seed", range(3))
def test_one_median_is_the_geometric_median(seed):
    points, weights = random_points(seed), 0.5 + np.random.default_rng(9).random(20)
    found = place(euclidean, SQUARE, points, weights=weights)
    assert found.cost == pytest.approx(geometric_median_cost(points, weights), rel=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_one_center_is_that_of_the_smallest_circle(seed):
    points = random_points(seed)
    found = place(euclidean, SQUARE, points, objective="max")
    assert found.cost == pytest.approx(smallest_circle_radius(points), rel=1e-6)


def test_a_median_is_a_demand_point_that_outweighs_the_others():
    points = random_points(0, 5)
    found = place(euclidean, SQUARE, points, weights=[1, 1, 5, 1, 1])
    assert found.facilities.tolist() == [points[2].tolist()]


def test_a_median_is_the_corner_that_all_must_pass():
    wall = Workspace(((0, 0), (4, 4)), [[(0, 0), (3, 0), (3, 3), (0, 3)]])  # leaves an L
    points = np.array([[0.5, 3.5], [0.2, 3.1], [3.5, 0.5], [3.1, 0.2]])
    found = place(construct_pairs(wall), wall, points)
    assert found.cost == pytest.approx(np.linalg.norm(points - [3, 3], axis=1).sum(), rel=1e-5)
    np.testing.assert_allclose(found.facilities, [[3, 3]], atol=1e-3)


def grid_of(spacing):
    axis = np.arange(spacing / 2, 1, spacing)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    return grid[MAZE.is_free(grid)]


@pytest.mark.parametrize("objective", ["sum", "max"])
def test_one_place_in_the_maze_is_as_good_as_a_dense_grid(objective, pairs, exact):
    demand, spacing = MAZE.sample_free(15, seed=3), 1 / 150
    cost = {"sum": np.sum, "max": np.max}[objective]
    found = place(pairs, MAZE, demand, objective=objective)
    of_grid = cost([exact.with_goal(point)(grid_of(spacing)) for point in demand], axis=0).min()
    assert found.cost <= of_grid * (1 + 1e-6)
    slope = len(demand) if objective == "sum" else 1
    assert found.cost >= of_grid - slope * spacing / np.sqrt(2)
    at = exact.with_goal(found.facilities[0])(demand)
    assert found.cost == pytest.approx(cost(at), rel=1e-6)


@pytest.mark.parametrize("objective", ["sum", "max"])
def test_two_places_in_the_maze_are_as_good_as_all_pairs_of_a_grid(objective, pairs, exact):
    demand = MAZE.sample_free(12, seed=4)
    cost = {"sum": np.sum, "max": np.max}[objective]
    found = place(pairs, MAZE, demand, 2, objective=objective)
    distances = np.stack([exact.with_goal(point)(grid_of(1 / 25)) for point in demand], axis=1)
    of_pairs = min(cost(np.minimum(row, distances), axis=1).min() for row in distances)
    assert found.cost <= of_pairs
    true = np.stack([exact.with_goal(x)(demand) for x in found.facilities])
    assert found.cost == pytest.approx(cost(true.min(axis=0)), rel=1e-6)


@pytest.mark.parametrize("objective", ["sum", "max"])
def test_what_a_placement_says_of_itself(objective, pairs):
    demand, weights = MAZE.sample_free(60, seed=5), 1 + np.arange(60) % 3
    found = place(pairs, MAZE, demand, 4, objective=objective, weights=weights)
    assert MAZE.is_free(found.facilities).all()
    distances = np.asarray(pairs(found.facilities[:, None], demand))
    assert (found.assignment == distances.argmin(axis=0)).all()
    np.testing.assert_allclose(found.distances, distances.min(axis=0), atol=1e-6)
    costs = weights * found.distances
    assert found.cost == found.costs.min() == (costs.sum() if objective == "sum" else costs.max())
    assert (found.costs <= found.start_costs).all() and (np.diff(found.start_costs) >= 0).all()
    assert found.cost < 0.995 * found.start_costs[0]
    assert repr(found).startswith("Placement(4 facilities, cost ")


def test_the_same_seed_gives_the_same_placement(pairs):
    demand = MAZE.sample_free(40, seed=6)
    first, second, other = (place(pairs, MAZE, demand, 3, seed=seed) for seed in (1, 1, 2))
    assert (first.facilities == second.facilities).all() and (first.costs == second.costs).all()
    assert not np.array_equal(first.start_costs, other.start_costs)


def test_a_weight_counts_as_often_as_the_point():
    points, weights = random_points(7, 9), np.arange(1, 10) % 3 + 1
    weighted = place(euclidean, SQUARE, points, 2, weights=weights)
    assert weighted.cost == pytest.approx(place(euclidean, SQUARE, points.repeat(weights, axis=0), 2).cost, rel=1e-5)


@pytest.mark.parametrize("objective", ["sum", "max"])
def test_costs_are_in_the_units_of_weights_and_lengths(objective):
    points, large = random_points(8), Workspace(((0, 0), (1000, 1000)))
    one = place(euclidean, SQUARE, points, 3, objective=objective)
    other = place(euclidean, large, 1000 * points, 3, objective=objective, weights=np.full(20, 1e-4))
    assert other.cost == pytest.approx(0.1 * one.cost, rel=1e-4)


def test_as_many_facilities_as_points_are_at_the_points():
    points = random_points(0, 4)
    found = place(euclidean, SQUARE, points, 4)
    assert found.cost == 0 and sorted(found.facilities.tolist()) == sorted(points.tolist())


def test_points_that_are_all_one():
    found = place(euclidean, SQUARE, np.full((5, 2), 0.5), 2)
    assert found.cost == 0 and (found.facilities == 0.5).all()


@pytest.mark.parametrize("objective", ["sum", "max"])
def test_every_part_of_free_space_gets_a_facility(objective):
    pairs, demand = construct_pairs(TWO_ROOMS), TWO_ROOMS.sample_free(30, seed=0)
    with pytest.raises(ValueError, match=r"in 2 parts of free space that no path joins, so that k=1 .*: use k=2"):
        place(pairs, TWO_ROOMS, demand, objective=objective)
    found = place(pairs, TWO_ROOMS, demand, 2, objective=objective)
    in_left = demand[:, 0] < 1.5
    apart = [place(pairs, TWO_ROOMS, demand[part], objective=objective).cost for part in (in_left, ~in_left)]
    total = sum(apart) if objective == "sum" else max(apart)
    assert found.cost == pytest.approx(total, rel=1e-5)


@pytest.mark.parametrize("interrupted", ["moved", "searched"])
def test_an_interrupt_keeps_the_best_so_far(interrupted, monkeypatch, pairs):
    calls, original = itertools.count(), getattr(driver, interrupted)

    def interrupt(*args):
        if next(calls) == 5:
            raise KeyboardInterrupt
        return original(*args)

    monkeypatch.setattr(driver, interrupted, interrupt)
    demand = MAZE.sample_free(40, seed=6)
    with pytest.warns(OptimizationInterrupted, match="best found so far"):
        found = place(pairs, MAZE, demand, 3)
    monkeypatch.undo()
    assert place(pairs, MAZE, demand, 3).cost < found.cost < found.start_costs[0]
    assert MAZE.is_free(found.facilities).all()


DEMAND = random_points(0, 5)


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"workspace": 5}, "workspace must be a Workspace, got 5"),
        ({"demand": DEMAND[:, :1]}, r"demand must have shape \(n, 2\), got \(5, 1\)"),
        ({"demand": np.empty((0, 2))}, "demand must have at least one point"),
        (
            {"demand": DEMAND + 1},
            "demand must be points of free space: 5 of 5 are in an obstacle, outside the bounds",
        ),
        ({"demand": np.where(np.eye(5, 2) == 1, np.nan, DEMAND)}, "2 of 5 are .* or not finite, such as"),
        ({"k": 0}, "k must be an integer >= 1, got 0"),
        ({"k": 6}, "k must be at most the number of demand points, 5, got 6"),
        ({"k": 1.5}, "k must be an integer >= 1, got 1.5"),
        ({"objective": "mean"}, "objective must be 'sum' or 'max', got 'mean'"),
        ({"objective": None}, "objective must be 'sum' or 'max', got None"),
        ({"weights": [1, 2]}, r"weights must be one number a demand point, shape \(5,\), got shape \(2,\)"),
        ({"weights": [1, 1, 0, 1, 1]}, "weights must be positive and finite, got 0.0 for demand point 2"),
        ({"weights": [1, 1, 1, 1, np.inf]}, "weights must be positive and finite, got inf for demand point 4"),
        ({"weights": "heavy"}, "weights must be numbers of shape"),
        ({"num_restarts": 0}, "num_restarts must be an integer >= 1, got 0"),
        ({"num_iterations": 0}, "num_iterations must be an integer >= 1, got 0"),
        ({"seed": -1}, "seed must be an integer >= 0, got -1"),
        ({"distance": None}, "distance must be a function that JAX can trace, such as a PairPLR"),
        ({"distance": VisibilityGraph(SQUARE, (0.5, 0.5))}, "distance must be a function that JAX can trace"),
        ({"distance": lambda x, y: np.hypot(*np.asarray(x - y).T)}, "distance must be a function that JAX can trace"),
        ({"distance": lambda x, y: x - y}, r"to their distances \(m,\), got float32 of shape \(3, 2\) for 3 pairs"),
        ({"distance": lambda x, y: euclidean(x, y) - 1}, r"distance gives -\d.* for \[.*\] and \[.*\]; use inf"),
        ({"distance": lambda x, y: euclidean(x, y) + jnp.nan}, "distance gives nan for"),
        ({"distance": lambda x, y: euclidean(x, y) + jnp.inf}, "gives inf from the demand point .* to itself"),
    ],
)
def test_what_cannot_be_placed(change, message):
    given = {"distance": euclidean, "workspace": SQUARE, "demand": DEMAND} | change
    with pytest.raises(ValueError, match=message):
        place(**given)


def test_a_placement_is_public():
    assert isinstance(place(euclidean, SQUARE, DEMAND, num_iterations=1, num_restarts=1), Placement)
