import jax
import numpy as np
import pytest
from grid_helpers import dijkstra, drawn
from traced_helpers import random_levels

from plr_jax import grid_distance

FREE, _ = random_levels(1)
CELLS = np.stack([np.argwhere(free)[0] for free in FREE])
TRUTH = {
    moves: np.stack([dijkstra(f, tuple(c), moves) for f, c in zip(FREE, CELLS, strict=True)]) for moves in (4, 8)
}


@pytest.mark.parametrize("moves, tolerance", [(4, 0), (8, 1e-7)])
def test_cells_are_as_far_as_dijkstra_says(moves, tolerance):
    goals = CELLS[:, ::-1] + 0.5
    cells = jax.jit(jax.vmap(lambda free, goal: grid_distance(free, goal, moves=moves).cells))(FREE, goals)
    np.testing.assert_allclose(cells, TRUTH[moves], rtol=tolerance)


@pytest.mark.parametrize("moves", [4, 8])
def test_all_pairs_are_those_to_each_goal(moves):
    h, w = shape = FREE.shape[1:]
    cells = np.indices(shape).reshape(2, -1).T[:, ::-1] + 0.5
    ours = jax.jit(lambda free: grid_distance(free, None, moves=moves)(cells[:, None], cells[None]))(FREE[2])
    goals = [dijkstra(FREE[2], (row, column), moves).ravel() for row, column in np.ndindex(h, w)]
    np.testing.assert_allclose(ours, np.stack(goals), rtol=1e-7)


@pytest.mark.parametrize("moves", [4, 8])
def test_rows_wider_than_a_word(moves):
    free = np.random.default_rng(3).random((9, 70)) > 0.25
    free[4, 30:34] = True
    cells = grid_distance(free, [33.5, 4.5], moves=moves).cells
    np.testing.assert_allclose(cells, dijkstra(free, (4, 33), moves), rtol=1e-7)


def test_a_long_corridor_takes_more_steps_than_a_byte_counts():
    free = np.zeros((41, 41), bool)
    free[::2] = True
    free[1::4, -1] = free[3::4, 0] = True
    np.testing.assert_array_equal(grid_distance(free, [0.5, 0.5], moves=4).cells, dijkstra(free, (0, 0), 4))


def test_points_on_sides_are_in_the_cells_beside_them():
    free = drawn("..#", "#..")
    steps, pairs = grid_distance(free, [0.5, 0.5], moves=4), grid_distance(free, None, moves=4)
    x = np.array([[0.9, 0.1], [1.0, 0.5], [1.5, 1.0], [2.0, 0.5], [2.5, 1.0], [3.0, 2.0], [0.0, 1.0], [2.5, 0.5]])
    expected = [0, 0, 1, 1, 3, 3, 0, np.inf]
    np.testing.assert_array_equal(steps(x), expected)
    np.testing.assert_array_equal(pairs(x, [0.5, 0.5]), expected)
    np.testing.assert_array_equal(pairs([0.5, 0.5], x), expected)


@pytest.mark.parametrize("moves", [4, 8])
def test_corners_are_in_all_free_cells_around_them(moves):
    """Goals and points at all corners, against Dijkstra's algorithm from each free cell at the goal's corner."""

    def around(corner):
        column, row = map(int, corner)
        cells = ((i, j) for i in (row - 1, row) for j in (column - 1, column) if 0 <= i < h and 0 <= j < w)
        return [cell for cell in cells if free[cell]]

    for free in FREE[:2]:
        h, w = free.shape
        corners = np.indices((w + 1, h + 1)).reshape(2, -1).T.astype(float)
        pairs = grid_distance(free, None, moves=moves)
        for goal in corners[9 :: 2 * h]:
            cells = np.min([np.full(free.shape, np.inf), *(dijkstra(free, c, moves) for c in around(goal))], axis=0)
            expected = [min((cells[c] for c in around(x)), default=np.inf) for x in corners]
            steps = grid_distance(free, goal, moves=moves)
            for found in (steps(corners), pairs(corners, goal), pairs(goal, corners)):
                np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_where_cells_touch_in_a_corner_a_goal_is_in_both():
    free = drawn(".#", "#.")
    np.testing.assert_array_equal(grid_distance(free, [1.0, 1.0], moves=8).cells, [[0, np.inf], [np.inf, 0]])
    assert grid_distance(free, [0.5, 0.5], moves=8)([1.5, 1.5]) == np.inf
