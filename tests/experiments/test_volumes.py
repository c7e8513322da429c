"""The paths with which experiments measure volumes: shortest where the truth is known."""

import numpy as np
import pytest
from scipy.optimize import minimize

from experiments import _made_volumes as made
from experiments._taut_paths import taut_paths
from plr_jax import VoxelGraph, VoxelSpace

pytestmark = pytest.mark.full

GOAL = np.array([3.3, 16.2, 17.1])
WINDOW = ((5, 7), (6, 9))  # along y and z, in a wall from x = 10 on


def through_window(x, thickness):
    """The least length from a point over two in the faces of the window: a convex function of these."""

    def length(at):
        bends = np.array([[10 + thickness, *at[2:]], [10, *at[:2]]])
        return np.linalg.norm(np.diff([x, *bends, GOAL], axis=0), axis=1).sum()

    middle = np.tile(np.mean(WINDOW, axis=1), 2)
    return minimize(length, middle, method="SLSQP", bounds=WINDOW * 2, options={"ftol": 1e-13}).fun


@pytest.mark.parametrize("thickness", [1, 4])
def test_taut_paths_through_a_window_are_shortest(thickness):
    free = np.ones((20, 20, 20), bool)
    free[10 : 10 + thickness] = False
    free[10 : 10 + thickness, slice(*WINDOW[0]), slice(*WINDOW[1])] = True
    space, graph = VoxelSpace(free), VoxelGraph(free, GOAL)
    x = np.random.default_rng(0).uniform((10 + thickness, 0, 0), 20, (100, 3))
    paths = taut_paths(space, graph, x)
    truth = np.array([through_window(each, thickness) for each in x])
    assert (paths.lengths >= (1 - 1e-6) * truth).all()
    assert (paths.lengths / truth).max() < 1.001 and (paths.lengths / truth).mean() < 1 + 1e-5
    assert graph(x).mean() > 1.05 * truth.mean()


def test_taut_paths_are_free_and_reach_the_goal():
    free = made.boxes(np.random.default_rng(1), (24, 20, 16), 12, 3, 9)
    goal = made.first_free(free) + 0.5
    space, graph = VoxelSpace(free), VoxelGraph(free, goal)
    centers = np.argwhere(np.isfinite(graph(np.argwhere(np.ones_like(free)) + 0.5)).reshape(free.shape)) + 0.5
    x = np.random.default_rng(0).choice(centers, 60)
    paths = taut_paths(space, graph, x)
    assert np.array_equal(paths.points[paths.position == 0], x)
    same = paths.path[1:] == paths.path[:-1]
    assert space.are_free(paths.points[:-1][same], paths.points[1:][same]).all()
    assert np.array_equal(paths.points[np.append(~same, True)], np.tile(goal, (len(x), 1)))
    legs = np.where(same, np.linalg.norm(np.diff(paths.points, axis=0), axis=1), 0.0)
    assert np.allclose(np.bincount(paths.path[:-1], legs, len(x)), paths.lengths)
    assert (paths.lengths <= graph(x) + 1e-9).all()
    assert (paths.lengths >= np.linalg.norm(x - goal, axis=1) - 1e-9).all()
