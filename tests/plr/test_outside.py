"""What a query answers outside the domain."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from plr_jax import (
    Box,
    Euclidean,
    ReedsShepp,
    VisibilityGraph,
    construct,
    construct_pairs,
    evaluate,
    scenes,
    stack,
)

PLANE = Box((-1.3, 2.2), (3, 5))
FAR = Box((5e5 - 1300, 4e6 + 2200), (5e5 + 3000, 4e6 + 5000))
FAR_CAR = Box((1e5 - 3, -4, -np.pi), (1e5 + 4, 4, np.pi), periodic=(False, False, True))
CASES = {  # readers without JAX are held against what is compiled for PLRs of all kinds
    "continuous": (Euclidean((0, 3)), PLANE, "continuous"),
    "far": (Euclidean((5e5, 4e6 + 3300)), FAR, "plane"),
    "folded, far": (ReedsShepp((1e5, 0.5, 0.4), 1), FAR_CAR, "continuous"),
}


@pytest.fixture(scope="module", params=[*CASES, "cone"])
def plr(request):
    if request.param == "cone":
        return cones()
    oracle, domain, leaf = CASES[request.param]
    return construct(oracle, domain, leaf=leaf, max_leaves=60)


def cones():
    problem = scenes.maze()
    oracle = VisibilityGraph(problem.workspace, problem.goals[0])
    return construct(oracle, problem.workspace.bounds, leaf="cone", max_bytes=512)


def around(domain, n=500, seed=0):
    """Points of a box three times as wide, half of them outside along some axis or other."""
    rng = np.random.default_rng(seed)
    return rng.uniform(domain.lo - domain.width, domain.hi + domain.width, (n, domain.dim))


def clamped(domain, x):
    """The nearest point of the domain, and how far it is."""
    nearest = np.where(domain.periodic, x, np.clip(x, domain.lo, domain.hi))
    return nearest, np.linalg.norm(x - nearest, axis=-1)


def test_clamped_is_the_value_at_the_nearest_point_and_the_way_there(plr):
    x = around(plr.domain)
    nearest, way = clamped(plr.domain, x)
    assert 50 < (way > 0).sum() < len(x)
    value = plr(x, outside="clamp")
    assert np.isfinite(value).all()
    inset = plr.domain.lo + np.clip((nearest - plr.domain.lo) / plr.domain.width, 1e-5, 1 - 1e-5) * plr.domain.width
    inset = np.where(plr.domain.periodic, nearest, inset)  # from where rounding does not lead outside
    expected = np.asarray(plr(inset), np.float64) + way
    close = np.isclose(value, expected, rtol=1e-5, atol=1e-3 * plr.domain.width.max())
    assert close.mean() > 0.97  # the others are beside a face across which the function jumps
    np.testing.assert_array_equal(evaluate(plr, x, outside="clamp"), value)


@pytest.mark.parametrize("outside", ["clamp", "nan"])
def test_inside_nothing_changes(plr, outside):
    x = around(plr.domain)
    ends = np.stack([plr.domain.lo, plr.domain.hi])
    x = np.concatenate([x[clamped(plr.domain, x)[1] == 0], ends])
    np.testing.assert_array_equal(plr(x, outside=outside), plr(x))
    single = jnp.asarray(x, jnp.float32)
    inside = np.isfinite(plr(single))
    np.testing.assert_array_equal(plr(single, outside=outside)[inside], plr(single)[inside])


def test_nan_is_where_inf_was(plr):
    x = around(plr.domain)
    is_outside = clamped(plr.domain, x)[1] > 0
    np.testing.assert_array_equal(np.isnan(plr(x, outside="nan")), is_outside)
    np.testing.assert_array_equal(np.isinf(plr(x)), is_outside)


@pytest.mark.parametrize("outside", ["inf", "clamp", "nan"])
def test_numbers_that_are_not_finite(plr, outside):
    middle = (plr.domain.lo + plr.domain.hi) / 2
    first = np.eye(plr.dim)[0] > 0
    x = np.array([np.where(first, bad, middle) for bad in (np.nan, np.inf, -np.inf)])
    expected = [np.nan] + 2 * [np.nan if outside == "nan" else np.inf]
    for points in (x, jnp.asarray(x)):
        np.testing.assert_array_equal(plr(points, outside=outside), expected)
    gradient = jax.vmap(jax.grad(lambda x: plr(x, outside=outside)))(jnp.asarray(x[1:]))
    np.testing.assert_array_equal(gradient, np.zeros_like(gradient))


def test_the_gradient_leads_back(plr):
    """Along axes that a point is outside of it is the unit vector away from the domain, else the function's own."""
    x = jnp.asarray(around(plr.domain), jnp.float32)
    ask = partial(plr, outside="clamp")
    gradient = np.asarray(jax.jit(jax.vmap(jax.grad(ask)))(x))
    assert np.isfinite(gradient).all()
    exact = np.asarray(x, np.float64)
    nearest, way = clamped(plr.domain, exact)
    beyond = np.abs(exact - nearest) > 1e-3 * plr.domain.width
    outward = (exact - nearest) / np.maximum(way, 1e-9)[:, None]
    np.testing.assert_allclose(gradient[beyond], outward[beyond], atol=1e-2)
    own = np.asarray(jax.vmap(jax.grad(plr))(x))
    inside = np.isfinite(np.asarray(plr(x)))
    np.testing.assert_allclose(gradient[inside], own[inside], atol=1e-5)


