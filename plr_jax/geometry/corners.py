"""The corners at which shortest paths turn, what each corner sees, and where paths to one goal turn first."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import parts, take_ragged
from plr_jax.geometry.boundary import Boundary
from plr_jax.geometry.graph import NO_ARCS, Arcs, FirstVisible, Sees, first_visible_in_parts, first_visible_ragged
from plr_jax.geometry.triangulation import LocatedPoints, TriangleLists, Triangulation
from plr_jax.geometry.vectors import cross_product, distances_between, turned_left
from plr_jax.geometry.visibility import Viewpoints, VisibilityTable, triangles_within, viewpoints_at, visibility_of
from plr_jax.geometry.workspace import Workspace

Indices: TypeAlias = Int[np.ndarray, "*#batch"]
Pairs: TypeAlias = Int[np.ndarray, "2 pairs"]  # a viewpoint and a corner, as indices
ViewsInSight: TypeAlias = tuple[VisibilityTable, Pairs]  # what viewpoints see, and the corners that also see them
_PAIRS = 1 << 18  # pairs of a point and a turn point in memory at a time


@dataclass(frozen=True, eq=False)
class ReflexCorners:
    """Corners of the boundary of free space at which shortest paths can turn."""

    points: Float[np.ndarray, "corners 2"]
    # Unit vectors along both walls at each corner; free space lies counterclockwise from the first to the second.
    # Both are 0 if a path can turn in any direction: at goals and places, and where obstacles touch if paths may pass
    # between them.
    walls: Float[np.ndarray, "2 corners 2"]
    slack: float  # tolerance of tests on which side of a line through a corner a point lies

    def with_points(self, points: Float[np.ndarray, "n 2"], index: int = 0) -> "ReflexCorners":
        """Return the corners with ``points``, where paths may turn in any direction, inserted at ``index``."""
        at = [index] * len(points)
        return ReflexCorners(np.insert(self.points, at, points, 0), np.insert(self.walls, at, 0.0, 1), self.slack)

    def without(self, points: Float[np.ndarray, "n 2"]) -> "ReflexCorners":
        is_other = ~np.isin(self.points @ [1, 1j], points @ [1, 1j])
        return ReflexCorners(self.points[is_other], self.walls[:, is_other], self.slack)

    def is_tangent(self, corner: Indices, other: Indices) -> Bool[np.ndarray, "..."]:
        return self.is_tangent_to(corner, self.points[other])

    def is_tangent_to(self, corner: Indices, x: Float[np.ndarray, "*#batch 2"]) -> Bool[np.ndarray, "..."]:
        """Return whether both walls at each corner lie on one side of the line through the corner and a point ``x``.

        Only then can a shortest path turn at the corner on the way from or to ``x``. Up to ``slack``, walls may lie
        on the other side.
        """
        # Along any other line a path could cut off a part of the obstacle, so no shortest path turns there.
        dx, dy = np.moveaxis(x - self.points[corner], -1, 0)
        # Cross products: positive if x is on the left of the wall.
        sides = [wall[corner, 0] * dy - wall[corner, 1] * dx for wall in self.walls]
        return (np.minimum(*sides) >= -self.slack) | (np.maximum(*sides) <= self.slack)


def find_corners(workspace: Workspace) -> tuple[ReflexCorners, Viewpoints]:
    """Return the corners at which shortest paths may turn, and the same corners as viewpoints.

    These corners are the reflex vertices of free space and, if ``workspace.squeeze``, the *contacts*: points where
    obstacles touch, which paths may then cross.
    """
    boundary = workspace.boundary
    contacts = boundary.contacts if workspace.squeeze else np.empty(0, int)
    turns = boundary.is_reflex() | np.isin(boundary.edges[:, 0], contacts)
    # Each edge that begins at a corner has a sector: a reflex vertex has one sector, a contact has several.
    vertex, owner = np.unique(boundary.edges[turns, 0], return_inverse=True)
    views = Viewpoints(boundary.vertices[vertex], owner, np.flatnonzero(turns))
    walls = np.empty((2, len(vertex), 2))
    walls[:, owner] = views.opens(boundary), views.closes(boundary)
    walls /= np.linalg.norm(walls, axis=2, keepdims=True)
    walls[:, np.isin(vertex, contacts)] = 0.0
    return ReflexCorners(views.points, walls, workspace.tolerance), views


@dataclass(frozen=True, eq=False)
class CornerVisibility:
    """The corners at which shortest paths can turn, their visibility polygons, and the visibility graph.

    The last corners may be *places*: points of free space at which paths may turn in any direction, such as the ends
    of stairs. Arcs join places, even through walls.
    """

    corners: ReflexCorners
    views: Viewpoints  # at the corners
    table: VisibilityTable
    edges: Int[np.ndarray, "edges 2"]  # of the visibility graph, without a goal
    num_places: int = 0
    arcs: Arcs = NO_ARCS  # between corners
    # The index of each arc among the arcs given to :func:`with_places`, which copies some.
    given_arc: Int[np.ndarray, " arcs"] = field(default_factory=lambda: np.zeros(0, int))

    @staticmethod
    def of(workspace: Workspace) -> "CornerVisibility":
        corners, views = find_corners(workspace)
        table, (view, vertex) = visibility_of(workspace.triangulation, views)
        seen = corner_of_vertex(workspace.boundary, views)[vertex]
        view, seen = np.stack([view, seen])[:, (seen >= 0) & (seen != view)]
        return CornerVisibility(corners, views, table, mutually_visible_pairs(corners, view, seen))

    @property
    def places(self) -> Int[np.ndarray, " places"]:
        """The indices, among the corners, of the *places*: points at which paths may turn in any direction."""
        return np.arange(len(self.corners.points))[len(self.corners.points) - self.num_places :]

    @cached_property
    def of_vertex(self) -> Int[np.ndarray, " vertices"]:
        """The index of the corner at each vertex of the boundary; -1 for none.

        Places (see the class) do not count as corners here.
        """
        return corner_of_vertex(self.table.boundary, self.views[: len(self.corners.points) - self.num_places])

    def in_sight(self, triangulation: Triangulation, views: Viewpoints) -> ViewsInSight:
        """Return the visibility polygons of viewpoints, and pairs of a viewpoint and a corner that see each other."""
        table, (view, vertex) = visibility_of(triangulation, views)
        return table, self.mutual_pairs(table, view, self.of_vertex[vertex])

    def mutual_pairs(self, table: VisibilityTable, view: Indices, corner: Indices) -> Pairs:
        """Return the pairs of a viewpoint and a corner that see each other, each pair once, sorted.

        ``table`` has what the viewpoints see. Viewpoint ``view[i]`` sees the vertex at ``corner[i]`` (-1: no corner).
        """
        # Places are no vertices of the boundary, so `corner` lacks them: test every viewpoint and place.
        owner, place = (each.ravel() for each in np.meshgrid(np.arange(len(table.points)), self.places))
        sees = table.sees(owner, self.table.points[place])
        pairs = np.stack([np.append(view, owner[sees]), np.append(corner, place[sees])])
        view, corner = np.unique(pairs[:, pairs[1] >= 0], axis=1)
        return np.stack([view, corner])[:, self.table.sees(corner, table.points[view])]


def with_places(
    visibility: CornerVisibility, triangulation: Triangulation, places: Float[np.ndarray, "places 2"], arcs: Arcs
) -> CornerVisibility:
    """Return the corners, which have no places yet, followed by ``places``, distinct points of free space.

    ``arcs`` join places, given by their indices in ``places``. Where obstacles touch, a place becomes several copies,
    one for each sector of free space around it, each with copies of the place's arcs. So no path passes between the
    obstacles.
    """
    # 1. Split places, and copy arcs: from each copy of the start to each copy of the end.
    corners, count = visibility.corners, len(visibility.corners.points)
    views, of = viewpoints_at(triangulation, places).split()
    first = np.searchsorted(of, np.arange(len(places) + 1))
    start, arc = take_ragged(first, arcs.start)
    end, row = take_ragged(first, arcs.end[arc])
    places, copies = places[of], Arcs(count + start[row], count + end, arcs.length[arc[row]])
    # 2. Join each place to the corners that it sees and that see it, if paths from there can turn at the corner.
    table, (place, corner) = visibility.in_sight(triangulation, views)
    joined = corners.is_tangent_to(corner, views.points[place]) & views.joins(place, visibility.views, corner)
    # 3. Join places that see each other.
    a, b = np.triu_indices(len(places), 1)
    sees = table.sees(a, views.points[b]) & table.sees(b, views.points[a]) & (of[a] != of[b])
    pairs = np.stack([corner[joined], count + place[joined]], axis=1), count + np.stack([a[sees], b[sees]], axis=1)
    edges = np.concatenate([visibility.edges, *pairs], dtype=visibility.edges.dtype)
    corners, views = corners.with_points(places, count), visibility.views.append(views)
    table = VisibilityTable.joined([visibility.table, table])
    return CornerVisibility(corners, views, table, edges, len(places), copies, arc[row])


def mutually_visible_pairs(corners: ReflexCorners, view: Indices, seen: Indices) -> Int[np.ndarray, "edges 2"]:
    """Return the pairs of corners that see each other along a line that is tangent to the walls at a corner or both.

    The arguments list what corners see: corner ``view[i]`` sees corner ``seen[i]``. Each pair is returned once.
    """
    tangent = corners.is_tangent(view, seen) | corners.is_tangent(seen, view)
    view, seen = view[tangent], seen[tangent]
    # Visibility is not symmetric: at a point contact, a corner may be seen from a sector that it does not look into.
    # Give each unordered pair a number, and each of its directions a key: twice the number, plus 0 or 1. Then the
    # number of a pair that sees one another occurs twice, side by side.
    size = np.int64(len(corners.points))
    number = np.minimum(view, seen) * size + np.maximum(view, seen)
    pair = sorted_unique(2 * number + (view < seen)) >> 1
    mutual = pair[1:][pair[1:] == pair[:-1]]
    return np.stack(np.divmod(mutual, size), axis=1).astype(np.int32)


def corner_of_vertex(boundary: Boundary, views: Viewpoints) -> Int[np.ndarray, " vertices"]:
    """Return the index in ``views`` of the corner at each boundary vertex; -1 if paths cannot turn at the vertex.

    ``views`` are the corners at which paths can turn.
    """
    corner = np.full(len(boundary.vertices), -1)
    corner[boundary.edges[views.edge, 0]] = views.owner
    return corner


def sorted_unique(keys: Int[np.ndarray, " n"]) -> Int[np.ndarray, " distinct"]:
    keys = np.sort(keys)  # faster than the hashing of ``np.unique`` if most keys are distinct
    return keys[np.append(True, keys[1:] != keys[:-1])[: len(keys)]]


@dataclass(frozen=True, eq=False)
class TurnPoints:
    """The corners at which a shortest path to one goal can turn first, each with the cone from which paths come.

    The shortest path from a corner to the goal is known. The cone of a corner lies between the backward extension of
    that path and the nearer wall at the corner. A path from a point outside the cone could be shortened.
    """

    vertex: Int[np.ndarray, " turns"]  # index of each corner in a list of goals, then corners
    points: Float[np.ndarray, "turns 2"]
    distance: Float[np.ndarray, " turns"]  # from each corner to the goal
    normal: Float[np.ndarray, "2 turns 2"]  # inward normals of the two sides of each cone; 0 if it is the whole plane
    slack: float  # points up to this far outside a cone count as inside

    @property
    def bounds(self) -> tuple[Float[np.ndarray, "turns 2"], Float[np.ndarray, "turns 2"]]:
        """Vectors along the right side and along the left side of each corner's cone (see the class).

        Both are 0 if the cone is the whole plane.
        """
        #     left side \      / right side
        #                \cone/
        #                 \  /
        #                  c
        # The inward normal of the right side is the vector along this side, turned left. The inward normal of the
        # left side is the vector along that side, turned right. A cone is narrower than half the plane, so the right
        # side's normal is counterclockwise of the left side's normal: if cross(first, second) >= 0, `second` belongs
        # to the right side.
        first, second = self.normal
        in_order = (cross_product(first, second) >= 0)[:, None]
        return -turned_left(np.where(in_order, second, first)), turned_left(np.where(in_order, first, second))

    def path_lengths(self, x: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n turns"]:
        """Return the length of the path from each point straight to each corner, and on to the goal.

        The length is NaN if the point lies outside the corner's cone, the region from which shortest paths can turn
        at the corner. Visibility is not tested.
        """
        length = distances_between(x, self.points)
        length += self.distance
        for normal in self.normal:
            length[x @ normal.T < (self.points * normal).sum(axis=1) - self.slack] = np.nan
        return length

    def first_visible(self, x: Float[np.ndarray, "n 2"], sees: Sees) -> FirstVisible:
        """Return the first corner and the length of each point's shortest path among paths that turn at a corner.

        Corners are numbered as in ``vertex``: goals first, then corners. ``sees(i, corner)`` tests whether point
        ``i`` sees a corner. Without a path, the corner is -1 and the length ``inf``.
        """
        turn, length = first_visible_in_parts(
            lambda rows: self.path_lengths(x[rows]), len(x), len(self.vertex), lambda i, k: sees(i, self.vertex[k])
        )
        return np.append(self.vertex, -1)[turn[:, 0]], length[:, 0]


def find_turn_points(
    vertices: ReflexCorners, distances: Float[np.ndarray, " v"], parents: Int[np.ndarray, " v"], num_goals: int = 1
) -> TurnPoints:
    """Return the corners at which shortest paths to a goal may turn first.

    ``vertices`` are the ``num_goals`` goals, then all corners. ``distances`` are the distances from vertices to the
    nearest goal, and ``parents`` the index of the next vertex on each shortest path to a goal.
    """
    # ``distances`` and ``parents`` come from Dijkstra's algorithm with the goals as sources.
    #
    #                                 . onward, to the goal
    #                            .
    #                       c------------ opening wall
    #                  .    |############
    #             .   cone  |# obstacle #
    #    extension          |############
    #                  closing wall
    #
    # A path that turns at corner c comes from the cone between the backward extension of the path onward and the wall
    # around which it comes, the *near wall*: here the closing wall. If the extension enters the obstacle, no path
    # turns at c. The obstacle fills the corner from the closing wall counterclockwise to the opening wall. Its
    # direction is o = opens + closes. If it lies to the left of the path onward, cross(onward, o) > 0, the near wall
    # is the opening wall. Else it is the closing wall, and all is mirrored: `sign` is -1.
    vertex = num_goals + np.flatnonzero(np.isfinite(distances[num_goals:]))
    points = vertices.points[vertex]
    opens, closes = vertices.walls[:, vertex]
    onward = vertices.points[parents[vertex]] - points
    onward[(opens == 0).all(axis=1)] = 0.0
    on_left = cross_product(onward, opens + closes) > 0
    sign = np.where(on_left, 1.0, -1.0)[:, None]
    near_wall = np.where(on_left[:, None], opens, closes)
    # `onward` leads to the next vertex, so the product is that vertex's distance from the line of the near wall.
    enters_obstacle = sign[:, 0] * cross_product(onward, near_wall) < -vertices.slack
    norm = np.linalg.norm(onward, axis=1, keepdims=True)
    onward = np.divide(onward, norm, out=np.zeros_like(onward), where=norm > 0)
    normal = np.stack([sign * turned_left(onward), sign * turned_left(near_wall)])
    useful = np.flatnonzero(~enters_obstacle)
    vertex = vertex[useful]
    return TurnPoints(vertex, points[useful], distances[vertex], normal[:, useful], vertices.slack)


class TurnRegions(NamedTuple):
    """Lists, one for each triangle of free space, of the corners where paths from there to a goal may turn first."""

    turns: TurnPoints
    triangulation: Triangulation
    first: Int[np.ndarray, " triangles_plus_one"]
    turn: Int[np.ndarray, " entries"]  # turn[first[t] : first[t + 1]] are the indices in `turns` for triangle t

    @staticmethod
    def of(turns: TurnPoints, triangulation: Triangulation, views: Viewpoints) -> "TurnRegions":
        """List, for each triangle of free space, the turn points that see a part of the triangle within their cone.

        A turn point is a corner where paths to a goal may turn first. Its cone has all points from which a shortest
        path can turn there, if no wall is in between. ``views`` are the turn points as viewpoints.
        """
        visits = triangles_within(triangulation, views, *turns.bounds)
        return TurnRegions(turns, triangulation, *views_by_triangle(triangulation, visits))

    def first_visible(self, x: Float[np.ndarray, "n 2"], places: LocatedPoints, sees: Sees) -> FirstVisible:
        """Return the first corner and the length of each point's shortest path among paths that turn at a corner.

        Corners are numbered as in ``self.turns.vertex``: goals first, then corners. ``sees(i, corner)`` tests whether
        point ``i`` sees a corner. ``places`` are the points ``x``, located in the triangulation. Without a path, the
        corner is -1 and the length ``inf``.
        """
        vertex, length = np.full(len(x), -1), np.full(len(x), np.inf)
        # 1. Find the triangles of each point that is not a vertex: one, or two if the point is on a side.
        is_vertex = places.on_side.sum(axis=1) > 1
        point, rest = np.flatnonzero(~is_vertex), np.flatnonzero(is_vertex)
        first, triangle = triangles_at(self.triangulation, places[point])
        # 2. The candidates of a point are the turns that its triangles list. The point's path turns first at the
        #    candidate of least path length among the candidates that the point sees.
        num_listed = self.first[triangle + 1] - self.first[triangle]
        counts = np.diff(np.append(0, np.cumsum(num_listed))[first])
        for part in parts(counts, _PAIRS):
            entry, _ = take_ragged(self.first, triangle[first[part.start] : first[part.stop]])
            turn, rows = self.turn[entry], point[part]
            dx, dy = (np.repeat(x[rows], counts[part], axis=0) - self.turns.points[turn]).T
            lengths = np.sqrt(dx * dx + dy * dy) + self.turns.distance[turn]
            corner = self.turns.vertex[turn]
            # The last two parameters of the function bind the arrays of this iteration.
            pair, length[rows] = first_visible_ragged(
                lengths, counts[part], lambda i, pair, rows=rows, corner=corner: sees(rows[i], corner[pair])
            )
            vertex[rows] = np.append(corner, -1)[pair]
        # 3. At a vertex, many triangles meet: there, a point tries all turns.
        vertex[rest], length[rest] = self.turns.first_visible(x[rest], lambda i, corner: sees(rest[i], corner))
        return vertex, length


def views_by_triangle(triangulation: Triangulation, visits: Int[np.ndarray, "2 visits"]) -> TriangleLists:
    """List the viewpoints that see each triangle, given all pairs (viewpoint, triangle); a pair may repeat.

    The result is ``(first, view)``: triangle ``t`` is seen by the viewpoints ``view[first[t] : first[t + 1]]``.
    """
    view, triangle = visits
    count = int(view.max(initial=0)) + 1
    triangle, view = np.divmod(sorted_unique(triangle * np.int64(count) + view), count)
    return np.searchsorted(triangle, np.arange(len(triangulation.origin) // 3 + 1)), view


def corners_by_triangle(visibility: CornerVisibility, triangulation: Triangulation) -> TriangleLists:
    """List, for each triangle of free space, the corners where paths from points of the triangle may turn first.

    The result is ``(first, corner)``: triangle ``t`` has the corners ``corner[first[t] : first[t + 1]]``.
    """
    # A path may turn at a corner only if it comes from a direction v for which `opens x v` and `closes x v`, with the
    # directions of the corner's walls, are both at least 0 (from opens to -closes), or both at most 0.
    opens, closes = visibility.corners.walls
    cones = (opens, -closes), (-opens, closes)
    visits = [triangles_within(triangulation, visibility.views, *cone) for cone in cones]
    return views_by_triangle(triangulation, np.concatenate(visits, axis=1))


def triangles_at(
    triangulation: Triangulation, places: LocatedPoints
) -> tuple[Int[np.ndarray, " points_plus_one"], Int[np.ndarray, " pairs"]]:
    """Return the triangles that contain each point, as arrays ``(first, triangle)``.

    Point ``i`` lies in the triangles ``triangle[first[i] : first[i + 1]]``: one, or two if the point lies on the side
    between them. For a point at a vertex, the only entry is not a triangle, but the number of all triangles.
    """
    num_sides, side = places.on_side.sum(axis=1), places.on_side.argmax(axis=1)
    beyond = triangulation.twin[3 * places.triangle + side] // 3
    counts = np.where((num_sides == 1) & (beyond >= 0), 2, 1)
    triangle = np.where(num_sides > 1, len(triangulation.triangles), places.triangle)
    return np.append(0, np.cumsum(counts)), np.stack([triangle, beyond], axis=1)[np.arange(2) < counts[:, None]]
