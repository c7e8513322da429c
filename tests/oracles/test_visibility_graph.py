import math

import networkx as nx
import numpy as np
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st

from plr_jax.geometry.workspace import Workspace
from plr_jax.oracles import VisibilityGraph

TEN = ((0, 0), (10, 10))


def box(x0, y0, x1, y1):
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], dtype=float)


def length(path):
    return np.linalg.norm(np.diff(path, axis=0), axis=1).sum()


# --- drawn by hand ---------------------------------------------------------------------------------------

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


# --- twins by brute force --------------------------------------------------------------------------------


def brute_force(workspace, x, goal):
    """Distances by a plain visibility graph: every vertex of free space, every pair tested with Shapely.

    Free space is shrunk by a hair around point contacts unless squeezing is allowed.
    """
    free = shapely.box(0, 0, 10, 10) - shapely.union_all([shapely.Polygon(o) for o in workspace.obstacles])
    hair = 1e-7
    if not workspace.squeeze:
        points, count = np.unique(ring_vertices(free), axis=0, return_counts=True)
        plugs = [shapely.box(*(p - hair), *(p + hair)) for p in points[count > 1]]
        free = free - shapely.union_all(plugs)
    nodes = np.vstack([x, [goal], np.unique(ring_vertices(free), axis=0)])
    i, j = np.triu_indices(len(nodes), 1)
    grown = free.buffer(hair / 10, join_style="mitre")
    shapely.prepare(grown)
    seen = shapely.covers(grown, shapely.linestrings(np.stack([nodes[i], nodes[j]], axis=1)))
    weight = np.linalg.norm(nodes[i] - nodes[j], axis=1)
    graph = nx.Graph()
    graph.add_nodes_from(range(len(nodes)))
    graph.add_weighted_edges_from(zip(i[seen].tolist(), j[seen].tolist(), weight[seen].tolist(), strict=True))
    distance = nx.single_source_dijkstra_path_length(graph, len(x))
    return np.array([distance.get(k, np.inf) for k in range(len(x))])


def ring_vertices(free):
    rings = shapely.get_rings(shapely.get_parts(free))
    return np.vstack([shapely.get_coordinates(ring)[:-1] for ring in rings])


def general_workspace(seed, squeeze=False):
    rng = np.random.default_rng(seed)
    corners, size = rng.uniform(-0.5, 9, (5, 2)), rng.uniform(0.3, 3, (5, 2))
    boxes = [box(*c, *(c + s)) for c, s in zip(corners, size, strict=True)]
    triangles = [rng.uniform(0, 10, 2) + rng.uniform(-2, 2, (3, 2)) for _ in range(3)]
    return Workspace(TEN, boxes + triangles, squeeze=squeeze)


def lattice_workspace(seed, squeeze):
    """Unit cells blocked at random: collinear corners and point contacts everywhere."""
    blocked = np.argwhere(np.random.default_rng(seed).random((10, 10)) < 0.3)
    return Workspace(TEN, [box(x, y, x + 1, y + 1) for x, y in blocked], squeeze=squeeze)


@given(st.integers(0, 100_000))
@settings(max_examples=25, deadline=None)
def test_distances_equal_those_of_a_plain_visibility_graph(seed):
    workspace = general_workspace(seed)
    x = workspace.sample_free(12, seed)
    corners = workspace.boundary.vertices[:4]
    oracle = VisibilityGraph(workspace, x[0])
    queries = np.vstack([x[1:], corners])
    np.testing.assert_allclose(oracle(queries), brute_force(workspace, queries, x[0]), atol=1e-6)


@given(st.integers(0, 100_000), st.booleans(), st.booleans())
@settings(max_examples=40, deadline=None)
def test_distances_on_a_lattice_equal_those_of_a_plain_visibility_graph(seed, squeeze, goal_on_lattice):
    workspace = lattice_workspace(seed, squeeze)
    lattice = np.argwhere(np.ones((11, 11))).astype(float)
    rng = np.random.default_rng(seed)
    contacts = workspace.boundary.vertices[workspace.boundary.contacts]
    lattice = lattice[workspace.is_free(lattice)]
    if not squeeze:  # the twin plugs the contacts, so it cannot answer there
        lattice = lattice[~(lattice[:, None] == contacts).all(axis=2).any(axis=1)]
    x = np.vstack([rng.permutation(lattice)[:10], workspace.sample_free(6, seed)])
    x = x if goal_on_lattice else x[::-1]
    oracle = VisibilityGraph(workspace, x[0])
    np.testing.assert_allclose(oracle(x[1:]), brute_force(workspace, x[1:], x[0]), atol=1e-5)


