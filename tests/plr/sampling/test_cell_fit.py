import numpy as np
import pytest
from plr_helpers import cone, points

from plr_jax.geometry.box import Box
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.sampling.cell_fit import Sampler, call_oracle, call_weights, sample_pattern

LINE = Box([0.0], [2.0])


def fit(distance_fn, weight_fn=None, cells=None, domain=LINE, num_samples=64):
    pattern = sample_pattern(domain.dim, num_samples, 0.0, 0)
    return Sampler(distance_fn, domain, weight_fn, pattern, pattern, 14)(
        Cells.root(domain.dim) if cells is None else cells
    )


def left_half(x):
    return np.where(x[:, 0] < 1, 3 + 2 * x[:, 0], np.inf)


def test_blocked_cells_are_marked_and_residuals_kept():
    found = fit(left_half, cells=Cells.root(1).split(np.array([0])), num_samples=16)
    assert np.isfinite(found.center[0]) and np.isinf(found.center[1])
    np.testing.assert_allclose([found.center[0], found.half[0, 0]], [4.0, 1.0], atol=1e-7)
    assert np.abs(found.residual).max() < 1e-7
    assert not found.reachable[1].any() and not found.weight[1].any() and not found.value[1].any()


def test_weights_pull_the_plane_and_zero_weights_do_not_void_it():
    bend = lambda x: np.abs(x[:, 0] - 1.0)  # noqa: E731
    left = fit(bend, lambda x: 1.0 * (x[:, 0] < 1))
    np.testing.assert_allclose(left.half[0, 0], -1.0, atol=1e-6)
    nowhere = fit(bend, lambda x: np.zeros(len(x)))
    np.testing.assert_allclose(nowhere.center, fit(bend).center, atol=1e-8)


def test_cells_can_be_taken_and_appended():
    found = fit(left_half, cells=Cells.root(1).split(np.array([0])).split(np.array([0, 0])), num_samples=16)
    again = found[[2, 3]].append(found[[0, 1]])
    order = [2, 3, 0, 1]
    assert len(again) == 4
    np.testing.assert_array_equal(again.cells.position, found.cells.position[order])
    for name in ("reachable", "weight", "value", "center", "half", "residual"):
        np.testing.assert_array_equal(getattr(again, name), getattr(found, name)[order])


def test_masked_cells_are_those_with_samples_of_another_weight():
    halves = Cells.root(1).split(np.array([0]))
    assert fit(left_half, cells=halves).masked.tolist() == [0, 1]  # a sample on the face at 1 is blocked
    assert fit(lambda x: x[:, 0], cells=halves).masked.tolist() == []
    assert fit(lambda x: x[:, 0], lambda x: np.where(x[:, 0] > 1, 2.0, 1.0), cells=halves).masked.tolist() == [1]


def test_noise_is_what_floats_resolve_of_the_largest_distance():
    np.testing.assert_allclose(fit(lambda x: np.full(len(x), 3.0)).noise, 3 * 2.0**-23)
    np.testing.assert_allclose(
        fit(lambda x: np.full(len(x), 3.0), lambda x: np.full(len(x), 0.5)).noise, 1.5 * 2**-23
    )


def test_cells_can_be_split_until_every_axis_is_at_its_end():
    cells = Cells(np.array([[14, 13], [14, 14]]), np.zeros((2, 2), int))
    assert fit(lambda x: x[:, 0], cells=cells, domain=Box((0, 0), (1, 1))).can_split.tolist() == [True, False]


def test_a_root_without_a_reachable_sample_is_refused():
    sampler = Sampler(lambda x: np.full(len(x), np.inf), LINE, None, *2 * [sample_pattern(1, 16, 0.0, 0)], 14)
    with pytest.raises(ValueError, match="found nothing reachable"):
        sampler.root()


@pytest.mark.parametrize(
    ("rule", "message"),
    [
        (lambda pattern, value, weight: (value[:, 0], value[:, 1]), "compute_coefficients must return shapes"),
        (lambda pattern, value, weight: (value[:, 0] * np.nan, value[:, :1]), "must return finite planes"),
        (lambda pattern, value, weight: (np.ma.masked_all(len(value)), value[:, :1]), "or masked numbers"),
    ],
)
def test_bad_fits_are_refused(rule, message):
    sampler = Sampler(lambda x: x[:, 0], LINE, None, *2 * [sample_pattern(1, 16, 0.0, 0)], 14, rule)
    with pytest.raises(ValueError, match=message):
        sampler(Cells.root(1))


