"""Constrained Delaunay triangulation of a region, and exact location of points in its triangles.

GEOS computes the Delaunay triangulation of the vertices, which may lack some walls. Each missing wall is inserted by
removing the triangles that it crosses and filling the two polygons on its sides, in exact integer arithmetic.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from plr_jax._arrays import index_of, take_ragged
from plr_jax.geometry.boundary import Boundary, Edges, grid_at
from plr_jax.geometry.vectors import cross_product, left_normal, orientation

Triangles: TypeAlias = Int[np.ndarray, "triangles 3"]
HalfEdges: TypeAlias = Int[np.ndarray, " half_edges"]
_FEW = 4  # up to so many points, searching all triangles is faster than building a locator
_MOST_STEPS = 100  # limit of the walk from triangle to triangle; one or two steps are usual
_STEPS_INSIDE = 0, 1, 2, 4  # grid spacings by which a point on a wall is moved inside until a triangle contains it
_BITS = 46  # bits of integer coordinates: they resolve the grid to which a workspace rounds
# ``(first, entries)``: the entries of triangle ``t`` are ``entries[first[t] : first[t + 1]]``.
TriangleLists: TypeAlias = tuple[Int[np.ndarray, " triangles_plus_one"], Int[np.ndarray, " entries"]]


@dataclass(frozen=True, eq=False)
class Locator:
    """A uniform grid for point location: cell ``c`` meets the triangles ``triangle[first[c] : first[c + 1]]``."""

    lo: Float[np.ndarray, "2"]
    width: Float[np.ndarray, "2"]
    shape: tuple[int, int]
    first: Int[np.ndarray, " cells_plus_one"]
    triangle: Int[np.ndarray, " entries"]
    lines: Float[np.ndarray, "triangles 3 3"]  # inward unit normal of each side, and distance of its line from 0

    def find(self, x: Float[np.ndarray, "n 2"]) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Return each point's triangle, or a nearby one (-1: none), and its signed distance to the nearest side."""
        place = np.clip((x - self.lo) / self.width, 0, np.array(self.shape) - 1).astype(int)
        cell = place[:, 0] * self.shape[1] + place[:, 1]
        nearest, best = np.full(len(x), -1), np.full(len(x), -np.inf)
        pending, entry, end = np.arange(len(x)), self.first[cell], self.first[cell + 1]
        while len(pending):
            more = entry < end
            pending, entry, end = pending[more], entry[more], end[more]
            triangle = self.triangle[entry]
            normal_x, normal_y, offset = np.moveaxis(self.lines[triangle], 2, 0)
            height = (normal_x * x[pending, :1] + normal_y * x[pending, 1:] - offset).min(axis=1)
            better = height > best[pending]
            nearest[pending[better]], best[pending[better]] = triangle[better], height[better]
            outside = height < 0
            pending, entry, end = pending[outside], entry[outside] + 1, end[outside]
        return nearest, best


@dataclass(frozen=True, eq=False)
class LocatedPoints:
    """Points of a region with the triangles that contain them."""

    x: Float[np.ndarray, "n 2"]  # rounded to the grid
    triangle: Int[np.ndarray, " n"]  # that contains each point
    on_side: Bool[np.ndarray, "n 3"]  # whether the point lies on each side of its triangle

    def __getitem__(self, rows: Int[np.ndarray, " some"] | Bool[np.ndarray, " n"] | slice) -> "LocatedPoints":
        return LocatedPoints(self.x[rows], self.triangle[rows], self.on_side[rows])


