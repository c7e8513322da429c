"""Queries of grids: cells that see each other, and blocks of corners."""

from itertools import pairwise

import numpy as np
import pytest
from grid_helpers import legal, mosaic, pairs_of_tiles

from plr_jax import GridGraph, construct_grid_pairs
from plr_jax.pairs.grid_corners import taut_corners
from plr_jax.pairs.grid_query import BLOCK, sees, tables_of


def all_open_paths(p, q, connectivity):
    """Every path of the length that it would have without obstacles, as lists of cells."""
    way = np.subtract(q, p)
    down, right = np.sign(way)
    diagonal = min(abs(way)) if connectivity == 8 else 0
    steps = {(down, right): diagonal, (down, 0): abs(way[0]) - diagonal, (0, right): abs(way[1]) - diagonal}

    def paths(cell, left):
        if not any(left.values()):
            yield [cell]
        for step, count in left.items():
            if count:
                rest = paths((cell[0] + step[0], cell[1] + step[1]), {**left, step: count - 1})
                yield from ([cell, *path] for path in rest)

    return paths(p, steps)


@pytest.mark.parametrize("connectivity", [4, 8])
def test_cells_see_each_other_if_all_open_paths_are_legal(connectivity):
    free = mosaic(connectivity, 3, 4)
    p, q = (points[:, ::-1].astype(int) for points in pairs_of_tiles(3, 4))
    found = sees(tables_of(free, connectivity), p, q)
    assert 0.1 < found.mean() < 0.9
    for start, end, seen in zip(map(tuple, p.tolist()), map(tuple, q.tolist()), found, strict=True):
        steps = [step for path in all_open_paths(start, end, connectivity) for step in pairwise(path)]
        legal_steps = [legal(free, a[0], a[1], b[0] - a[0], b[1] - a[1], connectivity) for a, b in steps]
        assert seen == (free[start] and all(legal_steps))


@pytest.mark.full
@pytest.mark.parametrize("connectivity", [4, 8])
def test_cells_with_more_corners_than_bits_of_a_word(connectivity):
    size = 270
    row, column = np.indices((size, size))
    free = np.ones((size, size), bool)
    free[(row + column == size) & (row % 2 == 0) & (column > 3)] = False  # with gaps, in a line
    graph = GridGraph(free, connectivity=connectivity)
    cells = np.argwhere(free)[:, ::-1].astype(float)
    rng = np.random.default_rng(0)
    x = np.repeat(cells[rng.integers(len(cells), size=30)], 200, axis=0)
    y = cells[rng.integers(len(cells), size=6_000)]
    assert np.diff(taut_corners(free, connectivity)[0]).max() > 32 * BLOCK
    np.testing.assert_allclose(construct_grid_pairs(graph)(x, y), graph.between(x, y), rtol=1e-6)
