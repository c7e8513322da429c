import numpy as np
import pytest
from plr_helpers import random_partition

from plr_jax.plr.leaves.continuous.basis import design, numbers_of_leaves
from plr_jax.plr.leaves.continuous.fit import Samples, fit_values, residuals
from plr_jax.plr.leaves.continuous.space import nodal_space
from plr_jax.plr.partition.faces import shared_faces, tree_of
from plr_jax.plr.sampling.pattern import sample_pattern


@pytest.mark.parametrize("order", [0, 1])
def test_values_are_those_of_a_dense_least_squares_fit(order):
    rng = np.random.default_rng(0)
    tree = tree_of(random_partition(4, 2, 15))
    space = nodal_space(tree, shared_faces(tree), np.zeros(16, bool))
    pattern = sample_pattern(2, 48, 0.0, 0)
    samples = Samples(pattern, rng.normal(size=(16, 48)), rng.random((16, 48)))
    values, numbers = fit_values(order, space, samples)
    of_masters = numbers_of_leaves(order, space)
    np.testing.assert_allclose(numbers.ravel(), of_masters @ values)
    rows = np.kron(np.eye(16), design(order, (pattern.u + 1) / 2)) @ of_masters.toarray()
    root = np.sqrt(samples.weight).ravel()
    expected = np.linalg.lstsq(rows * root[:, None], samples.value.ravel() * root, rcond=None)[0]
    np.testing.assert_allclose(values, expected, atol=1e-4)
    residual = residuals(order, numbers, samples)
    np.testing.assert_allclose(residual.ravel(), samples.value.ravel() - rows @ values, atol=1e-9)


def test_values_that_no_sample_holds_are_harmless():
    tree = tree_of(random_partition(4, 2, 15))
    space = nodal_space(tree, shared_faces(tree), np.zeros(16, bool))
    pattern = sample_pattern(2, 48, 0.0, 0)
    weight = np.zeros((16, 48))
    weight[3] = 1.0
    values, _ = fit_values(0, space, Samples(pattern, np.full((16, 48), 7.0), weight))
    np.testing.assert_allclose(values, 7.0, rtol=1e-6)
