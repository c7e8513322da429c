import itertools

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from plr_jax.geometry.graph import Graph, dijkstra, first_visible, first_visible_ragged, path_ends, path_to_root


@st.composite
def lattice_graphs(draw):
    """Draw graphs with vertices on a small lattice, so that many coincide, and any set of edges."""
    points = draw(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3)), min_size=2, max_size=12))
    ends = st.tuples(st.integers(0, len(points) - 1), st.integers(0, len(points) - 1))
    pairs = draw(st.lists(ends.filter(lambda e: e[0] != e[1]), unique_by=frozenset, max_size=30))
    return Graph(np.array(points, dtype=float), np.array(pairs, dtype=np.int64).reshape(-1, 2))


@given(lattice_graphs())
def test_dijkstra_equals_networkx(graph):
    exported, edges = graph.to_networkx(), {frozenset(edge) for edge in graph.edges.tolist()}
    assert {frozenset(edge) for edge in exported.edges} == edges
    np.testing.assert_array_equal([place for _, place in exported.nodes(data="pos")], graph.vertices)
    for a, b, weight in exported.edges(data="weight"):
        assert weight == np.linalg.norm(np.subtract(*graph.vertices[[a, b]]))
    expected = nx.single_source_dijkstra_path_length(exported, 0)
    distances, parents = dijkstra(graph.adjacency, 0)
    np.testing.assert_allclose(distances, [expected.get(i, np.inf) for i in range(len(distances))], atol=1e-12)
    assert parents[0] < 0 and (parents[np.isinf(distances)] < 0).all()
    places = {frozenset(map(tuple, graph.vertices[[a, b]].tolist())) for a, b in edges}
    for vertex in expected:
        path = path_to_root(graph, parents, np.array([-1.0, -1.0]), vertex)
        assert path[0].tolist() == [-1, -1] and path[-1].tolist() == graph.vertices[0].tolist()
        assert all(frozenset(map(tuple, step)) in places for step in itertools.pairwise(path[1:].tolist()))
        legs = np.linalg.norm(np.diff(path[1:], axis=0), axis=1)
        assert legs.sum() == pytest.approx(expected[vertex], abs=1e-12) and (legs > 0).all()


@given(st.lists(st.integers(0, 40), min_size=1, max_size=40))
def test_path_ends_equal_the_last_of_steps(steps):
    """Each vertex leads to a vertex of a smaller number, or is an end."""
    onward = np.minimum(steps, np.arange(len(steps)))
    for vertex, end in enumerate(path_ends(onward).tolist()):
        while onward[vertex] != vertex:
            vertex = onward[vertex]
        assert end == vertex


LENGTHS = st.sampled_from([np.nan, np.inf, *np.arange(20.0)])


@st.composite
def searches(draw):
    """Draw the lengths of ways from several points, and which ways are visible."""
    shape = draw(st.tuples(st.integers(0, 6), st.integers(0, 50)))
    return draw(arrays(float, shape, elements=LENGTHS)), draw(arrays(bool, shape))


@given(searches(), st.integers(1, 5))
def test_first_visible_equals_brute_force(search, count):
    lengths, visible = search
    before = lengths.copy()
    ways, shortest = first_visible(lengths, lambda point, way: visible[point, way], count)
    assert ways.shape == shortest.shape == (len(lengths), count)
    for row, seen, found, length in zip(lengths, visible, ways, shortest, strict=True):
        seen &= ~np.isnan(row)
        expected = np.sort(row[seen])[:count]
        number = len(expected)
        assert seen[found[:number]].all() and len(set(found[:number])) == number
        np.testing.assert_array_equal(length[:number], expected)
        np.testing.assert_array_equal(row[found[:number]], expected)
        assert (found[number:] == -1).all() and (length[number:] == np.inf).all()
    np.testing.assert_array_equal(lengths, before)


def test_shortest_ways_are_tested_first_and_once():
    tested = []

    def sees(point, way):
        tested.append(sorted(way.tolist()))
        return way == 12

    way, shortest = first_visible(np.arange(100.0)[None], sees)
    assert (way[0, 0], shortest[0, 0]) == (12, 12.0)
    assert tested == [[0, 1], [*range(2, 10)], [*range(10, 42)]]


@given(st.integers(0, 10_000))
def test_ragged_search_equals_brute_force(seed):
    rng = np.random.default_rng(seed)
    counts = rng.integers(0, 6, 12)
    lengths, visible = rng.integers(0, 9, counts.sum()).astype(float), rng.random(counts.sum()) < 0.4
    lengths[rng.random(len(lengths)) < 0.1] = np.inf
    owner = np.repeat(np.arange(12), counts)

    def sees(point, pair):
        np.testing.assert_array_equal(owner[pair], point)
        return visible[pair]

    pair, shortest = first_visible_ragged(lengths.copy(), counts, sees)
    of_point = (owner == np.arange(12)[:, None]) & visible
    np.testing.assert_array_equal(shortest, np.min(np.where(of_point, lengths, np.inf), axis=1, initial=np.inf))
    found = np.flatnonzero(np.isfinite(shortest))
    assert of_point[found, pair[found]].all() and (lengths[pair[found]] == shortest[found]).all()
