"""The public function :func:`trace`, which reads paths to the goal from a PLR of cones.

With a workspace, :func:`trace` also tests which sources of the PLR (corners and goals) each start sees.
"""

from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from plr_jax._arrays import as_points, require_type
from plr_jax._types import ArrayLike, Points
from plr_jax.geometry.graph import first_visible_in_parts
from plr_jax.geometry.vectors import distances_between
from plr_jax.plr._plr import PLR
from plr_jax.plr.leaves import as_sourced

if TYPE_CHECKING:
    from plr_jax.geometry.workspace import Workspace

_ROUNDING = 2.0**-24  # tolerance, in domain widths: four times the rounding of a source's coordinates in a file
Indices: TypeAlias = Int[np.ndarray, " n"]


class TraceStatus(IntEnum):
    """How the path from a start ended."""

    ARRIVED = 0
    """The path ends at the goal; without a workspace, it may cross walls."""
    OUTSIDE = 1
    """There is no path: the start is outside the domain or cut off from the goal, or a coordinate is NaN."""
    ENDED_ELSEWHERE = 2
    """The path ends at a corner; the file has the corner's distance to the goal, but not the next corner on the way.

    With a workspace, the start sees no other source with a free path to the goal either.
    """
    CROSSES_WALL = 3
    """The path is not free in the given workspace, and the start sees no source with a free path to the goal."""


@dataclass(frozen=True, eq=False)
class Traces:
    """Paths from many starts.

    Attributes:
        paths: Points of each path, ``(n, steps, dim)``, from the start along straight segments; the last point is
            repeated up to the length of the longest path. NaN if there is no path.
        counts: Number of distinct points of each path, ``(n,)``: 1 if the start is the goal, 0 without a path.
        lengths: Length of each path in the units of the domain, ``(n,)``; ``inf`` if there is no path.
        status: :class:`TraceStatus` of each path, ``(n,)``.
        are_tested: Whether segments were tested for collisions with a workspace.
    """

    paths: Float[np.ndarray, "n steps dim"]
    counts: Int[np.ndarray, " n"]
    lengths: Float[np.ndarray, " n"]
    status: Int[np.ndarray, " n"]
    are_tested: bool

    @property
    def arrived(self) -> Bool[np.ndarray, " n"]:
        """Whether each path ends at the goal and, if walls were tested, crosses none."""
        return self.status == TraceStatus.ARRIVED

    def __len__(self) -> int:
        return len(self.counts)

    def __repr__(self) -> str:
        walls = "" if self.are_tested else "; no walls were given to test"
        return f"Traces({int(self.arrived.sum()):,} of {len(self):,} starts arrive at the goal{walls})"


def trace(plr: PLR, starts: ArrayLike, workspace: "Workspace | None" = None) -> Traces:
    """Return paths to the goal from many starts, read from a PLR of cones.

    A cone measures distances from its *source*, the goal or a corner. The path leads from the start to the source of
    the start's leaf, then to the next source on the shortest path from there, and so on. A path that starts at the
    source of its leaf leads to the next source. A path that ends at the goal is as long as the PLR's value at the
    start, up to rounding. Segments between sources cross no wall, but for rounding. The first segment may cross a
    wall: it does if the start does not see the source of its leaf, or is in an obstacle. Where the PLR answers
    ``inf``, there is no path.

    With a workspace, no path that arrives crosses a wall. If a start does not see its leaf's source, or the path from
    that source does not lead to the goal, the start gets the shortest path through another source that it sees.

    Args:
        plr: PLR with ``leaf="cone"``.
        starts: Start points, ``(n, dim)``.
        workspace: Free space in which each segment is tested by itself, up to the rounding of the file (6e-8 of the
            domain's width). So a path that bends where two walls touch may pass between these walls. None: no tests.

    Raises:
        ValueError: If ``plr`` is no PLR of cones, ``starts`` has a wrong shape, ``workspace`` is no Workspace, or a
            workspace is given for a PLR that is not in the plane.
    """
    return trace_by_sources(plr, starts, workspace)[0]


