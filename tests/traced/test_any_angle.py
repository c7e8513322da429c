"""Any-angle paths on traced grids, compared with the visibility graph of the same map."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from grid_helpers import drawn
from traced_helpers import LEVELS, all_levels, answers, random_levels, random_points

from plr_jax import VisibilityGraph, Workspace, grid_distance

STEP = 1e-5


def truth(free, goal, x):
    return VisibilityGraph(Workspace.from_mask(free, tolerance=0), goal)(x)


def cell_centers(shape):
    return np.indices(shape)[::-1].reshape(2, -1).T + 0.5


@pytest.fixture(scope="module")
def exact():
    """Return exact distances of random levels: of cells; of points, also moved along both axes."""
    free, goals, x = (each[:LEVELS] for each in all_levels())
    shifts = STEP * np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)])[:, None]
    centers = cell_centers(free.shape[1:])
    found = [
        truth(f, g, np.concatenate([centers, *(each + shifts)]))
        for f, g, each in zip(free, goals, x.astype(float), strict=True)
    ]
    cells, points = np.split(np.stack(found), [len(centers)], axis=1)
    return cells.reshape(free.shape), points.reshape(LEVELS, 5, -1)


def test_distances_equal_the_visibility_graph(exact):
    _, cells, distances, _ = answers("any-angle")
    np.testing.assert_allclose(cells[:LEVELS], exact[0], atol=1e-5)
    np.testing.assert_allclose(distances[:LEVELS], np.stack([exact[1][:, 0]] * 3, axis=1), atol=1e-5)


def test_gradients_equal_differences_of_exact_distances(exact):
    center, *ends = exact[1].swapaxes(0, 1)
    gradients, smooth = np.asarray(answers("any-angle")[3][0])[:LEVELS], 0
    for axis, (ahead, behind) in enumerate((ends[:2], ends[2:])):
        with np.errstate(invalid="ignore"):
            is_smooth = np.isfinite(center) & (np.abs(ahead + behind - 2 * center) < 1e-3 * STEP)
            differences = (ahead - behind) / (2 * STEP)
        np.testing.assert_allclose(gradients[..., axis][is_smooth], differences[is_smooth], atol=2e-3)
        smooth += is_smooth.sum()
    assert smooth > center.size / 2 and not gradients[np.isinf(center)].any()


# Around a block from (2, 1) to (4, 3): three of its corners, two of which see the goal, and a point.
BLOCK_X = np.array([(2, 3), (2, 1), (4, 1), (5, 2.5)])
FIRST_TURN, LAST_TURN, BLOCK_GOAL = [(1, 3.5), (1, 3.5), (2, 1), (4, 3)], [(2, 3), (2, 1), (2, 1), (4, 3)], (1, 3.5)


def unit(vectors):
    return vectors / np.hypot(*vectors.T)[:, None]


def test_gradient_at_a_corner_follows_the_path_of_that_corner():
    of_x, of_goal = (gradient[LEVELS] for gradient in answers("any-angle")[3])
    np.testing.assert_allclose(of_x[:4], unit(BLOCK_X - FIRST_TURN), atol=1e-6)
    # The points are repeated ten times.
    np.testing.assert_allclose(of_goal, 10 * unit(np.subtract(BLOCK_GOAL, LAST_TURN)).sum(axis=0), atol=1e-4)


@pytest.mark.full
def test_second_derivatives_follow_the_same_path():
    free, goal = all_levels()[0][LEVELS], np.array(BLOCK_GOAL)
    hessian = jax.jit(jax.vmap(jax.hessian(lambda x: grid_distance(free, jnp.array(BLOCK_GOAL))(x) ** 2)))
    u, r, d = unit(BLOCK_X - FIRST_TURN), np.hypot(*(BLOCK_X - FIRST_TURN).T), truth(free, goal, BLOCK_X)
    # The distance d = |x - turn| + const has the gradient u and the Hessian (I - u u') / r.
    along = u[:, :, None] * u[:, None]
    expected = 2 * (along + (d / r)[:, None, None] * (np.eye(2) - along))
    np.testing.assert_allclose(hessian(jnp.asarray(BLOCK_X, jnp.float32)), expected, atol=1e-5)


def test_gradient_in_goal_passes_many_corners():
    free, goal, x = (each[LEVELS + 1] for each in all_levels())
    x, goal = x.astype(float), goal.astype(float)
    ahead, behind = ([truth(free, goal + step, x).sum() for step in sign * np.eye(2)] for sign in (STEP, -STEP))
    expected = np.subtract(ahead, behind) / (2 * STEP)
    np.testing.assert_allclose(answers("any-angle")[3][1][LEVELS + 1], expected, atol=1e-2)


@pytest.mark.full
def test_gradients_of_pairs_follow_first_and_last_turns():
    def gradients(x):
        pairs, goal = grid_distance(all_levels()[0][LEVELS], None), jnp.array(BLOCK_GOAL)
        return jax.grad(pairs, argnums=(0, 1))(x, goal), jax.grad(pairs, argnums=(1, 0))(goal, x)

    for of_x, of_goal in jax.jit(jax.vmap(gradients))(jnp.asarray(BLOCK_X, jnp.float32)):
        np.testing.assert_allclose(of_x, unit(BLOCK_X - FIRST_TURN), atol=1e-6)
        np.testing.assert_allclose(of_goal, unit(np.subtract(BLOCK_GOAL, LAST_TURN)), atol=1e-6)


@pytest.mark.full
def test_fewer_places_than_lattice_corners_suffice():
    free, goals = random_levels(4, levels=4, shape=(18, 18))
    x = random_points(5, levels=4, shape=(18, 18))
    x[0] = cell_centers((18, 18))[:: 324 // len(x[0])][: len(x[0])]

    def answers(free, goal, x):
        field = grid_distance(free, goal)
        return field(x), field.cells

    distances, cells = jax.jit(jax.vmap(answers))(free, goals, x)
    np.testing.assert_allclose(distances, [truth(*each) for each in zip(free, goals, x, strict=True)], atol=2e-5)
    np.testing.assert_allclose(cells[0].ravel()[:: 324 // len(x[0])][: len(x[0])], distances[0], atol=2e-5)


def test_a_grid_of_one_row():
    cells = jax.jit(lambda goal: grid_distance(drawn("..#."), goal).cells)(jnp.array([0.5, 0.5]))
    np.testing.assert_allclose(cells, [[0, 1, np.inf, np.inf]])


def test_rows_wider_than_a_word_and_more_corners_than_places():
    free = np.random.default_rng(6).random((3, 40)) > 0.05
    free[1, 2] = True
    blocked = ~np.pad(free, 1, constant_values=True)  # beyond the grid no corner is inside
    around = sum(np.roll(blocked, shift, (0, 1))[2:-1, 2:-1].astype(int) for shift in np.ndindex(2, 2))
    number, x = (around == 1).sum(), np.random.default_rng(7).uniform((0, 0), (40, 3), (50, 2))

    @partial(jax.jit, static_argnums=0)
    def answers(max_corners):
        field, pairs = (grid_distance(free, goal, max_corners=max_corners) for goal in ([2.5, 1.5], None))
        return field.is_complete, pairs.is_complete, field(x)

    *are_complete, distances = answers(int(number))
    assert all(are_complete) and distances[np.isfinite(distances)].max() > 32
    np.testing.assert_allclose(distances, truth(free, [2.5, 1.5], x), atol=5e-5)
    *are_complete, distances = answers(int(number) - 1)
    assert not any(are_complete) and np.isnan(distances).all()