def test_descending_returns_from_anywhere(plr):
    ask, middle = partial(plr, outside="clamp"), (plr.domain.lo + plr.domain.hi) / 2
    x = jnp.asarray(middle + 9.0 * np.eye(plr.dim)[0] * plr.domain.width, jnp.float32)
    for _ in range(400):
        x = x - 0.03 * plr.domain.width.max() * jax.grad(ask)(x)
        if np.isfinite(plr(x)):
            return
    pytest.fail(f"still outside, at {x}")


def test_jit_vmap_and_a_loop_agree(plr):
    x = jnp.asarray(around(plr.domain, 20), jnp.float32)
    ask = partial(plr, outside="clamp")
    expected = ask(x)
    np.testing.assert_allclose(jax.jit(ask)(x), expected, rtol=1e-6)
    np.testing.assert_allclose(jax.vmap(ask)(x), expected, rtol=1e-6)
    np.testing.assert_allclose([ask(each) for each in x], expected, rtol=1e-6)


def test_ways_as_long_as_floats_go(plr):
    x = (plr.domain.lo + plr.domain.hi) / 2 + 1e30 * np.eye(plr.dim)[0]
    np.testing.assert_allclose(plr(x, outside="clamp"), 1e30, rtol=1e-5)
    assert np.isfinite(jax.grad(lambda x: plr(x, outside="clamp"))(jnp.asarray(x))).all()


def test_double_precision_clamps_to_the_closed_domain():
    domain = Box((1 / 3, -0.1), (2 / 3, 1e-9))
    plr = construct(Euclidean((0.5, 0)), domain, max_leaves=30)
    with jax.enable_x64(True):
        for reach in (1.0, 1e-15, 1e-12):
            away = reach * np.array([[1, 1], [0, 1], [1, 0]])
            x = np.concatenate([domain.lo - away, domain.hi + away])
            assert np.isfinite(plr(x, outside="clamp")).all()


def test_a_stack_answers_as_its_plrs_do(plr):
    other = construct(Euclidean(plr.domain.lo), Box(plr.domain.lo, plr.domain.hi), max_leaves=20)
    stacked = stack([plr, other])
    x = jnp.asarray(around(plr.domain), jnp.float32)
    for outside in ("inf", "clamp", "nan"):
        for index, of_stack in enumerate((plr, other)):
            expected = of_stack(x, outside=outside)
            np.testing.assert_allclose(
                stacked(index, x, outside=outside), expected, rtol=2e-6, atol=2e-6 * plr.domain.width.max()
            )


def test_pairs_add_the_ways_of_both_ends():
    workspace = scenes.maze().workspace
    pairs = construct_pairs(workspace, max_bytes=512)
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-1, 2, (2, 300, 2))
    (near_x, way_x), (near_y, way_y) = clamped(workspace.bounds, x), clamped(workspace.bounds, y)
    value = pairs(x, y, outside="clamp")
    np.testing.assert_allclose(value, pairs(near_x, near_y) + way_x + way_y, rtol=1e-5, atol=1e-5)
    is_outside = (way_x > 0) | (way_y > 0)
    assert np.isinf(pairs(x, y))[is_outside].all()
    np.testing.assert_array_equal(np.isnan(pairs(x, y, outside="nan")), is_outside)
    np.testing.assert_array_equal(value[~is_outside], pairs(x, y)[~is_outside])
    gradient = jax.vmap(jax.grad(lambda x, y: pairs(x, y, outside="clamp")))(jnp.asarray(x), jnp.asarray(y))
    beyond = np.abs(x - near_x) > 1e-4
    outward = (x - near_x) / np.maximum(way_x, 1e-9)[:, None]
    np.testing.assert_allclose(np.asarray(gradient)[beyond], outward[beyond], atol=1e-4)
    for bad, expected in ((np.nan, np.nan), (np.inf, np.inf)):
        np.testing.assert_array_equal(pairs(np.array([bad, 0.5]), y[0], outside="clamp"), expected)


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize("outside", ["clip", None, 0, ["clamp"]])
def test_another_word_is_refused(outside):
    plr = construct(Euclidean((0.3,)), Box((-1,), (1,)), max_leaves=4)
    with pytest.raises(ValueError, match="outside must be 'inf', 'clamp' or 'nan'"):
        plr(np.zeros((3, 1)), outside=outside)
    with pytest.raises(ValueError, match="outside must be 'inf', 'clamp' or 'nan'"):
        stack([plr])(0, np.zeros((3, 1)), outside=outside)
