from dataclasses import replace

import numpy as np
import pytest
from plr_helpers import random_contents

from plr_jax.plr._plr import plr_of_leaves
from plr_jax.plr.file.bits import BitWriter
from plr_jax.plr.leaves import leaf_model
from plr_jax.plr.leaves.base import linear_mean_planes, rounded_down


@pytest.mark.parametrize("dim", [1, 2])
def test_coefficients_of_planes_are_planes(leaf, dim):
    model, rng = leaf_model(leaf), np.random.default_rng(0)
    center, half, u = rng.normal(size=5), rng.normal(size=(5, dim)), rng.uniform(-1, 1, size=(30, dim))
    coefficients = model.of_planes(center, half)
    np.testing.assert_allclose(coefficients @ model.basis(u).T, center[:, None] + half @ u.T, atol=1e-12)
    found_center, found_half = linear_mean_planes(model, coefficients, dim)
    np.testing.assert_allclose(found_center, center, atol=1e-12)
    np.testing.assert_allclose(found_half, half, atol=1e-12)


def test_coefficients_are_the_map_of_the_parameters(leaf):
    contents = random_contents(3, 2, leaf)
    model, coefficients = contents.leaf, contents.leaf.coefficients(contents.cells, contents.stored)
    parameters = model.parameters(contents.cells, contents.stored)
    of_map = np.zeros(coefficients.size)
    np.add.at(of_map, parameters.row, parameters.weight * parameters.values[parameters.column])
    np.testing.assert_allclose(of_map.reshape(coefficients.shape), coefficients, atol=1e-12)


def test_the_same_parameters_are_stored_as_before_then_with_fewer_and_fewer_bits(leaf):
    contents = random_contents(3, 2, leaf)
    parameters = contents.leaf.parameters(contents.cells, contents.stored)
    sizes = []
    for stored in contents.leaf.restored(contents.stored, parameters.values):
        values = contents.leaf.parameters(contents.cells, stored).values
        assert np.abs(values - parameters.values).max() <= 0.51 * stored.step + 1e-6 * np.abs(parameters.values).max()
        body = BitWriter()
        contents.leaf.write(body, contents.domain, contents.cells, stored)
        sizes.append(body.num_bits)
        if len(sizes) == 1:
            np.testing.assert_allclose(stored.step, contents.stored.step, rtol=1e-5)
    assert sizes[-1] < 0.7 * sizes[0] and (np.diff(sizes) <= 0).all()


def test_raised_leaves_are_higher_by_the_shift_or_a_little_less(leaf):
    contents = random_contents(4, 2, leaf)
    x = contents.domain.lo + contents.domain.width * np.random.default_rng(0).random((200, 2))
    plr = plr_of_leaves(contents)
    raised = plr_of_leaves(replace(contents, stored=contents.leaf.raised(contents.stored, 0.123456789)))
    change = np.asarray(raised(x), float) - np.asarray(plr(x), float)
    finite = np.isfinite(change)
    assert finite.sum() > 100
    np.testing.assert_allclose(change[finite], 0.123456789, atol=1e-5)


def test_rounding_down_to_32_bits():
    values = np.array([0.1, -0.1, 1.0, 1 + 2.0**-40, -1 - 2.0**-40])
    found = rounded_down(values)
    np.testing.assert_array_equal(found, found.astype(np.float32))
    assert (found <= values).all() and (values - found < 2e-7).all()
    assert found[2] == 1.0 == found[3]
