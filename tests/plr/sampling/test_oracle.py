import numpy as np
import pytest
from plr_helpers import cone, points

from plr_jax.plr.sampling.oracle import call_oracle, call_weights


def test_distances_are_doubles_and_inf_passes():
    found = call_oracle(lambda x: np.array([1, np.inf, 0], np.float32), points(3, 0))
    assert found.dtype == np.float64 and found.tolist() == [1, np.inf, 0]
    assert call_oracle(lambda x: [3, 4, 5], points(3, 0)).tolist() == [3, 4, 5]


@pytest.mark.parametrize("dtype", [float, int])
def test_masked_distances_are_infinite(dtype):
    """What stands under a mask means nothing."""
    masked = lambda x: np.ma.masked_array(np.array([7, 0, -3], dtype), [False, True, True])  # noqa: E731
    assert call_oracle(masked, points(3, 0)).tolist() == [7, np.inf, np.inf]


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
