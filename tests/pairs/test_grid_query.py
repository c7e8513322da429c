import numpy as np
import pytest

from plr_jax import GridGraph, construct_grid_pairs
from plr_jax._arrays import runs
from plr_jax.pairs.grid_corners import MOST_BYTES
from plr_jax.pairs.grid_query import BLOCK, tables_of
from plr_jax.pairs.grid_corners import taut_corners


@pytest.mark.parametrize("connectivity", [4, 8])
def test_blocks_of_a_cell_hold_its_corners(connectivity):
    free = np.random.default_rng(0).random((20, 30)) > 0.2
    tables = tables_of(free, connectivity)
    first, corners = taut_corners(free, connectivity, MOST_BYTES)
    begin = np.asarray(tables.group_block)[np.arange(free.size + 1) // 16] + np.asarray(tables.cell_block)
    cell, place = runs(np.diff(first))
    blocks = np.asarray(tables.blocks)
    np.testing.assert_array_equal(blocks[begin[cell] + place // BLOCK, place % BLOCK], corners)
    assert begin[-1] == len(blocks) < len(corners)


@pytest.mark.parametrize("connectivity", [4, 8])
def test_cells_with_more_corners_than_a_word_has_bits(connectivity):
    size = 300
    row, column = np.indices((size, size))
    free = np.ones((size, size), bool)
    free[(row + column == size) & (row % 2 == 0) & (column > 3)] = False  # with gaps, in a line
    graph = GridGraph(free, connectivity=connectivity)
    cells = np.argwhere(free)[:, ::-1].astype(float)
    rng = np.random.default_rng(0)
    x, y = (
        np.repeat(cells[rng.integers(len(cells), size=30)], 500, axis=0),
        cells[rng.integers(len(cells), size=15_000)],
    )
    assert np.diff(taut_corners(free, connectivity, MOST_BYTES)[0]).max() > 32 * BLOCK
    np.testing.assert_allclose(construct_grid_pairs(graph)(x, y), graph.between(x, y), rtol=1e-6)
