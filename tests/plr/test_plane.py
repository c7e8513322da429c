"""Leaf models' names and codes; planes: what a query answers, how they are rounded, and how they are written."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plr_helpers import UNIT, cone, evaluate_by_search, leaf_by_search, points, walled

from plr_jax import BuildOptions
from plr_jax.plr import Continuous, Plane, construct
from plr_jax.plr.leaves import leaf_model
from plr_jax.plr.leaves.plane import FLOAT_BITS, quantize

# Leaf models: their names and codes, and what holds of the numbers of every model with free parameters.


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("make", "wrong", "message"),
    [
        (lambda order: Continuous(order=order), 2, "order must be 0 or 1, got 2"),
        *((Plane, bits, f"an integer, 32 .floats. or 4 to 20, got {bits}") for bits in (3, 21, 31, 33, 8.5)),
    ],
)
def test_invalid_leaf_models_raise(make, wrong, message):
    with pytest.raises((ValueError, TypeError), match=message):
        make(wrong)


@pytest.mark.parametrize("dim", [1, 2])
def test_all_models_represent_planes_exactly(leaf, dim):
    model, rng = leaf_model(leaf), np.random.default_rng(0)
    center, half, u = rng.normal(size=5), rng.normal(size=(5, dim)), rng.uniform(-1, 1, size=(30, dim))
    coefficients = model.coefficients_of_planes(center, half)
    np.testing.assert_allclose(coefficients @ model.basis(u).T, center[:, None] + half @ u.T, atol=1e-12)
    for found, expected in zip(model.mean_planes(0 * half, half, coefficients), (center, half), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-12)


# Planes: what a query answers, how they are rounded to few bits, and how they are written.


@pytest.mark.parametrize("leaf", ["plane"])
def test_answers_are_the_plane_of_the_containing_leaf(plr, x):
    np.testing.assert_allclose(plr(x), evaluate_by_search(plr, x), atol=1e-6)
    gradient = jax.vmap(jax.grad(plr))(jnp.asarray(x))
    np.testing.assert_allclose(gradient, plr.slope[leaf_by_search(plr, x)], rtol=1e-6)
    of_cone, doubles = construct(cone, UNIT, max_leaves=40), x.astype(np.float64)
    with jax.enable_x64(True):
        np.testing.assert_allclose(of_cone(doubles), evaluate_by_search(of_cone, doubles), rtol=1e-12)


def test_coefficients_are_floats_without_and_integers_with_budget():
    assert construct(walled, UNIT, max_leaves=5).stored.bits == 32
    assert construct(walled, UNIT, max_bytes=500).stored.bits in range(8, 17)
    assert construct(walled, UNIT, max_leaves=5, leaf=Plane(coefficient_bits=12)).stored.bits == 12


def test_few_planes_may_be_deep_without_a_budget():
    """Next to a goal, the error of a plane grows with its width."""
    few, small = (construct(lambda x: np.sqrt(cone(x)), UNIT, max_leaves=64, max_bytes=most) for most in (None, 1024))
    assert few.cells.depth.max() == 9 and few.num_bytes < 1024 and small.cells.depth.max() == 7
    finest = few.cells.depth.max(axis=0).sum()  # a flat table of all their slots would exceed the class of a kilobyte
    assert few.tables.blocks is not None and len(few.tables.leaf_of_slot) == 2**14 < 2**finest


def test_large_budget_makes_files_of_a_tolerance_smaller():
    plain, small = (construct(cone, UNIT, tolerance=0.01, max_bytes=most) for most in (None, 1 << 20))
    assert small.num_bytes < 0.7 * plain.num_bytes and small.num_leaves <= plain.num_leaves + 8


def test_custom_fit_is_used():
    def flat(pattern, value, weight):
        return value.max(axis=1), 0 * value[:, :2]

    plr = construct(lambda x: x[:, 0], UNIT, max_leaves=4, options=BuildOptions(compute_coefficients=flat))
    np.testing.assert_allclose(plr.slope, 0)
    assert (plr(points(100, 0)) >= 0.2).all()


@given(seed=st.integers(0, 1000), bits=st.integers(4, 20), scale=st.sampled_from([1e-6, 1.0, 1e6]))
def test_rounding_errors_are_at_most_half_a_step(seed, bits, scale):
    rng = np.random.default_rng(seed)
    center, half = scale * rng.uniform(-1, 5, size=30), scale * rng.normal(size=(30, 3))
    center[rng.random(30) < 0.2] = np.inf
    center[0] = scale
    planes, blocked = quantize(center, half, bits), np.isinf(center)
    again_center, again_half = planes.decode()
    np.testing.assert_array_equal(planes.unreachable, blocked)
    assert np.isinf(again_center[blocked]).all()
    # The step spans the center values (or the half-differences, where those are far larger), but for its rounding.
    spread = max(np.ptp(center[~blocked]), np.abs(half[~blocked]).max() / 256)
    assert planes.step <= spread / (2**bits - 2) * (1 + 1e-5) + abs(scale) * 1e-5
    for again, before in ((again_center, center), (again_half, half)):
        assert np.abs(again[~blocked] - before[~blocked]).max() <= planes.step * (0.5 + 1e-9)


def test_floats_and_constants_are_stored_in_32_bits():
    center, half = np.array([0.1, np.inf, -3.0]), np.array([[0.3], [np.nan], [7.0]])
    again_center, again_half = quantize(center, half, FLOAT_BITS).decode()
    np.testing.assert_array_equal(again_center, center.astype(np.float32))
    np.testing.assert_array_equal(again_half, np.array([[0.3], [0.0], [7.0]], np.float32))
    for bits in (4, 8, 16):
        planes = quantize(np.full(3, 2.5), np.zeros((3, 2)), bits)
        np.testing.assert_allclose(planes.decode()[0], 2.5, rtol=1e-6)
        assert not planes.unreachable.any()


def test_planes_too_large_for_floats_raise():
    for center, half, bits in ((1e31, 0, 16), (1.0, -1e31, FLOAT_BITS)):
        with pytest.raises(ValueError, match="scale them down"):
            quantize(np.array([center]), np.full((1, 2), half, float), bits)
