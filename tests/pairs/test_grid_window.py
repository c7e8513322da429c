"""Windows of distances around agents on a grid, compared with searches from each goal."""

import jax
import numpy as np
import pytest
from grid_helpers import mosaic

from plr_jax import GridGraph, construct_grid_pairs

FREE = mosaic(5, 2, 10)


def asked_cell_by_cell(graph, goals, positions, radius):
    """Return the windows, by a search from each goal, cut at whole steps."""
    offsets = np.argwhere(np.ones((2 * radius + 1, 2 * radius + 1)))[:, ::-1] - radius
    windows = np.floor(positions)[:, None] + offsets
    lengths = graph.between(windows.reshape(-1, 2), np.repeat(goals, len(offsets), axis=0))
    whole = np.where(np.isfinite(lengths), lengths + 1e-9, -1).astype(int)
    return whole.reshape(len(goals), 2 * radius + 1, 2 * radius + 1)


@pytest.mark.parametrize(
    ("connectivity", "radius"), [(8, 1), *(pytest.param(*each, marks=pytest.mark.full) for each in ((4, 1), (8, 4)))]
)
def test_windows_equal_searches_from_each_goal(connectivity, radius):
    graph = GridGraph(FREE, connectivity=connectivity)
    pairs, rng = construct_grid_pairs(graph), np.random.default_rng(radius)
    goals, positions = rng.uniform(-1, len(FREE) + 1, (2, 300, 2))
    positions[:100] = goals[:100] + rng.uniform(-3, 3, (100, 2))  # goals in sight, or in the window
    inside = ((positions >= 0) & (positions < len(FREE))).all(axis=1)
    found = np.asarray(pairs.window(goals, positions, radius))
    assert found.dtype == np.int32 and (found[~inside] == -1).all() and (found[inside] >= 0).any()
    np.testing.assert_array_equal(found[inside], asked_cell_by_cell(graph, goals, positions, radius)[inside])


def test_windows_are_traced_and_may_be_of_no_agent():
    pairs, none = construct_grid_pairs(GridGraph(FREE)), np.zeros((0, 2))
    traced = jax.eval_shape(lambda pairs, x: pairs.window(x, x, 0), pairs, np.zeros((7, 2)))
    assert traced.shape == (7, 1, 1) and traced.dtype == np.int32
    assert pairs.window(none, none, 2).shape == (0, 5, 5)


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
def test_wrong_arguments_raise(arguments, message):
    with pytest.raises(ValueError, match=message):
        construct_grid_pairs(GridGraph(FREE)).window(*arguments)
