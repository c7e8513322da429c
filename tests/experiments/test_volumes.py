"""The paths with which experiments measure volumes: shortest where the truth is known."""

import numpy as np
import pytest
from scipy.optimize import minimize

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
