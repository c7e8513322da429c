"""Distances between all corners of a grid, by elimination over the graph of those that see each other.

Corners are taken out of the graph one by one, each time one with the fewest neighbors, which are joined by edges as
long as the way over it. Distances of the last ones are known first; from one that was taken out a shortest path to
those that were taken out later leads over one of its neighbors. So each takes a minimum over a few rows of distances,
where a search from it would visit all corners. No row depends on the order of sums, which are whole numbers.

References:
    D. J. Rose, R. E. Tarjan and G. S. Lueker, "Algorithmic aspects of vertex elimination on graphs", SIAM J. Comput.
    5(2), 1976. J. Dibbelt, B. Strasser and D. Wagner, "Customizable contraction hierarchies", ACM JEA 21, 2016.
"""

import heapq
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int, Int32, Integer

from plr_jax.pairs.grid_sectors import corner_cells, corners_in_sight, open_length, units

FAR = 2**30
"""No path, in units: no sum of distances that are there reaches it."""

_NO_PATH = FAR + 2**20  # so that what is a little less is no path either
_MOST_STEPS_FROM_CENTER = {4: 63, 8: 16}  # so that twice as many units fit into 8 bits, or into 16


@dataclass(frozen=True)
class CornerDistances:
    """Distances of corners in units, as those of centers nearby and small differences.

    Attributes:
        center: Number of the center of each corner, which a short path joins to it.
        between_centers: Their distances, at least :data:`FAR` if there is no path.
        differences: How much longer each corner's way to those before it and to itself is than that between their
            centers, row by row of a triangle.
    """

    center: Int[np.ndarray, "corners"]
    between_centers: Int32[np.ndarray, "centers centers"]
    differences: Integer[np.ndarray, "triangle"]


def corner_distances(free: Bool[np.ndarray, "rows columns"], connectivity: int) -> CornerDistances:
    """Distances between all corners of a grid, in row-major order.

    Raises:
        ValueError: If paths are so long that their lengths do not fit into 30 bits.
    """
    order, uppers = _eliminated(_edges(free, connectivity))
    distances = _all_pairs(order, uppers)
    most = FAR - 2 * int(open_length(connectivity, *map(np.int64, free.shape)))  # to which a query adds the rest
    if np.count_nonzero(distances < most) != _num_joined(order, uppers):
        raise ValueError(f"Paths of more than {most} units are too long; distances of pairs go up to {FAR}.")
    radius = _MOST_STEPS_FROM_CENTER[connectivity] * units(connectivity)
    centers, center = _centers(distances, radius)
    between = distances[np.ix_(centers, centers)]
    differences = np.empty(len(center) * (len(center) + 1) // 2, np.int8 if connectivity == 4 else np.int16)
    for corner, row in enumerate(distances):
        begin = corner * (corner + 1) // 2
        expected = between[center[corner], center[: corner + 1]]
        differences[begin : begin + corner + 1] = row[: corner + 1] - expected
    return CornerDistances(center, between, differences)


_Edges = list[dict[int, int]]


def _edges(free: Bool[np.ndarray, "rows columns"], connectivity: int) -> _Edges:
    """Lengths of the edges of each corner, by the other end: those to corners in sight."""
    places = np.flatnonzero(corner_cells(free))
    ends = corners_in_sight(free, connectivity)
    (row, column), (other_row, other_column) = (np.divmod(places[end], free.shape[1]) for end in ends)
    lengths = np.minimum(open_length(connectivity, abs(row - other_row), abs(column - other_column)), FAR)
    edges: _Edges = [{} for _ in places]
    for a, b, length in zip(*(one.tolist() for one in (*ends, lengths)), strict=True):
        edges[a][b] = edges[b][a] = length
    return edges


def _eliminated(edges: _Edges) -> tuple[list[int], _Edges]:
    """An order of elimination, and the neighbors that each corner has when it is taken out."""
    heap = [(len(nearby), corner) for corner, nearby in enumerate(edges)]
    heapq.heapify(heap)
    is_left, order = [True] * len(edges), []
    while heap:
        degree, corner = heapq.heappop(heap)
        nearby = edges[corner]
        if not is_left[corner] or degree != len(nearby):
            continue
        is_left[corner] = False
        order.append(corner)
        for a, to_a in nearby.items():
            of_a = edges[a]
            del of_a[corner]
            for b, to_b in nearby.items():
                if b != a and to_a + to_b < of_a.get(b, FAR):
                    of_a[b] = to_a + to_b
            heapq.heappush(heap, (len(of_a), a))
    return order, edges


def _all_pairs(order: list[int], uppers: _Edges) -> Int32[np.ndarray, "corners corners"]:
    """Distances of all corners, those that were taken out last first."""
    place = np.empty(len(order), np.int64)
    place[order[::-1]] = np.arange(len(order))
    distances = np.full((len(order), len(order)), _NO_PATH, np.int32)
    for known, corner in enumerate(reversed(order)):
        distances[known, known] = 0
        nearby = uppers[corner]
        if nearby:
            lengths = np.fromiter(nearby.values(), np.int32, len(nearby))
            over = distances[place[list(nearby)], :known] + lengths[:, None]
            distances[known, :known] = distances[:known, known] = np.minimum(over.min(axis=0), _NO_PATH)
    return distances[np.ix_(place, place)]


def _num_joined(order: list[int], uppers: _Edges) -> int:
    """How many pairs of corners paths join, of which all are taken out but for one that has no neighbors left."""
    part = np.arange(len(order))
    for corner in reversed(order):
        part[corner] = part[next(iter(uppers[corner]), corner)]
    return int((np.bincount(part, minlength=1) ** 2).sum())


def _centers(
    distances: Int32[np.ndarray, "corners corners"], radius: int
) -> tuple[Int[np.ndarray, "centers"], Int[np.ndarray, "corners"]]:
    """Corners so many that each is near one, and the number of that."""
    center, centers = np.full(len(distances), -1), []
    for corner, row in enumerate(distances):
        if center[corner] < 0:
            center[(center < 0) & (row <= radius)] = len(centers)
            centers.append(corner)
    return np.array(centers, np.int64), center
