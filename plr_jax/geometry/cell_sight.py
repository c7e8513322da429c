"""The corners that see each cell of a partition, and at which shortest paths from the cell may turn first.

The free space in a cell is divided into convex *pieces*. The whole cell is one piece unless a wall reaches into it;
then the pieces are parts of the triangles of free space. The *sources* of a piece are the goal and the corners to
which a shortest path from the piece may go first. When a cell is cut in two, the new cells inherit pieces and
sources. A new piece drops a source if it is proven that no point of the piece sees the source, or that no path from
the piece turns at the source.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Self, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import concatenated, parts, ragged_indices, take_ragged
from plr_jax._types import Sources
from plr_jax.geometry import convex_pieces
from plr_jax.geometry.boundary import grid_at
from plr_jax.geometry.convex_pieces import Pieces, Vectors, highest, lowest, next_corner
from plr_jax.geometry.corners import CornerVisibility, ReflexCorners, TurnPoints, TurnRegions, views_by_triangle
from plr_jax.geometry.triangulation import TriangleLists, Triangulation
from plr_jax.geometry.vectors import cross_product, pseudo_angle, turned_left
from plr_jax.geometry.visibility import VisibilityTable, triangles_within

_CHUNK = 1 << 16  # pairs of a piece and a source tested at a time
_OF_PIECES = "cell", "triangle", "center", "distance", "best"  # fields of `CellSources` with one row per piece
_OF_PAIRS = "piece", "source", "by_all"  # fields of `CellSources` with one row per pair of a piece and a source
OfPieces: TypeAlias = Bool[np.ndarray, " pieces"]
Indices: TypeAlias = Int[np.ndarray, " pieces"]
Rows: TypeAlias = Int[np.ndarray, " cells"]
Corners: TypeAlias = Float[np.ndarray, "cells 2"]


class Shadows(NamedTuple):
    """Segments (*shadows*) across which visibility from a viewpoint changes: on rays past corners, behind the corner.

    ::

        viewpoint . - - - - - corner =============|       The viewpoint sees points above the shadow (=), but not
                             /                    | wall  points below it, behind the obstacle.
                   obstacle /                     |

    On the two sides of the ray, the viewpoint sees different walls. The shadow is the part of the ray between the
    nearer and the farther wall. A viewpoint on a wall looks only into its sectors (see :class:`Viewpoints`). If the
    ray bounds a sector, the viewpoint sees a wall on one side only, and the shadow starts at the viewpoint.
    """

    table: VisibilityTable
    key: Float[np.ndarray, " shadows"]  # 4 times the viewpoint's index, plus the pseudo-angle from its cut; ascending
    unit: Float[np.ndarray, "shadows 2"]  # direction
    start: Float[np.ndarray, " shadows"]  # distance of each shadow's start from the viewpoint
    end: Float[np.ndarray, " shadows"]  # distance of its end

    @staticmethod
    def of(table: VisibilityTable) -> "Shadows":
        """Find all segments across which the visibility from a viewpoint of the table changes: see the class."""
        # 1. The first interval of each viewpoint starts at the cut, every other one at a vertex. Find unit vectors
        #    towards these vertices.
        view = np.repeat(np.arange(len(table.points)), np.diff(table.first))
        row = 1 + np.flatnonzero(view[1:] == view[:-1])
        view = view[row]
        unit = table.boundary.vertices[table.vertex[row]] - table.points[view]
        vertex_distance = np.linalg.norm(unit, axis=1)
        unit /= vertex_distance[:, None]
        # 2. Find the distance along each unit vector u to the walls of the intervals before and after the vertex.
        #    From viewpoint p, it is (n . p - d) / (-n . u) to the line n . x = d of a wall. It is the distance of the
        #    vertex for a wall that ends there, and 0 where the viewpoint does not look.
        wall_distances = []
        for edge in (table.edge[row - 1], table.edge[row]):
            normal = table.boundary.normal[edge]
            height = (normal * table.points[view]).sum(axis=1) - table.boundary.offset[edge]
            approach = -(normal * unit).sum(axis=1)
            with np.errstate(divide="ignore", invalid="ignore"):
                line_distance = np.where(edge < 0, 0.0, np.maximum(height, 0) / np.maximum(approach, 0))
            is_end = (table.boundary.edges[edge] == table.vertex[row, None]).any(axis=1) & (edge >= 0)
            wall_distances.append(np.where(is_end, vertex_distance, line_distance))
        start, end = np.minimum(*wall_distances), np.maximum(*wall_distances)
        long = np.flatnonzero(end - start > grid_at(table.tolerance))
        return Shadows(table, table.key[row[long]], unit[long], start[long], end[long])

    def see(self, view: Indices, pieces: Pieces, center: Vectors) -> tuple[OfPieces, OfPieces]:
        """Test what viewpoints see of convex polygons; return two booleans per polygon, ``(sees_center, is_whole)``.

        Viewpoint ``view[i]`` is tested with polygon ``i``, which contains the point ``center[i]``. ``is_whole`` is
        True if no shadow (see the class) of the viewpoint crosses the polygon. The viewpoint then sees all of the
        polygon if it sees the center, else nothing.
        """
        point, grid = self.table.points[view], grid_at(self.table.tolerance)
        # 1. Find the range of keys strictly inside each piece. Keys of one viewpoint run from 0 to 4,
        #    counterclockwise from the cut. As seen from outside, a piece spans less than half a turn, which is 2. So
        #    a larger difference of its corners' keys means that the cut passes through the piece:
        #      0 ----- first ===== last ----- 4      the cut is outside of the piece: one range
        #      0 == last - 4 ------- first == 4      `wraps`: keys above `first`, and keys below `last - 4`
        #    Each end moves inward by `blur`, the angle of one grid step, so that shadows that only touch the piece do
        #    not count. If no key below 4 is left then, the piece lies after the cut, and nothing wraps.
        dx = pieces[0] - point[:, 0, None]
        dy = pieces[1] - point[:, 1, None]
        cx, cy = self.table.cut[view].T[:, :, None]
        key = pseudo_angle(cx * dx + cy * dy, cx * dy - cy * dx)
        distance = np.sqrt(dx * dx + dy * dy)
        is_apart = distance > grid  # a corner at the viewpoint has no direction
        wraps = highest(np.where(is_apart, key, -np.inf)) - lowest(np.where(is_apart, key, np.inf)) > 2
        key += np.where(wraps[:, None] & (key < 2), 4.0, 0.0)
        blur = grid / np.maximum(distance, grid)
        first = lowest(np.where(is_apart, key + blur, np.inf))
        last = highest(np.where(is_apart, key - blur, -np.inf))
        wraps &= first < 4
        shift = np.where(first >= 4, 4.0, 0.0)
        first, last = first - shift, last - shift
        # 2. Look up the shadows in these ranges, two for a piece that wraps. A viewpoint in a piece sees all of it.
        outside = np.flatnonzero(~convex_pieces.contain(pieces, point[:, None], grid)[:, 0])
        wrapped = outside[wraps[outside]]
        piece_of_range = np.concatenate([outside, wrapped])
        begin = np.concatenate([first[outside], np.zeros(len(wrapped))])
        end = np.concatenate([np.where(wraps, 4.0, last)[outside], last[wrapped] - 4])
        low = np.searchsorted(self.key, 4.0 * view[piece_of_range] + begin, side="right")
        high = np.searchsorted(self.key, 4.0 * view[piece_of_range] + end, side="left")
        run, place = ragged_indices(np.maximum(high - low, 0))
        shadow, piece = low[run] + place, piece_of_range[run]
        # 3. A shadow crosses a piece if the shadow contains the middle of the chord that its ray cuts out of the
        #    piece. A corner at offset d from the viewpoint lies u . d along the ray and u x d beside it. An edge of
        #    the piece meets the ray's line where the offset beside it changes its sign.
        ux, uy = self.unit[shadow].T[:, :, None]
        dx, dy = dx[piece], dy[piece]
        along, beside = ux * dx + uy * dy, ux * dy - uy * dx
        next_beside = next_corner(beside)
        is_met = (beside >= 0) != (next_beside >= 0)
        fraction = np.divide(beside, beside - next_beside, out=np.zeros_like(beside), where=is_met)
        met = along + fraction * (next_corner(along) - along)
        near, far = lowest(np.where(is_met, met, np.inf)), highest(np.where(is_met, met, -1.0))
        middle = np.where(far > 0, (near + far) / 2, np.inf)
        is_whole = np.ones(len(view), bool)
        is_whole[piece[(self.start[shadow] < middle) & (middle < self.end[shadow])]] = False
        return self.table.sees(view, center), is_whole


def turns_by_side(corners: ReflexCorners) -> TurnPoints:
    """Return two turn points of each corner ``c``, one for each direction in which paths bend around the corner.

    The turn points have the indices ``2 * c`` and ``2 * c + 1``. A turn point is the corner together with the cone
    from which paths come that bend around the corner.
    """
    #              .   side 1          A path around the corner goes from one cone into the other. The cone of
    #              .                   side 1 is left of both walls' lines, the cone of side 0 is right of both.
    #     . . . . .c=== opening wall   Free space is counterclockwise from the opening to the closing wall.
    #              |####
    #     side 0   |# obstacle
    #           closing wall
    opens, closes = turned_left(corners.walls)
    normal = np.stack([[-closes, -opens], [opens, closes]], axis=2).reshape(2, -1, 2)
    points = np.repeat(corners.points, 2, axis=0)
    return TurnPoints(np.arange(len(points)), points, np.zeros(len(points)), normal, corners.slack)


def turns_by_triangle(visibility: CornerVisibility, triangulation: Triangulation) -> TriangleLists:
    """List, for each triangle of free space, the turn points that see a part of the triangle within their cone.

    A turn point is a corner together with a cone from which paths around the corner come: see :func:`turns_by_side`.
    The result is ``(first, turn)``: triangle ``t`` has the turn points ``turn[first[t] : first[t + 1]]``.
    """
    visits = []
    right, left = turns_by_side(visibility.corners).bounds
    for side in range(2):
        view, triangle = triangles_within(triangulation, visibility.views, right[side::2], left[side::2])
        visits.append(np.stack([2 * view + side, triangle]))
    return views_by_triangle(triangulation, np.concatenate(visits, axis=1))


class Sight(NamedTuple):
    """The goals and corners to which shortest paths may go first (*sources*), and data for two tests of sources.

    One test is whether a source sees a convex piece of free space. The other is whether a path from the piece may
    turn at the source.
    """

    sources: Sources
    view: Int[np.ndarray, " sources"]  # index of each source in the visibility table
    turn: Int[np.ndarray, " sources"]  # index of each source in `turns`, -1 for a goal
    shadows: Shadows  # with the visibility table
    turns: TurnPoints
    triangulation: Triangulation

    def may_bend(self, pieces: Pieces, source: Indices, from_all: bool = False) -> OfPieces:
        """Return whether shortest paths from some point of polygon ``i`` may turn at ``source[i]``; True for a goal.

        Paths may turn there if a part of the polygon lies in the source's cone (see :class:`TurnPoints`). If
        ``from_all``, return whether all of the polygon lies in the cone.
        """
        # The cone of turn point p is n . x >= n . p for its two normals n. The extremes of n . x are at the piece's
        # corners. Both normals are tested on their own, so a piece that passes may still miss the cone.
        may_bend = np.ones(len(source), bool)
        row = np.flatnonzero(self.turn[source] >= 0)
        turn = self.turn[source[row]]
        x, y = pieces[:, row]
        extreme, slack = (lowest, 0.0) if from_all else (highest, self.turns.slack)
        for normal in self.turns.normal[:, turn]:
            height = extreme(x * normal[:, :1] + y * normal[:, 1:])
            may_bend[row] &= height >= (normal * self.turns.points[turn]).sum(axis=1) - slack
        return may_bend


@dataclass(frozen=True, eq=False)
class CellSources:
    """The free space in cells as convex pieces, each with *sources*: the goal or corners to which paths may go first.

    Let ``distances[s]`` be the distance from source ``s`` at ``points[s]`` to the goal. If these distances are known,
    they bound the distance from a point ``x`` of a piece to the goal, with an error of at most :attr:`slack`:

    - It is at least the minimum of ``distances[s] + |x - points[s]|`` over the piece's sources ``s``.
    - It is at most the minimum of this sum over those sources ``s`` that are visible from every point of the piece.

    If the distances are known, pieces without a path to the goal are left out.
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
        """Find the convex pieces of the free space in each box from ``lo[i]`` to ``hi[i]``, and their sources.

        ``lists`` has the possible sources of each triangle of free space.
        """
        # 1. Cut triangles into the pieces of cells.
        triangles = np.ascontiguousarray(sight.triangulation.triangles.transpose(2, 0, 1))
        pieces, cell, triangle = convex_pieces.clip_to_boxes(triangles, lo, hi)
        # 2. Give each piece the possible sources of its triangle, and drop the sources that it does not need.
        first, source = lists
        chunks = []
        for chunk in parts(np.diff(first)[triangle], _CHUNK):
            part = pieces[:, chunk]
            count = part.shape[1]
            unknown = np.full(count, np.inf), np.zeros(count, int)
            entry, piece = take_ragged(first, triangle[chunk])
            pairs = piece, source[entry], np.zeros(len(piece), bool)
            # With ``num_cells=0``, `append` leaves the indices of cells as they are.
            cells = cls(sight, 0, cell[chunk], part, triangle[chunk], convex_pieces.centers(part), *unknown, *pairs)
            chunks.append(cells.prune_sources(np.ones(count, bool)))
        cells = replace(chunks[0].append(*chunks[1:]), num_cells=len(lo))
        # 3. Merge the pieces of cells without walls.
        return cells.merge_free_boxes(np.zeros(len(cells.cell), bool), lo, hi)

    @property
    def slack(self) -> float:
        """Largest error of distance bounds, in workspace units: it comes from the triangulation's tolerance."""
        return 4 * self.sight.triangulation.tolerance

    @property
    def sources(self) -> Sources:
        return self.sight.sources

    def hold(self, piece: Int[np.ndarray, " n"], points: Float[np.ndarray, "n k 2"]) -> Bool[np.ndarray, "n k"]:
        """Return whether convex piece ``piece[i]`` holds each of the points ``points[i]``, up to a tolerance."""
        return convex_pieces.contain(self.pieces[:, piece], points, self.sight.triangulation.tolerance)

    def see(self, source: Int[np.ndarray, " n"], points: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        """Return whether source ``source[i]`` sees ``points[i]``."""
        return self.sight.shadows.table.sees(self.sight.view[source], points)

    def pieces_as_cells(self, rows: Int[np.ndarray, " some"]) -> Self:
        """Return sources of only the convex pieces ``rows`` (indices), each as a cell of its own."""
        return replace(self.of_pieces(rows), num_cells=len(rows), cell=np.arange(len(rows)))

    @cached_property
    def first_piece(self) -> Int[np.ndarray, " cells_plus_one"]:
        return np.searchsorted(self.cell, np.arange(self.num_cells + 1))

    @cached_property
    def first_pair(self) -> Int[np.ndarray, " pieces_plus_one"]:
        return np.searchsorted(self.piece, np.arange(len(self.cell) + 1))

    def of_cells(self, cells: Int[np.ndarray, " some"]) -> Self:
        """Return sources of only the cells ``cells`` (indices), in this order; their new indices are 0, 1, ..."""
        rows, cell = take_ragged(self.first_piece, cells)
        return replace(self.of_pieces(rows), num_cells=len(cells), cell=cell)

    __getitem__ = of_cells

    def of_pieces(self, rows: Int[np.ndarray, " some"]) -> Self:
        """Return sources of only the convex pieces ``rows`` (indices), in this order.

        If ``cell`` is then no longer ascending, the caller must renumber the cells.
        """
        if len(rows) == len(self.cell) and (rows == np.arange(len(rows))).all():
            return self
        pairs, piece = take_ragged(self.first_pair, rows)
        columns = {name: getattr(self, name)[rows] for name in _OF_PIECES}
        return replace(self.of_pairs(pairs), pieces=self.pieces[:, rows], piece=piece, **columns)

    def of_pairs(self, pairs: Int[np.ndarray, " some"] | Bool[np.ndarray, " pairs"]) -> Self:
        """Return a copy with all convex pieces, but only those pairs of a piece and a source that ``pairs`` selects.

        ``pairs`` are indices, or a boolean for each pair.
        """
        return replace(self, **{name: getattr(self, name)[pairs] for name in _OF_PAIRS})

    def append(self, *others: Self) -> Self:
        """Return the cells of this object, then the cells of the other objects, as one object."""
        several = self, *others
        columns = {name: concatenated(several, name)[0] for name in (*_OF_PIECES, *_OF_PAIRS)}
        pieces = np.concatenate([group.pieces for group in several], axis=1)
        # Shift the indices of cells and pieces by the numbers in the preceding objects.
        sizes = [(group.num_cells, len(group.cell), len(group.piece)) for group in several]
        num_cells, num_pieces, num_pairs = np.array(sizes).T
        columns["cell"] += np.repeat(np.cumsum(num_cells) - num_cells, num_pieces)
        columns["piece"] += np.repeat(np.cumsum(num_pieces) - num_pieces, num_pairs)
        return replace(self, num_cells=int(num_cells.sum()), pieces=pieces, **columns)

    def parts(self, parent: Rows, axis: Rows, is_upper: Bool[np.ndarray, " cells"], lo: Corners, hi: Corners) -> Self:
        """Cut cells in two, and return the halves as new cells, with centers, distances and sources.

        New cell ``i`` is the box from ``lo[i]`` to ``hi[i]``: the half of cell ``parent[i]`` above a cut
        perpendicular to ``axis[i]`` if ``is_upper[i]``, else the half below the cut.
        """
        # 1. Compute the signed distances of the corners of pieces from the cut, positive in the part.
        rows, cell = take_ragged(self.first_piece, parent)
        along = axis[cell]
        cut = np.where(is_upper[cell], lo[cell, along], hi[cell, along])
        height = (self.pieces[along, rows] - cut[:, None]) * np.where(is_upper[cell], 1.0, -1.0)[:, None]
        # 2. Drop the pieces outside of the part, and clip the pieces that the cut crosses.
        reaches = np.flatnonzero(highest(height) > 0)
        rows, cell, height = rows[reaches], cell[reaches], height[reaches]
        pieces, is_cut = self.pieces[:, rows], lowest(height) < 0
        pieces[:, is_cut] = convex_pieces.clip(pieces[:, is_cut], height[is_cut])
        # 3. Merge the pieces of parts without walls, and prune the sources of changed pieces.
        part = replace(self.of_pieces(rows), num_cells=len(parent), cell=cell, pieces=pieces)
        return part.merge_free_boxes(is_cut, lo, hi)

    def merge_free_boxes(self, changed: OfPieces, lo: Corners, hi: Corners) -> Self:
        """Merge the pieces of each cell without walls into one piece, the cell's box, and drop pieces without area.

        Then call :meth:`prune_sources` for merged pieces and for ``changed`` pieces (a boolean for each piece). Cell
        ``i`` is the box from ``lo[i]`` to ``hi[i]``.
        """
        # 1. Find the walls of cells with several pieces. All these pieces are parts of triangles (`triangle` >= 0),
        #    and walls in the cell are sides of these triangles. Wall ``i`` belongs to cell ``cells[index[i]]``.
        cells = np.flatnonzero(np.diff(self.first_piece) > 1)
        rows, index = take_ragged(self.first_piece, cells)
        row, side = np.nonzero(self.sight.triangulation.wall.reshape(-1, 3)[self.triangle[rows]] >= 0)
        triangle, index = self.triangle[rows[row]], index[row]
        start, end = (self.sight.triangulation.triangles[triangle, corner] for corner in (side, (side + 1) % 3))
        # 2. Test whether a wall enters the cell's box. Separating axes of a box and a segment are x, y and the
        #    segment's normal. Let m be the vector from the box's center to the segment's, and h and s half the widths
        #    of box and segment. Both overlap along x and y if |m| < h + s in each coordinate. They overlap along the
        #    normal (y, -x) of the segment's vector (x, y) if |m x (x, y)| < h_x |y| + h_y |x|, where |x| = 2 s_x.
        vector = end - start
        offset = (start + end) / 2 - ((lo + hi) / 2)[cells[index]]
        half_box = ((hi - lo) / 2)[cells[index]]
        half_wall = np.abs(vector) / 2
        enters = (np.abs(offset) < half_box + half_wall).all(axis=1)
        enters &= np.abs(cross_product(offset, vector)) < 2 * (half_wall * half_box[:, ::-1]).sum(axis=1)
        is_free = np.zeros(self.num_cells, bool)
        is_free[cells] = ~np.isin(np.arange(len(cells)), index[enters])
        # 3. Replace the first piece of each free cell by the box, with the sources of all the cell's pieces. None of
        #    these sources is known to be visible from all of the box.
        is_merged = is_free[self.cell]
        is_kept = (convex_pieces.areas(self.pieces) > 0) & ~is_merged
        merged = self
        if is_free.any():
            whole = self.first_piece[:-1][is_free]
            is_kept[whole] = True
            pieces, triangle = self.pieces.copy(), self.triangle.copy()
            pieces[:, whole], triangle[whole] = convex_pieces.boxes_as_pieces(lo[is_free], hi[is_free]), -1
            target = np.where(is_merged, self.first_piece[self.cell], np.arange(len(is_kept)))  # new piece of each
            keys = target[self.piece] * np.int64(max(self.source.max(initial=0), 0) + 1) + self.source
            merged = replace(self.of_pairs(np.unique(keys, return_index=True)[1]), pieces=pieces, triangle=triangle)
            merged = replace(merged, piece=target[merged.piece], by_all=merged.by_all & ~is_merged[merged.piece])
        # 4. Drop pieces without area and merged pieces, and prune the sources of the remaining pieces.
        kept = np.flatnonzero(is_kept)
        return merged.of_pieces(kept).prune_sources((changed | is_merged)[kept])

    def prune_sources(self, changed: OfPieces) -> Self:
        """Drop sources of changed pieces that no point of the piece sees, or where no path from the piece turns.

        A source stays unless a test proves that it is not needed. ``changed`` has a boolean for each piece. If there
        is a goal, also call :meth:`prune_dominated`.
        """
        # 1. Compute the centers of changed pieces. A path straight to the old center bounds the distance of the new.
        has_goal = np.isfinite(self.sources.distances).any()
        center = self.center.copy()
        center[changed] = convex_pieces.centers(self.pieces[:, changed])
        moved = replace(self, center=center, distance=self.distance + np.linalg.norm(center - self.center, axis=1))
        # 2. Test pairs of changed pieces and sources:                    keep             by_center    by_all
        #      of an unchanged piece (not tested)                         True             True         as before
        #      all of the piece is known to see the source, and there
        #        is a goal (not tested: `prune_dominated` decides)        True             True         True
        #      no path from the piece can turn at the source              False            False        as before
        #      all of the piece is known to see the source (no goal)      True             not used     True
        #      others                                                     seen | ~whole    seen         seen & whole
        pairs = np.flatnonzero(changed[self.piece] & ~(self.by_all & has_goal))
        bends = self.sight.may_bend(self.pieces[:, self.piece[pairs]], self.source[pairs])
        keep, by_center = np.ones((2, len(self.piece)), bool)
        keep[pairs], by_center[pairs] = bends, False
        pairs = pairs[bends & ~self.by_all[pairs]]
        piece, view = self.piece[pairs], self.sight.view[self.source[pairs]]
        seen, is_whole = self.sight.shadows.see(view, self.pieces[:, piece], center[piece])
        by_all = self.by_all.copy()
        keep[pairs], by_center[pairs], by_all[pairs] = seen | ~is_whole, seen, seen & is_whole
        if not has_goal:
            return replace(moved, by_all=by_all).of_pairs(keep)
        # 3. Far from the origin, rounding may remove all sources of a very thin piece; it then keeps what it had.
        keep |= (np.bincount(moved.piece[keep], minlength=len(changed)) == 0)[moved.piece]
        return replace(moved, by_all=by_all).of_pairs(keep).prune_dominated(changed, by_center[keep])

    def prune_dominated(self, changed: OfPieces, by_center: Bool[np.ndarray, " pairs"]) -> Self:
        """Find each changed piece's best source, to which the shortest path from the piece's center goes first.

        Drop every other source of the piece that is proven to shorten the path from no point of the piece. Drop
        pieces without a path to the goal. ``changed`` says which pieces changed. ``by_center`` says, for each pair of
        a piece and a source, whether the piece's center sees the source.
        """
        # 1. Find the best source s of each center c, with the least distances[s] + |c - points[s]|; ties prefer
        #    sources that all of the piece sees.
        sources = self.sources
        pairs = np.flatnonzero(changed[self.piece] & by_center)
        piece, source = self.piece[pairs], self.source[pairs]
        length = sources.distances[source] + np.linalg.norm(self.center[piece] - sources.points[source], axis=1)
        order = np.lexsort((source, ~self.by_all[pairs], length, piece))
        order = order[np.append(True, piece[order[1:]] != piece[order[:-1]])[: len(order)]]  # each piece's first pair
        best_pair, distance, best = np.full(len(changed), -1), self.distance.copy(), self.best.copy()
        for of_piece, values in ((best_pair, pairs), (distance, length), (best, source)):
            of_piece[piece[order]] = values[order]
        # 2. Compare each rival, another source of the piece, with the cone offset + |x - apex| of paths to the best
        #    source if all of the piece sees it, else with the cone of paths to the center.
        is_best_seen = np.append(self.by_all, False)[best_pair]  # without a best pair (-1): False
        has_several = np.bincount(self.piece, minlength=len(changed)) > 1
        rivals = np.flatnonzero((changed & has_several & np.isfinite(distance))[self.piece])
        rivals = rivals[best_pair[self.piece[rivals]] != rivals]
        piece, source = self.piece[rivals], self.source[rivals]
        apex = np.where(is_best_seen[piece, None], sources.points[best[piece]], self.center[piece])
        offset = np.where(is_best_seen, sources.distances[best], distance)[piece]
        cones = sources.points[source], sources.distances[source], apex, offset
        least_excess, _ = convex_pieces.difference_of_cones(self.pieces[:, piece], *cones)
        # 3. Drop rivals that are nowhere better. A rival that is better by up to the tolerance is dropped only if
        #    paths from all parts of the piece can turn at the best source: beside a thin wall, some paths turn at its
        #    other corner, whose cone is hardly lower.
        may_turn = is_best_seen & self.sight.may_bend(self.pieces, best, from_all=True)
        threshold = np.where(may_turn[piece], -self.sight.triangulation.tolerance, 0.0)
        keep = np.isfinite(distance)[self.piece]
        keep[rivals[least_excess > threshold]] = False
        pruned = replace(self, distance=distance, best=best).of_pairs(keep)
        return pruned.of_pieces(np.flatnonzero(np.isfinite(distance)))


def goal_sight(
    sources: Sources, turns: TurnPoints, table: VisibilityTable, triangulation: Triangulation, num_goals: int = 1
) -> Sight:
    """Return data to test to which of the goals and corners shortest paths from a convex piece may go first.

    ``sources`` has the ``num_goals`` goals, then all corners, with their distances to the goal; source ``i`` is
    viewpoint ``i`` of the visibility ``table``. ``turns`` are the corners where paths to the goal may turn first.
    """
    index = np.arange(len(sources.points))
    turn = np.full(len(index), len(turns.vertex) - 1)  # also of corners that no path turns at, which are never tested
    turn[:num_goals] = -1
    turn[turns.vertex] = np.arange(len(turns.vertex))
    return Sight(sources, index, turn, Shadows.of(table), turns, triangulation)


def lists_of_goal(regions: TurnRegions, num_goals: int = 1) -> TriangleLists:
    """List, for each triangle of free space, the sources to which paths from the triangle may go first.

    The sources are all goals, with the indices 0, 1, ..., and the corners that ``regions`` lists for the triangle.
    The result is ``(first, source)``: triangle ``t`` has the sources ``source[first[t] : first[t + 1]]``.
    """
    # The goals come before the corners of each triangle, so the list of triangle t begins num_goals * t later.
    first, turns = regions.first, regions.turns.vertex[regions.turn]
    goals = np.tile(np.arange(num_goals), len(first) - 1)
    return first + num_goals * np.arange(len(first)), np.insert(turns, np.repeat(first[:-1], num_goals), goals)


def corner_sight(visibility: CornerVisibility, triangulation: Triangulation) -> Sight:
    """Return data to test which corners a convex piece of free space sees, and at which of them paths may turn.

    The :class:`Sight` has each corner twice, once for each direction in which paths bend around the corner: see
    :func:`turns_by_side`. There is no goal, and all distances to it are ``inf``.
    """
    turns = turns_by_side(visibility.corners)
    sources = Sources(turns.points, np.full(len(turns.points), np.inf), turns.vertex)
    return Sight(sources, turns.vertex >> 1, turns.vertex, Shadows.of(visibility.table), turns, triangulation)
