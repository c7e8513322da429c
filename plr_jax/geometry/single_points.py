"""Location and visibility of single points, in plain Python.

A query of one point is ten times faster in Python floats than in NumPy. Where rounding could matter, this module
leaves the answer to the functions for batches. Elsewhere it uses the same arithmetic as these functions, so the
results for a point and for a batch are equal to the bit.
"""

from bisect import bisect_right
from math import inf
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Int, Shaped

from plr_jax.geometry.corners import CornerVisibility
from plr_jax.geometry.triangulation import Triangulation
from plr_jax.geometry.visibility import VisibilityTable

# Largest batch that is answered point by point. On two maps (maze, den520d), 32 points take half as long as a batch.
FEW = 32
# A distance, in tolerances. If a segment is farther than this from all vertices of the triangles that it crosses,
# rounding cannot change which sides it crosses.
_NEAR = 4


class Place(NamedTuple):
    """A point of free space, rounded to the workspace's grid, and the one or two triangles that contain the point."""

    x: float
    y: float
    triangle: int
    beyond: int  # the triangle across a side if the point lies on that side, else `triangle`

    def take(self, first: Int[np.ndarray, " _"], entries: Int[np.ndarray, " _"]) -> Int[np.ndarray, " _"]:
        """Return the entries of the one or two triangles that contain the point, such as corners that see a triangle.

        Triangle ``t`` has the entries ``entries[first[t] : first[t + 1]]``.
        """
        listed = entries[first[self.triangle] : first[self.triangle + 1]]
        if self.beyond == self.triangle:
            return listed
        return np.concatenate([listed, entries[first[self.beyond] : first[self.beyond + 1]]])


class PointLocator:
    """A locator that finds the triangle of one point at a time, without calls of NumPy.

    For batches of points, use :meth:`Triangulation.place`.
    """

    def __init__(self, triangulation: Triangulation):
        locator = triangulation.locator
        (self._x0, self._y0), (self._width, self._height) = locator.lo.tolist(), locator.width.tolist()
        self._columns, self._rows = locator.shape
        self._first, self._triangle, self._lines = map(_flat, (locator.first, locator.triangle, locator.lines))
        self._corners, self._twin = _flat(triangulation.triangles), _flat(triangulation.twin)
        self._grid, self._tolerance = triangulation.grid, triangulation.tolerance

    def place(self, x: float, y: float) -> Place | None:
        """Return the :class:`Place` of the point ``(x, y)``, or None if the function for batches must find it.

        The result is None if the point is outside free space, or so near two sides of a triangle that rounding
        matters.
        """
        # 1. Find the cell of the locator's grid.
        across, along = (x - self._x0) / self._width, (y - self._y0) / self._height
        if not (0 <= across < self._columns and 0 <= along < self._rows):
            return None
        cell = int(across) * self._rows + int(along)
        # 2. Try its triangles. The point is in a triangle if it is clearly inside of all three sides, and near one
        #    side if it is clearly inside of the two others.
        x, y = self._grid * round(x / self._grid), self._grid * round(y / self._grid)
        for triangle in self._triangle[self._first[cell] : self._first[cell + 1]]:
            low, middle, _ = sorted(heights := self._heights(triangle, x, y))
            if low > self._tolerance:
                return Place(x, y, triangle, triangle)
            if abs(low) <= self._tolerance < middle:
                return self._place_near_side(x, y, 3 * triangle + heights.index(low))
        return None

    def _heights(self, triangle: int, x: float, y: float) -> list[float]:
        """Return the signed distances of a point from the lines of a triangle's three sides, positive inside."""
        a, b, c, d, e, f, g, h, i = self._lines[9 * triangle : 9 * triangle + 9]
        return [a * x + b * y - c, d * x + e * y - f, g * x + h * y - i]

    def _place_near_side(self, x: float, y: float, half_edge: int) -> Place | None:
        """Return the place of the point ``(x, y)`` near a half-edge: on its left, on its right, or exactly on it.

        The result is None if the point is outside free space, or also near another side of the triangle across the
        half-edge. ``half_edge`` is an index in the triangulation.
        """
        triangle, twin = half_edge // 3, self._twin[half_edge]
        beyond = twin // 3 if twin >= 0 else triangle
        if twin >= 0 and sorted(self._heights(beyond, x, y))[1] <= self._tolerance:
            return None
        # The cross product is exact: coordinates are multiples of the grid spacing, and Python's integers are exact.
        next_half_edge = half_edge - 2 if half_edge % 3 == 2 else half_edge + 1
        ends = (self._corners[2 * i + axis] for i in (half_edge, next_half_edge) for axis in (0, 1))
        ax, ay, bx, by, px, py = (int(coordinate / self._grid) for coordinate in (*ends, x, y))
        side = (bx - ax) * (py - ay) - (by - ay) * (px - ax)
        if side < 0:
            return Place(x, y, beyond, beyond) if twin >= 0 else None
        return Place(x, y, triangle, beyond if side == 0 else triangle)

    def is_free_segment(self, start: Place, end: Place) -> bool | None:
        """Return whether the segment between two points is free, or None if it passes too near a vertex to tell."""
        if start.triangle == end.triangle:
            return True
        # Let d be the segment's vector. The cross product of d and a corner's offset from the start is positive on
        # the left of the segment, with the size |d| <= |dx| + |dy| times the corner's distance from the line.
        corners, x, y, dx, dy = self._corners, start.x, start.y, end.x - start.x, end.y - start.y
        near = _NEAR * self._tolerance * (abs(dx) + abs(dy))
        # 1. The segment leaves a triangle through the half-edge that starts on its right and ends on its left.
        half_edge = 3 * start.triangle
        sides = [dx * (corners[2 * i + 1] - y) - dy * (corners[2 * i] - x) for i in range(half_edge, half_edge + 3)]
        if min(map(abs, sides)) <= near:
            return None
        half_edge += next(i for i in range(3) if sides[i] < 0 < sides[i - 2])  # corner i - 2 is the next one, i + 1
        # 2. Walk from triangle to triangle, until the half-edge is a wall. If the corner ahead, opposite to the
        #    entry, is on the left, the segment leaves through the half-edge before the corner, else the one after.
        while (entry := self._twin[half_edge]) >= 0:
            triangle, i = divmod(entry, 3)
            if triangle == end.triangle:
                return True
            ahead = 3 * triangle + (i + 2) % 3
            side = dx * (corners[2 * ahead + 1] - y) - dy * (corners[2 * ahead] - x)
            if abs(side) <= near:
                return None
            half_edge = 3 * triangle + (i + 1) % 3 if side > 0 else ahead
        return False


