import math
import warnings

import numpy as np
import pytest

from plr_jax import VisibilityGraph, Workspace, scenes

WALL = Workspace(((0, 0), (10, 10)), [np.array([(4, 0), (6, 0), (6, 8), (4, 8)], dtype=float)])
DIAGONAL = math.sqrt(0.5)


def test_by_hand():
    oracle = VisibilityGraph(WALL, (8, 6))
    x = np.array([[8.0, 1.0], [9, 5], [2, 6], [4, 3], [4, 8], [5, 8], [6, 8], [8, 6], [5, 4], [-1, 4], [np.nan, 1]])
    expected = [
        (0, 1),
        (-DIAGONAL, DIAGONAL),
        (DIAGONAL, DIAGONAL),
        (0, 1),
        (1, 0),
        (1, 0),
        (DIAGONAL, -DIAGONAL),
        (0, 0),
        *[(np.nan, np.nan)] * 3,
    ]
    np.testing.assert_allclose(oracle.directions(x), expected, atol=1e-12)


@pytest.mark.parametrize("goal", [(4, 8), (6, 8)])
def test_goals_on_corners(goal):
    directions = VisibilityGraph(WALL, goal).directions(np.array([[4.0, 8.0], [6, 8]]))
    expected = [(0, 0), (-1, 0)] if goal == (4, 8) else [(1, 0), (0, 0)]
    np.testing.assert_array_equal(directions, expected)


def test_as_the_shortest_path_and_the_gradient_have_it():
    problem = scenes.thin_maze()
    oracle = VisibilityGraph(problem.workspace, problem.goals[0])
    x = problem.workspace.sample_free(200, 0)
    directions = oracle.directions(x)
    for point, direction in zip(x, directions, strict=True):
        path = oracle.shortest_path(point)
        np.testing.assert_allclose(direction, (path[1] - point) / np.linalg.norm(path[1] - point), atol=1e-9)
    step = 1e-6
    inner = problem.workspace.is_visible(x, x + step * directions)
    np.testing.assert_allclose((oracle(x) - oracle(x + step * directions))[inner] / step, 1, atol=1e-6)
    assert inner.mean() > 0.9


def test_infinitely_far_there_is_no_direction():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.isnan(VisibilityGraph(WALL, (8, 6)).directions([[np.inf, 0], [0, -np.inf], [1e308, 1]])).all()


def test_other_shapes_are_refused():
    with pytest.raises(ValueError, match=r"x must have shape \(n, 2\)"):
        VisibilityGraph(WALL, (8, 6)).directions(np.zeros(2))
