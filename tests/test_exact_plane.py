"""The exact oracle of the tests, compared with values by hand and with the package on ordinary maps."""

import numpy as np
import pytest
import shapely
from exact_plane import ExactPlane

_BOX = ((0, 0), (4, 4))


def _square(x, y, side=1):
    return [(x, y), (x + side, y), (x + side, y + side), (x, y + side)]


TOUCHING = [_square(1, 1), _square(2, 2)]
GAP = [[(1, 0), (2, 0), (2, 4), (1, 4)], [(2 + 2**-40, 0), (3, 0), (3, 3), (2 + 2**-40, 3)]]


@pytest.mark.parametrize(
    ("obstacles", "source", "points", "expected"),
    [
        # Along a wall, around a corner, in an obstacle and outside of the bounds.
        ([_square(1, 1, 2)], (1, 0), [(1, 4), (4, 1), (2, 2), (4.5, 0), (1, 0)], [4, 10**0.5, np.inf, np.inf, 0]),
        # Squares that touch at (2, 2): from side to side around them, from the contact to both sides.
        (TOUCHING, (1.5, 2.5), [(2.5, 1.5), (2, 2), (1, 3)], [2 + 2 * 0.5**0.5, 0.5**0.5, 0.5**0.5]),
        (TOUCHING, (2, 2), [(2, 2), (1, 2), (2, 1), (1.5, 1.5)], [0, 1, 1, np.inf]),
        # Walls that touch the bounds separate two sides; walls that share an edge leave no way between them.
        ([[(2, 0), (3, 2), (2, 4)]], (1, 1), [(3, 1), (2, 3), (2, 4), (4, 4)], [np.inf, 5**0.5, 10**0.5, np.inf]),
        ([_square(0, 1, 2), _square(2, 1, 2)], (1, 0), [(2, 1), (3, 1), (1, 4)], [2**0.5, 5**0.5, np.inf]),
        # The hole of an obstacle touches its outline, which is no way out.
        ([shapely.Polygon(_square(1, 1, 2), [[(1, 1), (2, 1.5), (1.5, 2)]])], (1.2, 1.2), [(0, 0)], [np.inf]),
        # A gap 2^-40 wide can be passed, and a wall as thin cannot.
        (GAP, (2 + 2**-41, 0), [(2.5, 4), (0, 0), (3, 0)], [3 + np.hypot(0.5, 1), np.inf, 7]),
        ([[(2, 1), (2 + 2**-40, 1), (2 + 2**-40, 4), (2, 4)]], (1, 3), [(3, 3)], [2 * 5**0.5]),
    ],
)
def test_distances_by_hand(obstacles, source, points, expected):
    plane = ExactPlane(_BOX, obstacles)
    np.testing.assert_allclose(plane.distances(source, points), expected, rtol=1e-11)


def test_visibility_touches_corners_but_passes_no_contact():
    plane = ExactPlane(_BOX, TOUCHING)
    assert plane.sees((0, 0), (1, 2))
    assert plane.sees((1, 3), (2, 2))
    assert not any(plane.sees(*ends) for ends in (((1, 3), (3, 1)), ((1, 2), (3, 2)), ((1.5, 1.5), (1.5, 1.5))))
    # On the segment in real numbers, and 2^-60 beside it.
    assert plane.sees((1, 0), (1, 4))
    assert not ExactPlane(_BOX, [[(2, 2), (3, 3 - 2**-50), (3, 2)]]).sees((2, 2), (2.5, 2.5 - 2**-48))


def test_joins_finds_paths_near_a_segment():
    """One segment cuts off a corner of a square by 0.1; a wall separates the ends of the other segment."""
    plane = ExactPlane(_BOX, [_square(1, 1), [(2, 0), (2.1, 0), (2.1, 4), (2, 4)]])
    assert plane.joins((0.5, 2.3), (1.7, 2.3), 0) and not plane.sees((0.9, 1.4), (1.5, 2.0))
    assert [plane.joins((0.6, 1.4), (1.6, 2.4), radius) for radius in (0.1, 0.15)] == [False, True]
    assert not plane.joins((1.5, 3), (3, 3), 10)
