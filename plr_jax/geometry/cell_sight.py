"""The corners that the cells of a partition see: for one goal, or for any goal.

The free part of a cell consists of convex *pieces*: the whole cell if no wall reaches into it, else parts of
triangles of free space. Each piece has *sources*: the corners, and the goal, that paths from some point of it may go
to first. When a cell is cut, its parts inherit pieces and sources, and sources are dropped that no path from the
piece turns at, or that no point of the piece sees.

Inside a free piece, visible and hidden points are separated by *shadows* only: rays from a corner onward, between the
nearer wall that ends there and the farther wall behind. If no shadow crosses a piece, all of it is visible if its
center is, else hidden.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import parts, ragged_indices, take_ragged
from plr_jax._types import Sources
from plr_jax.geometry.boundary import grid_at
from plr_jax.geometry.convex_pieces import (
    PartCorner,
    PartIndex,
    PartSide,
    Pieces,
    areas,
    boxes_as_pieces,
    centers,
    clip_to_boxes,
    contain,
    cut_parts,
    difference_of_cones,
    highest,
    lowest,
    next_corner,
)
from plr_jax.geometry.corners import CornerVisibility, ReflexCorners, TurnPoints, TurnRegions, views_by_triangle
from plr_jax.geometry.triangulation import Triangulation
from plr_jax.geometry.vectors import pseudo_angle, turned_left
from plr_jax.geometry.visibility import VisibilityTable, triangles_within

_CHUNK = 1 << 16  # pairs of a piece and a source tested at a time

OfPieces: TypeAlias = Bool[np.ndarray, "pieces"]
Corners: TypeAlias = Float[np.ndarray, "cells 2"]
SourceLists: TypeAlias = tuple[Int[np.ndarray, "triangles_plus_one"], Int[np.ndarray, "entries"]]
"""``(first, sources)``: the goal and corners ``sources[first[t] : first[t + 1]]`` see a part of triangle ``t``."""


@dataclass(frozen=True, eq=False)
class Shadows:
    """Parts of rays past a corner, between the nearer and the farther wall, sorted by viewpoint and direction.

    ``key`` is the pseudo-angle of a shadow from its viewpoint's zero direction (``VisibilityTable.cut``), plus 4
    times the viewpoint's index. ``unit`` is its direction; ``start`` and ``end`` are distances from the viewpoint.
    """

    table: VisibilityTable
    key: Float[np.ndarray, "shadows"]
    unit: Float[np.ndarray, "shadows 2"]
    start: Float[np.ndarray, "shadows"]
    end: Float[np.ndarray, "shadows"]

    @staticmethod
    def of(table: VisibilityTable) -> "Shadows":
        """Find the :class:`Shadows` around all viewpoints of a visibility table."""
        view = np.repeat(np.arange(len(table.points)), np.diff(table.first))
        row = np.flatnonzero(np.append(True, view[1:] != view[:-1])[: len(view)] == 0)
        view = view[row]
        # 1. Unit vectors towards the vertices at which intervals start.
        unit = table.boundary.vertices[table.vertex[row]] - table.points[view]
        length = np.linalg.norm(unit, axis=1)
        unit /= length[:, None]
        # 2. Distance along each direction to the walls of both adjacent intervals; 0 without a wall.
        reach = []
        for edge in (table.edge[row - 1], table.edge[row]):
            normal = table.boundary.normal[edge]
            height = (normal * table.points[view]).sum(axis=1) - table.boundary.offset[edge]
            toward = -(normal * unit).sum(axis=1)
            with np.errstate(divide="ignore", invalid="ignore"):
                at = np.where(edge < 0, 0.0, np.maximum(height, 0) / np.maximum(toward, 0))
            ends = (table.boundary.edges[edge] == table.vertex[row, None]).any(axis=1) & (edge >= 0)
            reach.append(np.where(ends, length, at))
        start, end = np.minimum(*reach), np.maximum(*reach)
        long = np.flatnonzero(end - start > grid_at(table.tolerance))
        return Shadows(table, table.key[row[long]], unit[long], start[long], end[long])

    def see(
        self, view: Int[np.ndarray, "pieces"], pieces: Pieces, center: Float[np.ndarray, "pieces 2"]
    ) -> tuple[OfPieces, OfPieces]:
        """Return whether each viewpoint sees its convex piece's center, and if it is known to see all or none."""
        point, grid = self.table.points[view], grid_at(self.table.tolerance)
        seen, is_whole = self.table.sees(view, center), np.ones(len(view), bool)
        # 1. Find the range of keys strictly inside each piece, and whether the cut lies in it.
        dx = pieces[0] - self.table.points[view, 0, None]
        dy = pieces[1] - self.table.points[view, 1, None]
        cx, cy = self.table.cut[view].T[:, :, None]
        key = pseudo_angle(cx * dx + cy * dy, cx * dy - cy * dx)
        distance = np.sqrt(dx * dx + dy * dy)
        blur = grid / np.maximum(distance, grid)
        apart = distance > grid
        wraps = highest(np.where(apart, key, -np.inf)) - lowest(np.where(apart, key, np.inf)) > 2
        key += np.where(wraps[:, None] & (key < 2), 4.0, 0.0)
        first = lowest(np.where(apart, key + blur, np.inf))
        last = highest(np.where(apart, key - blur, -np.inf))
        beyond = np.where(first >= 4, 4.0, 0.0)
        first, last, wraps = first - beyond, last - beyond, wraps & (first < 4)
        # 2. Look up the shadows with such keys, unless the piece contains its viewpoint.
        some = np.flatnonzero(~contain(pieces, point[:, None], grid)[:, 0])
        again = some[wraps[some]]  # a range that contains the cut is looked up in two parts
        begin = 4.0 * view[np.concatenate([some, again])]
        end = begin + np.concatenate([np.where(wraps, 4.0, last)[some], last[again] - 4])
        begin[: len(some)] += first[some]
        low, high = np.searchsorted(self.key, begin, side="right"), np.searchsorted(self.key, end, side="left")
        run, place = ragged_indices(np.maximum(high - low, 0))
        shadow, owner = low[run] + place, np.concatenate([some, again])[run]
        # 3. A shadow crosses a piece if it contains the middle of the chord that its ray cuts out.
        ux, uy = self.unit[shadow].T[:, :, None]
        dx, dy = pieces[0, owner] - point[owner, :1], pieces[1, owner] - point[owner, 1:]
        along, beside = ux * dx + uy * dy, ux * dy - uy * dx
        next_along, next_beside = next_corner(along), next_corner(beside)
        crosses = (beside >= 0) != (next_beside >= 0)
        share = np.divide(beside, beside - next_beside, out=np.zeros_like(beside), where=crosses)
        at = along + share * (next_along - along)
        near, far = lowest(np.where(crosses, at, np.inf)), highest(np.where(crosses, at, -1.0))
        middle = np.where(far > 0, (near + far) / 2, np.inf)
        is_whole[owner[(self.start[shadow] < middle) & (middle < self.end[shadow])]] = False
        return seen, is_whole