@given(st.integers(0, 100_000), st.booleans(), st.floats(0, 6.28), st.floats(-3, 3), st.floats(-100, 100))
@example(977, True, 1.0, 0.0, 50.0)
@example(2286, False, 0.3, -1.5, -70.0)
@example(3223, True, 2.0, -0.5, 30.0)
@settings(max_examples=20, deadline=None)
def test_distances_survive_turning_scaling_and_shifting(seed, squeeze, turn, log_scale, shift):
    """Off the axes what was collinear, or touched, is so up to rounding only."""
    workspace = lattice_workspace(seed, squeeze)
    scale = 10**log_scale
    rotation = scale * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])

    def moved(points):
        return np.asarray(points, dtype=float) @ rotation.T + scale * shift

    holes = [moved(shapely.get_coordinates(o)[:-1]) for o in workspace.obstacles]
    other = Workspace.from_polygons([{"outer": moved(box(0, 0, 10, 10)), "holes": holes}], squeeze=squeeze)
    lattice = np.argwhere(np.ones((11, 11))).astype(float)
    x = np.vstack([lattice[workspace.is_free(lattice)][seed % 7 :: 7], workspace.sample_free(10, seed)])
    goal = x[seed % len(x)]
    expected = VisibilityGraph(workspace, goal)(x)
    np.testing.assert_allclose(VisibilityGraph(other, moved(goal))(moved(x)) / scale, expected, atol=1e-6)
    free = x[len(x) - 10 :]  # off the lattice: at point contacts the twin cannot answer
    from_outside = brute_force(workspace, free[1:], free[0])
    np.testing.assert_allclose(
        VisibilityGraph(other, moved(free[0]))(moved(free[1:])) / scale, from_outside, atol=1e-5
    )


@given(st.integers(0, 100_000), st.booleans())
@settings(max_examples=25, deadline=None)
def test_contacts_are_reached_from_the_nearest_side(seed, squeeze):
    workspace = lattice_workspace(seed, squeeze)
    contacts = workspace.boundary.vertices[workspace.boundary.contacts]
    goal = workspace.sample_free(1, seed)[0]
    oracle = VisibilityGraph(workspace, goal)
    beside = contacts[:, None] + 1e-4 * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
    around = oracle(beside.reshape(-1, 2)).reshape(-1, 4).min(axis=1)
    np.testing.assert_allclose(oracle(contacts), around, atol=2e-4)
    few = beside[:2].reshape(-1, 2)
    few = few[workspace.is_free(few)]
    np.testing.assert_allclose(oracle(few), brute_force(workspace, few, goal), atol=1e-5)
    for contact, distance in zip(contacts, oracle(contacts), strict=True):
        assert oracle.with_goal(contact)(goal[None])[0] == pytest.approx(distance)


@given(st.integers(0, 100_000), st.booleans(), st.booleans())
@settings(max_examples=40, deadline=None)
def test_paths_are_free_and_as_long_as_the_distance(seed, lattice, squeeze):
    workspace = (lattice_workspace if lattice else general_workspace)(seed, squeeze)
    goal, *starts = workspace.sample_free(6, seed)
    oracle = VisibilityGraph(workspace, goal)
    for start, distance in zip(starts, oracle(np.array(starts)), strict=True):
        path = oracle.shortest_path(start)
        if np.isinf(distance):
            assert len(path) == 0
            continue
        np.testing.assert_array_equal(path[[0, -1]], [start, goal])
        assert length(path) == pytest.approx(distance, abs=1e-9)
        assert workspace.is_visible(path[:-1], path[1:]).all()


@given(st.integers(0, 100_000))
@settings(max_examples=20, deadline=None)
def test_distance_is_symmetric_at_least_straight_and_one_lipschitz_along_sight(seed):
    workspace = general_workspace(seed)
    x = workspace.sample_free(60, seed)
    oracle = VisibilityGraph(workspace, x[0])
    d = oracle(x)
    assert (d >= np.linalg.norm(x - x[0], axis=1) - 1e-9).all()
    assert d[0] == 0
    assert oracle.with_goal(x[1])(x[:1])[0] == pytest.approx(d[1])
    i, j = np.triu_indices(len(x), 1)
    seen = workspace.is_visible(x[i], x[j])
    step = np.linalg.norm(x[i] - x[j], axis=1)[seen]
    assert (np.isfinite(d[i[seen]]) == np.isfinite(d[j[seen]])).all()
    reached = np.isfinite(d[i[seen]])
    assert (np.abs(d[i[seen]][reached] - d[j[seen]][reached]) <= step[reached] + 1e-9).all()


def test_batches_of_any_size_give_the_same_answers():
    workspace = general_workspace(7)
    oracle = VisibilityGraph(workspace, workspace.sample_free(1, 0)[0])
    x = np.random.default_rng(0).uniform(-1, 11, (5000, 2))
    whole = oracle(x)
    np.testing.assert_array_equal(whole, np.concatenate([oracle(part) for part in np.array_split(x, 97)]))
    np.testing.assert_array_equal(np.isfinite(whole) & ~workspace.is_free(x), False)


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


@given(st.integers(0, 100_000), st.booleans())
@settings(max_examples=15, deadline=None)
def test_distances_of_the_graph_are_those_of_the_oracle(seed, squeeze):
    """Edges that no shortest path can use are left out of it, and only those."""
    workspace = lattice_workspace(seed, squeeze) if squeeze else general_workspace(seed)
    oracle = VisibilityGraph(workspace, workspace.sample_free(1, seed)[0])
    np.testing.assert_allclose(oracle(oracle.graph.vertices), oracle.distances, atol=1e-9)


def test_another_goal_shares_the_corners():
    oracle = VisibilityGraph(WALL, (8, 4))
    other = oracle.with_goal((2, 4))
    x = WALL.sample_free(200, 0)
    np.testing.assert_array_equal(other(x), VisibilityGraph(WALL, (2, 4))(x))
    assert other._corners is oracle._corners
    assert 0 < other.num_bytes < 10_000


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
