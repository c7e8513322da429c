import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from plr_jax.geometry.vectors import (
    arc,
    cross_product,
    distances_between,
    left_normal,
    pseudo_angle,
    turn_between,
    turned_left,
)


def test_cross_product_and_normal_point_left():
    u = np.array([[2.0, 0.0], [0.0, 3.0]])
    np.testing.assert_array_equal(left_normal(u), [[0, 1], [-1, 0]])
    np.testing.assert_array_equal(turned_left(u), [[0, 2], [-3, 0]])
    np.testing.assert_array_equal(cross_product(u, left_normal(u)), [2, 3])


@given(st.lists(st.floats(0, 6.28), min_size=2, max_size=30))
def test_pseudo_angle_orders_directions_like_the_angle(angles):
    angle = np.array(angles)
    pseudo = pseudo_angle(np.cos(angle), np.sin(angle))
    order = np.argsort(angle)
    rise, turn = np.diff(pseudo[order]), np.diff(angle[order])
    # Between half and the full rate, to rounding.
    assert (rise >= 0.5 * turn - 1e-12).all() and (rise <= turn + 1e-12).all()


def test_pseudo_angle_of_the_axes():
    dx, dy = np.array([[1.0, 0], [0, 1], [-1, 0], [0, -1], [0, 0]]).T
    np.testing.assert_array_equal(pseudo_angle(dx, dy), [0, 1, 2, 3, 0])


def test_an_arc_is_inscribed_and_ends_exactly():
    center, start, end = np.array([1.0, 2.0]), np.array([0.5, 0.0]), np.array([0.0, -0.5])
    points = arc(center, start, end, 12)
    assert len(points) == 1 + 12
    np.testing.assert_array_equal(points[[0, -1]], [center + start, center + end])
    np.testing.assert_allclose(np.linalg.norm(points - center, axis=1), 0.5)
    chord = np.linalg.norm(np.diff(points, axis=0), axis=1)
    np.testing.assert_allclose(chord, 2 * 0.5 * math.sin(math.pi / 16))


def test_turns_are_counterclockwise():
    east, north = np.array([2.0, 0.0]), np.array([0.0, 3.0])
    turns = turn_between(np.array([east, north, east, east]), np.array([north, east, -north, east]))
    np.testing.assert_allclose(turns, [math.pi / 2, 3 * math.pi / 2, 3 * math.pi / 2, 0])


def test_distances_between():
    found = distances_between(np.array([[0.0, 0], [3, 4]]), np.array([[3.0, 4], [0, 4], [0, 0]]))
    np.testing.assert_array_equal(found, [[5, 4, 0], [0, 3, 5]])
    assert distances_between(np.empty((0, 2)), np.ones((3, 2))).shape == (0, 3)
