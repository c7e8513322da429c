"""Exact shortest-path distances among polygons in the plane, by a visibility graph.

Two numberings occur. Corners are numbered from 0, as in ``CornerVisibility``. Vertices of the graph of one goal are
the goal, vertex 0, and then the corners, so that corner ``i`` is vertex ``1 + i``.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Self

import numpy as np
import shapely
from jaxtyping import Float, Int
from scipy.sparse import coo_array, csr_array

from plr_jax._arrays import PickledWithoutCaches, as_finite_point, as_numbers, as_point, as_points, set_fields
from plr_jax._types import ArrayLike, Distances, Points, Reach, Sources
from plr_jax.geometry.box import Box
from plr_jax.geometry.cell_family import FamilyCells, FamilyGoal, FamilySamples, cells_of_goals
from plr_jax.geometry.cell_sight import CellSources, Rows, Sight, goal_sight, lists_of_goal
from plr_jax.geometry.changes import Change, changed_triangulation, changed_visibility
from plr_jax.geometry.corners import CornerVisibility, TurnPoints, TurnRegions, ViewsInSight, find_turn_points
from plr_jax.geometry.graph import Arcs, Graph, dijkstra, path_ends, path_to_root
from plr_jax.geometry.single_points import FEW, Place, PointSight
from plr_jax.geometry.visibility import VisibilityTable, viewpoints_at
from plr_jax.geometry.workspace import Workspace, require_workspace
from plr_jax.oracles._pair_distances import PairDistances


@dataclass(frozen=True, eq=False, init=False)
class VisibilityGraph(PickledWithoutCaches):
    """Exact length of the shortest path to a goal for a point among polygonal obstacles in the plane.

        oracle = plr_jax.VisibilityGraph(workspace, goal)
        oracle(x)  # distances (n,) of points (n, 2)

    A shortest path turns only at corners that stick out into free space. Construction computes the graph of corners
    that see one another, and by Dijkstra's algorithm ``distances`` of the vertices of ``graph`` to the goal, ``inf``
    without a path. A query tries corners in ascending order of ``distance(corner) + |x - corner|`` and stops at the
    first one that sees the point. See de Berg et al., Computational Geometry (3rd ed.), chapter 15.

    Args:
        workspace: The free space. Its ``squeeze`` decides about passing between obstacles that touch.
        goal: The goal, two finite numbers in closed free space, else ``ValueError``.
        shared: For internal use.
        goal_view: For internal use.
    """

    workspace: Workspace
    goal: Float[np.ndarray, "2"]
    distances: Float[np.ndarray, " vertices"]
    _parents: Int[np.ndarray, " vertices"]  # next vertex on each shortest path to the goal, -1 for none
    _goal_table: VisibilityTable  # what the goal sees
    _turns: TurnPoints  # corners at which shortest paths may turn first, and the cones from which such paths come
    _goal_edges: Int[np.ndarray, "edges 2"]  # edges of the graph at the goal: 0, and a vertex that the goal sees
    _pairs: PairDistances
    is_lower_bound: ClassVar[bool] = True
    """True: no path of the robot's reference point is shorter."""
    dim: ClassVar[int] = 2
    """Number of coordinates of a point."""

    def __init__(
        self,
        workspace: Workspace,
        goal: ArrayLike,
        *,
        shared: PairDistances | None = None,
        goal_view: ViewsInSight | None = None,
    ):
        require_workspace(workspace)
        goal = _free_goal(workspace, goal) if goal_view is None else np.asarray(goal)
        # 1. Find what the corners see, and what the goal sees.
        shared = shared or PairDistances(workspace, CornerVisibility.of(workspace))
        corners = shared.visibility
        mesh = workspace.triangulation
        goal_table, (_, corner) = goal_view or corners.in_sight(mesh, viewpoints_at(mesh, goal[None]))
        # 2. Join the goal, vertex 0, to the corners that it sees and that see it.
        edges = np.stack([np.zeros_like(corner), 1 + corner], axis=1)
        set_fields(self, workspace=workspace, goal=goal, _pairs=shared, _goal_table=goal_table, _goal_edges=edges)
        # 3. Find shortest paths from all corners to the goal, and from where paths can go to each corner first.
        distances, parents = dijkstra(self.graph.adjacency, 0)
        turns = find_turn_points(corners.corners.with_points(goal_table.points), distances, parents)
        set_fields(self, distances=distances, _parents=parents, _turns=turns)

    def with_goal(self, goal: ArrayLike) -> "VisibilityGraph":
        """Return the oracle for another free goal ``(2,)`` (else ``ValueError``), sharing the graph of corners."""
        return VisibilityGraph(self.workspace, goal, shared=self._pairs)

    def with_workspace(self, workspace: Workspace) -> "VisibilityGraph":
        """Return the oracle for the same goal after a local change of the workspace, reusing what did not change.

        The changed workspace comes for example from :meth:`Workspace.with_obstacles`. The result equals a new oracle
        up to rounding. Small changes take the least time. ``ValueError`` if the goal is no longer in closed free
        space.
        """
        # 1. Check whether the oracle can be updated, and whether the goal is still free if the map changed around it.
        require_workspace(workspace)
        old, goal = self.workspace, self.goal
        if (old.tolerance, old.squeeze) != (workspace.tolerance, workspace.squeeze):
            return VisibilityGraph(workspace, goal)
        change = Change.between(old.boundary, workspace.boundary)
        if any((box[0] <= goal).all() and (goal <= box[2]).all() for box in change.boxes(old.tolerance)):
            _free_goal(workspace, goal)
        # 2. Update the triangulation, what corners see, and what the goal sees.
        if not workspace.is_triangulated:
            if (triangulation := changed_triangulation(old.triangulation, change)) is None:
                return VisibilityGraph(workspace, goal)
            workspace.use_triangulation(triangulation)
        view = viewpoints_at(workspace.triangulation, goal[None])
        old_view = self._goal_table, self._goal_edges[:, 1] - 1
        corners, (goal_table, seen) = changed_visibility(self.family, old_view, view, workspace, change)
        goal_view = goal_table, corners.mutual_pairs(goal_table, np.zeros(len(seen), int), seen)
        return VisibilityGraph(workspace, goal, shared=PairDistances(workspace, corners), goal_view=goal_view)

    def __repr__(self) -> str:
        num_corners = len(self.graph.vertices) - 1
        return f"VisibilityGraph(goal={self.goal.tolist()}, {num_corners:,} corners, {len(self.graph.edges):,} edges)"

    @cached_property
    def graph(self) -> Graph:
        """The graph of the goal (vertex 0) and the corners.

        Edges join two vertices that see each other if a shortest path can turn at one of them.
        """
        edges = np.concatenate([self._goal_edges, 1 + self.family.edges], dtype=np.int32)
        return Graph(np.concatenate([self.goal[None], self.family.corners.points]), edges)

    @cached_property
    def regions(self) -> TurnRegions:
        """The corners at which paths to the goal may turn first, listed for each triangle of free space."""
        return TurnRegions.of(self._turns, self.workspace.triangulation, self.family.views[self._turns.vertex - 1])

    @cached_property
    def _goal_sight(self) -> PointSight:
        return PointSight(self._goal_table)

    @cached_property
    def sources(self) -> Sources:
        """The goal and the corners, numbered as in ``graph``: a shortest path first goes straight to one of them."""
        return Sources.of_graph(self.graph.vertices, self.distances, self._parents)

    @cached_property
    def sight(self) -> Sight:
        """Data to find which ``sources`` come first on shortest paths from a convex part of free space."""
        table = VisibilityTable.joined([self._goal_table, self.family.table])
        return goal_sight(self.sources, self._turns, table, self.workspace.triangulation)

    def cell_sources(self, domain: Box) -> CellSources:
        """Return a box's convex pieces of free space, and for each piece the sources to which paths may go first.

        Paths are the shortest paths from the piece to the goal. Sources are the corners and the goal, as numbered in
        ``sources``.
        """
        return CellSources.of_boxes(self.sight, lists_of_goal(self.regions), domain.lo[None], domain.hi[None])

    @property
    def family(self) -> CornerVisibility:
        """The corners and what each corner sees: one object that all oracles made by :meth:`with_goal` share."""
        return self._pairs.visibility

    def shared_samples(self, lo: Float[np.ndarray, "boxes 2"], hi: Float[np.ndarray, "boxes 2"]) -> FamilySamples:
        """Choose a free sample point in each box with free points, and find the corners where paths from it may turn.

        The result serves the oracles of all goals in this workspace.
        """
        return FamilySamples.of(self.family, self.workspace.triangulation, lo, hi)

    def first_turns(self, samples: FamilySamples) -> tuple[Float[np.ndarray, " boxes"], Int[np.ndarray, " boxes"]]:
        """Return the distance from each sample to the goal, and the index in ``sources`` of the path's first vertex.

        :meth:`shared_samples` makes the samples, at most one per box. For a box without a sample, or a sample without
        a path, the distance is ``inf`` and the index -1.
        """
        return samples.first_turns(self.goal, self._goal_table, self.distances[1:])

    def shared_cells(self, lo: Float[np.ndarray, "boxes 2"], hi: Float[np.ndarray, "boxes 2"]) -> FamilyCells:
        """Return each box's convex pieces of free space, and for each piece the corners where paths may turn first.

        Paths are shortest paths from the piece to any goal.
        """
        return FamilyCells.of(self.family, self.workspace.triangulation, lo, hi)

    def cells_of_members(self, shared: FamilyCells, members: Sequence[Self], box: Rows, member: Rows) -> CellSources:
        """Return convex pieces of free space and sources, as :meth:`cell_sources` does, for many boxes and oracles.

        ``shared`` is the result of :meth:`shared_cells` for several boxes, and ``members`` are oracles for several
        goals on this map. Pair ``i`` is the box of index ``box[i]`` and the oracle of index ``member[i]``. Sources of
        all members are numbered one after another: first all sources of ``members[0]``, then of ``members[1]``, ...
        """
        goals = [FamilyGoal(oracle.sources, oracle._turns, oracle._goal_table) for oracle in members]
        return cells_of_goals(shared, self.family.corners, goals, box, member)

    def __call__(self, x: ArrayLike) -> Distances:
        """Return the length of the shortest path from each point ``(n, 2)`` to the goal, ``(n,)`` in workspace units.

        The length is ``inf`` for points in obstacles, outside the bounds, without a path to the goal, or not finite.
        Points of 32-bit floats that are in obstacles only by rounding count as points on the walls.
        """
        return self._first_turns(self._points("x", x))[0]

    def reach(self, domain: Box) -> Reach | None:
        """Return tests whether boxes in ``domain`` hold points that reach the goal, or free points that do not.

        The result is None if a path leads from every free point.
        """
        return self.workspace.reach(self.goal[None], domain)

    def between(self, x: ArrayLike, y: ArrayLike) -> Distances:
        """Return the length of the shortest path from ``x[i]`` to ``y[i]`` for each ``i``; the goal plays no part.

        Points are ``(n, 2)``, lengths ``(n,)``. A length is ``inf`` without a path, or if a point is not free or not
        finite. Lengths are bitwise the same if ``x`` and ``y`` are swapped. Distances between corners are computed
        when needed. Up to 16 million of them are cached, for all oracles made by :meth:`with_goal`. With more than
        4,096 corners, ask for many pairs in one call.
        """
        return self._pairs(self._points("x", x), self._points("y", y))

    def shortest_path(self, x: ArrayLike) -> Float[np.ndarray, "m 2"]:
        """Return the shortest path from a point ``(2,)`` to the goal, as vertices ``(m, 2)`` without repetitions.

        There is one vertex if the point is the goal, none if the distance is ``inf``. Corners that the path only
        grazes may be among the vertices.
        """
        x = as_point("The start", self.workspace.settled(x), 2)
        distance, turn = self._first_turns(x[None])
        if not np.isfinite(distance[0]):
            return np.empty((0, 2))
        return path_to_root(self.graph, self._parents, x, int(turn[0]))

    def directions(self, x: ArrayLike) -> Float[np.ndarray, "n 2"]:
        """Return unit vectors, ``(n, 2)``, along which shortest paths from points ``(n, 2)`` start.

        The vectors are the negative gradient of the distance: zero within the workspace's tolerance of the goal, NaN
        where the distance is ``inf``. If several paths from a point are shortest, the result is the direction of one.
        """
        return self._first_legs(self._points("x", x))[0]

    def vertex_gradient(self, x: ArrayLike) -> csr_array:
        """Return the derivatives of the distances of points ``(n, 2)`` by the vertices of obstacles and by the goal.

        The result is a SciPy sparse matrix ``(n, 2 * m + 2)``, with ``m`` the number of rows of
        ``workspace.obstacle_vertices``. Columns ``2 * i`` and ``2 * i + 1`` belong to ``x`` and ``y`` of vertex
        ``i``, the last two columns to the goal. The derivative by the point itself is ``-directions(x)``.

        Only vertices at which the path turns have entries. Rows of points whose distance is ``inf`` are empty. If
        several paths from a point are shortest, its row belongs to one of them. Of vertices that coincide, one has
        the entries. A corner within the workspace's tolerance of the goal counts as the goal.
        """
        unit, turn = self._first_legs(self._points("x", x))
        vertices, obstacles = self.graph.vertices, self.workspace.obstacle_vertices
        # 1. Find the vertex of an obstacle at each corner. Paths turn at no other points, up to rounding: where edges
        #    of two obstacles cross, free space is convex.
        corner = np.flatnonzero(np.isfinite(self.distances) & (self.distances > self.workspace.tolerance))
        places, corners = (np.asarray(shapely.points(points)) for points in (obstacles, vertices[corner]))
        found, nearest = shapely.STRtree(places).query_nearest(corners, all_matches=False)
        column = np.full(len(vertices), len(obstacles))
        column[corner[found]] = nearest

        # 2. Differentiate legs: |b - a| has the derivative unit(b - a) by b, and the negative of it by a.
        def by_vertices(row: Rows, vertex: Rows, vector: Float[np.ndarray, "entries 2"], n: int) -> csr_array:
            place = np.repeat(row, 2), (2 * column[vertex][:, None] + [0, 1]).ravel()
            return coo_array((vector.ravel(), place), shape=(n, 2 * len(obstacles) + 2)).tocsr()

        onward = self._parents[corner]
        along = (leg := vertices[onward] - vertices[corner]) / np.linalg.norm(leg, axis=1, keepdims=True)
        ends, change = np.append(onward, corner), np.append(along, -along, axis=0)
        legs = by_vertices(np.tile(corner, 2), ends, change, len(vertices))
        first = by_vertices(np.arange(len(turn)), turn, np.nan_to_num(unit), len(turn))
        # 3. Add the legs of each path: list the vertices on the paths from all first turns to the goal.
        start, place = np.unique(turn, return_inverse=True)
        path = [np.stack([np.arange(len(start)), start])]
        while path[-1].size:
            row, vertex = path[-1][0], self._parents[path[-1][1]]
            path.append(np.stack([row, vertex])[:, vertex >= 0])
        index = np.concatenate(path, axis=1)
        on_path = coo_array((np.ones(index.shape[1]), tuple(index)), shape=(len(start), len(vertices))).tocsr()
        return first + (on_path @ legs)[place]

    def _points(self, name: str, x: ArrayLike) -> Float[np.ndarray, "n 2"]:
        return as_points(name, self.workspace.settled(x), 2)

    def _first_legs(self, x: Float[np.ndarray, "n 2"]) -> tuple[Float[np.ndarray, "n 2"], Int[np.ndarray, " n"]]:
        """Return the direction in which each point's path starts, and the index of its next vertex in ``graph``."""
        distance, turn = self._first_turns(x)
        leg = np.where(np.isfinite(distance)[:, None], self.graph.vertices[turn] - x, np.nan)
        length = np.linalg.norm(leg, axis=1)
        # From a point at a corner, the path starts towards the next vertex, at last the goal, vertex 0.
        while (is_at_turn := (length <= self.workspace.tolerance) & (turn > 0)).any():
            turn[is_at_turn] = self._parents[turn[is_at_turn]]
            leg[is_at_turn] = self.graph.vertices[turn[is_at_turn]] - x[is_at_turn]
            length[is_at_turn] = np.linalg.norm(leg[is_at_turn], axis=1)
        away = (length > self.workspace.tolerance)[:, None]
        return np.divide(leg, length[:, None], out=np.where(np.isnan(leg), np.nan, 0.0), where=away), turn

    def _first_turns(self, x: Float[np.ndarray, "n 2"]) -> tuple[Distances, Int[np.ndarray, " n"]]:
        """Return distances to the goal, and the index of the vertex of ``graph`` to which each path goes first.

        Without a path, the distance is ``inf`` and the index is 0.
        """
        if len(x) > FEW:
            return self._first_turns_of_batch(x)
        distance, turn = np.full(len(x), np.inf), np.full(len(x), -1)  # -1: not answered, as in no triangle
        for i, (x0, x1) in enumerate(x.tolist()):
            if (place := self._pairs.locator.place(x0, x1)) is not None:
                distance[i], turn[i] = self._first_turn(x0, x1, place)
        if len(pending := np.flatnonzero(turn < 0)):
            distance[pending], turn[pending] = self._first_turns_of_batch(x[pending])
        return distance, turn

    def _first_turn(self, x: float, y: float, place: Place) -> tuple[float, int]:
        """Return the distance of one point to the goal, and the index of the vertex to which the path goes first.

        ``place`` is the place of the point in the triangulation. The result equals `_first_turns_of_batch` in all
        bits.
        """
        # Go straight to the goal, else to the visible vertex of the least |x - vertex| + distance(vertex).
        if self._goal_sight.sees(0, place):
            goal_x, goal_y = self.goal.tolist()
            dx, dy = x - goal_x, y - goal_y
            return math.sqrt(dx * dx + dy * dy), 0
        turns = self._turns
        turn = place.take(self.regions.first, self.regions.turn)
        dx, dy = (turns.points[turn] - (x, y)).T
        length = np.sqrt(dx * dx + dy * dy) + turns.distance[turn]
        for i in length.argsort(kind="stable").tolist():
            vertex = int(turns.vertex[turn[i]])
            if self._pairs.sight.sees(vertex - 1, place):
                return float(length[i]), vertex
        return math.inf, 0

    def _first_turns_of_batch(self, x: Float[np.ndarray, "n 2"]) -> tuple[Distances, Int[np.ndarray, " n"]]:
        distance, turn = np.full(len(x), np.inf), np.zeros(len(x), int)
        free = np.flatnonzero(self.workspace.is_free_to_tolerance(x))
        mesh, sees = self.workspace.triangulation, self.family.table.sees
        # 1. Test what the goal sees at rounded points, and again at the few points that are moved into free space.
        grid = mesh.on_grid(x[free])
        is_direct = self._goal_table.sees(np.zeros(len(free), int), grid)
        if len(others := np.flatnonzero(~is_direct)):
            places = mesh.place(x[free[others]])
            if (is_moved := (places.x != grid[others]).any(axis=1)).any():
                is_direct[others[is_moved]] = self._goal_table.sees(np.zeros(is_moved.sum(), int), places.x[is_moved])
            # 2. From other points, find the shortest path over a visible corner.
            places, hidden = places[~is_direct[others]], free[~is_direct]
            first, shortest = self.regions.first_visible(x[hidden], places, lambda at, v: sees(v - 1, places.x[at]))
            turn[hidden], distance[hidden] = np.maximum(first, 0), shortest
        seen = free[is_direct]
        distance[seen] = np.linalg.norm(x[seen] - self.goal, axis=1)
        return distance, turn


