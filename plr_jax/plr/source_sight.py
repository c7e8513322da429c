"""Find out which sources of a PLR (corners and goals from which its cones measure distances) a point sees."""

from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Int
from scipy.spatial import KDTree

from plr_jax._types import Points
from plr_jax.geometry.graph import first_visible_in_parts
from plr_jax.geometry.vectors import distances_between
from plr_jax.geometry.visibility import viewpoints_at, visibility_of
from plr_jax.geometry.workspace import Workspace
from plr_jax.plr._plr import PLR


class SourceSight:
    """Tests of whether points see the sources of a PLR, the corners and goals from which its cones measure distances.

    ``rounding`` is a bound of the error of a source's position in the file, in workspace units.
    """

    def __init__(self, plr: PLR, workspace: Workspace, rounding: float):
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
        self._arrives = self._is_clear & (sources.offsets[root] <= rounding)

    def free_paths(
        self, x: Points, first: Int[np.ndarray, " n"]
    ) -> tuple[Int[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
        """Return the source (corner or goal) to which each start's path goes first, and whether the path is free.

        The starts are ``x``. ``first`` has the index of a source for each start: the source of its leaf. This source
        stays if the path through it is free and reaches the goal. Otherwise, it is replaced by the first source of
        the shortest free path to the goal, if there is a free path.
        """
        # 1. Test the given sources.
        is_free = self._is_clear[first] & self._sees(first, x)
        first = first.copy()
        failing = np.flatnonzero(~(is_free & self._arrives[first]))
        if not len(failing):
            return first, is_free
        # 2. Find the nearest visible source with a path to the goal. A segment of length zero is free if its point
        #    is: starts in obstacles see no source.
        failing = failing[self._workspace.is_visible(x[failing], x[failing], self._tolerance)]
        starts, sources = x[failing], np.flatnonzero(self._arrives)
        nearest, length = first_visible_in_parts(
            lambda rows: distances_between(starts[rows], self._points[sources]) + self._distances[sources],
            len(starts),
            len(sources),
            lambda start, source: self._sees(sources[source], starts[start]),
        )
        is_mended = np.isfinite(length[:, 0])
        is_free[failing[is_mended]] = True
        first[failing[is_mended]] = sources[nearest[is_mended, 0]]
        return first, is_free

    def _sees(self, source: Int[np.ndarray, " n"], x: Points) -> Bool[np.ndarray, " n"]:
        """Return whether each point ``x[i]`` sees the source ``source[i]``, up to the tolerance."""
        view = self._view[source]
        sees = view >= 0
        sees[sees] = self._table.sees(view[sees], x[sees])
        if len(pending := np.flatnonzero(~sees)):
            sees[pending] = self._workspace.is_visible(x[pending], self._points[source[pending]], self._tolerance)
        return sees


source_sight = lru_cache(maxsize=2)(SourceSight)
