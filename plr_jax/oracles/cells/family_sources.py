"""Which sources the points of cells may use, for many goals of one workspace at once."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int, UInt64

from plr_jax._arrays import mixed, runs
from plr_jax.geometry.box import Box
from plr_jax.geometry.convex_pieces import (
    PartCorner,
    PartIndex,
    PartSide,
    Pieces,
    centers,
    clip_to_boxes,
    convex_pieces,
)
from plr_jax.geometry.corners import CornerVisibility, ReflexCorners, TurnPoints
from plr_jax.geometry.shadows import shadows_of
from plr_jax.geometry.vectors import turned_left
from plr_jax.geometry.visibility import VisibilityTable, joined_tables
from plr_jax.geometry.workspace import Workspace
from plr_jax.oracles.cells.cell_sources import VisibleSources, filled, settled_cells, undominated
from plr_jax.oracles.cells.sight import SharedCones, Sight

_STEP = 2.0**-44  # of the domain's width: in such steps distances beyond the least are kept
_AT_ONCE = 1 << 16  # pairs of a piece and a viewpoint

Bounds: TypeAlias = tuple[Float[np.ndarray, "views 2"], Float[np.ndarray, "views 2"]]
GoalTurns: TypeAlias = tuple[VisibilityTable, Int[np.ndarray, "_"], Float[np.ndarray, "_"]]
"""What a goal sees, and the kinds of the corners that may bend a shortest path to it, with their distances."""


@dataclass(frozen=True, eq=False)
class SharedCells:
    """Boxes of a workspace, their free convex pieces, and which corners see them: the same for all goals.

    Attributes:
        corners: All corners.
        cells: The boxes. Their sources are kinds: corners, and the sides on which paths bend around them.
        radius: How far any point of each piece is from its center at most.
        length: How far the corner of each pair is from the center of its piece.
        by_center: Whether the center sees it.
        step: In such steps distances beyond the least are kept.
    """

    corners: CornerVisibility
    cells: "FamilySources"
    radius: Float[np.ndarray, "pieces"]
    length: Float[np.ndarray, "pairs"]
    by_center: Bool[np.ndarray, "pairs"]
    step: float

    @staticmethod
    def of(
        workspace: Workspace,
        corners: CornerVisibility,
        domain: Box,
        lo: Float[np.ndarray, "cells 2"],
        hi: Float[np.ndarray, "cells 2"],
    ) -> "SharedCells":
        """Those of some boxes in a domain."""
        points, step = corners.corners.points, _STEP * float(domain.width.max())
        # No source has a number yet: that takes the distances of goals.
        cones, turns = SharedCones(points, 2 * len(points), step), _turns_by_side(corners.corners)
        sight = Sight(cones, shadows_of(corners.table), turns, workspace.edge_tree)
        pieces, cell, origin = clip_to_boxes(convex_pieces(workspace.free_space), lo, hi)
        pieces, origin, stays, _ = filled(cell, pieces, origin, sight.walls, (lo, hi))
        cell, pieces, origin = cell[stays], pieces[:, stays], origin[stays]
        center, bounds = centers(pieces), _seen_boxes(corners.table)
        radius = np.sqrt(np.square(pieces - center.T[:, :, None]).sum(axis=0).max(axis=1))
        parts, at_once = [np.zeros((4, 0), np.int64)], max(1, _AT_ONCE // max(1, len(points)))
        for begin in range(0, len(cell), at_once):
            part = slice(begin, begin + at_once)
            piece, *found = _pairs_of_pieces(pieces[:, part], center[part], sight, bounds)
            parts.append(np.stack([begin + piece, *found]))
        piece, kind, by_all, by_center = np.concatenate(parts, axis=1)
        length = np.linalg.norm(center[piece] - points[kind >> 1], axis=1)
        unknown = np.full(len(cell), np.inf), np.zeros(len(cell), np.int64)
        of_pieces = cell, pieces, origin, center, *unknown
        cells = FamilySources(sight, len(lo), *of_pieces, piece, kind, by_all > 0)
        return SharedCells(corners, cells, radius, length, by_center > 0, step)

    def of_goals(
        self, goals: Sequence[GoalTurns]
    ) -> tuple["FamilySources", UInt64[np.ndarray, "distinct"], Int[np.ndarray, "goals cells"]]:
        """The distinct cells of all goals, their keys, and which one each cell of each goal is, -1 if it has none."""
        cells, table = self.cells, joined_tables([self.corners.table, *(table for table, _, _ in goals)])
        cones = SharedCones(table.points, len(cells.sight.turns.points), self.step)
        sight = replace(cells.sight, cones=cones, shadows=shadows_of(table))
        # First all cells of all goals: each goal's one after the other, and the pairs of these by piece and kind.
        of_goal, piece, kind, distance, by_all, by_center = self._pairs(goals, sight)
        order = np.lexsort((kind, piece, of_goal))
        row, piece = _numbered((of_goal * len(cells.cell) + piece)[order])
        number, row = np.divmod(row, len(cells.cell))
        node, cell = _numbered(number * cells.num_cells + cells.cell[row])
        least = np.full(len(node), np.inf)
        np.minimum.at(least, cell[piece], distance[order])
        source = cones.numbers(kind[order], distance[order] - least[cell[piece]])
        columns = {name: getattr(cells, name)[row] for name in ("origin", "center", "distance", "best")}
        columns |= {"cell": cell, "pieces": cells.pieces[:, row]}
        of_pairs = {"piece": piece, "source": source, "by_all": by_all[order]}
        found = replace(cells, sight=sight, num_cells=len(node), **columns, **of_pairs)
        # Then those that differ by more than a constant.
        box = mixed(node % cells.num_cells)
        first, index = _distinct(found.keys(box))
        by_center = by_center[order][np.isin(cell[piece], first)]
        found = found.of_cells(first)
        found = undominated(found, np.ones(len(found.cell), bool), by_center).counted_from_least()
        result = np.full(len(goals) * cells.num_cells, -1)
        result[node] = np.where(np.diff(found.first_piece)[index] > 0, index, -1)
        return found, found.keys(box[first]), result.reshape(len(goals), cells.num_cells)

    def _pairs(self, goals: Sequence[GoalTurns], sight: Sight) -> tuple[np.ndarray, ...]:
        """Goal, piece, kind, distance, and whether all of it or its center is seen, of all pairs that may matter."""
        cells, table, columns = self.cells, sight.shadows.table, []
        (lowest, highest), (lo, hi) = (cells.pieces.min(axis=2).T, cells.pieces.max(axis=2).T), _seen_boxes(table)
        first, num_corners = np.unique(cells.piece, return_index=True)[1], len(self.corners.corners.points)
        of_first, radius = cells.piece[first], self.radius[cells.piece]
        for number, (_, kinds, distances) in enumerate(goals):
            view = num_corners + number
            near = np.flatnonzero(((lowest <= hi[view]) & (highest >= lo[view])).all(axis=1))
            by_center, alike = sight.shadows.see(np.full(len(near), view), cells.pieces[:, near], cells.center[near])
            some = by_center | ~alike
            near, by_center, by_all = near[some], by_center[some], (by_center & alike)[some]
            goal, kind, none = np.full(len(near), number), np.full(len(near), 2 * view), np.zeros(len(near))
            columns.append((goal, near, kind, none, by_all, by_center))
            # Of corners those by which the way to some point of the piece may be shorter than another one is to all.
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
            near = np.flatnonzero((way - radius <= most[cells.piece] + sight.tolerance) & np.isfinite(way))
            of_pairs = cells.piece, cells.source, distance, cells.by_all, self.by_center
            columns.append((np.full(len(near), number), *(column[near] for column in of_pairs)))
        return tuple(np.concatenate(column) for column in zip(*columns, strict=True))


class FamilySources(VisibleSources):
    """Those of distinct cells: of cells of several goals that are alike but for a constant, one."""

    def distinct_parts(
        self,
        parent: PartIndex,
        axis: PartIndex,
        is_upper: PartSide,
        lo: PartCorner,
        hi: PartCorner,
        cell: UInt64[np.ndarray, "parts"],
    ) -> tuple["FamilySources", UInt64[np.ndarray, "distinct"], Int[np.ndarray, "distinct"], PartIndex]:
        """Of parts of cells the distinct ones, their keys, a part that each is, and which one each part is.

        A part is told from others by the hash of its box, and by its pieces and pairs.
        """
        inherited, changed = self.cut(parent, axis, is_upper, lo, hi)
        first, index = _distinct(inherited.keys(cell))
        changed = changed[np.isin(inherited.cell, first)]
        settled = settled_cells(inherited.of_cells(first), changed, lo[first], hi[first]).counted_from_least()
        return settled, settled.keys(cell[first]), first, index

    def views(self, source: Int[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
        """Viewpoints of sources: corners in their order, then goals in theirs."""
        return self.sight.cones.view[source]

    def keys(self, cell: UInt64[np.ndarray, "cells"]) -> UInt64[np.ndarray, "cells"]:
        """A hash of each cell: of its box, given by a hash, and of its pieces and pairs."""
        pair = mixed(self.source * 2 + self.by_all) + mixed(self.origin[self.piece] + (1 << 40))
        total = np.concatenate([np.zeros(1, np.uint64), np.cumsum(mixed(pair), dtype=np.uint64)])
        return mixed(np.diff(total[self.first_pair[self.first_piece]])) + cell

    def counted_from_least(self) -> "FamilySources":
        """The same with distances of sources beyond the least of their cell."""
        cones, distances = self.sight.cones, self.sources.distances
        assert isinstance(cones, SharedCones)
        least = np.full(self.num_cells, np.inf)
        np.minimum.at(least, self.cell[self.piece], distances[self.source])
        least = np.where(np.isfinite(least), least, 0.0)
        source, best, distance = self.source.copy(), self.best.copy(), self.distance - least[self.cell]
        for column, beyond in ((source, least[self.cell[self.piece]]), (best, least[self.cell])):
            rows = np.flatnonzero(beyond > 0)
            column[rows] = cones.numbers(cones.kind[column[rows]], distances[column[rows]] - beyond[rows])
        return replace(self, source=source, best=best, distance=distance)


def _numbered(keys: Int[np.ndarray, "n"]) -> tuple[Int[np.ndarray, "distinct"], Int[np.ndarray, "n"]]:
    """Of ascending numbers the distinct ones, and which of these each is."""
    new = np.append(True, keys[1:] != keys[:-1])[: len(keys)]
    return keys[new], np.cumsum(new) - 1


def _distinct(keys: UInt64[np.ndarray, "n"]) -> tuple[Int[np.ndarray, "distinct"], Int[np.ndarray, "n"]]:
    """Where each distinct key stands first, ascending, and which of these each key is."""
    _, first, index = np.unique(keys, return_index=True, return_inverse=True)
    order = np.argsort(first)
    return first[order], np.argsort(order)[index]


def _turns_by_side(corners: ReflexCorners) -> TurnPoints:
    """Turns around each corner on either side, whatever the way onward: in front of the far wall."""
    opens, closes = corners.walls
    normal = np.stack([-turned_left(closes), turned_left(opens)], axis=1).reshape(-1, 2)
    points = np.repeat(corners.points, 2, axis=0)
    kinds = np.arange(len(points))
    return TurnPoints(kinds, points, np.zeros(len(points)), np.stack([0 * normal, normal]), corners.slack)


def _seen_boxes(table: VisibilityTable) -> tuple[Float[np.ndarray, "views 2"], Float[np.ndarray, "views 2"]]:
    """Boxes that hold what each viewpoint sees: itself and the walls that it looks at."""
    view = np.repeat(np.arange(len(table.points)), np.diff(table.first))
    lo, hi = table.points.copy(), table.points.copy()
    looks = table.edge >= 0
    for ends in table.boundary.segments[table.edge[looks]].transpose(1, 0, 2):
        np.minimum.at(lo, view[looks], ends)
        np.maximum.at(hi, view[looks], ends)
    return lo - table.tolerance, hi + table.tolerance


def _pairs_of_pieces(
    pieces: Pieces, center: Float[np.ndarray, "pieces 2"], sight: Sight, bounds: Bounds
) -> tuple[np.ndarray, ...]:
    """Pieces, kinds of turns that are seen from some of each, and whether from all, and from its center."""
    (lo, hi), turns = bounds, sight.turns
    near = np.ones((pieces.shape[1], len(lo)), bool)
    for along, low, high in zip(pieces, lo.T, hi.T, strict=True):
        near &= (along.min(axis=1)[:, None] <= high) & (along.max(axis=1)[:, None] >= low)
    kinds = []
    for side in range(2):
        normal, points = turns.normal[1, side::2], turns.points[side::2]
        height = np.max(pieces[0][:, :, None] * normal[:, 0] + pieces[1][:, :, None] * normal[:, 1], axis=1)
        kinds.append(near & (height >= (normal * points).sum(axis=1) - turns.slack))
    piece, view = np.nonzero(kinds[0] | kinds[1])
    seen, alike = sight.shadows.see(view, pieces[:, piece], center[piece])
    some = seen | ~alike
    piece, view, seen, by_all = piece[some], view[some], seen[some], (seen & alike)[some]
    sides = np.stack([kinds[0][piece, view], kinds[1][piece, view]], axis=1)
    run, _ = runs(sides.sum(axis=1))
    return piece[run], 2 * view[run] + np.nonzero(sides)[1], by_all[run], seen[run]