@dataclass(frozen=True, eq=False)
class NearestPaths:
    """Shortest paths in a workspace to the nearest of several goals, each of which may cost something to use.

    Paths may also take the arcs of :class:`CornerVisibility`, such as links of a building. The *sources* are the
    goals (the cheapest at each point), then the corners. A *root* is a source that is a goal where the path ends,
    or from which the path takes an arc. A root at goal ``i`` has the number ``i``. A root whose path takes arc ``i``
    has the number ``g + i``, where ``g`` is the number of goals.
    """

    dim: ClassVar[int] = 2
    workspace: Workspace
    sources: Sources
    root_numbers: Int[np.ndarray, " sources"]  # those of `sources`
    regions: TurnRegions  # of all sources: paths may turn at a goal or place in any direction
    table: VisibilityTable

    @classmethod
    def of(cls, workspace: Workspace, corners: CornerVisibility, goals: Points, offsets: Distances) -> "NearestPaths":
        """Find the paths to ``goals``, points ``(n, 2)`` of free space; using them costs the ``offsets`` ``(n,)``."""
        # 1. Keep the cheapest of goals at one point.
        mesh, num_goals = workspace.triangulation, len(goals)
        order = np.argsort(offsets, kind="stable")
        _, cheapest = np.unique(mesh.place(goals).x[order], axis=0, return_index=True)
        kept = np.sort(order[cheapest])
        # 2. Split goals where obstacles touch, so that no path to another goal passes there between the obstacles.
        views, copied = viewpoints_at(mesh, goals[kept]).split()
        kept = kept[copied]
        # 3. Join goals and corners: goal i is vertex i, corner j is vertex count + j. The last vertex is the end of
        #    all paths. An arc leads there from each goal, whose length is the goal's offset. Dijkstra's algorithm
        #    starts at this end, so all arcs are reversed.
        count, vertices = len(kept), corners.corners.with_points(goals[kept])
        table, (goal, corner) = corners.in_sight(mesh, views)
        goal, corner = np.stack([goal, corner])[:, views.joins(goal, corners.views, corner)]
        end = len(vertices.points)
        start = np.append(np.arange(count), count + corners.arcs.start)
        onward = np.append(np.full(count, end), count + corners.arcs.end)
        arcs = Arcs(onward, start, np.append(offsets[kept], corners.arcs.length))
        edges = np.concatenate([np.stack([goal, count + corner], axis=1), count + corners.edges])
        adjacency = Graph(np.concatenate([vertices.points, vertices.points[:1]]), edges, arcs=arcs).adjacency
        distances, parents = dijkstra(adjacency, end)
        # 4. Find the roots: vertices whose paths start with an arc. If equal arcs leave a vertex, the first counts.
        numbers, exits = np.full(end, -1), np.arange(end)
        taken = np.flatnonzero((parents[start] == onward) & (adjacency[onward, start] == arcs.length))[::-1]
        numbers[start[taken]] = np.append(kept, num_goals + corners.given_arc)[taken]
        exits[start[taken]] = np.where(taken < count, start[taken], onward[taken])
        parents = np.where(numbers < 0, parents[:-1], -1)
        sources = Sources.of_graph(vertices.points, distances[:-1], parents, numbers, exits)
        # 5. List the sources at which paths from each triangle may turn first. Compute the cones of turns from
        #    rounded points: before rounding, a goal beside a corner may lie on another side of the corner's walls.
        views = views.append(corners.views)
        rounded = replace(vertices, points=views.points)
        turns = find_turn_points(rounded, sources.distances, parents, num_goals=0)
        turns = replace(turns, points=vertices.points[turns.vertex])
        regions = TurnRegions.of(turns, mesh, views[turns.vertex])
        return cls(workspace, sources, numbers, regions, VisibilityTable.joined([table, corners.table]))

    def first_turns(self, x: Float[np.ndarray, "n 2"]) -> tuple[Int[np.ndarray, " n"], Distances]:
        """Return the index of the source to which each point's path goes first, and the distance to the nearest goal.

        Without a path, the index is -1 and the distance ``inf``.
        """
        source, distance = np.full(len(x), -1), np.full(len(x), np.inf)
        free = np.flatnonzero(self.workspace.is_free_to_tolerance(x))
        places = self.workspace.triangulation.place(x[free])
        sees = self.table.sees
        source[free], distance[free] = self.regions.first_visible(x[free], places, lambda i, v: sees(v, places.x[i]))
        return source, distance

    def __call__(self, x: ArrayLike) -> Distances:
        """Return the distance of each point ``(n, 2)`` to the nearest goal, ``inf`` without a path."""
        return self.first_turns(as_points("x", x, 2))[1]

    def which(self, x: ArrayLike) -> Int[np.ndarray, " n"]:
        """Return the number of the root at the end of each point's path, a goal or the start of an arc.

        Points are ``(n, 2)``. The class explains the numbers of roots; the result is -1 without a path.
        """
        source, _ = self.first_turns(as_points("x", x, 2))
        return np.where(source < 0, -1, self.root_numbers[path_ends(self.sources.parents)[source]])

    def reach(self, domain: Box) -> Reach | None:
        """Return tests whether boxes in ``domain`` hold points that reach a goal, or free points that do not.

        The result is None if a path leads from every free point to a goal.
        """
        return self.workspace.reach(self.sources.points[self.root_numbers >= 0], domain)

    def cell_sources(self, domain: Box) -> CellSources:
        """Return a box's convex pieces of free space, and for each piece the sources to which paths may go first."""
        sight = goal_sight(self.sources, self.regions.turns, self.table, self.regions.triangulation, num_goals=0)
        lists = lists_of_goal(self.regions, num_goals=0)
        return CellSources.of_boxes(sight, lists, domain.lo[None], domain.hi[None])


def _free_goal(workspace: Workspace, goal: ArrayLike) -> Float[np.ndarray, "2"]:
    goal = as_numbers("The goal", workspace.settled(goal), "numbers of shape (2,)")
    if goal.ndim == 2:
        several = "For the nearest of several goals, use NearestGoal([first, *map(first.with_goal, others)])"
        advice = f"{several}; for a PLR per goal, use construct_many."
        raise ValueError(f"The goal must be one point (x, y), got an array of shape {goal.shape}. {advice}")
    goal = as_finite_point("The goal", goal, 2)
    if not workspace.is_free_to_tolerance(goal[None])[0]:
        clearance = f"(clearance {workspace.clearance(goal[None])[0]:.3g})"
        is_in = workspace.bounds.contains(goal[None])[0]
        where = "in an obstacle" if is_in else f"outside the bounds {workspace.bounds}"
        raise ValueError(f"The goal {goal.tolist()} lies {where} {clearance}; move it into free space.")
    return goal