@dataclass(frozen=True, eq=False)
class Triangulation:
    """A triangulation of a region: half-edges ``3 t`` to ``3 t + 2`` bound triangle ``t``, counterclockwise."""

    boundary: Boundary
    tolerance: float  # points count as inside up to this distance from the region
    origin: HalfEdges  # the vertex at which each half-edge starts
    twin: HalfEdges  # the opposite half-edge in the adjacent triangle, -1 at walls
    wall: HalfEdges  # the edge of the boundary along each half-edge, -1 inside the region

    @cached_property
    def of_wall(self) -> Int[np.ndarray, " edges"]:
        half_edges = np.empty(len(self.boundary.edges), np.int32)
        is_wall = np.flatnonzero(self.wall >= 0)
        half_edges[self.wall[is_wall]] = is_wall
        return half_edges

    @cached_property
    def locator(self) -> Locator:
        """A grid of about as many cells as triangles, with the triangles that each cell meets, to locate points."""
        triangles = self.triangles
        lo, hi = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
        side = np.sqrt(np.prod(hi - lo) / len(triangles))
        count = np.maximum(1, np.minimum((hi - lo) / side, 4 * len(triangles)).astype(int))
        width = (hi - lo) / count
        corner = lo + width * np.stack(np.meshgrid(*map(np.arange, count), indexing="ij"), axis=-1).reshape(-1, 2)
        cells: Any = shapely.box(*(corner - self.tolerance).T, *(corner + width + self.tolerance).T)
        tree = shapely.STRtree(np.asarray(shapely.polygons(triangles)))
        cell, triangle = tree.query(cells, predicate="intersects")
        order = np.argsort(cell, kind="stable")
        first = np.searchsorted(cell[order], np.arange(len(cells) + 1))
        normal = left_normal(np.roll(triangles, -1, axis=1) - triangles)
        offset = (normal * triangles).sum(axis=2, keepdims=True)
        shape = int(count[0]), int(count[1])
        lines = np.concatenate([normal, offset], axis=2)
        return Locator(lo, width, shape, first, triangle[order].astype(np.int32), lines)

    @cached_property
    def grid(self) -> float:
        """Spacing of the grid to which vertices, and points that are to be located, are rounded."""
        return grid_at(self.tolerance)

    def on_grid(self, x: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        return self.grid * np.rint(x / self.grid)

    def locate(
        self, x: Float[np.ndarray, "n 2"], triangle: Int[np.ndarray, " n"] | None = None
    ) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
        """Return each point's triangle and the point's side of its edges (inside: 1); ``triangle``: a first guess."""
        # Points are multiples of ``grid``. A point outside the region gets a nearby triangle, and a sign of -1. Walks
        # through the triangles begin at ``triangle``, if given.
        turn, pending = np.ones((len(x), 3)), np.arange(len(x))
        if triangle is not None:
            triangle = triangle.copy()
        elif len(x) > _FEW or "locator" in self.__dict__:
            triangle, height = self.locator.find(x)
            pending = np.flatnonzero(height <= self.tolerance)
        else:
            sides = np.roll(self.triangles, -1, axis=1) - self.triangles
            triangle = np.array([cross_product(sides, q - self.triangles).min(axis=1).argmax() for q in x], int)
        for _ in range(_MOST_STEPS):
            corners = self.triangles[triangle[pending]]
            sides = np.roll(corners, -1, axis=1) - corners
            away = x[pending, None] - corners
            turn[pending] = np.sign(orientation(sides[..., 0], sides[..., 1], away[..., 0], away[..., 1]))
            # Walk through a side that has the point on its other side and is not a wall.
            twin = self.twin.reshape(-1, 3)[triangle[pending]]
            side = np.where(twin >= 0, turn[pending], 0).argmin(axis=1)
            outside = turn[pending, side] < 0
            outside &= twin[np.arange(len(pending)), side] >= 0
            pending, twin, side = pending[outside], twin[outside], side[outside]
            if not len(pending):
                break
            triangle[pending] = twin[np.arange(len(pending)), side] // 3
        return triangle, turn

    def place(self, x: Float[np.ndarray, "n 2"]) -> "LocatedPoints":
        """Round points to ``grid`` and locate them; points outside the region move onto the nearest wall."""
        boundary = self.boundary
        exact, x = x, self.on_grid(x)
        triangle, turn = self.locate(x)
        outside = np.flatnonzero((turn < 0).any(axis=1))
        if len(outside):
            # Move to the nearest point of the nearest wall, or to a grid point just inside of it.
            _, edge, foot = boundary.feet(exact[outside])
            beside, x[outside] = self.of_wall[edge] // 3, self.on_grid(foot)
            triangle[outside], turn[outside] = beside, 0.0
            pending = np.arange(len(outside))
            for steps in _STEPS_INSIDE:
                place = self.on_grid(foot[pending] + steps * self.grid * boundary.normal[edge[pending]])
                in_triangle, turns = self.locate(place, beside[pending])
                inside = (turns >= 0).all(axis=1)
                now, pending = outside[pending[inside]], pending[~inside]
                x[now], triangle[now], turn[now] = place[inside], in_triangle[inside], turns[inside]
        # Points near a vertex where the region touches itself move there, and are on all sides of their triangle.
        if len(boundary.contacts):
            away = np.linalg.norm(self.triangles[triangle] - exact[:, None], axis=2)
            away[~np.isin(self.origin.reshape(-1, 3)[triangle], boundary.contacts)] = np.inf
            near = np.flatnonzero(away.min(axis=1) <= self.tolerance)
            x[near], turn[near] = self.triangles[triangle[near], away[near].argmin(axis=1)], 0.0
        return LocatedPoints(x, triangle, turn == 0)

    def are_joined(
        self, a: LocatedPoints, b: LocatedPoints, tolerance: float, squeeze: bool
    ) -> Bool[np.ndarray, " n"]:
        """Return whether a free path within ``tolerance`` of the segment from ``a`` to ``b`` joins the two points."""
        # Breadth-first search of triangles, through sides within the tolerance of the segment and around contacts:
        # without ``squeeze``, only around contacts at which the segment begins or ends.
        lines: Any = shapely.linestrings
        num, joined = len(self.triangles), np.zeros(len(a.x), bool)
        segments = lines(np.stack([a.x, b.x], axis=1))
        contacts = index_of(self.boundary.contacts, self.origin)
        around = np.argsort(contacts, kind="stable")  # half-edges that start at contacts, sorted by contact
        first = np.searchsorted(contacts[around], np.arange(len(self.boundary.contacts) + 1))
        before, keys = np.zeros(0, np.int64), np.arange(len(a.x)) * np.int64(num) + a.triangle
        while len(keys):
            pair, triangle = np.divmod(keys, num)
            joined[pair[triangle == b.triangle[pair]]] = True
            pair, triangle = pair[~joined[pair]], triangle[~joined[pair]]
            corners, segment = self.triangles[triangle], segments[pair, None]
            sides = lines(np.stack([corners, np.roll(corners, -1, axis=1)], axis=2))
            twin, contact = (table.reshape(-1, 3)[triangle] for table in (self.twin, contacts))
            row, side = np.nonzero((twin >= 0) & shapely.dwithin(segment, sides, tolerance))
            onward = pair[row] * np.int64(num) + twin[row, side] // 3
            if len(self.boundary.contacts):
                is_end = (corners == a.x[pair, None]).all(axis=2) | (corners == b.x[pair, None]).all(axis=2)
                row, side = np.nonzero((contact >= 0) & (squeeze | is_end))
                points: Any = shapely.points(corners[row, side])
                near = shapely.dwithin(segments[pair[row]], points, tolerance)
                row, side = row[near], side[near]
                half_edge, pair_row = take_ragged(first, contact[row, side])
                onward = np.append(onward, pair[row[pair_row]] * np.int64(num) + around[half_edge] // 3)
            before, keys = keys, np.setdiff1d(onward, np.concatenate([before, keys]))
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
    """Return the constrained Delaunay triangulation of a region; raise ``ValueError`` if its walls cross."""
    # Anglada, "An improved incremental algorithm for constructing restricted Delaunay triangulations" (1997).
    # 1. Add four vertices far outside, so that every vertex of the region is surrounded by triangles.
    lo, hi = boundary.vertices.min(axis=0), boundary.vertices.max(axis=0)
    (x0, y0), (x1, y1) = lo - (hi - lo).max(), hi + (hi - lo).max()
    vertices = np.concatenate([boundary.vertices, [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]])
    # 2. Compute the Delaunay triangulation of the vertices, with counterclockwise triangles.
    triangles = shapely.delaunay_triangles(shapely.multipoints(vertices))
    corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    clockwise = u[:, 0] * v[:, 1] < u[:, 1] * v[:, 0]
    corners[clockwise] = corners[clockwise, ::-1]
    flat, keys = corners @ [1, 1j], vertices @ [1, 1j]  # complex numbers are ordered by x, then y
    order = np.argsort(keys)
    triangles = order[np.searchsorted(keys, flat, sorter=order)]
    crossed = _crossed(triangles, boundary.edges, len(vertices))
    if len(crossed):
        # 3. Insert the missing walls one by one, in integer arithmetic.
        offset = vertices - vertices.min(axis=0)
        unit = np.exp2(np.ceil(np.log2(offset.max())) - _BITS)
        mesh = _Mesh([(x, y) for x, y in np.rint(offset / unit).astype(np.int64).tolist()], triangles)
        for start, end in crossed.tolist():
            if (start, end) not in mesh.apex:
                mesh.insert(start, end)
        triangles = np.array([(u, v, w) for (u, v), w in mesh.apex.items() if u < v and u < w])
        if len(_crossed(triangles, boundary.edges, len(vertices))):
            raise ValueError("Walls must not cross one another, but some do.")
    return Triangulation(boundary, tolerance, *_inside(boundary.edges, triangles, len(vertices)))


def _keys(edges: Int[np.ndarray, "n 2"], num_vertices: int) -> Int[np.ndarray, " n"]:
    return edges[:, 0].astype(np.int64) * num_vertices + edges[:, 1]


def _half_edges(triangles: Triangles) -> Int[np.ndarray, "half_edges 2"]:
    return np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2)


def _crossed(triangles: Triangles, edges: Edges, num_vertices: int) -> Int[np.ndarray, "crossed 2"]:
    keys = _keys(_half_edges(triangles), num_vertices)
    return edges[index_of(keys, _keys(edges, num_vertices)) < 0]


class _Mesh:
    """An editable triangulation: for each directed edge, the third vertex of the triangle on its left."""

    def __init__(self, points: list[tuple[int, int]], triangles: Triangles):
        self.points = points
        u, v, w = triangles.T.tolist()
        self.apex = dict(zip(zip(u + v + w, v + w + u, strict=True), w + u + v, strict=True))
        self.neighbor = dict(self.apex.keys())

    def insert(self, start: int, end: int) -> None:
        # 1. Find the triangle at the start through whose opposite edge the new edge leaves.
        right = self.neighbor[start]
        left = self.apex[start, right]
        while not (self._turn(start, right, end) >= 0 and self._turn(start, end, left) > 0):
            right, left = left, self.apex[start, left]
        # 2. Remove the crossed triangles and collect their vertices on each side of the edge.
        on_left, on_right = [left], [right]
        self._remove(start, right, left)
        while (ahead := self.apex[left, right]) != end:
            self._remove(left, right, ahead)
            if self._turn(start, end, ahead) > 0:
                left = ahead
                on_left.append(ahead)
            else:
                right = ahead
                on_right.append(ahead)
        self._remove(left, right, ahead)
        # 3. Fill the polygons on both sides.
        self._fill(start, end, on_left[::-1])
        self._fill(end, start, on_right)

    def _fill(self, start: int, end: int, chain: list[int]) -> None:
        """Fill the polygon of an edge and a chain of vertices on its left with Delaunay triangles."""
        pending = [(start, end, chain)]
        while pending:
            start, end, chain = pending.pop()
            if not chain:
                continue
            best = 0
            for i in range(1, len(chain)):
                # In-circle test: does the vertex lie inside the circle through start, end and the best one so far?
                dx, dy = self.points[chain[i]]
                rows = [(x - dx, y - dy) for x, y in (self.points[vertex] for vertex in (start, end, chain[best]))]
                (ax, ay), (bx, by), (cx, cy) = rows
                a2, b2, c2 = (x * x + y * y for x, y in rows)
                if a2 * (bx * cy - by * cx) - b2 * (ax * cy - ay * cx) + c2 * (ax * by - ay * bx) > 0:
                    best = i
            apex = chain[best]
            for a, b, c in ((start, end, apex), (end, apex, start), (apex, start, end)):
                self.apex[a, b] = c
                self.neighbor[a] = b
            pending += [(chain[best], end, chain[:best]), (start, chain[best], chain[best + 1 :])]

    def _remove(self, u: int, v: int, w: int) -> None:
        for edge in ((u, v), (v, w), (w, u)):
            del self.apex[edge]

    def _turn(self, a: int, b: int, c: int) -> int:
        (ax, ay), (bx, by), (cx, cy) = self.points[a], self.points[b], self.points[c]
        return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


def _inside(edges: Edges, triangles: Triangles, num_vertices: int) -> tuple[HalfEdges, HalfEdges, HalfEdges]:
    # Keep the triangles on the free side of walls, and number their half-edges. `wall` is set only for half-edges on
    # the free side. So of the parts into which walls divide the triangles, those with such a half-edge are free.
    half_edges = _half_edges(triangles)
    key, opposite = (_keys(ends, num_vertices) for ends in (half_edges, half_edges[:, ::-1]))
    wall, twin = index_of(_keys(edges, num_vertices), key), index_of(key, opposite)
    blocked = (wall >= 0) | (wall[twin] >= 0) | (twin < 0)
    open_, count = np.flatnonzero(~blocked), len(triangles)
    adjacency = coo_array((np.ones(len(open_)), (open_ // 3, twin[open_] // 3)), shape=(count, count))
    _, part = connected_components(adjacency, directed=False)
    is_inside = np.flatnonzero(np.isin(part, part[np.flatnonzero(wall >= 0) // 3]))
    new_index = np.full(count, -1)
    new_index[is_inside] = np.arange(len(is_inside))
    rows = (3 * is_inside[:, None] + np.arange(3)).ravel()
    twin = np.where(blocked, -1, 3 * new_index[twin // 3] + twin % 3)[rows]
    origin = triangles.ravel()[rows]
    return origin.astype(np.int32), twin.astype(np.int32), wall[rows].astype(np.int32)
