import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from plr_jax.eikonal.program import rescaling_of

# Multiples of 1/8, so that ends of intervals meet often.
LEVEL = st.integers(-8, 40).map(lambda k: k / 8)
CELLS = st.lists(st.tuples(LEVEL, LEVEL, st.sampled_from([0.0, 0.5, 1.0, 1.25, 2.0, 4.0])), min_size=1, max_size=12)


def intervals(cells):
    lowest, highest, factor = np.array(cells, float).T
    return np.minimum(lowest, highest), np.maximum(lowest, highest), factor


def naive(u, lowest, highest, factor):
    """The integral from 0, slot by slot, of one over the steepest factor there."""
    total = 0.0
    for slot in range(-8, 40):
        middle = (slot + 0.5) / 8
        steepest = max([1.0, *(f for lo, hi, f in zip(lowest, highest, factor, strict=True) if lo < middle < hi)])
        share = np.clip(8 * u - slot, 0, 1) if slot >= 0 else -np.clip(slot + 1 - 8 * u, 0, 1)
        total += share / 8 / steepest
    return total


@given(CELLS)
def test_it_is_the_integral_of_one_over_the_steepest_factor(cells):
    lowest, highest, factor = intervals(cells)
    rescaling = rescaling_of(lowest, highest, factor)
    u = np.linspace(min(lowest.min(), 0), max(highest.max(), 0), 41)
    np.testing.assert_allclose(rescaling(u), [naive(v, lowest, highest, factor) for v in u], atol=1e-12)


@given(CELLS)
def test_no_cell_stays_steeper_than_allowed(cells):
    lowest, highest, factor = intervals(cells)
    rescaling = rescaling_of(lowest, highest, factor)
    assert rescaling(np.zeros(1)) == 0
    assert (np.diff(rescaling.level) > 0).all() and (np.diff(rescaling.value) > 0).all()
    for lo, hi, f in zip(lowest, highest, factor, strict=True):
        u = np.linspace(lo, hi, 33)
        assert (np.diff(rescaling(u)) <= np.diff(u) / max(f, 1) + 1e-12).all()


def test_values_without_a_steep_cell_stay_as_they_are():
    rescaling = rescaling_of(np.array([-1.0, 0.5]), np.array([0.5, 3.0]), np.array([1.0, 0.2]))
    u = np.linspace(-1, 3, 50)
    np.testing.assert_array_equal(rescaling(u), u)


def test_a_steep_cell_lowers_what_is_beyond_by_what_it_loses():
    rescaling = rescaling_of(np.array([1.0, 0.0]), np.array([2.0, 4.0]), np.array([2.0, 1.0]))
    np.testing.assert_array_equal(rescaling(np.array([0.5, 1.0, 1.5, 2.0, 4.0])), [0.5, 1.0, 1.25, 1.5, 3.5])
