import numpy as np
import pytest

from plr_jax.geometry.box import Box


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
        ((0, np.nan), (1, 1), "Box lo must have finite coordinates"),
        ((0, 0), (np.inf, 1), "Box hi must have finite coordinates"),
        (0.0, 1.0, r"Box lo must be one point of shape \(dim,\), got shape \(\)"),
        ("a", "b", "Box lo must be numbers"),
    ],
)
def test_bad_corners_are_refused(lo, hi, message):
    with pytest.raises(ValueError, match=message):
        Box(lo, hi)


def test_a_box_may_be_given_by_its_corners():
    box = Box((0, 1), (2, 5))
    assert Box.of(box) is box
    assert Box.of(((0, 1), (2, 5))) == Box.of(np.array([[0, 1], [2, 5]])) == box


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (((0, 0),), "The box must be a Box or its corners"),
        (3.0, "The box must be a Box or its corners"),
        (None, "The box must be a Box or its corners"),
        ("ab", "Box lo must be numbers"),
        (((0, 0), (1, 0)), "positive width"),
    ],
)
def test_what_is_no_box_is_refused(value, message):
    with pytest.raises(ValueError, match=message):
        Box.of(value)


def test_points_of_another_dimension_are_refused():
    with pytest.raises(ValueError, match=r"shape \(n, 2\), got \(1, 3\)"):
        Box((0, 0), (1, 1)).contains(np.zeros((1, 3)))


def test_a_grid_fills_the_box_with_square_cells():
    centers = Box((1, 2), (5, 4)).grid(4)
    np.testing.assert_allclose(centers[0], [[1.5, 2.5], [2.5, 2.5], [3.5, 2.5], [4.5, 2.5]])
    np.testing.assert_allclose(centers[1, 0], [1.5, 3.5])
    assert centers.shape == (2, 4, 2)
    # A sliver keeps one row.
    assert Box((0, 0), (100, 1)).grid(10).shape == (1, 10, 2)
    with pytest.raises(ValueError, match="integer >= 1"):
        Box((0, 0), (1, 1)).grid(0)
    with pytest.raises(ValueError, match="two dimensions, got 3"):
        Box((0, 0, 0), (1, 1, 1)).grid(4)
