"""Distances and paths over roadmaps: near the exact ones and never below, equal to those of twins by brute force."""

import csv
import itertools

import networkx as nx
import numpy as np
import pytest
import shapely
from oracle_helpers import CUT, GAP, NOTHING, UNIT, Boxes, free_points, roadmap

from plr_jax import scenes
from plr_jax.geometry.box import Box
from plr_jax.geometry.workspace import Workspace
from plr_jax.oracles import Roadmap


def test_empty_box_is_near_euclidean_and_never_below():
    x = free_points(NOTHING, 500)
    oracle = roadmap(NOTHING, num_samples=2000)
    euclidean = np.linalg.norm(x - oracle.goal, axis=1)
    excess = oracle(x) - euclidean
    assert excess.min() >= -1e-12
    assert excess.max() < 0.05
    near = euclidean <= oracle.radius
    assert near.any()
    np.testing.assert_allclose(oracle(x[near]), euclidean[near], rtol=0, atol=1e-15)


@pytest.mark.parametrize(("dim", "excess"), [(3, 0.06), (4, 0.10)])
def test_empty_box_in_higher_dimensions(dim, excess):
    goal = np.full(dim, 0.2)
    oracle = roadmap(NOTHING, goal, 1500, Box(np.zeros(dim), np.ones(dim)))
    x = np.random.default_rng(3).random((200, dim))
    difference = oracle(x) - np.linalg.norm(x - goal, axis=1)
    assert difference.min() >= -1e-12
    assert difference.mean() < excess
    path = oracle.shortest_path(x[0])
    assert path.shape[1] == dim
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).sum() == pytest.approx(oracle(x[:1])[0])


def test_wall_with_a_gap():
    oracle = roadmap(GAP, num_samples=1500)
    # Exact: over the two corners of the gap's lower edge.
    corner_left, corner_right = np.array([0.45, 0.8]), np.array([0.55, 0.8])
    start = np.array([0.9, 0.1])
    exact = np.linalg.norm(start - corner_right) + 0.1 + np.linalg.norm(corner_left - oracle.goal)
    assert exact * (1 - 1e-12) <= oracle(start[None])[0] < 1.06 * exact


def test_a_wall_in_three_dimensions_is_rounded():
    wall = Boxes((0.45, -1.0, -1.0, 0.55, 2.0, 0.7))
    oracle = roadmap(wall, (0.2, 0.5, 0.2), 1500, Box((0, 0, 0), (1, 1, 1)))
    start = np.array([[0.8, 0.5, 0.2]])
    exact = 0.1 + 2 * np.hypot(0.25, 0.5)
    assert exact * (1 - 1e-12) <= oracle(start)[0] < 1.15 * exact
    blind = roadmap(wall, (0.2, 0.5, 0.2), 1500, Box((0, 0, 0), (1, 1, 1)), is_visible=None, resolution=0.02)
    assert 0.98 * exact <= blind(start)[0] < 1.15 * exact


def test_the_other_side_of_a_closed_wall_is_unreachable():
    oracle = roadmap(CUT)
    x = np.array([[0.2, 0.9], [0.8, 0.9], [0.8, 0.1], [0.5, 0.5], [0.45, 0.3], [0.55, 0.3]])
    np.testing.assert_array_equal(np.isfinite(oracle(x)), [True, False, False, False, True, False])
    assert oracle.shortest_path(x[1]).shape == (0, 2)
    assert oracle.shortest_path(x[3]).shape == (0, 2)


def test_no_answer_outside_the_domain_or_for_nan():
    oracle = roadmap(NOTHING)
    x = np.array([[1.1, 0.5], [0.5, -1e-9], [np.nan, 0.5], [0.5, np.inf], [1.0, 1.0]])
    np.testing.assert_array_equal(np.isfinite(oracle(x)), [False, False, False, False, True])
    assert oracle.shortest_path(x[2]).shape == (0, 2)


def test_the_goal_and_the_vertices_are_answered_exactly():
    oracle = roadmap(GAP)
    assert oracle(oracle.goal[None])[0] == 0.0
    np.testing.assert_array_equal(oracle.shortest_path(oracle.goal), oracle.goal[None])
    np.testing.assert_allclose(oracle(oracle.graph.vertices), oracle.distances, rtol=0, atol=1e-12)


def brute_force_graph(oracle, obstacles):
    """Every pair within the radius, tested by Shapely one at a time."""
    vertices, union = oracle.graph.vertices, obstacles.union()
    graph = nx.Graph()
    graph.add_nodes_from(range(len(vertices)))
    for i, j in itertools.combinations(range(len(vertices)), 2):
        segment = shapely.LineString(vertices[[i, j]])
        if segment.length <= oracle.radius and not segment.relate_pattern(union, "T********"):
            graph.add_edge(i, j, weight=segment.length)
    return graph