def trace_by_sources(plr: PLR, starts: ArrayLike, workspace: "Workspace | None") -> tuple[Traces, Indices]:
    """Trace paths as :func:`trace`; also return the index of each path's first source (corner or goal), or -1."""
    require_type("plr", plr, PLR, "a PLR of cones")
    as_sourced(plr.leaf)
    sources, source_of_leaf = plr.stored.sources, plr.stored.source
    rounding = _ROUNDING * float(plr.domain.width.max())
    if workspace is not None:
        from plr_jax.geometry.workspace import Workspace  # needs Shapely, which a query does not

        require_type("workspace", workspace, Workspace, "a Workspace or None")
        if plr.dim != 2:
            raise ValueError(f"A workspace needs a PLR in the plane, got {plr.dim} dimensions: trace without it.")
    starts = plr.domain.settled(starts) if workspace is None else workspace.settled(starts, plr.domain)
    starts = as_points("starts", starts, plr.dim)
    inside = np.flatnonzero(plr.domain.contains(starts))
    leaf = plr.numpy().leaf(starts[inside])
    has_path, leaf = (each[~plr.unreachable[leaf]] for each in (inside, leaf))
    x, first = starts[has_path], source_of_leaf[leaf]
    is_free = np.ones(len(x), bool)
    if workspace is not None:
        first, is_free = _source_sight(plr, workspace, rounding).free_paths(x, first)

    # 1. Follow the parents of each distinct first source up to its root, which is its own parent. Column k of `chain`
    #    has the source after k steps; shorter chains repeat their root. Decoded sources have no cycles.
    source, row = np.unique(first, return_inverse=True)
    generations = [source]
    while (sources.parent[generations[-1]] != generations[-1]).any():
        generations.append(sources.parent[generations[-1]])
    chain = np.stack(generations, axis=1)

    # 2. Collect the points of the paths. Repeated roots add no length. A start that is a source is there twice: shift
    #    the path to drop it.
    corners = sources.points[chain]
    paths = np.concatenate([x[:, None], corners[row]], axis=1)
    lengths = np.linalg.norm(paths[:, 1] - x, axis=1)
    lengths += np.linalg.norm(np.diff(corners, axis=1), axis=2).sum(axis=1)[row]
    at_source = (paths[:, 1] == x).all(axis=1)
    counts = 2 - at_source + np.count_nonzero(chain[:, 1:] != chain[:, :-1], axis=1)[row]
    paths[at_source, :-1] = paths[at_source, 1:]
    paths = paths[:, : max(1, counts.max(initial=1))]

    # 3. Find how each path ends. Roots with numbers are goals, or places from which paths jump to other sources.
    status = np.where(sources.is_goal(chain[:, -1], rounding)[row], TraceStatus.ARRIVED, TraceStatus.ENDED_ELSEWHERE)
    status[~is_free] = TraceStatus.CROSSES_WALL

    # 4. Add rows for starts without a path.
    columns = []
    for rows, fill in (paths, np.nan), (counts, 0), (lengths, np.inf), (status, TraceStatus.OUTSIDE), (first, -1):
        columns.append(np.full((len(starts), *rows.shape[1:]), fill, rows.dtype))
        columns[-1][has_path] = rows
    *of_traces, first = columns
    return Traces(*of_traces, are_tested=workspace is not None), first


class _SourceSight:
    """Tests of whether points see the sources of a PLR, the corners and goals from which its cones measure distances.

    ``rounding`` is a bound of the error of a source's position in the file, in workspace units.
    """

    def __init__(self, plr: PLR, workspace: "Workspace", rounding: float):
        from plr_jax.geometry.visibility import viewpoints_at, visibility_of  # needs Shapely, which a query does not

        sources = plr.stored.sources
        self._distances = sources.offsets
        self._workspace = workspace
        self._tolerance = max(workspace.tolerance, rounding)  # files round sources
        # 1. Undo the rounding of corners: beside a point where two walls touch, a rounded one lies on either side.
        corners = workspace.boundary.vertices
        to_corner, nearest = KDTree(corners).query(sources.points)
        self._points = np.where((to_corner <= self._tolerance)[:, None], corners[nearest], sources.points)
        # 2. Compute what sources in free space see. The others have no view, -1.
        is_free = workspace.is_free(self._points)
        self._view = np.full(len(self._points), -1)
        points, self._view[is_free] = np.unique(self._points[is_free], axis=0, return_inverse=True)
        mesh = workspace.triangulation
        self._table, _ = visibility_of(mesh, viewpoints_at(mesh, points))
        # 3. Test the paths from all sources to their roots by pointer doubling: after round k, a source's path is
        #    tested up to `root`, its ancestor 2**k steps away; a root is its own parent.
        root = sources.parent
        self._is_clear = workspace.is_visible(self._points, self._points[root], self._tolerance)
        while (root[root] != root).any():
            self._is_clear &= self._is_clear[root]
            root = root[root]
        self._arrives = self._is_clear & sources.is_goal(root, rounding)

    def free_paths(self, x: Points, first: Indices) -> tuple[Indices, Bool[np.ndarray, " n"]]:
        """Return the source (corner or goal) to which each start's path goes first, and whether the path is free.

        The starts are ``x``. ``first`` has the index of a source for each start: the source of its leaf. This source
        stays if the path through it is free and reaches the goal. Otherwise, it is replaced by the first source of
        the shortest free path to the goal, if there is a free path.
        """
        # 1. Test the given sources.
        is_free = self._is_clear[first] & self._sees(first, x)
        first = first.copy()
        if not len(failing := np.flatnonzero(~(is_free & self._arrives[first]))):
            return first, is_free
        # 2. Find the nearest visible source with a path to the goal. A segment of length zero is free if its point
        #    is: starts in obstacles see no source.
        failing = failing[self._workspace.is_visible(x[failing], x[failing], self._tolerance)]
        starts, sources = x[failing], np.flatnonzero(self._arrives)

        def lengths(rows: slice) -> Float[np.ndarray, "rows sources"]:
            return distances_between(starts[rows], self._points[sources]) + self._distances[sources]

        def sees(start: Indices, source: Indices) -> Bool[np.ndarray, " n"]:
            return self._sees(sources[source], starts[start])

        nearest, length = first_visible_in_parts(lengths, len(starts), len(sources), sees)
        is_mended = np.isfinite(length[:, 0])
        is_free[failing[is_mended]] = True
        first[failing[is_mended]] = sources[nearest[is_mended, 0]]
        return first, is_free

    def _sees(self, source: Indices, x: Points) -> Bool[np.ndarray, " n"]:
        """Return whether point ``x[i]`` sees source ``source[i]``, up to the rounding of sources in files."""
        view = self._view[source]
        sees = view >= 0
        sees[sees] = self._table.sees(view[sees], x[sees])
        if len(pending := np.flatnonzero(~sees)):
            sees[pending] = self._workspace.is_visible(x[pending], self._points[source[pending]], self._tolerance)
        return sees


_source_sight = lru_cache(maxsize=2)(_SourceSight)
