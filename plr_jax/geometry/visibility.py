"""Visibility polygons of many viewpoints, as one sorted table that answers "does v see x?" by bisection.

Around a viewpoint the directions of all vertices cut the full turn into intervals. Within one interval the
same edge is nearest, so a visibility polygon is a sorted list of directions with the nearest edge after each.

To find the nearest edges, each edge is placed over the range of intervals it covers. Edges do not cross, so
those that cover a whole range are ordered by distance all over it, and comparing two of them in the middle of
the range decides which hides the other. A range is the union of two that are powers of two long, as in a
sparse table for range minima; the nearest edge over a long range is then handed down to its two halves, level
by level, to single intervals. All of it is array operations, O(E log E) a viewpoint.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from plr_jax._deadline import require_time
from plr_jax.geometry.boundary import Boundary
from plr_jax.geometry.vectors import cross_product, pseudo_angle

_CHUNK = 1 << 18


@dataclass(frozen=True, eq=False)
class Viewpoints:
    """Points and the sectors they look into.

    Args:
        points: The points, ``(views, 2)``.
        owner: The point of each sector, ``(sectors,)``. A point without sectors looks all around.
        start: The vertex towards which each sector opens, counterclockwise, ``(sectors,)``.
        end: The vertex towards which it closes, ``(sectors,)``.
    """

    points: Float[np.ndarray, "views 2"]
    owner: Int[np.ndarray, "sectors"]
    start: Int[np.ndarray, "sectors"]
    end: Int[np.ndarray, "sectors"]


@dataclass(frozen=True, eq=False)
class VisibilityTable:
    """Visibility polygons of viewpoints.

    Row ``first[v]`` to ``first[v + 1]`` belong to viewpoint ``v``. Directions are measured as a pseudo-angle
    in [0, 4] from ``cut[v]``, a direction in which no vertex lies, so no polygon wraps around.

    Args:
        boundary: The boundary of free space, whose edges the rows name.
        tolerance: How far behind an edge a point still counts as free.
        points: The viewpoints, ``(views, 2)``.
        cut: Unit vector from which the directions of each viewpoint are measured, ``(views, 2)``.
        first: First row of each viewpoint, and the number of rows, ``(views + 1,)``.
        key: ``4 v`` plus the pseudo-angle at which the row's interval starts, ascending, ``(rows,)``.
        edge: The nearest edge in the interval; -1 where the viewpoint does not look, ``(rows,)``.
    """

    boundary: Boundary
    tolerance: float
    points: Float[np.ndarray, "views 2"]
    cut: Float[np.ndarray, "views 2"]
    first: Int[np.ndarray, "views+1"]
    key: Float[np.ndarray, "rows"]
    edge: Int[np.ndarray, "rows"]

    @property
    def num_bytes(self) -> int:
        """Bytes of the table, without the boundary."""
        return sum(a.nbytes for a in (self.points, self.cut, self.first, self.key, self.edge))

    def followed_by(self, other: "VisibilityTable") -> "VisibilityTable":
        """The viewpoints of both, of one workspace, those of the other after these."""
        first = np.concatenate([self.first, self.first[-1] + other.first[1:]])
        key = np.concatenate([self.key, 4.0 * len(self.points) + other.key])
        points, cut = np.concatenate([self.points, other.points]), np.concatenate([self.cut, other.cut])
        edge = np.concatenate([self.edge, other.edge])
        return VisibilityTable(self.boundary, self.tolerance, points, cut, first, key, edge)

    def sees(self, v: Int[np.ndarray, "n"], x: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, "n"]:
        """Whether viewpoint ``v[i]`` sees point ``x[i]`` of free space: the segment is free, to the tolerance.

        A segment that grazes several corners may be reported as not seen; it is seen from the last of them.
        """
        dx, dy = (x - self.points[v]).T
        cx, cy = self.cut[v].T
        key = 4.0 * v + pseudo_angle(cx * dx + cy * dy, cx * dy - cy * dx)
        row = np.minimum(np.searchsorted(self.key, key, side="right"), self.first[v + 1]) - 1
        seen = self._in_front(row, x)
        rest = np.flatnonzero(~seen)
        if rest.size:
            distance = np.hypot(dx[rest], dy[rest])
            seen[rest] = self._seen_beside(v[rest], x[rest], row[rest], key[rest], distance)
        return seen

    def _seen_beside(
        self,
        v: Int[np.ndarray, "n"],
        x: Float[np.ndarray, "n 2"],
        row: Int[np.ndarray, "n"],
        key: Float[np.ndarray, "n"],
        distance: Float[np.ndarray, "n"],
    ) -> Bool[np.ndarray, "n"]:
        """Whether points are the viewpoint itself, or within rounding of a neighboring interval and seen there."""
        tolerance = self.tolerance
        seen = distance <= tolerance
        slack = tolerance / np.maximum(distance, tolerance)
        before, after = np.maximum(row - 1, self.first[v]), np.minimum(row + 1, self.first[v + 1] - 1)
        for neighbor, gap in ((before, key - self.key[row]), (after, self.key[after] - key)):
            near = np.flatnonzero((gap <= slack) & (neighbor != row))
            if near.size:
                seen[near] |= self._seen_in(neighbor[near], v[near], x[near], distance[near])
        return seen

    def _seen_in(
        self,
        row: Int[np.ndarray, "n"],
        v: Int[np.ndarray, "n"],
        x: Float[np.ndarray, "n 2"],
        distance: Float[np.ndarray, "n"],
    ) -> Bool[np.ndarray, "n"]:
        """Whether points beside an interval are in front of its edge, and not on the edge's line beyond its ends."""
        ends = self.boundary.segments[self.edge[row]]
        farthest = np.linalg.norm(ends - self.points[v][:, None], axis=-1).max(axis=1)
        return self._in_front(row, x) & (distance <= farthest + self.tolerance)

    def _in_front(self, row: Int[np.ndarray, "n"], x: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, "n"]:
        edge = self.edge[row]
        normal = self.boundary.normal[edge]
        height = normal[:, 0] * x[:, 0] + normal[:, 1] * x[:, 1] - self.boundary.offset[edge]
        return (height >= -self.tolerance) & (edge >= 0)