def brute_force_query(oracle, obstacles, distances, x):
    """Every vertex tested, by Shapely; the radius doubles until one is seen."""
    vertices, union = oracle.graph.vertices, obstacles.union()
    seen = [not shapely.LineString([x, v]).relate_pattern(union, "T********") for v in vertices]
    length = np.linalg.norm(vertices - x, axis=1)
    radius = oracle.radius
    while not np.any(seen & (length <= radius)):
        if radius > 4:
            return np.inf
        radius *= 2
    return min(length[v] + distances.get(v, np.inf) for v in np.flatnonzero(seen & (length <= radius)))


@pytest.mark.parametrize(("obstacles", "num_samples"), [(GAP, 25), (GAP, 120), (CUT, 60)])
def test_brute_force_twin(obstacles, num_samples):
    oracle = roadmap(obstacles, num_samples=num_samples, seed=4)
    expected = brute_force_graph(oracle, obstacles)
    assert {frozenset(e) for e in oracle.graph.edges.tolist()} == {frozenset(e) for e in expected.edges}
    distances = nx.single_source_dijkstra_path_length(expected, 0)
    np.testing.assert_allclose(oracle.distances, [distances.get(v, np.inf) for v in range(num_samples + 1)])
    x = free_points(obstacles, 120)
    np.testing.assert_allclose(oracle(x), [brute_force_query(oracle, obstacles, distances, p) for p in x])


def test_a_point_that_sees_no_vertex_nearby_looks_farther():
    # A closet in the corner, open to the right, too small to be hit by a sample.
    closet = Boxes((0.0, 0.979, 0.1, 0.98), (0.0, 0.90, 0.02, 0.979))
    oracle = roadmap(closet, (0.9, 0.99), 60, seed=0)
    x = np.array([[0.001, 0.981]])
    length = np.linalg.norm(oracle.graph.vertices - x, axis=1)
    seen = oracle.is_visible(np.repeat(x, len(length), 0), oracle.graph.vertices)
    assert not np.any(seen & (length <= oracle.radius))
    assert seen.any()
    assert np.linalg.norm(x[0] - oracle.goal) <= oracle(x)[0] < 1.0
    path = oracle.shortest_path(x[0])
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).sum() == pytest.approx(oracle(x)[0])


def test_a_point_that_sees_nothing_at_all_is_unconnected():
    # A sealed chamber too small to be hit by a sample.
    sealed = Boxes(
        (0.5, 0.5, 0.52, 0.5001),
        (0.5, 0.5, 0.5001, 0.52),
        (0.5, 0.5199, 0.52, 0.52),
        (0.5199, 0.5, 0.52, 0.52),
    )
    oracle = roadmap(sealed, num_samples=60)
    assert not oracle.is_visible(np.full((61, 2), 0.51), oracle.graph.vertices).any()
    assert oracle(np.array([[0.51, 0.51]]))[0] == np.inf
    assert oracle.shortest_path([0.51, 0.51]).shape == (0, 2)


def test_networkx_agrees():
    oracle = roadmap(GAP)
    exported = oracle.to_networkx()
    distances = nx.single_source_dijkstra_path_length(exported, 0)
    np.testing.assert_allclose([distances[v] for v in range(oracle.graph.num_vertices)], oracle.distances)
    assert exported.nodes[0]["pos"] == (0.1, 0.1)


def test_the_path_is_as_long_as_the_query_says_and_free():
    oracle = roadmap(GAP)
    x = free_points(GAP, 40)
    for start, distance in zip(x, oracle(x), strict=True):
        path = oracle.shortest_path(start)
        np.testing.assert_array_equal(path[[0, -1]], [start, oracle.goal])
        assert np.linalg.norm(np.diff(path, axis=0), axis=1).sum() == pytest.approx(distance, abs=1e-12)
        assert GAP.is_visible(path[:-1], path[1:]).all()


def test_a_batch_is_its_points_one_by_one():
    oracle = roadmap(GAP)
    x = np.random.default_rng(2).random((60, 2))
    np.testing.assert_array_equal(oracle(x), [oracle(p[None])[0] for p in x])
    assert oracle(np.empty((0, 2))).shape == (0,)
    assert oracle(x.tolist()).dtype == np.float64


def test_batches_larger_than_memory_allows_are_cut(monkeypatch):
    x = free_points(GAP, 200)
    expected, sampled = roadmap(GAP)(x), roadmap(GAP, is_visible=None, resolution=0.01)(x)
    monkeypatch.setattr("plr_jax.oracles._roadmap._BATCH", 64)
    monkeypatch.setattr("plr_jax.oracles._roadmap._BATCH", 64)
    np.testing.assert_array_equal(roadmap(GAP)(x), expected)
    np.testing.assert_array_equal(roadmap(GAP, is_visible=None, resolution=0.01)(x), sampled)


