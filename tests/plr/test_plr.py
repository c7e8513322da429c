import jax
import jax.numpy as jnp
import numpy as np
import pytest
from plr_helpers import cone, evaluate_by_search, leaf_by_search, walled

from plr_jax.geometry.box import Box
from plr_jax.plr import construct, evaluate
from plr_jax.plr._plr import _evaluate
from plr_jax.plr.query.tables import lookup

SQUARE = Box((0, 0), (1, 1))


@pytest.fixture(scope="module")
def plr():
    return construct(walled, SQUARE, max_leaves=100)


@pytest.fixture(scope="module")
def x():
    return np.random.default_rng(0).random((1000, 2)).astype(np.float32)


def test_a_query_is_the_plane_of_the_leaf_that_holds_the_point(plr, x):
    np.testing.assert_allclose(plr(x), evaluate_by_search(plr, x), atol=1e-6)


def test_evaluate_is_calling(plr, x):
    np.testing.assert_array_equal(evaluate(plr, x), plr(x))


def test_attributes(plr):
    lo, hi = plr.leaf_boxes
    assert plr.num_leaves == len(plr.slope) == len(plr.intercept) == len(lo) == 100
    assert plr.domain == SQUARE and plr.dim == 2
    assert np.prod(hi - lo, axis=1).sum() == pytest.approx(1.0)
    assert plr.depth == round(-np.log2(np.prod(hi - lo, axis=1).min()))
    assert plr.resident_bytes >= plr.tables.leaf_of_slot.nbytes + 100 * 12
    assert "num_leaves=100" in repr(plr)


@pytest.mark.parametrize("shape", [(2,), (0, 2), (3, 2), (4, 5, 2)])
def test_any_batch_shape(plr, shape):
    x = np.random.default_rng(1).random(shape)
    assert plr(x).shape == shape[:-1]
    np.testing.assert_array_equal(np.ravel(plr(x)), np.ravel(plr(x.reshape(-1, 2))))


def test_jit_vmap_and_a_loop_agree(plr, x):
    plain = np.asarray(plr(x))
    np.testing.assert_array_equal(jax.jit(plr)(x), plain)
    np.testing.assert_array_equal(jax.jit(lambda plr, x: plr(x))(plr, x), plain)
    np.testing.assert_array_equal(jax.vmap(plr)(jnp.asarray(x)), plain)
    np.testing.assert_array_equal([plr(point) for point in x[:50]], plain[:50])


def test_gradient_is_the_slope_of_the_leaf(plr, x):
    gradient = jax.vmap(jax.grad(plr))(jnp.asarray(x))
    np.testing.assert_allclose(gradient, plr.slope[leaf_by_search(plr, x)], rtol=1e-6)


def test_gradient_is_finite_and_zero_where_there_is_none(plr):
    outside = jnp.array([[-0.5, 0.5], [2.0, 2.0], [1e30, 0.5]])
    np.testing.assert_array_equal(jax.vmap(jax.grad(plr))(outside), 0)


def test_a_pytree_survives_a_round_trip_through_jit(plr, x):
    again = jax.jit(lambda plr: plr)(plr)
    np.testing.assert_array_equal(again(x), plr(x))
    assert again.to_bytes() == plr.to_bytes() and again.num_leaves == 100


def test_a_second_plr_of_its_size_class_compiles_nothing(x):
    first = construct(walled, SQUARE, max_leaves=100)
    second = construct(lambda x: walled(x) + 1, Box((0, 0), (1, 1)), max_leaves=100)
    first(x)
    compiled = _evaluate._cache_size()
    second(x)
    assert _evaluate._cache_size() == compiled


def test_outside_nan_and_edges(plr):
    answers = plr(np.array([[1.0, 1.0], [0.0, 0.0], [1.0, 0.0], [1.0001, 0.5], [0.5, -0.0001], [np.inf, 0.5]]))
    np.testing.assert_array_equal(np.isfinite(answers), [True, True, True, False, False, False])
    assert np.isposinf(answers[3:]).all()
    answers = plr(np.array([[np.nan, 0.5], [0.5, np.nan], [np.nan, 7.0], [np.inf, np.nan]]))
    assert np.isnan(answers).all()


