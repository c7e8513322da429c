"""The corners that each cell of a partition of the plane sees, from which shortest paths from the cell go on.

The free part of a cell consists of convex *pieces*: the whole cell, or parts of triangles if a wall reaches into it.
The *sources* of a piece are the goal and the corners to which a path from the piece may go first. When a cell is cut,
its parts inherit pieces and sources, except sources that no point of the piece sees or at which no path turns.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import concatenated, parts, ragged_indices, take_ragged
from plr_jax._types import Sources
from plr_jax.geometry.boundary import grid_at
from plr_jax.geometry.convex_pieces import (
    Pieces,
    Vectors,
    areas,
    boxes_as_pieces,
    centers,
    clip,
    clip_to_boxes,
    contain,
    difference_of_cones,
    highest,
    lowest,
    next_corner,
)
from plr_jax.geometry.corners import CornerVisibility, ReflexCorners, TurnPoints, TurnRegions, views_by_triangle
from plr_jax.geometry.triangulation import TriangleLists, Triangulation
from plr_jax.geometry.vectors import pseudo_angle, turned_left
from plr_jax.geometry.visibility import VisibilityTable, triangles_within

_CHUNK = 1 << 16  # pairs of a piece and a source tested at a time
_OF_PIECES = "cell", "triangle", "center", "distance", "best"  # fields of `CellSources` with one row per piece
OfPieces: TypeAlias = Bool[np.ndarray, " pieces"]
Indices: TypeAlias = Int[np.ndarray, " pieces"]
Rows: TypeAlias = Int[np.ndarray, " cells"]
Corners: TypeAlias = Float[np.ndarray, "cells 2"]
Entries: TypeAlias = Int[np.ndarray, " entries"]


@dataclass(frozen=True, eq=False)
class Shadows:
    """Segments across which visibility from viewpoints changes: on rays past corners, from the corner to a wall.

    ::

        viewpoint . - - - - - corner =============|       The viewpoint sees points above the shadow (=), but not
                             /                    | wall  points below it, behind the obstacle.
                   obstacle /                     |
    """

    table: VisibilityTable
    key: Float[np.ndarray, " shadows"]  # 4 times the viewpoint's index, plus the pseudo-angle from its cut; ascending
    unit: Float[np.ndarray, "shadows 2"]  # direction
    start: Float[np.ndarray, " shadows"]  # distance from the viewpoint
    end: Float[np.ndarray, " shadows"]

    @staticmethod
    def of(table: VisibilityTable) -> "Shadows":
        """Find the shadows of all viewpoints of a table."""
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

    def see(self, view: Indices, pieces: Pieces, center: Vectors) -> tuple[OfPieces, OfPieces]:
        # A viewpoint sees all or nothing of a piece if no shadow crosses the piece.
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
        outside = np.flatnonzero(~contain(pieces, point[:, None], grid)[:, 0])
        wrapped = outside[wraps[outside]]  # a range that contains the cut is looked up in two parts
        begin = 4.0 * view[np.concatenate([outside, wrapped])]
        end = begin + np.concatenate([np.where(wraps, 4.0, last)[outside], last[wrapped] - 4])
        begin[: len(outside)] += first[outside]
        low, high = np.searchsorted(self.key, begin, side="right"), np.searchsorted(self.key, end, side="left")
        run, place = ragged_indices(np.maximum(high - low, 0))
        shadow, owner = low[run] + place, np.concatenate([outside, wrapped])[run]
        # 3. A shadow crosses a piece if it contains the middle of the chord that its ray cuts out.
        ux, uy = self.unit[shadow].T[:, :, None]
        dx, dy = pieces[0, owner] - point[owner, :1], pieces[1, owner] - point[owner, 1:]
        along, beside = ux * dx + uy * dy, ux * dy - uy * dx
        next_along, next_beside = next_corner(along), next_corner(beside)
        crosses = (beside >= 0) != (next_beside >= 0)
        fraction = np.divide(beside, beside - next_beside, out=np.zeros_like(beside), where=crosses)
        at = along + fraction * (next_along - along)
        near, far = lowest(np.where(crosses, at, np.inf)), highest(np.where(crosses, at, -1.0))
        middle = np.where(far > 0, (near + far) / 2, np.inf)
        is_whole[owner[(self.start[shadow] < middle) & (middle < self.end[shadow])]] = False
        return seen, is_whole


def turns_by_side(corners: ReflexCorners) -> TurnPoints:
    """Return turn points ``2 * c`` and ``2 * c + 1`` of each corner ``c``: the two ways to bend around the corner."""
    opens, closes = turned_left(corners.walls)
    normal = np.stack([[-closes, -opens], [opens, closes]], axis=2).reshape(2, -1, 2)
    points = np.repeat(corners.points, 2, axis=0)
    return TurnPoints(np.arange(len(points)), points, np.zeros(len(points)), normal, corners.slack)


def turns_by_triangle(visibility: CornerVisibility, triangulation: Triangulation) -> TriangleLists:
    # Indices ``2 * c`` and ``2 * c + 1`` are the two ways to bend around corner ``c``.
    visits, (right, left) = [], turns_by_side(visibility.corners).bounds
    for side in range(2):
        view, triangle = triangles_within(triangulation, visibility.views, right[side::2], left[side::2])
        visits.append(np.stack([2 * view + side, triangle]))
    return views_by_triangle(triangulation, np.concatenate(visits, axis=1))


@dataclass(frozen=True, eq=False)
class Sight:
    """The goals and corners to which shortest paths may go first, and data to test this for a convex piece."""

    sources: Sources
    view: Int[np.ndarray, " sources"]  # index of each source in the visibility table
    turn: Int[np.ndarray, " sources"]  # its index in turns, -1 for a goal
    shadows: Shadows
    turns: TurnPoints
    triangulation: Triangulation
    has_goal: bool

    @cached_property
    def is_wall(self) -> Bool[np.ndarray, "triangles 3"]:
        return (self.triangulation.wall >= 0).reshape(-1, 3)

    def may_bend(self, pieces: Pieces, source: Indices, from_all: bool = False) -> OfPieces:
        """Return whether a part of each piece may lie in its source's cone of :class:`TurnPoints`; True for a goal.

        With ``from_all``, return whether all of the piece lies in the cone.
        """
        turn = self.turn[source]
        may, corner = np.ones(len(source), bool), np.flatnonzero(turn >= 0)  # there may be none but the goal
        turn, (x, y) = turn[corner], pieces[:, corner]
        extreme, slack = (lowest, 0.0) if from_all else (highest, self.turns.slack)
        for normal in self.turns.normal[:, turn]:
            height = extreme(x * normal[:, :1] + y * normal[:, 1:])
            may[corner] &= height >= (normal * self.turns.points[turn]).sum(axis=1) - slack
        return may


@dataclass(frozen=True, eq=False)
class CellSources:
    """The free part of cells as convex pieces, each with *sources*: the goal or corners to which paths may go first.

    Let ``distances[s]`` be the distance from source ``s`` to the goal. If these are known, the distance of a point
    ``x`` of a piece is at least the minimum of ``distances[s] + |x - points[s]|`` over the piece's sources ``s``. It
    is at most the minimum over the sources that all of the piece sees. Both hold to within :attr:`slack`. Pieces
    without a path to the goal are then left out.
    """

    sight: Sight
    num_cells: int
    cell: Indices  # of each piece, ascending
    pieces: Pieces
    triangle: Indices  # that contains each piece; -1 for a box that no wall reaches into
    center: Vectors  # a point inside each piece
    distance: Float[np.ndarray, " pieces"]  # of each center to the goal, or an upper bound; inf if not computed
    best: Indices  # source to which the shortest path from each center goes first, or one near it; 0 if not computed
    piece: Int[np.ndarray, " pairs"]  # ascending
    source: Int[np.ndarray, " pairs"]
    by_all: Bool[np.ndarray, " pairs"]  # whether every point of the pair's piece is known to see its source

    @classmethod
    def of_boxes(cls, sight: Sight, lists: TriangleLists, lo: Corners, hi: Corners) -> Self:
        """Find the convex pieces of free space in boxes; ``lists`` has possible sources by triangle of free space."""
        first, source = lists
        triangles = np.ascontiguousarray(sight.triangulation.triangles.transpose(2, 0, 1))
        pieces, cell, triangle = clip_to_boxes(triangles, lo, hi)
        chunks = []
        for chunk in parts(np.diff(first)[triangle], _CHUNK) or [slice(0, 0)]:
            entry, piece = take_ragged(first, triangle[chunk])
            count, part = len(cell[chunk]), pieces[:, chunk]
            unknown = np.full(count, np.inf), np.zeros(count, int), piece, source[entry], np.zeros(len(piece), bool)
            # With ``num_cells=0``, `append` leaves the indices of cells as they are.
            cells = cls(sight, 0, cell[chunk], part, triangle[chunk], centers(part), *unknown)
            chunks.append(cells.prune_sources(np.ones(count, bool)))
        cells = replace(chunks[0].append(*chunks[1:]), num_cells=len(lo))
        return cells.merge_free_boxes(np.zeros(len(cells.cell), bool), lo, hi)

    @property
    def slack(self) -> float:
        """Error of distance bounds, in workspace units, since free space is known only to a tolerance."""
        return 4 * self.sight.triangulation.tolerance

    @property
    def sources(self) -> Sources:
        return self.sight.sources

    def hold(self, piece: Int[np.ndarray, " n"], points: Float[np.ndarray, "n k 2"]) -> Bool[np.ndarray, "n k"]:
        return contain(self.pieces[:, piece], points, self.sight.triangulation.tolerance)

    def see(self, source: Int[np.ndarray, " n"], points: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        return self.sight.shadows.table.sees(self.sight.view[source], points)

    def pieces_as_cells(self, rows: Int[np.ndarray, " some"]) -> Self:
        return replace(self.of_pieces(rows), num_cells=len(rows), cell=np.arange(len(rows)))

    @cached_property
    def first_piece(self) -> Int[np.ndarray, " cells_plus_one"]:
        return np.searchsorted(self.cell, np.arange(self.num_cells + 1))

    @cached_property
    def first_pair(self) -> Int[np.ndarray, " pieces_plus_one"]:
        return np.searchsorted(self.piece, np.arange(len(self.cell) + 1))

    def of_cells(self, cells: Int[np.ndarray, " some"]) -> Self:
        rows, cell = take_ragged(self.first_piece, cells)
        return replace(self.of_pieces(rows), num_cells=len(cells), cell=cell)

    def of_pieces(self, rows: Int[np.ndarray, " some"]) -> Self:
        if len(rows) == len(self.cell) and (rows == np.arange(len(rows))).all():
            return self
        pairs, piece = take_ragged(self.first_pair, rows)
        columns = {name: getattr(self, name)[rows] for name in _OF_PIECES}
        return replace(self.of_pairs(pairs), pieces=self.pieces[:, rows], piece=piece, **columns)

    def of_pairs(self, pairs: Int[np.ndarray, " some"] | Bool[np.ndarray, " pairs"]) -> Self:
        return replace(self, piece=self.piece[pairs], source=self.source[pairs], by_all=self.by_all[pairs])

    def append(self, *others: Self) -> Self:
        several, names = (self, *others), (*_OF_PIECES, "piece", "source", "by_all")
        columns = dict(zip(names, concatenated(several, *names), strict=True))
        pieces = np.concatenate([group.pieces for group in several], axis=1)
        # Shift the indices of cells and pieces by the numbers in the preceding objects.
        for name, counts in (("cell", [e.num_cells for e in several]), ("piece", [len(e.cell) for e in several])):
            columns[name] += np.repeat(np.cumsum([0, *counts[:-1]]), [len(getattr(group, name)) for group in several])
        return replace(self, num_cells=sum(group.num_cells for group in several), pieces=pieces, **columns)

    def parts(self, parent: Rows, axis: Rows, is_upper: Bool[np.ndarray, " cells"], lo: Corners, hi: Corners) -> Self:
        # Part ``i`` is the box ``lo[i]`` to ``hi[i]``, on one side of a cut of cell ``parent[i]`` across ``axis[i]``.
        rows, cell = take_ragged(self.first_piece, parent)
        along, upper = axis[cell], is_upper[cell]
        cut = np.where(upper, lo[cell, along], hi[cell, along])
        height = (self.pieces[along, rows] - cut[:, None]) * np.where(upper, 1.0, -1.0)[:, None]
        reaches = np.flatnonzero(highest(height) > 0)
        rows, cell, height = rows[reaches], cell[reaches], height[reaches]
        pieces, is_cut = self.pieces[:, rows], lowest(height) < 0
        pieces[:, is_cut] = clip(pieces[:, is_cut], height[is_cut])
        part = replace(self.of_pieces(rows), num_cells=len(parent), cell=cell, pieces=pieces)
        return part.merge_free_boxes(is_cut, lo, hi)

    def merge_free_boxes(self, changed: OfPieces, lo: Corners, hi: Corners) -> Self:
        # Then prune the sources of merged and of changed pieces.
        cells = np.flatnonzero(np.diff(self.first_piece) > 1)
        rows, index = take_ragged(self.first_piece, cells)
        row, side = np.nonzero(self.sight.is_wall[self.triangle[rows]])
        triangle, index = self.triangle[rows[row]], index[row]
        start, end = (self.sight.triangulation.triangles[triangle, corner] for corner in (side, (side + 1) % 3))
        # Separating axis test of walls and boxes. Walls in a box are sides of the triangles of its pieces.
        from_middle, half = (start + end) / 2 - ((lo + hi) / 2)[cells[index]], ((hi - lo) / 2)[cells[index]]
        along = np.abs(end - start) / 2
        beside = np.abs(from_middle[:, 0] * (end - start)[:, 1] - from_middle[:, 1] * (end - start)[:, 0])
        meets = (np.abs(from_middle) < half + along).all(axis=1) & (beside < 2 * (along * half[:, ::-1]).sum(axis=1))
        is_free = np.zeros(self.num_cells, bool)
        is_free[cells] = ~np.isin(np.arange(len(cells)), index[meets])
        is_merged = is_free[self.cell]
        is_kept = (areas(self.pieces) > 0) & ~is_merged
        merged = self
        if is_free.any():
            # The merged piece has the sources of all pieces; none is known to be visible from all of it.
            owner = np.where(is_merged, self.first_piece[self.cell], np.arange(len(is_kept)))
            keys = owner[self.piece] * np.int64(max(self.source.max(initial=0), 0) + 1) + self.source
            pieces, triangle = self.pieces.copy(), self.triangle.copy()
            whole = self.first_piece[:-1][is_free]
            pieces[:, whole], triangle[whole], is_kept[whole] = boxes_as_pieces(lo[is_free], hi[is_free]), -1, True
            merged = replace(self.of_pairs(np.unique(keys, return_index=True)[1]), pieces=pieces, triangle=triangle)
            merged = replace(merged, piece=owner[merged.piece], by_all=merged.by_all & ~is_merged[merged.piece])
        kept = np.flatnonzero(is_kept)
        return replace(merged.of_pieces(kept), num_cells=len(lo)).prune_sources((changed | is_merged)[kept])

    def prune_sources(self, changed: OfPieces) -> Self:
        # 1. Compute the centers of changed pieces. Paths straight to the old centers bound their distances.
        center, has_goal = self.center.copy(), self.sight.has_goal
        center[changed] = centers(self.pieces[:, changed])
        moved = replace(self, center=center, distance=self.distance + np.linalg.norm(center - self.center, axis=1))
        # 2. Test whether the center or all of a piece sees a source. What is not tested counts as seen by the center.
        pairs = np.flatnonzero(changed[self.piece] & ~(self.by_all & has_goal))
        bends = self.sight.may_bend(self.pieces[:, self.piece[pairs]], self.source[pairs])
        keep, by_center, by_all = np.ones(len(self.piece), bool), np.ones(len(self.piece), bool), self.by_all.copy()
        by_center[pairs], keep[pairs] = by_all[pairs], bends
        pairs = pairs[bends & ~by_all[pairs]]
        piece, view = self.piece[pairs], self.sight.view[self.source[pairs]]
        seen, is_whole = self.sight.shadows.see(view, self.pieces[:, piece], center[piece])
        by_all[pairs], by_center[pairs], keep[pairs] = seen & is_whole, seen, seen | ~is_whole
        if not has_goal:
            return replace(moved, by_all=by_all).of_pairs(keep)
        # Far from the origin, rounding may remove all sources of a very thin piece; it then keeps what it had.
        keep |= (np.bincount(moved.piece[keep], minlength=len(changed)) == 0)[moved.piece]
        return replace(moved, by_all=by_all).of_pairs(keep).prune_dominated(changed, by_center[keep])

    def prune_dominated(self, changed: OfPieces, by_center: Bool[np.ndarray, " pairs"]) -> Self:
        """Find the best source of each changed piece, and drop the sources through which no path is shorter."""
        sources, pairs = self.sources, np.flatnonzero(changed[self.piece] & by_center)
        # 1. Find the best source of each center; ties prefer sources that all of the piece sees.
        piece, source = self.piece[pairs], self.source[pairs]
        length = sources.distances[source] + np.linalg.norm(self.center[piece] - sources.points[source], axis=1)
        order = np.lexsort((source, ~self.by_all[pairs], length, piece))
        order = order[np.append(True, piece[order[1:]] != piece[order[:-1]])] if len(order) else order
        best_pair, distance, best = np.full(len(changed), -1), self.distance.copy(), self.best.copy()
        for of_piece, values in ((best_pair, pairs), (distance, length), (best, source)):
            of_piece[piece[order]] = values[order]
        # 2. Compare other sources with the best one if all of the piece sees it, else with paths through the center.
        by_best = np.append(self.by_all, False)[best_pair]
        several = np.bincount(self.piece, minlength=len(changed)) > 1
        rivals = np.flatnonzero((changed & several & np.isfinite(distance))[self.piece])
        rivals = rivals[best_pair[self.piece[rivals]] != rivals]
        piece, source = self.piece[rivals], self.source[rivals]
        apex = np.where(by_best[piece, None], sources.points[best[piece]], self.center[piece])
        offset = np.where(by_best, sources.distances[best], distance)[piece]
        cones = sources.points[source], sources.distances[source], apex, offset
        lowest, _ = difference_of_cones(self.pieces[:, piece], *cones)
        keep = np.isfinite(distance)[self.piece]
        # Drop a rival that is better by up to the tolerance only if paths from all parts of the piece can turn at the
        # best source: beside a thin wall, some paths turn at its other corner, whose cone is hardly lower.
        by_best &= self.sight.may_bend(self.pieces, best, from_all=True)
        keep[rivals[lowest > np.where(by_best[piece], -self.sight.triangulation.tolerance, 0.0)]] = False
        pruned = replace(self, distance=distance, best=best).of_pairs(keep)
        return pruned.of_pieces(np.flatnonzero(np.isfinite(distance)))


def goal_sight(
    sources: Sources, turns: TurnPoints, table: VisibilityTable, triangulation: Triangulation, num_goals: int = 1
) -> Sight:
    index = np.arange(len(sources.points))
    turn = np.full(len(index), len(turns.vertex) - 1)  # also of corners that no path turns at, which are never tested
    turn[:num_goals], turn[turns.vertex] = -1, np.arange(len(turns.vertex))
    return Sight(sources, index, turn, Shadows.of(table), turns, triangulation, True)


def lists_of_goal(regions: TurnRegions, num_goals: int = 1) -> TriangleLists:
    """List, for each triangle, where paths may go first: all goals, and corners that see a part of the triangle."""
    first, turns = regions.first, regions.turns.vertex[regions.turn]
    goals = np.tile(np.arange(num_goals), len(first) - 1)
    return first + num_goals * np.arange(len(first)), np.insert(turns, np.repeat(first[:-1], num_goals), goals)


def corner_sight(visibility: CornerVisibility, triangulation: Triangulation) -> Sight:
    # Each corner is two sources, one for each way to bend around it.
    turns = turns_by_side(visibility.corners)
    sources = Sources(turns.points, np.full(len(turns.points), np.inf), turns.vertex)
    shadows = Shadows.of(visibility.table)
    return Sight(sources, turns.vertex >> 1, turns.vertex, shadows, turns, triangulation, False)


def corners_of_cells(cells: CellSources) -> tuple[Entries, Entries, Bool[np.ndarray, " entries"]]:
    """Return pairs (cell, corner where paths from it may turn first), and whether all of the cell sees the corner."""
    # The sources of the pieces are entries of ``turns_by_side``.
    count = np.int64(len(cells.sight.turns.points) // 2)
    of_piece, first = np.unique(cells.piece * count + (cells.source >> 1), return_index=True)
    piece, corner = np.divmod(of_piece, count)
    key, index = np.unique(cells.cell[piece] * count + corner, return_inverse=True)
    cell, corner = np.divmod(key, count)
    return cell, corner, np.bincount(index, cells.by_all[first], len(key)) == np.diff(cells.first_piece)[cell]
