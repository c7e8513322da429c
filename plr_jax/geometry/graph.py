"""Shortest paths: Dijkstra's algorithm over geometric graphs, and the best visible first vertex of a path."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array, csgraph, csr_array

from plr_jax._arrays import path_from_root, slices
from plr_jax._types import Points

if TYPE_CHECKING:
    import networkx

_CHUNK = 1 << 18  # lengths computed at a time
# A visibility test: given indices of points and of candidates for the first vertex of a path, return whether each
# point sees its candidate.
Sees: TypeAlias = Callable[[Int[np.ndarray, " pairs"], Int[np.ndarray, " pairs"]], Bool[np.ndarray, " pairs"]]
# For each point: the first vertex of its shortest visible path (-1: no path), and the path's length (inf: no path).
FirstVisible: TypeAlias = tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"]]
VisiblePaths: TypeAlias = tuple[Int[np.ndarray, "n count"], Float[np.ndarray, "n count"]]  # several for each point


class Arcs(NamedTuple):
    """Directed edges of a graph, with lengths of their own, at least 0. Several arcs may join the same vertices."""

    start: Int[np.ndarray, " a"]
    end: Int[np.ndarray, " a"]
    length: Float[np.ndarray, " a"]


NO_ARCS = Arcs(np.zeros(0, int), np.zeros(0, int), np.zeros(0))


@dataclass(frozen=True, eq=False)
class Graph:
    """A graph with points as vertices, undirected edges that have lengths, and arcs."""

    vertices: Float[np.ndarray, "v dim"]
    edges: Int[np.ndarray, "e 2"]  # each edge once
    measure: Callable[[Points, Points], Float[np.ndarray, " e"]] | None = None  # lengths of edges; None: Euclidean
    arcs: Arcs = NO_ARCS

    @cached_property
    def lengths(self) -> Float[np.ndarray, " e"]:
        start, end = (self.vertices[ends] for ends in self.edges.T)
        return np.linalg.norm(end - start, axis=1) if self.measure is None else self.measure(start, end)

    @property
    def adjacency(self) -> csr_array:
        """The lengths of edges and arcs from rows to columns as a sparse matrix; a stored entry 0 is a length."""
        # Add both directions at once: adding a matrix to its transpose would drop the stored zeros.
        arcs = np.stack([self.arcs.start, self.arcs.end], axis=1)
        ends = np.concatenate([self.edges, self.edges[:, ::-1], arcs], dtype=self.edges.dtype)
        lengths = np.concatenate([self.lengths, self.lengths, self.arcs.length])
        if len(arcs):
            # From one vertex to another, keep the shortest edge or arc: the matrix would add their lengths.
            order = np.argsort(lengths, kind="stable")
            _, shortest = np.unique((ends @ [len(self.vertices), 1])[order], return_index=True)
            ends, lengths = ends[order[shortest]], lengths[order[shortest]]
        return coo_array((lengths, tuple(ends.T)), shape=(len(self.vertices),) * 2).tocsr()

    def to_networkx(self) -> "networkx.Graph":
        """Return the graph as a NetworkX graph.

        Nodes are ``0, 1, ...``, with coordinates in their attribute ``pos``. Edges have their length as ``weight``.
        """
        import networkx  # slow to import, and needed only here

        graph = networkx.Graph()
        graph.add_nodes_from((node, {"pos": tuple(place)}) for node, place in enumerate(self.vertices.tolist()))
        graph.add_weighted_edges_from(zip(*self.edges.T.tolist(), self.lengths.tolist(), strict=True))
        return graph


def dijkstra(
    adjacency: csr_array, source: int | Int[np.ndarray, " sources"]
) -> tuple[Float[np.ndarray, " v"], Int[np.ndarray, " v"]]:
    """Return the distance of each vertex from the nearest source vertex, and its predecessor on the shortest path.

    ``adjacency`` is that of a :class:`Graph`. Without a path the distance is ``inf``. The predecessor of a source,
    and of a vertex without a path, is negative.
    """
    return csgraph.dijkstra(adjacency, indices=source, return_predecessors=True, min_only=True)[:2]


def connected_groups(num_vertices: int, edges: Int[np.ndarray, "2 _"]) -> Int[np.ndarray, " v"]:
    """Return the number, from 0, of each vertex's connected component; a column of ``edges`` joins two vertices."""
    graph = coo_array((np.ones(edges.shape[1]), tuple(edges)), shape=(num_vertices, num_vertices))
    return csgraph.connected_components(graph, directed=False)[1]


def path_to_root(graph: Graph, parents: Int[np.ndarray, " v"], start: Float[np.ndarray, " d"], vertex: int) -> Points:
    """Return the path from ``start`` straight to a vertex, then from each vertex to its parent, until the root.

    ``vertex`` is an index, and so are ``parents``; the root has a negative parent. Repeated points are left out.
    """
    path = np.concatenate([start[None], graph.vertices[path_from_root(parents, vertex)[::-1]]])
    return path[np.append(True, (path[1:] != path[:-1]).any(axis=1))]


def path_ends(onward: Int[np.ndarray, " v"]) -> Int[np.ndarray, " v"]:
    """Return the last vertex of each vertex's path; ``onward`` has the next vertex, the vertex itself at an end."""
    # Pointer doubling: after round k, `onward` is the vertex 2**k steps ahead. Paths must not form circles.
    while not np.array_equal(further := onward[onward], onward):
        onward = further
    return onward


