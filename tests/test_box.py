import numpy as np
import pytest

from plr_jax._box import Box


def test_box_keeps_its_corners():
    box = Box((0, 1), (2, 5))
    assert box.dim == 2
    np.testing.assert_array_equal(box.width, [2.0, 4.0])
    np.testing.assert_array_equal(
        box.contains(np.array([[0.0, 1.0], [2.0, 5.0], [2.1, 3.0], [np.nan, 3.0]])),
        [True, True, False, False],
    )


def test_boxes_of_equal_corners_are_equal():
    assert Box((0, 0), (1, 1)) == Box([0.0, 0.0], [1.0, 1.0])
    assert hash(Box((0, 0), (1, 1))) == hash(Box([0.0, 0.0], [1.0, 1.0]))
    assert Box((0, 0), (1, 1)) != Box((0, 0), (1, 2))


@pytest.mark.parametrize(
    ("lo", "hi", "message"),
    [
        ((0, 0), (1, 0), "positive width along every axis.*axis 1"),
        ((0, 0), (1, 1, 1), "one length"),
        ((0, np.nan), (1, 1), "vector of finite numbers"),
        ((0, 0), (np.inf, 1), "vector of finite numbers"),
        (0.0, 1.0, "vector of finite numbers"),
    ],
)
def test_bad_corners_are_refused(lo, hi, message):
    with pytest.raises(ValueError, match=message):
        Box(lo, hi)
