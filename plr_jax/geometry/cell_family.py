"""Sources of cells (the goal, and corners where paths may turn first), for many goals of one workspace at once."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int, UInt64

from plr_jax._arrays import hash64
from plr_jax._types import Sources
from plr_jax.geometry.box import Box
from plr_jax.geometry.cell_sight import (
    CellSources,
    Shadows,
    corner_sight,
    turns_by_triangle,
)
from plr_jax.geometry.convex_pieces import PartCorner, PartIndex, PartSide
from plr_jax.geometry.corners import CornerVisibility
from plr_jax.geometry.triangulation import Triangulation
from plr_jax.geometry.visibility import VisibilityTable, joined_tables

_STEP = 2.0**-44  # resolution of relative distances, as a share of the domain's width

GoalTurns = tuple[VisibilityTable, Int[np.ndarray, "_"], Float[np.ndarray, "_"]]
"""The visibility polygon of a goal, and the turns on shortest paths to it: ``2 * corner + side``, and distance."""


class SharedSources:
    """A table of sources (goals, and corners where paths may turn first) of many goals, each stored once.

    Which source is best at a point, and by how much, depends only on differences of the sources' distances. Behind a
    corner these are equal for all goals that are reached through it. So distances are counted from the nearest source
    of each cell, in multiples of ``step``, and each pair of a kind and such a distance is stored once. A *kind* is a
    corner and the side on which paths bend around it, ``2 * corner + side``, or ``2 * view`` for a goal.
    """

    def __init__(self, points: Float[np.ndarray, "views 2"], num_turns: int, step: float) -> None:
        self._points, self._num_turns, self._step = points, num_turns, step
        self.kind, self._steps = np.zeros(0, np.int64), np.zeros(0, np.int64)
        self._sorted, self._place = np.zeros(0, np.uint64), np.zeros(0, np.int64)
        self._sources: Sources | None = None

    def indices_of(self, kind: Int[np.ndarray, "n"], distance: Float[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
        """Return the table index of each source (a kind and a relative distance); new sources are appended."""
        steps = np.rint(distance / self._step).astype(np.int64)
        hashes = hash64(kind) + hash64(steps ^ np.int64(1 << 62))
        keys, first, index = np.unique(hashes, return_index=True, return_inverse=True)
        at = np.searchsorted(self._sorted, keys)
        known = at < len(self._sorted)
        known[known] = self._sorted[at[known]] == keys[known]
        place = np.empty(len(keys), np.int64)
        place[known] = self._place[at[known]]
        new = np.flatnonzero(~known)
        if len(new):
            order = np.argsort(first[new])
            place[new[order]] = len(self.kind) + np.arange(len(new))
            self.kind = np.concatenate([self.kind, kind[first[new[order]]]])
            self._steps = np.concatenate([self._steps, steps[first[new[order]]]])
            self._sorted = np.insert(self._sorted, at[new], keys[new])
            self._place = np.insert(self._place, at[new], place[new])
            self._sources = None
        return place[index]

    @property
    def view(self) -> Int[np.ndarray, "sources"]:
        """Index of the viewpoint of each source: corners first, then goals."""
        return self.kind >> 1

    @property
    def turn(self) -> Int[np.ndarray, "sources"]:
        """Index ``2 * corner + side`` of each source's turn point, -1 for goals."""
        return np.where(self.kind < self._num_turns, self.kind, -1)

    @property
    def sources(self) -> Sources:
        """Points and relative distances of all sources in the table."""
        if self._sources is None:
            self._sources = Sources(self._points[self.view], self._steps * self._step, np.arange(len(self.kind)))
        return self._sources


