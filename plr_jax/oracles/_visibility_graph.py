"""Exact shortest-path distance among polygons in the plane."""

import math
from dataclasses import dataclass
from functools import cached_property

import networkx
import numpy as np
from jaxtyping import Float, Int

from plr_jax._arrays import as_finite_point, as_point, as_points
from plr_jax._deadline import deadline_after
from plr_jax._types import ArrayLike, Distances, Sources
from plr_jax.geometry.boundary import Boundary
from plr_jax.geometry.box import Box
from plr_jax.geometry.corners import CornerVisibility, TurnPoints, corner_visibility, find_turn_points
from plr_jax.geometry.graph import Graph, dijkstra, path_from_root, rooted, to_networkx
from plr_jax.geometry.shadows import shadows_of
from plr_jax.geometry.visibility import Viewpoints, VisibilityTable, visibility_table
from plr_jax.geometry.workspace import Workspace
from plr_jax.oracles._cell_sources import Sight, VisibleSources, visible_sources


@dataclass(frozen=True, eq=False, init=False)
class VisibilityGraph:
    """Exact length of the shortest path to a goal for a point among polygonal obstacles in the plane.

    A shortest path turns only at corners that stick out into free space. Construction finds the visibility
    polygon of every corner, the graph of corners that see one another, and by Dijkstra's algorithm the
    distance of each corner to the goal. A query takes, of the corners that see the point, the one of least
    ``distance(corner) + |x - corner|``: it tries them in that order and stops at the first that does.

    Args:
        workspace: The free space. Its ``squeeze`` decides about passing between obstacles that touch.
        goal: The goal, ``(2,)``, in closed free space.
        time_limit: Seconds that construction may take. A single call of Shapely is not cut short.

    Attributes:
        workspace: As given.
        goal: As given.
        graph: The visibility graph: the goal as vertex 0, then the corners. It has no edge of which neither
            end can be a turn of a shortest path along it.
        distances: Distance of each vertex to the goal, ``inf`` where it cannot be reached.

    Raises:
        ValueError: If the goal is not two finite numbers, lies in an obstacle or outside the bounds.
        TimeoutError: If the time limit passes first.

    References:
        de Berg et al., Computational Geometry (3rd ed.), chapter 15; visibility polygons as in
        :mod:`plr_jax.geometry.visibility`.
    """

    workspace: Workspace
    goal: Float[np.ndarray, "2"]
    graph: Graph
    distances: Float[np.ndarray, "vertices"]
    _parents: Int[np.ndarray, "vertices"]
    _corners: CornerVisibility
    _goal_table: VisibilityTable
    _turns: TurnPoints

    def __init__(self, workspace: Workspace, goal: ArrayLike, *, time_limit: float | int = math.inf):
        deadline = deadline_after(time_limit)
        _assign(self, workspace, _free_goal(workspace, goal), corner_visibility(workspace, deadline))

    def with_goal(self, goal: ArrayLike) -> "VisibilityGraph":
        """The same workspace's oracle for another goal; corners and what they see are shared.

        Args:
            goal: The goal, ``(2,)``, in closed free space.

        Returns:
            The oracle.

        Raises:
            ValueError: As for the class.
        """
        oracle = object.__new__(VisibilityGraph)
        _assign(oracle, self.workspace, _free_goal(self.workspace, goal), self._corners)
        return oracle

    def __repr__(self) -> str:
        num_corners = len(self.graph.vertices) - 1
        return f"VisibilityGraph(goal={self.goal.tolist()}, {num_corners:,} corners, {len(self.graph.edges):,} edges)"

    @property
    def is_lower_bound(self) -> bool:
        """True: no path of a robot whose reference point keeps to its free space is shorter."""
        return True

    @property
    def dim(self) -> int:
        """Number of coordinates of a point: 2."""
        return 2

    @property
    def num_bytes(self) -> int:
        """Bytes of the arrays that a query reads and another goal needs, including what their oracles share."""
        own = self._goal_table.num_bytes + self._turns.num_bytes + self._parents.nbytes + self.distances.nbytes
        return self._corners.num_bytes + own

    @cached_property
    def sources(self) -> Sources:
        """The goal and the corners, vertices of the graph: a path's next turn is one of them."""
        return Sources(self.graph.vertices, self.distances, rooted(self._parents))

    def cell_sources(self, domain: Box) -> VisibleSources:
        """Which sources points of a box may use, and which all of them can, piece by piece of free space.

        Args:
            domain: The box, as one cell, of which smaller ones can be cut. It may reach beyond the workspace.

        Returns:
            The pieces of free space in the box from which the goal can be reached, and their sources.
        """
        sight = Sight(self.sources, shadows_of(self._goal_table.followed_by(self._corners.table)), self._turns)
        return visible_sources(sight, self.workspace, domain)

    def to_networkx(self) -> networkx.Graph:
        """The graph in NetworkX: position as ``pos`` of a node, length as ``weight`` of an edge."""
        return to_networkx(self.graph)

    def __call__(self, x: ArrayLike) -> Distances:
        """Length of the shortest path from each point to the goal.

        Args:
            x: Points, ``(n, 2)``.

        Returns:
            Distances, ``(n,)``, in workspace units: ``inf`` in an obstacle, outside the bounds, where the
            goal cannot be reached, and for points that are not finite.

        Raises:
            ValueError: If ``x`` has another shape.
        """
        return self._first_turns(as_points("x", x, 2))[0]

    def shortest_path(self, x: ArrayLike) -> Float[np.ndarray, "m 2"]:
        """The shortest path from a point to the goal.

        Args:
            x: The point, ``(2,)``.

        Returns:
            The path's vertices, ``(m, 2)``, from ``x`` to the goal, no two in a row equal: one if ``x`` is the
            goal; corners that the path only grazes may be among them. No rows where the distance is ``inf``.

        Raises:
            ValueError: If ``x`` has another shape.
        """
        x = as_point("The start", x, 2)
        distance, turn = self._first_turns(x[None])
        if not np.isfinite(distance[0]):
            return np.empty((0, 2))
        onward = path_from_root(self._parents, int(turn[0]))[::-1]
        path = np.concatenate([x[None], self.graph.vertices[onward]])
        return path[np.append(True, (path[1:] != path[:-1]).any(axis=1))]

    def directions(self, x: ArrayLike) -> Float[np.ndarray, "n 2"]:
        """The directions in which the shortest paths set out: where the exact distance falls at a rate of one.

        Args:
            x: Points, ``(n, 2)``.

        Returns:
            Unit vectors, ``(n, 2)``: zero within the workspace's tolerance of the goal, NaN where the distance is
            ``inf``. Where several paths are shortest, the direction of one of them.

        Raises:
            ValueError: If ``x`` has another shape.
        """
        x = as_points("x", x, 2)
        distance, turn = self._first_turns(x)
        leg = np.where(np.isfinite(distance)[:, None], self.graph.vertices[turn] - x, np.nan)
        length = np.linalg.norm(leg, axis=1)
        # From a corner the path sets out towards the vertex after it.
        while (here := (length <= self.workspace.tolerance) & (turn > 0) & np.isfinite(distance)).any():
            turn[here] = self._parents[turn[here]]
            leg[here] = self.graph.vertices[turn[here]] - x[here]
            length[here] = np.linalg.norm(leg[here], axis=1)
        away = (length > self.workspace.tolerance)[:, None]
        result = np.divide(leg, length[:, None], out=np.zeros_like(leg), where=away)
        result[~np.isfinite(distance)] = np.nan
        return result

    def _first_turns(self, x: Float[np.ndarray, "n 2"]) -> tuple[Distances, Int[np.ndarray, "n"]]:
        """Distance, and the vertex that the path goes to first: 0, the goal, if it is straight or there is none."""
        distance, turn = np.full(len(x), np.inf), np.zeros(len(x), int)
        free = np.flatnonzero(self.workspace.is_free(x))
        direct = self._goal_table.sees(np.zeros(len(free), int), x[free])
        seen, hidden = free[direct], x[free[~direct]]
        distance[seen] = np.linalg.norm(x[seen] - self.goal, axis=1)
        table = self._corners.table
        first, distance[free[~direct]] = self._turns.first_visible(
            hidden, lambda point, vertex: table.sees(vertex - 1, hidden[point])
        )
        turn[free[~direct]] = np.maximum(first, 0)
        return distance, turn


