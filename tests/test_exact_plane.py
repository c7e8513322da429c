"""The exact oracle of the tests, against values worked out by hand and against the package on ordinary maps."""

import numpy as np
import pytest
import shapely
from exact_plane import ExactPlane

from plr_jax import VisibilityGraph, Workspace

_BOX = ((0, 0), (4, 4))


def _square(x, y, side=1):
    return [(x, y), (x + side, y), (x + side, y + side), (x, y + side)]


@pytest.mark.parametrize(
    ("obstacles", "source", "points", "expected"),
    [
        # Along a wall, around a corner of it, into it, and outside of the bounds.
        (
            [_square(1, 1, 2)],
            (1, 0),
            [(1, 4), (4, 1), (3.5, 4), (2, 2), (4.5, 0), (1, 0)],
            [4, 10**0.5, 5**0.5 + np.hypot(0.5, 3), np.inf, np.inf, 0],
        ),
        # Squares that touch at (2, 2): from side to side around them, from the contact to both sides.
        (
            [_square(1, 1), _square(2, 2)],
            (1.5, 2.5),
            [(2.5, 1.5), (2, 2), (1, 3)],
            [2 + 2 * 0.5**0.5, 0.5**0.5, 0.5**0.5],
        ),
        ([_square(1, 1), _square(2, 2)], (2, 2), [(2, 2), (1, 2), (2, 1), (1.5, 1.5)], [0, 1, 1, np.inf]),
        # Along the upper wall of one and then the lower wall of the other one, which is blocked at the contact.
        ([_square(1, 1), _square(2, 2)], (1, 2), [(3, 2)], [2 + 2**0.5]),
        # Walls that touch the bounds leave two sides; walls that share an edge leave no way between them.
        ([[(2, 0), (3, 2), (2, 4)]], (1, 1), [(3, 1), (2, 3), (2, 4), (4, 4)], [np.inf, 5**0.5, 10**0.5, np.inf]),
        ([_square(0, 1, 2), _square(2, 1, 2)], (1, 0), [(2, 1), (3, 1), (1, 4)], [2**0.5, 5**0.5, np.inf]),
        # Walls that cross are solid together.
        ([[(1, 0), (2, 0), (2, 3), (1, 3)], [(0, 1), (3, 1), (3, 2), (0, 2)]], (0, 0), [(0, 4)], [np.inf]),
        # The hole of an obstacle, which touches its outline: no way out there.
        ([shapely.Polygon(_square(1, 1, 2), [[(1, 1), (2, 1.5), (1.5, 2)]])], (1.2, 1.2), [(0, 0)], [np.inf]),
        # A crack 2^-40 wide leads through, and a wall as thin does not.
        (
            [[(1, 0), (2, 0), (2, 4), (1, 4)], [(2 + 2**-40, 0), (3, 0), (3, 3), (2 + 2**-40, 3)]],
            (2 + 2**-41, 0),
            [(2.5, 4), (0, 0), (3, 0)],
            [3 + np.hypot(0.5, 1), np.inf, 7],
        ),
        ([[(2, 1), (2 + 2**-40, 1), (2 + 2**-40, 4), (2, 4)]], (1, 3), [(3, 3)], [2 * 5**0.5]),
    ],
)
def test_distances_are_those_worked_out_by_hand(obstacles, source, points, expected):
    plane = ExactPlane(_BOX, obstacles)
    np.testing.assert_allclose(plane.distances(source, points), expected, rtol=1e-11)


def test_sight_grazes_corners_but_passes_no_contact():
    plane = ExactPlane(_BOX, [_square(1, 1), _square(2, 2)])
    assert plane.sees((0, 0), (1, 2))
    assert plane.sees((1, 3), (2, 2))
    assert not plane.sees((1, 3), (3, 1))
    assert not plane.sees((1, 2), (3, 2))
    assert not plane.sees((1.5, 1.5), (1.5, 1.5))
    # On the segment in real numbers, and 2^-60 beside it.
    assert plane.sees((1, 0), (1, 4))
    assert not ExactPlane(_BOX, [[(2, 2), (3, 3 - 2**-50), (3, 2)]]).sees((2, 2), (2.5, 2.5 - 2**-48))


@pytest.mark.parametrize("seed", range(5))
def test_ordinary_maps_are_answered_as_by_the_package(seed):
    rng = np.random.default_rng(seed)
    obstacles = [shapely.MultiPoint(at + rng.random((5, 2))).convex_hull for at in 4 * rng.random((8, 2))]
    workspace = Workspace(((0, 0), (5, 5)), obstacles)
    goal, *x = workspace.sample_free(30, seed)
    expected = ExactPlane(((0, 0), (5, 5)), obstacles).distances(goal, x)
    assert np.isfinite(expected).any()
    np.testing.assert_allclose(VisibilityGraph(workspace, goal)(x), expected, rtol=1e-9)


def test_paths_that_keep_near_a_segment_join_its_ends_and_others_do_not():
    """A segment that cuts off 0.1 of a square's corner; and one between points that a wall parts."""
    plane = ExactPlane(_BOX, [_square(1, 1), [(2, 0), (2.1, 0), (2.1, 4), (2, 4)]])
    assert plane.joins((0.5, 2.3), (1.7, 2.3), 0) and not plane.sees((0.9, 1.4), (1.5, 2.0))
    assert [plane.joins((0.6, 1.4), (1.6, 2.4), radius) for radius in (0.1, 0.15)] == [False, True]
    assert not plane.joins((1.5, 3), (3, 3), 10)