class FamilySources(CellSources):
    """Sources of the cells of several goals; cells whose distances differ only by a constant are stored once."""

    is_family: ClassVar[bool] = True

    def distinct_parts(
        self,
        parent: PartIndex,
        axis: PartIndex,
        is_upper: PartSide,
        lo: PartCorner,
        hi: PartCorner,
        cell: UInt64[np.ndarray, "parts"],
    ) -> tuple["FamilySources", UInt64[np.ndarray, "distinct"], Int[np.ndarray, "distinct"], PartIndex]:
        """Cut parts off cells, as :meth:`CellSources.parts`, and keep those with distinct boxes, pieces or sources.

        ``cell`` holds a hash of each part's box. Return the distinct parts, a hash of each, the index of the first
        part equal to each, and for every part the index of its distinct part.
        """
        inherited, changed = self.cut(parent, axis, is_upper, lo, hi)
        first, index = _first_occurrences(inherited.keys(cell))
        changed = changed[np.isin(inherited.cell, first)]
        settled = inherited.of_cells(first).merge_free_boxes(changed, lo[first], hi[first]).relative_to_nearest()
        return settled, settled.keys(cell[first]), first, index

    def keys(self, cell: UInt64[np.ndarray, "cells"]) -> UInt64[np.ndarray, "cells"]:
        """Return a hash of each cell: of its box (whose hash is given), its convex pieces and their sources."""
        pair = hash64(self.source * 2 + self.by_all) + hash64(self.triangle[self.piece] + (1 << 40))
        total = np.concatenate([np.zeros(1, np.uint64), np.cumsum(hash64(pair), dtype=np.uint64)])
        return hash64(np.diff(total[self.first_pair[self.first_piece]])) + cell

    def relative_to_nearest(self) -> "FamilySources":
        """Return the cells with each cell's distances reduced by the least distance of its sources."""
        source_table, distances = self.sight.source_table, self.sources.distances
        least = np.full(self.num_cells, np.inf)
        np.minimum.at(least, self.cell[self.piece], distances[self.source])
        least = np.where(np.isfinite(least), least, 0.0)
        source, best, distance = self.source.copy(), self.best.copy(), self.distance - least[self.cell]
        for column, beyond in ((source, least[self.cell[self.piece]]), (best, least[self.cell])):
            rows = np.flatnonzero(beyond > 0)
            column[rows] = source_table.indices_of(
                source_table.kind[column[rows]], distances[column[rows]] - beyond[rows]
            )
        return replace(self, source=source, best=best, distance=distance)


