import numpy as np
import pytest

from plr_jax import Box, Dubins, Euclidean, ReedsShepp
from plr_jax._types import Symmetry
from plr_jax.plr.folding.choice import folding_of

WINDOW = Box((-2, -2, -np.pi), (2, 2, np.pi), periodic=(False, False, True))


class Stated:
    """A distance function that states what it is given."""

    def __init__(self, *symmetries):
        self.symmetries = symmetries

    def __call__(self, x):
        return np.zeros(len(x))


def test_of_a_car_that_reverses_a_quarter_of_a_window_about_the_goal_is_left():
    folding = folding_of(ReedsShepp((0, 0, 0), 1), WINDOW)
    assert folding.box == Box((0, 0, -np.pi), (2, 2, np.pi), periodic=(False, False, True))
    assert folding.radial == (True, True, False)
    x = np.array([[-1, 1, 0.5], [1, -1, 0.5], [-1, -1, 0.5]])
    np.testing.assert_array_equal(folding(x), [[1, 1, -0.5], [1, 1, -0.5], [1, 1, 0.5]])


def test_of_a_car_that_does_not_reverse_a_half_is_left():
    folding = folding_of(Dubins((0, 0, 0), 1), WINDOW)
    assert folding.box == Box((-2, 0, -np.pi), (2, 2, np.pi), periodic=(False, False, True))
    x = np.array([[-1, -1, 0.5], [1, 1, 0.5]])
    np.testing.assert_array_equal(folding(x), [[-1, 1, -0.5], [1, 1, 0.5]])


def test_a_window_that_is_not_about_the_goal_folds_onto_its_larger_parts():
    folding = folding_of(Euclidean((1, 5)), Box((0, 0), (4, 4)))
    assert folding.mirrors == ((True, False),) and folding.box == Box((0, -5), (3, -1))


@pytest.mark.parametrize("goal", [(9, 9), (0, 0), (4, 2)])
def test_a_window_that_no_mirror_cuts_is_not_folded_along_it(goal):
    folding = folding_of(Euclidean(goal), Box((0, 0), (4, 4)))
    assert (None if folding is None else folding.mirrors) == (((False, True),) if goal == (4, 2) else None)


def test_a_goal_s_heading_turns_the_box():
    folding = folding_of(ReedsShepp((0, 0, np.pi / 4), 1), WINDOW)
    assert folding.is_turned
    np.testing.assert_allclose(folding.box.hi[:2], np.sqrt(8))
    ahead, behind, aside = folding(np.array([[1, 1, 1.0], [-1, -1, 1.0], [-1, 1, 1.0]]))
    np.testing.assert_allclose(np.sort(ahead[:2]), (0, np.sqrt(2)), atol=1e-15)
    np.testing.assert_allclose(np.sort(aside[:2]), (0, np.sqrt(2)), atol=1e-15)
    np.testing.assert_allclose(behind[:2], ahead[:2], atol=1e-15)
    np.testing.assert_allclose(np.abs([ahead[2], behind[2], aside[2]]), 1 - np.pi / 4)


def test_a_turned_box_that_is_not_smaller_is_not_used():
    folding = folding_of(Dubins((0, 0, np.pi / 4), 1), WINDOW)
    assert folding.mirrors == () and any(folding.radial)


def test_what_is_no_reflection_or_reverses_angles_alone_is_left_out():
    turn = Symmetry(np.array([[0.0, -1.0], [1.0, 0.0]]), np.zeros(2))
    assert folding_of(Stated(turn), Box((-1, -1), (1, 1))) is None
    around = Symmetry(np.diag([1.0, -1.0]), np.zeros(2))
    assert folding_of(Stated(around), Box((-1, -1), (1, 1), periodic=(False, True))) is None
    assert folding_of(lambda x: x[:, 0], Box((-1, -1), (1, 1))) is None


def test_of_reflections_that_do_not_commute_the_first_is_used():
    along = Symmetry(np.diag([1.0, -1.0]), np.zeros(2))
    slanted = Symmetry(np.array([[0.6, 0.8], [0.8, -0.6]]), np.zeros(2))
    assert folding_of(Stated(along, slanted), Box((-1, -1), (1, 1))).mirrors == ((False, True),)


def test_mirrors_share_no_pivot():
    """Of the reflections in a point and in a plane that holds it the pivots are two axes."""
    point, plane = (Symmetry(np.diag(signs), np.zeros(3)) for signs in ((-1.0, -1.0, -1.0), (-1.0, 1.0, 1.0)))
    folding = folding_of(Stated(point, plane), Box((-1, -1, -1), (1, 1, 1)))
    assert folding.box == Box((0, 0, -1), (1, 1, 1))