def visibility_table(
    boundary: Boundary, tolerance: float, views: Viewpoints, deadline: float = math.inf
) -> VisibilityTable:
    """The visibility polygons of all viewpoints.

    These are points in free space, on walls only exactly at vertices or with their sectors given.

    Raises:
        TimeoutError: If the deadline, on the clock of ``time.perf_counter``, passes first.
    """
    cut = _cuts(boundary, views)
    size = max(1, _CHUNK // len(boundary.vertices))
    starts, edges, counts = [], [], []
    for begin in range(0, len(views.points), size):
        require_time(deadline, f"all viewpoints had looked around: {begin:,} of {len(views.points):,} had")
        chunk = slice(begin, begin + size)
        inside = (views.owner >= begin) & (views.owner < begin + size)
        part = Viewpoints(views.points[chunk], views.owner[inside] - begin, views.start[inside], views.end[inside])
        row, start, edge = _sweep(boundary, tolerance, part, cut[chunk])
        starts.append(4.0 * (row + begin) + start)
        edges.append(edge)
        counts.append(np.bincount(row, minlength=len(part.points)))
    first = np.concatenate([[0], np.cumsum(np.concatenate([np.empty(0, int), *counts]))])
    key, edge = (np.concatenate([np.empty(0), *starts]), np.concatenate([np.empty(0, int), *edges]))
    return VisibilityTable(boundary, tolerance, views.points, cut, first, key, edge.astype(np.int32))


def _cuts(boundary: Boundary, views: Viewpoints) -> Float[np.ndarray, "views 2"]:
    """For each viewpoint a direction between those of the vertices it may see.

    A viewpoint of one sector gets the middle of the rest of the turn, any other the middle of the widest gap.
    """
    vertices = boundary.vertices
    opens = _angle(vertices[views.start] - views.points[views.owner])
    closes = _angle(vertices[views.end] - views.points[views.owner])
    angle = np.zeros(len(views.points))
    angle[views.owner] = closes + (opens - closes) % (2 * np.pi) / 2
    for v in np.flatnonzero(np.bincount(views.owner, minlength=len(angle)) != 1):
        offset = vertices - views.points[v]
        directions = np.sort(_angle(offset[(offset != 0).any(axis=1)]))
        gaps = np.diff(directions, append=directions[0] + 2 * np.pi)
        angle[v] = directions[gaps.argmax()] + gaps.max() / 2
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _angle(u: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n"]:
    return np.arctan2(u[:, 1], u[:, 0])


@dataclass(frozen=True, eq=False)
class _Fan:
    """The intervals around each viewpoint: ``count[v]`` directions, closed by the first one again."""

    offset: Float[np.ndarray, "views vertices 2"]
    unit: Float[np.ndarray, "views vertices+1 2"]
    start: Float[np.ndarray, "views vertices+1"]
    count: Int[np.ndarray, "views"]
    index: Int[np.ndarray, "views vertices"]


def _fan(
    boundary: Boundary, tolerance: float, points: Float[np.ndarray, "views 2"], cut: Float[np.ndarray, "views 2"]
) -> _Fan:
    """The distinct directions of all vertices from each point, and the place of each vertex among them.

    Directions that rounding of the vertices could make equal are one: between them there might be nothing to
    see but a wall edge-on, behind which no tolerance could tell near from far.
    """
    vertices = boundary.vertices
    c, num_vertices = len(points), len(vertices)
    offset = vertices - points[:, None]
    # A viewpoint's own vertex has no direction; its neighbor in the list stands in.
    own = (offset == 0).all(axis=2)
    towards = np.where(own[:, :, None], np.roll(offset, 1, axis=1), offset)
    (dx, dy), (cx, cy) = towards.transpose(2, 0, 1), cut.T[:, :, None]
    angle = pseudo_angle(cx * dx + cy * dy, cx * dy - cy * dx)
    order = np.argsort(angle, axis=1)
    ascending = np.take_along_axis(angle, order, axis=1)
    blur = 0.01 * tolerance / np.linalg.norm(towards, axis=2)
    blur = np.take_along_axis(blur, order, axis=1)
    new = np.ones(angle.shape, dtype=bool)
    new[:, 1:] = np.diff(ascending, axis=1) > np.maximum(blur[:, 1:], blur[:, :-1])
    place = np.cumsum(new, axis=1) - 1
    index = np.empty_like(order)
    np.put_along_axis(index, order, place, axis=1)
    row, column = np.nonzero(new)
    start, unit = np.full((c, num_vertices + 1), np.inf), np.zeros((c, num_vertices + 1, 2))
    start[row, place[row, column]] = ascending[row, column]
    towards = towards[row, order[row, column]]
    unit[row, place[row, column]] = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    count = place[:, -1] + 1
    unit[np.arange(c), count] = unit[:, 0]
    return _Fan(offset, unit, start, count, index)


def _sweep(
    boundary: Boundary, tolerance: float, views: Viewpoints, cut: Float[np.ndarray, "views 2"]
) -> tuple[Int[np.ndarray, "rows"], Float[np.ndarray, "rows"], Int[np.ndarray, "rows"]]:
    """Viewpoint, start and nearest edge of each interval, neighbors with the same edge joined."""
    fan = _fan(boundary, tolerance, views.points, cut)
    nearest = _nearest_edges(boundary, fan)
    nearest[~_looked_into(views, fan)] = -1
    last = np.take_along_axis(nearest, fan.count[:, None] - 1, axis=1)
    edge = np.concatenate([last, nearest], axis=1)
    start = np.concatenate([np.zeros_like(cut[:, :1]), fan.start[:, :-1]], axis=1)
    keep = np.diff(edge, axis=1, prepend=-2) != 0
    keep &= np.isfinite(start)
    return np.nonzero(keep)[0], start[keep], edge[keep]


def _looked_into(views: Viewpoints, fan: _Fan) -> Bool[np.ndarray, "views vertices"]:
    """Which intervals lie in a sector of their viewpoint."""
    begin, end = fan.index[views.owner, views.start], fan.index[views.owner, views.end]
    change = np.zeros(fan.start.shape, dtype=int)
    np.add.at(change, (views.owner, begin), 1)
    np.add.at(change, (views.owner, end), -1)
    np.add.at(change[:, 0], views.owner[begin >= end], 1)
    everywhere = np.bincount(views.owner, minlength=len(change)) == 0
    return (np.cumsum(change, axis=1)[:, :-1] > 0) | everywhere[:, None]


def _nearest_edges(boundary: Boundary, fan: _Fan) -> Int[np.ndarray, "views vertices"]:
    """The nearest edge in each interval, -1 where there is none."""
    row, edge, height, begin, end = _ranges(boundary, fan)
    # The inverse distance to an edge along the unit vector u is nearness @ u.
    nearness = np.append(-boundary.normal[edge] / height[:, None], [[0.0, 0.0]], axis=0)
    width = fan.start.shape[1]
    unit = fan.unit.reshape(-1, 2)
    level = np.frexp(end - begin)[1] - 1
    cell = np.concatenate([row * width + begin, row * width + end - (1 << level)])
    item, level = np.tile(np.arange(len(row)), 2), np.tile(level, 2)
    order = np.argsort((nearness[item] * (unit[cell] + unit[cell + (1 << level)])).sum(axis=1))
    best = np.full((level.max(initial=0) + 1, len(unit)), -1)
    best[level[order], cell[order]] = item[order]  # of several, the last and nearest stays
    for k in range(len(best) - 1, 0, -1):
        half = 1 << (k - 1)
        parent = np.flatnonzero(best[k] >= 0)
        for child in (parent, parent + half):
            middle = unit[child] + unit[child + half]
            old, new = best[k - 1, child], best[k, parent]
            nearer = ((nearness[new] - nearness[old]) * middle).sum(axis=1) > 0
            best[k - 1, child[nearer]] = new[nearer]
    return np.append(edge, -1)[best[0]].reshape(-1, width)[:, :-1]


def _ranges(boundary: Boundary, fan: _Fan) -> tuple[Shaped[np.ndarray, "ranges"], ...]:
    """Viewpoint, edge, height above it, and range of intervals of each edge seen from its free side.

    Heights come from the very offsets that give the directions, so an edge almost in line with the viewpoint
    is seen from its free side exactly if its range runs counterclockwise. Ranges are split at the cut.
    """
    first, last = boundary.edges.T
    turn = cross_product(fan.offset[:, first], fan.offset[:, last])
    row, edge = np.nonzero(turn > 0)
    segments = boundary.segments[edge]
    height = turn[row, edge] / np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
    begin, end = fan.index[row, first[edge]], fan.index[row, last[edge]]
    wraps = np.flatnonzero(begin > end)
    item = np.concatenate([np.arange(len(row)), wraps])
    begin = np.concatenate([begin, np.zeros_like(wraps)])
    end = np.concatenate([np.where(begin[: len(row)] > end, fan.count[row], end), end[wraps]])
    seen = begin < end
    item = item[seen]
    return row[item], edge[item], height[item], begin[seen], end[seen]
