"""Placements against optima known by other means: brute force, Weiszfeld's iteration, smallest circles."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from plr_jax import Placement, VisibilityGraph, Workspace, construct_pairs, place, scenes
from plr_jax._compiled import as_pytree
from plr_jax.optimize import OptimizationInterrupted
from plr_jax.optimize.placement import place as driver
from plr_jax.optimize.placement.costs import LocationProblem, PlacementObjective, pair_slopes, soft_pulls
from plr_jax.optimize.placement.search import moved, starts

SQUARE = Workspace(((0, 0), (1, 1)))
MAZE = scenes.maze().workspace
COSTS = {"sum": np.sum, "max": np.max}
either_objective = pytest.mark.parametrize("objective", COSTS)


def manhattan(x, y):
    return jnp.abs(x - y).sum(axis=-1)


def euclidean(x, y):
    return jnp.sqrt(((x - y) ** 2).sum(axis=-1))  # without a gradient for a point and itself


def around_the_corner(x, y):
    """In an L, all of [0, 4] x [0, 4] but [0, 3] x [0, 3]: straight, or by the corner (3, 3)."""
    (ax, ay), (bx, by) = (x - 3).T, (y - 3).T
    is_hidden = (jnp.minimum(ax, bx) < 0) & (jnp.minimum(ay, by) < 0)
    is_hidden &= jnp.where(ax < bx, ax * by - ay * bx, ay * bx - ax * by) > 0
    return jnp.where(is_hidden, euclidean(x, 3.0) + euclidean(y, 3.0), euclidean(x, y))


def in_two_rooms(x, y):
    return jnp.where((x[..., 0] < 1.5) == (y[..., 0] < 1.5), euclidean(x, y), jnp.inf)


def random_points(seed, n=20):
    return np.random.default_rng(seed).random((n, 2))


def problem_of(objective, n, seed=0, distance=manhattan):
    weights = 0.5 + np.random.default_rng(seed + 100).random(n)
    return LocationProblem(
        SQUARE, as_pytree(distance), PlacementObjective(objective), random_points(seed, n), weights
    )


# --- parts -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("k", "distance"), [(1, manhattan), (3, manhattan), (5, in_two_rooms)])
def test_no_exchange_makes_the_sum_of_a_start_less(k, distance):
    problem = problem_of("sum", 40, distance=distance)
    problem = problem._replace(points=3 * problem.points)
    (start,) = starts(problem, None, k, 1, np.random.default_rng(1))
    each = [np.stack([*start[:i], point, *start[i + 1 :]]) for i in range(k) for point in problem.points]
    costs = problem.cost(problem.distances(np.array([start, *each])).min(axis=1))
    assert costs.min() >= costs[0] * (1 - 2e-6)


@either_objective
@pytest.mark.parametrize(("n", "k", "count"), [(40, 4, 6), (3, 1, 3)])
def test_starts_differ_and_the_cheapest_is_first(objective, n, k, count):
    problem = problem_of(objective, n)
    found = starts(problem, None, k, 6, np.random.default_rng(0))
    assert found.shape == (count, k, 2)
    assert len({tuple(sorted(map(tuple, start))) for start in found.tolist()}) == count
    assert (np.diff(problem.cost(problem.distances(found).min(axis=1))) >= 0).all()
    assert {tuple(x) for x in found.reshape(-1, 2)} <= {tuple(x) for x in problem.points}


@either_objective
@pytest.mark.parametrize("k", [3, 20])
def test_pulls_become_the_slopes_of_the_cost(objective, k):
    problem = problem_of(objective, n=30)
    weights, x = problem.weights / problem.weights.max(), np.random.default_rng(1).random((2, k, 2))
    near = problem.near(x)
    distances, slopes = pair_slopes(problem.distance, x[np.arange(2)[:, None, None], near], problem.points[:, None])
    given = (jnp.asarray(each) for each in (weights, distances, slopes, near))
    pulls = soft_pulls(problem.objective, *given, k, jnp.asarray(1e-5))

    def cost(x):
        return COSTS[objective](weights * problem.distances(x).min(axis=1), axis=-1)

    np.testing.assert_allclose(COSTS[objective](weights * distances.min(axis=2), axis=-1), cost(x), rtol=1e-6)
    for change in 1e-4 * np.eye(2 * k).reshape(2 * k, k, 2):  # all costs are linear up to the next kink
        slope = (cost(x + change) - cost(x - change)) / 2e-4
        np.testing.assert_allclose(np.asarray(pulls)[:, change != 0][:, 0], slope, atol=0.02)


def test_distances_that_jax_cannot_differentiate_do_not_pull_but_are_compared():
    def halved(x, y):
        """The Manhattan distance by a loop, whose number of turns is not known beforehand."""
        start = 2 * manhattan(x, y), 0
        return jax.lax.while_loop(lambda state: state[1] < 1, lambda state: (state[0] / 2, state[1] + 1), start)[0]

    demand = SQUARE.sample_free(12, seed=0)
    found, pulled = (place(of, SQUARE, demand, k=2, num_iterations=5) for of in (halved, manhattan))
    assert pulled.cost - 1e-6 <= found.cost <= found.start_costs.min() == pulled.start_costs.min()


def test_slopes_of_pairs():
    x, y = np.array([[0.2, 0.3], [0.5, 0.5]]), np.array([[0.4, 0.1], [0.1, 0.1]])
    distances, slopes = pair_slopes(as_pytree(manhattan), x, y)
    np.testing.assert_allclose(distances, [0.4, 0.8], rtol=1e-6)
    assert slopes.tolist() == [[-1, 1], [1, 1]]


def test_steps_stay_in_free_space_and_slide_along_walls():
    x = MAZE.sample_free(2000, seed=0)
    step = np.random.default_rng(0).normal(0, 0.1, x.shape)
    end = moved(MAZE, x, step)
    assert MAZE.is_visible(x, end).all()
    is_free = MAZE.is_visible(x, x + step)
    assert 0.2 < is_free.mean() < 0.9
    np.testing.assert_array_equal(end[is_free], (x + step)[is_free])
    # What is blocked never goes back, and mostly goes on.
    ahead = ((end - x) * step).sum(axis=1)[~is_free]
    assert (ahead >= 0).all() and (ahead > 0).mean() > 0.9
    assert (np.linalg.norm(end - x, axis=1) <= np.linalg.norm(step, axis=1) * (1 + 1e-12)).all()
    on_wall = moved(SQUARE, np.array([[0.5, 0.0]]), np.array([[0.1, -0.02]]))
    assert on_wall[0, 0] > 0.57 and on_wall[0, 1] >= 0


# --- optima ----------------------------------------------------------------------------------------------


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
def test_one_median_is_the_geometric_median_and_one_center_that_of_the_smallest_circle(seed):
    points, weights = random_points(seed), 0.5 + np.random.default_rng(9).random(20)
    median = place(euclidean, SQUARE, points, weights=weights)
    assert median.cost == pytest.approx(geometric_median_cost(points, weights), rel=1e-6)
    center = place(euclidean, SQUARE, points, objective="max")
    assert center.cost == pytest.approx(smallest_circle_radius(points), rel=1e-6)


def test_a_median_is_a_demand_point_that_outweighs_the_others():
    points = random_points(0)
    found = place(euclidean, SQUARE, points, weights=np.where(np.arange(20) == 2, 20, 1))
    assert found.facilities.tolist() == [points[2].tolist()]


def test_a_median_is_the_corner_that_all_must_pass():
    wall = Workspace(((0, 0), (4, 4)), [[(0, 0), (3, 0), (3, 3), (0, 3)]])
    points = np.array([[0.5, 3.5], [0.2, 3.1], [3.5, 0.5], [3.1, 0.2]])
    found = place(around_the_corner, wall, points)
    assert found.cost == pytest.approx(np.linalg.norm(points - [3, 3], axis=1).sum(), rel=1e-5)
    np.testing.assert_allclose(found.facilities, [[3, 3]], atol=1e-3)


@pytest.mark.parametrize(("objective", "k"), [("sum", 1), ("max", 2)])
def test_places_in_the_maze_are_as_good_as_those_of_a_grid(objective, k):
    exact, cost, spacing = VisibilityGraph(MAZE, scenes.maze().goals[0]), COSTS[objective], 1 / 25
    demand, (axis, step) = (
        MAZE.sample_free(15, seed=2 + k),
        np.linspace(spacing / 2, 1 - spacing / 2, 25, retstep=True),
    )
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    from_each = [exact.with_goal(point) for point in demand]
    distances = np.stack([distance(grid[MAZE.is_free(grid)]) for distance in from_each], axis=1)
    found = place(construct_pairs(MAZE, max_bytes=2048), MAZE, demand, k, objective=objective)
    assert MAZE.is_free(found.facilities).all()
    of_grid = min(cost(np.minimum(row, distances), axis=1).min() for row in (distances if k == 2 else [np.inf]))
    if k == 1:  # a finer grid around the best of the coarse one
        best = grid[MAZE.is_free(grid)][cost(distances, axis=1).argmin()]
        fine = best + np.stack(np.meshgrid(*[np.linspace(-step, step, 31)] * 2), axis=-1).reshape(-1, 2)
        fine = fine[MAZE.is_free(fine)]
        of_grid = min(of_grid, cost([distance(fine) for distance in from_each], axis=0).min())
    assert found.cost <= of_grid * (1 + 1e-6)
    nearest = np.stack([exact.with_goal(x)(demand) for x in found.facilities]).min(axis=0)
    assert found.cost == pytest.approx(cost(nearest), rel=1e-6)


@either_objective
def test_what_a_placement_says_of_itself(objective):
    points, weights = random_points(5), 1 + np.arange(20) % 3
    found = place(euclidean, SQUARE, points, 3, objective=objective, weights=weights)
    assert isinstance(found, Placement) and repr(found).startswith("Placement(3 facilities, cost ")
    distances = np.linalg.norm(found.facilities[:, None] - points, axis=2)
    assert (found.assignment == distances.argmin(axis=0)).all()
    np.testing.assert_allclose(found.distances, distances.min(axis=0), atol=1e-6)
    assert found.costs.min() >= found.cost == COSTS[objective](weights * found.distances)
    assert (found.costs <= found.start_costs).all() and (np.diff(found.start_costs) >= 0).all()
    assert found.cost < 0.995 * found.start_costs[0]


def test_the_same_seed_gives_the_same_placement():
    first, second, other = (place(euclidean, SQUARE, random_points(6), 3, seed=seed) for seed in (1, 1, 2))
    assert (first.facilities == second.facilities).all() and (first.costs == second.costs).all()
    assert not np.array_equal(first.start_costs, other.start_costs)


def test_a_weight_counts_as_often_as_the_point():
    points, weights = random_points(7, 10), np.array([1, 2, 3, 1, 2, 3, 1, 2, 3, 2])
    weighted = place(euclidean, SQUARE, points, 3, weights=weights)
    assert weighted.cost == pytest.approx(place(euclidean, SQUARE, points.repeat(weights, axis=0), 3).cost, rel=1e-5)


@either_objective
def test_costs_are_in_the_units_of_weights_and_lengths(objective):
    points, large = random_points(8), Workspace(((0, 0), (1000, 1000)))
    one = place(euclidean, SQUARE, points, 3, objective=objective)
    other = place(euclidean, large, 1000 * points, 3, objective=objective, weights=np.full(20, 1e-4))
    assert other.cost == pytest.approx(0.1 * one.cost, rel=1e-4)


def test_as_many_facilities_as_points_are_at_the_points():
    points = random_points(0, 4)
    found = place(euclidean, SQUARE, points, 4)
    assert found.cost == 0 and sorted(found.facilities.tolist()) == sorted(points.tolist())
    found = place(euclidean, SQUARE, np.full((5, 2), 0.5), 2)  # points that are all one
    assert found.cost == 0 and (found.facilities == 0.5).all()


@either_objective
def test_every_part_of_free_space_gets_a_facility(objective):
    rooms = Workspace(((0, 0), (3, 1)), [[(1, 0), (2, 0), (2, 1), (1, 1)]])
    left, right = random_points(0), random_points(1) + np.array([2, 0])
    both = np.concatenate([left, right])
    with pytest.raises(ValueError, match=r"in 2 parts of free space that no path joins, so that k=1 .*: use k=2"):
        place(in_two_rooms, rooms, both, objective=objective)
    apart = [place(in_two_rooms, rooms, demand, objective=objective).cost for demand in (left, right)]
    found = place(in_two_rooms, rooms, both, 2, objective=objective)
    assert found.cost == pytest.approx(COSTS[objective](apart), rel=1e-5)


@pytest.mark.parametrize(("objective", "most"), [("sum", 1 + 1e-6), ("max", 1.05)])
@pytest.mark.parametrize("seed", range(3))
def test_facilities_at_candidates_are_about_as_cheap_as_the_best_of_all_choices(objective, most, seed):
    points, sites, weights = random_points(seed, 30), random_points(seed + 20, 9), 1 + np.arange(30) % 3
    found = place(euclidean, SQUARE, points, 3, objective=objective, weights=weights, candidates=sites)
    distances = np.linalg.norm(sites[:, None] - points, axis=2)
    choices = map(list, itertools.combinations(range(9), 3))
    best = min(COSTS[objective](weights * distances[some].min(axis=0)) for some in choices)
    assert best * (1 - 1e-6) <= found.cost <= best * most
    assert {tuple(x) for x in found.facilities} <= {tuple(x) for x in sites}
    assert (found.costs == found.start_costs).all()


def test_candidates_serve_rooms_that_no_path_joins_each_once():
    rooms, sites = (
        Workspace(((0, 0), (3, 1)), [[(1, 0), (2, 0), (2, 1), (1, 1)]]),
        [[0.5, 0.5], [2.5, 0.5], [2.2, 0.1]],
    )
    both = np.concatenate([random_points(0), random_points(1) + np.array([2, 0])])
    assert sorted(place(in_two_rooms, rooms, both, 3, candidates=sites).facilities.tolist()) == sorted(sites)
    with pytest.raises(ValueError, match=r"No candidate reaches 20 of 40 demand points, such as .*, number 20: add"):
        place(in_two_rooms, rooms, both, candidates=sites[:1])
    with pytest.raises(ValueError, match=r"in 2 parts of free space .*: use k=2"):
        place(in_two_rooms, rooms, both, candidates=sites)


@pytest.mark.parametrize("interrupted", ["moved", "searched"])
def test_an_interrupt_keeps_the_best_so_far(interrupted, monkeypatch):
    calls, original, points = itertools.count(), getattr(driver, interrupted), random_points(6)

    def interrupt(*args):
        if next(calls) == 5:
            raise KeyboardInterrupt
        return original(*args)

    monkeypatch.setattr(driver, interrupted, interrupt)
    with pytest.warns(OptimizationInterrupted, match="best found so far"):
        found = place(euclidean, SQUARE, points, 3)
    monkeypatch.undo()
    whole = place(euclidean, SQUARE, points, 3)
    assert whole.cost < found.cost < found.start_costs[0]
    nearest = np.linalg.norm(found.facilities[:, None] - points, axis=2).min(axis=0)
    assert found.cost == found.distances.sum() == pytest.approx(nearest.sum(), rel=1e-6)
    if interrupted == "searched":
        assert found.cost < found.costs.min()
        np.testing.assert_array_equal(found.costs, whole.costs)


def test_what_the_last_step_of_descent_leads_to_counts():
    found = place(euclidean, SQUARE, random_points(6), 3, num_iterations=1)
    assert (found.costs < found.start_costs).any()


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
        ({"candidates": DEMAND[:1], "k": 2}, "k must be at most the number of candidates, 1, got 2"),
        ({"candidates": DEMAND + 1}, "candidates must be points of free space: 5 of 5 are in an obstacle"),
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
