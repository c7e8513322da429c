"""Shortest distances and paths in workspaces drawn by hand, the graph that gives them, and what it refuses."""

import math
import pickle

import networkx as nx
import numpy as np
import pytest
import shapely
from oracle_helpers import TEN, box, length

from plr_jax.geometry.workspace import Workspace
from plr_jax.oracles import VisibilityGraph

WALL = Workspace(TEN, [box(4, 0, 6, 8)])


def test_straight_around_and_along():
    oracle = VisibilityGraph(WALL, (8, 4))
    x = np.array([[9.0, 1.0], [2, 4], [6, 4], [4, 4], [4, 8], [5, 8], [6, 8], [8, 4], [5, 4], [-1, 4], [5, 9]])
    over = 2 + math.hypot(2, 4)
    expected = [
        math.hypot(1, 3),
        over + math.hypot(2, 4),
        2,
        over + 4,
        over,
        over - 1,
        over - 2,
        0,
        math.inf,
        math.inf,
        math.hypot(1, 1) + math.hypot(2, 4),
    ]
    np.testing.assert_allclose(oracle(x), expected, atol=1e-12)
    assert oracle(x).dtype == np.float64
    np.testing.assert_array_equal(oracle(np.array([[np.nan, 1], [np.inf, 1]])), [np.inf, np.inf])
    assert oracle(np.empty((0, 2))).shape == (0,)


def test_the_path_turns_at_the_corners():
    oracle = VisibilityGraph(WALL, (8, 4))
    np.testing.assert_array_equal(oracle.shortest_path(np.array([2, 4])), [[2, 4], [4, 8], [6, 8], [8, 4]])
    np.testing.assert_array_equal(oracle.shortest_path((9, 1)), [[9, 1], [8, 4]])
    np.testing.assert_array_equal(oracle.shortest_path((8, 4)), [[8, 4]])
    np.testing.assert_array_equal(VisibilityGraph(WALL, (4, 8)).shortest_path((4, 8)), [[4, 8]])
    np.testing.assert_array_equal(oracle.shortest_path((4, 8)), [[4, 8], [6, 8], [8, 4]])
    assert oracle.shortest_path((5, 4)).shape == (0, 2)


UP = math.hypot(2, 4)  # from (2, 4) to the wall's corner (4, 8)


@pytest.mark.parametrize(
    ("goal", "from_left", "from_right"),
    [
        ((6, 8), UP + 2, math.hypot(3, 6)),
        ((4, 8), UP, math.hypot(3, 6) + 2),
        ((5, 8), UP + 1, math.hypot(3, 6) + 1),
        ((6, 4), UP + 2 + 4, math.hypot(3, 2)),
        ((6 + 1e-10, 4), UP + 2 + 4, math.hypot(3, 2)),
        ((6 - 1e-10, 4), UP + 2 + 4, math.hypot(3, 2)),
        ((6, 8 - 1e-10), UP + 2, math.hypot(3, 6)),
        ((6, 0), UP + 2 + 8, math.hypot(3, 2)),
        ((10, 10), UP + math.hypot(6, 2), math.hypot(1, 8)),
        ((4, 0), math.hypot(2, 4), math.hypot(3, 6) + 2 + 8),
    ],
)
def test_goals_on_walls_and_corners(goal, from_left, from_right):
    x = np.array([[2.0, 4.0], [9.0, 2.0]])
    np.testing.assert_allclose(VisibilityGraph(WALL, goal)(x), [from_left, from_right], atol=1e-8)
    # Distance is symmetric, so the same holds of queries on walls and corners.
    np.testing.assert_allclose(VisibilityGraph(WALL, x[0])(np.array([goal])), [from_left], atol=1e-8)
    np.testing.assert_allclose(VisibilityGraph(WALL, x[1])(np.array([goal])), [from_right], atol=1e-8)


def test_an_enclosed_region_is_unreachable():
    ring = shapely.Polygon(box(2, 2, 8, 8), [box(4, 4, 6, 6)])
    workspace = Workspace(TEN, [ring])
    x = np.array([[5.0, 5.0], [1, 1], [4, 4]])
    np.testing.assert_array_equal(np.isfinite(VisibilityGraph(workspace, (1, 9))(x)), [False, True, False])
    np.testing.assert_array_equal(np.isfinite(VisibilityGraph(workspace, (5, 5))(x)), [True, False, True])
    assert VisibilityGraph(workspace, (1, 9)).shortest_path((5, 5)).shape == (0, 2)


def test_without_obstacles_the_distance_is_straight():
    oracle = VisibilityGraph(Workspace(TEN), (3, 3))
    x = np.vstack([np.random.default_rng(0).uniform(0, 10, (1000, 2)), [[0, 0], [10, 10]]])
    np.testing.assert_allclose(oracle(x), np.linalg.norm(x - 3, axis=1))
    assert np.isinf(oracle(np.array([[0, 11], [-1e-6, 3]]))).all()


