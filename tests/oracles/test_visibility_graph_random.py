"""Shortest distances in random workspaces: those of a plain visibility graph, and what holds of any distance."""

import networkx as nx
import numpy as np
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st
from oracle_helpers import TEN, box, length

from plr_jax.geometry.workspace import Workspace
from plr_jax.oracles import VisibilityGraph


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
@example(30254, False)  # a free space at which GEOS fails to find triangles to draw points from
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


@given(st.integers(0, 100_000), st.booleans())
@settings(max_examples=15, deadline=None)
def test_distances_of_the_graph_are_those_of_the_oracle(seed, squeeze):
    """Edges that no shortest path can use are left out of it, and only those."""
    workspace = lattice_workspace(seed, squeeze) if squeeze else general_workspace(seed)
    oracle = VisibilityGraph(workspace, workspace.sample_free(1, seed)[0])
    np.testing.assert_allclose(oracle(oracle.graph.vertices), oracle.distances, atol=1e-9)
