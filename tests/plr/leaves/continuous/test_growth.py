import jax.numpy as jnp
import numpy as np
import pytest
from plr_helpers import cone, walled

from plr_jax.plr import ConstructionInterrupted, construct
from plr_jax.plr.leaves.continuous.growth import construct_continuous

SQUARE = ((0, 0), (1, 1))


def free_points(n=20_000, seed=5):
    x = np.random.default_rng(seed).random((n, 2))
    return x[np.isfinite(walled(x))]


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_one_leaf_holds_a_multilinear_function(dim):
    def product(x):
        return 1 + np.prod(1 + x * np.arange(1, dim + 1), axis=1)

    plr = construct_continuous(product, (np.zeros(dim), np.ones(dim)), max_leaves=1)
    x = np.random.default_rng(0).random((100, dim))
    np.testing.assert_allclose(plr(x), product(x), rtol=3e-6)


@pytest.mark.parametrize("order", [0, 1])
def test_linear_functions_are_held_across_leaves_and_walls(order):
    def linear(x):
        return np.where(np.isfinite(walled(x)), 3 + x @ [2.0, -1.0], np.inf)

    plr = construct_continuous(linear, SQUARE, order=order, tolerance=0)
    x = free_points(500)
    assert plr.num_leaves < 200
    np.testing.assert_allclose(plr(x), linear(x), rtol=1e-5)


@pytest.mark.parametrize("order", [0, 1])
def test_at_equal_bytes_it_errs_less_than_planes(order):
    x = free_points()
    planes = construct(walled, SQUARE, max_bytes=1000)
    continuous = construct_continuous(walled, SQUARE, max_bytes=1000, order=order)
    assert 960 <= continuous.num_bytes <= 1000
    errors = [np.abs(np.asarray(plr(x)) - walled(x)).mean() for plr in (continuous, planes)]
    assert errors[0] < 0.8 * errors[1]


def test_limits():
    assert construct_continuous(cone, SQUARE, max_leaves=37).num_leaves == 37
    plr = construct_continuous(cone, SQUARE, tolerance=0.01)
    x = np.random.default_rng(0).random((5000, 2))
    assert np.abs(np.asarray(plr(x)) - cone(x)).max() < 0.015
    assert plr.num_leaves < 60


def test_the_same_seed_gives_the_same_bytes():
    first, second, other = (construct_continuous(walled, SQUARE, max_leaves=40, seed=seed) for seed in (1, 1, 2))
    assert first.to_bytes() == second.to_bytes() != other.to_bytes()


def test_weights_draw_leaves():
    plr = construct_continuous(cone, SQUARE, max_leaves=64, weight_fn=lambda x: np.where(x[:, 0] > 0.5, 1.0, 0.001))
    assert np.mean(plr.leaf_boxes[0][:, 0] >= 0.5) > 0.8


def test_an_interrupt_keeps_what_there_is():
    calls = []

    def interrupted(x):
        calls.append(len(x))
        if len(calls) == 12:
            raise KeyboardInterrupt
        return cone(x)

    with pytest.warns(ConstructionInterrupted):
        plr = construct_continuous(interrupted, SQUARE, max_leaves=1000)
    assert 1 < plr.num_leaves < 1000
    assert jnp.isfinite(plr(jnp.array([0.3, 0.3])))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"order": 2}, "order must be 0"),
        ({"order": 1, "domain": (np.zeros(3), np.ones(3))}, "up to 2 dimensions, got 3. Use order=0 or"),
        ({"domain": (np.zeros(7), np.ones(7))}, "up to 6 dimensions, got 7. Use construct"),
        ({"num_samples": 4}, r"num_samples must be at least 2\*\*dim \+ 1 = 5, got 4"),
        ({"seed": -1}, "seed must be an integer >= 0"),
        ({"max_leaves": 0}, "max_leaves must be an integer >= 1"),
        ({"max_bytes": 20}, "one leaf takes"),
        ({"distance_fn": lambda x: np.full(len(x), np.inf)}, "nothing reachable"),
        ({"distance_fn": lambda x: np.full(len(x), np.nan)}, "must return numbers"),
    ],
)
def test_bad_arguments_are_refused(options, message):
    arguments = {"distance_fn": cone, "domain": SQUARE, **options}
    with pytest.raises(ValueError, match=message):
        construct_continuous(**arguments)
