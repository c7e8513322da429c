"""Exact shortest-path distance among polygons."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse
from jaxtyping import Float, Int
from scipy.sparse.csgraph import dijkstra

from plr_jax._arrays import as_finite_point, as_point, as_points
from plr_jax._geometry import cross
from plr_jax._types import ArrayLike, Distances
from plr_jax._workspace import Workspace
from plr_jax.oracles._visibility import Viewpoints, VisibilityTable, Walls, visibility_table

_CHUNK = 1 << 20
_NO_PARENT = -9999  # what scipy's dijkstra writes for the source and for what it does not reach


@dataclass(frozen=True, eq=False)
class _Corners:
    """The turning points of shortest paths, what each sees, and which see one another. Knows no goal.

    Args:
        table: Visibility polygons of the corners.
        opens: Unit vector along the wall with which each corner's sector opens, ``(c, 2)``; zero for the
            point contacts of a workspace with ``squeeze``, which may be turned around on any side.
        closes: The same for the wall with which it closes, ``(c, 2)``.
        pairs: Corners that see one another, ``(e, 2)``, both ways.
        lengths: Their distances, ``(e,)``.
    """

    table: VisibilityTable
    opens: Float[np.ndarray, "c 2"]
    closes: Float[np.ndarray, "c 2"]
    pairs: Int[np.ndarray, "e 2"]
    lengths: Float[np.ndarray, "e"]

    @property
    def num_bytes(self) -> int:
        walls = self.table.walls
        arrays = (self.opens, self.closes, self.pairs, self.lengths, walls.normal, walls.offset)
        return self.table.num_bytes + sum(a.nbytes for a in arrays)


@dataclass(frozen=True, eq=False)
class _Turns:
    """The corners at which a shortest path to one goal can turn first, and the points it can come from.

    At such a corner the path bends around the obstacle. With the way onward given, that leaves the points
    between the straight continuation and the far wall of the corner: those in front of two lines through it.

    Args:
        corner: Indices of the corners, ``(u,)``.
        points: The corners, ``(u, 2)``.
        distance: Their distances to the goal, ``(u,)``.
        normal: Normals of the lines through them, ``(2, u, 2)``; zero where any point will do.
        slack: How far behind the lines a point may lie.
    """

    corner: Int[np.ndarray, "u"]
    points: Float[np.ndarray, "u 2"]
    distance: Float[np.ndarray, "u"]
    normal: Float[np.ndarray, "2 u 2"]
    slack: float

    @property
    def num_bytes(self) -> int:
        return sum(a.nbytes for a in (self.corner, self.points, self.distance, self.normal))

    def path_lengths(self, x: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n u"]:
        """Length of the path by way of each corner; inf if it would not bend around the corner."""
        length = np.square(x[:, :1] - self.points[:, 0])
        length += np.square(x[:, 1:] - self.points[:, 1])
        np.sqrt(length, out=length)
        length += self.distance
        for normal in self.normal:
            height = x @ normal.T
            length[height < (self.points * normal).sum(axis=1) - self.slack] = np.inf
        return length


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

    Raises:
        ValueError: If the goal is not two finite numbers, lies in an obstacle or outside the bounds.

    References:
        de Berg et al., Computational Geometry (3rd ed.), chapter 15; visibility polygons as in
        :mod:`plr_jax.oracles._visibility`.
    """

    workspace: Workspace
    goal: Float[np.ndarray, "2"]
    _corners: _Corners
    _goal_table: VisibilityTable
    _parent: Int[np.ndarray, "c"]
    _turns: _Turns

    def __init__(self, workspace: Workspace, goal: ArrayLike):
        goal = _free_goal(workspace, goal)
        _assign(self, workspace, goal, _find_corners(workspace))

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

    @property
    def num_bytes(self) -> int:
        """Bytes of the arrays that a query reads, including what oracles of other goals share."""
        own = self._goal_table.num_bytes + self._parent.nbytes + self._turns.num_bytes
        return self._corners.num_bytes + own

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
            Vertices of the path, ``(m, 2)``, from ``x`` to the goal: at least two, equal if ``x`` is the
            goal; corners that the path only grazes may be among them. Empty, ``(0, 2)``, where the distance
            is ``inf``.

        Raises:
            ValueError: If ``x`` has another shape.
        """
        x = as_point("The start", x, 2)
        distance, turn = self._first_turns(x[None])
        if not np.isfinite(distance[0]):
            return np.empty((0, 2))
        path, corner = [x], int(turn[0])
        while corner >= 0:
            path.append(self._corners.table.points[corner])
            corner = int(self._parent[corner])
        inner = [p for p in path[1:] if (p != path[0]).any() and (p != self.goal).any()]
        return np.array([path[0], *inner, self.goal])

    def _first_turns(self, x: Float[np.ndarray, "n 2"]) -> tuple[Distances, Int[np.ndarray, "n"]]:
        """Distance, and the first corner of the path: -1 if it is straight or there is none."""
        distance, turn = np.full(len(x), np.inf), np.full(len(x), -1)
        free = np.flatnonzero(self.workspace.is_free(x))
        direct = self._goal_table.sees(np.zeros(len(free), int), x[free])
        seen = free[direct]
        distance[seen] = np.linalg.norm(x[seen] - self.goal, axis=1)
        hidden = free[~direct]
        step = max(1, _CHUNK // max(1, len(self._turns.corner)))
        for begin in range(0, len(hidden), step):
            rows = hidden[begin : begin + step]
            distance[rows], turn[rows] = self._best_corners(x[rows])
        return distance, turn

    def _best_corners(self, x: Float[np.ndarray, "n 2"]) -> tuple[Distances, Int[np.ndarray, "n"]]:
        """The least distance by way of a corner that sees the point, and that corner (-1: none does)."""
        best, turn = np.full(len(x), np.inf), np.full(len(x), -1)
        lengths, active, tries = self._turns.path_lengths(x), np.arange(len(x)), 2
        while len(active) and lengths.shape[1]:
            tries = min(tries, lengths.shape[1])
            order = np.argpartition(lengths, tries - 1, axis=1)[:, :tries]
            order = np.take_along_axis(order, np.argsort(np.take_along_axis(lengths, order, axis=1), axis=1), axis=1)
            least = np.take_along_axis(lengths, order, axis=1)
            row, column = np.nonzero(np.isfinite(least))
            seen = np.zeros(order.shape, dtype=bool)
            corner = self._turns.corner[order]
            seen[row, column] = self._corners.table.sees(corner[row, column], x[active[row]])
            found, pick = seen.any(axis=1), seen.argmax(axis=1)
            best[active[found]] = least[found, pick[found]]
            turn[active[found]] = corner[found, pick[found]]
            left = ~found & np.isfinite(least[:, -1]) & (tries < lengths.shape[1])
            active, lengths, tries = active[left], lengths[left], 4 * tries
        return best, turn


def _assign(oracle: VisibilityGraph, workspace: Workspace, goal: np.ndarray, corners: _Corners) -> None:
    goal_table = visibility_table(corners.table.walls, _goal_view(corners.table.walls, goal))
    distance, parent = _distances_to_goal(corners, goal_table, goal)
    for name, value in (
        ("workspace", workspace),
        ("goal", goal),
        ("_corners", corners),
        ("_goal_table", goal_table),
        ("_parent", parent),
        ("_turns", _find_turns(corners, distance, parent, goal)),
    ):
        object.__setattr__(oracle, name, value)


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


def _find_corners(workspace: Workspace) -> _Corners:
    """Reflex corners of free space and, where squeezing is allowed, point contacts; and who sees whom."""
    boundary, walls = workspace.boundary, Walls.of(workspace.boundary, workspace.tolerance)
    turns = boundary.is_reflex(1e-3 * workspace.tolerance)
    contacts = boundary.contacts if workspace.squeeze else np.empty(0, int)
    turns |= np.isin(boundary.edges[:, 0], contacts)
    sector = np.flatnonzero(turns)
    vertex, owner = np.unique(boundary.edges[sector, 0], return_inverse=True)
    opens, closes = boundary.edges[sector, 1], boundary.sector_end[sector]
    points = boundary.vertices[vertex]
    table = visibility_table(walls, Viewpoints(points, owner, opens, closes))
    pairs = _mutually_visible(table)
    lengths = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
    along = [np.zeros_like(points), np.zeros_like(points)]
    for direction, towards in zip(along, (opens, closes), strict=True):
        offset = boundary.vertices[towards] - points[owner]
        direction[owner] = offset / np.linalg.norm(offset, axis=1, keepdims=True)
        direction[np.isin(vertex, contacts)] = 0.0
    return _Corners(table, along[0], along[1], pairs, lengths)


def _mutually_visible(table: VisibilityTable) -> Int[np.ndarray, "e 2"]:
    """Ordered pairs of viewpoints that see one another, each within its own sector."""
    c = len(table.points)
    sees = np.zeros((c, c), dtype=bool)
    step = max(1, _CHUNK // max(1, c))
    for begin in range(0, c, step):
        v = np.arange(begin, min(c, begin + step)).repeat(c)
        x = np.tile(table.points, (len(v) // c, 1))
        sees[begin : begin + step] = table.sees(v, x).reshape(-1, c)
    np.fill_diagonal(sees, False)
    return np.argwhere(sees & sees.T)


def _goal_view(walls: Walls, goal: Float[np.ndarray, "2"]) -> Viewpoints:
    """The goal as a viewpoint, moved exactly onto the vertex or edge it lies on to within tolerance."""
    boundary = walls.boundary
    to_vertex = np.linalg.norm(boundary.vertices - goal, axis=1)
    if to_vertex.min() <= walls.tolerance:
        vertex = to_vertex.argmin()
        edge = np.flatnonzero(boundary.edges[:, 0] == vertex)
        ends = boundary.edges[edge, 1], boundary.sector_end[edge]
        return Viewpoints(boundary.vertices[[vertex]], np.zeros(len(edge), int), *ends)
    start, end = boundary.segments.transpose(1, 0, 2)
    share = ((goal - start) * (end - start)).sum(axis=1) / ((end - start) ** 2).sum(axis=1)
    foot = start + np.clip(share, 0, 1)[:, None] * (end - start)
    to_edge = np.linalg.norm(goal - foot, axis=1)
    near = to_edge.argmin()
    if to_edge[near] <= walls.tolerance:
        return Viewpoints(foot[[near]], np.zeros(1, int), boundary.edges[[near], 1], boundary.edges[[near], 0])
    none = np.empty(0, int)
    return Viewpoints(goal[None], none, none, none)


def _distances_to_goal(
    corners: _Corners, goal_table: VisibilityTable, goal: Float[np.ndarray, "2"]
) -> tuple[Float[np.ndarray, "c"], Int[np.ndarray, "c"]]:
    """Distance of each corner to the goal, and the next corner on the way: -1 if that is the goal."""
    points, c = corners.table.points, len(corners.table.points)
    indices = np.arange(c)
    seen = corners.table.sees(indices, np.tile(goal, (c, 1))) & goal_table.sees(np.zeros(c, int), points)
    near = np.flatnonzero(seen)
    # The goal becomes node c. SciPy keeps explicit zeros as edges, so a goal on a corner is no special case.
    tail = np.concatenate([corners.pairs[:, 0], np.full(len(near), c)])
    head = np.concatenate([corners.pairs[:, 1], near])
    length = np.concatenate([corners.lengths, np.linalg.norm(points[near] - goal, axis=1)])
    graph = scipy.sparse.csr_array((length, (tail, head)), shape=(c + 1, c + 1))
    distance, parent = dijkstra(graph, indices=c, return_predecessors=True)
    parent = np.where((parent == c) | (parent == _NO_PARENT), -1, parent)
    return distance[:c], parent[:c]


def _find_turns(
    corners: _Corners,
    distance: Float[np.ndarray, "c"],
    parent: Int[np.ndarray, "c"],
    goal: Float[np.ndarray, "2"],
) -> _Turns:
    """The corners that bend a shortest path to the goal, with the points that come around them."""
    points = corners.table.points
    onward = np.where(parent[:, None] < 0, goal, points[parent]) - points
    norm = np.linalg.norm(onward, axis=1, keepdims=True)
    onward = np.divide(onward, norm, out=np.zeros_like(onward), where=norm > 0)
    onward[(corners.opens == 0).all(axis=1)] = 0.0
    # The obstacle fills the corner from the closing wall counterclockwise to the opening one. If it is to
    # the left of the way onward, the path comes around the opening wall, else around the closing one.
    on_left = cross(onward, corners.opens + corners.closes) > 0
    side = np.where(on_left, 1.0, -1.0)[:, None]
    wall = np.where(on_left[:, None], corners.opens, corners.closes)
    normal = np.stack([side * _turned_left(onward), side * _turned_left(wall)])
    straight_on_is_blocked = (normal[0] * wall).sum(axis=1) < -1e-9
    useful = np.flatnonzero(np.isfinite(distance) & ~straight_on_is_blocked)
    slack = 100 * corners.table.walls.tolerance
    return _Turns(useful, points[useful], distance[useful], normal[:, useful], slack)


def _turned_left(u: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    return np.stack([-u[:, 1], u[:, 0]], axis=1)
