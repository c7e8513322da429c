"""Domains far from the origin: coordinates as of UTM, and farther than 32-bit floats resolve."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from plr_jax import Box, Euclidean, VisibilityGraph, Workspace, construct, construct_pairs, evaluate, scenes, stack

UTM, FARTHER = np.array([5e5, 4e6]), np.array([1e8 + 1, -3e9 + 5])
REFUSED = "so far from the origin that float32 points.*Give NumPy's float64 points.*enable jax_enable_x64"


def maze(origin, width):
    problem = scenes.maze()
    walls = [origin + width * np.array(wall.exterior.coords) for wall in problem.workspace.obstacles]
    workspace = Workspace((origin, origin + width), walls)
    return workspace, VisibilityGraph(workspace, origin + width * problem.goals[0])


def mean_error(found, true):
    return np.abs(np.asarray(found, np.float64) - true).mean()


@pytest.mark.parametrize(
    ("leaf", "origin"),
    [("plane", UTM), ("smooth", UTM), ("cone", UTM), ("continuous", [1e8] * 2), ("cone", [1e8] * 2)],
)
def test_64_bit_points_keep_what_the_origin_has(leaf, origin):
    (here, oracle), (there, moved) = maze(np.zeros(2), 2000.0), maze(np.array(origin), 2000.0)
    options = {"leaf": leaf, "max_leaves": 100, "certified": True}
    near, far = construct(oracle, here.bounds, **options), construct(moved, there.bounds, **options)
    x = here.sample_free(3000, 0)
    distance, y = oracle(x), x + origin
    error = mean_error(near(x), distance)
    assert mean_error(far(y), distance) < 1.02 * error
    assert mean_error(stack([far, far])(np.ones(len(x), int), y), distance) < 1.02 * error
    assert far.max_error < 1.02 * near.max_error
    lower, upper = (np.asarray(bound, np.float64) for bound in far.bounds(y))
    assert (lower <= distance).all() and (distance <= upper).all() and (upper - lower).max() < 3 * far.max_error
    if origin is UTM and leaf == "cone":  # in double precision on the host, and under jit about the rounded points
        for compiled in (far(jnp.asarray(y)), jax.jit(far)(y)):
            np.testing.assert_allclose(compiled, far(y.astype(np.float32).astype(np.float64)), atol=2e-3)


@pytest.mark.full
def test_under_jit_what_is_proven_holds_in_64_bits():
    """As the documentation says: in 32 bits it is about rounded points, which are elsewhere."""
    there, oracle = maze(UTM, 200.0)
    far = construct(oracle, there.bounds, leaf="cone", max_bytes=1000, certified=True)
    x = there.sample_free(2000, 0)
    distance, clearance = oracle(x), there.clearance(x)

    def holds(points):
        lower, upper = (np.asarray(bound, np.float64) for bound in jax.jit(far.bounds)(points))
        return (lower <= distance) & (distance <= upper)

    def clearance_error(points):
        return np.abs(np.asarray(jax.jit(there.clearance)(points)) - clearance).max()

    assert not holds(x).all() and 0.01 < clearance_error(x) < 0.5
    with jax.enable_x64(True):
        assert holds(x).all() and clearance_error(x) < 1e-6


def test_where_32_bits_tell_no_places_apart_64_bits_do_and_others_are_refused():
    near, farther = (
        construct(Euclidean(lo + 0.3), Box(lo, lo + 2), leaf="continuous", max_leaves=100)
        for lo in (0 * UTM, FARTHER)
    )
    x = np.random.default_rng(0).integers(0, 2**20, (1000, 2)) / 2**19  # which stay exact when moved
    np.testing.assert_allclose(farther(x + FARTHER), near(x), atol=1e-3)
    np.testing.assert_allclose(stack([farther])(0, x + FARTHER), near(x), atol=1e-3)
    beside = np.array([[-0.1, 1], [2.1, 1], [1, -0.1], [1, 2.1]])
    assert np.isinf(farther(beside + FARTHER)).all()
    assert np.isfinite(farther(np.array([[0, 0], [2, 2], [0, 2]]) + FARTHER)).all()
    assert evaluate(farther, beside[0] + FARTHER, outside="clamp") < 1.5
    x, stacked = np.full((3, 2), FARTHER + 1), stack([farther])
    for call in (
        lambda: farther(jnp.asarray(x)),
        lambda: farther(x.astype(np.float32)),
        lambda: jax.jit(farther)(x),
        lambda: jax.jit(lambda plr, x: plr(x))(farther, x),
        lambda: jax.grad(farther)(jnp.asarray(x[0])),
        lambda: jax.vmap(farther)(jnp.asarray(x)),
        lambda: stacked(0, jnp.asarray(x)),
        lambda: jax.jit(stacked)(0, x),
    ):
        with pytest.raises(ValueError, match=REFUSED):
            call()
    with jax.enable_x64(True):
        np.testing.assert_allclose(farther(jnp.asarray(x)), 0.7 * np.sqrt(2), atol=0.02)


@pytest.mark.full
def test_farther_than_64_bits_with_tables_of_32():
    far = np.full(2, 1e13)
    plr = construct(Euclidean(far + 1), Box(far, far + 2), max_leaves=20)
    np.testing.assert_allclose(plr(far + np.array([1, 2])), 1, atol=0.05)
    with jax.enable_x64(True), pytest.raises(ValueError, match=r"float64 points, or 32-bit tables.*build it in"):
        plr(jnp.asarray(far + 1))


@pytest.mark.full
def test_pairs_far_away():
    wall, origin = np.array([(0.9, 0.5), (1.1, 0.5), (1.1, 1.5), (0.9, 1.5)]), np.full(2, 1e8 + 1)
    near, far = (construct_pairs(Workspace((lo, lo + 2), [lo + wall]), max_bytes=500) for lo in (np.zeros(2), origin))
    x, y = np.random.default_rng(0).uniform([[[0, 0]], [[1.15, 0]]], [[[0.8, 2]], [[2, 2]]], (2, 200, 2))
    np.testing.assert_allclose(far(x + origin, y + origin), near(x, y), atol=1e-4)  # as fine as workspaces are there
    with pytest.raises(ValueError, match=REFUSED):
        far(jnp.asarray(x + origin), jnp.asarray(y + origin))
    with jax.enable_x64(True):
        np.testing.assert_allclose(far(jnp.asarray(x + origin), jnp.asarray(y + origin)), near(x, y), atol=1e-4)


def test_a_stack_of_near_and_far_ones():
    near = construct(Euclidean((0.3, 0.3)), Box((0, 0), (2, 2)), max_leaves=30)
    far = construct(Euclidean(UTM + 0.3), Box(UTM, UTM + 2000), max_leaves=30)
    x = np.random.default_rng(0).uniform(0, 2, (100, 2))
    stacked, index = stack([near, far]), np.arange(100) % 2
    points = np.where(index[:, None] == 1, UTM + 1000 * x, x)
    expected = np.where(index == 1, far(points), near(points))
    np.testing.assert_allclose(stacked(index, points), expected, rtol=1e-6)
    np.testing.assert_array_equal(np.isnan(stacked([0, 2, -1], x[:3])), [False, True, True])
    by_jit = jax.jit(lambda stacked, x: stacked(index, x))(stacked, points)
    np.testing.assert_allclose(by_jit, expected, atol=0.5)
