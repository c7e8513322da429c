"""Steps between cells of traced grids, compared with a textbook implementation of Dijkstra's algorithm."""

import numpy as np
import pytest
from grid_helpers import dijkstra
from traced_helpers import LEVELS, all_levels, answers

from plr_jax import grid_distance


def around(free, point):
    """Return the free cells that hold a point, on their sides too."""
    cells = np.argwhere(free)
    return [tuple(cell) for cell in cells[(np.abs(cells[:, ::-1] + 0.5 - point) <= 0.5).all(axis=1)].tolist()]


@pytest.mark.parametrize("moves, tolerance", [(8, 1e-6), pytest.param(4, 0, marks=pytest.mark.full)])
def test_distances_equal_dijkstra_from_all_cells_that_hold_the_goal(moves, tolerance):
    _, cells, distances, _ = answers(moves)
    for level, (free, goal, x) in enumerate(zip(*(each[:LEVELS] for each in all_levels()), strict=True)):
        truth = np.min([dijkstra(free, cell, moves) for cell in around(free, goal)], axis=0)
        np.testing.assert_allclose(cells[level], truth, rtol=tolerance)
        expected = [min((truth[cell] for cell in around(free, point)), default=np.inf) for point in x]
        np.testing.assert_allclose(distances[level], [expected] * 3, rtol=tolerance)


@pytest.mark.parametrize("moves", [8, pytest.param(4, marks=pytest.mark.full)])
def test_rows_of_several_words_equal_dijkstra(moves):
    free = np.random.default_rng(3).random((9, 70)) > 0.25
    free[4, 30:34] = True
    cells = grid_distance(free, [33.5, 4.5], moves=moves).cells
    np.testing.assert_allclose(cells, dijkstra(free, (4, 33), moves), rtol=1e-7)


def test_a_corridor_takes_more_steps_than_a_byte_counts():
    free = np.zeros((41, 41), bool)
    free[::2] = True
    free[1::4, -1] = free[3::4, 0] = True
    np.testing.assert_array_equal(grid_distance(free, [0.5, 0.5], moves=4).cells, dijkstra(free, (0, 0), 4))
