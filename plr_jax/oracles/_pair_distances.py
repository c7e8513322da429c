"""Exact distances of pairs of points: straight, or by a corner that each of them sees.

A shortest path that is not straight leaves both points for corners at which it turns. So its length is the least,
over the corners that one point sees and those that the other one sees, of two legs and the way between the corners.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Complex, Float, Int
from scipy.sparse import csgraph

from plr_jax._arrays import parts, take_ragged
from plr_jax._types import Distances
from plr_jax.geometry.corners import CornerVisibility, triangles_at, views_by_triangle
from plr_jax.geometry.graph import Graph
from plr_jax.geometry.visibility import triangles_within
from plr_jax.geometry.workspace import Workspace

_CANDIDATES = 1 << 21  # pairs of a point and a corner at a time
_WAYS = 1 << 18  # ways by two corners at a time
_DISTANCES = 1 << 24  # between corners, held at a time; where all are as few, they are kept
_SLACK = 1e-9  # share of a length by which rounding may disturb an order


@dataclass(frozen=True, eq=False)
class _CornerLists:
    """Corners at which paths from each of some points may turn first.

    Args:
        first: First entry of each point, and the number of entries, ``(points + 1,)``.
        corner: Corners, point by point, ``(entries,)``.
        leg: How far each is from its point, ``(entries,)``.
    """

    first: Int[np.ndarray, "points_plus_one"]
    corner: Int[np.ndarray, "entries"]
    leg: Float[np.ndarray, "entries"]

    @cached_property
    def point(self) -> Int[np.ndarray, "entries"]:
        """The point of each entry."""
        return np.repeat(np.arange(len(self.first) - 1), np.diff(self.first))

    def take(self, points: Int[np.ndarray, "some"]) -> "_CornerLists":
        """Those of some of the points, which may be repeated."""
        entry, _ = take_ragged(self.first, points)
        first = np.append(0, np.cumsum(np.diff(self.first)[points]))
        return _CornerLists(first, self.corner[entry], self.leg[entry])

    def filter(self, kept: Bool[np.ndarray, "entries"]) -> "_CornerLists":
        """Those of the entries that are kept."""
        return _CornerLists(np.append(0, np.cumsum(kept))[self.first], self.corner[kept], self.leg[kept])


@dataclass(frozen=True, eq=False)
class PairDistances:
    """Distances between points of a workspace. What is found on the way is kept, but not pickled.

    Args:
        workspace: The workspace.
        visibility: What its corners see.
    """

    workspace: Workspace
    visibility: CornerVisibility

    def __reduce__(self):
        return PairDistances, (self.workspace, self.visibility)

    @cached_property
    def _graph(self) -> Graph:
        return Graph(self.visibility.corners.points, self.visibility.edges)

    @cached_property
    def _distance_cache(self) -> tuple[Bool[np.ndarray, "corners"], Float[np.ndarray, "corners corners"]]:
        """Corners whose distances to all of them are known, where all are to be kept, and these."""
        return np.zeros(len(self._graph.vertices), bool), np.empty(2 * (len(self._graph.vertices),))

    def _corner_distances(self, corners: Int[np.ndarray, "some"]) -> Float[np.ndarray, "some corners"]:
        """Distances from some corners to all of them."""
        if len(self._graph.vertices) > self._at_once:
            return csgraph.dijkstra(self._graph.adjacency, indices=corners)
        is_known, table = self._distance_cache
        missing = corners[~is_known[corners]]
        table[missing] = csgraph.dijkstra(self._graph.adjacency, indices=missing)
        is_known[missing] = True
        return table[corners]

    @property
    def _at_once(self) -> int:
        """Corners to ask for at a time."""
        return max(1, _DISTANCES // max(1, len(self._graph.vertices)))

    @cached_property
    def _regions(self) -> tuple[Int[np.ndarray, "runs_plus_one"], Int[np.ndarray, "entries"]]:
        """The corners at which paths from each triangle may turn first, and in the end, for vertices, all of them."""
        triangulation, corners, views = self.workspace.triangulation, self.visibility.corners, self.visibility.views
        opens, closes = corners.walls
        visits = [triangles_within(triangulation, views, *cone) for cone in ((opens, -closes), (-opens, closes))]
        first, corner = views_by_triangle(triangulation, np.concatenate(visits, axis=1))
        num_corners = len(corners.points)
        return np.append(first, len(corner) + num_corners), np.append(corner, np.arange(num_corners))

    def __call__(self, x: Float[np.ndarray, "n 2"], y: Float[np.ndarray, "n 2"]) -> Distances:
        """Distances of pairs, ``inf`` where there is no path; alike either way round.

        Raises:
            ValueError: If the numbers of points differ.
        """
        if len(x) != len(y):
            raise ValueError(f"x and y must be as many points, got {len(x)} and {len(y)}.")
        swaps = ((x[:, 0] > y[:, 0]) | ((x[:, 0] == y[:, 0]) & (x[:, 1] > y[:, 1])))[:, None]
        x, y = np.where(swaps, y, x), np.where(swaps, x, y)
        distance, seen = np.full(len(x), np.inf), self.workspace.is_visible(x, y)
        distance[seen] = np.linalg.norm(x[seen] - y[seen], axis=1)
        hidden = np.flatnonzero(~seen)
        is_free = self.workspace.is_free_to_tolerance
        hidden = hidden[is_free(x[hidden]) & is_free(y[hidden])]
        hidden = hidden[np.argsort(_as_complex(x[hidden]), kind="stable")]  # those at a time share points and corners
        counts = self._candidates(x[hidden])[0] + self._candidates(y[hidden])[0]
        for part in parts(counts, _CANDIDATES):
            pairs = hidden[part]
            distance[pairs] = self._by_corners(x[pairs], y[pairs])
        return distance

    def _by_corners(self, x: Float[np.ndarray, "n 2"], y: Float[np.ndarray, "n 2"]) -> Distances:
        """Lengths of the shortest ways that turn: a good one first, then all that may be shorter."""
        at_x, at_y = self._lists(x), self._lists(y)
        least_x, least_y = self._lower_bounds(at_x, y), self._lower_bounds(at_y, x)
        promising = least_x == _run_minima(least_x, at_x.first)[at_x.point]
        most = self._shortest(at_x.filter(promising), at_y) * (1 + _SLACK)
        return self._shortest(at_x.filter(least_x <= most[at_x.point]), at_y.filter(least_y <= most[at_y.point]))

    def _lower_bounds(self, lists: _CornerLists, other: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "entries"]:
        """No way by an entry's corner is shorter: it ends straight."""
        to_other = other[lists.point] - self.visibility.corners.points[lists.corner]
        return lists.leg + np.linalg.norm(to_other, axis=1)

    def _shortest(self, at_x: _CornerLists, at_y: _CornerLists) -> Distances:
        """Length of the shortest way of each pair by a corner of either list."""
        corners, row = np.unique(at_x.corner, return_inverse=True)
        length, at_once = np.full(len(at_x.corner), np.inf), self._at_once
        for begin in range(0, len(corners), at_once):
            between = self._corner_distances(corners[begin : begin + at_once])
            of_these = np.flatnonzero((row >= begin) & (row < begin + at_once))
            counts = np.diff(at_y.first)[at_x.point[of_these]]
            for part in parts(counts, _WAYS):
                entries = of_these[part]
                last, way = take_ragged(at_y.first, at_x.point[entries])
                onward = between[row[entries][way] - begin, at_y.corner[last]] + at_y.leg[last]
                first = np.append(0, np.cumsum(counts[part]))
                length[entries] = _run_minima(onward, first)
        return _run_minima(at_x.leg + length, at_x.first)

    def _lists(self, x: Float[np.ndarray, "n 2"]) -> _CornerLists:
        """The corners that each point sees, and that turn a path from it."""
        _, index, number = np.unique(_as_complex(x), return_index=True, return_inverse=True)
        points = x[index]
        (counts, runs), (begins, listed) = self._candidates(points), self._regions
        places = self.workspace.triangulation.place(points)
        point, corner = np.repeat(np.arange(len(points)), counts), listed[take_ragged(begins, runs)[0]]
        kept = self.visibility.corners.is_tangent_to(corner, places.x[point])
        kept[kept] = self.visibility.table.sees(corner[kept], places.x[point[kept]])
        leg = np.linalg.norm(points[point] - self.visibility.corners.points[corner], axis=1)
        return _CornerLists(np.append(0, np.cumsum(counts)), corner, leg).filter(kept).take(number)

    def _candidates(self, x: Float[np.ndarray, "n 2"]) -> tuple[Int[np.ndarray, "n"], Int[np.ndarray, "runs"]]:
        """How many corners see some of the triangles at each point, and the runs that these are, point by point."""
        begins, (held, first, triangle) = (
            self._regions[0],
            triangles_at(self.workspace.triangulation, self.workspace.triangulation.place(x)),
        )
        num_runs, in_triangle = np.ones(len(x), int), np.zeros(len(x), bool)
        num_runs[held], in_triangle[held] = np.diff(first), True
        point = np.repeat(np.arange(len(x)), num_runs)
        runs = np.full(len(point), len(begins) - 2)
        runs[in_triangle[point]] = triangle
        return np.bincount(point, np.diff(begins)[runs], len(x)).astype(int), runs


def _run_minima(
    values: Float[np.ndarray, "entries"], first: Int[np.ndarray, "runs_plus_one"]
) -> Float[np.ndarray, "runs"]:
    """The least of each run, ``inf`` where it is empty."""
    result, some = np.full(len(first) - 1, np.inf), np.diff(first) > 0
    if some.any():
        result[some] = np.minimum.reduceat(values, first[:-1][some])
    return result


def _as_complex(x: Float[np.ndarray, "n 2"]) -> Complex[np.ndarray, "n"]:
    """Points as numbers that are ordered by their first, then by their second coordinate."""
    return x[:, 0] + 1j * x[:, 1]
