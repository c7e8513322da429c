"""Constrained Delaunay triangulation of a region, and exact location of points in its triangles.

GEOS computes the Delaunay triangulation of the vertices, which may lack some walls. Each missing wall is inserted by
removing the triangles that it crosses and filling the two polygons on its sides, in exact integer arithmetic.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import PickledWithoutCaches, index_of, take_ragged
from plr_jax.geometry.boundary import Boundary, Edges, grid_at
from plr_jax.geometry.graph import connected_groups
from plr_jax.geometry.vectors import cross_product, left_normal, orientation

Triangles: TypeAlias = Int[np.ndarray, "triangles 3"]
HalfEdges: TypeAlias = Int[np.ndarray, " half_edges"]
_FEW = 4  # up to so many points, searching all triangles is faster than building a locator
_MOST_STEPS = 100  # limit of the walk from triangle to triangle; one or two steps are usual
_STEPS_INSIDE = 0, 1, 2, 4  # grid spacings by which a point on a wall is moved inside until a triangle contains it
_BITS = 46  # bits of integer coordinates: they resolve the grid to which a workspace rounds
# ``(first, entries)``: the entries of triangle ``t`` are ``entries[first[t] : first[t + 1]]``.
TriangleLists: TypeAlias = tuple[Int[np.ndarray, " triangles_plus_one"], Int[np.ndarray, " entries"]]


class Locator(NamedTuple):
    """A uniform grid for point location: cell ``c`` meets the triangles ``triangle[first[c] : first[c + 1]]``.

    Cells are numbered column by column.
    """

    lo: Float[np.ndarray, "2"]
    width: Float[np.ndarray, "2"]
    shape: tuple[int, int]
    first: Int[np.ndarray, " cells_plus_one"]
    triangle: Int[np.ndarray, " entries"]
    lines: Float[np.ndarray, "triangles 3 3"]  # inward unit normal of each side, and distance of its line from 0

    def find(self, x: Float[np.ndarray, "n 2"]) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Return the index of the triangle that contains each point, and a signed distance.

        The distance is the least of the point's distances from the lines through the three sides of the triangle. It
        is positive inside the triangle, up to rounding. If no triangle contains the point, the result is a nearby
        triangle with a negative distance, or -1 and ``-inf`` if the grid cell of the point meets no triangle.
        """
        column, row = np.clip((x - self.lo) / self.width, 0, np.array(self.shape) - 1).astype(int).T
        cell = column * self.shape[1] + row
        nearest, best_height = np.full(len(x), -1), np.full(len(x), -np.inf)
        # Each pending point tries one triangle of its cell in each round, until one contains the point.
        pending, entry, end = np.arange(len(x)), self.first[cell], self.first[cell + 1]
        while len(pending):
            has_more = entry < end
            pending, entry, end = pending[has_more], entry[has_more], end[has_more]
            triangle = self.triangle[entry]
            normal_x, normal_y, offset = np.moveaxis(self.lines[triangle], 2, 0)
            height = (normal_x * x[pending, :1] + normal_y * x[pending, 1:] - offset).min(axis=1)
            is_better = height > best_height[pending]
            rows = pending[is_better]
            nearest[rows], best_height[rows] = triangle[is_better], height[is_better]
            is_outside = height < 0
            pending, entry, end = pending[is_outside], entry[is_outside] + 1, end[is_outside]
        return nearest, best_height


@dataclass(frozen=True, eq=False)
class LocatedPoints:
    """Points of a region with the triangles that contain them."""

    x: Float[np.ndarray, "n 2"]  # rounded to the grid
    triangle: Int[np.ndarray, " n"]  # that contains each point
    on_side: Bool[np.ndarray, "n 3"]  # whether the point lies on each side of its triangle

    def __getitem__(self, rows: Int[np.ndarray, " some"] | Bool[np.ndarray, " n"] | slice) -> "LocatedPoints":
        return LocatedPoints(self.x[rows], self.triangle[rows], self.on_side[rows])


