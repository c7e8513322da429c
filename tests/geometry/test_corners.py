import numpy as np
import pytest
import shapely

from plr_jax.geometry.corners import corner_visibility, find_corners, find_turn_points
from plr_jax.geometry.workspace import Workspace

TEN = ((0, 0), (10, 10))
BLOCK = Workspace(TEN, [[(4, 0), (6, 0), (6, 8), (4, 8)]])  # stands on the bottom, its corners (4, 8) and (6, 8)
TOUCHING = [shapely.box(1, 1, 2, 2), shapely.box(2, 2, 3, 3)]
INF = np.inf


def test_corners_by_hand():
    corners, views = find_corners(BLOCK)
    np.testing.assert_array_equal(corners.points, [[4, 8], [6, 8]])
    # A free sector opens counterclockwise: at (4, 8) from the top of the block to its left side.
    np.testing.assert_array_equal(corners.walls, [[[1, 0], [0, -1]], [[0, -1], [-1, 0]]])
    np.testing.assert_array_equal(views.points, corners.points)
    np.testing.assert_array_equal(views.opens(BLOCK.boundary), [[2, 0], [0, -8]])
    np.testing.assert_array_equal(views.closes(BLOCK.boundary), [[0, -8], [-2, 0]])


def test_a_workspace_without_corners():
    corners, views = find_corners(Workspace(TEN))
    assert corners.points.shape == views.points.shape == (0, 2) and corners.walls.shape == (2, 0, 2)
    assert corner_visibility(Workspace(TEN)).edges.shape == (0, 2)


@pytest.mark.parametrize("squeeze", [False, True])
def test_a_contact_is_a_corner_that_may_be_turned_around_on_any_side_where_squeezing_is_allowed(squeeze):
    corners, views = find_corners(Workspace(TEN, TOUCHING, squeeze=squeeze))
    contact = (corners.points == [2, 2]).all(axis=1)
    assert len(corners.points) == 6 + squeeze and contact.sum() == squeeze
    assert (corners.walls[:, contact] == 0).all() and (corners.walls[:, ~contact] != 0).any(axis=2).all()
    assert len(views.owner) == 6 + 2 * squeeze  # a contact looks into two sectors


def test_the_goal_comes_first_and_takes_the_place_of_a_corner():
    corners, _ = find_corners(BLOCK)
    goal = np.array([4.0, 8.0])
    assert corners.without(goal).with_goal(goal).points.tolist() == [[4, 8], [6, 8]]
    assert corners.with_goal(goal).points.tolist() == [[4, 8], [4, 8], [6, 8]]
    assert corners.with_goal(goal).walls[:, 0].tolist() == [[0, 0], [0, 0]]


def test_tangent_lines_by_hand():
    vertices = find_corners(BLOCK)[0].with_goal(np.array([8.0, 4.0]))
    # From (4, 8): the goal is behind the block, (6, 8) along its top. From (6, 8): both are tangent.
    tangent = vertices.is_tangent(np.array([[1], [2]]), np.arange(3))
    assert tangent[:, [0, 2]].tolist() == [[False, True], [True, True]] and tangent[1, 1]
    assert vertices.is_tangent(np.arange(3), np.full(3, 2)).tolist() == [True, True, True]


def test_corners_that_see_one_another_are_joined_once_unless_no_path_turns_there():
    # Two blocks side by side: diagonals cut off a part of the left one at one end, of the right one at the other.
    seen = corner_visibility(Workspace(TEN, [shapely.box(1, 4, 3, 6), shapely.box(5, 4, 7, 6)]))
    pairs = {frozenset(map(tuple, pair)) for pair in seen.corners.points[seen.edges].tolist()}
    sides = [((x, 4), (x, 6)) for x in (1, 3, 5, 7)]
    along = [((a, y), (b, y)) for y in (4, 6) for a, b in ((1, 3), (3, 5), (5, 7))]
    inner = [((3, 4), (5, 6)), ((3, 6), (5, 4))]
    assert pairs >= {frozenset(pair) for pair in sides + along + inner} and len(pairs) == len(seen.edges)
    assert frozenset([(1, 4), (7, 6)]) not in pairs


def test_turn_points_by_hand():
    """Around the block to the right: by way of (4, 8) only from below its top carried on and not from above."""
    vertices = find_corners(BLOCK)[0].with_goal(np.array([8.0, 4.0]))
    length = np.array([0.0, 2 + np.hypot(2, 4), np.hypot(2, 4)])
    turns = find_turn_points(vertices, length, np.array([0, 2, 0]))
    np.testing.assert_array_equal(turns.vertex, [1, 2])
    np.testing.assert_array_equal(turns.distance, length[1:])
    x = np.array([[2.0, 4.0], [4, 4], [2, 8], [2, 9], [5, 9], [4, 8]])
    assert np.isfinite(turns.path_lengths(x)[:, 0]).tolist() == [True, True, True, False, False, True]
    # By way of (6, 8): from the left of it, below the way on carried backward.
    x = np.array([[5.0, 9.0], [5, 11], [2, 8], [7, 9], [2, 7.9]])
    assert np.isfinite(turns.path_lengths(x)[:, 1]).tolist() == [True, False, True, False, False]
    np.testing.assert_allclose(turns.path_lengths(x)[0, 1], np.sqrt(2) + np.hypot(2, 4))


def test_the_first_turn_is_the_best_in_sight():
    vertices = find_corners(BLOCK)[0].with_goal(np.array([8.0, 4.0]))
    length = np.array([0.0, 2 + np.hypot(2, 4), np.hypot(2, 4)])
    turns = find_turn_points(vertices, length, np.array([0, 2, 0]))
    x = np.array([[2.0, 4.0], [5, 8.5], [2, 9]])
    vertex, distance = turns.first_visible(x, lambda point, vertex: (point != 1) & (vertex > 0))
    np.testing.assert_array_equal(vertex, [1, -1, 2])
    np.testing.assert_allclose(distance, [np.hypot(2, 4) + length[1], INF, np.hypot(4, 1) + length[2]])


def test_no_path_turns_at_a_corner_that_cannot_reach_the_goal_or_whose_way_on_cuts_into_the_obstacle():
    vertices = find_corners(BLOCK)[0].with_goal(np.array([8.0, 4.0]))
    assert find_turn_points(vertices, np.array([0, INF, 1.0]), np.array([0, 0, 0])).vertex.tolist() == [2]
    above = find_corners(BLOCK)[0].with_goal(np.array([1.0, 9.5]))  # straight on past (4, 8) is the block
    assert find_turn_points(above, np.array([0, 3.0, 6.0]), np.array([0, 0, 0])).vertex.tolist() == [2]
