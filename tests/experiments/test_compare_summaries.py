"""Rivals of a file of all pairs, each at its smallest, and what they are made of by hand."""

import numpy as np
import pytest

from experiments import compare_summaries
from experiments.baselines._brute_distance import MAZE, BruteDistance
from experiments.summaries import _given, _node_tables
from experiments.summaries._given import Given
from plr_jax import VisibilityGraph, Workspace, scenes

pytestmark = pytest.mark.full

SQUARE = Workspace(((0, 0), (1, 1)))


def given(workspace, max_bytes, goals=20):
    oracle = VisibilityGraph(workspace, workspace.sample_free(1, 0)[0])
    return Given(oracle, max_bytes, _given.draw_pairs(oracle, goals, 50, 1), 0, True)


def test_the_polygon_is_exact():
    problem = scenes.maze()
    brute, x = BruteDistance(MAZE, goal := problem.goals[0]), problem.workspace.sample_free(1_000, 3)
    y = np.tile(goal, (len(x), 1))
    ((_, summary),) = compare_summaries.polygon(given(problem.workspace, 1_024))
    assert summary.num_bytes == 4 * 28
    np.testing.assert_allclose(summary(x, y), brute(x), rtol=0, atol=1e-6)
    np.testing.assert_allclose(summary(y, x), brute(x), rtol=0, atol=1e-6)


def test_grids_interpolate_between_free_nodes():
    grid = _node_tables.grid_of(SQUARE, 20)
    table = np.stack([grid.free @ [1.0, 2.0], np.full(len(grid.free), 3.0)], axis=1)[grid.nearest]
    for x in np.random.default_rng(0).random((50, 2)):
        np.testing.assert_allclose(grid.read(table, x), [x @ [1.0, 2.0], 3.0], atol=1e-5)
    walled = Workspace(((0, 0), (1, 1)), [[(0.4, 0.0), (0.6, 0.0), (0.6, 0.9), (0.4, 0.9)]])
    grid = _node_tables.grid_of(walled, 81)  # 9 by 9
    assert grid.shape == (9, 9) and len(grid.free) == 81 - 8  # x = 0.5, below y = 0.9
    assert walled.is_free(grid.free).all()
    inside = np.ravel_multi_index((4, 0), (9, 9))
    assert np.abs(grid.free[grid.nearest[inside]] - [0.5, 0.0]).max() == 0.125
    assert grid.table_bytes(2, 12) == 16 + 11 + 2 * (8 + -(-73 * 12 // 8))
    finest = _node_tables.finest_grid(SQUARE, lambda grid: grid.table_bytes(1, 8), 1_000)
    assert 800 < finest.table_bytes(1, 8) <= 1_000
