import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plr_helpers import lstsq_plane

from plr_jax.plr.sampling.cell_fit import Pattern, least_squares, midrange, sample_pattern


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), dim=st.integers(1, 5))
def test_batched_fit_equals_lstsq_cell_by_cell(seed, dim):
    rng = np.random.default_rng(seed)
    pattern = sample_pattern(dim, 40, 0.0, seed)
    value = rng.normal(size=(6, 40))
    weight = np.ones((6, 40))
    weight[2:] = rng.random((4, 40)) < 0.6
    weight[4:] *= rng.uniform(0.1, 3, size=(2, 40))
    center, half = least_squares(pattern, value, weight)
    for cell in range(6):
        expected = lstsq_plane(pattern.u, value[cell], weight[cell] * pattern.weight)
        np.testing.assert_allclose(np.r_[center[cell], half[cell]], expected, rtol=1e-6, atol=1e-7)


def test_undetermined_directions_get_slope_zero():
    pattern = Pattern(np.array([[0.0, 0.0], [0.5, 0.25], [-0.5, 0.25], [0.3, -0.9]]), np.ones(4))
    value = np.array([[7.0, 0, 0, 0], [0, 3.0, 1.0, 0], [5.0, 5.0, 5.0, 5.0]])
    weight = np.array([[1.0, 0, 0, 0], [0, 1, 1, 0], [0, 0, 0, 0]])
    center, half = least_squares(pattern, value, weight)
    np.testing.assert_allclose(center, [7, 2, 0], atol=1e-6)
    np.testing.assert_allclose(half, [[0, 0], [2, 0], [0, 0]], atol=1e-6)


def test_least_squares_leaves_the_range_of_its_samples():
    """The false step of the paper's Theorem 2: V = 0, 0, 1 at 0, 1, 2 gives the line -1/6 at 0."""
    pattern = Pattern(np.array([[-1.0], [0], [1]]), np.ones(3))
    center, half = least_squares(pattern, np.array([[0.0, 0, 1]]), np.ones((1, 3)))
    assert center[0] - half[0, 0] == pytest.approx(-1 / 6)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), dim=st.integers(1, 4), share=st.sampled_from([0.0, 0.3, 1.0]))
def test_midrange_errs_as_far_above_as_below(seed, dim, share):
    rng = np.random.default_rng(seed)
    pattern = sample_pattern(dim, 40, 0.0, seed)
    weight = 1.0 * (rng.random((3, 40)) >= share)
    value = rng.normal(size=(3, 40)) * (weight > 0)
    center, half = midrange(pattern, value, weight)
    _, slope = least_squares(pattern, value, weight)
    np.testing.assert_array_equal(half, slope)
    error = value - (center[:, None] + half @ pattern.u.T)
    for row, counts in zip(error, weight > 0, strict=True):
        if counts.any():
            assert row[counts].max() == pytest.approx(-row[counts].min(), abs=1e-9)
    assert np.isfinite(center).all()