@dataclass(frozen=True, eq=False)
class SharedCells:
    """Boxes of a workspace with what is the same for all goals: free convex pieces, and the corners that see them.

    ``radius`` is the largest distance from the center of each piece to a point of it. For each pair of a piece and a
    corner, ``length`` is the distance from the piece's center to the corner, and ``by_center`` says whether the
    center sees the corner. Distances of goals are rounded to multiples of ``step``.
    """

    corners: CornerVisibility
    cells: CellSources
    radius: Float[np.ndarray, "pieces"]
    length: Float[np.ndarray, "pairs"]
    by_center: Bool[np.ndarray, "pairs"]
    step: float

    @staticmethod
    def of(
        corners: CornerVisibility, triangulation: Triangulation, domain: Box, lo: PartCorner, hi: PartCorner
    ) -> "SharedCells":
        """Compute the free convex pieces of boxes in a domain, and the corners that see each piece."""
        lists = turns_by_triangle(corners, triangulation)
        cells = CellSources.of_boxes(corner_sight(corners, triangulation), lists, lo, hi)
        radius = np.sqrt(np.square(cells.pieces - cells.center.T[:, :, None]).sum(axis=0).max(axis=1))
        view, center = cells.source >> 1, cells.center[cells.piece]
        length = np.linalg.norm(center - corners.corners.points[view], axis=1)
        step = _STEP * float(domain.width.max())
        return SharedCells(corners, cells, radius, length, corners.table.sees(view, center), step)

    def of_goals(
        self, goals: Sequence[GoalTurns]
    ) -> tuple[FamilySources, UInt64[np.ndarray, "distinct"], Int[np.ndarray, "goals cells"]]:
        """Return distinct cells (boxes with sources), their hashes, and the index by goal and box (-1: no path)."""
        cells, table = self.cells, joined_tables([self.corners.table, *(table for table, _, _ in goals)])
        source_table = SharedSources(table.points, len(cells.sight.turns.points), self.step)
        sight = replace(cells.sight, source_table=source_table, shadows=Shadows.of(table), has_goal=True)
        # 1. List the cells of all goals, with pairs sorted by goal, piece and kind.
        of_goal, piece, kind, distance, by_all, by_center = self._pairs(goals, sight.shadows)
        order = np.lexsort((kind, piece, of_goal))
        row, piece = _group_sorted((of_goal * len(cells.cell) + piece)[order])
        number, row = np.divmod(row, len(cells.cell))
        node, cell = _group_sorted(number * cells.num_cells + cells.cell[row])
        least = np.full(len(node), np.inf)
        np.minimum.at(least, cell[piece], distance[order])
        source = source_table.indices_of(kind[order], distance[order] - least[cell[piece]])
        found = FamilySources(
            sight,
            len(node),
            cell,
            cells.pieces[:, row],
            cells.triangle[row],
            cells.center[row],
            cells.distance[row],
            cells.best[row],
            piece,
            source,
            by_all[order],
        )
        # 2. Keep cells that differ by more than a constant.
        box = hash64(node % cells.num_cells)
        first, index = _first_occurrences(found.keys(box))
        by_center = by_center[order][np.isin(cell[piece], first)]
        found = found.of_cells(first)
        found = found.prune_dominated(np.ones(len(found.cell), bool), by_center).relative_to_nearest()
        result = np.full(len(goals) * cells.num_cells, -1)
        result[node] = np.where(np.diff(found.first_piece)[index] > 0, index, -1)
        return found, found.keys(box[first]), result.reshape(len(goals), cells.num_cells)

    def _pairs(self, goals: Sequence[GoalTurns], shadows: Shadows) -> tuple[np.ndarray, ...]:
        """Return goal, piece, kind and distance of useful sources; whether all of the piece and its center see it."""
        cells, table, columns = self.cells, shadows.table, []
        lowest, highest = cells.pieces.min(axis=2).T, cells.pieces.max(axis=2).T
        first, num_corners = np.unique(cells.piece, return_index=True)[1], len(self.corners.corners.points)
        of_first, radius = cells.piece[first], self.radius[cells.piece]
        for number, (own, kinds, distances) in enumerate(goals):
            # 1. Pieces that the goal may see, near the bounding box of itself and the walls that it sees.
            ends = np.append(own.boundary.segments[own.edge[own.edge >= 0]].reshape(-1, 2), own.points, axis=0)
            lo, hi = ends.min(axis=0) - table.tolerance, ends.max(axis=0) + table.tolerance
            view, near = num_corners + number, np.flatnonzero(((lowest <= hi) & (highest >= lo)).all(axis=1))
            by_center, is_whole = shadows.see(np.full(len(near), view), cells.pieces[:, near], cells.center[near])
            some = by_center | ~is_whole
            near, by_center, by_all = near[some], by_center[some], (by_center & is_whole)[some]
            goal, kind, none = np.full(len(near), number), np.full(len(near), 2 * view), np.zeros(len(near))
            columns.append((goal, near, kind, none, by_all, by_center))
            # 2. Corners through which some point of a piece may be closer than the upper bound of the whole piece.
            most = np.full(len(cells.cell), np.inf)
            beyond = np.linalg.norm(cells.center[near] - table.points[view], axis=1) + self.radius[near]
            most[near[by_all]] = beyond[by_all]
            distance = np.full(2 * num_corners, np.inf)
            distance[kinds] = distances
            distance = distance[cells.source]
            way = distance + self.length
            if len(first):
                farthest = np.minimum.reduceat(np.where(cells.by_all, way + radius, np.inf), first)
                most[of_first] = np.minimum(most[of_first], farthest)
            near = np.flatnonzero((way - radius <= most[cells.piece] + table.tolerance) & np.isfinite(way))
            of_pairs = cells.piece, cells.source, distance, cells.by_all, self.by_center
            columns.append((np.full(len(near), number), *(column[near] for column in of_pairs)))
        return tuple(np.concatenate(column) for column in zip(*columns, strict=True))


def _group_sorted(keys: Int[np.ndarray, "n"]) -> tuple[Int[np.ndarray, "distinct"], Int[np.ndarray, "n"]]:
    new = np.append(True, keys[1:] != keys[:-1])[: len(keys)]
    return keys[new], np.cumsum(new) - 1


def _first_occurrences(keys: UInt64[np.ndarray, "n"]) -> tuple[Int[np.ndarray, "distinct"], Int[np.ndarray, "n"]]:
    _, first, index = np.unique(keys, return_index=True, return_inverse=True)
    order = np.argsort(first)
    return first[order], np.argsort(order)[index]
