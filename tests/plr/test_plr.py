import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plr_helpers import UNIT, cone, evaluate_by_search, leaf_by_search, points, walled
from portable_helpers import case, compiled_answers, hard_points, same_bits

from plr_jax import PLR, Box, BuildOptions, construct, from_bytes
from plr_jax.plr import _plr
from plr_jax.plr.query import bound_points, evaluate_anywhere, evaluate_points, waypoints_of_points


def test_attributes_describe_the_leaves(plr, leaf, x):
    lo, hi = plr.leaf_boxes
    assert plr.num_leaves == len(plr.slope) == len(plr.intercept) == len(lo) == 100
    assert plr.domain == UNIT and plr.dim == 2 and plr.leaf.name == leaf
    assert np.prod(hi - lo, axis=1).sum() == pytest.approx(1.0)
    assert plr.depth == round(-np.log2(np.prod(hi - lo, axis=1).min()))
    parameter_bytes = 100 * 4 * plr.leaf.num_leaf_parameters(2)
    assert plr.resident_bytes >= plr.tables.leaf_of_slot.nbytes + parameter_bytes
    assert f"PLR('{leaf}', dim=2, num_leaves=100" in repr(plr)
    assert not plr.unreachable.all() and plr.num_unreachable == np.isinf(plr.intercept).sum()
    np.testing.assert_array_equal(plr.numpy().leaf(x), leaf_by_search(plr, x))
    # A leaf's function differs from its mean plane by about the error of that plane.
    assert np.abs(evaluate_by_search(plr, x) - np.asarray(plr(x))).mean() < 0.01


def test_points_of_any_batch_shape(plr):
    for shape in ((2,), (0, 2), (4, 5, 2)):
        x = np.random.default_rng(1).random(shape)
        assert plr(x).shape == shape[:-1]
        np.testing.assert_allclose(np.ravel(plr(x)), np.ravel(plr(x.reshape(-1, 2))), rtol=1e-6)


@pytest.mark.parametrize("leaf", ["plane"])
def test_plrs_of_one_size_class_share_a_program(plr, leaf, x):
    evaluate_points(plr.tables, x)
    compiled = evaluate_points._cache_size()
    evaluate_points(construct(lambda x: 1 + 2 * walled(x), UNIT, leaf=leaf, max_leaves=98).tables, x)
    assert evaluate_points._cache_size() == compiled


PROGRAMS = evaluate_points, evaluate_anywhere, bound_points, waypoints_of_points


def test_few_points_outside_of_jit_compile_nothing():
    plr, before = case("maze of cones"), [program._cache_size() for program in PROGRAMS]
    x = hard_points(plr, 100, seed=3)
    x[np.abs(x) < 1e-30] = 0  # compiled code takes smaller products for 0
    y = [plr(x), plr(jnp.asarray(x)), plr(x, outside="clamp"), plr(x.astype(float)), *plr.bounds(x), plr.waypoint(x)]
    assert before == [program._cache_size() for program in PROGRAMS]
    assert all(isinstance(answer, jax.Array) and not answer.committed for answer in y)
    for answer, outside in ((y[0], "inf"), (y[1], "inf"), (y[2], "clamp")):
        assert same_bits(answer, compiled_answers(plr, x, outside))


def test_compiled_code_answers_many_points_committed_ones_and_64_bits(monkeypatch):
    monkeypatch.setattr(_plr.PLR, "numpy", None)
    plr = from_bytes(case("maze of cones").to_bytes())
    assert plr(np.zeros((_plr._FEW + 1, 2))).shape == (_plr._FEW + 1,)
    assert plr(jax.device_put(np.zeros((3, 2)), jax.devices()[0])).committed
    with jax.enable_x64(True):
        assert plr(np.zeros((3, 2))).dtype == np.float64
    with pytest.raises(TypeError):
        plr(np.zeros((3, 2)))