@pytest.mark.parametrize("corner", [0.1, 1 / 3, 1e5 + 0.1])
def test_corners_of_a_domain_that_floats_cannot_hold(corner):
    domain = Box((-corner, -corner), (corner, corner))
    plr = construct(cone, domain, max_leaves=20)
    for dtype in (np.float32, np.float64):
        corners = np.array([[1, 1], [-1, -1], [1, -1]], dtype) * dtype(corner)
        np.testing.assert_allclose(plr(corners), corner * np.sqrt(2), rtol=0.05)


def test_blocked_leaves_beside_free_ones_answer_and_far_ones_do_not():
    plr = construct(lambda x: np.where(x[:, 0] < 0.1, cone(x), np.inf), SQUARE, max_leaves=300)
    assert np.isfinite(plr(np.array([[0.1 + 1e-6, 0.5]]))).all()
    assert np.isposinf(plr(np.array([[0.9, 0.5]]))).all()
    assert np.all(np.asarray(jax.grad(plr)(jnp.array([0.9, 0.5]))) == 0)


def test_far_from_the_origin_the_precision_stays():
    origin = np.array([5e5, 2e6])
    here = construct(cone, Box((0, 0), (8, 8)), max_leaves=50)
    there = construct(lambda x: cone(x - origin), Box(origin, origin + 8), max_leaves=50)
    x = np.random.default_rng(0).integers(0, 8, size=(50, 2)).astype(np.float32)
    np.testing.assert_allclose(there(x + origin.astype(np.float32)), here(x), atol=1e-5)


@pytest.mark.parametrize("origin", [1e3 + 0.03, 1e6 + 0.03, 1e7 + 0.3])
def test_cells_stay_in_place_far_from_the_origin(origin):
    with jax.enable_x64(True):
        far = construct(
            lambda x: cone(x - origin - 0.3), ((origin, origin), (origin + 1, origin + 1)), max_leaves=200
        )
        x = np.random.default_rng(0).random((2000, 2)) + origin
        found = lookup(far.tables, jnp.asarray(x)) == leaf_by_search(far, x)
        assert np.mean(found) > 0.999  # all but points within a float's rounding of a face
        np.testing.assert_allclose(far(x)[found], evaluate_by_search(far, x)[found], atol=1e-5)
        edges = np.array([[0, 0.5], [1, 0.5], [-0.02, 0.5], [1.02, 0.5]]) + origin
        np.testing.assert_array_equal(np.isfinite(far(edges)), [True, True, False, False])


def test_integers_do_not_wrap_around(plr):
    assert np.isposinf(plr(np.array([[2**32, 0], [-(2**32), 0]]))).all()
    assert np.isposinf(plr([2**32, 0]))


def test_double_precision_where_enabled(plr, x):
    with jax.enable_x64(True):
        answers = plr(x.astype(np.float64))
        assert answers.dtype == np.float64
        np.testing.assert_allclose(answers, evaluate_by_search(plr, x.astype(np.float64)), rtol=1e-12)
        assert plr(x).dtype == np.float32


def test_integers_lists_and_half_precision_are_points_too(plr):
    expected = plr(np.array([[0.0, 1.0], [1.0, 0.0]], np.float32))
    np.testing.assert_array_equal(plr([[0, 1], [1, 0]]), expected)
    np.testing.assert_array_equal(plr(jnp.array([[0, 1], [1, 0]])), expected)
    half = plr(np.array([[0, 1], [1, 0]], np.float16))
    np.testing.assert_array_equal(half, expected)
    assert half.dtype == np.float32


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((3, 3)), r"shape \(\.\.\., 2\), got \(3, 3\)"),
        (1.0, r"shape \(\.\.\., 2\), got \(\)"),
        (np.zeros((2, 2), complex), "real numbers"),
        (["a", "b"], "real numbers"),
        ([[0.0, 1.0], [2.0]], "array of numbers"),
    ],
)
def test_bad_points_are_refused(plr, points, message):
    with pytest.raises(ValueError, match=message):
        plr(points)


def test_strict_promotion(plr, x):
    with jax.numpy_dtype_promotion("strict"):
        plr(x)
        jax.vmap(jax.value_and_grad(plr))(jnp.asarray(x))
