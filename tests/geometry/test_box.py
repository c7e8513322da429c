import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plr_jax.geometry.box import Box, Slice


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


TURN = Box((0, -np.pi), (2, np.pi), periodic=(False, True))


def test_which_axes_are_periodic_is_a_part_of_a_box():
    assert TURN.periodic == (False, True) and TURN.is_periodic
    assert Box((0, 0), (1, 1)).periodic == (False, False) and not Box((0, 0), (1, 1)).is_periodic
    assert Box((0, 0), (1, 1), (np.True_, False)) == Box((0, 0), (1, 1), [True, False])
    assert Box((0, 0), (1, 1), (True, False)) != Box((0, 0), (1, 1))
    assert len({Box((0, 0), (1, 1), (True, False)), Box((0, 0), (1, 1), (False, True)), Box((0, 0), (1, 1))}) == 3
    assert repr(Box((0, 0), (1, 1), (True, False))) == "Box([0.0, 0.0], [1.0, 1.0], periodic=(True, False))"
    assert repr(Box((0,), (1,))) == "Box([0.0], [1.0])"


def test_messages_tell_ends_without_what_arithmetic_made_of_their_last_digits():
    box = Box((0.1 + 0.2, -1), (146 * 0.05, 5334012.654321), (False, True))
    assert f"{box}" == "Box([0.3, -1.0], [7.3, 5334012.65432], periodic=(False, True))"
    assert eval(repr(box)) == box
    assert Box.of(TURN) is TURN


@pytest.mark.parametrize(
    "periodic", [True, (True,), (True, False, True), "no", ((True, False),), (1, 0), (True, None)]
)
def test_what_does_not_say_of_each_axis_whether_it_is_periodic_is_refused(periodic):
    with pytest.raises(ValueError, match="Box periodic must be"):
        Box((0, 0), (1, 1), periodic=periodic)


def test_every_finite_coordinate_is_inside_along_a_periodic_axis():
    x = np.array([[1, 100.0], [1, -100.0], [2.1, 0], [1, np.inf], [1, np.nan], [2, np.pi]])
    np.testing.assert_array_equal(TURN.contains(x), [True, True, False, False, False, True])


def test_points_are_wrapped_by_whole_periods():
    box = Box((-1, 10), (3, 11), periodic=(True, False))
    x = [[-1.0, 5], [2.5, 5], [3, 5], [4.5, 5], [-1.25, 5], [12, 11.5], [np.inf, 5], [np.nan, np.nan]]
    expected = [[-1.0, 5], [2.5, 5], [-1, 5], [0.5, 5], [2.75, 5], [0, 11.5], [np.inf, 5], [np.nan, np.nan]]
    np.testing.assert_array_equal(box.wrapped(x), expected)
    np.testing.assert_array_equal(box.wrapped(np.array(x)[None, 3]), [[0.5, 5]])
    np.testing.assert_array_equal(box.wrapped([3.0, 5.0]), [-1, 5])


@given(lo=st.floats(-1e3, 1e3), width=st.floats(1e-3, 1e3), turns=st.integers(-1000, 1000), share=st.floats(0, 1))
def test_wrapped_points_are_below_the_upper_end_and_the_seam_is_at_the_lower_one(lo, width, turns, share):
    box = Box([lo], [lo + width], [True])
    (lo,), (hi,), (width,) = box.lo, box.hi, box.width
    x = lo + (turns + share) * width
    (found,) = box.wrapped([x])
    assert lo <= found < hi
    away = (x - found) / width
    assert abs(away - round(away)) < 1e-9 * (1 + np.abs(lo) / width)
    assert box.wrapped([found]) == found
    assert box.wrapped([hi]) == box.wrapped([lo + turns * width]) == lo
    assert box.wrapped([np.nextafter(hi, -np.inf)]) == np.nextafter(hi, -np.inf)
    for just_outside in (np.nextafter(lo, -np.inf), np.nextafter(hi, np.inf), -1e-300, 1e300, -1e300):
        assert lo <= box.wrapped([just_outside])[0] < hi


def test_differences_go_the_short_way_around():
    a, b = np.array([[0.5, 3.0], [0.5, -3.0], [1.5, 0.5]]), np.array([[0.0, -3.0], [2.0, 3.0], [0.5, 7.0]])
    short = 2 * np.pi - 6
    np.testing.assert_allclose(TURN.difference(a, b), [[0.5, -short], [-1.5, short], [1, 0.5 - (7 - 2 * np.pi)]])
    np.testing.assert_allclose(TURN.image_near(a, b), b + TURN.difference(a, b))
    np.testing.assert_array_equal(Box((0, -np.pi), (2, np.pi)).difference(a, b), a - b)
    # Within half a period nothing is rounded.
    near = np.array([0.3, 0.1])
    np.testing.assert_array_equal(TURN.image_near(near, [0.2, -3.0]), near)
    np.testing.assert_array_equal(TURN.difference(near, [[0.2, -3.0]]), [near - [0.2, -3.0]])


@pytest.mark.parametrize(
    "ask", [TURN.wrapped, lambda x: TURN.difference(x, [0.0, 0]), lambda x: TURN.image_near([0, 0], x)]
)
def test_points_of_other_dimensions_are_not_wrapped(ask):
    with pytest.raises(ValueError, match=r"must have shape \(\.\.\., 2\), got \(1, 3\)"):
        ask(np.zeros((1, 3)))
    with pytest.raises(ValueError, match="some are masked"):
        ask(np.ma.masked_less([[-1.0, 2.0]], 0))


# --- slices ----------------------------------------------------------------------------------------------


def test_a_slice_holds_the_coordinates_that_are_given():
    box = Box((0, -1, 5), (4, 1, 7), periodic=(False, True, False))
    shown = Slice.of(box, {1: 2.5})  # around the seam: 0.5
    assert shown.axes == (0, 2) and shown.box == Box((0, 5), (4, 7))
    points = shown.grid(4)
    assert points.shape == (2, 4, 3)
    np.testing.assert_allclose(points[1, 2], (2.5, 0.5, 6.5))
    assert Slice.of(box, {0: 1}).box == Box((-1, 5), (1, 7), periodic=(True, False))


def test_a_slice_of_the_plane_is_the_plane():
    box = Box((0, 0), (3, 1))
    shown = Slice.of(box, None)
    assert shown.box == box and shown.axes == (0, 1)
    np.testing.assert_array_equal(shown.grid(6), box.grid(6))


@pytest.mark.parametrize(
    ("at", "message"),
    [
        (None, "of 3 coordinates, at must give 1, got 0"),
        ({0: 1.0, 1: 0.0}, "must give 1, got 2"),
        ({3: 1.0}, "at must be coordinates by axis"),
        ({-1: 6.0}, "at must be coordinates by axis"),
        ({0: 9.0}, "at must lie in Box"),
        ({0: float("nan")}, "must have finite coordinates"),
    ],
)
def test_slices_that_are_none(at, message):
    with pytest.raises(ValueError, match=message):
        Slice.of(Box((0, -1, 5), (4, 1, 7)), at)