@pytest.mark.parametrize("squeeze", [False, True])
def test_a_point_contact_is_passed_only_by_squeezing(squeeze):
    workspace = Workspace(TEN, [box(3, 3, 5, 5), box(5, 5, 7, 7)], squeeze=squeeze)
    root2, root5 = math.sqrt(2), math.sqrt(5)
    cases = [
        ((4, 6), (5, 5), root2),
        ((6, 4), (5, 5), root2),
        ((4, 6), (6, 4), 2 * root2 if squeeze else 4 + 2 * root2),
        ((5, 6), (5, 4), 2 if squeeze else 5 + root5),
        ((4, 5), (6, 5), 2 if squeeze else 5 + root5),
    ]
    for start, goal, expected in cases:
        for a, b in ((start, goal), (goal, start)):
            oracle = VisibilityGraph(workspace, b)
            assert oracle(np.array([a]))[0] == pytest.approx(expected, abs=1e-12)
            assert length(oracle.shortest_path(a)) == pytest.approx(expected, abs=1e-12)


def test_an_obstacle_that_touches_the_bounds_in_a_point_blocks_unless_squeezed():
    tip = np.array([[5.0, 0], [3, 10], [7, 10]])
    start = np.array([[1.0, 0.0]])
    assert np.isinf(VisibilityGraph(Workspace(TEN, [tip]), (9, 0))(start)[0])
    assert VisibilityGraph(Workspace(TEN, [tip], squeeze=True), (9, 0))(start)[0] == pytest.approx(8)


def test_obstacles_that_share_a_wall_leave_no_slit():
    workspace = Workspace(TEN, [box(3, 2, 5, 10), box(5, 2, 7, 10)])
    oracle = VisibilityGraph(workspace, (5, 1))
    distances = oracle(np.array([[5.0, 5.0], [5, 2], [3, 10]]))
    np.testing.assert_allclose(distances, [np.inf, 1, 8 + math.sqrt(5)], rtol=1e-12)


def test_the_graph_joins_what_sees_one_another():
    oracle = VisibilityGraph(WALL, (8, 4))
    corners = {tuple(p): i for i, p in enumerate(oracle.graph.vertices.tolist())}
    assert set(corners) == {(8, 4), (4, 8), (6, 8)}
    assert corners[8, 4] == 0
    assert {frozenset(e) for e in oracle.graph.edges.tolist()} == {
        frozenset({0, corners[6, 8]}),
        frozenset({corners[4, 8], corners[6, 8]}),
    }
    np.testing.assert_allclose(oracle.distances[[0, corners[6, 8], corners[4, 8]]], [0, UP, UP + 2])
    exported = oracle.to_networkx()
    assert nx.dijkstra_path_length(exported, corners[4, 8], 0) == pytest.approx(UP + 2)
    assert exported.nodes[0]["pos"] == (8.0, 4.0)


def test_another_goal_shares_the_corners():
    oracle = VisibilityGraph(WALL, (8, 4))
    other = oracle.with_goal((2, 4))
    x = WALL.sample_free(200, 0)
    np.testing.assert_array_equal(other(x), VisibilityGraph(WALL, (2, 4))(x))
    assert other._corners is oracle._corners
    assert 0 < other.num_bytes < 10_000


def test_what_follows_from_the_rest_is_not_pickled():
    oracle = VisibilityGraph(WALL, (8, 4))
    x = WALL.sample_free(50, 0)
    expected = oracle(x), oracle.directions(x), oracle.sources.points
    again = pickle.loads(pickle.dumps(oracle))
    assert vars(again).keys() < vars(oracle).keys()
    for found, known in zip((again(x), again.directions(x), again.sources.points), expected, strict=True):
        np.testing.assert_array_equal(found, known)
    np.testing.assert_array_equal(again.graph.edges, oracle.graph.edges)
    np.testing.assert_array_equal(again.graph.vertices, oracle.graph.vertices)


def test_repr_is_one_line_without_arrays():
    assert repr(VisibilityGraph(WALL, (1, 1))) == "VisibilityGraph(goal=[1.0, 1.0], 2 corners, 2 edges)"


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: VisibilityGraph(WALL, (5, 4)), r"goal \[5.0, 4.0\] lies in an obstacle \(clearance -1\)"),
        (lambda: VisibilityGraph(WALL, (11, 4)), "outside the bounds"),
        (lambda: VisibilityGraph(WALL, (1, np.nan)), "finite"),
        (lambda: VisibilityGraph(WALL, (1, 2, 3)), r"The goal must be one point of shape \(2,\), got shape \(3,\)"),
        (lambda: VisibilityGraph(WALL, (1, 1)).with_goal((5, 5)), "in an obstacle"),
        (lambda: VisibilityGraph(WALL, (1, 1))(np.zeros(2)), r"\(n, 2\).*x\[None\]"),
        (lambda: VisibilityGraph(WALL, (1, 1))(np.zeros((5, 3))), r"\(n, 2\), got \(5, 3\)"),
        (
            lambda: VisibilityGraph(WALL, (1, 1)).shortest_path(np.zeros((1, 2))),
            r"The start must be one point of shape \(2,\)",
        ),
    ],
)
def test_bad_input_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
