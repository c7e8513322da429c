"""Shortest paths over sparse geometric graphs: Dijkstra's algorithm (SciPy), and export to NetworkX."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array, csr_array
from scipy.sparse import csgraph as sparse_graphs

from plr_jax._types import Points

if TYPE_CHECKING:
    import networkx

NO_PARENT = -9999
"""Parent of the root of a shortest-path tree and of what the tree does not reach (SciPy's sentinel)."""


@dataclass(frozen=True, eq=False)
class Graph:
    """An undirected graph of points joined by straight edges, as long as the points are far apart.

    Args:
        vertices: Position of each vertex.
        edges: The two ends of each edge, as indices of vertices. An edge is listed once, in either
            direction. Ends may coincide: such an edge has length zero and still connects them.
        measure: Length of an edge for each pair of ends, where it is not Euclidean.

    Raises:
        ValueError: If an end is not a vertex, both ends are one vertex, or an edge is listed twice.
    """

    vertices: Float[np.ndarray, "v dim"]
    edges: Int[np.ndarray, "e 2"]
    measure: Callable[[Points, Points], Float[np.ndarray, "e"]] | None = None

    def __post_init__(self):
        edges, last = self.edges, len(self.vertices) - 1
        if edges.size and not (edges.min() >= 0 and edges.max() <= last):
            raise ValueError(f"Edges must join vertices 0 to {last}, got {edges.min()} to {edges.max()}.")
        if np.any(edges[:, 0] == edges[:, 1]):
            raise ValueError("An edge must join two different vertices.")
        # SciPy adds up repeated entries, which would silently lengthen a repeated edge.
        if self.adjacency.nnz != 2 * len(edges):
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
        """Length of each edge."""
        start, end = (self.vertices[ends] for ends in self.edges.T)
        return np.linalg.norm(end - start, axis=1) if self.measure is None else self.measure(start, end)

    @cached_property
    def adjacency(self) -> csr_array:
        """Edge lengths as a symmetric sparse matrix; a stored zero is an edge of length zero."""
        start, end = self.edges.T
        # Both directions go in at once: adding a matrix to its transpose would drop the stored zeros.
        rows, columns = np.concatenate([start, end]), np.concatenate([end, start])
        shape = (len(self.vertices), len(self.vertices))
        return coo_array((np.tile(self.lengths, 2), (rows, columns)), shape=shape).tocsr()


def dijkstra(graph: Graph, source: int) -> tuple[Float[np.ndarray, "v"], Int[np.ndarray, "v"]]:
    """Length of the shortest path from one vertex to each, and the vertex before it on that path.

    Where there is none they are ``inf`` and ``NO_PARENT``, which is also the parent of the source.
    """
    distances, parents = sparse_graphs.dijkstra(graph.adjacency, indices=source, return_predecessors=True)
    return distances, parents


def rooted(parents: Int[np.ndarray, "v"]) -> Int[np.ndarray, "v"]:
    """The same parents, but where there is none the vertex itself."""
    return np.where(parents == NO_PARENT, np.arange(len(parents)), parents)


def path_from_root(parents: Int[np.ndarray, "v"], vertex: int) -> list[int]:
    """Vertices from the root of a shortest-path tree, given by its parents, to one vertex, both included."""
    path = [vertex]
    while (parent := int(parents[path[-1]])) != NO_PARENT:
        path.append(parent)
    return path[::-1]


def path_to_root(graph: Graph, parents: Int[np.ndarray, "v"], start: Float[np.ndarray, "dim"], vertex: int) -> Points:
    """The path from a point by way of a vertex to the root of a shortest-path tree, no two points in a row equal."""
    path = np.concatenate([start[None], graph.vertices[path_from_root(parents, vertex)[::-1]]])
    return path[np.append(True, (path[1:] != path[:-1]).any(axis=1))]


def to_networkx(graph: Graph) -> "networkx.Graph":
    """The graph in NetworkX: nodes ``0, 1, ...`` with ``pos``, a tuple, and edges with their length as ``weight``."""
    import networkx  # a tenth of a second, which nothing else needs

    exported = networkx.Graph()
    exported.add_nodes_from((i, {"pos": tuple(pos)}) for i, pos in enumerate(graph.vertices.tolist()))
    ends, lengths = graph.edges.tolist(), graph.lengths.tolist()
    exported.add_weighted_edges_from((a, b, length) for (a, b), length in zip(ends, lengths, strict=True))
    return exported