@dataclass(frozen=True, eq=False)
class Triangulation(PickledWithoutCaches):
    """A triangulation of a region: half-edges ``3 t`` to ``3 t + 2`` bound triangle ``t``, counterclockwise."""

    boundary: Boundary
    tolerance: float  # points count as inside up to this distance from the region
    origin: HalfEdges  # the vertex at which each half-edge starts
    twin: HalfEdges  # the opposite half-edge in the adjacent triangle, -1 at walls
    wall: HalfEdges  # the edge of the boundary along each half-edge, -1 inside the region

    @cached_property
    def of_wall(self) -> Int[np.ndarray, " edges"]:
        """Index of the half-edge along each edge of the boundary."""
        half_edges = np.empty(len(self.boundary.edges), np.int32)
        is_wall = np.flatnonzero(self.wall >= 0)
        half_edges[self.wall[is_wall]] = is_wall
        return half_edges

    @cached_property
    def locator(self) -> Locator:
        """A grid to locate points, with about as many cells as there are triangles."""
        # 1. Divide the bounding box into nearly square cells.
        triangles = self.triangles
        lo, hi = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
        side = np.sqrt(np.prod(hi - lo) / len(triangles))
        count = np.maximum(1, np.minimum((hi - lo) / side, 4 * len(triangles)).astype(int))
        width = (hi - lo) / count
        # 2. Find the triangles that meet each cell, grown by the tolerance.
        corner = lo + width * np.stack(np.meshgrid(*map(np.arange, count), indexing="ij"), axis=-1).reshape(-1, 2)
        cells: Any = shapely.box(*(corner - self.tolerance).T, *(corner + width + self.tolerance).T)
        cell, triangle = shapely.STRtree(np.asarray(shapely.polygons(triangles))).query(cells, predicate="intersects")
        order = np.argsort(cell, kind="stable")
        first = np.searchsorted(cell[order], np.arange(len(cells) + 1))
        # 3. Find the line n . x = d of each side, with the inward normal n.
        normal = left_normal(np.roll(triangles, -1, axis=1) - triangles)
        lines = np.concatenate([normal, (normal * triangles).sum(axis=2, keepdims=True)], axis=2)
        return Locator(lo, width, (int(count[0]), int(count[1])), first, triangle[order].astype(np.int32), lines)

    @cached_property
    def grid(self) -> float:
        """Spacing of the grid to which vertices and located points are rounded."""
        return grid_at(self.tolerance)

    def on_grid(self, x: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        return self.grid * np.rint(x / self.grid)

    def locate(
        self, x: Float[np.ndarray, "n 2"], triangle: Int[np.ndarray, " n"] | None = None
    ) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
        """Return the index of the triangle that contains each point, and on which side of the three edges it lies.

        The side is 1 if the point is inside an edge of the triangle, 0 on the line through the edge, and -1 outside.
        A point outside the region gets a nearby triangle, and -1 for one edge or more. Coordinates must be multiples
        of ``grid``. The search begins at the triangles ``triangle``; if None, this method chooses where to begin.
        """
        # 1. Choose the triangles at which walks begin. Points far inside a triangle of the locator need no walk.
        turn = np.ones((len(x), 3))
        pending = np.arange(len(x))
        if triangle is not None:
            triangle = triangle.copy()
        elif len(x) > _FEW or "locator" in self.__dict__:
            triangle, height = self.locator.find(x)
            pending = np.flatnonzero(height <= self.tolerance)
        else:
            sides = np.roll(self.triangles, -1, axis=1) - self.triangles
            triangle = np.array([cross_product(sides, q - self.triangles).min(axis=1).argmax() for q in x], int)
        # 2. Walk through a side that has the point on its other side and is not a wall, until there is none.
        for _ in range(_MOST_STEPS):
            corners = self.triangles[triangle[pending]]
            sides = np.roll(corners, -1, axis=1) - corners
            away = x[pending, None] - corners
            turn[pending] = np.sign(orientation(sides[..., 0], sides[..., 1], away[..., 0], away[..., 1]))
            twin = self.twin.reshape(-1, 3)[triangle[pending]]
            side = np.where(twin >= 0, turn[pending], 0).argmin(axis=1)
            twin = twin[np.arange(len(pending)), side]
            is_walking = (turn[pending, side] < 0) & (twin >= 0)
            pending, twin = pending[is_walking], twin[is_walking]
            if not len(pending):
                break
            triangle[pending] = twin // 3
        return triangle, turn

    def place(self, x: Float[np.ndarray, "n 2"]) -> "LocatedPoints":
        """Round points to ``grid`` and locate them.

        A point outside the region moves to the nearest wall, or a few grid steps inside it. A point within the
        tolerance of a vertex where the region touches itself moves to this vertex.
        """
        boundary = self.boundary
        placed = self.on_grid(x)
        triangle, turn = self.locate(placed)
        # 1. Points outside move to the nearest place on the nearest wall, or to a grid point just inside of it, since
        #    the wall has few grid points. If no triangle contains any of these, the point is on all sides of one.
        if len(outside := np.flatnonzero((turn < 0).any(axis=1))):
            _, edge, foot = boundary.feet(x[outside])
            beside = self.of_wall[edge] // 3
            placed[outside], triangle[outside], turn[outside] = self.on_grid(foot), beside, 0.0
            pending = np.arange(len(outside))
            for steps in _STEPS_INSIDE:
                candidate = self.on_grid(foot[pending] + steps * self.grid * boundary.normal[edge[pending]])
                of_candidate, turns = self.locate(candidate, beside[pending])
                is_in = (turns >= 0).all(axis=1)
                rows = outside[pending[is_in]]
                placed[rows], triangle[rows], turn[rows] = candidate[is_in], of_candidate[is_in], turns[is_in]
                pending = pending[~is_in]
        # 2. Points near a vertex where the region touches itself move there, and are on all sides of their triangle.
        if len(boundary.contacts):
            away = np.linalg.norm(self.triangles[triangle] - x[:, None], axis=2)
            away[~np.isin(self.origin.reshape(-1, 3)[triangle], boundary.contacts)] = np.inf
            near = np.flatnonzero(away.min(axis=1) <= self.tolerance)
            placed[near], turn[near] = self.triangles[triangle[near], away[near].argmin(axis=1)], 0.0
        return LocatedPoints(placed, triangle, turn == 0)

    def are_joined(self, a: LocatedPoints, b: LocatedPoints, within: float, squeeze: bool) -> Bool[np.ndarray, " n"]:
        """Return whether a free path joins each point of ``a`` to the point of ``b`` in the same row.

        The path must stay at most ``within`` away from the straight segment. It may pass through *contacts*, points
        where the region touches itself. Without ``squeeze``, it may pass only contacts at an end of the segment.
        """
        # Breadth-first search of triangles, for all segments at once: state pair * num + triangle. The neighbors of a
        # level lie in this level, the one before, or the next one, so only two levels are remembered.
        num = len(self.triangles)
        segments: Any = shapely.linestrings(np.stack([a.x, b.x], axis=1))
        # 1. List the half-edges that start at contact c: around[first[c] : first[c + 1]].
        contacts = index_of(self.boundary.contacts, self.origin)
        around = np.argsort(contacts, kind="stable")
        first = np.searchsorted(contacts[around], np.arange(len(self.boundary.contacts) + 1))
        joined = np.zeros(len(a.x), bool)
        before, level = np.zeros(0, np.int64), np.arange(len(a.x)) * np.int64(num) + a.triangle
        while len(level):
            # 2. Drop the segments whose end is reached.
            pair, triangle = np.divmod(level, num)
            joined[pair[triangle == b.triangle[pair]]] = True
            pair, triangle = pair[~joined[pair]], triangle[~joined[pair]]
            # 3. Go on through sides near the segment.
            corners = self.triangles[triangle]
            sides: Any = shapely.linestrings(np.stack([corners, np.roll(corners, -1, axis=1)], axis=2))
            twin, contact = (table.reshape(-1, 3)[triangle] for table in (self.twin, contacts))
            row, side = np.nonzero((twin >= 0) & shapely.dwithin(segments[pair, None], sides, within))
            onward = pair[row] * np.int64(num) + twin[row, side] // 3
            # 4. Go on to all triangles around contacts near the segment.
            if len(self.boundary.contacts):
                is_end = (corners == a.x[pair, None]).all(axis=2) | (corners == b.x[pair, None]).all(axis=2)
                row, corner = np.nonzero((contact >= 0) & (squeeze | is_end))
                points: Any = shapely.points(corners[row, corner])
                is_near = shapely.dwithin(segments[pair[row]], points, within)
                row, corner = row[is_near], corner[is_near]
                entry, index = take_ragged(first, contact[row, corner])
                onward = np.append(onward, pair[row[index]] * np.int64(num) + around[entry] // 3)
            before, level = level, np.setdiff1d(onward, np.concatenate([before, level]))
        return joined

    @cached_property
    def triangles(self) -> Float[np.ndarray, "triangles 3 2"]:
        return self.boundary.vertices[self.origin].reshape(-1, 3, 2)


def next_half_edge(half_edge: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """Return the next half-edge, counterclockwise, of the same triangle."""
    return half_edge + np.where(half_edge % 3 == 2, -2, 1).astype(half_edge.dtype)


def previous_half_edge(half_edge: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    return half_edge + np.where(half_edge % 3 == 0, 2, -1).astype(half_edge.dtype)


def triangulation_of(boundary: Boundary, tolerance: float) -> Triangulation:
    """Return the constrained Delaunay triangulation of the region with the given boundary.

    ``ValueError`` if edges of the boundary cross. Points up to ``tolerance`` outside the region will count as inside.
    """
    # Anglada, "An improved incremental algorithm for constructing restricted Delaunay triangulations" (1997).
    # 1. Add four vertices far outside, so that every vertex of the region is surrounded by triangles.
    lo, hi = boundary.vertices.min(axis=0), boundary.vertices.max(axis=0)
    (x0, y0), (x1, y1) = lo - (hi - lo).max(), hi + (hi - lo).max()
    vertices = np.concatenate([boundary.vertices, [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]])
    # 2. Compute the Delaunay triangulation of the vertices, with counterclockwise triangles.
    triangles = shapely.delaunay_triangles(shapely.multipoints(vertices))
    corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]
    is_clockwise = cross_product(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) < 0
    corners[is_clockwise] = corners[is_clockwise, ::-1]
    # 3. Find the indices of the triangles' vertices by coordinates: complex numbers are ordered by x, then y.
    triangles = index_of(vertices @ [1, 1j], (corners @ [1, 1j]).ravel()).reshape(-1, 3)
    # 4. Insert the missing walls one by one, in integer arithmetic.
    if len(missing := _missing_edges(triangles, boundary.edges, len(vertices))):
        offset = vertices - vertices.min(axis=0)
        unit = np.exp2(np.ceil(np.log2(offset.max())) - _BITS)
        mesh = _Mesh([(x, y) for x, y in np.rint(offset / unit).astype(np.int64).tolist()], triangles)
        for start, end in missing.tolist():
            if (start, end) not in mesh.apex:
                mesh.insert(start, end)
        triangles = np.array([(u, v, w) for (u, v), w in mesh.apex.items() if u < v and u < w])
        if len(_missing_edges(triangles, boundary.edges, len(vertices))):
            raise ValueError("Walls must not cross one another, but some do.")
    # 5. Keep the triangles in the region.
    return Triangulation(boundary, tolerance, *_free_side(boundary.edges, triangles, len(vertices)))


def _edge_keys(edges: Int[np.ndarray, "n 2"], num_vertices: int) -> Int[np.ndarray, " n"]:
    return edges[:, 0].astype(np.int64) * num_vertices + edges[:, 1]


def _half_edges(triangles: Triangles) -> Int[np.ndarray, "half_edges 2"]:
    return np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2)


def _missing_edges(triangles: Triangles, edges: Edges, num_vertices: int) -> Int[np.ndarray, "missing 2"]:
    return edges[index_of(_edge_keys(_half_edges(triangles), num_vertices), _edge_keys(edges, num_vertices)) < 0]


class _Mesh:
    """An editable triangulation: a map from each directed edge to the third vertex of the triangle on its left."""

    def __init__(self, points: list[tuple[int, int]], triangles: Triangles):
        self.points = points
        u, v, w = triangles.T.tolist()
        self.apex = dict(zip(zip(u + v + w, v + w + u, strict=True), w + u + v, strict=True))
        self.neighbor = dict(self.apex.keys())  # for each vertex, the end of an edge that starts there

    def insert(self, start: int, end: int) -> None:
        """Insert an edge between two vertices, given by index, and remove all edges that cross it, even walls."""
        #          left --- ahead        The new edge crosses the edge from left to right. If the vertex ahead lies on
        #         /    \   /    \        its left, as here, the next crossed edge leads from ahead to right, else from
        #    start - - -\-/- - - end     left to ahead.
        #         \     /
        #          right
        # 1. Find the triangle at the start through whose opposite edge the new edge leaves.
        right = self.neighbor[start]
        left = self.apex[start, right]
        while not (self._turn(start, right, end) >= 0 and self._turn(start, end, left) > 0):
            right, left = left, self.apex[start, left]
        # 2. Remove the crossed triangles and collect their vertices on each side of the edge.
        on_left, on_right = [left], [right]
        self._remove(start, right, left)
        while (ahead := self.apex[on_left[-1], on_right[-1]]) != end:
            self._remove(on_left[-1], on_right[-1], ahead)
            (on_left if self._turn(start, end, ahead) > 0 else on_right).append(ahead)
        self._remove(on_left[-1], on_right[-1], end)
        # 3. Fill the polygons on both sides.
        self._fill(start, end, on_left[::-1])
        self._fill(end, start, on_right)

    def _fill(self, start: int, end: int, chain: list[int]) -> None:
        """Triangulate the polygon with the counterclockwise vertices ``start``, ``end``, ``*chain`` (Delaunay)."""
        #            apex             The apex of the edge's Delaunay triangle is the vertex of the chain whose circle
        #     chain  /  \  chain      through start and end contains no other one. The triangle leaves two smaller
        #    after  /    \  before    polygons, each with one of its edges and a part of the chain.
        #       start -- end
        pending = [(start, end, chain)]
        while pending:
            start, end, chain = pending.pop()
            if not chain:
                continue
            best = 0
            for i in range(1, len(chain)):
                # In-circle test: does the vertex lie inside the circle through start, end and the best one so far?
                # It does if the determinant of the rows (x, y, x^2 + y^2) of these points, relative to it, is > 0.
                x0, y0 = self.points[chain[i]]
                rows = [(x - x0, y - y0) for x, y in (self.points[vertex] for vertex in (start, end, chain[best]))]
                (ax, ay), (bx, by), (cx, cy) = rows
                a2, b2, c2 = (x * x + y * y for x, y in rows)
                if a2 * (bx * cy - by * cx) - b2 * (ax * cy - ay * cx) + c2 * (ax * by - ay * bx) > 0:
                    best = i
            apex = chain[best]
            for a, b, c in ((start, end, apex), (end, apex, start), (apex, start, end)):
                self.apex[a, b] = c
                self.neighbor[a] = b
            pending += [(apex, end, chain[:best]), (start, apex, chain[best + 1 :])]

    def _remove(self, u: int, v: int, w: int) -> None:
        for edge in ((u, v), (v, w), (w, u)):
            del self.apex[edge]

    def _turn(self, a: int, b: int, c: int) -> int:
        # Positive if vertex c lies on the left of the line from a to b.
        (ax, ay), (bx, by), (cx, cy) = self.points[a], self.points[b], self.points[c]
        return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


def _free_side(edges: Edges, triangles: Triangles, num_vertices: int) -> tuple[HalfEdges, HalfEdges, HalfEdges]:
    """Return the half-edges of the triangles in free space, which is on the left of the walls ``edges``.

    The three results are the fields ``origin``, ``twin`` and ``wall`` of :class:`Triangulation`.
    """
    # 1. Find the wall along each half-edge that has the wall's direction, so that free space is on its left.
    half_edges = _half_edges(triangles)
    key, opposite = (_edge_keys(ends, num_vertices) for ends in (half_edges, half_edges[:, ::-1]))
    wall = index_of(_edge_keys(edges, num_vertices), key)
    twin = index_of(key, opposite)
    # 2. Walls divide the triangles into connected parts. A part is free if one of its half-edges has a wall.
    is_blocked = (wall >= 0) | (wall[twin] >= 0) | (twin < 0)
    passage = np.flatnonzero(~is_blocked)
    part = connected_groups(len(triangles), np.stack([passage, twin[passage]]) // 3)
    is_free = np.isin(part, part[np.flatnonzero(wall >= 0) // 3])
    # 3. Number the half-edges of the free triangles.
    rows = np.flatnonzero(np.repeat(is_free, 3))
    twin = np.where(is_blocked, -1, 3 * (np.cumsum(is_free) - 1)[twin // 3] + twin % 3)[rows]
    return triangles.ravel()[rows].astype(np.int32), twin.astype(np.int32), wall[rows].astype(np.int32)
