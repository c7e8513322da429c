import numpy as np

from plr_jax.oracles import Euclidean


def test_distance_in_several_dimensions():
    np.testing.assert_allclose(Euclidean((0, 0))(np.array([[3, 4], [0, 0]])), [5, 0])
    np.testing.assert_allclose(Euclidean((1, 1, 1, 1))(np.array([[2.0, 2, 2, 2]])), [2])
    np.testing.assert_allclose(Euclidean([2.0])(np.array([[-1.5]])), [3.5])
    assert Euclidean((0, 0))(np.zeros((3, 2), dtype=np.float32)).dtype == np.float64


def test_points_that_are_not_finite_are_unreachable():
    x = np.array([[np.nan, 0.0], [0.0, np.inf], [np.inf, np.nan], [-np.inf, np.inf]])
    np.testing.assert_array_equal(Euclidean((0, 0))(x), [np.inf] * 4)
