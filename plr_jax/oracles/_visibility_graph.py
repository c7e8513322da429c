"""Exact shortest-path distance among polygons in the plane."""

import io
import math
import os
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from tokenize import TokenError
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int, Shaped, UInt64
from shapely.geometry import MultiPolygon, Polygon

from plr_jax._arrays import as_finite_point, as_point, as_points, deadline_after, set_fields, shortened
from plr_jax._files import write_atomically
from plr_jax._types import ArrayLike, Distances, Sources
from plr_jax.geometry.boundary import Boundary, Region, RingEdges, as_polygons, grid_of
from plr_jax.geometry.box import Box
from plr_jax.geometry.cell_sight import Sight
from plr_jax.geometry.changed_distances import ChangedDistances
from plr_jax.geometry.changes import Change, Looked, changed_triangulation, changed_visibility
from plr_jax.geometry.convex_pieces import areas
from plr_jax.geometry.corners import (
    CornerVisibility,
    TurnPoints,
    TurnRegions,
    corner_visibility,
    find_corners,
    find_turn_points,
    turn_regions,
)
from plr_jax.geometry.graph import Graph, dijkstra, path_to_root, rooted, to_networkx
from plr_jax.geometry.vectors import turned_left
from plr_jax.geometry.visibility import Viewpoints, VisibilityTable, joined_tables, visibility_of
from plr_jax.geometry.workspace import Workspace, require_workspace
from plr_jax.oracles._cell_sources import FamilySources, SharedCells, VisibleSources, goal_sight, lists_of_goal
from plr_jax.oracles._changed_distances import changed_distances
from plr_jax.oracles._pair_distances import PairDistances

if TYPE_CHECKING:
    import networkx


