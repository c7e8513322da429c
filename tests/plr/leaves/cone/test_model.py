"""Cones of an oracle: small, exact, evaluated as cones, above other leaves within bounds, of sources in sight."""

import tracemalloc

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from piece_helpers import TEN, WORKSPACES, box, points_of, random_pieces
from plr_helpers import UNIT, leaf_by_search, points

from plr_jax import Box, BuildOptions, VisibilityGraph, Workspace, cyclic_axis, maximum_depth, scenes
from plr_jax.plr import construct
from plr_jax.plr._plr import leaf_of
from plr_jax.plr.leaves import leaf_model
from plr_jax.plr.leaves.cone import search


@pytest.fixture(scope="module")
def maze():
    """The oracle of a maze."""
    problem = scenes.maze()
    return VisibilityGraph(problem.workspace, problem.goals[0])


@pytest.fixture(scope="module")
def cones(maze):
    """Its cones in a kilobyte."""
    return construct(maze, UNIT, leaf="cone", max_bytes=1024)


def mean_error(plr, oracle, x):
    return np.abs(np.asarray(plr(x), float) - oracle(x)).mean()


def test_a_maze_in_a_kilobyte_less_and_of_fewer_leaves(cones, maze):
    x = maze.workspace.sample_free(20_000, 0)
    assert cones.num_bytes <= 1024 and mean_error(cones, maze, x) < 1e-6
    small, few = (construct(maze, UNIT, leaf="cone", **limit) for limit in ({"max_bytes": 260}, {"max_leaves": 20}))
    assert small.num_bytes <= 260 and few.num_leaves <= 20
    assert mean_error(small, maze, x) < 1e-5 < mean_error(few, maze, x) < 0.1


@pytest.mark.full
def test_a_leaf_among_clutter_takes_little_memory():
    """All pairs of 400 corners and the triangles of free space took a gigabyte, of more corners all there was."""
    free = np.ones((60, 60), bool)
    free[3::6, 3::6] = False
    workspace = Workspace.from_mask(free)
    oracle = VisibilityGraph(workspace, (1, 1))
    construct(oracle, workspace.bounds, max_leaves=1)
    tracemalloc.start()
    construct(oracle, workspace.bounds, leaf="cone", max_leaves=1)
    assert tracemalloc.get_traced_memory()[1] < 300e6
    tracemalloc.stop()


def test_a_query_is_the_cone_of_the_points_leaf_around_a_source_of_the_oracle(cones, maze):
    offset, apex = cones._coefficients[:, 0], cones._coefficients[:, 1:]
    away = np.linalg.norm(apex[:, None] - maze.sources.points, axis=2)
    np.testing.assert_allclose(away.min(axis=1), 0, atol=1e-7)
    np.testing.assert_allclose(offset, maze.sources.distances[away.argmin(axis=1)], atol=1e-6)
    x = points(1000, 0).astype(np.float32).astype(float)
    leaf = leaf_by_search(cones, x)
    leg = x - apex[leaf]
    length = np.hypot(*leg.T)
    np.testing.assert_allclose(np.asarray(cones(x)), offset[leaf] + length, atol=1e-6)
    np.testing.assert_allclose(cones.values_in_leaves(leaf, x), offset[leaf] + length, rtol=1e-14)
    gradient = np.asarray(jax.vmap(jax.grad(cones))(jnp.asarray(x, jnp.float32)))  # leads away from the source
    np.testing.assert_allclose(gradient[length > 0.01], (leg / length[:, None])[length > 0.01], atol=1e-4)


def test_the_gradient_is_zero_at_a_source():
    goal = jnp.array([0.25, 0.5])
    plr = construct(VisibilityGraph(Workspace(((0, 0), (1, 1))), goal), UNIT, leaf="cone", max_leaves=1)
    assert plr(goal) == 0
    np.testing.assert_array_equal(jax.grad(plr)(goal), [0, 0])
    assert np.isfinite(jax.grad(plr)(goal + 1e-7)).all()


def test_mean_planes_are_differences_of_the_cone(cones):
    lo, hi = cones.leaf_boxes
    center, width = (lo + hi) / 2, hi - lo

    def cone(x):
        return cones.values_in_leaves(np.arange(cones.num_leaves), x)

    for axis, step in enumerate(np.eye(2)[:, None] * width / 2):
        slope = (cone(center + step) - cone(center - step)) / width[:, axis]
        np.testing.assert_allclose(cones.slope[:, axis], slope, atol=1e-9)
    np.testing.assert_allclose(cones.intercept + (cones.slope * center).sum(axis=1), cone(center), atol=1e-9)


