"""The polygon itself, and what of its visibility graph is worth storing with it: exact, or as exact as a spanner.

A vertex takes 4 bytes. Nothing more is needed: the visibility graph and the distances between all its corners follow
when the file is loaded, which takes the seconds of building, and are not counted. For a pair, the straight line is
tested, then every corner that ``x`` sees is paired with every one that ``y`` sees.

A spanner keeps some of the visibility graph's edges, so that paths along it are at most so many times longer. Its
edges are counted as the fewest bits that tell so many of all pairs of corners. Greedy ones have few edges [1];
networkx.spanner, which is random [2], keeps all of them for any factor below 3.

[1] I. Althoefer et al., "On sparse spanners of weighted graphs", Discrete & Computational Geometry 1993.
[2] S. Baswana, S. Sen, "A simple and linear time randomized algorithm for computing sparse spanners in weighted
graphs", Random Structures & Algorithms 2007.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import networkx
import numpy as np
from jaxtyping import Array, Float
from scipy.sparse.csgraph import shortest_path

from experiments.summaries._given import Candidates, CornerLists, Given, Points, corner_lists
from plr_jax import Workspace
from plr_jax.geometry.corners import CornerVisibility, corner_visibility
from plr_jax.geometry.graph import Graph, to_networkx

_BYTES_A_VERTEX = 4
_STRETCHES = (1.5, 2.0, 3.0)
_PAIRS_AT_ONCE = 20_000
_PAIRS_A_BATCH = 64  # whose tables of corners fit into the cache


def exact(given: Given) -> Candidates:
    """The polygon with its exact oracle: pairs by lists of corners, and as the package answers them where it does."""
    corners = corner_visibility(given.workspace)
    graph = Graph(corners.corners.points, corners.edges)
    summary = PolygonSummary(given.workspace, corners, _all_pairs(graph), 0, tangent=True)
    yield "lists of corners", summary
    if hasattr(given.exact, "between"):
        yield "VisibilityGraph.between", _Between(summary.num_bytes, given.exact.between)  # type: ignore[reportAttributeAccessIssue]


def spanners(given: Given) -> Candidates:
    """Spanners of each factor and kind: all of them are rows."""
    corners = corner_visibility(given.workspace)
    graph = Graph(corners.corners.points, corners.edges)
    for name, kept in _spanners(graph, given.seed, _STRETCHES[-1:] if given.smoke else _STRETCHES):
        bits = _edge_bits(kept.num_vertices, kept.num_edges)
        summary = PolygonSummary(given.workspace, corners, _all_pairs(kept), -(-bits // 8), tangent=False)
        yield f"{name}, {kept.num_edges:,} of {graph.num_edges:,} edges", summary


@dataclass(frozen=True)
class _Between:
    """The package's own exact distance of pairs."""

    num_bytes: int
    between: Callable[[Points, Points], Float[np.ndarray, "n"]]

    def __call__(self, x: Points, y: Points) -> Float[np.ndarray, "n"]:
        """Distances of pairs."""
        return self.between(x, y)


def _spanners(graph: Graph, seed: int, stretches: tuple[float, ...]) -> Iterator[tuple[str, Graph]]:
    for stretch in stretches:
        yield f"greedy, {stretch:g} times", greedy_spanner(graph, stretch)
    sparse = networkx.spanner(to_networkx(graph), _STRETCHES[-1], weight="weight", seed=seed)
    edges = np.array(sparse.edges, int).reshape(-1, 2)
    yield f"networkx, {_STRETCHES[-1]:g} times", Graph(graph.vertices, edges)


def greedy_spanner(graph: Graph, stretch: float) -> Graph:
    """Edges, the shortest first, whose ends those before do not join by a path at most so many times as long."""
    between = np.full((graph.num_vertices, graph.num_vertices), np.inf)
    np.fill_diagonal(between, 0.0)
    kept = []
    for edge in np.argsort(graph.lengths, kind="stable"):
        (a, b), length = graph.edges[edge], graph.lengths[edge]
        if between[a, b] > stretch * length:
            kept.append(edge)
            by_way_of = np.minimum(between[:, [a]] + between[[b]], between[:, [b]] + between[[a]])
            np.minimum(between, by_way_of + length, out=between)
    return Graph(graph.vertices, graph.edges[np.sort(np.array(kept, int))])


def _all_pairs(graph: Graph) -> Float[np.ndarray, "v v"]:
    return shortest_path(graph.adjacency, method="D", directed=False)


def _edge_bits(num_vertices: int, num_edges: int) -> int:
    """Bits that tell which of all pairs are edges, given how many."""
    return math.ceil(math.log2(math.comb(num_vertices * (num_vertices - 1) // 2, num_edges)))


@dataclass(frozen=True, eq=False)
class PolygonSummary:
    """Distances by way of the corners that two points see.

    Args:
        workspace: The map.
        corners: Its corners, and what they see.
        between: Lengths of paths between any two corners.
        edge_bytes: Bytes of what is stored beside the polygon.
        tangent: Whether a path may turn only at corners that it is tangent to, as shortest ones do.
    """

    workspace: Workspace
    corners: CornerVisibility
    between: Float[np.ndarray, "corners corners"]
    edge_bytes: int
    tangent: bool

    @property
    def num_bytes(self) -> int:
        """Bytes of the polygon's vertices, and of edges where some are stored."""
        return _BYTES_A_VERTEX * len(self.workspace.boundary.vertices) + self.edge_bytes

    def __call__(self, x: Points, y: Points) -> Float[np.ndarray, "n"]:
        """Distances of pairs."""
        distance = np.linalg.norm(x - y, axis=1)
        hidden = np.flatnonzero(~self.workspace.is_visible(x, y))
        for begin in range(0, len(hidden), _PAIRS_AT_ONCE):
            part = hidden[begin : begin + _PAIRS_AT_ONCE]
            distance[part] = _by_way_of_corners(self.between, self._seen(x[part]), self._seen(y[part]))
        return distance

    def _seen(self, x: Points) -> CornerLists:
        return corner_lists(self.corners, x, self.tangent)


def _by_way_of_corners(between: np.ndarray, at_x: CornerLists, at_y: CornerLists) -> Float[np.ndarray, "n"]:
    lists = tuple(jnp.asarray(column) for column in (*at_x, *at_y))
    return np.asarray(_shortest(jnp.asarray(between, jnp.float32), *lists), float)


@partial(jax.jit)
def _shortest(between: Array, i: Array, to_i: Array, j: Array, to_j: Array) -> Float[Array, "n"]:
    def of_pair(pair: tuple[Array, Array, Array, Array]) -> Array:
        i, to_i, j, to_j = pair
        return (to_i[:, None] + between[i[:, None], j] + to_j).min()

    return jax.lax.map(of_pair, (i, to_i, j, to_j), batch_size=_PAIRS_A_BATCH)
