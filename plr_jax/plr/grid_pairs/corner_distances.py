"""Distances between all corners of a grid: shortest paths over the graph of those that see each other."""

import numpy as np
from jaxtyping import Bool, Float, Shaped
from scipy.sparse import csgraph, csr_array

from plr_jax.plr.grid_pairs.lengths import open_length
from plr_jax.plr.grid_pairs.sectors import corner_cells, seen_by_corners

FAR = {np.dtype(np.uint16): 2**16 - 1, np.dtype(np.int32): 2**30}
"""What stands for no path, by type: no sum of distances that are there reaches it."""

_AT_ONCE = 2**22  # distances held in double precision


def corner_distances(
    free: Bool[np.ndarray, "rows columns"], connectivity: int
) -> Shaped[np.ndarray, "corners_by_corners"]:
    """Distance in units of each corner to those before it and to itself, row by row of a triangle.

    As 16-bit integers if they are all small enough, else 32-bit ones; see :data:`FAR`.
    """
    graph = _graph(free, connectivity)
    corners = np.count_nonzero(corner_cells(free))
    triangle = np.empty(corners * (corners + 1) // 2)
    step = max(_AT_ONCE // max(corners, 1), 1)
    for begin in range(0, corners, step):
        block = np.arange(begin, min(begin + step, corners))
        of_block = csgraph.dijkstra(graph, directed=False, indices=block)
        before = np.arange(corners) <= block[:, None]
        triangle[block[0] * (block[0] + 1) // 2 : (block[-1] + 1) * (block[-1] + 2) // 2] = of_block[before]
    return _as_integers(triangle, 2 * int(open_length(connectivity, *map(np.int64, free.shape))))


def _graph(free: Bool[np.ndarray, "rows columns"], connectivity: int) -> csr_array:
    """Corners, joined if they see each other with no corner between them."""
    places = np.flatnonzero(corner_cells(free))
    corner, cell = seen_by_corners(free, connectivity)
    at = np.minimum(np.searchsorted(places, cell), len(places) - 1)
    is_corner = (places[at] == cell) if len(places) else np.zeros(0, bool)
    a, b = corner[is_corner], at[is_corner]
    (row, column), (other_row, other_column) = (np.divmod(places[ends], free.shape[1]) for ends in (a, b))
    lengths = open_length(connectivity, abs(row - other_row), abs(column - other_column)).astype(float)
    return csr_array((lengths, (a, b)), shape=(len(places), len(places)))


def _as_integers(distances: Float[np.ndarray, "n"], most_beside: int) -> Shaped[np.ndarray, "n"]:
    """Distances as integers, to which at most so much is added in a query."""
    longest = int(distances.max(initial=0, where=np.isfinite(distances))) + most_beside
    fitting = [dtype for dtype, far in FAR.items() if longest < far]
    if not fitting:
        raise ValueError(f"Paths of up to {longest} units are too long; distances of pairs go up to {2**30}.")
    return np.where(np.isfinite(distances), distances, FAR[fitting[0]]).astype(fitting[0])
