"""Domains with periodic axes, and far from the origin."""

import itertools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from plr_helpers import INDEPENDENT, LINEAR, UNIT

from plr_jax import Box, BuildOptions, Euclidean, VisibilityGraph, Workspace, scenes
from plr_jax.plr import certify, construct, evaluate, from_bytes, stack
from plr_jax.plr._file import encode

# PLRs of domains with periodic axes, such as angles: no seam anywhere.


PI = np.pi
PERIOD = np.array([2 * PI, 0.0])
CYLINDER = Box((-PI, 0), (PI, 2), periodic=(True, False))
FAR = Box((1e6, 0), (1e6 + 2 * PI, 2), periodic=(True, False))
GOAL = np.array([2.5, 0.4])


def around(domain, goal, x):
    """Return the distance to the nearest of all images of a goal that are at most a period away."""
    turns = itertools.product(*[(-1, 0, 1) if periodic else (0,) for periodic in domain.periodic])
    return np.min([np.linalg.norm(x - goal - np.array(turn) * domain.width, axis=1) for turn in turns], axis=0)


def on_cylinder(x):
    return around(CYLINDER, GOAL, x)


def inside(domain, n, seed=0):
    return np.random.default_rng(seed).uniform(domain.lo, domain.hi, (n, domain.dim))


def at_seam(n=200):
    """Return points at the lower end of the angle."""
    return np.column_stack([np.full(n, -PI), np.linspace(0, 2, n)])


SLOW = {"continuous": pytest.mark.full}


@pytest.fixture(scope="module", params=[pytest.param(leaf, marks=SLOW.get(leaf, ())) for leaf in LINEAR])
def plr(request):
    return construct(on_cylinder, CYLINDER, leaf=request.param, max_leaves=150)


def test_both_ends_of_a_periodic_axis_have_equal_values(plr):
    x = at_seam()
    expected = np.asarray(plr(x))
    for turns in (1, 5, -3):
        np.testing.assert_array_equal(plr(x + turns * PERIOD), expected)
    upper = jnp.asarray(x + PERIOD, jnp.float32)
    for answer in (plr(upper), jax.jit(plr)(upper)):
        np.testing.assert_array_equal(answer, expected)
    if plr.leaf.name == "smooth":
        return  # in 64 bits, the wrap is that of planes
    with jax.enable_x64(True):
        twin = from_bytes(plr.to_bytes())
        np.testing.assert_allclose(jax.jit(twin)(jnp.asarray(x + PERIOD)), twin(x), atol=1e-9)
        is_near = np.abs(np.asarray(twin(x + 10 * PERIOD)) - np.asarray(twin(x))) < 1e-9
        assert is_near.mean() > (0.99 if plr.leaf.name in INDEPENDENT else 0.9999)


def test_tied_leaves_and_gradients_are_continuous_at_the_seam(plr):
    """If the axis is not periodic, values jump there."""
    x, step, leaf = at_seam(), np.array([1e-6, 0.0]), plr.leaf.name
    gradient = jax.jit(jax.vmap(jax.grad(plr)))
    y = jnp.asarray(inside(CYLINDER, 200), jnp.float32)
    np.testing.assert_allclose(gradient(y + jnp.array([4 * PI, 0])), gradient(y), atol=2e-3)
    assert (np.abs(np.asarray(gradient(y))).max(axis=1) > 0.1).all()
    if leaf in INDEPENDENT:
        return
    below, above = (np.asarray(plr((x + sign * step).astype(np.float32))) for sign in (-1, 1))
    assert np.abs(above - below).max() < 2e-5
    flat = construct(on_cylinder, Box(CYLINDER.lo, CYLINDER.hi), leaf=leaf, max_leaves=150)
    assert np.abs(np.asarray(flat(x)) - np.asarray(flat(x + PERIOD))).max() > 1e-3
    if leaf == "smooth":
        sides = (np.asarray(gradient(jnp.asarray(x + sign * step))) for sign in (-1, 1))
        np.testing.assert_allclose(*sides, atol=1e-3)


@pytest.mark.parametrize(
    ("domain", "goal", "most", "leaf"),
    [
        (CYLINDER, GOAL, 0.006, "plane"),
        (Box((-PI, 0), (PI, 1), periodic=(True, True)), GOAL, 0.006, "smooth"),
        (Box((0, 0, -PI), (1, 1, PI), periodic=(False, False, True)), np.array([0.3, 0.6, 3.0]), 0.05, "continuous"),
        (FAR, np.array([1e6 + 6.1, 0.4]), 0.01, "continuous"),  # points are wrapped in 64 bits
    ],
)
def test_periodic_distances_equal_brute_force(domain, goal, most, leaf):
    def distance(x):
        assert (~np.array(domain.periodic) | ((domain.lo <= x) & (x <= domain.hi))).all()
        return around(domain, goal, x)

    options = BuildOptions(margin=0.3 if leaf == "plane" else 0)
    plr = construct(distance, domain, leaf=leaf, max_leaves=200 * domain.dim, options=options)
    x = inside(domain, 500)
    away = x + np.random.default_rng(1).integers(-3, 4, x.shape) * domain.width * domain.periodic
    assert np.abs(np.asarray(plr(away)) - around(domain, goal, x)).mean() < most
    np.testing.assert_allclose(plr(away), plr(x), atol=2e-5 if leaf != "plane" else 8 * most)
    np.testing.assert_array_equal(plr.numpy().leaf(away), plr.numpy().leaf(domain.wrapped(away)))
    seam = np.where(domain.periodic, domain.lo, x)
    np.testing.assert_array_equal(plr(seam + domain.width * domain.periodic), plr(seam))


