"""Answers do not depend on the sizes of batches that limit memory."""

import numpy as np
import pytest
from oracle_helpers import GAP, free_points, roadmap
from piece_helpers import general_workspace

from plr_jax import VisibilityGraph, scenes
from plr_jax.geometry.corners import CornerVisibility
from plr_jax.geometry.graph import first_visible_in_parts

MAZE = scenes.maze().workspace
X, Y = MAZE.sample_free(200, 1), MAZE.sample_free(200, 2)
LENGTHS = np.random.default_rng(0).permutation(np.arange(350.0)).reshape(50, 7)


def ways():
    return first_visible_in_parts(lambda rows: LENGTHS[rows].copy(), 50, 7, lambda p, w: LENGTHS[p, w] % 3 == 0, 2)


def corner_table():
    table = CornerVisibility.of(general_workspace(np.random.default_rng(3))).table
    return np.concatenate([table.key, table.edge, table.first])


def inflated_clearance():
    return general_workspace(np.random.default_rng(0)).inflate(0.3).clearance(X * 10)


@pytest.mark.parametrize(
    ("limit", "size", "ask"),
    [
        ("geometry.graph._CHUNK", 21, ways),
        ("geometry.visibility._VIEWS", 1, corner_table),
        ("geometry.boundary._COLLARS", 3, inflated_clearance),
        ("geometry.boundary._REGIONS", 2, inflated_clearance),
        ("oracles._pair_distances._CANDIDATES", 40, lambda: VisibilityGraph(MAZE, X[0]).between(X, Y)),
        ("oracles._pair_distances._WAYS", 40, lambda: VisibilityGraph(MAZE, X[0]).between(X, Y)),
        ("oracles._pair_distances._DISTANCES", 40, lambda: VisibilityGraph(MAZE, X[0]).between(X, Y)),
        ("oracles._roadmap._BATCH", 64, lambda: roadmap(GAP, num_samples=100)(free_points(GAP, 100))),
        ("oracles._roadmap._BATCH", 64, lambda: roadmap(GAP, is_visible=None, resolution=0.05)(free_points(GAP, 50))),
    ],
)
def test_answers_do_not_depend_on_batch_sizes(monkeypatch, limit, size, ask):
    whole = ask()
    monkeypatch.setattr(f"plr_jax.{limit}", size)
    np.testing.assert_allclose(ask(), whole, rtol=0, atol=1e-9)
