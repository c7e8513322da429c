import jax
import jax.numpy as jnp
import numpy as np
import pytest
from piece_helpers import WORKSPACES, box, points_of, random_pieces
from plr_helpers import UNIT, leaf_by_search

from plr_jax import scenes
from plr_jax.geometry.box import Box
from plr_jax.geometry.workspace import Workspace
from plr_jax.oracles import VisibilityGraph
from plr_jax.plr import construct, from_bytes
from plr_jax.plr.leaves import leaf_model


@pytest.fixture(scope="module")
def maze():
    """The oracle of a maze."""
    problem = scenes.maze()
    return VisibilityGraph(problem.workspace, problem.goals[0])


@pytest.fixture(scope="module")
def cones(maze):
    """Its cones in a kilobyte."""
    return construct(maze, UNIT, leaf="cone", max_bytes=1024)


def test_a_maze_in_a_kilobyte(cones, maze):
    assert cones.num_bytes <= 1024
    x = maze.workspace.sample_free(20_000, 0)
    error = np.abs(np.asarray(cones(x), float) - maze(x))
    assert error.mean() < 1e-6


def test_more_bytes_err_less_and_fewer_leaves_are_kept(maze):
    x = maze.workspace.sample_free(5000, 0)
    small = construct(maze, UNIT, leaf="cone", max_bytes=260)
    few = construct(maze, UNIT, leaf="cone", max_leaves=20)
    assert small.num_bytes <= 260 and few.num_leaves <= 20
    of_few, of_small = (np.abs(np.asarray(plr(x), float) - maze(x)).mean() for plr in (few, small))
    assert of_small < 1e-5 < of_few < 0.1


def test_every_leaf_holds_a_cone_around_a_source_of_the_oracle(cones, maze):
    offset, apex = cones._coefficients[:, 0], cones._coefficients[:, 1:]
    away = np.linalg.norm(apex[:, None] - maze.sources.points, axis=2)
    np.testing.assert_allclose(away.min(axis=1), 0, atol=1e-7)
    np.testing.assert_allclose(offset, maze.sources.distances[away.argmin(axis=1)], atol=1e-6)


def test_a_query_is_the_cone_of_the_points_leaf(cones):
    x = np.random.default_rng(0).random((3000, 2)).astype(np.float32).astype(float)
    leaf = leaf_by_search(cones, x)
    offset, apex = cones._coefficients[leaf, 0], cones._coefficients[leaf, 1:]
    np.testing.assert_allclose(np.asarray(cones(x)), offset + np.hypot(*(x - apex).T), atol=1e-6)
    np.testing.assert_allclose(cones.values_in_leaves(leaf, x), offset + np.hypot(*(x - apex).T), rtol=1e-14)


def test_queries_under_jit_vmap_and_from_a_file_are_the_same(cones):
    x = jnp.asarray(np.random.default_rng(1).random((500, 2)), jnp.float32)
    np.testing.assert_allclose(jax.jit(cones)(x), cones(x), rtol=1e-6)
    np.testing.assert_allclose(jax.jit(lambda plr, x: plr(x))(cones, x), cones(x), rtol=1e-6)
    np.testing.assert_allclose(jax.vmap(cones)(x), cones(x), rtol=1e-6)
    again = from_bytes(cones.to_bytes())
    assert again.to_bytes() == cones.to_bytes()
    np.testing.assert_array_equal(again(x), cones(x))


def test_the_gradient_leads_away_from_the_source(cones):
    x = np.random.default_rng(2).random((300, 2)).astype(np.float32).astype(float)
    apex = cones._coefficients[leaf_by_search(cones, x), 1:]
    unit = (x - apex) / np.linalg.norm(x - apex, axis=1, keepdims=True)
    far = np.linalg.norm(x - apex, axis=1) > 0.01
    gradient = np.asarray(jax.vmap(jax.grad(cones))(jnp.asarray(x, jnp.float32)))
    np.testing.assert_allclose(gradient[far], unit[far], atol=1e-4)


