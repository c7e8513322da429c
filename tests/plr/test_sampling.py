"""Samples of cells, least squares of planes, and checks of what oracles return."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plr_helpers import cone, lstsq_plane, points, sampler_of

from plr_jax.geometry.box import Box
from plr_jax.plr import sampling as sampling
from plr_jax.plr.tree import Cells

LINE = Box([0.0], [2.0])


def fit(distance_fn, weight_fn=None, cells=None):
    return sampler_of(distance_fn, LINE, weight_fn)(Cells.root(1) if cells is None else cells)


def left_half(x):
    return np.where(x[:, 0] < 1, 3 + 2 * x[:, 0], np.inf)


# Patterns and planes.


@pytest.mark.parametrize("dim", [1, 2, 3, 6])
def test_pattern_starts_at_the_center_and_fills_the_cell(dim):
    pattern = sampling.sample_pattern(dim, 100, 0.0, 0)
    assert pattern.u.shape == (100, dim) and len(pattern.weight) == 100
    np.testing.assert_array_equal(pattern.u[0], 0)
    assert np.abs(pattern.u).max() <= 1
    # Low discrepancy: each half of each axis holds close to half of the samples.
    assert np.all(np.abs(np.mean(pattern.u > 0, axis=0) - 0.5) <= 0.06)
    np.testing.assert_array_equal(pattern.u, sampling.sample_pattern(dim, 100, 0.0, 0).u)
    assert not np.array_equal(pattern.u, sampling.sample_pattern(dim, 100, 0.0, 1).u)


def test_faces_have_light_samples_and_margins_reach_beyond():
    pattern = sampling.sample_pattern(3, 90, 0.0, 0)
    for side in (-1, 1):
        assert (np.count_nonzero(pattern.u == side, axis=0) >= 5).all()
    on_face = (np.abs(pattern.u) == 1).any(axis=1)
    assert pattern.weight[on_face].max() < 0.1 * pattern.weight[~on_face].min()
    assert np.abs(sampling.sample_pattern(2, 200, 0.25, 0).u).max() == pytest.approx(1.5)


@given(seed=st.integers(0, 1000), dim=st.integers(1, 5))
def test_batched_fit_equals_lstsq_cell_by_cell(seed, dim):
    rng = np.random.default_rng(seed)
    pattern = sampling.sample_pattern(dim, 40, 0.0, seed)
    value = rng.normal(size=(6, 40))
    weight = np.ones((6, 40))
    weight[2:] = rng.random((4, 40)) < 0.6
    weight[4:] *= rng.uniform(0.1, 3, size=(2, 40))
    center, half = sampling.least_squares(pattern, value, weight)
    for cell in range(6):
        expected = lstsq_plane(pattern.u, value[cell], weight[cell] * pattern.weight)
        np.testing.assert_allclose(np.r_[center[cell], half[cell]], expected, rtol=1e-6, atol=1e-7)


def test_undetermined_directions_get_slope_zero():
    pattern = sampling.Pattern(np.array([[0.0, 0.0], [0.5, 0.25], [-0.5, 0.25], [0.3, -0.9]]), np.ones(4))
    value = np.array([[7.0, 0, 0, 0], [0, 3.0, 1.0, 0], [5.0, 5.0, 5.0, 5.0]])
    weight = np.array([[1.0, 0, 0, 0], [0, 1, 1, 0], [0, 0, 0, 0]])
    center, half = sampling.least_squares(pattern, value, weight)
    np.testing.assert_allclose(center, [7, 2, 0], atol=1e-6)
    np.testing.assert_allclose(half, [[0, 0], [2, 0], [0, 0]], atol=1e-6)


# Cells.


def test_blocked_cells_and_indexing_of_fits():
    found = fit(left_half, cells=Cells.root(1).split(np.array([0])))
    assert np.isfinite(found.center[0]) and np.isinf(found.center[1])
    np.testing.assert_allclose([found.center[0], found.half[0, 0]], [4.0, 1.0], atol=1e-7)
    assert np.abs(found.residual).max() < 1e-7
    assert not found.reachable[1].any() and not found.weight[1].any() and not found.value[1].any()
    again = found[[1]].append(found[[0]])
    assert len(again) == 2
    np.testing.assert_array_equal(again.cells.position, found.cells.position[::-1])
    for name in ("reachable", "weight", "value", "center", "half", "residual"):
        np.testing.assert_array_equal(getattr(again, name), getattr(found, name)[::-1])


def test_planes_follow_weights_unless_all_are_zero():
    bend = lambda x: np.abs(x[:, 0] - 1.0)  # noqa: E731
    left, nowhere = fit(bend, lambda x: 1.0 * (x[:, 0] < 1)), fit(bend, lambda x: np.zeros(len(x)))
    np.testing.assert_allclose(left.half[0, 0], -1.0, atol=1e-6)
    np.testing.assert_allclose(nowhere.center, fit(bend).center, atol=1e-8)


def test_noise_is_the_resolution_of_the_largest_distance():
    three = lambda x: np.full(len(x), 3.0)  # noqa: E731
    np.testing.assert_allclose(fit(three).noise, 3 * 2.0**-23)
    np.testing.assert_allclose(fit(three, lambda x: np.full(len(x), 0.5)).noise, 1.5 * 2**-23)


def test_cells_with_few_reachable_samples_are_hardly_seen():
    """They have at most two reachable samples a coefficient, so that a plane passes near all of them."""
    sliver = lambda x: np.where(np.abs(x[:, 0] - 0.92) < 0.03, x[:, 0], np.inf)  # noqa: E731
    patterns = [sampling.sample_pattern(1, num_samples, 0.0, 0) for num_samples in (64, 512)]
    sampler = sampling.Sampler(sliver, LINE, None, *patterns, 14)
    few, many = sampler(Cells.root(1)), replace(sampler, pattern=sampler.dense_pattern)(Cells.root(1))
    assert few.is_hardly_seen.tolist() == [True] and many.is_hardly_seen.tolist() == [False]
    assert few.reachable.sum() < many.reachable.sum() and many.value.shape == (1, 512)
    assert sampler(Cells.root(1).split(np.array([0]))).is_hardly_seen.tolist() == [True, True]  # the other has none


@pytest.mark.parametrize(
    ("rule", "message"),
    [
        (lambda pattern, value, weight: (value[:, 0], value[:, 1]), "compute_coefficients must return shapes"),
        (lambda pattern, value, weight: (value[:, 0] * np.nan, value[:, :1]), "must return finite planes"),
        (lambda pattern, value, weight: (np.ma.masked_all(len(value)), value[:, :1]), "or masked numbers"),
    ],
)
def test_invalid_coefficients_raise(rule, message):
    sampler = sampling.Sampler(lambda x: x[:, 0], LINE, None, *2 * [sampling.sample_pattern(1, 16, 0.0, 0)], 14, rule)
    with pytest.raises(ValueError, match=message):
        sampler(Cells.root(1))


# Answers.


@pytest.mark.parametrize(
    ("answer", "expected"),  # what stands under a mask means nothing
    [
        (np.array([1, np.inf, 0], np.float32), [1, np.inf, 0]),
        ([3, 4, 5], [3, 4, 5]),
        (np.ma.masked_array([7.0, 0, -3], [False, True, True]), [7, np.inf, np.inf]),
        (np.ma.masked_array([7, 0, -3], [False, True, True]), [7, np.inf, np.inf]),
        (np.ma.masked_invalid([7.0, np.nan, -np.inf]), [7, np.inf, np.inf]),
    ],
)
def test_distances_are_doubles_and_inf_where_masked(answer, expected):
    found = sampling.call_oracle(lambda x: answer, points(3, 0))
    assert found.dtype == np.float64 and found.tolist() == expected


def test_an_oracle_may_compute_in_place():
    x = points(4, 0)
    kept = x.copy()

    def in_place(x):
        x *= x
        return np.sqrt(x.sum(axis=1))

    np.testing.assert_allclose(sampling.call_oracle(in_place, x), cone(kept))
    np.testing.assert_array_equal(x, kept)


def ask_distances(answer):
    return sampling.call_oracle(answer, points(5, 0))


def ask_weights(answer):
    return sampling.call_weights(answer, points(5, 0))


@pytest.mark.parametrize(
    ("ask", "answer", "message"),
    [
        (ask_distances, lambda x: x, "distance_fn must give one number per point"),
        (ask_distances, lambda x: np.ones(len(x) - 1), "distance_fn must give one number per point"),
        (ask_distances, lambda x: 1.0, "distance_fn must give one number per point"),
        (ask_distances, lambda x: np.full(len(x), np.nan), r"gives NaN at \[.*; use inf for unreachable"),
        (ask_distances, lambda x: np.full(len(x), -np.inf), "distance_fn gives -inf at"),
        (ask_distances, lambda x: np.full(len(x), "far"), "answer must be real numbers"),
        (ask_distances, lambda x: {}, "answer must be real numbers"),
        (ask_distances, lambda x: [[1.0], [2.0, 3.0]], "answer must be real numbers"),
        (ask_distances, lambda x: 1j * cone(x), "answer must be real numbers"),
        (ask_weights, lambda x: -np.ones(len(x)), "weight_fn must return finite weights >= 0"),
        (ask_weights, lambda x: np.full(len(x), np.nan), "weight_fn must return finite weights >= 0"),
        (ask_weights, lambda x: x, "weight_fn must give one number per point"),
        (ask_weights, lambda x: np.ma.masked_less(np.ones(len(x)), 2), "weight_fn's answer must be .*masked"),
    ],
)
def test_invalid_answers_raise(ask, answer, message):
    with pytest.raises(ValueError, match=message):
        ask(answer)


@pytest.mark.parametrize("fn", [lambda x: float(x[0] + x[1]), lambda x, y: x + y, lambda x: 1.0 if x[0] else 2.0])
def test_functions_of_one_point_raise_with_a_note(fn):
    with pytest.raises((TypeError, ValueError)) as caught:
        ask_distances(fn)
    (note,) = caught.value.__notes__
    assert note == "distance_fn must return distances (n,) for points (n, dim); it was called with shape (5, 2)."


def test_norms_of_all_points_raise():
    with pytest.raises(ValueError, match=r"shape \(5,\), got \(\); it is called with a batch of points \(5, dim\)"):
        ask_distances(np.linalg.norm)