@pytest.mark.parametrize(("name", "terms"), [("cone", 3), ("plane", 3), ("continuous", 4), ("smooth", 16)])
def test_cones_are_above_leaves_within_their_bounds(name, terms):
    """Whatever a leaf holds: at random points of pieces in its box cones minus it are between what is proven."""
    leaf, rng = leaf_model(name), np.random.default_rng(3)
    pieces = random_pieces(rng, 60, 1.5)
    lo, hi = pieces.min(axis=2).T - rng.random((60, 2)), pieces.max(axis=2).T + rng.random((60, 2))
    coefficients = rng.normal(size=(60, terms)) + (np.array([0, 5, 5]) if name == "cone" else 0)
    apex, offset = rng.uniform(0, 10, (60, 2)), rng.normal(size=60)
    apex[::4] = pieces.mean(axis=2).T[::4]
    low, high = leaf.below_cones(lo, hi, coefficients, pieces, apex, offset)
    for x in points_of(rng, pieces, 400).swapaxes(0, 1):
        value = offset + np.linalg.norm(x - apex, axis=1) - leaf.values(lo, hi, coefficients, x)
        assert (low <= value + 1e-9).all() and (value <= high + 1e-9).all()
    assert (high - low < 40).all()


@pytest.mark.parametrize("kind", WORKSPACES)
def test_partitions_of_random_workspaces_tile_the_domain(kind):
    workspace = kind(np.random.default_rng(2))
    oracle = VisibilityGraph(workspace, workspace.sample_free(1, 0)[0])
    plr = construct(oracle, Box((-1, -1), (11, 11)), leaf="cone", max_leaves=50)
    assert 10 < plr.num_leaves <= 50
    leaf_by_search(plr, -1 + 12 * points(500, 0))
    x = workspace.sample_free(3000, 1)
    assert mean_error(plr, oracle, x[np.isfinite(oracle(x))]) < 0.2


def test_where_nothing_is_reached_and_for_too_few_bytes_the_construction_says_so(maze):
    oracle = VisibilityGraph(Workspace(TEN, [box(4, 0, 6, 10)]), (1, 5))
    with pytest.raises(ValueError, match="nothing reachable"):
        construct(oracle, ((7, 0), (10, 10)), leaf="cone")
    with pytest.raises(ValueError, match="max_bytes=20 is too small: one leaf takes"):
        construct(maze, UNIT, leaf="cone", max_bytes=20)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"distance_fn": lambda x: np.abs(x[:, 0])}, "Use leaf='continuous' for any other"),
        ({"domain": ((0, 0, 0), (1, 1, 1)), "distance_fn": lambda x: x[:, 0]}, "in 3 dimensions"),
        ({"options": BuildOptions(weight_fn=lambda x: 1 + x[:, 0])}, "or use leaf='continuous'"),
        ({"options": BuildOptions(should_split=maximum_depth)}, "or use leaf='continuous'"),
        ({"options": BuildOptions(split=cyclic_axis)}, "or use leaf='continuous'"),
    ],
)
def test_cones_are_not_found_from_samples(maze, options, message):
    with pytest.raises(ValueError, match=message):
        construct(**{"distance_fn": maze, "domain": UNIT, "leaf": "cone", "max_leaves": 9, **options})


@pytest.mark.parametrize("max_bytes", [261, 661])
def test_more_points_see_their_source_and_no_proof_is_worse(maze, max_bytes, monkeypatch):
    x, plrs = maze.workspace.sample_free(20_000, seed=0), []
    for choose in (search.sources_in_sight, lambda tree, options, fits: tree.source):
        monkeypatch.setattr(search, "sources_in_sight", choose)
        plrs.append(construct(maze, UNIT, leaf="cone", max_bytes=max_bytes, certified=True))
    plr, before = plrs
    assert plr.num_leaves == before.num_leaves and before.num_bytes <= max_bytes and plr.num_bytes <= max_bytes
    assert plr.max_error <= before.max_error * (1 + 1e-6)
    sources = (each.stored.sources.points[each.stored.source[leaf_of(each, x)]] for each in plrs)
    hidden, hidden_before = (1 - maze.workspace.is_visible(x, source).mean() for source in sources)
    assert hidden < 0.25 * hidden_before and mean_error(plr, maze, x) < 1.5 * mean_error(before, maze, x)


def test_only_as_many_changes_are_made_as_fit_and_none_where_all_is_in_sight(maze, monkeypatch):
    changes, choose = [], search.sources_in_sight

    def with_few(tree, options, fits):
        for most in (0, 3, 10**9):
            source = choose(tree, options, lambda source, most=most: (source != tree.source).sum() <= most)
            changes.append(np.where(source != tree.source, source, -1))
        return source

    monkeypatch.setattr(search, "sources_in_sight", with_few)
    construct(maze, UNIT, leaf="cone", max_leaves=200)
    none, few, many = changes
    assert [(each >= 0).sum() for each in (none, few)] == [0, 3] and (many >= 0).sum() > 5
    assert (few == many)[few >= 0].all()
    changes.clear()
    assert construct(VisibilityGraph(Workspace(UNIT), (0.1, 0.1)), UNIT, leaf="cone", max_bytes=128).num_leaves == 1
    assert (np.array(changes) < 0).all()
