"""The corners of polygons whose vertices JAX may trace, and what is in sight among the polygons.

Points that touch a wall, corners among them, are first moved into free space, to a small distance from the wall, the
*margin*. A segment between moved points is free if it crosses no edge. So a segment that grazes a corner may count as
blocked; the path that bends at this corner is equally long.
"""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from plr_jax._compiled import pytree
from plr_jax.traced.corner_paths import Broadcast, Points, length_if_seen

# In machine epsilons of the largest coordinate. In tests of sight, rounding moves segments by up to about 4 epsilons.
_MARGIN = 8  # the margin: twice as much
_WALL = 4  # a point this close to a wall counts as on the wall
_SHARPEST = 1 / 64  # sine of half of a corner's angle: sharper corners would be moved more than 64 margins
_ROUNDS = 4  # a point in a right angle between two walls or bounds is moved away from one after the other, twice
_EDGES = 16  # edges that a compiled loop tests in one pass: with fewer it is slower, with more it compiles longer


@pytree
class PolygonCorners:
    """The corners of polygons, made by :meth:`of_polygons`."""

    vertices: Float[Array, "*maps m k 2"]  # counterclockwise; padding repeats another vertex of its polygon
    offsets: Float[Array, "*maps m k 2"]  # moves each vertex to the margin outside of both of its sides
    is_convex: Bool[Array, "*maps corners"]  # whether paths may bend there: convex, within bounds, in no polygon
    bounds: Float[Array, "*maps 2 2"]  # lower and upper corner
    margin: Float[Array, "*maps"]

    @classmethod
    def of_polygons(cls, polygons: Float[Array, "m k 2"], bounds: Float[Array, "2 2"]) -> "PolygonCorners":
        """Find the corners of polygons, ``(m, k, 2)``, within bounds. Rows of NaN are padding."""
        # 1. Let padding repeat the vertex before it, and let all polygons run counterclockwise.
        k = polygons.shape[1]
        steps = (np.arange(k) - np.arange(k)[:, None]) % k  # from vertex i to vertex j
        is_vertex = ~jnp.isnan(polygons).any(axis=2)
        last = jnp.argmin(jnp.where(is_vertex[:, None], -steps % k, k), axis=2)
        vertices = jnp.take_along_axis(polygons, last[..., None], axis=1)
        vertices = jnp.where(is_vertex.any(axis=1)[:, None, None], vertices, 0)  # 0 in a polygon of padding alone
        spokes = vertices - vertices[:, :1]  # relative to the first vertex, the area of a small polygon is precise
        area = _cross(spokes, jnp.roll(spokes, -1, axis=1)).sum(axis=1)
        vertices = jnp.where(area[:, None, None] < 0, vertices[:, ::-1], vertices)
        # 2. Find the directions of the sides that meet at each vertex, past equal vertices.
        #    previous --- before ---> vertex --- after ---> next
        fixed = lax.stop_gradient(vertices)
        differs = (fixed[:, :, None] != fixed[:, None]).any(axis=3)
        neighbors = [jnp.argmin(jnp.where(differs, each, k), axis=2)[..., None] for each in (-steps % k, steps)]
        before = _unit(fixed - jnp.take_along_axis(fixed, neighbors[0], axis=1))
        after = _unit(jnp.take_along_axis(fixed, neighbors[1], axis=1) - fixed)
        # 3. Move each vertex outward along its bisector: the sum of the sides' normals and, for sharp corners, the
        #    difference of the sides.
        #              after ^   x: moved, at the margin from the lines of both sides
        #     (polygon)      |
        #    --- before ---> o
        #                      x
        normals, turn = _normals(before + after), _cross(before, after)
        sides = jnp.where(turn[..., None] < 0, after - before, before - after)
        eps = jnp.finfo(fixed.dtype).eps
        margin = _MARGIN * eps * jnp.abs(fixed).max()
        offsets = margin * _unit(normals + sides) / jnp.maximum(_length(normals) / 2, _SHARPEST)[..., None]
        # 4. Paths can bend at the first of equal vertices, if they turn left there and paths can get there.
        is_first = differs[:, np.arange(k), np.arange(k) - 1]
        is_convex = (is_first & (turn > -_MARGIN * eps)).ravel()
        corners = cls(vertices, offsets, is_convex, bounds, margin)
        ends = corners._ends()
        return replace(corners, is_convex=is_convex & ~corners._are_inside(ends) & corners._are_in_bounds(ends))

    def __repr__(self) -> str:
        m, k = self.vertices.shape[-3:-1]
        return f"{m} polygons of up to {k} vertices"

    def points(self, dtype: Any) -> Float[Array, "corners 2"]:
        return self.vertices.reshape(-1, 2).astype(dtype)

    def placed(self, x: Points) -> tuple[Points, Bool[Array, " n"]]:
        """Move points near walls away from them; return the points, and whether each given point is free.

        Moved points are at the distance ``margin`` from the wall, in free space if possible.
        """
        x = lax.stop_gradient(x)
        end, distances = lax.scan(self._moved_from_wall, x, jnp.arange(_ROUNDS) == 0)
        # A point on a wall is free if its moved point is: the wall may be a side of two polygons that touch.
        is_blocked = self._are_inside(end)
        is_free = ~jnp.where(distances[0] <= self.margin * (_WALL / _MARGIN), is_blocked, self._are_inside(x))
        return jnp.where(is_blocked[:, None], x, end), is_free & self._are_in_bounds(x)

    def see_each_other(self, a: Broadcast, b: Broadcast) -> Bool[Array, "..."]:
        # A segment from a to b crosses an edge if the edge's ends are on different sides of it, and a and b on
        # different sides of the edge. A vertex on the line of the segment counts as on its right.
        (ax, ay), (bx, by) = _columns(a), _columns(b)
        dx, dy = bx - ax, by - ay

        def is_left(x, y):
            return dx * (y - by) > dy * (x - bx)

        def add_hits(hit, edges):
            for (x0, y0), (x1, y1) in zip(*edges, strict=True):
                a_is_left, b_is_left = ((x1 - x0) * (y - y0) > (y1 - y0) * (x - x0) for x, y in ((ax, ay), (bx, by)))
                hit |= (is_left(x0, y0) != is_left(x1, y1)) & (a_is_left != b_is_left)
            return hit, None

        edges = self._edges(dx.dtype)
        num_passes = -(-len(edges[0]) // _EDGES)
        passes = [jnp.pad(each, ((0, -len(each) % num_passes), (0, 0))).reshape(num_passes, -1, 2) for each in edges]
        return ~lax.scan(add_hits, jnp.zeros(dx.shape, bool), passes)[0]

    def seen_from(self, ends: Points) -> Bool[Array, "n corners"]:
        return self.see_each_other(ends[:, None], self._ends()[None]) & self.is_convex[None]

    def lengths(self, dtype: Any) -> Float[Array, "corners corners"]:
        seen = self.seen_from(self._ends()) & self.is_convex[:, None]
        points = self.points(dtype)
        lengths = length_if_seen(seen, points[:, None], points[None])
        return jnp.where(lengths > 0, lengths, jnp.inf)  # corners of two polygons may be equal

    def _ends(self) -> Float[Array, "corners 2"]:
        return lax.stop_gradient(self.vertices + self.offsets).reshape(-1, 2)

    def _edges(self, dtype: Any) -> tuple[Points, Points]:
        vertices = lax.stop_gradient(self.vertices).astype(dtype)
        return vertices.reshape(-1, 2), jnp.roll(vertices, -1, axis=1).reshape(-1, 2)

    def _are_in_bounds(self, x: Points) -> Bool[Array, " n"]:
        return ((self.bounds[:1] <= x) & (x <= self.bounds[1:])).all(axis=1)

    def _are_inside(self, x: Points) -> Bool[Array, " n"]:
        return self._containing(x).any(axis=0)

    def _containing(self, x: Points) -> Bool[Array, "m n"]:
        # Return which polygons contain each point: a ray to the right crosses an odd number of edges.
        (x0, y0), (x1, y1) = (_columns(each[:, None]) for each in self._edges(x.dtype))  # rows are edges
        x, y = _columns(x[None])
        is_ahead = ((x1 - x0) * (y - y0) > (y1 - y0) * (x - x0)) == (y1 > y0)
        crosses = ((y0 > y) != (y1 > y)) & is_ahead
        return crosses.reshape(*self.vertices.shape[:2], -1).sum(axis=1) % 2 == 1

    def _moved_from_wall(self, x: Points, is_first: Bool[Array, ""]) -> tuple[Points, Float[Array, " n"]]:
        # Move each point that is too close to its nearest wall to the margin outside of it. Return the points, and
        # their distances before the move.
        start, end = self._edges(x.dtype)
        square = _feet(start[:, None], end[:, None], x[None])[1]  # rows are edges
        # After the first round, a point inside polygons leaves these. Padding is no wall.
        k, is_in = self.vertices.shape[1], self._containing(x) & ~is_first
        is_wall = (jnp.repeat(is_in, k, axis=0) | ~is_in.any(axis=0)[None]) & (start != end).any(axis=1)[:, None]
        square = jnp.where(is_wall, square, jnp.inf)
        least = square.min(axis=0)
        index = jnp.arange(len(start), dtype=x.dtype)  # this minimum is eight times as fast as an argmin
        edge = jnp.where(square <= least[None], index[:, None], len(start) - 1).min(axis=0).astype(int)
        foot = _feet(start[edge], end[edge], x)[0]
        moved = foot + self.margin.astype(x.dtype) * _normals(_unit(end - start))[edge]
        # In the first round, a point near an end of the wall moves outside of both walls there. Where polygons touch,
        # it may get into another polygon, which it leaves in the next round.
        for vertex in (edge, edge // k * k + (edge + 1) % k):
            is_near = is_first & (_length(foot - start[vertex]) <= self.margin)
            moved = jnp.where(is_near[:, None], self._ends().astype(x.dtype)[vertex], moved)
        distance = jnp.sqrt(least)
        must_move = distance < jnp.where(is_first, 1, jnp.where(is_in.any(axis=0), 2, 0.5)) * self.margin
        # Stay within the bounds by the margin, too: no segment may pass between a polygon and bounds that it touches.
        lower, upper = self.bounds.astype(x.dtype)[:, None]
        return jnp.clip(jnp.where(must_move[:, None], moved, x), lower + self.margin, upper - self.margin), distance


def _feet(start: Broadcast, end: Broadcast, x: Broadcast) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Return the nearest point of each edge to each point, and the squared distance to it."""
    (ux, uy), (dx, dy) = _columns(end - start), _columns(x - start)
    square = ux * ux + uy * uy
    t = jnp.clip((dx * ux + dy * uy) / jnp.where(square > 0, square, 1), 0, 1)
    foot = start + t[..., None] * (end - start)
    ex, ey = dx - t * ux, dy - t * uy
    return foot, ex * ex + ey * ey


def _columns(points: Float[Array, "*batch 2"]) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
    return points[..., 0], points[..., 1]


def _cross(a: Float[Array, "*batch 2"], b: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _length(vectors: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
    return jnp.sqrt((vectors**2).sum(axis=-1))


def _unit(vectors: Float[Array, "*batch 2"]) -> Float[Array, "*batch 2"]:
    length = _length(vectors)[..., None]
    return vectors / jnp.where(length > 0, length, 1)


def _normals(sides: Float[Array, "*batch 2"]) -> Float[Array, "*batch 2"]:
    """Turn vectors to their right by 90 degrees: outward from sides that run counterclockwise."""
    return jnp.stack([sides[..., 1], -sides[..., 0]], axis=-1)
