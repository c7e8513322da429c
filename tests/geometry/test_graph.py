import itertools

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plr_jax.geometry.graph import NO_PARENT, Graph, dijkstra, path_from_root, to_networkx

# A 3-4-5 triangle with a detour, a vertex on top of another, and a vertex on its own.
#
#   3 --- 2
#   |   / |      4 coincides with 2; 5 is alone
#   0 --- 1
SMALL = Graph(
    np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0], [4.0, 3.0], [9.0, 9.0]]),
    np.array([[0, 1], [2, 1], [2, 3], [0, 3], [2, 4]]),
)


@st.composite
def lattice_graphs(draw):
    """Vertices on a small lattice, so that many coincide, and any set of edges."""
    points = draw(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3)), min_size=2, max_size=12))
    ends = st.tuples(st.integers(0, len(points) - 1), st.integers(0, len(points) - 1))
    pairs = draw(st.lists(ends.filter(lambda e: e[0] != e[1]), unique_by=frozenset, max_size=30))
    return Graph(np.array(points, dtype=float), np.array(pairs, dtype=np.int64).reshape(-1, 2))


@given(lattice_graphs())
def test_dijkstra_agrees_with_networkx(graph):
    expected = nx.single_source_dijkstra_path_length(to_networkx(graph), 0)
    distances, parents = dijkstra(graph, 0)
    vertices, edges = range(graph.num_vertices), {frozenset(edge) for edge in graph.edges.tolist()}
    np.testing.assert_allclose(distances, [expected.get(vertex, np.inf) for vertex in vertices], atol=1e-12)
    assert parents[0] == NO_PARENT and (parents[np.isinf(distances)] == NO_PARENT).all()
    for vertex in expected:
        way = path_from_root(parents, vertex)
        assert (way[0], way[-1]) == (0, vertex)
        assert all(frozenset(step) in edges for step in itertools.pairwise(way))
        length = np.linalg.norm(np.diff(graph.vertices[way], axis=0), axis=1).sum()
        assert length == pytest.approx(expected[vertex], abs=1e-12)


def test_counts_positions_and_weights():
    exported = to_networkx(SMALL)
    assert list(exported.nodes) == list(range(6))
    assert exported.nodes[2]["pos"] == (4.0, 3.0)
    assert exported.number_of_edges() == SMALL.num_edges == 5
    assert exported.edges[1, 2]["weight"] == 3.0
    assert SMALL.num_vertices == 6
    assert SMALL.num_bytes == 6 * 2 * 8 + 5 * 2 * 8 + 5 * 8
    lone = Graph(np.zeros((1, 3)), np.zeros((0, 2), dtype=np.int64))
    np.testing.assert_array_equal(dijkstra(lone, 0)[0], [0.0])


@pytest.mark.parametrize(
    ("edges", "message"),
    [
        ([[0, 6]], "vertices 0 to 5"),
        ([[-1, 2]], "vertices 0 to 5"),
        ([[3, 3]], "two different vertices"),
        ([[0, 1], [1, 0]], "listed once"),
        ([[0, 1], [0, 1]], "listed once"),
    ],
)
def test_malformed_edges_are_refused(edges, message):
    with pytest.raises(ValueError, match=message):
        Graph(SMALL.vertices, np.array(edges))