class PointSight:
    """A test whether a viewpoint of a visibility table sees a :class:`Place`, mostly without calls of NumPy.

    Each call tests one viewpoint and one place.
    """

    def __init__(self, table: VisibilityTable):
        boundary = table.boundary
        self._table, self._blur, self._tolerance = table, table.blur, table.tolerance
        self._points, self._cut, self._first = map(_flat, (table.points, table.cut, table.first))
        self._key, self._edge = _flat(table.key), _flat(table.edge)
        self._normal, self._offset = _flat(boundary.normal), _flat(boundary.offset)

    def sees(self, view: int, place: Place) -> bool:
        """Return whether the viewpoint of index ``view`` sees a place, as :meth:`VisibilityTable.sees` does."""
        # 1. Find the key of the direction, 4 view + pseudo_angle(u, v), and its interval in the table.
        i, keys, x, y = 2 * view, self._key, place.x, place.y
        dx, dy, cx, cy = x - self._points[i], y - self._points[i + 1], self._cut[i], self._cut[i + 1]
        u, v = cx * dx + cy * dy, cx * dy - cy * dx
        length = abs(u) + abs(v)
        slant = u / length if length > 0 else 1.0
        key = 4.0 * view + (1.0 - slant if v >= 0 else 3.0 + slant)
        row = bisect_right(keys, key, self._first[view], self._first[view + 1]) - 1
        next_key = keys[row + 1] if row + 1 < len(keys) else inf
        # 2. Test whether the place is in front of the interval's nearest edge. Near the edge or an end of the
        #    interval, where rounding matters, ask the exact test.
        edge = self._edge[row]
        height = self._normal[2 * edge] * x + self._normal[2 * edge + 1] * y - self._offset[edge]
        if key - keys[row] <= self._blur or next_key - key <= self._blur or abs(height) <= self._tolerance:
            return bool(self._table.sees(np.array([view]), np.array([[x, y]]))[0])
        return height > 0 and edge >= 0


class CornerSight(PointSight):
    """A test whether a shortest path from a :class:`Place` can turn at a corner, mostly without calls of NumPy.

    Each call tests one corner and one place.
    """

    def __init__(self, visibility: CornerVisibility):
        super().__init__(visibility.table)
        self._slack = visibility.corners.slack
        self._opens, self._closes = map(_flat, visibility.corners.walls)

    def may_turn(self, corner: int, place: Place) -> bool:
        """Return whether a shortest path from a place may turn at the corner of index ``corner``.

        The path may turn there if the segment from the place to the corner is free, and both walls at the corner lie
        on one side of the line through the segment.
        """
        i, slack = 2 * corner, self._slack
        dx, dy = place.x - self._points[i], place.y - self._points[i + 1]
        opens = self._opens[i] * dy - self._opens[i + 1] * dx
        closes = self._closes[i] * dy - self._closes[i + 1] * dx
        return (min(opens, closes) >= -slack or max(opens, closes) <= slack) and self.sees(corner, place)


def _flat(values: Shaped[np.ndarray, "..."]) -> memoryview:
    # Python reads numbers faster from this view than from an array.
    flat: Any = np.ascontiguousarray(values).reshape(-1)
    return memoryview(flat)
