"""Visibility polygons of many viewpoints, as one sorted table that answers "does v see x?" by bisection.

Around a viewpoint the same edge is nearest within an interval of directions, so a visibility polygon is a sorted list
of directions with the nearest edge after each.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from tqdm import tqdm

from plr_jax._deadline import require_time
from plr_jax.geometry.boundary import Boundary
from plr_jax.geometry.vectors import pseudo_angle
from plr_jax.geometry.visibility.expansion import Sights, Viewpoints, look_around
from plr_jax.geometry.visibility.triangulation import Triangulation

_VIEWS = 1 << 12  # that look around between two looks at the clock


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


def joined_tables(tables: Sequence[VisibilityTable]) -> VisibilityTable:
    """The viewpoints of all tables, which are of one workspace and one at least, those of each after the others."""
    views = np.cumsum([0] + [len(table.points) for table in tables])
    rows = np.cumsum([0] + [len(table.key) for table in tables])
    first = [table.first[:-1] + begin for table, begin in zip(tables, rows, strict=False)]
    key = [table.key + 4.0 * begin for table, begin in zip(tables, views, strict=False)]
    points, cut, edge = (
        np.concatenate([getattr(table, name) for table in tables]) for name in ("points", "cut", "edge")
    )
    first = np.append(np.concatenate(first), rows[-1])
    return VisibilityTable(tables[0].boundary, tables[0].tolerance, points, cut, first, np.concatenate(key), edge)


def visibility_of(
    triangulation: Triangulation, views: Viewpoints, deadline: float = math.inf
) -> tuple[VisibilityTable, Int[np.ndarray, "2 pairs"]]:
    """What viewpoints see of the region that is triangulated.

    Returns:
        Their visibility polygons, and viewpoint and vertex of each pair that see one another, some repeatedly.

    Raises:
        TimeoutError: If the deadline, on the clock of ``time.perf_counter``, passes first.
    """
    boundary, num_views = triangulation.boundary, len(views.points)
    cut, counts = np.empty((num_views, 2)), np.zeros(num_views, int)
    keys, edges, seen = [np.empty(0)], [np.empty(0, np.int32)], [np.empty((2, 0), np.int32)]
    with tqdm(desc="visibility", total=num_views, unit=" corners", delay=3, leave=False, disable=None) as progress:
        for begin in range(0, num_views, _VIEWS):
            require_time(deadline, f"all viewpoints had looked around: {begin:,} of {num_views:,} had")
            part = views[begin : begin + _VIEWS]
            sights = look_around(triangulation, part)
            of_part = slice(begin, begin + len(part.points))
            cut[of_part] = _cuts(boundary, part, sights)
            view, key, edge = _intervals(boundary, part, sights, cut[of_part])
            counts[of_part] = np.bincount(view, minlength=len(part.points))
            keys.append(4.0 * begin + key)
            edges.append(edge)
            seen.append(sights.seen + np.array([[begin], [0]], np.int32))
            progress.update(len(part.points))
    first = np.concatenate([[0], np.cumsum(counts)])
    polygons = views.points, cut, first, np.concatenate(keys), np.concatenate(edges)
    return VisibilityTable(boundary, triangulation.tolerance, *polygons), np.concatenate(seen, axis=1)


def _cuts(boundary: Boundary, views: Viewpoints, sights: Sights) -> Float[np.ndarray, "views 2"]:
    """For each viewpoint a direction in which it sees no vertex.

    Of one with sectors the middle between the end of its first one and the start of the next, of any other the middle
    of the widest cone.
    """
    opens, closes = (_angle(towards(boundary)) for towards in (views.opens, views.closes))
    order = np.lexsort((opens, views.owner))
    owner = views.owner[order]
    first = np.searchsorted(owner, np.unique(owner))
    following = np.where(
        np.append(owner[1:], -1) == owner, np.arange(1, len(owner) + 1), np.searchsorted(owner, owner)
    )
    end = closes[order[first]]
    gap = (opens[order[following[first]]] - end) % (2 * np.pi)
    angle = np.empty(len(views.points))
    angle[owner[first]] = end + gap / 2
    for view in np.flatnonzero(views.looks_around):
        directions = np.sort(_angle(sights.right[sights.view == view]))
        gaps = np.diff(directions, append=directions[0] + 2 * np.pi)
        angle[view] = directions[gaps.argmax()] + gaps.max() / 2
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _angle(u: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n"]:
    return np.arctan2(u[:, 1], u[:, 0])


def _intervals(
    boundary: Boundary, views: Viewpoints, sights: Sights, cut: Float[np.ndarray, "views 2"]
) -> tuple[Int[np.ndarray, "rows"], Float[np.ndarray, "rows"], Int[np.ndarray, "rows"]]:
    """Viewpoint, key and edge of each interval in order: of cones, beyond sectors, and from the cut on."""
    view = np.concatenate([sights.view, views.owner])
    (dx, dy), (cx, cy) = np.concatenate([sights.right, views.closes(boundary)]).T, cut[view].T
    key = 4.0 * view + pseudo_angle(cx * dx + cy * dy, cx * dy - cy * dx)
    edge = np.concatenate([sights.wall, np.full(len(views.owner), -1, np.int32)])
    order = np.argsort(key)
    view, key, edge = view[order], key[order], edge[order]
    # From the cut on, it sees what it does at the end of the turn.
    each = np.arange(len(views.points))
    first, last = np.searchsorted(view, each), np.searchsorted(view, each, side="right") - 1
    view, key, edge = (np.insert(a, first, b) for a, b in ((view, each), (key, 4.0 * each), (edge, edge[last])))
    new = np.append(True, (edge[1:] != edge[:-1]) | (view[1:] != view[:-1]))
    return view[new], key[new], edge[new]