_LOST = 1e-6  # share of free space that rounding may lose


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
        shared: What the oracles of one workspace share, as :meth:`with_goal` passes it on; None: it is computed.
        goal_view: What the goal sees, if it is known; the goal is then known to be free.

    Attributes:
        workspace, goal: As given.
        distances: Distance of each vertex of ``graph`` to the goal, ``inf`` where it cannot be reached.

    Raises:
        ValueError: If the goal is not two finite numbers, lies in an obstacle or outside the bounds.
        TimeoutError: If the time limit passes first.

    References:
        de Berg et al., Computational Geometry (3rd ed.), chapter 15, by :mod:`plr_jax.geometry.visibility`.
    """

    workspace: Workspace
    goal: Float[np.ndarray, "2"]
    distances: Float[np.ndarray, "vertices"]
    _parents: Int[np.ndarray, "vertices"]
    _corners: CornerVisibility
    _goal_table: VisibilityTable
    _turns: TurnPoints
    _goal_edges: Int[np.ndarray, "edges 2"]
    _pairs: PairDistances
    is_lower_bound: ClassVar[bool] = True
    """True: no path of a robot whose reference point keeps to its free space is shorter."""
    dim: ClassVar[int] = 2
    """Number of coordinates of a point: 2."""

    def __init__(
        self,
        workspace: Workspace,
        goal: ArrayLike,
        *,
        time_limit: float | int = math.inf,
        shared: PairDistances | None = None,
        goal_view: Looked | None = None,
    ):
        require_workspace(workspace)
        deadline = deadline_after(time_limit)
        goal = _free_goal(workspace, goal) if goal_view is None else np.asarray(goal)
        if shared is None:
            shared = PairDistances(workspace, corner_visibility(workspace, deadline))
        corners = shared.visibility
        if goal_view is None:
            view = _goal_view(workspace.boundary, workspace.tolerance, goal)
            goal_table, (_, seen) = visibility_of(workspace.triangulation, view)
            goal_view = Looked(goal_table, corners.of_vertex[seen])
        # The goal, vertex 0, is joined to the corners that it sees and that see it.
        corner = np.setdiff1d(goal_view.corner, [-1])
        corner = corner[corners.table.sees(corner, np.tile(goal, (len(corner), 1)))]
        edges = np.stack([np.zeros_like(corner), 1 + corner], axis=1)
        set_fields(self, workspace=workspace, goal=goal, _corners=corners, _pairs=shared)
        set_fields(self, _goal_table=goal_view.table, _goal_edges=edges)
        distances, parents = dijkstra(self.graph, 0)
        turns = find_turn_points(corners.corners.with_goal(goal), distances, parents)
        set_fields(self, distances=distances, _parents=parents, _turns=turns)

    def with_goal(self, goal: ArrayLike) -> "VisibilityGraph":
        """The same workspace's oracle for another goal; corners and what they see are shared.

        Args:
            goal: The goal, ``(2,)``, in closed free space.

        Returns:
            The oracle.

        Raises:
            ValueError: As for the class.
        """
        return VisibilityGraph(self.workspace, goal, shared=self._pairs)

    def with_workspace(self, workspace: Workspace) -> "VisibilityGraph":
        """The oracle of a workspace that differs here and there, as :meth:`Workspace.with_obstacles` makes one.

        What the change does not meet is shared. Any workspace will do, but the more differs, the longer it takes.

        Args:
            workspace: The other workspace.

        Returns:
            The oracle for the same goal, as if made anew, up to rounding.

        Raises:
            ValueError: If the goal is not in its closed free space.
        """
        require_workspace(workspace)
        own, goal = self.workspace, self.goal
        if (own.tolerance, own.squeeze) != (workspace.tolerance, workspace.squeeze):
            return VisibilityGraph(workspace, goal)
        change = Change.between(own.boundary, workspace.boundary)
        if change.is_near(goal, own.tolerance):
            _free_goal(workspace, goal)
        if not workspace.is_triangulated:
            if (triangulation := changed_triangulation(own.triangulation, change)) is None:
                return VisibilityGraph(workspace, goal)
            workspace.use_triangulation(triangulation)
        view = _goal_view(workspace.boundary, workspace.tolerance, goal)
        old_view = Looked(self._goal_table, self._goal_edges[:, 1] - 1)
        corners, goal_view = changed_visibility(self._corners, old_view, view, workspace, change)
        return VisibilityGraph(workspace, goal, shared=PairDistances(workspace, corners), goal_view=goal_view)

    def save(self, path: str | os.PathLike) -> None:
        """Write what preparing the oracle has found to a file: NumPy arrays in a zip archive, without pickles.

        Args:
            path: The file. It is complete or absent: it is written under another name first, then renamed.

        Raises:
            OSError: If the file cannot be written.
        """
        write_visibility(Path(path), self.workspace, self.goal, self._corners)

    @classmethod
    def load(cls, path: str | os.PathLike) -> "VisibilityGraph":
        """Read an oracle that :meth:`save` wrote, without preparing its workspace again; it answers alike.

        Args:
            path: The file.

        Returns:
            The oracle. With :meth:`with_goal` it serves other goals.

        Raises:
            ValueError: If the file is truncated, corrupt, of another kind, or of another version.
            OSError: If the file cannot be read.
        """
        try:
            workspace, goal, corners = read_visibility(Path(path))
            return cls(workspace, goal, shared=PairDistances(workspace, corners))
        except (ValueError, EOFError, zipfile.BadZipFile, shapely.errors.ShapelyError) as error:
            reason = str(error).rstrip(".")
            raise ValueError(f"{path} cannot be read as a visibility graph: {reason}.") from error

    def __getstate__(self) -> dict[str, Any]:  # for another process: without what follows from the rest
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def __repr__(self) -> str:
        num_corners = len(self.graph.vertices) - 1
        return f"VisibilityGraph(goal={self.goal.tolist()}, {num_corners:,} corners, {len(self.graph.edges):,} edges)"

    @property
    def num_bytes(self) -> int:
        """Bytes of the arrays that a query reads and another goal needs, including what their oracles share."""
        turns = self._turns.num_bytes + self.regions.num_bytes
        own = self._goal_table.num_bytes + turns + self._parents.nbytes + self.distances.nbytes
        return self._corners.num_bytes + own

    @cached_property
    def graph(self) -> Graph:
        """The goal as vertex 0, then the corners, joined where a shortest path along the edge can turn at an end."""
        edges = np.concatenate([self._goal_edges, 1 + self._corners.edges])
        return Graph(np.concatenate([self.goal[None], self._corners.corners.points]), edges)

    @cached_property
    def regions(self) -> TurnRegions:
        turns = self._turns
        return turn_regions(turns, self.workspace.triangulation, self._corners.views[turns.vertex - 1])

    @cached_property
    def sources(self) -> Sources:
        """The goal and the corners, vertices of the graph: a path's next turn is one of them."""
        points = self._corners.corners.with_goal(self.goal).points
        return Sources(points, self.distances, rooted(self._parents))

    @cached_property
    def sight(self) -> Sight:
        """What tells which sources pieces of free space may use."""
        table = joined_tables([self._goal_table, self._corners.table])
        return goal_sight(self.sources, self._turns, table, self.workspace.triangulation)

    def cell_sources(self, domain: Box) -> VisibleSources:
        """Which sources points of a box may use, and which all of them can, piece by piece of free space.

        Args:
            domain: The box, as one cell, of which smaller ones can be cut. It may reach beyond the workspace.

        Returns:
            The pieces of free space in the box from which the goal can be reached, and their sources.

        Raises:
            ValueError: If not all of the free space around the goal is such: corners nearer to one another than the
                workspace's tolerance may hide it.
        """
        found = self.sources_of_boxes(domain.lo[None], domain.hi[None])
        around: Any = shapely.get_parts(self.workspace.free_space)
        around = around[shapely.dwithin(around, shapely.Point(self.goal), self.workspace.tolerance)]
        # Not clip_by_rect, which errs where edges end on sides of the box.
        around = shapely.intersection(around, shapely.box(*domain.lo, *domain.hi))
        area, outline = float(shapely.area(around).sum()), float(shapely.length(around).sum())
        rounded = _LOST * area + self.workspace.tolerance * outline
        if (reached := float(areas(found.pieces).sum())) < area - rounded:
            raise ValueError(
                f"The goal is found to be reached from {reached / area:.3g} of the free space that it lies in: where "
                "obstacles all but touch, corners are nearer to one another than the workspace's tolerance, "
                f"{self.workspace.tolerance:g}. Simplify the obstacles, or join them there."
            )
        return found

    def sources_of_boxes(self, lo: Float[np.ndarray, "cells 2"], hi: Float[np.ndarray, "cells 2"]) -> VisibleSources:
        """As :meth:`cell_sources`, of boxes as cells, whatever they are parts of.

        Args:
            lo: Their lower corners.
            hi: Their upper corners.

        Returns:
            The pieces of free space in them, and their sources.
        """
        return VisibleSources.of_boxes(self.sight, lists_of_goal(self.regions), lo, hi)

    def changed_since(self, before: "VisibilityGraph") -> ChangedDistances:
        """How distances have changed since another oracle of the same goal.

        Args:
            before: The other oracle.

        Returns:
            Where, and by how much.

        Raises:
            ValueError: If it is none, or of another goal.
        """
        if not isinstance(before, VisibilityGraph):
            raise ValueError(f"before must be a VisibilityGraph, got {shortened(before)}.")
        if (self.goal != before.goal).any():
            goals = f"{before.goal.tolist()} and {self.goal.tolist()}"
            raise ValueError(f"Both oracles must have one goal, got {goals}.")
        return changed_distances(before, self)

    @property
    def family(self) -> CornerVisibility:
        """What oracles share that :meth:`with_goal` makes of one another: the corners and what they see."""
        return self._corners

    def shared_cells(
        self, domain: Box, lo: Float[np.ndarray, "cells 2"], hi: Float[np.ndarray, "cells 2"]
    ) -> SharedCells:
        """What all of the family share of some boxes in a domain: pieces of free space, and corners that see them."""
        return SharedCells.of(self._corners, self.workspace.triangulation, domain, lo, hi)

    @staticmethod
    def family_sources(
        shared: SharedCells, fns: Sequence["VisibilityGraph"]
    ) -> tuple[FamilySources, UInt64[np.ndarray, "distinct"], Int[np.ndarray, "fns cells"]]:
        """The distinct sources of these boxes for some of the family, their keys, and which ones are each one's."""
        goals = []
        for fn in fns:
            corner, turns = fn._turns.vertex - 1, fn._turns
            # Paths come around the wall that opens a corner's sector, or around the one that closes it.
            side = (turns.normal[1] == turned_left(fn._corners.corners.walls[0, corner])).all(axis=1)
            goals.append((fn._goal_table, 2 * corner + side, turns.distance))
        return shared.of_goals(goals)

    def to_networkx(self) -> "networkx.Graph":
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
        return self._first_turns(self._points("x", x))[0]

    def is_free(self, x: ArrayLike) -> Bool[np.ndarray, "n"]:
        """As of the workspace: whether points ``(n, 2)`` are free, whether or not the goal can be reached."""
        return self.workspace.is_free(x)

    def between(self, x: ArrayLike, y: ArrayLike) -> Distances:
        """Length of the shortest path between points, pair by pair, whatever the goal.

        Ways between corners are searched when the first pair needs them, and kept for all oracles that
        :meth:`with_goal` makes of one another if there are at most 4,096 corners. If more, ask for many pairs a call.

        Args:
            x: Points, ``(n, 2)``.
            y: Points, ``(n, 2)``.

        Returns:
            Distances, ``(n,)``, in workspace units, as of oracles whose goals are ``y``, up to rounding; bit for bit
            the same either way round. ``inf`` as for a call, and where that is so of ``y``.

        Raises:
            ValueError: If a shape is another, or the numbers of points differ.
        """
        return self._pairs(self._points("x", x), self._points("y", y))

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
        x = as_point("The start", self.workspace.bounds.settled(x), 2)
        distance, turn = self._first_turns(x[None])
        if not np.isfinite(distance[0]):
            return np.empty((0, 2))
        return path_to_root(self.graph, self._parents, x, int(turn[0]))

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
        x = self._points("x", x)
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

    def _points(self, name: str, x: ArrayLike) -> Float[np.ndarray, "n 2"]:
        return as_points(name, self.workspace.bounds.settled(x), 2)

    def _first_turns(self, x: Float[np.ndarray, "n 2"]) -> tuple[Distances, Int[np.ndarray, "n"]]:
        """Distance, and the vertex that the path goes to first: 0, the goal, if it is straight or there is none."""
        distance, turn = np.full(len(x), np.inf), np.zeros(len(x), int)
        free = np.flatnonzero(self.workspace.is_free_to_tolerance(x))
        direct = self._goal_table.sees(np.zeros(len(free), int), x[free])
        seen, hidden = free[direct], x[free[~direct]]
        distance[seen] = np.linalg.norm(x[seen] - self.goal, axis=1)
        sees = self._corners.table.sees
        ways = self.regions.first_visible(hidden, lambda point, vertex: sees(vertex - 1, hidden[point]))
        turn[free[~direct]], distance[free[~direct]] = np.maximum(ways[0], 0), ways[1]
        return distance, turn