def test_answers_are_finite_at_free_points_and_inf_outside(plr):
    x = points(5000, 1)
    assert np.isfinite(np.asarray(plr(x))[np.isfinite(walled(x))]).all()
    edge = np.linspace(0, 1, 1000)
    for at in (0.0, 1.0):
        assert np.isfinite(plr(np.stack([edge, np.full(1000, at)], axis=1))[(edge < 0.4) | (edge > 0.5)]).all()
    beside = np.stack([np.full(500, 0.4 + 1e-6), np.linspace(0, 0.7, 500)], axis=1)  # a little way into the wall
    assert np.isfinite(plr(beside)).all()
    outside = [[1.0001, 0.5], [0.5, -0.0001], [np.inf, 0.5], [2**32, 0], [-(2**32), 0]]  # no integer wraps around
    assert np.isposinf(plr(np.array(outside))).all() and np.isposinf(plr(np.array(outside[3:], int))).all()
    assert np.isnan(plr(np.array([[np.nan, 0.5], [0.5, np.nan], [np.nan, 7.0], [np.inf, np.nan]]))).all()


@pytest.mark.parametrize("leaf", ["plane"])
def test_unreachable_leaves_beside_free_ones_are_finite(leaf):
    plr = construct(lambda x: np.where(x[:, 0] < 0.1, cone(x), np.inf), UNIT, leaf=leaf, max_leaves=150)
    assert np.isfinite(plr(np.array([[0.1 + 1e-6, 0.5]]))).all()
    assert np.isposinf(plr(np.array([[0.9, 0.5]]))).all()
    assert plr.num_unreachable > 0 and plr.unreachable.sum() >= plr.num_unreachable
    gradient = np.asarray(jax.vmap(jax.grad(plr))(jnp.array([[0.9, 0.5], [0.05, 0.5], [0.1, 0.5]])))
    assert (gradient[0] == 0).all() and (gradient[1] != 0).any() and np.isfinite(gradient).all()


@given(lo=st.floats(-1e8, 1e8), width=st.floats(1e-3, 1e3))
def test_corners_of_any_domain_are_inside(lo, width):
    lo, hi = np.full(2, lo), np.full(2, lo + width)
    if not (hi - lo > 100 * np.spacing(np.abs(hi))).all():
        return
    plr = construct(lambda x: np.ones(len(x)), Box(lo, hi), max_leaves=1, options=BuildOptions(num_samples=8))
    corners = np.array([lo, hi, [lo[0], hi[1]], (lo + hi) / 2])
    np.testing.assert_array_equal(plr(corners), 1)
    np.testing.assert_array_equal(PLR.stack([plr])(corners[:, None]), 1)


@pytest.mark.parametrize("leaf", ["plane"])
@pytest.mark.parametrize("dtype", ["bfloat16", "int8", "uint8", "int32"])
def test_points_of_any_type_under_strict_promotion(plr, dtype):
    """Answers are of 32 bits, for lists, JAX and NumPy; floats have gradients of their type."""
    exact = np.array([[0, 1], [1, 0], [1, 1]], np.float32)
    expected = plr(exact)
    x = jnp.asarray(exact, dtype)
    with jax.numpy_dtype_promotion("strict"):
        others = (exact.astype(int).tolist(), exact.astype(bool), exact.astype(np.longdouble))
        for given_points in (x, np.asarray(x), *others):
            np.testing.assert_array_equal(plr(given_points), expected)
            assert plr(given_points).dtype == np.float32
        if jnp.issubdtype(x.dtype, jnp.floating):
            value, gradient = jax.vmap(jax.value_and_grad(plr))(x)
            np.testing.assert_allclose(value, expected, rtol=1e-6)
            assert gradient.dtype == x.dtype and np.isfinite(np.asarray(gradient, np.float32)).all()
    if jnp.issubdtype(x.dtype, jnp.integer):
        assert np.isposinf(plr(jnp.asarray([[100, 0]], dtype))).all()
