import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plr_jax.plr.leaves.continuous.space import design, monomials
from plr_jax.plr.partition.cells import corner_bits


@pytest.mark.parametrize("order", [0, 1])
@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 1000), dim=st.integers(1, 3))
def test_functions_are_their_powers(order, seed, dim):
    t = np.random.default_rng(seed).random((20, dim))
    powers = np.stack(np.meshgrid(*[np.arange((2, 4)[order])] * dim, indexing="ij"), -1).reshape(-1, dim)
    by_power = np.prod(t[:, None] ** powers, axis=2) @ monomials(order, dim).T
    np.testing.assert_allclose(design(order, t), by_power, atol=1e-12)


@pytest.mark.parametrize("order", [0, 1])
def test_numbers_are_the_values_at_the_corners_and_the_cubics_derivatives(order):
    corners = corner_bits(2).astype(float)
    at_corners = design(order, corners).reshape(4, 4, -1)
    np.testing.assert_allclose(at_corners[:, :, 0], np.eye(4), atol=1e-12)
    if order == 1:
        step = 1e-6 * np.array([0.0, 1.0])
        slope = (design(1, corners + step) - design(1, corners - step)).reshape(4, 4, 4) / 2e-6
        np.testing.assert_allclose(slope[:, :, 1], np.eye(4), atol=1e-5)  # the second number is the slope along y
        np.testing.assert_allclose(slope[:, :, 0], 0, atol=1e-5)