def _free_goal(workspace: Workspace, goal: ArrayLike) -> Float[np.ndarray, "2"]:
    if np.ndim(goal) == 2:
        raise ValueError(
            f"The goal must be one point (x, y), got an array of shape {np.shape(goal)}. For the nearest of several "
            "use NearestGoal([first, *map(first.with_goal, others)]), for a PLR of each construct_many."
        )
    goal = as_finite_point("The goal", workspace.bounds.settled(goal), 2)
    if not workspace.is_free_to_tolerance(goal[None])[0]:
        clearance = f"(clearance {workspace.clearance(goal[None])[0]:.3g})"
        is_in = workspace.bounds.contains(goal[None])[0]
        where = "in an obstacle" if is_in else f"outside the bounds {workspace.bounds}"
        raise ValueError(f"The goal {goal.tolist()} lies {where} {clearance}; move it into free space.")
    return goal


def _goal_view(boundary: Boundary, tolerance: float, goal: Float[np.ndarray, "2"]) -> Viewpoints:
    """The goal as a viewpoint, moved exactly onto the vertex or edge it lies on to within tolerance."""
    to_vertex = np.linalg.norm(boundary.vertices - goal, axis=1)
    if to_vertex.min() <= tolerance:
        vertex = to_vertex.argmin()
        edge = np.flatnonzero(boundary.edges[:, 0] == vertex)
        return Viewpoints(boundary.vertices[[vertex]], np.zeros(len(edge), int), edge)
    start, end = boundary.segments.transpose(1, 0, 2)
    share = ((goal - start) * (end - start)).sum(axis=1) / ((end - start) ** 2).sum(axis=1)
    foot = start + np.clip(share, 0, 1)[:, None] * (end - start)
    to_edge = np.linalg.norm(goal - foot, axis=1)
    near = to_edge.argmin()
    if to_edge[near] <= tolerance:
        return Viewpoints(foot[[near]], np.zeros(1, int), np.array([near]))
    none = np.empty(0, int)
    return Viewpoints(goal[None], none, none)


