"""Which corners are joined, and the distances between corners over them.

Joined are corners between which a shortest path may go straight: they see one another, and the line is tangent to the
obstacles at both. This follows from free space, so an outline tells it of itself, but for what its lattice rounds.
"""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from plr_jax.plr.pairs.outline import Outline

if TYPE_CHECKING:
    from plr_jax.geometry.corners import CornerVisibility
    from plr_jax.geometry.workspace import Workspace

_AT_ONCE = 2**21  # distances


def taut_edges(visibility: "CornerVisibility") -> Int[np.ndarray, "edges 2"]:
    """Pairs of corners that see one another and whose line is tangent at both: what shortest paths are made of."""
    corners, (i, j) = visibility.corners, visibility.edges.T
    return visibility.edges[corners.is_tangent(i, j) & corners.is_tangent(j, i)]


def derived_edges(
    workspace: "Workspace", outline: Outline, corner: Int[np.ndarray, "corners"]
) -> Int[np.ndarray, "edges 2"]:
    """Pairs of corners that are joined in the workspace of an outline, the earlier one first.

    Args:
        workspace: What the outline bounds.
        outline: The outline.
        corner: Which of its points are corners.

    Returns:
        The pairs, in order of the later corner. Corners that the lattice has made to stick out no longer are in none.
    """
    from plr_jax.geometry.corners import corner_visibility  # which a query of a whole file does not need

    visibility = corner_visibility(workspace)
    number = {tuple(point): i for i, point in enumerate(outline.points[corner].tolist())}
    lattice = np.rint((visibility.corners.points - outline.origin) / outline.step).astype(np.int64)
    found = np.array([number.get(tuple(point), -1) for point in lattice.tolist()], np.int64)
    edges = found[taut_edges(visibility)]
    return in_order(edges[(edges >= 0).all(axis=1) & (edges[:, 0] != edges[:, 1])])


def in_order(edges: Int[np.ndarray, "edges 2"]) -> Int[np.ndarray, "distinct 2"]:
    """Pairs, each once, the earlier corner first, in order of the later one."""
    return np.unique(np.sort(edges, axis=1)[:, ::-1], axis=0)[:, ::-1]


def distances_by_rows(
    points: Float[np.ndarray, "n 2"], edges: Int[np.ndarray, "edges 2"]
) -> Iterator[tuple[int, Float[np.ndarray, "rows n"]]]:
    """Shortest distances between points some of which are joined, ``inf`` without a path: first rows, and some."""
    start, end = edges.T
    lengths = np.linalg.norm(points[start] - points[end], axis=1)
    graph = coo_array((lengths, (start, end)), shape=2 * (len(points),)).tocsr()
    step = max(1, _AT_ONCE // max(1, len(points)))
    for begin in range(0, len(points), step):
        rows = np.arange(begin, min(begin + step, len(points)))
        yield begin, dijkstra(graph, directed=False, indices=rows)


def largest_difference(
    points: Float[np.ndarray, "n 2"],
    edges: Int[np.ndarray, "edges 2"],
    others: Float[np.ndarray, "n 2"],
    other_edges: Int[np.ndarray, "others 2"],
) -> float:
    """How far the distances between points are from those between others; ``inf`` if one path has no other."""
    largest = 0.0
    both = zip(distances_by_rows(points, edges), distances_by_rows(others, other_edges), strict=True)
    for (_, one), (_, other) in both:
        with np.errstate(invalid="ignore"):
            largest = max(largest, float(np.where(one == other, 0.0, np.abs(one - other)).max()))
    return largest
