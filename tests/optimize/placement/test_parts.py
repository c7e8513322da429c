"""Seeding, steps in free space and gradients of costs, each against its definition."""

import jax.numpy as jnp
import numpy as np
import pytest

from plr_jax import Workspace, scenes
from plr_jax._pytree import as_pytree
from plr_jax.optimize.placement.costs import LocationProblem, PlacementObjective, nearest_and_pulls, slopes_at
from plr_jax.optimize.placement.search import _exchanged, _totals_after_exchange, moved, starts

SQUARE = Workspace(((0, 0), (1, 1)))


def manhattan(x, y):
    return jnp.abs(x - y).sum(axis=-1)


def problem_of(objective, n=12, seed=0):
    rng = np.random.default_rng(seed)
    return LocationProblem(SQUARE, as_pytree(manhattan), objective, rng.random((n, 2)), 0.5 + rng.random(n))


@pytest.mark.parametrize("k", [1, 3])
def test_sums_after_exchange_are_those_of_the_exchanged(k):
    terms = np.random.default_rng(0).random((9, 12))
    terms[:4, 6:] = terms[4:, :6] = np.inf  # two parts
    chosen = np.array([1, 5, 8])[:k]
    found = _totals_after_exchange(terms, chosen)
    for site in range(len(terms)):
        for place in range(k):
            exchanged = chosen.copy()
            exchanged[place] = site
            assert found[site, place] == pytest.approx(terms[exchanged].min(axis=0).sum())


def test_exchanges_end_where_none_makes_the_sum_less():
    terms = np.random.default_rng(1).random((40, 60))
    drawn = np.arange(5)
    chosen = _exchanged(terms, drawn)
    total = terms[chosen].min(axis=0).sum()
    assert total < terms[drawn].min(axis=0).sum() and (drawn == np.arange(5)).all()
    assert _totals_after_exchange(terms, chosen).min() >= total * (1 - 1e-6)


@pytest.mark.parametrize("objective", PlacementObjective)
@pytest.mark.parametrize(("n", "k", "count"), [(40, 4, 6), (3, 1, 3)])
def test_starts_differ_and_the_cheapest_is_first(objective, n, k, count):
    problem = problem_of(objective, n)
    found = starts(problem, k, 6, np.random.default_rng(0))
    assert found.shape == (count, k, 2)
    assert len({tuple(sorted(map(tuple, start))) for start in found.tolist()}) == count
    assert (np.diff(problem.cost(problem.distances(found).min(axis=1))) >= 0).all()
    assert {tuple(x) for x in found.reshape(-1, 2)} <= {tuple(x) for x in problem.points}


@pytest.mark.parametrize("objective", PlacementObjective)
def test_pulls_become_the_slopes_of_the_cost(objective):
    problem = problem_of(objective, n=30)
    weights = problem.weights / problem.weights.max()
    x = np.random.default_rng(1).random((2, 3, 2))
    given = problem.objective, problem.distance, jnp.asarray(problem.points), jnp.asarray(weights), jnp.asarray(x)
    nearest, pulls = nearest_and_pulls(*given, jnp.asarray(1e-5))

    def cost(x):
        return objective.over(weights * problem.distances(x).min(axis=1))

    np.testing.assert_allclose(objective.over(weights * np.asarray(nearest, float)), cost(x), rtol=1e-6)
    step = 1e-4  # all costs are linear up to the next kink
    for facility in range(3):
        for axis in range(2):
            change = np.zeros((3, 2))
            change[facility, axis] = step
            slope = (cost(x + change) - cost(x - change)) / (2 * step)
            np.testing.assert_allclose(np.asarray(pulls)[:, facility, axis], slope, atol=0.02)


def test_slopes_of_pairs():
    x, y = np.array([[0.2, 0.3], [0.5, 0.5]]), np.array([[0.4, 0.1], [0.1, 0.1]])
    distances, slopes = slopes_at(as_pytree(manhattan), x, y)
    np.testing.assert_allclose(distances, [0.4, 0.8], rtol=1e-6)
    assert slopes.tolist() == [[-1, 1], [1, 1]]


def test_steps_stay_in_free_space_and_slide_along_walls():
    workspace, rng = scenes.maze().workspace, np.random.default_rng(0)
    x = workspace.sample_free(2000, seed=0)
    step = rng.normal(0, 0.1, x.shape)
    end = moved(workspace, x, step)
    assert workspace.is_visible(x, end).all()
    is_free = workspace.is_visible(x, x + step)
    assert 0.2 < is_free.mean() < 0.9
    np.testing.assert_array_equal(end[is_free], (x + step)[is_free])
    # What is blocked never goes back, and mostly goes on.
    ahead = ((end - x) * step).sum(axis=1)[~is_free]
    assert (ahead >= 0).all() and (ahead > 0).mean() > 0.9
    assert (np.linalg.norm(end - x, axis=1) <= np.linalg.norm(step, axis=1) * (1 + 1e-12)).all()
    on_wall = moved(SQUARE, np.array([[0.5, 0.0]]), np.array([[0.1, -0.02]]))
    assert on_wall[0, 0] > 0.57 and on_wall[0, 1] >= 0