# Visibility graphs in files: a zip archive of NumPy arrays, without pickles, that ``np.load`` can read as well.


_VERSION = 1
_ARRAYS = {
    "version": ("i", ()),
    "bounds": ("f", (2, 2)),
    "squeeze": ("b", ()),
    "free_space": ("u", (None,)),
    "obstacles": ("u", (None,)),
    "goal": ("f", (2,)),
    "cut": ("f", (None, 2)),
    "first": ("i", (None,)),
    "key": ("f", (None,)),
    "edge": ("i", (None,)),
    "edges": ("i", (None, 2)),
}
"""Kind of the numbers of each array, and its shape, where None is any number."""


def write_visibility(
    path: Path, workspace: Workspace, goal: Float[np.ndarray, "2"], corners: CornerVisibility
) -> None:
    """Write what :func:`read_visibility` reads."""
    table, file = corners.table, io.BytesIO()
    geometries: Any = workspace.free_space, shapely.geometrycollections(list(workspace.obstacles))
    geometries = [np.frombuffer(shapely.to_wkb(each), np.uint8) for each in geometries]
    bounds = np.stack([workspace.bounds.lo, workspace.bounds.hi])
    of_corners = table.cut, table.first, table.key, table.edge, corners.edges
    values: Any = _VERSION, bounds, workspace.squeeze, *geometries, goal, *of_corners
    np.savez(file, **dict(zip(_ARRAYS, values, strict=True)))
    write_atomically(path, file.getvalue())


