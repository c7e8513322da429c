"""Which sources the points of cells may use, for many goals of one workspace at once."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int, UInt64

from plr_jax._arrays import mixed, runs
from plr_jax._types import Sources
from plr_jax.geometry.box import Box
from plr_jax.geometry.convex_pieces import Pieces, areas, boxes_as_pieces, centers, clip, convex_pieces
from plr_jax.geometry.corners import CornerVisibility, ReflexCorners, TurnPoints
from plr_jax.geometry.shadows import Shadows, shadows_of
from plr_jax.geometry.vectors import turned_left
from plr_jax.geometry.visibility import VisibilityTable, joined_tables
from plr_jax.geometry.workspace import Workspace
from plr_jax.oracles.cells.cell_sources import VisibleSources, are_filled, settled_cells, undominated
from plr_jax.oracles.cells.sight import Sight, Walls

# Numbers for the sources of many goals, so that cells which differ between goals by a constant have the same ones.
#
# Which source is best in a piece, and how far others are from it, depends on the differences of the sources'
# distances alone. Behind a corner they are the same for all goals that are reached by way of it. So the sources of
# each cell are counted from the least of them, and a source and its distance from there are known by one number.


_NO_TURN = -1


class SharedCones:
    """Sources with their distances beyond the least of a cell, each kept once, in the order in which they came.

    A *kind* is a corner and the side on which paths bend around it, ``2 * corner + side``, or ``2 * view`` for a
    goal; the first ``num_turns`` kinds are those of corners.

    Args:
        points: The viewpoints, ``(views, 2)``: the corners, then the goals.
        num_turns: Twice the number of corners.
        step: Distances are kept as multiples of it, so that what differs by rounding is the same.
    """

    def __init__(self, points: Float[np.ndarray, "views 2"], num_turns: int, step: float) -> None:
        self._points, self._num_turns, self._step = points, num_turns, step
        self.kind, self._steps = np.zeros(0, np.int64), np.zeros(0, np.int64)
        self._sorted, self._place = np.zeros(0, np.uint64), np.zeros(0, np.int64)
        self._sources: Sources | None = None

    def numbers(self, kind: Int[np.ndarray, "n"], distance: Float[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
        """The number of each of some sources; of new ones, new numbers."""
        steps = np.rint(distance / self._step).astype(np.int64)
        keys, first, index = np.unique(
            mixed(kind) + mixed(steps ^ np.int64(1 << 62)), return_index=True, return_inverse=True
        )
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
        """The viewpoint of each."""
        return self.kind >> 1

    @property
    def turn(self) -> Int[np.ndarray, "sources"]:
        """The turn of each, -1 of goals."""
        return np.where(self.kind < self._num_turns, self.kind, _NO_TURN)

    @property
    def sources(self) -> Sources:
        """Where they are, and their distances."""
        if self._sources is None:
            self._sources = Sources(self._points[self.view], self._steps * self._step, np.arange(len(self.kind)))
        return self._sources


_STEP = 2.0**-44  # of the domain's width: in such steps distances beyond the least are kept
_AT_ONCE = 1 << 16  # pairs of a piece and a viewpoint


@dataclass(frozen=True, eq=False)
class GoalDistances:
    """What a family needs of one goal.

    Args:
        table: What the goal sees.
        corner: Corners that may bend a shortest path to it.
        side: 1 for those whose paths come around the wall that opens their sector, else 0.
        distance: Their distances.
    """

    table: VisibilityTable
    corner: Int[np.ndarray, "turns"]
    side: Int[np.ndarray, "turns"]
    distance: Float[np.ndarray, "turns"]


@dataclass(frozen=True, eq=False)
class SharedCells:
    """Boxes of a workspace, their free convex pieces, and which corners see them: the same for all goals.

    Pairs, of a piece and a corner around which paths bend on one side, stand piece by piece.
    """

    corners: CornerVisibility
    turns: TurnPoints
    walls: Walls
    domain: Box
    num_cells: int
    cell: Int[np.ndarray, "pieces"]
    pieces: Pieces
    origin: Int[np.ndarray, "pieces"]
    center: Float[np.ndarray, "pieces 2"]
    radius: Float[np.ndarray, "pieces"]
    piece: Int[np.ndarray, "pairs"]
    kind: Int[np.ndarray, "pairs"]
    by_all: Bool[np.ndarray, "pairs"]
    by_center: Bool[np.ndarray, "pairs"]
    length: Float[np.ndarray, "pairs"]

    @staticmethod
    def of(
        workspace: Workspace,
        corners: CornerVisibility,
        domain: Box,
        lo: Float[np.ndarray, "cells 2"],
        hi: Float[np.ndarray, "cells 2"],
    ) -> "SharedCells":
        """Those of some boxes in a domain."""
        turns, walls = _turns_by_side(corners.corners), Walls(workspace.boundary)
        cell, pieces, origin = _clipped_to_boxes(workspace, walls, lo, hi)
        center = centers(pieces)
        radius = np.sqrt(np.square(pieces - center.T[:, :, None]).sum(axis=0).max(axis=1))
        shadows = shadows_of(corners.table)
        parts = [np.zeros((4, 0), np.int64)]
        step = max(1, _AT_ONCE // max(1, len(corners.corners.points)))
        bounds = _seen_boxes(corners.table)
        for begin in range(0, len(cell), step):
            parts.append(_pairs_of_pieces(pieces, center, begin, begin + step, shadows, bounds, turns))
        piece, kind, by_all, by_center = np.concatenate(parts, axis=1)
        length = np.linalg.norm(center[piece] - corners.corners.points[kind >> 1], axis=1)
        seen = by_all > 0, by_center > 0
        return SharedCells(
            corners, turns, walls, domain, len(lo), cell, pieces, origin, center, radius, piece, kind, *seen, length
        )

    def of_goals(
        self, goals: Sequence[GoalDistances]
    ) -> tuple["FamilySources", UInt64[np.ndarray, "distinct"], Int[np.ndarray, "goals cells"]]:
        """The distinct cells of all goals, their keys, and which one each cell of each goal is, -1 if it has none."""
        table = joined_tables([self.corners.table, *(goal.table for goal in goals)])
        num_corners = len(self.corners.corners.points)
        cones = SharedCones(table.points, 2 * num_corners, _STEP * float(self.domain.width.max()))
        sight = Sight(cones, shadows_of(table), self.turns, self.walls)
        of_goal, piece, kind, distance, by_all, by_center = self._pairs(goals, sight, num_corners)
        node = of_goal * self.num_cells + self.cell[piece]
        order = np.lexsort((kind, piece, of_goal))
        of_goal, piece, kind, distance, by_all, by_center, node = (
            column[order] for column in (of_goal, piece, kind, distance, by_all, by_center, node)
        )
        distinct, node = np.unique(node, return_inverse=True)
        least = np.full(len(distinct), np.inf)
        np.minimum.at(least, node, distance)
        source = cones.numbers(kind, distance - least[node])
        new_piece = np.flatnonzero(np.append(True, (np.diff(piece) != 0) | (np.diff(node) != 0))[: len(piece)])
        of_piece = piece[new_piece]
        pair_piece = np.zeros(len(piece), np.int64)
        pair_piece[new_piece[1:]] = 1
        found = FamilySources(
            sight,
            len(distinct),
            node[new_piece],
            self.pieces[:, of_piece],
            self.origin[of_piece],
            self.center[of_piece],
            np.full(len(of_piece), np.inf),
            np.zeros(len(of_piece), np.int64),
            np.cumsum(pair_piece),
            source,
            by_all,
        )
        cell = mixed(distinct % self.num_cells)
        _, first, index = np.unique(found.keys(cell), return_index=True, return_inverse=True)
        rows = np.repeat(np.arange(len(distinct)), np.bincount(node, minlength=len(distinct)))
        keep = np.zeros(len(distinct), bool)
        keep[first] = True
        by_center = by_center[keep[rows]]
        place = np.cumsum(keep) - 1
        found = found.of_cells(np.flatnonzero(keep))
        found = undominated(found, np.ones(len(found.cell), bool), by_center).counted_from_least()
        keys = found.keys(cell[keep])
        result = np.full(len(goals) * self.num_cells, -1)
        result[distinct] = place[first[index]]
        result[distinct[np.diff(found.first_piece)[result[distinct]] == 0]] = -1
        return found, keys, result.reshape(len(goals), self.num_cells)

    def _pairs(self, goals: Sequence[GoalDistances], sight: Sight, num_corners: int) -> tuple[np.ndarray, ...]:
        """Goal, piece, kind, distance, and whether all of it or its center is seen, of all pairs that may matter."""
        num_pieces = len(self.cell)
        goal, piece, by_center, by_all = self._seen_by_goals(goals, sight, num_corners)
        beyond = np.linalg.norm(self.center[piece] - sight.shadows.table.points[num_corners + goal], axis=1)
        most = np.full((len(goals), num_pieces), np.inf)
        most[goal[by_all], piece[by_all]] = (beyond + self.radius[piece])[by_all]
        columns = [[goal, piece, 2 * (num_corners + goal), np.zeros(len(goal)), by_all, by_center]]
        first = np.flatnonzero(np.append(True, np.diff(self.piece) > 0)[: len(self.piece)])
        for number, each in enumerate(goals):
            distance = np.full(2 * num_corners, np.inf)
            distance[2 * each.corner + each.side] = each.distance
            distance = distance[self.kind]
            way = distance + self.length
            if len(first):
                farthest = np.where(self.by_all, way + self.radius[self.piece], np.inf)
                of_piece = self.piece[first]
                most[number, of_piece] = np.minimum(most[number, of_piece], np.minimum.reduceat(farthest, first))
            near = np.flatnonzero(
                (way - self.radius[self.piece] <= most[number, self.piece] + sight.tolerance) & np.isfinite(way)
            )
            count = np.full(len(near), number)
            columns.append(
                [count, self.piece[near], self.kind[near], distance[near], self.by_all[near], self.by_center[near]]
            )
        return tuple(np.concatenate(column) for column in zip(*columns, strict=True))

    def _seen_by_goals(
        self, goals: Sequence[GoalDistances], sight: Sight, num_corners: int
    ) -> tuple[np.ndarray, ...]:
        """Pairs of a goal and a piece of which it may see some, whether it sees the center, and all of it."""
        found = [np.zeros((4, 0), np.int64)]
        lo, hi = _seen_boxes(sight.shadows.table)
        lowest, highest = self.pieces.min(axis=2).T, self.pieces.max(axis=2).T
        for number in range(len(goals)):
            view = num_corners + number
            near = np.flatnonzero(((lowest <= hi[view]) & (highest >= lo[view])).all(axis=1))
            of_view = np.full(len(near), view)
            seen, alike = sight.shadows.see(of_view, self.pieces[:, near], self.center[near])
            some = seen | ~alike
            found.append(np.stack([of_view - num_corners, near, seen, seen & alike]).astype(np.int64)[:, some])
        goal, piece, seen, by_all = np.concatenate(found, axis=1)
        return goal, piece, seen > 0, by_all > 0


class FamilySources(VisibleSources):
    """Those of distinct cells: of cells of several goals that are alike but for a constant, one."""

    def distinct_parts(
        self,
        parent: Int[np.ndarray, "parts"],
        axis: Int[np.ndarray, "parts"],
        is_upper: Bool[np.ndarray, "parts"],
        lo: Float[np.ndarray, "parts 2"],
        hi: Float[np.ndarray, "parts 2"],
        cell: UInt64[np.ndarray, "parts"],
    ) -> tuple[
        "FamilySources", UInt64[np.ndarray, "distinct"], Int[np.ndarray, "distinct"], Int[np.ndarray, "parts"]
    ]:
        """Of parts of cells the distinct ones, their keys, a part that each is, and which one each part is.

        A part is told from others by the hash of its box, and by its pieces and pairs.
        """
        inherited, changed = self.cut(parent, axis, is_upper, lo, hi)
        _, first, index = np.unique(inherited.keys(cell), return_index=True, return_inverse=True)
        order = np.argsort(first)
        rank = np.argsort(order)
        first, index = first[order], rank[index]
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
        bounds = self.first_pair[self.first_piece]
        return mixed(total[bounds[1:]] - total[bounds[:-1]]) + cell

    @property
    def _shared(self) -> SharedCones:
        assert isinstance(self.sight.cones, SharedCones)
        return self.sight.cones

    def counted_from_least(self) -> "FamilySources":
        """The same with distances of sources beyond the least of their cell."""
        sources, cones, bounds = self.sources, self._shared, self.first_pair[self.first_piece]
        some = np.flatnonzero(np.diff(bounds))
        least = np.zeros(self.num_cells)
        if len(some):
            least[some] = np.minimum.reduceat(sources.distances[self.source], bounds[:-1][some])
        pairs = np.flatnonzero(least[self.cell[self.piece]] > 0)
        pieces = np.flatnonzero(least[self.cell] > 0)
        if not len(pairs):
            return self
        source, best, distance = self.source.copy(), self.best.copy(), self.distance.copy()
        for column, rows, cell in ((source, pairs, self.cell[self.piece[pairs]]), (best, pieces, self.cell[pieces])):
            each = column[rows]
            column[rows] = cones.numbers(cones.kind[each], sources.distances[each] - least[cell])
        distance[pieces] -= least[self.cell[pieces]]
        return replace(self, source=source, best=best, distance=distance)


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


def _clipped_to_boxes(
    workspace: Workspace, walls: Walls, lo: Float[np.ndarray, "cells 2"], hi: Float[np.ndarray, "cells 2"]
) -> tuple[Int[np.ndarray, "pieces"], Pieces, Int[np.ndarray, "pieces"]]:
    """Cells, pieces and the triangles of free space that they are parts of, box by box."""
    triangles = convex_pieces(workspace.free_space)
    lowest, highest = triangles.min(axis=2), triangles.max(axis=2)
    cell, origin = np.nonzero(
        (lowest[0] < hi[:, :1]) & (highest[0] > lo[:, :1]) & (lowest[1] < hi[:, 1:]) & (highest[1] > lo[:, 1:])
    )
    pieces = triangles[:, origin]
    for axis in range(2):
        for sign, bound in ((1.0, lo[:, axis]), (-1.0, hi[:, axis])):
            height = sign * (pieces[axis] - bound[cell, None])
            reaches = (height > 0).any(axis=1)
            cell, origin = cell[reaches], origin[reaches]
            pieces = clip(pieces[:, reaches], height[reaches])
    area = areas(pieces)
    filled = are_filled(cell, area, walls, lo, hi)
    some = (area > 0) & ~filled[cell]
    cell = np.append(cell[some], np.flatnonzero(filled))
    pieces = np.concatenate([pieces[:, some], boxes_as_pieces(lo[filled], hi[filled])], axis=1)
    origin = np.append(origin[some], np.full(np.count_nonzero(filled), -1))
    order = np.argsort(cell, kind="stable")
    return cell[order], pieces[:, order], origin[order]


def _pairs_of_pieces(
    pieces: Pieces,
    center: Float[np.ndarray, "pieces 2"],
    begin: int,
    end: int,
    shadows: Shadows,
    bounds: tuple[Float[np.ndarray, "views 2"], Float[np.ndarray, "views 2"]],
    turns: TurnPoints,
) -> Int[np.ndarray, "4 pairs"]:
    """Pieces from one to another, kinds of turns that are seen from some of each, and from all, and its center."""
    part = pieces[:, begin:end]
    lo, hi = bounds
    near = np.ones((part.shape[1], len(lo)), bool)
    for along, low, high in zip(part, lo.T, hi.T, strict=True):
        near &= (along.min(axis=1)[:, None] <= high) & (along.max(axis=1)[:, None] >= low)
    kinds = []
    for side in range(2):
        normal, points = turns.normal[1, side::2], turns.points[side::2]
        height = np.max(part[0][:, :, None] * normal[:, 0] + part[1][:, :, None] * normal[:, 1], axis=1)
        kinds.append(near & (height >= (normal * points).sum(axis=1) - turns.slack))
    piece, view = np.nonzero(kinds[0] | kinds[1])
    seen, alike = shadows.see(view, part[:, piece], center[begin + piece])
    some = seen | ~alike
    piece, view, seen, by_all = piece[some], view[some], seen[some], (seen & alike)[some]
    sides = np.stack([kinds[0][piece, view], kinds[1][piece, view]], axis=1)
    run, _ = runs(sides.sum(axis=1))
    kind = 2 * view[run] + np.nonzero(sides)[1]
    return np.stack([begin + piece[run], kind, by_all[run], seen[run]])
