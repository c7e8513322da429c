import numpy as np
import pytest
from plr_helpers import UNIT, cone, walled

from plr_jax.plr import Plane, construct


@pytest.mark.parametrize("budget", [80, 100, 1000, 4000])
@pytest.mark.parametrize("bits", [None, 16, 32])
def test_a_budget_of_bytes_is_kept_and_used(budget, bits):
    if bits == 32 and budget < 100:
        return
    plr = construct(walled, UNIT, max_bytes=budget, leaf=Plane(coefficient_bits=bits))
    assert plr.num_bytes <= budget
    if budget >= 1000:
        assert plr.num_bytes > budget - 20


def test_a_budget_goes_into_bits_where_leaves_need_none():
    plr = construct(lambda x: 1 + 2 * x[:, 0] - x[:, 1], UNIT, max_bytes=2048)
    assert plr.num_leaves == 1
    np.testing.assert_allclose(plr.slope, [[2, -1]], atol=1e-3)


def test_bits_are_traded_for_leaves():
    """The choice errs no more than any one number of bits (but for what sampling makes of it)."""
    x = np.random.default_rng(0).random((5000, 2))
    x = x[np.isfinite(walled(x))]
    error = {}
    for bits in (None, 8, 12, 16, 32):
        plr = construct(walled, UNIT, max_bytes=1000, leaf=Plane(coefficient_bits=bits))
        error[bits] = np.abs(np.asarray(plr(x)) - walled(x)).mean()
    assert error[None] < 1.1 * min(error[8], error[12], error[16])
    assert error[None] < 0.7 * error[32]


def test_one_leaf_that_does_not_fit_is_refused(leaf):
    """A header of 16 bytes, four corners of 8 and a checksum of 4 are 52 without any leaf."""
    with pytest.raises(ValueError, match=r"max_bytes=52 is too small: one leaf takes [567]\d bytes"):
        construct(cone, UNIT, leaf=leaf, max_bytes=52)
