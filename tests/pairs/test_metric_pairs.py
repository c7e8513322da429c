"""Pairs by any metric: symmetric to the bit, 0 on the diagonal, close to what was sampled."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from plr_jax import Box, construct_metric_pairs, load, save
from plr_jax.pairs import MetricPairs


def manhattan(x, y):
    return np.abs(x - y).sum(axis=1)


@pytest.fixture(scope="module")
def pairs():
    return construct_metric_pairs(manhattan, ((0.0, 0.0), (1.0, 1.0)), max_leaves=300)


def random_points(seed, dim=2):
    return np.random.default_rng(seed).uniform(0, 1, (2, 2000, dim)).astype(np.float32)


def test_answers_are_near_metric_symmetric_and_zero_on_diagonal(pairs):
    x, y = random_points(0)
    assert np.abs(np.asarray(pairs(x, y)) - manhattan(x, y)).mean() < 0.03
    np.testing.assert_array_equal(pairs(x, y), pairs(y, x))
    np.testing.assert_array_equal(pairs(x, x), 0)
    assert np.asarray(pairs(x, x + np.float32(1e-4)))[(x < 0.999).all(axis=1)].min() >= 0
    y[:, 0] = x[:, 0]
    np.testing.assert_array_equal(pairs(x, y), pairs(y, x))


@pytest.mark.full
def test_jit_vmap_and_gradients_agree(pairs):
    x, y = (jnp.asarray(points[:20]) for points in random_points(2))
    answers = jax.jit(jax.vmap(jax.value_and_grad(pairs, argnums=(0, 1))))
    (distances, gradients), (_, swapped) = answers(x, y), answers(y, x)
    np.testing.assert_allclose(distances, pairs(x, y), rtol=1e-6)
    np.testing.assert_allclose(gradients, swapped[::-1], atol=1e-6)


def test_periodic_line():
    def around(x, y):
        apart = np.abs(x - y)[:, 0] % 1
        return np.minimum(apart, 1 - apart)

    pairs = construct_metric_pairs(around, Box((0.0,), (1.0,), (True,)), max_leaves=300)
    x, y = random_points(3, dim=1)
    assert np.abs(np.asarray(pairs(x, y)) - around(x, y)).mean() < 0.01
    np.testing.assert_allclose(pairs(x + 3, y - 2), pairs(x, y), atol=1e-5)  # whole turns change nothing
    assert float(pairs(np.array([0.9]), np.array([1.1]))) == pytest.approx(0.2, abs=0.01)
    np.testing.assert_array_equal(pairs(np.full((1, 1), 0.25), np.full((1, 1), 4.25)), 0)
    np.testing.assert_allclose(jax.jit(lambda f: f(x + 3, y - 2))(pairs), pairs(x, y), atol=1e-5)


def test_points_outside_the_box_are_infinitely_far(pairs):
    ends = np.array([[0.5, 0.5], [1.5, 0.5], [np.nan, 0.5]])
    np.testing.assert_array_equal(pairs(ends, ends), [0, np.inf, np.nan])
    upper_quarter = construct_metric_pairs(manhattan, ((0.5, 0.5), (1.0, 1.0)), max_leaves=2)
    corners = jnp.array([[0, 0], [1, 1]])
    np.testing.assert_array_equal(upper_quarter(corners, corners), [np.inf, 0])


def test_answers_from_file_and_far_from_origin_agree(pairs, tmp_path):
    x, y = (points.astype(np.float64) for points in random_points(5))
    save(pairs.plr, tmp_path / "pairs.plr")
    again = MetricPairs(load(tmp_path / "pairs.plr"))
    np.testing.assert_array_equal(again(x, y), pairs(x, y))
    assert again.num_bytes == (tmp_path / "pairs.plr").stat().st_size and again.dim == 2
    far = np.array([5e5, 4e6])
    moved = construct_metric_pairs(manhattan, (far, far + 1), max_leaves=300)
    np.testing.assert_allclose(moved(far + x, far + y), pairs(x, y), atol=1e-4)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda pairs: construct_metric_pairs(manhattan, (np.zeros(4), np.ones(4))), "at most 3 dimensions"),
        (lambda pairs: pairs(np.zeros((3, 3)), np.zeros((3, 3))), r"x must be points of shape \(..., 2\)"),
        (lambda pairs: pairs(np.zeros((3, 2)), np.zeros(4)), r"y must be points of shape \(..., 2\)"),
    ],
)
def test_wrong_arguments_raise(pairs, call, message):
    with pytest.raises(ValueError, match=message):
        call(pairs)