def test_values_do_not_blend_across_a_wall_at_the_seam():
    def distance(x):
        return np.where(np.abs(x[:, 0]) > PI - 0.1, np.inf, np.linalg.norm(x - GOAL, axis=1))

    plr = construct(distance, CYLINDER, leaf="continuous", max_leaves=150)
    for angle in (-PI + 0.11, PI - 0.11):
        x = np.stack([np.full(50, angle), np.linspace(0, 2, 50)], axis=1)
        np.testing.assert_allclose(plr(x), distance(x), atol=0.05)


def test_cones_and_proofs_of_periodic_domains_raise():
    with pytest.raises(ValueError, match="Leaves of kind 'cone' need Euclidean distances"):
        construct(Euclidean(GOAL), CYLINDER, leaf="cone")
    oracle = VisibilityGraph(Workspace(UNIT), (0.5, 0.5))
    cones = construct(oracle, UNIT, leaf="cone", max_leaves=5)
    domain = Box((0, 0), (1, 1), periodic=(True, False))
    with pytest.raises(ValueError, match="Use continuous leaves or planes"):
        from_bytes(encode(replace(cones._contents, domain=domain)))
    with pytest.raises(ValueError, match="A proof needs Euclidean distances, without periodic axes"):
        construct(oracle, domain, certified=True)
    with pytest.raises(ValueError, match="Build the PLR without a proof"):
        certify(construct(oracle, domain, max_leaves=10), oracle)


# Domains far from the origin: coordinates as of UTM, and farther than 32-bit floats resolve.


UTM, FARTHER = np.array([5e5, 4e6]), np.array([1e8 + 1, -3e9 + 5])


def maze(origin, width):
    problem = scenes.maze()
    walls = [origin + width * np.array(wall.exterior.coords) for wall in problem.workspace.obstacles]
    workspace = Workspace((origin, origin + width), walls)
    return workspace, VisibilityGraph(workspace, origin + width * problem.goals[0])


def mean_error(found, true):
    return np.abs(np.asarray(found, np.float64) - true).mean()


@pytest.mark.parametrize(("leaf", "origin"), [("plane", UTM), ("cone", UTM), ("continuous", [1e8] * 2)])
def test_64_bit_points_are_as_exact_far_away_as_at_the_origin(leaf, origin):
    (here, oracle), (there, moved) = maze(np.zeros(2), 2000.0), maze(np.array(origin), 2000.0)
    options = {"leaf": leaf, "max_leaves": 60, "certified": True}
    near, far = construct(oracle, here.bounds, **options), construct(moved, there.bounds, **options)
    x = here.sample_free(1000, 0)
    distance, y = oracle(x), x + origin
    error = mean_error(near(x), distance)
    assert mean_error(far(y), distance) < 1.02 * error
    assert mean_error(stack([far, far])(np.ones(len(x), int), y), distance) < 1.02 * error
    assert far.max_error < 1.02 * near.max_error
    lower, upper = (np.asarray(bound, np.float64) for bound in far.bounds(y))
    assert (lower <= distance).all() and (distance <= upper).all() and (upper - lower).max() < 3 * far.max_error
    if leaf == "cone":  # in double precision on the host, and under jit about the rounded points
        for compiled in (far(jnp.asarray(y)), jax.jit(far)(y)):
            np.testing.assert_allclose(compiled, far(y.astype(np.float32).astype(np.float64)), atol=2e-3)
        with jax.enable_x64(True):
            lower, upper = map(np.asarray, jax.jit(far.bounds)(y))
        assert ((lower <= distance) & (distance <= upper)).all()


def test_32_bit_points_that_are_too_coarse_raise():
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
    of_tables = jax.jit(lambda plr, x: plr(x))
    for call in (
        lambda: farther(jnp.asarray(x)),
        lambda: farther(x.astype(np.float32)),
        lambda: of_tables(farther, x),
        lambda: jax.grad(farther)(jnp.asarray(x[0])),
        lambda: stacked(0, jnp.asarray(x)),
        lambda: jax.jit(stacked)(0, x),
    ):
        with pytest.raises(ValueError, match=r"float32 points.*too coarse.*float64 points.*enable jax_enable_x64"):
            call()
    with jax.enable_x64(True):
        np.testing.assert_allclose(farther(jnp.asarray(x)), 0.7 * np.sqrt(2), atol=0.02)


def test_tables_too_coarse_for_64_bit_points_raise():
    far = np.full(2, 1e13)
    plr = construct(Euclidean(far + 1), Box(far, far + 2), max_leaves=20)
    np.testing.assert_allclose(plr(far + np.array([1, 2])), 1, atol=0.05)
    with jax.enable_x64(True), pytest.raises(ValueError, match=r"float64 points, or 32-bit tables.*build the PLR in"):
        plr(jnp.asarray(far + 1))


def test_stacks_hold_near_and_far_domains():
    near = construct(Euclidean((0.3, 0.3)), Box((0, 0), (2, 2)), max_leaves=30)
    far = construct(Euclidean(UTM + 0.3), Box(UTM, UTM + 2000), max_leaves=30)
    x = np.random.default_rng(0).uniform(0, 2, (100, 2))
    stacked, index = stack([near, far]), np.arange(100) % 2
    points = np.where(index[:, None] == 1, UTM + 1000 * x, x)
    expected = np.where(index == 1, far(points), near(points))
    np.testing.assert_allclose(stacked(index, points), expected, rtol=1e-6)
    np.testing.assert_array_equal(np.isnan(stacked([0, 2, -1], x[:3])), [False, True, True])