def read_visibility(path: Path) -> tuple[Workspace, Float[np.ndarray, "2"], CornerVisibility]:
    """The workspace, the goal, and what the corners see, of a file.

    Raises:
        ValueError, EOFError, BadZipFile, ShapelyError: If the file is truncated, corrupt, of another kind or version.
        OSError: If it cannot be read.
    """
    arrays = _arrays(path)
    if arrays["version"] != _VERSION:
        raise ValueError(f"it is of version {arrays['version']}, this release reads version {_VERSION}")
    free: Any
    free, obstacles = (shapely.from_wkb(arrays[name].tobytes()) for name in ("free_space", "obstacles"))
    polygons = as_polygons("Obstacle", obstacles)
    if not isinstance(free, Polygon | MultiPolygon) or free.is_empty or not free.is_valid:
        raise ValueError("its free space is no valid polygon")
    bounds = Box(*arrays["bounds"])
    boundary = RingEdges.of(free, 8 * grid_of(bounds)).boundary
    region = Region(free, boundary, False)
    workspace = Workspace(bounds, polygons, squeeze=bool(arrays["squeeze"]), region=region)
    return workspace, arrays["goal"], _corners(arrays, workspace)


def _arrays(path: Path) -> dict[str, Shaped[np.ndarray, "..."]]:
    """The arrays of a file, of the kinds and shapes that they must have, and no larger than the file."""
    data = io.BytesIO(path.read_bytes())  # so that only what cannot be read, and no wrong place in it, is an OSError
    arrays = {}
    try:
        with zipfile.ZipFile(data) as archive:
            missing = {f"{name}.npy" for name in _ARRAYS} - set(archive.namelist())
            if missing:
                raise ValueError(f"it has no {min(missing)}")
            for name, (kind, shape) in _ARRAYS.items():
                member = archive.getinfo(f"{name}.npy")
                if member.compress_type != zipfile.ZIP_STORED or member.file_size != member.compress_size:
                    raise ValueError(f"{name} is compressed")
                arrays[name] = _array(name, kind, shape, io.BytesIO(archive.read(member)))
    except RuntimeError as error:  # so zipfile calls what it has no code for, and what is encrypted
        raise ValueError(f"it cannot be unpacked: {error}") from error
    return arrays


