"""Queries of grids: cells that see each other, blocks of corners, and windows around agents."""

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from grid_helpers import legal, mosaic, pairs_of_tiles

from plr_jax import GridGraph, construct_grid_pairs
from plr_jax.pairs.grid_corners import taut_corners
from plr_jax.pairs.grid_query import BLOCK, sees, sight_of


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
def test_cells_see_each_other_if_every_open_path_is_legal(connectivity):
    free = mosaic(connectivity, 3, 4)
    p, q = (points[:, ::-1].astype(int) for points in pairs_of_tiles(3, 4))
    found = np.asarray(sees(sight_of(free, connectivity), jnp.asarray(p), jnp.asarray(q)))
    assert 0.1 < found.mean() < 0.9
    for start, end, seen in zip(map(tuple, p.tolist()), map(tuple, q.tolist()), found, strict=True):
        steps = [step for path in all_open_paths(start, end, connectivity) for step in pairwise(path)]
        legal_steps = [legal(free, a[0], a[1], b[0] - a[0], b[1] - a[1], connectivity) for a, b in steps]
        assert seen == (free[start] and all(legal_steps))


@pytest.mark.full
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
    assert np.diff(taut_corners(free, connectivity)[0]).max() > 32 * BLOCK
    np.testing.assert_allclose(construct_grid_pairs(graph)(x, y), graph.between(x, y), rtol=1e-6)


FREE = mosaic(5, 2, 10)


def asked_cell_by_cell(graph, goals, positions, radius):
    """The windows by a search from each goal, cut at whole steps."""
    offsets = np.argwhere(np.ones((2 * radius + 1, 2 * radius + 1)))[:, ::-1] - radius
    windows = np.floor(positions)[:, None] + offsets
    lengths = graph.between(windows.reshape(-1, 2), np.repeat(goals, len(offsets), axis=0))
    whole = np.where(np.isfinite(lengths), lengths + 1e-9, -1).astype(int)
    return whole.reshape(len(goals), 2 * radius + 1, 2 * radius + 1)


@pytest.mark.parametrize("connectivity", [4, 8])
@pytest.mark.parametrize("radius", [1, *(pytest.param(radius, marks=pytest.mark.full) for radius in (0, 4))])
def test_windows_are_what_searches_find(connectivity, radius):
    graph = GridGraph(FREE, connectivity=connectivity)
    pairs, rng = construct_grid_pairs(graph), np.random.default_rng(radius)
    goals, positions = rng.uniform(-1, len(FREE) + 1, (2, 300, 2))
    positions[:100] = goals[:100] + rng.uniform(-3, 3, (100, 2))  # goals in sight, or in the window
    inside = ((positions >= 0) & (positions < len(FREE))).all(axis=1)
    found = np.asarray(pairs.window(goals, positions, radius))
    assert found.dtype == np.int32 and (found[~inside] == -1).all() and (found[inside] >= 0).any()
    np.testing.assert_array_equal(found[inside], asked_cell_by_cell(graph, goals, positions, radius)[inside])
    again = jax.jit(lambda pairs, x, y: pairs.window(x, y, radius))(pairs, goals, positions)
    np.testing.assert_array_equal(again, found)


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([[0, 0]], [[0, 0]], -1), "radius must be an integer >= 0"),
        (([[0, 0]], [0, 0], 1), r"must be points \(x, y\), \(n, 2\) both"),
        (([[0, 0]], [[0, 0], [1, 1]], 1), r"got \(1, 2\) and \(2, 2\)"),
        (([[0, 0, 0]], [[0, 0, 0]], 1), r"goals must have shape"),
    ],
)
def test_bad_input_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        construct_grid_pairs(GridGraph(FREE)).window(*arguments)
