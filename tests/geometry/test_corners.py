import numpy as np
import shapely
from piece_helpers import TEN

from plr_jax.geometry.corners import CornerVisibility, find_corners
from plr_jax.geometry.workspace import Workspace

BLOCK = Workspace(TEN, [[(4, 0), (6, 0), (6, 8), (4, 8)]])  # stands on the bottom, its corners (4, 8) and (6, 8)


def test_goal_comes_first_and_replaces_a_corner():
    corners, goal = find_corners(BLOCK)[0], np.array([4.0, 8.0])
    np.testing.assert_array_equal(corners.points, [[4, 8], [6, 8]])
    # A free sector opens counterclockwise: at (4, 8) from the top of the block to its left side.
    np.testing.assert_array_equal(corners.walls, [[[1, 0], [0, -1]], [[0, -1], [-1, 0]]])
    np.testing.assert_array_equal(corners.without(goal[None]).points, [[6, 8]])
    np.testing.assert_array_equal(corners.without(goal[None]).walls, corners.walls[:, 1:])
    vertices = corners.without(goal[None]).with_points(goal[None])
    np.testing.assert_array_equal(vertices.points, [[4, 8], [6, 8]])
    np.testing.assert_array_equal(vertices.walls[:, 0], 0)


def test_edges_join_visible_corners_where_paths_turn():
    # Two blocks side by side: diagonals cut off a part of the left one at one end, of the right one at the other.
    seen = CornerVisibility.of(Workspace(TEN, [shapely.box(1, 4, 3, 6), shapely.box(5, 4, 7, 6)]))
    pairs = {frozenset(map(tuple, pair)) for pair in seen.corners.points[seen.edges].tolist()}
    sides = [((x, 4), (x, 6)) for x in (1, 3, 5, 7)]
    along = [((a, y), (b, y)) for y in (4, 6) for a, b in ((1, 3), (3, 5), (5, 7))]
    inner = [((3, 4), (5, 6)), ((3, 6), (5, 4))]
    assert pairs >= {frozenset(pair) for pair in sides + along + inner} and len(pairs) == len(seen.edges)
    assert frozenset([(1, 4), (7, 6)]) not in pairs