def _assign(oracle: VisibilityGraph, workspace: Workspace, goal: np.ndarray, corners: CornerVisibility) -> None:
    view = _goal_view(workspace.boundary, workspace.tolerance, goal)
    goal_table = visibility_table(workspace.boundary, workspace.tolerance, view)
    vertices = corners.corners.with_goal(goal)
    graph = Graph(vertices.points, np.concatenate([_goal_edges(corners, goal_table, goal), 1 + corners.edges]))
    distances, parents = dijkstra(graph, 0)
    turns = find_turn_points(vertices, distances, parents)
    vars(oracle).update(workspace=workspace, goal=goal, graph=graph, distances=distances, _parents=parents)
    vars(oracle).update(_corners=corners, _goal_table=goal_table, _turns=turns)


def _free_goal(workspace: Workspace, goal: ArrayLike) -> Float[np.ndarray, "2"]:
    goal = as_finite_point("The goal", goal, 2)
    if not workspace.is_free(goal[None])[0]:
        clearance = workspace.clearance(goal[None])[0]
        bounds = workspace.bounds
        where = "in an obstacle" if bounds.contains(goal[None])[0] else f"outside the bounds {bounds}"
        raise ValueError(
            f"The goal {goal.tolist()} lies {where} (clearance {clearance:.3g}); move it into free space."
        )
    return goal


