"""Distances between pairs of points, compared with oracles of each goal and with exact arithmetic."""

import math
import pickle

import numpy as np
import pytest
from oracle_helpers import WALL
from piece_helpers import SEEDS, box, hard_points, random_workspace

from plr_jax import VisibilityGraph, Workspace, scenes

MAZE = scenes.maze().workspace


def test_distances_of_pairs_around_a_wall():
    oracle = VisibilityGraph(WALL, (8, 4))
    x = np.array([[2.0, 4], [2, 4], [4, 8], [6, 4], [1, 1], [5, 4], [2, 4], [-1, 4], [np.nan, 1], [6, 8]])
    y = np.array([[8.0, 4], [1, 1], [6, 8], [4, 4], [1, 1], [8, 4], [5, 4], [8, 4], [1, 1], [6, 2]])
    expected = [2 * math.hypot(2, 4) + 2, math.hypot(1, 3), 2, 10, 0, *[math.inf] * 4, 6]
    np.testing.assert_allclose(oracle.between(x, y), expected, atol=1e-12)
    assert oracle.between(x, y).dtype == np.float64 and oracle.between(x[:0], y[:0]).shape == (0,)


@pytest.mark.parametrize("seed", SEEDS)
def test_pair_distances_equal_oracles_of_each_goal(seed):
    """Points are on walls, at corners, outside, or not finite; batches and single pairs agree to the bit."""
    workspace, rng = random_workspace(seed), np.random.default_rng(seed)
    x = np.concatenate([hard_points(workspace, seed), rng.uniform(-1, 11, (10, 2))])
    oracle, x = VisibilityGraph(workspace, workspace.sample_free(1, seed)[0]), rng.permutation(x)[:30]
    y, distance = x[::-1], oracle.between(x, x[::-1])
    for i in np.flatnonzero(workspace.is_free(y))[:3]:
        assert oracle.with_goal(y[i])(x[i : i + 1])[0] == pytest.approx(distance[i], rel=0, abs=1e-7)
    singly = [oracle.between(a[None], b[None])[0] for a, b in zip(x, y, strict=True)]
    np.testing.assert_array_equal(distance, singly)
    np.testing.assert_array_equal(distance, oracle.between(y, x))
    np.testing.assert_array_equal(oracle.between(x, x), np.where(workspace.is_free(x), 0, np.inf))
    assert np.isinf(oracle.between([[np.nan, 1], x[0]], [x[0], [1, np.inf]])).all()


def test_derived_tables_are_shared_and_not_pickled():
    oracle, x = VisibilityGraph(MAZE, (0.06, 0.07)), MAZE.sample_free(100, 3)
    y = np.tile(oracle.goal, (100, 1))
    np.testing.assert_allclose(oracle.between(x, y), oracle(x), atol=1e-12)
    assert oracle.with_goal(x[1])._pairs is oracle._pairs
    again = pickle.loads(pickle.dumps(oracle))
    parts = [(o, o._pairs, o.workspace.triangulation, o.workspace.boundary) for o in (again, oracle)]
    assert all(vars(found).keys() < vars(expected).keys() for found, expected in zip(*parts, strict=True))
    answers = [(o(x), o.directions(x), o.between(x, y), o.sources.points) for o in (again, oracle)]
    np.testing.assert_equal(*answers)


def test_pairs_in_separate_rooms_are_unreachable():
    oracle = VisibilityGraph(Workspace.from_polygons([{"outer": box(i, 0, i + 1, 1)} for i in (0, 2)]), (0.5, 0.5))
    np.testing.assert_allclose(oracle.between([(0.2, 0.5), (0.2, 0.5)], [(2.5, 0.5), (0.8, 0.5)]), [np.inf, 0.6])
