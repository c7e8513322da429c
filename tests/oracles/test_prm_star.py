import numpy as np
import pytest

from plr_jax.geometry.box import Box
from plr_jax.oracles._prm_star import checked_is_free, checked_is_visible

LINE = Box([0.0], [10.0])


def sampled_test(resolution, is_free=lambda x: np.ones(len(x), dtype=bool)):
    """A sampled test of motions, and the list of all configurations it tests."""
    tested = []

    def recorded(x):
        tested.append(x)
        return is_free(x)

    return checked_is_visible(checked_is_free(LINE, recorded), None, resolution), tested


@pytest.mark.parametrize(("length", "num_inner"), [(0.0, 0), (0.4, 0), (0.5, 0), (0.6, 1), (2.0, 3), (2.1, 4)])
def test_a_motion_is_tested_evenly_at_steps_of_at_most_the_resolution(length, num_inner):
    is_visible, tested = sampled_test(0.5)
    assert is_visible(np.array([[3.0]]), np.array([[3.0 + length]]))[0]
    inner = np.concatenate([np.empty((0, 1)), *tested])[:, 0]
    np.testing.assert_allclose(inner, np.linspace(3.0, 3.0 + length, num_inner + 2)[1:-1])


def test_each_motion_is_judged_by_its_own_configurations():
    is_visible, _ = sampled_test(0.1, lambda x: (x[:, 0] <= 4.0) | (x[:, 0] >= 5.0))
    a = np.array([[1.0], [1.0], [7.0], [4.0], [6.0], [3.0]])
    b = np.array([[3.0], [6.0], [2.0], [4.0], [9.0], [3.05]])
    np.testing.assert_array_equal(is_visible(a, b), [True, False, False, True, True, True])
    assert is_visible(a[:0], b[:0]).shape == (0,)


def test_nothing_is_free_outside_the_domain_and_the_test_is_not_asked_there():
    def is_free(x):
        assert LINE.contains(x).all()
        return x[:, 0] > 1

    inside = checked_is_free(LINE, is_free)
    x = np.array([[0.5], [2.0], [-1.0], [11.0], [np.nan]])
    np.testing.assert_array_equal(inside(x), [False, True, False, False, False])
    np.testing.assert_array_equal(inside(x[2:]), [False, False, False])
