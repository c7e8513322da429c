from dataclasses import replace

import numpy as np
import pytest
from plr_helpers import UNIT, cone, random_partition

from plr_jax.plr import construct
from plr_jax.plr.leaves.continuous.growth import fit_values
from plr_jax.plr.leaves.continuous.space import design, nodal_space, numbers_of_leaves
from plr_jax.plr.partition.cells import tree_of
from plr_jax.plr.partition.faces import shared_faces
from plr_jax.plr.sampling.cell_fit import Sampler, sample_pattern


def test_limits():
    assert construct(cone, UNIT, leaf="continuous", max_leaves=37).num_leaves == 37
    plr = construct(cone, UNIT, leaf="continuous", tolerance=0.01)
    x = np.random.default_rng(0).random((5000, 2))
    assert np.abs(np.asarray(plr(x)) - cone(x)).max() < 0.015
    assert plr.num_leaves < 60


@pytest.mark.parametrize("max_leaves", [100, 200, 400])
def test_exhausted_leaves_take_no_part_of_what_was_asked_for(max_leaves):
    """Leaves at a jump are halved until they may not be; once they were chosen, and 99, 193 and 380 leaves made."""

    def bumps_and_a_jump(x):
        return 2 + np.sin(40 * x[:, 0]) + 10 * (x[:, 0] > 1 / 3)

    plr = construct(bumps_and_a_jump, ([0.0], [1.0]), leaf="continuous", max_leaves=max_leaves, num_samples=48)
    assert plr.num_leaves == max_leaves


def test_limits_on_depth_are_kept():
    plr = construct(lambda x: 10.0 * (x[:, 0] > 1 / 3) + cone(x), UNIT, leaf="continuous", max_leaves=60, max_depth=7)
    assert plr.depth == 7 and plr.num_leaves == 60


def test_weights_draw_leaves():
    weight = lambda x: np.where(x[:, 0] > 0.5, 1.0, 0.001)  # noqa: E731
    plr = construct(cone, UNIT, leaf="continuous", max_leaves=64, weight_fn=weight)
    assert np.mean(plr.leaf_boxes[0][:, 0] >= 0.5) > 0.8


@pytest.mark.parametrize("budget", [100, 300, 700])
def test_a_budget_of_bytes_is_kept_and_used(budget):
    plr = construct(cone, UNIT, leaf="continuous", max_bytes=budget)
    assert 0.95 * budget < plr.num_bytes <= budget


def space_and_fit(value):
    """A partition of 16 leaves, all tied, and samples of given values."""
    tree = tree_of(random_partition(4, 2, 15))
    fit = Sampler(lambda x: np.ones(len(x)), UNIT, None, *2 * [sample_pattern(2, 48, 0.0, 0)], 14)(tree.leaves)
    return nodal_space(tree, shared_faces(tree), np.zeros(16, bool)), replace(fit, value=value)


@pytest.mark.parametrize("order", [0, 1])
def test_values_are_those_of_a_dense_least_squares_fit(order):
    rng = np.random.default_rng(0)
    space, fit = space_and_fit(rng.normal(size=(16, 48)))
    weight = rng.random((16, 48))
    values, residual = fit_values(order, space, fit, weight)
    of_masters = numbers_of_leaves(order, space)
    rows = np.kron(np.eye(16), design(order, (fit.pattern.u + 1) / 2)) @ of_masters.toarray()
    root = np.sqrt(weight).ravel()
    expected = np.linalg.lstsq(rows * root[:, None], fit.value.ravel() * root, rcond=None)[0]
    np.testing.assert_allclose(values, expected, atol=1e-4)
    np.testing.assert_allclose(residual.ravel(), fit.value.ravel() - rows @ values, atol=1e-9)


def test_residuals_without_weight_are_zero():
    space, fit = space_and_fit(np.random.default_rng(0).normal(size=(16, 48)))
    weight = np.ones((16, 48))
    weight[2] = 0
    _, residual = fit_values(0, space, fit, weight)
    assert (residual[2] == 0).all() and (np.delete(residual, 2, axis=0) != 0).all()


def test_values_that_no_sample_holds_are_harmless():
    space, fit = space_and_fit(np.full((16, 48), 7.0))
    weight = np.zeros((16, 48))
    weight[3] = 1.0
    values, _ = fit_values(0, space, fit, weight)
    np.testing.assert_allclose(values, 7.0, rtol=1e-6)
