"""Leaf models: their names and codes, and what holds of the numbers of every model with free parameters."""

import numpy as np
import pytest

from plr_jax.plr import Continuous, Plane
from plr_jax.plr.leaves import code_of_leaf, leaf_model, leaf_of_code
from plr_jax.plr.leaves.base import linear_mean_planes
from plr_jax.plr.leaves.cone.model import Cone

MODELS = {"plane": Plane(), "continuous": Continuous(order=0), "smooth": Continuous(order=1), "cone": Cone()}


@pytest.mark.parametrize(("code", "name"), list(enumerate(MODELS)))
def test_every_model_has_a_name_and_a_code_that_stay(code, name):
    model = MODELS[name]
    assert leaf_model(name) == leaf_of_code(code) == leaf_model(model) == model
    assert code_of_leaf(model) == code and model.name == name


def test_options_of_a_model_do_not_change_its_code_but_compiled_queries_are_told_apart_by_them():
    assert code_of_leaf(Plane(coefficient_bits=16)) == 0
    assert leaf_model(Plane(coefficient_bits=16)).coefficient_bits == 16
    assert len({Plane(), Plane(), Plane(coefficient_bits=8), Continuous(), Continuous(order=0)}) == 3


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("make", "wrong", "message"),
    [
        (leaf_model, "cubic", "one of 'plane', 'continuous', 'smooth', 'cone', got 'cubic'"),
        (leaf_model, 7, r"leaf must be a leaf model or its name, one of 'plane', .*, got 7"),
        (leaf_of_code, 4, "it has leaves of kind 4, this release knows kinds 0 to 3"),
        (lambda order: Continuous(order=order), 2, "order must be 0 or 1, got 2"),
        *(
            (lambda bits: Plane(coefficient_bits=bits), bits, f"bits must be 32 .floats. or 4 to 20, got {bits}")
            for bits in (3, 21, 31, 33, 0, -1)
        ),
        (lambda bits: Plane(coefficient_bits=bits), 8.5, "coefficient_bits"),
    ],
)
def test_what_is_no_model_is_refused(make, wrong, message):
    with pytest.raises((ValueError, TypeError), match=message):
        make(wrong)


@pytest.mark.parametrize("dim", [1, 2])
def test_coefficients_of_planes_are_planes(leaf, dim):
    model, rng = leaf_model(leaf), np.random.default_rng(0)
    center, half, u = rng.normal(size=5), rng.normal(size=(5, dim)), rng.uniform(-1, 1, size=(30, dim))
    coefficients = model.of_planes(center, half)
    np.testing.assert_allclose(coefficients @ model.basis(u).T, center[:, None] + half @ u.T, atol=1e-12)
    for found, expected in zip(linear_mean_planes(model, coefficients, dim), (center, half), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-12)
