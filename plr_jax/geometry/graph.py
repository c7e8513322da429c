"""Shortest paths over sparse geometric graphs: Dijkstra (SciPy), A*, and export to NetworkX."""

import heapq
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import networkx
import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array, csr_array
from scipy.sparse import csgraph as sparse_graphs

NO_PARENT = -9999
"""Parent of the root of a shortest-path tree and of what the tree does not reach (SciPy's sentinel)."""


@dataclass(frozen=True, eq=False)
class Graph:
    """An undirected graph of points joined by straight edges, as long as the points are far apart.

    Args:
        vertices: Position of each vertex.
        edges: The two ends of each edge, as indices of vertices. An edge is listed once, in either
            direction. Ends may coincide: such an edge has length zero and still connects them.

    Raises:
        ValueError: If an end is not a vertex, both ends are one vertex, or an edge is listed twice.
    """

    vertices: Float[np.ndarray, "v dim"]
    edges: Int[np.ndarray, "e 2"]

    def __post_init__(self):
        edges = self.edges
        if edges.size and not (edges.min() >= 0 and edges.max() < self.num_vertices):
            raise ValueError(
                f"Edges must join vertices 0 to {self.num_vertices - 1}, got {edges.min()} to {edges.max()}."
            )
        if np.any(edges[:, 0] == edges[:, 1]):
            raise ValueError("An edge must join two different vertices.")
        # SciPy adds up repeated entries, which would silently lengthen a repeated edge.
        if self.adjacency.nnz != 2 * self.num_edges:
            raise ValueError("Each edge must be listed once, in one of its two directions.")

    @property
    def num_vertices(self) -> int:
        """Number of vertices."""
        return len(self.vertices)

    @property
    def num_edges(self) -> int:
        """Number of undirected edges."""
        return len(self.edges)

    @property
    def num_bytes(self) -> int:
        """Bytes of the vertices, of both ends of every edge and of its length, as arrays."""
        return self.vertices.nbytes + self.edges.nbytes + self.lengths.nbytes

    @cached_property
    def lengths(self) -> Float[np.ndarray, "e"]:
        """Euclidean length of each edge."""
        start, end = self.edges.T
        return np.linalg.norm(self.vertices[end] - self.vertices[start], axis=1)

    @cached_property
    def adjacency(self) -> csr_array:
        """Edge lengths as a symmetric sparse matrix; a stored zero is an edge of length zero."""
        start, end = self.edges.T
        # Both directions go in at once: adding a matrix to its transpose would drop the stored zeros.
        rows, columns = np.concatenate([start, end]), np.concatenate([end, start])
        shape = (self.num_vertices, self.num_vertices)
        return coo_array((np.tile(self.lengths, 2), (rows, columns)), shape=shape).tocsr()


def dijkstra(graph: Graph, source: int) -> tuple[Float[np.ndarray, "v"], Int[np.ndarray, "v"]]:
    """Shortest paths from one vertex to all others.

    Args:
        graph: The graph.
        source: Index of the vertex where all paths begin.

    Returns:
        The length of the shortest path to each vertex, ``inf`` where there is none, and the vertex
        before it on that path, ``NO_PARENT`` for the source and where there is none.
    """
    distances, parents = sparse_graphs.dijkstra(graph.adjacency, indices=source, return_predecessors=True)
    return distances, parents


def astar(graph: Graph, costs: Mapping[int, float], goal: int) -> list[int]:
    """Shortest path to one vertex by A*, straight-line distance to the goal as the heuristic.

    Args:
        graph: The graph.
        costs: Cost of entering the graph at each vertex where a path may begin (for a path from a
            vertex, that vertex at cost 0).
        goal: Index of the vertex where the path ends.

    Returns:
        The vertices of a path of least entry cost plus length, the goal last; empty if there is none.
    """
    indptr, indices, lengths = graph.adjacency.indptr, graph.adjacency.indices, graph.adjacency.data
    cost_to_go = np.linalg.norm(graph.vertices - graph.vertices[goal], axis=1)
    cost_to_come = np.full(graph.num_vertices, np.inf)
    parents = np.full(graph.num_vertices, NO_PARENT)
    for vertex, cost in costs.items():
        cost_to_come[vertex] = cost
    frontier = [(cost_to_come[vertex] + cost_to_go[vertex], vertex) for vertex in costs]
    heapq.heapify(frontier)
    expanded = np.zeros(graph.num_vertices, dtype=bool)
    while frontier:
        _, vertex = heapq.heappop(frontier)
        if vertex == goal:
            return path_from_root(parents, goal)
        if expanded[vertex]:
            continue
        expanded[vertex] = True
        row = slice(indptr[vertex], indptr[vertex + 1])
        costs_through = cost_to_come[vertex] + lengths[row]
        closer = costs_through < cost_to_come[indices[row]]
        neighbors, costs_through = indices[row][closer], costs_through[closer]
        cost_to_come[neighbors], parents[neighbors] = costs_through, vertex
        for entry in zip((costs_through + cost_to_go[neighbors]).tolist(), neighbors.tolist(), strict=True):
            heapq.heappush(frontier, entry)
    return []


def path_from_root(parents: Int[np.ndarray, "v"], vertex: int) -> list[int]:
    """Vertices from the root of a shortest-path tree to one vertex, both included.

    Args:
        parents: The vertex before each vertex, ``NO_PARENT`` at the root.
        vertex: Index of the last vertex.
    """
    path = [vertex]
    while (parent := int(parents[path[-1]])) != NO_PARENT:
        path.append(parent)
    return path[::-1]


def to_networkx(graph: Graph) -> networkx.Graph:
    """The graph in NetworkX, for its algorithms and drawing.

    Returns:
        An undirected graph whose nodes ``0 ... num_vertices - 1`` carry their position as the tuple
        ``pos`` and whose edges carry their length as ``weight``.
    """
    exported = networkx.Graph()
    exported.add_nodes_from((i, {"pos": tuple(pos)}) for i, pos in enumerate(graph.vertices.tolist()))
    ends, lengths = graph.edges.tolist(), graph.lengths.tolist()
    exported.add_weighted_edges_from((a, b, length) for (a, b), length in zip(ends, lengths, strict=True))
    return exported