def _goal_view(boundary: Boundary, tolerance: float, goal: Float[np.ndarray, "2"]) -> Viewpoints:
    """The goal as a viewpoint, moved exactly onto the vertex or edge it lies on to within tolerance."""
    to_vertex = np.linalg.norm(boundary.vertices - goal, axis=1)
    if to_vertex.min() <= tolerance:
        vertex = to_vertex.argmin()
        edge = np.flatnonzero(boundary.edges[:, 0] == vertex)
        ends = boundary.edges[edge, 1], boundary.sector_end[edge]
        return Viewpoints(boundary.vertices[[vertex]], np.zeros(len(edge), int), *ends)
    start, end = boundary.segments.transpose(1, 0, 2)
    share = ((goal - start) * (end - start)).sum(axis=1) / ((end - start) ** 2).sum(axis=1)
    foot = start + np.clip(share, 0, 1)[:, None] * (end - start)
    to_edge = np.linalg.norm(goal - foot, axis=1)
    near = to_edge.argmin()
    if to_edge[near] <= tolerance:
        return Viewpoints(foot[[near]], np.zeros(1, int), boundary.edges[[near], 1], boundary.edges[[near], 0])
    none = np.empty(0, int)
    return Viewpoints(goal[None], none, none, none)


def _goal_edges(
    corners: CornerVisibility, goal_table: VisibilityTable, goal: Float[np.ndarray, "2"]
) -> Int[np.ndarray, "edges 2"]:
    """Edges from the goal, vertex 0, to the corners: those that see one another are joined."""
    indices, points = np.arange(len(corners.corners.points)), corners.corners.points
    seen = corners.table.sees(indices, np.tile(goal, (len(indices), 1)))
    seen &= goal_table.sees(np.zeros_like(indices), points)
    return np.stack([np.zeros(seen.sum(), int), 1 + indices[seen]], axis=1)
