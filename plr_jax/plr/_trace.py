"""The way home from the file alone: from any point to its leaf's source, and on from source to source."""

from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from plr_jax._arrays import as_points, shortened
from plr_jax._types import ArrayLike
from plr_jax.plr._plr import PLR, leaf_of
from plr_jax.plr.leaves import as_sourced

if TYPE_CHECKING:
    from plr_jax.geometry.workspace import Workspace

_ROUNDING = 2.0**-24
"""Widths of the domain: four times what a file rounds the place of a source that is on no lattice."""


class TraceStatus(IntEnum):
    """How the path from a start ended."""

    ARRIVED = 0
    """At the goal; without a workspace, whether walls are in the way is not known."""
    OUTSIDE = 1
    """There is none: the start is outside the domain, or a coordinate is NaN."""
    ENDED_ELSEWHERE = 2
    """At a source from where the file knows only how far the goal is, not the way."""
    CROSSES_WALL = 3
    """Anywhere, but a leg is not free in the workspace that was given."""


@dataclass(frozen=True, eq=False)
class Traces:
    """Paths from many starts.

    Attributes:
        paths: From each start along straight legs to the path's end, which is repeated up to the length of the
            longest path, ``(n, steps, dim)``; NaN where there is no path.
        counts: Number of points of each path without the repetitions, ``(n,)``: 1 where the start is the goal, 0
            where there is no path.
        lengths: Length of each path, ``(n,)``, in the units of the domain; ``inf`` where there is none.
        status: How each path ended, a number of :class:`TraceStatus`, ``(n,)``.
        are_tested: Whether legs were tested in a workspace.
    """

    paths: Float[np.ndarray, "n steps dim"]
    counts: Int[np.ndarray, "n"]
    lengths: Float[np.ndarray, "n"]
    status: Int[np.ndarray, "n"]
    are_tested: bool

    @property
    def arrived(self) -> Bool[np.ndarray, "n"]:
        """Which paths end at the goal, and cross no wall that is known of."""
        return self.status == TraceStatus.ARRIVED

    def __len__(self) -> int:
        return len(self.counts)

    def __repr__(self) -> str:
        walls = "" if self.are_tested else "; no walls were given to test"
        return f"Traces({int(self.arrived.sum()):,} of {len(self):,} starts arrive at the goal{walls})"


def trace(plr: PLR, starts: ArrayLike, workspace: "Workspace | None" = None) -> Traces:
    """Paths to the goal from many starts, read from a PLR of cones alone, without a map.

    The first leg goes to the source of the start's leaf, every further one to the source that follows it on its own
    shortest path. So a path ends after at most as many legs as there are sources, and is as long as the PLR says.
    Where all sources are an oracle's, their own ways home cross no wall; only a first leg may, where the start does
    not see its leaf's source. The file knows no walls: a start in an obstacle, or cut off from the goal, is led
    straight through them, and only with the workspace given is that told.

    Runs on the host, in double precision: the leaves of all starts are found in one compiled query, the rest is
    looked up.

    Args:
        plr: The PLR, of leaves that have sources: built with ``leaf="cone"``.
        starts: Where to begin, ``(n, dim)``.
        workspace: Free space in which to test every leg, each alone, to within what a file rounds (6e-8 of the
            domain's width): a way that goes on at the very point where walls touch passes. None: nothing is tested.

    Returns:
        The paths, with a status for each. A start that is a source begins with the leg from there.

    Raises:
        ValueError: If it is no PLR, its leaves have no sources, or ``starts`` has another shape; with a workspace, if
            it is none, or the PLR is not in the plane.
    """
    if not isinstance(plr, PLR):
        raise ValueError(f"Only a PLR can be traced, got {shortened(plr)}.")
    sources, source_of_leaf = as_sourced(plr.leaf).sources(plr.stored)
    if workspace is not None:
        from plr_jax.geometry.workspace import Workspace  # needs Shapely, which a query does not

        if not isinstance(workspace, Workspace):
            raise ValueError(f"workspace must be a Workspace or None, got {shortened(workspace)}.")
        if plr.dim != 2:
            raise ValueError(f"A workspace is of the plane, but the PLR has {plr.dim} dimensions; trace without one.")
    starts = as_points("starts", plr.domain.settled(starts), plr.dim)
    inside = np.flatnonzero(plr.domain.contains(starts))
    first = source_of_leaf[leaf_of(plr, starts[inside])]

    # 1. Sources that paths go by, up to the roots, which are repeated; no file has sources that lead in a circle.
    ways = [first]
    while (sources.parents[ways[-1]] != ways[-1]).any():
        ways.append(sources.parents[ways[-1]])
    way = np.stack(ways, axis=1)

    # 2. Points of the paths, each once but for the last, which is repeated, and how many they are without that.
    paths = np.concatenate([starts[inside, None], sources.points[way]], axis=1)
    at_source = (starts[inside] == sources.points[first]).all(axis=1)
    counts = 2 - at_source + np.count_nonzero(way[:, 1:] != way[:, :-1], axis=1)
    paths[at_source, :-1] = paths[at_source, 1:]
    paths = paths[:, : max(1, counts.max(initial=1))]

    # 3. How each ends, and whether a leg meets a wall; that of a source to the next is tested once for all paths.
    rounding = _ROUNDING * float(plr.domain.width.max())
    is_at_goal = sources.distances[way[:, -1]] <= rounding
    status = np.where(is_at_goal, TraceStatus.ARRIVED, TraceStatus.ENDED_ELSEWHERE)
    if workspace is not None:
        used, place = np.unique(way, return_inverse=True)
        tolerance, onward = max(workspace.tolerance, rounding), sources.points[sources.parents[used]]
        is_clear = workspace.is_visible(sources.points[used], onward, tolerance)[place.reshape(way.shape)].all(axis=1)
        is_clear &= workspace.is_visible(starts[inside], sources.points[first], tolerance)
        status = np.where(is_clear, status, TraceStatus.CROSSES_WALL)
    lengths = np.linalg.norm(np.diff(paths, axis=1), axis=2).sum(axis=1)

    # 4. The same with rows for starts outside.
    def spread(column: Shaped[np.ndarray, "some *row"], fill: int | float) -> Shaped[np.ndarray, "n *row"]:
        every = np.full((len(starts), *column.shape[1:]), fill, column.dtype)
        every[inside] = column
        return every

    return Traces(
        spread(paths, np.nan),
        spread(counts, 0),
        spread(lengths, np.inf),
        spread(status, TraceStatus.OUTSIDE),
        workspace is not None,
    )