def turns_by_side(corners: ReflexCorners) -> TurnPoints:
    """Return two turn points per corner, ``2 * corner + side``: one for each side around which paths may bend."""
    opens, closes = turned_left(corners.walls)
    normal = np.stack([[-closes, -opens], [opens, closes]], axis=2).reshape(2, -1, 2)
    points = np.repeat(corners.points, 2, axis=0)
    return TurnPoints(np.arange(len(points)), points, np.zeros(len(points)), normal, corners.slack)


def turns_by_triangle(visibility: CornerVisibility, triangulation: Triangulation) -> SourceLists:
    """Return, for each triangle of free space, the turn points (:func:`turns_by_side`) that see a part of it."""
    visits, (right, left) = [], turns_by_side(visibility.corners).bounds
    for side in range(2):
        view, triangle = triangles_within(triangulation, visibility.views, right[side::2], left[side::2])
        visits.append(np.stack([2 * view + side, triangle]))
    return views_by_triangle(triangulation, np.concatenate(visits, axis=1))


@dataclass(frozen=True, eq=False)
class SightedSources:
    """Sources (goals and corners), with viewpoint and turn point (-1: a goal)."""

    sources: Sources
    view: Int[np.ndarray, "sources"]
    turn: Int[np.ndarray, "sources"]


