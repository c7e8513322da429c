"""The public function :func:`trace`, which reads paths to the goal from a PLR of cones, without a map."""

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

_ROUNDING = 2.0**-24  # tolerance, in domain widths: four times the rounding of a source's coordinates in a file


class TraceStatus(IntEnum):
    """How the path from a start ended."""

    ARRIVED = 0
    """The path ends at the goal; without a workspace, it may cross walls."""
    OUTSIDE = 1
    """There is no path: the start is outside the domain, or a coordinate is NaN."""
    ENDED_ELSEWHERE = 2
    """The path ends at a corner; the file has its distance to the goal, but not the next corner on the way."""
    CROSSES_WALL = 3
    """A segment is not free in the given workspace."""


@dataclass(frozen=True, eq=False)
class Traces:
    """Paths from many starts.

    Attributes:
        paths: Points of each path, ``(n, steps, dim)``, from the start along straight segments; the last point is
            repeated up to the length of the longest path. NaN if there is no path.
        counts: Number of points of each path without repetitions, ``(n,)``: 1 if the start is the goal, 0 if there is
            no path.
        lengths: Length of each path in the units of the domain, ``(n,)``; ``inf`` if there is no path.
        status: :class:`TraceStatus` of each path, ``(n,)``.
        are_tested: Whether segments were tested for collisions with a workspace.
    """

    paths: Float[np.ndarray, "n steps dim"]
    counts: Int[np.ndarray, "n"]
    lengths: Float[np.ndarray, "n"]
    status: Int[np.ndarray, "n"]
    are_tested: bool

    @property
    def arrived(self) -> Bool[np.ndarray, "n"]:
        """Whether each path ends at the goal and, if walls were tested, crosses none."""
        return self.status == TraceStatus.ARRIVED

    def __len__(self) -> int:
        return len(self.counts)

    def __repr__(self) -> str:
        walls = "" if self.are_tested else "; no walls were given to test"
        return f"Traces({int(self.arrived.sum()):,} of {len(self):,} starts arrive at the goal{walls})"


def trace(plr: PLR, starts: ArrayLike, workspace: "Workspace | None" = None) -> Traces:
    """Return paths to the goal from many starts, read from a PLR of cones without a map.

    A cone measures distances from its *source*, the goal or a corner. The first segment leads to the source of the
    start's leaf, every further segment to the next source on the shortest path from there. So a path has at most as
    many segments as there are sources, and is as long as the PLR says. Segments between sources cross no wall, but
    for rounding. The first segment may cross one, if the start does not see the source of its leaf. A start in an
    obstacle, or cut off from the goal, gets a path through walls, which only the tests with a workspace detect.
    Computation is in double precision.

    Args:
        plr: PLR with ``leaf="cone"``.
        starts: Start points, ``(n, dim)``.
        workspace: Free space in which each segment is tested, up to the rounding of the file (6e-8 of the domain's
            width). Segments are tested one by one, so a path may pass through a point where two walls touch if it
            bends there. None: no tests.

    Returns:
        A path and a status for each start. If a start is a source, its path begins with the segment from that source
        to the next.

    Raises:
        ValueError: If ``plr`` is no PLR of cones, ``starts`` has a wrong shape, ``workspace`` is no Workspace, or a
            workspace is given for a PLR that is not in the plane.
    """
    if not isinstance(plr, PLR):
        raise ValueError(f"plr must be a PLR of cones, got {shortened(plr)}.")
    sources, source_of_leaf = as_sourced(plr.leaf).sources(plr.stored)
    if workspace is not None:
        from scipy.spatial import KDTree

        from plr_jax.geometry.workspace import Workspace  # needs Shapely, which a query does not

        if not isinstance(workspace, Workspace):
            raise ValueError(f"workspace must be a Workspace or None, got {shortened(workspace)}.")
        if plr.dim != 2:
            raise ValueError(
                f"A workspace needs a PLR in the plane, got {plr.dim} dimensions: trace without a workspace."
            )
    starts = as_points("starts", plr.domain.settled(starts), plr.dim)
    inside = np.flatnonzero(plr.domain.contains(starts))
    first = source_of_leaf[leaf_of(plr, starts[inside])]

    # 1. Follow the parents of sources up to the roots, which are repeated; decoded sources have no cycles.
    ways = [first]
    while (sources.parents[ways[-1]] != ways[-1]).any():
        ways.append(sources.parents[ways[-1]])
    way = np.stack(ways, axis=1)

    # 2. Collect the points of the paths; drop the start if it is a source.
    paths = np.concatenate([starts[inside, None], sources.points[way]], axis=1)
    at_source = (starts[inside] == sources.points[first]).all(axis=1)
    counts = 2 - at_source + np.count_nonzero(way[:, 1:] != way[:, :-1], axis=1)
    paths[at_source, :-1] = paths[at_source, 1:]
    paths = paths[:, : max(1, counts.max(initial=1))]

    # 3. Find how each path ends; segments between sources are tested once for all paths.
    rounding = _ROUNDING * float(plr.domain.width.max())
    is_at_goal = sources.distances[way[:, -1]] <= rounding
    status = np.where(is_at_goal, TraceStatus.ARRIVED, TraceStatus.ENDED_ELSEWHERE)
    if workspace is not None:
        # Undo the rounding of corners: beside a point where two walls touch, a rounded corner lies on either side.
        corners, tolerance = workspace.boundary.vertices, max(workspace.tolerance, rounding)
        away, corner = KDTree(corners).query(sources.points)
        points = np.where((away <= tolerance)[:, None], corners[corner], sources.points)
        used, place = np.unique(way, return_inverse=True)
        is_clear = workspace.is_visible(points[used], points[sources.parents[used]], tolerance)
        is_clear = is_clear[place.reshape(way.shape)].all(axis=1)
        is_clear &= workspace.is_visible(starts[inside], points[first], tolerance)
        status = np.where(is_clear, status, TraceStatus.CROSSES_WALL)
    lengths = np.linalg.norm(np.diff(paths, axis=1), axis=2).sum(axis=1)

    # 4. Add rows for starts outside the domain.
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
