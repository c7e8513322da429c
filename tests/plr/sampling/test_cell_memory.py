import numpy as np
import pytest
from piece_helpers import WORKSPACES

from plr_jax.geometry.box import Box
from plr_jax.oracles import VisibilityGraph
from plr_jax.plr.cell_memory import CellMemory
from plr_jax.plr.tree import Cells


@pytest.mark.parametrize("kind", WORKSPACES)
@pytest.mark.parametrize("domain", [Box((0, 0), (10, 10)), Box((-3, 1), (7, 13))])
def test_distances_are_the_oracles(kind, domain):
    """In cells that are asked for in any order, several times, along either axis first."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        workspace = kind(rng, squeeze=seed % 2 == 0)
        oracle = VisibilityGraph(workspace, workspace.sample_free(1, seed)[0])
        memory, cells = CellMemory(oracle, domain), Cells.root(2)
        memory.sources(cells)
        for _ in range(5):
            u = rng.uniform(-1, 1, (30, 2))
            x = cells.points(u, domain)
            exact = oracle(x.reshape(-1, 2)).reshape(x.shape[:2])
            clear = np.abs(workspace.clearance(x.reshape(-1, 2)).reshape(x.shape[:2])) > 10 * workspace.tolerance
            found = memory.distances(cells, x)
            np.testing.assert_allclose(found[clear], exact[clear], atol=10 * workspace.tolerance)
            assert np.isfinite(exact).any() or len(cells) < 100
            split = rng.permutation(len(cells))[: 1 + len(cells) // 2]
            both = cells[split].split(rng.integers(2, size=len(split)))
            cells = both.append(cells[rng.permutation(len(cells))])[rng.permutation(len(both) + len(cells))]


def test_many_pairs_are_looked_at_in_parts(monkeypatch):
    rng = np.random.default_rng(0)
    workspace = WORKSPACES[0](rng)
    oracle = VisibilityGraph(workspace, workspace.sample_free(1, 0)[0])
    domain, cells = Box((0, 0), (10, 10)), Cells.root(2)
    x = cells.points(rng.uniform(-1, 1, (200, 2)), domain)
    whole = CellMemory(oracle, domain).distances(cells, x)
    monkeypatch.setattr("plr_jax.plr.cell_memory._PAIRS_AT_ONCE", 1)
    np.testing.assert_array_equal(CellMemory(oracle, domain).distances(cells, x), whole)


def test_a_cell_is_found_once_whichever_half_it_is_reached_by(monkeypatch):
    workspace = WORKSPACES[0](np.random.default_rng(1))
    oracle = VisibilityGraph(workspace, workspace.sample_free(1, 0)[0])
    memory = CellMemory(oracle, Box((0, 0), (10, 10)))
    root = Cells.root(2)
    memory.sources(root)
    columns, rows = root.split(np.array([0])), root.split(np.array([1]))
    memory.sources(columns), memory.sources(rows)
    quarters = columns.split(np.array([1, 1]))
    first = memory.sources(quarters)
    again = memory.sources(rows.split(np.array([0, 0]))[[0, 2, 1, 3]])
    np.testing.assert_array_equal(again.pieces, first.pieces)
    np.testing.assert_array_equal(again.source, first.source)