def _array(name: str, kind: str, shape: tuple[int | None, ...], data: io.BytesIO) -> Shaped[np.ndarray, "..."]:
    np.lib.format.read_magic(data)
    try:
        found, _, dtype = np.lib.format.read_array_header_1_0(data)
    except (TokenError, SyntaxError, RecursionError, TypeError) as error:  # it is read as Python
        raise ValueError(f"{name} has a header that cannot be read") from error
    fits = len(found) == len(shape) and all(n in (None, m) for n, m in zip(shape, found, strict=True))
    if dtype.kind != kind or not fits:
        raise ValueError(f"{name} has numbers of kind {dtype.kind} and shape {found}")
    array = np.frombuffer(data.read(), dtype)
    if array.size != np.prod(found, dtype=object) or (kind == "f" and not np.isfinite(array).all()):
        raise ValueError(f"{name} is incomplete or has numbers that are not finite")
    return array.reshape(found)


def _corners(arrays: dict[str, Shaped[np.ndarray, "..."]], workspace: Workspace) -> CornerVisibility:
    """What the corners see, if the arrays are in order and name nothing that is not there."""
    corners, views = find_corners(workspace)
    count, num_walls = len(corners.points), len(workspace.boundary.edges)
    cut, first, key, edge, edges = (arrays[name] for name in ("cut", "first", "key", "edge", "edges"))
    counts = np.diff(first)
    if len(cut) != count or len(counts) != count or first[0] != 0 or not (counts > 0).all():
        raise ValueError(f"it has not one visibility polygon for each of {count} corners")
    if (np.abs((cut * cut).sum(axis=1) - 1) > 1e-9).any():
        raise ValueError("directions of its visibility polygons are no unit vectors")
    if not len(key) == len(edge) == first[-1]:
        raise ValueError("its visibility polygons are incomplete")
    turn = key - 4.0 * np.repeat(np.arange(count), counts)
    if (np.diff(key) < 0).any() or (turn < 0).any() or (turn > 4).any():
        raise ValueError("its visibility polygons are out of order")
    if (edge < -1).any() or (edge >= num_walls).any() or (edges < 0).any() or (edges >= count).any():
        raise ValueError("it names corners or walls that its workspace has not")
    table = VisibilityTable(workspace.boundary, workspace.tolerance, corners.points, cut, first, key, edge)
    return CornerVisibility(corners, views, table, edges)
