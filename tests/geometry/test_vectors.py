import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from plr_jax.geometry.vectors import arc, distance_to_segment, orientation, pseudo_angle, turn_between


@given(st.integers(0, 100_000))
def test_orientation_signs_equal_those_of_integers(seed):
    """Consecutive vectors of a continued fraction, whose cross product of 1 or -1 is lost in rounding."""
    rng, u, v, pairs = np.random.default_rng(seed), *np.array([[0, 1], [1, 0]], object), []
    while v[0] < 2**41:
        u, v = v, u + int(rng.integers(1, 9)) * v
        pairs += [(u, v), (v, u), (v, v)]
    u, v = np.array(pairs, float).swapaxes(0, 1)
    unit = 2.0 ** rng.integers(-60, 60)
    found = orientation(*(unit * u.T), *(unit * v.T))
    np.testing.assert_array_equal(np.sign(found), [a * d - b * c for (a, b), (c, d) in pairs])


def test_pseudo_angles_of_the_axes():
    dx, dy = np.array([[1.0, 0], [0, 1], [-1, 0], [0, -1], [0, 0]]).T
    np.testing.assert_array_equal(pseudo_angle(dx, dy), [0, 1, 2, 3, 0])


def test_arc_points_lie_on_the_circle():
    center, start, end = np.array([1.0, 2.0]), np.array([0.5, 0.0]), np.array([0.0, -0.5])
    points = arc(center, start, end, 12)
    assert len(points) == 1 + 12
    np.testing.assert_array_equal(points[[0, -1]], [center + start, center + end])
    np.testing.assert_allclose(np.linalg.norm(points - center, axis=1), 0.5)
    chord = np.linalg.norm(np.diff(points, axis=0), axis=1)
    np.testing.assert_allclose(chord, 2 * 0.5 * math.sin(math.pi / 16))
    corners = arc(center, start, end, 12, outside=True)
    assert len(corners) == 2 + 12
    np.testing.assert_array_equal(corners[[0, -1]], points[[0, -1]])
    np.testing.assert_allclose(corners[1:-2] + corners[2:-1], 2 * points[1:-1])  # each tangent touches in its middle
    np.testing.assert_allclose(np.linalg.norm(corners[1:-1] - center, axis=1), 0.5 / math.cos(math.pi / 16))


def test_turns_are_measured_counterclockwise():
    east, north = np.array([2.0, 0.0]), np.array([0.0, 3.0])
    turns = turn_between(np.array([east, north, east, east]), np.array([north, east, -north, east]))
    np.testing.assert_allclose(turns, [math.pi / 2, 3 * math.pi / 2, 3 * math.pi / 2, 0])


def test_distances_from_the_origin_to_segments():
    segments = np.array([[1.0, 3, 2, -6], [0, 2, 2, -2], [3, 4, 1, 1], [-5, 0, 2, 0], [3, 4, 0, 0]])
    np.testing.assert_allclose(distance_to_segment(*segments.T), [6 / math.sqrt(10), math.sqrt(2), 5, 3, 5])
