"""What holds for PLRs of all kinds: compiled or not, of gradients, in files and in stacks, and outside the domain."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from portable_helpers import case, is_far

from plr_jax import PLR, Box, Euclidean, Workspace, construct, construct_pairs, evaluate, from_bytes, stack
from plr_jax.plr._plr import leaf_of

KINDS = (
    "maze of planes",
    "maze of gradients",
    "maze of cones",
    "around",
    "around twice",
    "folded car",
    "far planes",
    "far folded car",
)
OUTSIDE = ("inf", "clamp", "nan")


@pytest.fixture(scope="module", params=KINDS)
def plr(request):
    return case(request.param)


def around(plr, n=500, seed=0):
    """Points of a box three times as wide, half of them outside along some axis or other."""
    rng, domain = np.random.default_rng(seed), plr.domain
    return rng.uniform(domain.lo - domain.width, domain.hi + domain.width, (n, domain.dim))


def clamped(domain, x):
    """The nearest point of the domain, and how far it is."""
    nearest = np.where(domain.periodic, x, np.clip(x, domain.lo, domain.hi))
    return nearest, np.linalg.norm(x - nearest, axis=-1)


def test_compiled_or_not_one_by_one_or_at_once(plr):
    """Also as an argument of what is compiled."""
    x = jnp.asarray(around(plr), jnp.float32)
    close = {"rtol": 1e-6, "atol": 0 if plr.tables.folding is None else 1e-5}
    expected, clamp = np.asarray(plr(x)), partial(plr, outside="clamp")
    assert np.isfinite(expected).any()
    np.testing.assert_allclose(jax.jit(lambda plr, x: plr(x))(plr, x), expected, **close)
    np.testing.assert_allclose(jax.vmap(plr)(x), expected, **close)
    np.testing.assert_allclose([plr(each) for each in x[:20]], expected[:20], **close)
    np.testing.assert_allclose(jax.jit(jax.vmap(clamp))(x), clamp(x), **close)


def test_what_is_inside_is_clamped_to_itself_and_other_points_to_the_nearest_and_the_way_there(plr):
    """Evaluating is calling; without clamping, points outside answer inf or NaN, as one likes."""
    x = around(plr)
    nearest, way = clamped(plr.domain, x)
    is_outside = way > 0
    assert is_outside.sum() > 50 or plr.domain.periodic == (True, True)
    value = plr(x, outside="clamp")
    inset = plr.domain.lo + np.clip((nearest - plr.domain.lo) / plr.domain.width, 1e-5, 1 - 1e-5) * plr.domain.width
    inset = np.where(plr.domain.periodic, nearest, inset)  # from where rounding does not lead outside
    expected = np.asarray(plr(inset), np.float64) + way
    close = np.isclose(value, expected, rtol=1e-5, atol=1e-3 * plr.domain.width.max())
    assert close.mean() > 0.97  # the others are beside a face across which the function jumps
    np.testing.assert_array_equal(evaluate(plr, x, outside="clamp"), value)
    np.testing.assert_array_equal(np.isnan(plr(x, outside="nan")), is_outside)
    assert np.isinf(plr(x))[is_outside].all()
    inside = np.concatenate([x[~is_outside], [plr.domain.lo, plr.domain.hi]])
    single = jnp.asarray(x, jnp.float32)
    finite = np.isfinite(plr(single))
    for outside in OUTSIDE:
        np.testing.assert_array_equal(plr(inside, outside=outside), plr(inside))
        np.testing.assert_array_equal(plr(single, outside=outside)[finite], plr(single)[finite])
    far = (plr.domain.lo + plr.domain.hi) / 2 + 1e30 * np.eye(plr.dim)[0]  # as long a way as floats go
    if not plr.domain.periodic[0]:
        np.testing.assert_allclose(plr(far, outside="clamp"), 1e30, rtol=1e-5)


@pytest.mark.parametrize("outside", OUTSIDE)
def test_numbers_that_are_not_finite(plr, outside):
    middle, first = (plr.domain.lo + plr.domain.hi) / 2, np.eye(plr.dim)[0] > 0
    x = np.array([np.where(first, bad, middle) for bad in (np.nan, np.inf, -np.inf)])
    for points in (x, jnp.asarray(x)):
        np.testing.assert_array_equal(
            plr(points, outside=outside), [np.nan] + 2 * [np.nan if outside == "nan" else np.inf]
        )
    if outside == "clamp":
        np.testing.assert_array_equal(jax.vmap(jax.grad(partial(plr, outside=outside)))(jnp.asarray(x[1:])), 0)


def test_gradients_are_finite_differences_and_outside_zero_or_lead_back(plr):
    """Clamped, along axes that a point is outside of, it is the unit vector away from the domain."""
    x = jnp.asarray(around(plr), jnp.float32)
    exact = np.asarray(x, np.float64)
    nearest, way = clamped(plr.domain, exact)
    own = np.asarray(jax.vmap(jax.grad(plr))(x))
    assert (own[way > 1e-3 * plr.domain.width.max()] == 0).all()
    gradient = np.asarray(jax.jit(jax.vmap(jax.grad(partial(plr, outside="clamp"))))(x))
    assert np.isfinite(gradient).all()
    beyond = np.abs(exact - nearest) > 1e-3 * plr.domain.width
    outward = (exact - nearest) / np.maximum(way, 1e-9)[:, None]
    np.testing.assert_allclose(gradient[beyond], outward[beyond], atol=1e-2)
    inside = np.isfinite(np.asarray(plr(x)))
    np.testing.assert_allclose(gradient[inside], own[inside], atol=1e-5)
    with jax.enable_x64(True):
        x = jnp.asarray(np.random.default_rng(1).uniform(plr.domain.lo, plr.domain.hi, (300, plr.dim)))
        gradient = np.asarray(jax.vmap(jax.grad(plr))(x))
        scale = np.maximum(np.linalg.norm(gradient, axis=1), 0.1)
        for axis, step in enumerate(1e-5 * np.diag(plr.domain.width)):
            slope = (np.asarray(plr(x + step)) - np.asarray(plr(x - step))) / (2 * step[axis])
            is_near = np.abs(slope - gradient[:, axis]) < 1e-3 * scale
            assert is_near[np.isfinite(slope)].mean() > 0.97  # but beside faces


def test_files_and_arrays_hold_all_of_it(plr):
    x = around(plr)
    for again in (from_bytes(plr.to_bytes()), jax.jit(lambda plr: plr)(plr)):
        assert again.to_bytes() == plr.to_bytes() and again.num_bytes == len(plr.to_bytes())
        assert again.folded_domain == plr.folded_domain and again.max_error == plr.max_error
        np.testing.assert_array_equal(again(x), plr(x))
    inside = x[clamped(plr.domain, x)[1] == 0]
    found = plr.values_in_leaves(leaf_of(plr, inside), inside)
    is_near = np.isclose(found, plr(inside), rtol=1e-5, atol=2e-3)
    assert is_near.mean() > (0.99 if is_far(plr) else 0.999)


def test_in_64_bits(plr):
    x = np.random.default_rng(2).uniform(plr.domain.lo, plr.domain.hi, (300, plr.dim))
    with jax.enable_x64(True):
        twin = from_bytes(plr.to_bytes())
        for answer in (twin(x), twin(jnp.asarray(x))):
            assert answer.dtype == np.float64
            assert np.isclose(answer, np.asarray(twin(x)), rtol=1e-9, atol=1e-9).mean() > 0.99
        assert (
            np.isclose(answer, plr(x.astype(np.float32) if not is_far(plr) else x), rtol=1e-4, atol=1e-3).mean()
            > 0.98
        )
        assert plr(x.astype(np.float32)).dtype == np.float32 and plr(x).dtype == np.float64
    assert plr(x).dtype == np.float32  # what was decided for one mode of JAX is not kept for the other


def test_a_stack_answers_as_its_plrs_do(plr):
    other = construct(Euclidean(plr.domain.lo), Box(plr.domain.lo, plr.domain.hi), max_leaves=20)
    stacked, x = stack([plr, other]), around(plr) if is_far(plr) else jnp.asarray(around(plr), jnp.float32)
    for outside in OUTSIDE:
        for index, each in enumerate((plr, other)):
            found, expected = stacked(index, x, outside=outside), each(x, outside=outside)
            np.testing.assert_allclose(found, expected, rtol=2e-6, atol=2e-6 * plr.domain.width.max())
    q = np.stack([around(plr), around(plr, seed=3)], axis=1)
    q[0] = np.nan
    found = PLR.stack([plr, other])(q)
    for index, each in enumerate((plr, other)):
        np.testing.assert_array_equal(found[:, index], np.asarray(each(q[:, index]), np.float64))


def test_double_precision_clamps_to_the_closed_domain():
    domain = Box((1 / 3, -0.1), (2 / 3, 1e-9))
    plr = construct(Euclidean((0.5, 0)), domain, max_leaves=30)
    with jax.enable_x64(True):
        for reach in (1.0, 1e-15, 1e-12):
            away = reach * np.array([[1, 1], [0, 1], [1, 0]])
            x = np.concatenate([domain.lo - away, domain.hi + away])
            assert np.isfinite(plr(x, outside="clamp")).all()


@pytest.mark.full
def test_pairs_add_the_ways_of_both_ends():
    workspace = Workspace(((0, 0), (1, 1)), [[(0.4, 0), (0.5, 0), (0.5, 0.7), (0.4, 0.7)]])
    pairs = construct_pairs(workspace, max_bytes=300)
    x, y = np.random.default_rng(1).uniform(-1, 2, (2, 300, 2))
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
    x[:2, 0] = np.nan, np.inf
    np.testing.assert_array_equal(pairs(x, y, outside="clamp")[:2], [np.nan, np.inf])


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize("outside", ["clip", None, 0, ["clamp"]])
def test_another_word_is_refused(outside):
    plr, x = case("one leaf"), np.zeros((3, 2))
    for ask in (plr, partial(stack([plr]), 0), plr.numpy(), lambda x, **kwargs: plr.numpy()([0.5, 0.5], **kwargs)):
        with pytest.raises(ValueError, match="outside must be 'inf', 'clamp' or 'nan'"):
            ask(x, outside=outside)
