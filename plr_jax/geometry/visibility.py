r"""Visibility polygons of many viewpoints, computed by triangular expansion and stored in one sorted table.

1. *Triangular expansion* (:func:`_expand`) divides all that a viewpoint v sees into *cones of sight*::

          c          A cone has its apex at the viewpoint, and is bounded by the directions of two vertices (a and b).
         / \         It ends at a side (ab) that is a wall. Else it enters the next triangle, whose opposite corner
        /   \        (c) splits it in two, one for each exit side, unless the corner is outside the cone or on a
       a-----b       bound.
        \   /
          v

2. Within the directions of a cone that ends at a wall, this wall is the nearest boundary edge. :func:`visibility_of`
   sorts these intervals of directions into a :class:`VisibilityTable`.
3. :meth:`VisibilityTable.sees` finds the interval of a point's direction, and tests whether the point is in front of
   its edge. Without a table, :func:`triangles_within` collects the triangles that cones visit.

Cones of many viewpoints advance together. The tests are exact, since vertices and viewpoints lie on a grid.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import concatenated, index_of
from plr_jax._progress import Progress
from plr_jax.geometry.boundary import Boundary, grid_at
from plr_jax.geometry.triangulation import Triangulation, next_half_edge, previous_half_edge
from plr_jax.geometry.vectors import cross_product, orientation, pseudo_angle, turned_left

# Limits of the memory:
_CONES = 1 << 18  # cones that advance at a time
_VIEWS = 1 << 12  # viewpoints processed at a time
# Directions:
_BLUR = 1e-14  # rounding error of a pseudo-angle, which is at most 4, with a margin
_NARROW = 1e-3  # radians: a gap between sectors must be wider to hold a cut, far more than angles round
Vectors: TypeAlias = Float[np.ndarray, "views 2"]
Rays: TypeAlias = Float[np.ndarray, "2 n"]  # directions from viewpoints
Indices: TypeAlias = Int[np.ndarray, " n"]
Numbers: TypeAlias = Float[np.ndarray, " n"]
Points: TypeAlias = Float[np.ndarray, "n 2"]
Seen: TypeAlias = Int[np.ndarray, "2 pairs"]  # pairs (viewpoint, vertex)
Visits: TypeAlias = Int[np.ndarray, "2 visits"]  # pairs (viewpoint, triangle)


@dataclass(frozen=True, eq=False)
class Viewpoints:
    r"""Points that look in all directions or, on walls, only into *sectors*, directions between two walls.

    ::

        closing wall \   free   / opening wall: boundary edges have free space on their left
                      \        /
                       viewpoint
    """

    points: Vectors
    owner: Int[np.ndarray, " sectors"]  # the point to which each sector belongs: where `edge` starts, or inside it
    edge: Int[np.ndarray, " sectors"]  # the boundary edge at the right of each sector

    def __getitem__(self, rows: slice | Int[np.ndarray, " some"]) -> "Viewpoints":
        place = np.full(len(self.points), -1)
        place[rows] = np.arange(len(place[rows]))
        is_kept = place[self.owner] >= 0
        return Viewpoints(self.points[rows], place[self.owner[is_kept]], self.edge[is_kept])

    def append(self, other: "Viewpoints") -> "Viewpoints":
        owner = np.append(self.owner, len(self.points) + other.owner)
        return Viewpoints(np.concatenate([self.points, other.points]), owner, np.append(self.edge, other.edge))

    def split(self) -> "tuple[Viewpoints, Indices]":
        """Replace each viewpoint that has several sectors by copies with one sector each.

        Return the new viewpoints and, for each of them, the index of the viewpoint of which it is a copy.
        """
        order = np.argsort(self.owner, kind="stable")
        of = np.sort(np.append(self.owner, np.setdiff1d(np.arange(len(self.points)), self.owner)))
        return Viewpoints(self.points[of], np.flatnonzero(np.isin(of, self.owner)), self.edge[order]), of

    def joins(self, view: Indices, other: "Viewpoints", of_other: Indices) -> Bool[np.ndarray, " pairs"]:
        """Return whether a path may pass between viewpoint ``view[i]`` and viewpoint ``of_other[i]`` of ``other``.

        The result is False if both viewpoints lie at one point, but look into different sectors.
        """
        joins = (self.points[view] != other.points[of_other]).any(axis=1)
        for pair in np.flatnonzero(~joins):
            mine, others = self.edge[self.owner == view[pair]], other.edge[other.owner == of_other[pair]]
            joins[pair] = not len(mine) or np.isin(mine, others).any()
        return joins

    def opens(self, boundary: Boundary) -> Float[np.ndarray, "sectors 2"]:
        """Return, for each sector (see the class), a vector from the viewpoint along its right wall."""
        return boundary.vertices[boundary.edges[self.edge, 1]] - self.points[self.owner]

    def closes(self, boundary: Boundary) -> Float[np.ndarray, "sectors 2"]:
        """Return, for each sector (see the class), a vector from the viewpoint along its left wall."""
        return boundary.vertices[self.closing(boundary)] - self.points[self.owner]

    def at_vertex(self, boundary: Boundary) -> Bool[np.ndarray, " sectors"]:
        return (boundary.vertices[boundary.edges[self.edge, 0]] == self.points[self.owner]).all(axis=1)

    def closing(self, boundary: Boundary) -> Int[np.ndarray, " sectors"]:
        """Return, for each sector (see the class), the vertex at the far end of its left wall."""
        return np.where(self.at_vertex(boundary), boundary.sector_end[self.edge], boundary.edges[self.edge, 0])


def viewpoints_at(triangulation: Triangulation, x: Float[np.ndarray, "n 2"]) -> Viewpoints:
    """Round points of free space to the triangulation's grid, and return them as viewpoints.

    The rounded points must be distinct.
    """
    boundary, places = triangulation.boundary, triangulation.place(x)
    # A point at a vertex owns the sectors of all edges that start there. A point inside of a wall owns one sector.
    owner = index_of(places.x @ [1, 1j], boundary.vertices[boundary.edges[:, 0]] @ [1, 1j])
    edge = np.flatnonzero(owner >= 0)
    wall = triangulation.wall[3 * places.triangle + places.on_side.argmax(axis=1)]
    on_wall = np.setdiff1d(np.flatnonzero(places.on_side.any(axis=1) & (wall >= 0)), owner)
    return Viewpoints(places.x, np.append(owner[edge], on_wall), np.append(edge, wall[on_wall]))


@dataclass(frozen=True, eq=False)
class _Cones:
    """Cones of sight: ranges of directions in which a viewpoint sees through a side of a triangle."""

    view: Indices  # the viewpoint at each cone's apex
    half_edge: Indices  # through which each cone leaves a triangle
    vertex: Indices  # on the right bound
    right: Rays  # vectors along the right bounds
    left: Rays

    def __len__(self) -> int:
        return len(self.view)

    def __getitem__(self, rows: slice) -> "_Cones":
        return _Cones(*(column[..., rows] for column in vars(self).values()))

    def take(self, rows: Int[np.ndarray, " some"]) -> "_Cones":
        return _Cones(*(column.take(rows, axis=-1) for column in vars(self).values()))  # faster than indexing


def _first_cones(triangulation: Triangulation, views: Viewpoints) -> _Cones:
    """Return the first cones of sight: from each viewpoint through sides of the triangles that contain it."""
    # 1. Viewpoints without sectors look through all three sides of their triangle.
    around = np.setdiff1d(np.arange(len(views.points)), views.owner)
    triangle, _ = triangulation.locate(views.points[around])
    pairs = [(around, 3 * triangle + side) for side in range(3)]
    # 2. Viewpoints inside of a wall look through the two other sides of the wall's triangle.
    view, half_edge = views.owner, triangulation.of_wall[views.edge]
    at_vertex = views.at_vertex(triangulation.boundary)
    pairs += [(view[~at_vertex], side(half_edge[~at_vertex])) for side in (next_half_edge, previous_half_edge)]
    # 3. Viewpoints at vertices look through the opposite sides of all triangles of their sectors. Turn around the
    #    vertex, triangle by triangle, from the wall that opens the sector to the wall that closes it:
    #
    #            .                      The triangle on the left of half-edge h, which starts at vertex v, has the
    #     next  / \  opposite side       opposite side next_half_edge(h). The next half-edge from v, counterclockwise,
    #          v---.                     is the twin of previous_half_edge(h); there is none if that is a wall.
    #            h
    view, half_edge = view[at_vertex], half_edge[at_vertex]
    while len(view):
        pairs.append((view, next_half_edge(half_edge)))
        half_edge = triangulation.twin[previous_half_edge(half_edge)]
        view, half_edge = view[half_edge >= 0], half_edge[half_edge >= 0]
    # 4. Bound each cone by the ends of its side: half-edges go counterclockwise around the viewpoint.
    view, half_edge = (np.concatenate(several).astype(np.int32) for several in zip(*pairs, strict=True))
    right, left = triangulation.origin[half_edge], triangulation.origin[next_half_edge(half_edge)]
    vertices, points = triangulation.boundary.vertices, views.points[view]
    return _Cones(view, half_edge, right, (vertices[right] - points).T, (vertices[left] - points).T)


def _expand(triangulation: Triangulation, views: Viewpoints, first: _Cones) -> Iterator[tuple[_Cones, Seen, Visits]]:
    """Expand cones of sight: yield cones that end at walls, pairs (viewpoint, vertex seen), and triangles visited."""
    pending = [first[begin : begin + _CONES] for begin in range(0, len(first), _CONES)]
    while pending:
        # 1. Cones through walls end. The others go on.
        cones = pending.pop()
        is_wall = triangulation.wall[cones.half_edge] >= 0
        walls, cones = cones.take(np.flatnonzero(is_wall)), cones.take(np.flatnonzero(~is_wall))
        # 2. The corner ahead, opposite in the next triangle, may be seen, and may split the cone:
        #
        #          c                c: the corner ahead, the origin of the left exit
        #         / \
        #   left /   \ right        A cone goes right if its right ray passes right of c, and left if its left ray
        #       /     \             passes left of c. It splits if both hold.
        #      b-------a            b, a: the ends of the side through which it enters, as seen from the viewpoint
        #       \     /
        #      viewpoint
        entry = triangulation.twin[cones.half_edge]
        right_exit, left_exit = next_half_edge(entry), previous_half_edge(entry)
        ahead = triangulation.origin[left_exit]
        x, y = (triangulation.boundary.vertices[ahead] - views.points[cones.view]).T
        from_right, from_left = orientation(*cones.right, x, y), orientation(x, y, *cones.left)
        is_seen = (from_right >= 0) & (from_left >= 0)
        goes_right, goes_left = from_right > 0, from_left > 0
        goes_right |= ~goes_left & (from_right >= from_left)  # every cone goes on at least one way
        goes_left |= ~goes_right
        right, left = np.flatnonzero(goes_right), np.flatnonzero(goes_left)
        onward = cones.take(np.concatenate([right, left]))
        onward.half_edge[:] = np.concatenate([right_exit.take(right), left_exit.take(left)])
        # 3. If the cone splits, the corner ahead is the left bound of the right part and vice versa.
        is_split = goes_right & goes_left
        split = np.flatnonzero(is_split)
        right_part = np.flatnonzero(is_split.take(right))
        left_part = np.flatnonzero(is_split.take(left)) + len(right)
        onward.vertex[left_part] = ahead.take(split)
        for axis, along in enumerate((x, y)):
            onward.right[axis, left_part] = along.take(split)
            onward.left[axis, right_part] = along.take(split)
        pending += [onward[begin : begin + _CONES] for begin in range(0, len(onward), _CONES)]
        yield walls, np.stack([cones.view[is_seen], ahead[is_seen]]), np.stack([cones.view, entry // 3])


def triangles_within(triangulation: Triangulation, views: Viewpoints, right: Vectors, left: Vectors) -> Visits:
    """Return the pairs of a viewpoint and a triangle of which the viewpoint sees a part, as indices.

    Viewpoint ``i`` looks only into the directions counterclockwise from the unit vector ``right[i]`` to ``left[i]``,
    at most half a turn. Zero vectors stand for all directions. Pairs may repeat.
    """
    # 1. Widen these ranges by the angle of the tolerance at the farthest distance, to allow for rounded directions,
    #    except those that are half a turn wide up to rounding.
    far = np.ptp(triangulation.boundary.vertices, axis=0).max()
    wider = np.where(cross_product(right, left) > 4 * triangulation.tolerance / far, triangulation.tolerance, 0.0)
    right = far * right - wider[:, None] * turned_left(right)
    left = far * left + wider[:, None] * turned_left(left)
    # 2. Intersect each cone of sight with the range of its viewpoint. They meet if the right bound of one lies in the
    #    other, and the left bound of one, too. The intersection has a bound of the range if that lies in the cone.
    cones = _first_cones(triangulation, views)
    right, left = right[cones.view].T, left[cones.view].T
    is_whole = ~right.any(axis=0)
    cuts_right, cuts_left = (_inside(bound, cones.right, cones.left) for bound in (right, left))
    meets = cuts_right | _inside(cones.right, right, left)
    meets &= cuts_left | _inside(cones.left, right, left)
    right = np.where(cuts_right & ~is_whole, right, cones.right)
    left = np.where(cuts_left & ~is_whole, left, cones.left)
    first = _Cones(cones.view, cones.half_edge, cones.vertex, right, left).take(np.flatnonzero(is_whole | meets))
    # 3. Collect the triangles that these cones visit.
    visited = [np.stack([first.view, first.half_edge // 3])]
    visited += [new for _, _, new in _expand(triangulation, views, first)]
    return np.concatenate(visited, axis=1)


def _inside(u: Rays, right: Rays, left: Rays) -> Bool[np.ndarray, " n"]:
    return (orientation(*right, *u) >= 0) & (orientation(*u, *left) >= 0)


class VisibilityTable(NamedTuple):
    """The visibility polygons of viewpoints, as intervals of directions in which one boundary edge is nearest.

    The intervals of viewpoint ``v``, counterclockwise from the *cut*, a direction in which it sees no vertex::

        interval    first[v]    first[v] + 1            ...             first[v + 1] - 1
        starts at   the cut     direction of a vertex   ...             direction of a vertex
        key         4 v         4 v + pseudo-angle from the cut, ascending, below 4 (v + 1)
    """

    boundary: Boundary
    tolerance: float  # of the workspace; vertices, viewpoints and query points lie on its grid
    points: Vectors
    cut: Vectors  # unit vector, away from all visible vertices, from which pseudo-angles in [0, 4] are measured
    first: Int[np.ndarray, " views+1"]
    key: Float[np.ndarray, " intervals"]
    edge: Int[np.ndarray, " intervals"]  # nearest boundary edge; -1 where the viewpoint does not look
    vertex: Int[np.ndarray, " intervals"]  # in the direction at which an interval starts; -1 at the cut

    @staticmethod
    def joined(tables: "Sequence[VisibilityTable]") -> "VisibilityTable":
        """Join visibility tables of one boundary into one table, which has the viewpoints of all tables, in order."""
        points, cut, key, edge, vertex = concatenated(tables, "points", "cut", "key", "edge", "vertex")
        first = np.append(0, np.cumsum(np.concatenate([np.diff(table.first) for table in tables])))
        views = np.cumsum([0] + [len(table.points) for table in tables[:-1]])
        key += 4.0 * np.repeat(views, [len(table.key) for table in tables])
        return VisibilityTable(tables[0].boundary, tables[0].tolerance, points, cut, first, key, edge, vertex)

    @property
    def blur(self) -> float:
        """Upper bound of the rounding errors in ``key``, the numbers that order directions around viewpoints."""
        return _key_error(len(self.points))

    def sees(self, v: Indices, x: Points) -> Bool[np.ndarray, " n"]:
        """Return, for each ``i``, whether viewpoint ``v[i]`` sees the point ``x[i]``.

        A line of sight may touch corners on one side. It ends where it has touched a corner on each side.
        """
        # 1. Find the interval of each direction by its key.
        grid = grid_at(self.tolerance)
        x = grid * np.rint(x / grid)
        key = _keys(v, self.cut, (x - self.points[v]).T)
        row = np.minimum(np.searchsorted(self.key, key, side="right"), self.first[v + 1]) - 1
        seen = self._in_front(row, x)
        # 2. Where the key is within rounding of an interval's start, find the interval exactly: the last one that
        #    does not start on the left of the point. If the point is on the ray at which that interval starts, the
        #    ray is also the end of the previous interval, and the point is seen if it is in front of either edge.
        gap = np.abs(self.key[[row, np.minimum(row + 1, len(self.key) - 1)]] - key).min(axis=0)
        if len(near := np.flatnonzero(gap <= self.blur)):
            row, v, x, key = row[near], v[near], x[near], key[near]
            while (is_before := self._side_of_start(row + 1, v, x, key) >= 0).any():
                row += is_before
            while (is_after := (side := self._side_of_start(row, v, x, key)) < 0).any():
                row -= is_after
            seen[near] = self._in_front(row, x) | ((side == 0) & self._in_front(row - 1, x))
            seen[near] |= (x == self.points[v]).all(axis=1)  # viewpoints see themselves
        return seen

    def _side_of_start(self, row: Indices, v: Indices, x: Points, key: Numbers) -> Numbers:
        """Return on which side of a ray each point ``x[i]`` lies: positive left of it, 0 on it, negative right of it.

        The ray begins at viewpoint ``v[i]``, in the direction in which interval ``row[i]`` of the table starts.
        ``key[i]`` is the key (see the class) of the point's direction from the viewpoint. The viewpoint's first
        interval starts at the cut, which all points count as left of. For the row after the viewpoint's last
        interval, all points count as right of the ray.
        """
        has_vertex = (row > self.first[v]) & (row < self.first[v + 1])
        side = np.where(row > self.first[v], -1.0, 1.0)
        side[has_vertex] = key[has_vertex] - self.key[row[has_vertex]]
        near = np.flatnonzero(has_vertex & (np.abs(side) <= self.blur))
        start = self.boundary.vertices[self.vertex[row[near]]]
        side[near] = orientation(*(start - self.points[v[near]]).T, *(x[near] - self.points[v[near]]).T)
        return side

    def _in_front(self, row: Indices, x: Points) -> Bool[np.ndarray, " n"]:
        """Return whether each point ``x[i]`` is in front of the edge of interval ``row[i]``, or on the edge's line.

        The edge is the boundary edge that is nearest to the viewpoint in the interval's directions. *In front* is the
        free side of the line through the edge. The result is False if the interval has no edge. Near a line the test
        is exact.
        """
        edge = self.edge[row]
        normal = self.boundary.normal[edge]
        height = normal[:, 0] * x[:, 0] + normal[:, 1] * x[:, 1] - self.boundary.offset[edge]
        if len(near := np.flatnonzero(np.abs(height) <= self.tolerance)):
            start, end = self.boundary.segments[edge[near]].transpose(1, 2, 0)
            height[near] = orientation(*(end - start), *(x[near].T - start))
        return (height >= 0) & (edge >= 0)


def _keys(view: Indices, cut: Vectors, directions: Rays) -> Numbers:
    """Return numbers that order directions by viewpoint, then by the angle from the viewpoint's cut.

    The cut is a direction in which the viewpoint sees no vertex. The number is 4 times the viewpoint's index plus the
    pseudo-angle between cut and direction (:func:`~plr_jax.geometry.vectors.pseudo_angle`).
    """
    # The direction d has the coordinates (c . d, c x d) along and across the cut c.
    (cx, cy), (dx, dy) = cut[view].T, directions
    return 4.0 * view + pseudo_angle(cx * dx + cy * dy, cx * dy - cy * dx)


def _key_error(num_views: int) -> float:
    """Return an upper bound of the rounding errors of the numbers that :func:`_keys` returns."""
    return _BLUR + np.spacing(8.0 * num_views)


def visibility_of(triangulation: Triangulation, views: Viewpoints) -> tuple[VisibilityTable, Seen]:
    """Return the visibility polygons of viewpoints, and pairs (viewpoint, visible vertex) as indices.

    Pairs may repeat.
    """
    tables, seen, num_views = [], [], len(views.points)
    with Progress("visibility", "corners", num_views) as progress:
        for begin in range(0, max(1, num_views), _VIEWS):
            table, of_part = _look_around(triangulation, views[begin : begin + _VIEWS])
            tables.append(table)
            seen.append(of_part + np.array([[begin], [0]], np.int32))
            progress.update(len(table.points))
    return VisibilityTable.joined(tables), np.concatenate(seen, axis=1)


def _look_around(triangulation: Triangulation, views: Viewpoints) -> tuple[VisibilityTable, Seen]:
    """Return the visibility table of viewpoints, few enough for one pass, and pairs (viewpoint, visible vertex)."""
    # 1. Collect the cones that end at walls and the visible vertices, among them corners of triangles at viewpoints.
    boundary, index = triangulation.boundary, np.arange(len(views.points))
    cones = _first_cones(triangulation, views)
    corners = triangulation.origin.reshape(-1, 3)[cones.half_edge // 3]
    ended, seen = [cones[:0]], [np.stack([np.repeat(cones.view, 3), corners.ravel()])]
    for walls, new_seen, _ in _expand(triangulation, views, cones):
        ended.append(walls)
        seen.append(new_seen)
    bounds = [np.concatenate([getattr(part, name) for part in ended], axis=1) for name in ("right", "left")]
    cones = _Cones(*concatenated(ended, "view", "half_edge", "vertex"), *bounds)
    # 2. Sort the starts of intervals by key. An interval starts at the right bound of each cone, where its wall is
    #    the nearest edge, and at the closing wall of each sector, where no edge is.
    cut = _choose_cuts(boundary, views, cones)
    view = np.concatenate([cones.view, views.owner])
    directions = np.concatenate([cones.right, views.closes(boundary).T], axis=1)
    index_type = np.min_scalar_type(-len(boundary.edges))  # holds -1 and all indices: there are no more vertices
    edge = np.append(triangulation.wall[cones.half_edge], np.full(len(views.owner), -1)).astype(index_type)
    vertex = np.append(cones.vertex, views.closing(boundary)).astype(index_type)
    key = _keys(view, cut, directions)
    order = _exact_order(view, key, directions, len(index))
    view, key, edge, vertex = view[order], np.sort(key), edge[order], vertex[order]
    # 3. Start an interval at the cut, where a viewpoint sees the same edge as at the end of the turn.
    first, last = np.searchsorted(view, index), np.searchsorted(view, index, side="right") - 1
    added = (view, index), (key, 4.0 * index), (edge, edge[last]), (vertex, np.full(len(index), -1))
    view, key, edge, vertex = (np.insert(a, first, b) for a, b in added)
    # 4. Unite neighboring intervals with one edge.
    is_start = np.append(True, (edge[1:] != edge[:-1]) | (view[1:] != view[:-1]))[: len(view)]
    first = np.searchsorted(view[is_start], np.arange(len(index) + 1))
    rows = first, key[is_start], edge[is_start], vertex[is_start]
    return VisibilityTable(boundary, triangulation.tolerance, views.points, cut, *rows), np.concatenate(seen, axis=1)


def _choose_cuts(boundary: Boundary, views: Viewpoints, cones: _Cones) -> Vectors:
    """Choose a cut for each viewpoint, a direction in which it sees no vertex, from the cones that end at walls."""
    # 1. The middle of the gap after the first sector. If that is the only sector, the gap ends where it opens.
    #
    #       second sector \  gap  / first sector
    #                      \  |  /
    #                       \ | /    |: cut
    #                        \|/
    #                     viewpoint
    #
    opening, closing = views.opens(boundary), views.closes(boundary)
    opening_angle, closing_angle = (np.arctan2(u[:, 1], u[:, 0]) for u in (opening, closing))
    order = np.lexsort((opening_angle, views.owner))
    owner, first = np.unique(views.owner[order], return_index=True)
    first, second = order[first], order[first + (np.diff(first, append=len(order)) > 1)]
    gap, angle = np.zeros(len(views.points)), np.empty(len(views.points))
    gap[owner] = (opening_angle[second] - closing_angle[first]) % (2 * np.pi)
    angle[owner] = closing_angle[first] + gap[owner] / 2
    # 2. The middle of the widest cone, if the viewpoint has no sector or the gap is narrow. By rounding, a tiny gap
    #    may become almost 2 pi; then the exact test finds that its end is on the left of its start.
    is_narrow = gap < _NARROW
    is_narrow[owner] |= (gap[owner] > 2 * np.pi - _NARROW) & (orientation(*closing[first].T, *opening[second].T) > 0)
    for view in np.flatnonzero(is_narrow):
        is_own = cones.view == view
        (rx, ry), (lx, ly) = cones.right[:, is_own], cones.left[:, is_own]
        width = np.arctan2(np.abs(orientation(rx, ry, lx, ly)), rx * lx + ry * ly)
        widest = width.argmax()
        angle[view] = np.arctan2(ry[widest], rx[widest]) + width[widest] / 2
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _exact_order(view: Indices, key: Numbers, directions: Rays, num_views: int) -> Indices:
    """Return the indices that sort directions by viewpoint, then counterclockwise from the viewpoint's cut.

    The numbers ``key``, computed by :func:`_keys`, decide; where they are equal up to rounding, an exact test does.
    The cut is a direction in which the viewpoint sees no vertex. ``directions`` are vectors ``(dx, dy)``.
    """
    # Swap neighbors in the wrong order: row k of `order` and row k + 1, for each k in `near`. Swaps of one round must
    # not overlap. Test the neighbors of swapped rows again.
    dx, dy = directions
    order = np.argsort(key)
    is_close = np.diff(key[order], append=np.inf) <= _key_error(num_views)
    near = np.flatnonzero(is_close)
    while len(near):
        a, b = order[near], order[near + 1]
        near = near[(view[a] == view[b]) & (orientation(dx[a], dy[a], dx[b], dy[b]) < 0)]
        near = near[np.append(True, np.diff(near) > 1)[: len(near)]]
        order[near], order[near + 1] = order[near + 1], order[near]
        near = np.unique(np.concatenate([near - 1, near, near + 1]))
        near = near[is_close[near] & (near >= 0)]
    return order
