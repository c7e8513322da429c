"""Triangular expansion: what viewpoints see, found by going from triangle to triangle inside their cones of sight.

A cone begins at a viewpoint, is bounded by the directions of two vertices, and looks out of a triangle through an
edge. If that is a wall, the cone ends there. If not, the corner of the next triangle parts it in two, one for each
edge on, unless the corner lies outside. The cones of many viewpoints advance together, so that the cost follows what
is seen.

A corner on a bound, to a tolerance, counts as seen but parts no cone: none is narrower than rounding can tell.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax.geometry.boundary import Boundary
from plr_jax.geometry.visibility.triangulation import Triangulation, after, before

_MOST = 1 << 18  # cones that advance at a time
_BLUR = 0.01
"""How far a vertex may have to move, in tolerances, to lie on a bound."""


@dataclass(frozen=True, eq=False)
class Viewpoints:
    """Points and the sectors they look into.

    Args:
        points: The points, ``(views, 2)``: inside of free space, or exactly on its boundary with sectors given.
        owner: The point of each sector, ``(sectors,)``. A point without sectors looks all around.
        edge: The edge of the boundary with which each sector opens, counterclockwise, ``(sectors,)``: one that leaves
            the vertex where the point lies, or the one inside of which it lies.
    """

    points: Float[np.ndarray, "views 2"]
    owner: Int[np.ndarray, "sectors"]
    edge: Int[np.ndarray, "sectors"]

    def __getitem__(self, rows: slice | Int[np.ndarray, "some"]) -> "Viewpoints":
        """Some of them."""
        place = np.full(len(self.points), -1)
        place[rows] = np.arange(len(place[rows]))
        kept = place[self.owner] >= 0
        return Viewpoints(self.points[rows], place[self.owner[kept]], self.edge[kept])

    @property
    def looks_around(self) -> Bool[np.ndarray, "views"]:
        """Which points look all around."""
        return np.bincount(self.owner, minlength=len(self.points)) == 0

    def opens(self, boundary: Boundary) -> Float[np.ndarray, "sectors 2"]:
        """A vector from the point along the wall with which each sector opens."""
        return boundary.vertices[boundary.edges[self.edge, 1]] - self.points[self.owner]

    def closes(self, boundary: Boundary) -> Float[np.ndarray, "sectors 2"]:
        """A vector from the point along the wall with which each sector closes."""
        end = np.where(self.at_vertex(boundary), boundary.sector_end[self.edge], boundary.edges[self.edge, 0])
        return boundary.vertices[end] - self.points[self.owner]

    def at_vertex(self, boundary: Boundary) -> Bool[np.ndarray, "sectors"]:
        """Whether the point of each sector is the first vertex of its edge."""
        return (boundary.vertices[boundary.edges[self.edge, 0]] == self.points[self.owner]).all(axis=1)


@dataclass(frozen=True, eq=False)
class Sights:
    """What viewpoints see.

    Args:
        view: The viewpoint of each cone that ends at a wall, ``(cones,)``. The cones fill what it looks into.
        right: A vector from the viewpoint along the right bound of the cone, ``(cones, 2)``.
        wall: The edge at which it ends, ``(cones,)``.
        seen: Viewpoint and vertex of each pair that see one another, some repeatedly, ``(2, pairs)``.
    """

    view: Int[np.ndarray, "cones"]
    right: Float[np.ndarray, "cones 2"]
    wall: Int[np.ndarray, "cones"]
    seen: Int[np.ndarray, "2 pairs"]


@dataclass(frozen=True, eq=False)
class _Cones:
    """Cones of sight: viewpoint, half-edge of the triangle they look out by, right and left bound as vectors."""

    view: Int[np.ndarray, "n"]
    half_edge: Int[np.ndarray, "n"]
    right: Float[np.ndarray, "2 n"]
    left: Float[np.ndarray, "2 n"]

    def __len__(self) -> int:
        return len(self.view)

    def __getitem__(self, rows: slice | Int[np.ndarray, "some"]) -> "_Cones":
        return _Cones(self.view[rows], self.half_edge[rows], self.right[:, rows], self.left[:, rows])


def look_around(triangulation: Triangulation, views: Viewpoints) -> Sights:
    """What viewpoints see of the region that is triangulated."""
    first = _first_cones(triangulation, views)
    ended, seen = [], [_first_seen(triangulation, first)]
    for walls, new_seen, _ in _expansion(triangulation, views, first):
        ended.append(walls)
        seen.append(new_seen)
    return Sights(
        np.concatenate([np.empty(0, np.int32)] + [cones.view for cones in ended]),
        np.concatenate([np.empty((2, 0))] + [cones.right for cones in ended], axis=1).T,
        triangulation.wall[np.concatenate([np.empty(0, np.int32)] + [cones.half_edge for cones in ended])],
        np.concatenate(seen, axis=1),
    )


def triangles_within(
    triangulation: Triangulation,
    views: Viewpoints,
    right: Float[np.ndarray, "views 2"],
    left: Float[np.ndarray, "views 2"],
) -> Int[np.ndarray, "2 visits"]:
    """Viewpoint and triangle of each pair of which one sees a part of the other inside of a cone, some repeatedly.

    Args:
        triangulation: Of the region.
        views: The viewpoints.
        right: Direction of the right bound of the cone of each, a unit vector; zero for all that it looks into.
        left: That of its left bound, at most half a turn from there.
    """
    far = np.ptp(triangulation.boundary.vertices, axis=0).max()
    first = _clipped(_first_cones(triangulation, views), far * right, far * left)
    visited = [np.stack([first.view, first.half_edge // 3])]
    visited += [new for _, _, new in _expansion(triangulation, views, first)]
    return np.concatenate(visited, axis=1)


def _clipped(cones: _Cones, right: Float[np.ndarray, "views 2"], left: Float[np.ndarray, "views 2"]) -> _Cones:
    """What of the cones lies in another one for each viewpoint."""
    right, left, bounds = right[cones.view].T, left[cones.view].T, (cones.right, cones.left)
    whole = ~right.any(axis=0)
    from_right = _inside(right, *bounds), _inside(cones.right, right, left)
    from_left = _inside(left, *bounds), _inside(cones.left, right, left)
    kept = np.flatnonzero(whole | ((from_right[0] | from_right[1]) & (from_left[0] | from_left[1])))
    right = np.where(from_right[0] & ~whole, right, cones.right)
    left = np.where(from_left[0] & ~whole, left, cones.left)
    return _Cones(cones.view, cones.half_edge, right, left)[kept]


def _inside(
    u: Float[np.ndarray, "2 n"], right: Float[np.ndarray, "2 n"], left: Float[np.ndarray, "2 n"]
) -> Bool[np.ndarray, "n"]:
    """Whether directions lie in closed cones of less than half a turn."""
    return (right[0] * u[1] >= right[1] * u[0]) & (u[0] * left[1] >= u[1] * left[0])


def _expansion(
    triangulation: Triangulation, views: Viewpoints, first: _Cones
) -> Iterator[tuple[_Cones, Int[np.ndarray, "2 pairs"], Int[np.ndarray, "2 visits"]]]:
    """Step by step the cones that end at walls, and pairs of a viewpoint and a vertex, or a triangle, it sees."""
    pending = [first[begin : begin + _MOST] for begin in range(0, len(first), _MOST)]
    while pending:
        cones = pending.pop()
        is_wall = triangulation.wall[cones.half_edge] >= 0
        onward, seen, visited = _advanced(triangulation, views, cones[np.flatnonzero(~is_wall)])
        pending += [onward[begin : begin + _MOST] for begin in range(0, len(onward), _MOST)]
        yield cones[np.flatnonzero(is_wall)], seen, visited


def _first_cones(triangulation: Triangulation, views: Viewpoints) -> _Cones:
    """Cones that look out of the triangles at the viewpoints."""
    around = np.flatnonzero(views.looks_around)
    triangle = triangulation.locator.find(views.points[around])
    found = [(around, 3 * triangle + side) for side in range(3)]
    half_edge, view = triangulation.of_wall[views.edge], views.owner
    at_vertex = views.at_vertex(triangulation.boundary)
    found += [(view[~at_vertex], side(half_edge[~at_vertex])) for side in (after, before)]
    half_edge, view = half_edge[at_vertex], view[at_vertex]
    while len(view):  # from triangle to triangle around the vertex, to the wall at which the sector closes
        found.append((view, after(half_edge)))
        half_edge = triangulation.twin[before(half_edge)]
        half_edge, view = half_edge[half_edge >= 0], view[half_edge >= 0]
    view, half_edge = (np.concatenate(several).astype(np.int32) for several in zip(*found, strict=True))
    right, left = triangulation.origin[half_edge], triangulation.origin[after(half_edge)]
    vertices, points = triangulation.boundary.vertices, views.points[view]
    return _Cones(view, half_edge, (vertices[right] - points).T, (vertices[left] - points).T)


def _first_seen(triangulation: Triangulation, first: _Cones) -> Int[np.ndarray, "2 pairs"]:
    """The corners of the triangles at the viewpoints, the vertex at which one lies among them."""
    corners = triangulation.origin.reshape(-1, 3)[first.half_edge // 3]
    return np.stack([np.repeat(first.view, 3), corners.ravel()])


def _advanced(
    triangulation: Triangulation, views: Viewpoints, cones: _Cones
) -> tuple[_Cones, Int[np.ndarray, "2 pairs"], Int[np.ndarray, "2 visits"]]:
    """Cones after the next triangle, and which of its corners ahead, and of the triangles, are seen."""
    view, (rx, ry), (lx, ly) = cones.view, cones.right, cones.left
    entry = triangulation.twin[cones.half_edge]
    right_exit, left_exit = after(entry), before(entry)
    ahead = triangulation.origin[left_exit]
    x, y = (triangulation.boundary.vertices[ahead] - views.points[view]).T
    from_right, from_left = rx * y - ry * x, x * ly - y * lx
    tolerance, squared = triangulation.tolerance, x * x + y * y
    right_slack = tolerance * np.sqrt(np.maximum(squared, rx * rx + ry * ry))
    left_slack = tolerance * np.sqrt(np.maximum(squared, lx * lx + ly * ly))
    seen = (from_right >= -right_slack) & (from_left >= -left_slack)
    goes_right, goes_left = from_right > _BLUR * right_slack, from_left > _BLUR * left_slack
    goes_right |= ~goes_left & (from_right >= from_left)  # never nowhere
    goes_left |= ~goes_right
    parted = goes_right & goes_left
    right, left = np.flatnonzero(goes_right), np.flatnonzero(goes_left)
    middle = np.stack([x, y])
    onward = _Cones(
        np.concatenate([view[right], view[left]]),
        np.concatenate([right_exit[right], left_exit[left]]),
        np.concatenate([cones.right[:, right], np.where(parted, middle, cones.right)[:, left]], axis=1),
        np.concatenate([np.where(parted, middle, cones.left)[:, right], cones.left[:, left]], axis=1),
    )
    return onward, np.stack([view[seen], ahead[seen]]), np.stack([view, entry // 3])