def first_visible(lengths: Float[np.ndarray, "n ways"], sees: Sees, count: int = 1, at_once: int = 2) -> VisiblePaths:
    """Return the first vertices of each point's ``count`` shortest visible paths, and the lengths of these paths.

    The path from point ``i`` through the first vertex ``k`` has the length ``lengths[i, k]``, or NaN if there is no
    such path. The path is visible if ``sees(i, k)``. If a point has fewer than ``count`` visible paths, the remaining
    vertices are -1, and the remaining lengths ``inf``.

    Visibility is tested in rounds. The first round tests the ``max(at_once, count)`` shortest paths of each point.
    Each further round tests ``2 * at_once`` times as many paths as the round before.
    """
    num_ways = lengths.shape[1]
    visible_way, shortest = np.full((len(lengths), count), -1), np.full((len(lengths), count), np.inf)
    # Row `r` of `lengths`, and of all arrays of a round, belongs to point `pending[r]`.
    pending, num_found = np.arange(len(lengths)), np.zeros(len(lengths), int)
    num_tests = max(at_once, count)
    while pending.size and num_ways:
        # 1. Find the shortest paths of each row that were not tested, in ascending order of length, NaN last.
        rows = np.arange(len(lengths))[:, None]
        if num_tests < num_ways:
            way = np.argpartition(lengths, num_tests - 1, axis=1)[:, :num_tests]
            way = way[rows, np.argsort(lengths[rows, way], axis=1)]
        else:
            way = np.argsort(lengths, axis=1)
        length = lengths[rows, way]
        # 2. Test them.
        is_visible = ~np.isnan(length)
        row, column = np.nonzero(is_visible)
        is_visible[row, column] = sees(pending[row], way[row, column])
        # 3. Store each point's first visible paths, up to `count`.
        num_visible = num_found[:, None] + np.cumsum(is_visible, axis=1)  # up to and with each path
        row, column = np.nonzero(is_visible & (num_visible <= count))
        place = pending[row], num_visible[row, column] - 1
        visible_way[place], shortest[place] = way[row, column], length[row, column]
        # 4. Keep the points that need more paths and have some. Indexing copies, so the argument stays as it is.
        needs_more = (num_visible[:, -1] < count) & ~np.isnan(length[:, -1])
        pending, num_found, lengths = pending[needs_more], num_visible[needs_more, -1], lengths[needs_more]
        lengths[np.arange(len(lengths))[:, None], way[needs_more]] = np.nan
        num_tests *= 2 * at_once
    return visible_way, shortest


def first_visible_in_parts(
    lengths: Callable[[slice], Float[np.ndarray, "rows ways"]], n: int, num_ways: int, sees: Sees, count: int = 1
) -> VisiblePaths:
    """Apply :func:`first_visible` to ``n`` points slice by slice, to save memory.

    ``lengths`` maps a slice of points to the lengths of their ``num_ways`` paths.
    """
    visible_way, shortest = np.empty((n, count), int), np.empty((n, count))
    for rows in slices(n, max(1, _CHUNK // max(1, num_ways))):
        found = first_visible(lengths(rows), lambda i, way, rows=rows: sees(rows.start + i, way), count)
        visible_way[rows], shortest[rows] = found
    return visible_way, shortest


def first_visible_ragged(lengths: Float[np.ndarray, " p"], counts: Int[np.ndarray, " n"], sees: Sees) -> FirstVisible:
    """Return, for each point, the index in ``lengths`` of its shortest visible path, and the length of this path.

    If a point has no visible path, the index is -1 and the length ``inf``. ``lengths`` has the lengths of
    ``counts[0]`` paths from the first point, then of ``counts[1]`` paths from the second point, and so on, without
    NaN. ``lengths`` is modified in place. ``sees(i, k)`` tests whether path ``k`` (an index in ``lengths``) of point
    ``i`` is visible.
    """
    visible_pair, shortest = np.full(len(counts), -1), np.full(len(counts), np.inf)
    # `lengths` and `pair` have ``counts[i]`` paths of point ``pending[i]``. The length of a tested path is inf.
    pending, pair = np.flatnonzero(counts), np.arange(len(lengths))
    counts = counts[pending]
    while pending.size:
        # 1. Find the shortest path of each point, the first one if several are equal.
        start = np.cumsum(counts) - counts
        least = np.minimum.reduceat(lengths, start)
        best = np.flatnonzero(lengths == np.repeat(least, counts))
        best = best[np.searchsorted(best, start)]
        # 2. Test and store it.
        is_visible = sees(pending, pair[best])
        place = pending[is_visible]
        visible_pair[place], shortest[place] = pair[best[is_visible]], least[is_visible]
        # 3. Exclude it from the next round, and keep the points that need another path and have one.
        lengths[best] = np.inf
        needs_more = ~is_visible & (np.minimum.reduceat(lengths, start) < np.inf)
        is_kept = np.repeat(needs_more, counts)
        pending, counts, lengths, pair = pending[needs_more], counts[needs_more], lengths[is_kept], pair[is_kept]
    return visible_pair, shortest
