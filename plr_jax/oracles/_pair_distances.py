"""Exact distances between pairs of points in the plane: straight, or through the first and the last turn.

A shortest path from x to y that is not straight turns first at a corner i that x sees, and last at a corner j that y
sees. Its length is the minimum of |x - i| + D(i, j) + |j - y| over such corners, where D(i, j) is the length of the
shortest path between the corners.

Two implementations give the same results, bit for bit: ``PairDistances._distance`` handles a single pair and is fast
for few pairs, ``PairDistances._distances`` handles batches of many pairs.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csgraph, csr_array

from plr_jax._arrays import PickledWithoutCaches, parts, take_ragged
from plr_jax._types import Distances, Points
from plr_jax.geometry.corners import CornerVisibility, corners_by_triangle, triangles_at
from plr_jax.geometry.graph import Graph
from plr_jax.geometry.single_points import FEW, CornerSight, Place, PointLocator
from plr_jax.geometry.workspace import Workspace

Entries = Float[np.ndarray, " entries"]
_CANDIDATES = 1 << 21  # pairs of a point and a corner in memory at a time
_WAYS = 1 << 18  # paths through two corners in memory at a time
_DISTANCES = 1 << 24  # distances between corners in memory at a time, and in the cache
_LANDMARKS = 24  # corners used as landmarks; on the map den520d, fewer and more are slower
_SLACK = 1e-9  # relative rounding error of lengths, with a margin


@dataclass(frozen=True, eq=False)
class _CornerLists:
    """Lists of corners, one for each of several points: the corners at which paths from the point may turn first.

    Each entry also has the distance from the point to the corner.
    """

    first: Int[np.ndarray, " points_plus_one"]  # index of the first entry of each point
    corner: Int[np.ndarray, " entries"]
    distance: Entries

    @cached_property
    def point(self) -> Int[np.ndarray, " entries"]:
        return np.repeat(np.arange(len(self.first) - 1), np.diff(self.first))

    def take(self, points: Int[np.ndarray, " some"]) -> "_CornerLists":
        """Return the lists of the points with the indices ``points``, in this order."""
        entry, _ = take_ragged(self.first, points)
        first = np.append(0, np.cumsum(np.diff(self.first)[points]))
        return _CornerLists(first, self.corner[entry], self.distance[entry])

    def filter(self, mask: Bool[np.ndarray, " entries"]) -> "_CornerLists":
        return _CornerLists(np.append(0, np.cumsum(mask))[self.first], self.corner[mask], self.distance[mask])


@dataclass(frozen=True, eq=False)
class PairDistances(PickledWithoutCaches):
    """Exact distances between any two points of a workspace, with caches that the oracles of all goals share."""

    workspace: Workspace
    visibility: CornerVisibility

    @cached_property
    def locator(self) -> PointLocator:
        return PointLocator(self.workspace.triangulation)

    @cached_property
    def sight(self) -> CornerSight:
        return CornerSight(self.visibility)

    @cached_property
    def _adjacency(self) -> csr_array:
        """The edge lengths of the graph of corners, as a sparse matrix.

        An edge joins two corners that see each other if a shortest path can turn at both.
        """
        corners, edges = self.visibility.corners, self.visibility.edges
        start, end = edges.T
        return Graph(corners.points, edges[corners.is_tangent(start, end) & corners.is_tangent(end, start)]).adjacency

    def _corner_distances(self, corners: list[int]) -> list[Float[np.ndarray, " corners"]]:
        """Return, for each of the given corner indices, an array of path lengths from this corner to all corners."""
        # Rows of up to `_at_once` corners are cached. If the cache is full, a new one replaces it.
        rows = self.__dict__.setdefault("_rows", {})
        if missing := [corner for corner in corners if corner not in rows]:
            if len(rows) + len(missing) > self._at_once:
                rows, missing = {}, corners  # other threads may read the old rows
                self.__dict__["_rows"] = rows
            rows.update(zip(missing, csgraph.dijkstra(self._adjacency, indices=missing), strict=True))
        return [rows[corner] for corner in corners]

    @property
    def _at_once(self) -> int:
        return max(1, _DISTANCES // max(1, len(self.visibility.corners.points)))

    @cached_property
    def _lists_of_triangles(self) -> tuple[Int[np.ndarray, " runs_plus_one"], Int[np.ndarray, " entries"]]:
        """For each triangle of free space, the corners where paths from its points may turn first.

        The value is a pair ``(first, corner)``: triangle ``t`` has the corners ``corner[first[t] : first[t + 1]]``.
        One more list, after the list of the last triangle, holds all corners.
        """
        first, corner = corners_by_triangle(self.visibility, self.workspace.triangulation)
        num_corners = len(self.visibility.corners.points)
        return np.append(first, len(corner) + num_corners), np.append(corner, np.arange(num_corners))

    def __call__(self, x: Points, y: Points) -> Distances:
        """Return the length of the shortest path from ``x[i]`` to ``y[i]`` for each ``i``, ``inf`` without a path.

        If ``x`` and ``y`` are swapped, the result is the same, bit for bit.
        """
        if len(x) != len(y):
            raise ValueError(f"x and y must be equally many points, got {len(x)} and {len(y)}.")
        if len(x) > FEW:
            return self._distances(x, y)
        distance = np.array([self._distance(*pair) for pair in zip(x.tolist(), y.tolist(), strict=True)], float)
        if len(pending := np.flatnonzero(np.isnan(distance))):
            distance[pending] = self._distances(x[pending], y[pending])
        return distance

    def _distances(self, x: Points, y: Points) -> Distances:
        """Return the length of the shortest path from ``x[i]`` to ``y[i]`` for each ``i``, computed in batches."""
        # 1. Sort the points of each pair lexicographically, so that swapped points get the same bits.
        swaps = ((x[:, 0] > y[:, 0]) | ((x[:, 0] == y[:, 0]) & (x[:, 1] > y[:, 1])))[:, None]
        x, y = np.where(swaps, y, x), np.where(swaps, x, y)
        # 2. Pairs that see each other are joined straight.
        is_seen = self.workspace.is_visible(x, y)
        distance = np.full(len(x), np.inf)
        distance[is_seen] = np.linalg.norm(x[is_seen] - y[is_seen], axis=1)
        # 3. Other pairs of free points are joined through corners.
        hidden = np.flatnonzero(~is_seen)
        is_free = self.workspace.is_free_to_tolerance
        hidden = hidden[is_free(x[hidden]) & is_free(y[hidden])]
        hidden = hidden[np.argsort(x[hidden] @ [1, 1j], kind="stable")]  # so that batches share points and corners
        for part in parts(self._candidates(x[hidden])[0] + self._candidates(y[hidden])[0], _CANDIDATES):
            pairs = hidden[part]
            distance[pairs] = self._by_corners(x[pairs], y[pairs])
        return distance

    def _distance(self, x: list[float], y: list[float]) -> float:
        """Return the length of the shortest path between two points, equal in all bits to the result of `_distances`.

        The result is NaN if :class:`PointLocator` finds no triangle for one of the points: then use `_distances`.
        """
        if y < x:
            x, y = y, x
        start, end = self.locator.place(*x), self.locator.place(*y)
        if start is None or end is None:
            return math.nan
        is_visible = self.locator.is_free_segment(start, end)
        if is_visible is None:
            is_visible = self.workspace.is_visible(np.array([x]), np.array([y]))[0]
        dx, dy = x[0] - y[0], x[1] - y[1]
        return math.sqrt(dx * dx + dy * dy) if is_visible else self._around(x, start, y, end)

    def _around(self, x: list[float], start: Place, y: list[float], end: Place) -> float:
        """Return the length of the shortest path between points ``x`` and ``y`` that do not see each other.

        ``start`` and ``end`` are ``x`` and ``y`` with the triangles of free space that contain them.
        """
        (first, to_first), (last, to_last) = self._turns_at(x, start), self._turns_at(y, end)
        if not len(first) or not len(last):
            return math.inf
        # 1. Bound the length of the way through each first corner, by differences of distances to landmarks: Goldberg
        #    and Harrelson, "Computing the shortest path: A* search meets graph theory" (2005).
        #    With the distances L of a landmark, |j - y| + D(i, j) is at least |j - y| + |L(j) - L(i)|, for every j:
        #    at least L(i) - max over j of (L(j) - |j - y|), and at least min over j of (L(j) + |j - y|) - L(i).
        of_first, of_last, legs = self._landmarks[first], self._landmarks[last], to_last[:, None]
        with np.errstate(invalid="ignore"):  # a landmark and both corners may be infinitely far from one another
            nearer, farther = of_first - (of_last - legs).max(axis=0), (of_last + legs).min(axis=0) - of_first
        onward = np.fmax.reduce(np.fmax(nearer, farther), axis=1, initial=0.0)
        lower_bound = to_first + onward - self._rounding
        # 2. Try first corners by ascending bound, until no bound is below the least length. For each, try last
        #    corners by ascending length until a path can turn there. `may_turn` includes a test of visibility.
        shortest, may_turn = math.inf, self.sight.may_turn
        for i in lower_bound.argsort().tolist():
            if lower_bound[i] >= shortest:
                break
            if may_turn(corner := int(first[i]), start):
                onward = self._corner_distances([corner])[0][last] + to_last
                least = next((onward[k] for k in onward.argsort().tolist() if may_turn(int(last[k]), end)), math.inf)
                shortest = min(shortest, float(to_first[i] + least))
        return shortest

    def _turns_at(self, x: list[float], place: Place) -> tuple[Int[np.ndarray, " some"], Float[np.ndarray, " some"]]:
        """Return the indices of corners at which paths from the point ``x`` may turn first, and their distances to x.

        ``place`` has the triangles of free space that contain the point. Some of the corners may not be visible from
        the point.
        """
        corner = place.take(*self._lists_of_triangles)
        dx, dy = (self.visibility.corners.points[corner] - x).T
        return corner, np.sqrt(dx * dx + dy * dy)

    @cached_property
    def _landmarks(self) -> Float[np.ndarray, "corners landmarks"]:
        """Path lengths between all corners and a few *landmarks*: corners that are far from one another."""
        # Farthest-point sampling: the next landmark is the corner that is farthest from the nearest landmark so far.
        num_corners = len(self.visibility.corners.points)
        to_nearest, rows = np.full(num_corners, np.inf), []
        for _ in range(min(num_corners, _LANDMARKS)):
            rows += self._corner_distances([int(to_nearest.argmax())])
            to_nearest = np.minimum(to_nearest, rows[-1])
        return np.stack(rows, axis=1)

    @cached_property
    def _rounding(self) -> float:
        return _SLACK * float(self._landmarks[np.isfinite(self._landmarks)].max())

    def _by_corners(self, x: Points, y: Points) -> Distances:
        """Return the length of the shortest path from each ``x[i]`` to ``y[i]`` that turns at one corner or more."""
        # The shortest path through the corner i of least |x - i| + |i - y| limits which corners must be tried.
        at_x, at_y = self._visible_corners(x), self._visible_corners(y)
        least_x, least_y = self._lower_bounds(at_x, y), self._lower_bounds(at_y, x)
        is_promising = least_x == _run_minima(least_x, at_x.first)[at_x.point]
        most = self._shortest(at_x.filter(is_promising), at_y) * (1 + _SLACK)
        return self._shortest(at_x.filter(least_x <= most[at_x.point]), at_y.filter(least_y <= most[at_y.point]))

    def _lower_bounds(self, lists: _CornerLists, targets: Points) -> Entries:
        # Return, for each entry, the length of the path from its point to its corner, then straight to the target of
        # the point.
        to_other = targets[lists.point] - self.visibility.corners.points[lists.corner]
        return lists.distance + np.linalg.norm(to_other, axis=1)

    def _shortest(self, at_x: _CornerLists, at_y: _CornerLists) -> Distances:
        """Return, for each ``i``, the length of the shortest path from a point x to a point y through listed corners.

        The path must turn first at a corner in list ``i`` of ``at_x``, the corners visible from x, and last at a
        corner in list ``i`` of ``at_y``, the corners visible from y.
        """
        # 1. For each entry of x, minimize `onward`, D(i, j) + |j - y|, over the entries j of the same pair's y: in
        #    batches of corners i, whose rows of D fit into memory, then in batches of combinations.
        corners, row = np.unique(at_x.corner, return_inverse=True)
        length, at_once = np.full(len(at_x.corner), np.inf), self._at_once
        for begin in range(0, len(corners), at_once):
            between = np.stack(self._corner_distances(corners[begin : begin + at_once].tolist()))
            in_batch = np.flatnonzero((row >= begin) & (row < begin + at_once))
            counts = np.diff(at_y.first)[at_x.point[in_batch]]
            for part in parts(counts, _WAYS):
                entries = in_batch[part]
                last, entry = take_ragged(at_y.first, at_x.point[entries])
                onward = between[row[entries][entry] - begin, at_y.corner[last]] + at_y.distance[last]
                length[entries] = _run_minima(onward, np.append(0, np.cumsum(counts[part])))
        # 2. Minimize |x - i| + `length` over the entries i of each x.
        return _run_minima(at_x.distance + length, at_x.first)

    def _visible_corners(self, x: Points) -> _CornerLists:
        """Return, for each point, the corners visible from the point at which a shortest path from it may turn."""
        # Handle equal points once. As complex numbers, points are sorted by their first coordinate, then by the
        # second.
        _, index, inverse = np.unique(x @ [1, 1j], return_index=True, return_inverse=True)
        points = x[index]
        (counts, runs), (begins, listed) = self._candidates(points), self._lists_of_triangles
        places = self.workspace.triangulation.place(points)
        point, corner = np.repeat(np.arange(len(points)), counts), listed[take_ragged(begins, runs)[0]]
        is_kept = self.visibility.corners.is_tangent_to(corner, places.x[point])
        is_kept[is_kept] = self.visibility.table.sees(corner[is_kept], places.x[point[is_kept]])
        distance = np.linalg.norm(points[point] - self.visibility.corners.points[corner], axis=1)
        return _CornerLists(np.append(0, np.cumsum(counts)), corner, distance).filter(is_kept).take(inverse)

    def _candidates(self, x: Points) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " runs"]]:
        """Return the number of corners that may see each point, and the indices of the lists that hold these corners.

        The lists are those of `_lists_of_triangles`. Each point has one list or more; the result has the lists of the
        first point, then of the second point, and so on.
        """
        # A point has the lists of all triangles that contain it. A point that is a vertex of triangles has the last
        # list, which holds all corners.
        mesh, begins = self.workspace.triangulation, self._lists_of_triangles[0]
        first, runs = triangles_at(mesh, mesh.place(x))
        num_before = np.append(0, np.cumsum(np.diff(begins)[runs]))  # corners in the lists before each list
        return np.diff(num_before[first]), runs


def _run_minima(values: Entries, first: Int[np.ndarray, " runs_plus_one"]) -> Float[np.ndarray, " runs"]:
    """Return the minimum of ``values[first[i] : first[i + 1]]`` for each ``i``, ``inf`` if there are no values."""
    # `reduceat` reduces up to the next index, so leaving out empty runs does not change the others.
    minima, has_values = np.full(len(first) - 1, np.inf), np.diff(first) > 0
    if has_values.any():
        minima[has_values] = np.minimum.reduceat(values, first[:-1][has_values])
    return minima