def test_seeds():
    x = free_points(GAP, 50)
    first, again, other = (roadmap(GAP, seed=seed)(x) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    fewer, more = roadmap(GAP, num_samples=50), roadmap(GAP, num_samples=2500)
    np.testing.assert_array_equal(more.graph.vertices[:51], fewer.graph.vertices)


def test_more_samples_converge():
    x = free_points(NOTHING, 200)
    excess = [
        np.mean(oracle(x) - np.linalg.norm(x - oracle.goal, axis=1))
        for oracle in (roadmap(NOTHING, num_samples=n) for n in (100, 1000, 10_000))
    ]
    assert 0 < excess[2] < excess[1] < excess[0]


def test_counts_and_bytes():
    oracle = roadmap(GAP, num_samples=100)
    assert oracle.graph.num_vertices == 101
    assert oracle.num_bytes == 101 * 2 * 8 + oracle.graph.num_edges * (2 * 4 + 8)
    assert oracle.domain == UNIT


def test_a_workspace_gives_the_roadmap_of_its_parts():
    workspace = Workspace(((0, 0), (1, 1)), [shapely.box(0.45, 0.0, 0.55, 0.8), shapely.box(0.45, 0.9, 0.55, 1.0)])
    short = Roadmap.from_workspace(workspace, (0.1, 0.1), 300, seed=2)
    assert short.domain == UNIT
    x = free_points(GAP, 200)
    np.testing.assert_allclose(short(x), roadmap(GAP, seed=2)(x), rtol=1e-12)
    with pytest.raises(ValueError, match="not free"):
        Roadmap.from_workspace(workspace, (0.5, 0.5), 300)


def test_another_goal_keeps_samples_and_edges():
    first = roadmap(GAP, goal=(0.9, 0.2), seed=5)
    asked = []

    def is_visible(a, b):
        asked.append(len(a))
        return GAP.is_visible(a, b)

    moved = roadmap(GAP, goal=(0.2, 0.7), seed=5, is_visible=is_visible)
    asked.clear()
    moved = moved.with_goal((0.9, 0.2))
    assert len(asked) == 1 and asked[0] < 100  # the goal's own edges
    np.testing.assert_array_equal(moved.graph.vertices, first.graph.vertices)
    assert {frozenset(e) for e in moved.graph.edges.tolist()} == {frozenset(e) for e in first.graph.edges.tolist()}
    x = np.random.default_rng(0).random((100, 2))
    np.testing.assert_allclose(moved(x), first(x), rtol=1e-14)
    assert moved.num_bytes == first.num_bytes
    with pytest.raises(ValueError, match="not free"):
        moved.with_goal((0.5, 0.5))


def test_paths_are_no_shorter_than_the_published_lengths_of_the_arena(data_dir):
    folder = data_dir / "polyanya_arena"
    workspace = scenes.read_polygons(folder / "arena_polygons.json")
    with (folder / "arena_euclid.csv").open() as file:
        rows = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)][-1::-40]
    oracle = Roadmap.from_workspace(workspace, (rows[0]["goal_x"], rows[0]["goal_y"]), 2000)
    for row in rows:
        distance = oracle.with_goal((row["goal_x"], row["goal_y"]))([[row["start_x"], row["start_y"]]])[0]
        assert row["euclid_length"] - 1e-4 <= distance <= 1.1 * row["euclid_length"]


def test_sources_are_vertices_and_answers_go_by_way_of_one():
    def is_free(x):
        return np.linalg.norm(x - 0.5, axis=1) > 0.3

    oracle = Roadmap(Box(np.zeros(3), np.ones(3)), is_free, np.full(3, 0.05), 60, resolution=0.02)
    sources = oracle.sources
    assert np.array_equal(sources.points, oracle.graph.vertices) and np.array_equal(
        sources.distances, oracle.distances
    )
    assert sources.parents[0] == 0
    reached = np.isfinite(sources.distances)
    way = np.linalg.norm(sources.points - sources.points[sources.parents], axis=1)
    onward = sources.distances[sources.parents] + way
    assert np.allclose(onward[reached], sources.distances[reached])
    assert np.array_equal(sources.parents[~reached], np.flatnonzero(~reached))
    x = np.random.default_rng(0).random((200, 3))
    x = x[is_free(x)]
    through = sources.distances + np.linalg.norm(x[:, None] - sources.points, axis=2)
    assert np.abs(through - oracle(x)[:, None]).min(axis=1).max() < 1e-12