def test_the_gradient_is_zero_at_a_source():
    plr = construct(VisibilityGraph(Workspace(((0, 0), (1, 1))), (0.25, 0.5)), UNIT, leaf="cone", max_leaves=1)
    goal = jnp.array([0.25, 0.5])
    assert plr(goal) == 0
    np.testing.assert_array_equal(jax.grad(plr)(goal), [0, 0])
    assert np.isfinite(jax.grad(plr)(goal + 1e-7)).all()


def test_mean_planes_are_differences_of_the_cone(cones):
    lo, hi = cones.leaf_boxes
    offset, apex = cones._coefficients[:, 0], cones._coefficients[:, 1:]

    def cone(x):
        return offset + np.hypot(*(x - apex).T)

    center, width = (lo + hi) / 2, hi - lo
    for axis in range(2):
        step = np.eye(2)[axis] * width[:, axis, None] / 2
        np.testing.assert_allclose(
            cones.slope[:, axis], (cone(center + step) - cone(center - step)) / width[:, axis], atol=1e-9
        )
    np.testing.assert_allclose(cones.intercept + (cones.slope * center).sum(axis=1), cone(center), atol=1e-9)


@pytest.mark.parametrize("name", ["cone", "plane", "continuous", "smooth"])
def test_cones_are_above_leaves_within_their_bounds(name):
    """Whatever a leaf holds: at random points of pieces in its box cones minus it are between what is proven."""
    model, rng = leaf_model(name), np.random.default_rng(3)
    pieces = random_pieces(rng, 60, 1.5)
    lo, hi = pieces.min(axis=2).T - rng.random((60, 2)), pieces.max(axis=2).T + rng.random((60, 2))
    terms = {"cone": 3, "plane": 3, "continuous": 4, "smooth": 16}[name]
    coefficients = rng.normal(size=(60, terms))
    if name == "cone":
        coefficients[:, 1:] += 5
    apex, offset = rng.uniform(0, 10, (60, 2)), rng.normal(size=60)
    apex[::4] = pieces.mean(axis=2).T[::4]
    low, high = model.below_cones(lo, hi, coefficients, pieces, apex, offset)
    x = points_of(rng, pieces, 400)
    above = offset[:, None] + np.linalg.norm(x - apex[:, None], axis=2)
    for k in range(400):
        value = above[:, k] - model.values(lo, hi, coefficients, x[:, k])
        assert (low <= value + 1e-9).all() and (value <= high + 1e-9).all()
    assert (high - low < 40).all()


@pytest.mark.parametrize("kind", WORKSPACES)
def test_partitions_of_random_workspaces_tile_the_domain(kind):
    workspace = kind(np.random.default_rng(2))
    oracle = VisibilityGraph(workspace, workspace.sample_free(1, 0)[0])
    plr = construct(oracle, Box((-1, -1), (11, 11)), leaf="cone", max_leaves=50)
    assert 10 < plr.num_leaves <= 50
    leaf_by_search(plr, -1 + 12 * np.random.default_rng(0).random((500, 2)))
    x = workspace.sample_free(3000, 1)
    x = x[np.isfinite(oracle(x))]
    assert np.abs(np.asarray(plr(x), float) - oracle(x)).mean() < 0.2


def test_where_nothing_is_reached_the_construction_says_so():
    oracle = VisibilityGraph(Workspace(((0, 0), (10, 10)), [box(4, 0, 6, 10)]), (1, 5))
    with pytest.raises(ValueError, match="nothing reachable"):
        construct(oracle, ((7, 0), (10, 10)), leaf="cone")


def test_a_budget_too_small_for_one_leaf_is_refused(maze):
    with pytest.raises(ValueError, match="max_bytes=20 is too small: one leaf takes"):
        construct(maze, UNIT, leaf="cone", max_bytes=20)