def test_cells_whose_free_part_is_hardly_met_are_sampled_again():
    """Two reachable samples a coefficient of a plane, and no more: a plane passes near them all."""
    sliver = lambda x: np.where(np.abs(x[:, 0] - 0.92) < 0.03, x[:, 0], np.inf)  # noqa: E731
    patterns = [sample_pattern(1, num_samples, 0.0, 0) for num_samples in (64, 512)]
    sampler = Sampler(sliver, LINE, None, *patterns, 14)
    few, many = sampler(Cells.root(1)), sampler.densely(Cells.root(1))
    assert few.is_hardly_seen.tolist() == [True] and many.is_hardly_seen.tolist() == [False]
    assert few.reachable.sum() < many.reachable.sum() and many.value.shape == (1, 512)
    assert sampler(Cells.root(1).split(np.array([0]))).is_hardly_seen.tolist() == [True, True]  # the other has none


def test_distances_are_doubles_and_inf_passes():
    found = call_oracle(lambda x: np.array([1, np.inf, 0], np.float32), points(3, 0))
    assert found.dtype == np.float64 and found.tolist() == [1, np.inf, 0]
    assert call_oracle(lambda x: [3, 4, 5], points(3, 0)).tolist() == [3, 4, 5]


@pytest.mark.parametrize("dtype", [float, int])
def test_masked_distances_are_infinite(dtype):
    """What stands under a mask means nothing."""
    masked = lambda x: np.ma.masked_array(np.array([7, 0, -3], dtype), [False, True, True])  # noqa: E731
    assert call_oracle(masked, points(3, 0)).tolist() == [7, np.inf, np.inf]


def test_masked_weights_are_refused():
    with pytest.raises(ValueError, match=r"weight_fn's answer must be .*, and some are masked"):
        fit(lambda x: x[:, 0], lambda x: np.ma.masked_less(np.ones(len(x)), 2))


def test_what_stands_under_a_mask_may_be_anything():
    masked = lambda x: np.ma.masked_invalid([7.0, np.nan, -np.inf])  # noqa: E731
    assert call_oracle(masked, points(3, 0)).tolist() == [7, np.inf, np.inf]


def test_an_oracle_may_compute_in_place():
    x = points(4, 0)
    kept = x.copy()

    def in_place(x):
        x *= x
        return np.sqrt(x.sum(axis=1))

    np.testing.assert_allclose(call_oracle(in_place, x), cone(kept))
    np.testing.assert_array_equal(x, kept)


@pytest.mark.parametrize(
    ("oracle", "message"),
    [
        (lambda x: x, "distance_fn must give one number a point"),
        (lambda x: np.ones(len(x) - 1), "distance_fn must give one number a point"),
        (lambda x: 1.0, "distance_fn must give one number a point"),
        (lambda x: np.full(len(x), np.nan), r"distance_fn gives NaN at \[.*; use inf for unreachable"),
        (lambda x: np.full(len(x), -np.inf), "distance_fn gives -inf at"),
        (lambda x: np.full(len(x), "far"), "answer must be real numbers"),
        (lambda x: {}, "answer must be real numbers"),
        (lambda x: [[1.0], [2.0, 3.0]], "answer must be real numbers"),
        (lambda x: 1j * cone(x), "answer must be real numbers"),
    ],
)
def test_bad_oracles_are_refused(oracle, message):
    with pytest.raises(ValueError, match=message):
        call_oracle(oracle, points(5, 0))


@pytest.mark.parametrize("weights", [lambda x: -np.ones(len(x)), lambda x: x, lambda x: np.full(len(x), np.nan)])
def test_bad_weights_are_refused(weights):
    with pytest.raises(ValueError, match=r"weight_fn must (return finite weights >= 0|give one number a point)"):
        call_weights(weights, points(5, 0))
