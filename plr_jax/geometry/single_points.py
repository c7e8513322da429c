"""Location and visibility of single points, in plain Python.

A call of NumPy takes about a microsecond, however short the arrays are. So a query of one point is several times
faster in Python floats that are read from the tables of the triangulation and of visibility. The results equal those
of batches: where rounding could matter, the functions for batches decide.
"""

from bisect import bisect_right
from math import inf
from typing import NamedTuple

import numpy as np
from jaxtyping import Shaped

from plr_jax.geometry.corners import CornerVisibility
from plr_jax.geometry.triangulation import Triangulation
from plr_jax.geometry.visibility import VisibilityTable

FEW = 32  # up to so many
_AWAY = 4  # tolerances: a segment farther from all vertices and ends of its triangles is free, or crosses a wall


class Place(NamedTuple):
    """A point rounded to the grid, and the triangle that contains the point and its neighborhood."""

    x: float
    y: float
    triangle: int


class PointLocator:
    """Locates single points in a triangulation, and follows segments through it."""

    def __init__(self, triangulation: Triangulation):
        locator = triangulation.locator
        (self._x0, self._y0), (self._width, self._height) = locator.lo.tolist(), locator.width.tolist()
        self._columns, self._rows = locator.shape
        self._first, self._triangle = _flat(locator.first), _flat(locator.triangle)
        self._lines, self._corners = _flat(locator.lines), _flat(triangulation.triangles)
        self._twin = _flat(triangulation.twin)
        self._grid, self._tolerance = triangulation.grid, triangulation.tolerance

    def place(self, x: float, y: float) -> Place | None:
        """Return the place of a point, or None unless some triangle contains all within ``tolerance`` of it."""
        across, along = (x - self._x0) / self._width, (y - self._y0) / self._height
        if not (0 <= across < self._columns and 0 <= along < self._rows):
            return None
        x, y = self._grid * round(x / self._grid), self._grid * round(y / self._grid)
        cell, lines, tolerance = int(across) * self._rows + int(along), self._lines, self._tolerance
        for triangle in self._triangle[self._first[cell] : self._first[cell + 1]]:
            i = 9 * triangle
            if (
                lines[i] * x + lines[i + 1] * y - lines[i + 2] > tolerance
                and lines[i + 3] * x + lines[i + 4] * y - lines[i + 5] > tolerance
                and lines[i + 6] * x + lines[i + 7] * y - lines[i + 8] > tolerance
            ):
                return Place(x, y, triangle)
        return None

    def is_free_segment(self, start: Place, end: Place) -> bool | None:
        """Return whether a segment is free; None if it passes a vertex within a few tolerances."""
        if start.triangle == end.triangle:
            return True
        corners, x, y, dx, dy = self._corners, start.x, start.y, end.x - start.x, end.y - start.y
        near, half_edge = _AWAY * self._tolerance * (abs(dx) + abs(dy)), 3 * start.triangle
        sides = [dx * (corners[2 * i + 1] - y) - dy * (corners[2 * i] - x) for i in range(half_edge, half_edge + 3)]
        if min(map(abs, sides)) <= near:
            return None
        # The segment leaves a triangle through the half-edge that starts on its right and ends on its left.
        half_edge += next(i for i in range(3) if sides[i] < 0 < sides[i - 2])
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
    """Answers which viewpoints of a table see a single point."""

    def __init__(self, table: VisibilityTable):
        self._table, self._blur, self._tolerance = table, table.blur, table.tolerance
        boundary = table.boundary
        self._points, self._cut, self._normal = _flat(table.points), _flat(table.cut), _flat(boundary.normal)
        self._first, self._key, self._edge = _flat(table.first), _flat(table.key), _flat(table.edge)
        self._offset = _flat(boundary.offset)

    def sees(self, view: int, x: float, y: float) -> bool:
        """Return whether a viewpoint sees a point of free space on the grid; see :meth:`VisibilityTable.sees`."""
        i, keys = 2 * view, self._key
        dx, dy, cx, cy = x - self._points[i], y - self._points[i + 1], self._cut[i], self._cut[i + 1]
        u, v = cx * dx + cy * dy, cx * dy - cy * dx
        length = abs(u) + abs(v)
        slant = u / length if length > 0 else 1.0
        key = 4.0 * view + (1.0 - slant if v >= 0 else 3.0 + slant)
        row = bisect_right(keys, key, self._first[view], self._first[view + 1]) - 1
        edge = self._edge[row]
        height = self._normal[2 * edge] * x + self._normal[2 * edge + 1] * y - self._offset[edge]
        after = keys[row + 1] if row + 1 < len(keys) else inf
        if key - keys[row] <= self._blur or after - key <= self._blur or abs(height) <= self._tolerance:
            return bool(self._table.sees(np.array([view]), np.array([[x, y]]))[0])
        return height > 0 and edge >= 0


class CornerSight(PointSight):
    """Answers at which corners a path from a single point may turn."""

    def __init__(self, visibility: CornerVisibility):
        super().__init__(visibility.table)
        corners = visibility.corners
        self._corners, self._slack = _flat(corners.points), corners.slack
        self._opens, self._closes = map(_flat, corners.walls)

    def may_turn(self, corner: int, place: Place) -> bool:
        """Return whether a corner sees a point, and both its walls lie on one side of the line to the point."""
        i = 2 * corner
        dx, dy = place.x - self._corners[i], place.y - self._corners[i + 1]
        opens = self._opens[i] * dy - self._opens[i + 1] * dx
        closes = self._closes[i] * dy - self._closes[i + 1] * dx
        slack = self._slack
        is_tangent = (opens >= -slack and closes >= -slack) or (opens <= slack and closes <= slack)
        return is_tangent and self.sees(corner, place.x, place.y)


def _flat(values: Shaped[np.ndarray, "..."]) -> memoryview:
    """Return the entries of an array in one row, as a view from which Python reads numbers faster."""
    return memoryview(np.ascontiguousarray(values).reshape(-1))
