from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from grid_helpers import drawn
from traced_helpers import random_levels, random_points

from plr_jax import VisibilityGraph, Workspace, grid_distance

FREE, GOALS = random_levels(2)
X = random_points(3)


def cell_centers(shape):
    return np.indices(shape)[::-1].reshape(2, -1).T + 0.5


CENTERS = cell_centers(FREE.shape[1:])


def truth(free, goal, x):
    return VisibilityGraph(Workspace.from_mask(free, tolerance=0), goal)(x)


@pytest.fixture(scope="module")
def exact():
    return [truth(f, g, np.vstack([CENTERS, x])) for f, g, x in zip(FREE, GOALS, X, strict=True)]


def both(free, goal, x):
    field = grid_distance(free, goal)
    return jnp.concatenate([field.cells.ravel(), field(x)])


def test_equals_the_visibility_graph_at_centers_and_anywhere(exact):
    np.testing.assert_allclose(jax.jit(jax.vmap(both))(FREE, GOALS, X), exact, atol=1e-5)


def test_pairs_equal_it_as_well_both_ways_round(exact):
    def pairs(free, goal, x):
        distances = grid_distance(free, None)
        return jnp.stack([distances(x, goal), distances(goal, x)])

    ours = np.asarray(jax.jit(jax.vmap(pairs))(FREE, GOALS, X))
    there = np.stack(exact)[:, len(CENTERS) :]
    np.testing.assert_allclose(ours, np.stack([there, there], axis=1), atol=1e-5)


@pytest.mark.full
def test_a_grid_whose_corners_have_fewer_places_equals_it_too():
    free, goals = random_levels(4, levels=4, size=18)
    x = random_points(5, levels=4, size=18)
    ours = jax.jit(jax.vmap(lambda f, g, x: grid_distance(f, g)(x)))(free, goals, x)
    np.testing.assert_allclose(ours, [truth(*each) for each in zip(free, goals, x, strict=True)], atol=2e-5)


def test_rows_wider_than_a_word():
    free = np.random.default_rng(6).random((5, 40)) > 0.2
    free[2, 2] = True
    x = np.random.default_rng(7).uniform((0, 0), (40, 5), (50, 2))
    np.testing.assert_allclose(grid_distance(free, [2.5, 2.5])(x), truth(free, [2.5, 2.5], x), atol=5e-5)


def test_a_grid_of_one_row():
    cells = jax.jit(lambda goal: grid_distance(drawn("..#."), goal).cells)(jnp.array([0.5, 0.5]))
    np.testing.assert_allclose(cells, [[0, 1, np.inf, np.inf]])


def test_more_corners_than_places_are_said_and_never_answered():
    free, x, goal = drawn(".....", ".#.#.", "....."), jnp.array([2.5, 2.5]), jnp.array([0.5, 0.5])

    @partial(jax.jit, static_argnums=0)
    def answers(max_corners):
        field, pairs = (grid_distance(free, end, max_corners=max_corners) for end in (goal, None))
        return field.is_complete, pairs.is_complete, jnp.append(field.cells.ravel(), pairs(x, goal))

    *are_complete, values = answers(7)
    assert not any(are_complete) and np.isnan(values).all()
    *are_complete, values = answers(8)
    assert all(are_complete)
    np.testing.assert_allclose(values, truth(free, goal, np.vstack([cell_centers(free.shape), x])), rtol=1e-6)


# Gradients.


@pytest.fixture
def in_doubles():
    with jax.enable_x64(True):
        yield


@pytest.mark.full
def test_gradients_are_differences(in_doubles):
    """But where paths are about to change: there differences on both sides differ."""
    step, spread = 1e-5, np.random.default_rng(8).uniform(0.05, 0.95, (2, len(FREE), 2))
    cells = np.stack([np.random.default_rng(9).permutation(np.argwhere(free))[:1].repeat(2, 0)[:2] for free in FREE])
    cells[:, 1] = [np.argwhere(free)[-1] for free in FREE]
    x, goals = (cells[:, k, ::-1] + spread[k] for k in range(2))
    value = jax.jit(jax.vmap(lambda free, x, goal: grid_distance(free, goal)(x)))
    gradient = jax.jit(jax.vmap(jax.grad(lambda free, x, goal: grid_distance(free, goal)(x), argnums=(1, 2))))
    center, ours, smooth = value(FREE, x, goals), gradient(FREE, x, goals), 0
    for axis in np.eye(2):
        for end in (0, 1):
            there, back = (
                value(FREE, x + s * axis * (end == 0), goals + s * axis * (end == 1)) for s in (step, -step)
            )
            is_smooth = np.isfinite(center) & (np.abs(there + back - 2 * center) < 1e-3 * step)
            smooth += is_smooth.sum()
            differences = np.where(is_smooth, (there - back) / (2 * step), 0)
            np.testing.assert_allclose(np.where(is_smooth, ours[end] @ axis, 0), differences, atol=1e-4)
    assert smooth > 2 * len(FREE)
    assert all(np.isfinite(each).all() for each in ours)
    assert not any(each[np.isinf(center)].any() for each in ours)


@pytest.mark.full
def test_gradients_of_pairs_are_those_to_a_goal(in_doubles):
    free = drawn(".....", ".###.", "...#.")
    x, y = jnp.array([0.3, 0.4]), jnp.array([4.5, 2.6])
    of_pairs = jax.grad(grid_distance(free, None), argnums=(0, 1))
    to_goal = jax.grad(lambda x, y: grid_distance(free, y)(x), argnums=(0, 1))
    ours, there = jax.jit(lambda x, y: (of_pairs(x, y), to_goal(x, y)))(x, y)
    np.testing.assert_allclose(ours, there)
    np.testing.assert_allclose(ours[1], (y - np.array([4, 1])) / np.hypot(0.5, 1.6))


@pytest.mark.full
def test_a_gradient_at_a_corner_is_that_of_its_own_path():
    """Around a block from (2, 2) to (4, 4): the points that paths go to first, and through last, by hand."""
    free, goal = jnp.ones((6, 6), bool).at[2:4, 2:4].set(False), jnp.array([1, 4.5])
    x = jnp.array([(2.0, 4.0), (2.0, 2.0), (4.0, 2.0), (5.0, 3.5)])  # three corners, two of which see the goal
    first = jnp.array([(1, 4.5), (1, 4.5), (2, 2), (4, 4)])
    last = jnp.array([(2, 4), (2, 2), (2, 2), (4, 4)])

    @jax.jit
    @partial(jax.vmap, in_axes=(0, None))
    def gradients(x, goal):
        pairs = grid_distance(free, None)
        to_goal = jax.grad(lambda x, goal: grid_distance(free, goal)(x), argnums=(0, 1))(x, goal)
        return to_goal, jax.grad(pairs, argnums=(0, 1))(x, goal), jax.grad(pairs, argnums=(1, 0))(goal, x)

    for of_x, of_goal in gradients(x, goal):
        np.testing.assert_allclose(of_x, (x - first) / np.hypot(*(x - first).T)[:, None], atol=1e-6)
        np.testing.assert_allclose(of_goal, (goal - last) / np.hypot(*(goal - last).T)[:, None], atol=1e-6)
