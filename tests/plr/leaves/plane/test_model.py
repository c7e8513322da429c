import jax
import jax.numpy as jnp
import numpy as np
import pytest
from plr_helpers import UNIT, cone, evaluate_by_search, leaf_by_search, walled

from plr_jax.geometry.box import Box
from plr_jax.plr import Plane, construct
from plr_jax.plr._location import leaf_of
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.sampling.cell_fit import midrange


def test_rounding_is_as_the_step_says():
    exact = construct(walled, UNIT, max_leaves=60)
    rounded = construct(walled, UNIT, max_leaves=60, leaf=Plane(coefficient_bits=8))
    x = np.random.default_rng(0).random((10_000, 2))
    difference = np.abs(np.asarray(exact(x)) - np.asarray(rounded(x)))
    assert 0 < difference.max() <= 1.5 * rounded.stored.step + 1e-6


def test_floats_without_a_budget_and_integers_with_one():
    assert construct(walled, UNIT, max_leaves=5).stored.bits == 32
    assert construct(walled, UNIT, max_bytes=500).stored.bits in range(8, 17)
    assert construct(walled, UNIT, max_leaves=5, leaf=Plane(coefficient_bits=12)).stored.bits == 12


def test_without_a_budget_planes_may_be_as_deep_as_in_32_kilobytes():
    """However few they are: next to a goal a plane errs the more, the wider it is."""

    def steep(x):
        return np.sqrt(cone(x))

    few = construct(steep, UNIT, max_leaves=64)
    assert few.cells.depth.max() == 9 and few.num_bytes < 1024
    needed = few.cells.depth.max(axis=0).sum()  # more than the class of a kilobyte has, so there are more
    assert few.tables.blocks is None and len(few.tables.leaf_of_slot) == 2**needed > 2**14
    x = np.random.default_rng(0).random((500, 2)).astype(np.float32)
    np.testing.assert_array_equal(leaf_of(few, x), leaf_by_search(few, x))
    assert construct(steep, UNIT, max_leaves=64, max_bytes=1024).cells.depth.max() == 7


def test_a_budget_larger_than_needed_makes_the_file_of_a_tolerance_smaller():
    plain = construct(cone, UNIT, tolerance=0.01)
    small = construct(cone, UNIT, tolerance=0.01, max_bytes=1 << 20)
    assert small.num_bytes < 0.7 * plain.num_bytes and small.num_leaves <= plain.num_leaves + 8


@pytest.mark.parametrize("bits", [3, 21, 31, 33, 0, -1])
def test_bits_out_of_range_are_refused(bits):
    with pytest.raises(ValueError, match=f"coefficient_bits must be 32 .floats. or 4 to 20, got {bits}"):
        Plane(coefficient_bits=bits)


def test_bits_that_are_no_integer_are_refused():
    with pytest.raises((ValueError, TypeError), match="coefficient_bits"):
        Plane(coefficient_bits=8.5)


def test_a_fit_of_the_callers_own():
    flat = lambda pattern, value, weight: (value.max(axis=1), 0 * value[:, :2])  # noqa: E731
    plr = construct(lambda x: x[:, 0], UNIT, max_leaves=4, compute_coefficients=flat)
    np.testing.assert_allclose(plr.slope, 0)
    assert (plr(np.random.default_rng(0).random((100, 2))) >= 0.2).all()


def test_midrange_planes_need_fewer_leaves_for_a_tolerance():
    cone = lambda x: np.hypot(x[:, 0], x[:, 1])  # noqa: E731
    balanced = construct(cone, UNIT, tolerance=0.002, compute_coefficients=midrange)
    plain = construct(cone, UNIT, tolerance=0.002)
    x = np.random.default_rng(0).random((20_000, 2))
    assert np.abs(balanced(x) - cone(x)).max() < 1.2 * 0.002
    assert balanced.num_leaves < 0.8 * plain.num_leaves


def test_numbers_are_the_value_at_the_corner_and_the_slopes():
    """The plane ``3 + 5 x - 2 y`` on [2, 4] x [1, 2], in its upper half along x."""
    cells = Cells.root(2).split(np.array([0]))[[1]]
    corner = np.array([2.0, 1.0])
    numbers = Plane().numbers(Box(corner, (4, 2)), cells, np.array([[3 + 17.5 - 3, 2.5, -1.0]]), corner)
    np.testing.assert_allclose(numbers, [[3 + 10 - 2, 5, -2]])


def test_a_query_is_the_plane_of_the_leaf_that_holds_the_point(x):
    plr = construct(walled, UNIT, max_leaves=100)
    np.testing.assert_allclose(plr(x), evaluate_by_search(plr, x), atol=1e-6)
    gradient = jax.vmap(jax.grad(plr))(jnp.asarray(x))
    np.testing.assert_allclose(gradient, plr.slope[leaf_by_search(plr, x)], rtol=1e-6)


def test_double_precision_is_exact(x):
    plr = construct(cone, UNIT, max_leaves=40)
    with jax.enable_x64(True):
        points = x.astype(np.float64)
        np.testing.assert_allclose(plr(points), evaluate_by_search(plr, points), rtol=1e-12)