@dataclass(frozen=True, eq=False)
class Sight:
    """Data that decide where paths from a convex piece may go first."""

    source_table: SightedSources
    shadows: Shadows
    turns: TurnPoints
    triangulation: Triangulation
    has_goal: bool

    @property
    def tolerance(self) -> float:
        """Distance behind a wall up to which a point counts as free."""
        return self.shadows.table.tolerance

    @cached_property
    def is_wall(self) -> Bool[np.ndarray, "triangles 3"]:
        """Whether each side of the triangles is a wall."""
        return (self.triangulation.wall >= 0).reshape(-1, 3)

    def may_bend(self, pieces: Pieces, source: Int[np.ndarray, "pieces"], from_all: bool = False) -> OfPieces:
        """Return, for each convex piece and its source, whether a shortest path from some point may turn there.

        The source is a corner, which the point is assumed to see, or the goal, where the answer is True. With
        ``from_all``, return whether paths from every point of the piece may turn there, without any tolerance.
        """
        turn = self.source_table.turn[source]
        may, corner = np.ones(len(source), bool), np.flatnonzero(turn >= 0)  # there may be none but the goal
        turn, (x, y) = turn[corner], pieces[:, corner]
        extreme, slack = (lowest, 0.0) if from_all else (highest, self.turns.slack)
        for normal in self.turns.normal[:, turn]:
            height = extreme(x * normal[:, :1] + y * normal[:, 1:])
            may[corner] &= height >= (normal * self.turns.points[turn]).sum(axis=1) - slack
        return may


