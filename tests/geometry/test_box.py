import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from plr_jax.geometry.box import Box, Slice

UNIT = (0, 0), (1, 1)
BOX = Box((0, 1), (2, 5))
TURN = Box((0, -np.pi), (2, np.pi), periodic=(False, True))
SPACE = Box((0, -1, 5), (4, 1, 7))


def test_box_contains_points_between_its_corners():
    np.testing.assert_array_equal(BOX.width, [2.0, 4.0])
    x = np.array([[0.0, 1.0], [2.0, 5.0], [2.1, 3.0], [np.nan, 3.0]])
    np.testing.assert_array_equal(BOX.contains(x), [True, True, False, False])
    # Along a periodic axis every finite coordinate is inside.
    x = np.array([[1, 100.0], [1, -100.0], [2.1, 0], [1, np.inf], [1, np.nan], [2, np.pi]])
    np.testing.assert_array_equal(TURN.contains(x), [True, True, False, False, False, True])


def test_boxes_of_equal_corners_and_periodic_axes_are_equal():
    assert BOX.dim == 2 and Box.of(BOX) is BOX and Box.of(TURN) is TURN
    assert Box.of(((0, 1), (2, 5))) == Box.of(np.array([[0, 1], [2, 5]])) == BOX
    assert Box(*UNIT) == Box([0.0, 0.0], [1.0, 1.0]) != Box((0, 0), (1, 2))
    assert Box(*UNIT, (np.True_, False)) == Box(*UNIT, [True, False]) != Box(*UNIT)
    assert TURN.periodic == (False, True) and TURN.is_periodic
    assert BOX.periodic == (False, False) and not BOX.is_periodic
    boxes = Box(*UNIT), Box([0.0, 0.0], [1.0, 1.0]), Box(*UNIT, (True, False)), Box(*UNIT, (False, True))
    assert len(set(boxes)) == 3


def test_repr_is_exact_and_message_is_rounded():
    assert repr(Box(*UNIT, (True, False))) == "Box([0.0, 0.0], [1.0, 1.0], periodic=(True, False))"
    assert repr(Box((0,), (1,))) == "Box([0.0], [1.0])"
    box = Box((0.1 + 0.2, -1), (146 * 0.05, 5334012.654321), (False, True))
    assert f"{box}" == "Box([0.3, -1.0], [7.3, 5334012.65432], periodic=(False, True))"
    assert eval(repr(box)) == box


def test_grid_fills_the_box_with_square_cells():
    centers = Box((1, 2), (5, 4)).grid(4)
    np.testing.assert_allclose(centers[0], [[1.5, 2.5], [2.5, 2.5], [3.5, 2.5], [4.5, 2.5]])
    np.testing.assert_allclose(centers[1, 0], [1.5, 3.5])
    assert centers.shape == (2, 4, 2)
    assert Box((0, 0), (100, 1)).grid(10).shape == (1, 10, 2)  # a sliver keeps one row


def test_points_are_wrapped_by_whole_periods():
    box = Box((-1, 10), (3, 11), periodic=(True, False))
    x = [[-1.0, 5], [2.5, 5], [3, 5], [4.5, 5], [-1.25, 5], [12, 11.5], [np.inf, 5], [np.nan, np.nan]]
    expected = [[-1.0, 5], [2.5, 5], [-1, 5], [0.5, 5], [2.75, 5], [0, 11.5], [np.inf, 5], [np.nan, np.nan]]
    np.testing.assert_array_equal(box.wrapped(x), expected)
    np.testing.assert_array_equal(box.wrapped([3.0, 5.0]), [-1, 5])


@given(lo=st.floats(-1e3, 1e3), width=st.floats(1e-3, 1e3), turns=st.integers(-1000, 1000), share=st.floats(0, 1))
def test_wrapped_points_lie_in_the_half_open_period(lo, width, turns, share):
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


def test_differences_take_the_short_way_around():
    a, b = np.array([[0.5, 3.0], [0.5, -3.0], [1.5, 0.5]]), np.array([[0.0, -3.0], [2.0, 3.0], [0.5, 7.0]])
    short = 2 * np.pi - 6
    np.testing.assert_allclose(TURN.difference(a, b), [[0.5, -short], [-1.5, short], [1, 0.5 - (7 - 2 * np.pi)]])
    np.testing.assert_allclose(TURN.image_near(a, b), b + TURN.difference(a, b))
    np.testing.assert_array_equal(Box((0, -np.pi), (2, np.pi)).difference(a, b), a - b)
    # Within half a period nothing is rounded.
    near = np.array([0.3, 0.1])
    np.testing.assert_array_equal(TURN.image_near(near, [0.2, -3.0]), near)
    np.testing.assert_array_equal(TURN.difference(near, [[0.2, -3.0]]), [near - [0.2, -3.0]])


def test_slice_fixes_given_coordinates():
    box = Box(SPACE.lo, SPACE.hi, periodic=(False, True, False))
    shown = Slice.of(box, {1: 2.5})  # around the seam: 0.5
    assert shown.axes == (0, 2) and shown.box == Box((0, 5), (4, 7))
    points = shown.grid(4)
    assert points.shape == (2, 4, 3)
    np.testing.assert_allclose(points[1, 2], (2.5, 0.5, 6.5))
    assert Slice.of(box, {0: 1}).box == Box((-1, 5), (1, 7), periodic=(True, False))
    plane = Slice.of(BOX, None)
    assert plane.box == BOX and plane.axes == (0, 1)
    np.testing.assert_array_equal(plane.grid(6), BOX.grid(6))
