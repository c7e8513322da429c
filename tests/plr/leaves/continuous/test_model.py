import numpy as np
import pytest
from plr_helpers import UNIT, cone, walled

from plr_jax.plr import Continuous, construct


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_one_leaf_holds_a_multilinear_function(dim):
    def product(x):
        return 1 + np.prod(1 + x * np.arange(1, dim + 1), axis=1)

    plr = construct(product, (np.zeros(dim), np.ones(dim)), leaf="continuous", max_leaves=1)
    x = np.random.default_rng(0).random((100, dim))
    np.testing.assert_allclose(plr(x), product(x), rtol=3e-6)


@pytest.mark.parametrize("leaf", ["continuous", "smooth"])
def test_linear_functions_are_held_across_leaves_and_walls(leaf):
    def linear(x):
        return np.where(np.isfinite(walled(x)), 3 + x @ [2.0, -1.0], np.inf)

    plr = construct(linear, UNIT, leaf=leaf, tolerance=0)
    x = np.random.default_rng(5).random((500, 2))
    x = x[np.isfinite(walled(x))]
    assert plr.num_leaves < 200
    np.testing.assert_allclose(plr(x), linear(x), rtol=1e-5)


@pytest.mark.parametrize("leaf", ["continuous", "smooth"])
def test_at_equal_bytes_it_errs_less_than_planes(leaf):
    x = np.random.default_rng(5).random((10_000, 2))
    x = x[np.isfinite(walled(x))]
    planes = construct(walled, UNIT, max_bytes=600)
    tied = construct(walled, UNIT, max_bytes=600, leaf=leaf)
    assert 570 <= tied.num_bytes <= 600
    errors = [np.abs(np.asarray(plr(x)) - walled(x)).mean() for plr in (tied, planes)]
    assert errors[0] < 0.8 * errors[1]


@pytest.mark.parametrize(
    ("leaf", "dim", "message"),
    [
        ("smooth", 3, "'smooth' are for up to 2 dimensions, got 3. Use continuous ones or planes, which may jump"),
        ("continuous", 7, "'continuous' are for up to 6 dimensions, got 7. Use planes, which may jump, instead"),
    ],
)
def test_too_many_dimensions_are_refused(leaf, dim, message):
    with pytest.raises(ValueError, match=message):
        construct(cone, (np.zeros(dim), np.ones(dim)), leaf=leaf)


def test_an_order_that_is_none_is_refused():
    with pytest.raises(ValueError, match="order must be 0 or 1, got 2"):
        Continuous(order=2)
