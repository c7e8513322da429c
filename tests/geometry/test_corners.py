import numpy as np
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st
from piece_helpers import TEN, hard_points

from plr_jax.geometry.corners import corner_visibility, find_corners
from plr_jax.geometry.workspace import Workspace
from plr_jax.oracles import VisibilityGraph

BLOCK = Workspace(TEN, [[(4, 0), (6, 0), (6, 8), (4, 8)]])  # stands on the bottom, its corners (4, 8) and (6, 8)


def test_the_goal_comes_first_and_takes_the_place_of_a_corner():
    corners, goal = find_corners(BLOCK)[0], np.array([4.0, 8.0])
    np.testing.assert_array_equal(corners.points, [[4, 8], [6, 8]])
    # A free sector opens counterclockwise: at (4, 8) from the top of the block to its left side.
    np.testing.assert_array_equal(corners.walls, [[[1, 0], [0, -1]], [[0, -1], [-1, 0]]])
    np.testing.assert_array_equal(corners.without(goal).points, [[6, 8]])
    np.testing.assert_array_equal(corners.without(goal).walls, corners.walls[:, 1:])
    vertices = corners.without(goal).with_goal(goal)
    np.testing.assert_array_equal(vertices.points, [[4, 8], [6, 8]])
    np.testing.assert_array_equal(vertices.walls[:, 0], 0)


def test_corners_that_see_one_another_are_joined_once_unless_no_path_turns_there():
    # Two blocks side by side: diagonals cut off a part of the left one at one end, of the right one at the other.
    seen = corner_visibility(Workspace(TEN, [shapely.box(1, 4, 3, 6), shapely.box(5, 4, 7, 6)]))
    pairs = {frozenset(map(tuple, pair)) for pair in seen.corners.points[seen.edges].tolist()}
    sides = [((x, 4), (x, 6)) for x in (1, 3, 5, 7)]
    along = [((a, y), (b, y)) for y in (4, 6) for a, b in ((1, 3), (3, 5), (5, 7))]
    inner = [((3, 4), (5, 6)), ((3, 6), (5, 4))]
    assert pairs >= {frozenset(pair) for pair in sides + along + inner} and len(pairs) == len(seen.edges)
    assert frozenset([(1, 4), (7, 6)]) not in pairs


@pytest.mark.full
@given(st.integers(0, 100_000), st.booleans(), st.booleans())
@example(29693, True, False)  # a goal within the tolerance of a wall's end
@example(29693, True, True)
@example(981, False, False)
@settings(max_examples=40)
def test_turn_points_by_triangle_are_as_good_as_all_of_them(seed, lattice, squeeze):
    """The shortest path that starts around a listed corner is as short as around any corner."""
    rng = np.random.default_rng(seed)
    cells = np.argwhere(rng.random((10, 10)) < 0.3)
    triangles = [rng.uniform(0, 10, 2) + rng.uniform(-2, 2, (3, 2)) for _ in range(8)]
    workspace = Workspace(TEN, list(shapely.box(*cells.T, *cells.T + 1)) if lattice else triangles, squeeze=squeeze)
    x = hard_points(workspace, seed)
    oracle, places = VisibilityGraph(workspace, x[seed % len(x)]), workspace.triangulation.place(x)
    hidden = ~oracle._goal_table.sees(np.zeros(len(x), int), places.x)
    x, places = x[hidden], places[hidden]
    table = oracle.family.table

    def sees(point, vertex):
        return table.sees(vertex - 1, places.x[point])

    found = oracle.regions.first_visible(x, places, sees)
    expected = oracle._turns.first_visible(x, sees)
    np.testing.assert_allclose(found[1], expected[1], rtol=0, atol=1e-8)
    np.testing.assert_array_equal(found[0] < 0, expected[0] < 0)


def test_only_the_corners_around_which_paths_come_count():
    """Left of a wall that stands on the floor paths turn at its upper left corner, above it at the right one."""
    regions, triangulation = VisibilityGraph(BLOCK, (8.0, 4.0)).regions, BLOCK.triangulation
    triangle, _ = triangulation.locator.find(np.array([[1.0, 2.0], [5.0, 9.0]]))
    at = [regions.turns.points[regions.turn[regions.first[t] : regions.first[t + 1]]].tolist() for t in triangle]
    assert [4.0, 8.0] in at[0] and [6.0, 8.0] in at[1]
    assert len(regions.first) == len(triangulation.triangles) + 1
