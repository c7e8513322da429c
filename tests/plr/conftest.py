"""Fixtures of tests of PLRs: leaf models and PLRs of the walled square, each built once."""

from functools import cache

import numpy as np
import pytest
from plr_helpers import LINEAR, UNIT, points, walled

from plr_jax import VisibilityGraph, construct, scenes


@pytest.fixture(scope="session", params=LINEAR)
def leaf(request):
    """The name of a leaf model."""
    return request.param


@cache
def walled_plr(leaf):
    return construct(walled, UNIT, leaf=leaf, max_leaves=100)


@pytest.fixture
def plr(leaf):
    """A PLR of the walled square."""
    return walled_plr(leaf)


@pytest.fixture(scope="session")
def maze():
    """The oracle of a maze."""
    problem = scenes.maze()
    return VisibilityGraph(problem.workspace, problem.goals[0])


@pytest.fixture(scope="session")
def x():
    """Points of the unit square."""
    return points(1000, 0).astype(np.float32)


@pytest.fixture(scope="session")
def samples():
    """Points of the walled square whose distance is finite, and their distances."""
    x = points(20_000, 1)
    distance = walled(x)
    free = np.isfinite(distance)
    return x[free], distance[free]