@dataclass(frozen=True, eq=False)
class CellSources:
    """The free convex pieces of cells, and the sources that some point of each piece may go to first.

    A source is the goal or a corner at which a path may turn first. Pieces are sorted by ``cell``, pairs of a
    ``piece`` and a ``source`` by piece. If distances of sources are known, the distance of any point of a piece is
    at least the minimum of ``distances[s] + |x - points[s]|`` over its sources ``s``. It is at most the minimum over
    the sources that all of the piece sees. Both bounds hold to within :attr:`slack`. Pieces without a path to the
    goal are then left out, so that each piece has a source.

    Attributes:
        triangle: The triangle that contains each piece; -1 for a box that no wall reaches into.
        center: A point inside each piece.
        distance: Distance of each center to the goal, or an upper bound if no source is known to see the center;
            ``inf`` if it was not computed.
        best: The source that the shortest path from each center goes to first, or one near it; 0 if not computed.
        by_all: Whether every point of the pair's piece is known to see its source.
    """

    sight: Sight
    num_cells: int
    cell: Int[np.ndarray, "pieces"]
    pieces: Pieces
    triangle: Int[np.ndarray, "pieces"]
    center: Float[np.ndarray, "pieces 2"]
    distance: Float[np.ndarray, "pieces"]
    best: Int[np.ndarray, "pieces"]
    piece: Int[np.ndarray, "pairs"]
    source: Int[np.ndarray, "pairs"]
    by_all: Bool[np.ndarray, "pairs"]

    @classmethod
    def of_boxes(cls, sight: Sight, lists: SourceLists, lo: Corners, hi: Corners) -> Self:
        """Return the free convex pieces of boxes, each box a cell; ``lists`` holds the sources to try by triangle."""
        first, source = lists
        triangles = np.ascontiguousarray(sight.triangulation.triangles.transpose(2, 0, 1))
        pieces, cell, triangle = clip_to_boxes(triangles, lo, hi)
        chunks = []
        for chunk in parts(np.diff(first)[triangle], _CHUNK) or [slice(0, 0)]:
            entry, piece = take_ragged(first, triangle[chunk])
            count, part = len(cell[chunk]), pieces[:, chunk]
            unknown = np.full(count, np.inf), np.zeros(count, int), piece, source[entry], np.zeros(len(piece), bool)
            found = cls(sight, len(lo), cell[chunk], part, triangle[chunk], centers(part), *unknown)
            chunks.append(found.prune_sources(np.ones(count, bool)))
        found = chunks[0].append(*chunks[1:])
        found = replace(found, num_cells=len(lo), cell=found.cell % max(1, len(lo)))
        return found.merge_free_boxes(np.zeros(len(found.cell), bool), lo, hi)

    @property
    def slack(self) -> float:
        """Error of the bounds of distances that sources give, since free space is known to a tolerance."""
        return 4 * self.sight.tolerance

    @property
    def sources(self) -> Sources:
        """Points of all sources (goal and corners), and their distances to the goal."""
        return self.sight.source_table.sources

    def hold(self, piece: Int[np.ndarray, "n"], points: Float[np.ndarray, "n k 2"]) -> Bool[np.ndarray, "n k"]:
        """Return whether each given convex piece contains its ``k`` points, or is within ``sight.tolerance``."""
        return contain(self.pieces[:, piece], points, self.sight.tolerance)

    def see(self, source: Int[np.ndarray, "n"], points: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, "n"]:
        """Return whether each source (goal or corner) sees its point of free space."""
        return self.sight.shadows.table.sees(self.views(source), points)

    def views(self, source: Int[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
        """Return the index of each source's viewpoint in the visibility table."""
        return self.sight.source_table.view[source]

    def pieces_as_cells(self, rows: Int[np.ndarray, "some"]) -> Self:
        """Return some convex pieces, each as a cell of its own."""
        return replace(self.of_pieces(rows), num_cells=len(rows), cell=np.arange(len(rows)))

    @cached_property
    def first_piece(self) -> Int[np.ndarray, "cells_plus_one"]:
        """Index of the first convex piece of each cell, then the number of pieces."""
        return np.searchsorted(self.cell, np.arange(self.num_cells + 1))

    @cached_property
    def first_pair(self) -> Int[np.ndarray, "pieces_plus_one"]:
        """Index of the first source of each convex piece, then the number of pairs of a piece and a source."""
        return np.searchsorted(self.piece, np.arange(len(self.cell) + 1))

    def of_cells(self, cells: Int[np.ndarray, "some"]) -> Self:
        """Select cells, in any order, possibly repeated."""
        rows, cell = take_ragged(self.first_piece, cells)
        return replace(self.of_pieces(rows), num_cells=len(cells), cell=cell)

    def of_pieces(self, rows: Int[np.ndarray, "some"]) -> Self:
        """Select convex pieces; the cells stay, and may become empty."""
        if len(rows) == len(self.cell) and (rows == np.arange(len(rows))).all():
            return self
        pairs, piece = take_ragged(self.first_pair, rows)
        columns = {name: getattr(self, name)[rows] for name in ("cell", "triangle", "center", "distance", "best")}
        return replace(self.of_pairs(pairs), pieces=self.pieces[:, rows], piece=piece, **columns)

    def of_pairs(self, pairs: Int[np.ndarray, "some"] | Bool[np.ndarray, "pairs"]) -> Self:
        """Select pairs of a piece and a source."""
        return replace(self, piece=self.piece[pairs], source=self.source[pairs], by_all=self.by_all[pairs])

    def append(self, *others: Self) -> Self:
        """Concatenate the cells, with their pieces and sources, of several objects."""
        several = (self, *others)
        columns = {
            name: np.concatenate([getattr(each, name) for each in several], axis=int(name == "pieces"))
            for name in ("cell", "pieces", "triangle", "center", "distance", "best", "piece", "source", "by_all")
        }
        # Shift the indices of cells and pieces by the numbers in the preceding objects.
        for name, counts in (("cell", [e.num_cells for e in several]), ("piece", [len(e.cell) for e in several])):
            columns[name] += np.repeat(np.cumsum([0, *counts[:-1]]), [len(getattr(each, name)) for each in several])
        return replace(self, num_cells=sum(each.num_cells for each in several), **columns)

    def parts(self, parent: PartIndex, axis: PartIndex, is_upper: PartSide, lo: PartCorner, hi: PartCorner) -> Self:
        """Return boxes ``lo`` to ``hi``, each cut off its cell ``parent`` across ``axis``, as cells with sources."""
        part, is_cut = self.cut(parent, axis, is_upper, lo, hi)
        return part.merge_free_boxes(is_cut, lo, hi)

    def cut(
        self, parent: PartIndex, axis: PartIndex, is_upper: PartSide, lo: PartCorner, hi: PartCorner
    ) -> tuple[Self, OfPieces]:
        """Return parts of cells, whose pieces keep all sources of the uncut pieces, and which pieces were cut."""
        pieces, cell, rows, is_cut = cut_parts(self.pieces, self.first_piece, parent, axis, is_upper, lo, hi)
        return replace(self.of_pieces(rows), num_cells=len(parent), cell=cell, pieces=pieces), is_cut

    def merge_free_boxes(self, changed: OfPieces, lo: Corners, hi: Corners) -> Self:
        """Merge the convex pieces of boxes that no wall reaches into; drop needless sources of changed pieces."""
        cells, found = np.flatnonzero(np.diff(self.first_piece) > 1), self
        rows, of = take_ragged(self.first_piece, cells)
        row, side = np.nonzero(self.sight.is_wall[self.triangle[rows]])
        triangle, of = self.triangle[rows[row]], of[row]
        start, end = (self.sight.triangulation.triangles[triangle, each] for each in (side, (side + 1) % 3))
        # Separating axis test of walls and boxes. Walls in a box are sides of the triangles of its pieces.
        from_middle, half = (start + end) / 2 - ((lo + hi) / 2)[cells[of]], ((hi - lo) / 2)[cells[of]]
        along = np.abs(end - start) / 2
        beside = np.abs(from_middle[:, 0] * (end - start)[:, 1] - from_middle[:, 1] * (end - start)[:, 0])
        meets = (np.abs(from_middle) < half + along).all(axis=1) & (beside < 2 * (along * half[:, ::-1]).sum(axis=1))
        is_free = np.zeros(self.num_cells, bool)
        is_free[cells] = ~np.isin(np.arange(len(cells)), of[meets])
        is_merged = is_free[self.cell]
        stays = (areas(self.pieces) > 0) & ~is_merged
        if is_free.any():
            # The merged piece has the sources of all pieces; none is known to be visible from all of it.
            owner = np.where(is_merged, self.first_piece[self.cell], np.arange(len(stays)))
            keys = owner[self.piece] * np.int64(max(self.source.max(initial=0), 0) + 1) + self.source
            pieces, triangle = self.pieces.copy(), self.triangle.copy()
            whole = self.first_piece[:-1][is_free]
            pieces[:, whole], triangle[whole], stays[whole] = boxes_as_pieces(lo[is_free], hi[is_free]), -1, True
            found = replace(self.of_pairs(np.unique(keys, return_index=True)[1]), pieces=pieces, triangle=triangle)
            found = replace(found, piece=owner[found.piece], by_all=found.by_all & ~is_merged[found.piece])
        kept = np.flatnonzero(stays)
        return replace(found.of_pieces(kept), num_cells=len(lo)).prune_sources((changed | is_merged)[kept])

    def prune_sources(self, changed: OfPieces) -> Self:
        """Drop sources of changed pieces at which no path turns, or which no point of the piece sees or needs.

        If distances are known, pieces without a path to the goal are dropped as well.
        """
        # 1. Compute the centers of changed pieces. A path through the old center bounds their distances, since both
        #    centers lie in one convex piece.
        center, has_goal = self.center.copy(), self.sight.has_goal
        center[changed] = centers(self.pieces[:, changed])
        found = replace(self, center=center, distance=self.distance + np.linalg.norm(center - self.center, axis=1))
        # 2. Test which pairs may matter, and whether the center or all of the piece sees the source. Pairs that are
        #    not tested stay and count as visible from the center.
        pairs = np.flatnonzero(changed[self.piece] & ~(self.by_all & has_goal))
        bends = self.sight.may_bend(self.pieces[:, self.piece[pairs]], self.source[pairs])
        keep, by_center, by_all = np.ones(len(self.piece), bool), np.ones(len(self.piece), bool), self.by_all.copy()
        by_center[pairs], keep[pairs] = by_all[pairs], bends
        pairs = pairs[bends & ~by_all[pairs]]
        piece, view = self.piece[pairs], self.views(self.source[pairs])
        seen, is_whole = self.sight.shadows.see(view, self.pieces[:, piece], center[piece])
        by_all[pairs], by_center[pairs], keep[pairs] = seen & is_whole, seen, seen | ~is_whole
        if not has_goal:
            return replace(found, by_all=by_all).of_pairs(keep)
        # Far from the origin, rounding may remove all sources of a very thin piece; it then keeps what it had.
        keep |= (np.bincount(found.piece[keep], minlength=len(changed)) == 0)[found.piece]
        return replace(found, by_all=by_all).of_pairs(keep).prune_dominated(changed, by_center[keep])

    def prune_dominated(self, changed: OfPieces, by_center: Bool[np.ndarray, "pairs"]) -> Self:
        """Compute the distances of changed centers, and drop sources that are nowhere in the piece the best.

        A source is also dropped if a path through the center is shorter from every point of the piece. A center
        without a visible source keeps the bound of its distance.
        """
        sources, pairs = self.sources, np.flatnonzero(changed[self.piece] & by_center)
        # 1. Find the best source of each center; ties prefer sources that all of the piece sees.
        piece, source = self.piece[pairs], self.source[pairs]
        length = sources.distances[source] + np.linalg.norm(self.center[piece] - sources.points[source], axis=1)
        order = np.lexsort((source, ~self.by_all[pairs], length, piece))
        order = order[np.append(True, piece[order[1:]] != piece[order[:-1]])] if len(order) else order
        best_pair, distance, best = np.full(len(changed), -1), self.distance.copy(), self.best.copy()
        best_pair[piece[order]], distance[piece[order]], best[piece[order]] = (
            pairs[order],
            length[order],
            source[order],
        )
        # 2. Compare other sources with the best one if all of the piece sees it, else with paths through the center.
        by_best = np.append(self.by_all, False)[best_pair]
        several = np.bincount(self.piece, minlength=len(changed)) > 1
        rivals = np.flatnonzero((changed & several & np.isfinite(distance))[self.piece])
        rivals = rivals[best_pair[self.piece[rivals]] != rivals]
        piece, source = self.piece[rivals], self.source[rivals]
        apex = np.where(by_best[piece, None], sources.points[best[piece]], self.center[piece])
        offset = np.where(by_best, sources.distances[best], distance)[piece]
        lowest, _ = difference_of_cones(
            self.pieces[:, piece], sources.points[source], sources.distances[source], apex, offset
        )
        keep = np.isfinite(distance)[self.piece]
        # A rival up to the tolerance better is dropped only if no part of the piece will lose the best source, as one
        # at which no path turns: beside a thin wall, paths from some parts turn at one of its corners, and paths from
        # others at the next corner, whose cone is hardly lower.
        by_best &= self.sight.may_bend(self.pieces, best, from_all=True)
        keep[rivals[lowest > np.where(by_best[piece], -self.sight.tolerance, 0.0)]] = False
        found = replace(self, distance=distance, best=best).of_pairs(keep)
        return found.of_pieces(np.flatnonzero(np.isfinite(distance)))


def goal_sight(
    sources: Sources, turns: TurnPoints, table: VisibilityTable, triangulation: Triangulation, num_goals: int = 1
) -> Sight:
    """Return the :class:`Sight` of the nearest goal; sources are the goals, then corners where paths may turn."""
    each = np.arange(len(sources.points))
    turn = np.full(len(each), len(turns.vertex) - 1)  # also of corners that no path turns at, which are never tested
    turn[:num_goals], turn[turns.vertex] = -1, np.arange(len(turns.vertex))
    return Sight(SightedSources(sources, each, turn), Shadows.of(table), turns, triangulation, True)


def lists_of_goal(regions: TurnRegions, num_goals: int = 1) -> SourceLists:
    """Return where paths from each triangle may go first: all goals, and the turn points that see a part of it."""
    first, turns = regions.first, regions.turns.vertex[regions.turn]
    goals = np.tile(np.arange(num_goals), len(first) - 1)
    return first + num_goals * np.arange(len(first)), np.insert(turns, np.repeat(first[:-1], num_goals), goals)


def corner_sight(visibility: CornerVisibility, triangulation: Triangulation) -> Sight:
    """Return the :class:`Sight` for any goal; its sources are corners with the side that paths bend around."""
    turns = turns_by_side(visibility.corners)
    sources = Sources(turns.points, np.full(len(turns.points), np.inf), turns.vertex)
    source_table = SightedSources(sources, turns.vertex >> 1, turns.vertex)
    return Sight(source_table, Shadows.of(visibility.table), turns, triangulation, False)


def corners_of_cells(
    found: CellSources,
) -> tuple[Int[np.ndarray, "entries"], Int[np.ndarray, "entries"], Bool[np.ndarray, "entries"]]:
    """Return pairs of a cell and a corner where its paths may turn first, and whether all of it sees the corner."""
    count = np.int64(len(found.sight.turns.points) // 2)
    of_piece, first = np.unique(found.piece * count + (found.source >> 1), return_index=True)
    piece, corner = np.divmod(of_piece, count)
    key, index = np.unique(found.cell[piece] * count + corner, return_inverse=True)
    cell, corner = np.divmod(key, count)
    return cell, corner, np.bincount(index, found.by_all[first], len(key)) == np.diff(found.first_piece)[cell]
