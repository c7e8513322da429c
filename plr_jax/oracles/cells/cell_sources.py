"""Which sources the points of a cell may use: all that some of them may, and those that every one of them can."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias, TypeVar

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import parts, run_members
from plr_jax._types import Sources
from plr_jax.geometry.box import Box
from plr_jax.geometry.convex_pieces import (
    PartCorner,
    PartIndex,
    PartSide,
    Pieces,
    areas,
    boxes_as_pieces,
    centers,
    clip_to_box,
    clip_to_boxes,
    contain,
    cut_parts,
    difference_of_cones,
)
from plr_jax.geometry.corners import TurnRegions
from plr_jax.oracles.cells.sight import Sight, meet_walls

_CHUNK = 1 << 16  # pairs of a piece and a source at a time, where there are many
_FILLED = 1 - 1e-9
"""Share of a cell's area that its pieces fill, for it to be worth asking whether a wall is in it."""
_LEAD = 1 / 128
"""Tolerances by which a source may be better yet and is left out; cells are halved less often."""

OfPieces: TypeAlias = Bool[np.ndarray, "pieces"]
Found = TypeVar("Found", bound="VisibleSources")


@dataclass(frozen=True, eq=False)
class VisibleSources:
    """The free convex pieces of cells, and pairs of a piece and a source that a point of it may use.

    Pieces stand cell by cell, pairs piece by piece. Pieces of which nothing reaches the goal are left out. What is
    said of a piece holds to within ``slack``, as free space is known to a tolerance.

    Attributes:
        sight: Of the oracle.
        num_cells: How many cells.
        cell: The cell of each piece.
        pieces: The pieces.
        origin: The piece of the domain that each is a part of; -1 where several were put together.
        center: A point inside each.
        distance: Distance of each center to the goal; a bound of it where no source is said to see the center.
        best: Source that each center's shortest path goes to, or one near it where none is said to see the center.
        piece: The piece of each pair.
        source: The source of each pair.
        by_all: Whether every point of the piece sees it.
    """

    sight: Sight
    num_cells: int
    cell: Int[np.ndarray, "pieces"]
    pieces: Pieces
    origin: Int[np.ndarray, "pieces"]
    center: Float[np.ndarray, "pieces 2"]
    distance: Float[np.ndarray, "pieces"]
    best: Int[np.ndarray, "pieces"]
    piece: Int[np.ndarray, "pairs"]
    source: Int[np.ndarray, "pairs"]
    by_all: Bool[np.ndarray, "pairs"]

    @property
    def sources(self) -> Sources:
        """All sources of the oracle."""
        return self.sight.cones.sources

    @property
    def slack(self) -> float:
        """How much any bound that follows may err, as free space is known to a tolerance."""
        return 4 * self.sight.tolerance

    @cached_property
    def first_piece(self) -> Int[np.ndarray, "cells_plus_one"]:
        """First piece of each cell, and their number."""
        return np.searchsorted(self.cell, np.arange(self.num_cells + 1))

    @cached_property
    def first_pair(self) -> Int[np.ndarray, "pieces_plus_one"]:
        """First pair of each piece, and their number."""
        return np.searchsorted(self.piece, np.arange(len(self.cell) + 1))

    def hold(self, piece: Int[np.ndarray, "n"], points: Float[np.ndarray, "n k 2"]) -> Bool[np.ndarray, "n k"]:
        """Whether pieces hold points, to the tolerance of free space, ``k`` for each of some pieces."""
        return contain(self.pieces[:, piece], points, self.sight.tolerance)

    def see(self, source: Int[np.ndarray, "n"], points: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, "n"]:
        """Whether points are seen by sources."""
        return self.sight.shadows.table.sees(self.sight.cones.view[source], points)

    def rank(self, source: Int[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
        """The order of sources in which the first of equals is taken."""
        return self.sight.cones.kind[source]

    def of_cells(self: Found, cells: Int[np.ndarray, "some"]) -> Found:
        """The same of some of the cells, in another order perhaps, and perhaps repeated."""
        rows, cell = run_members(self.first_piece, cells)
        return replace(self._of_pieces(rows), num_cells=len(cells), cell=cell)

    def pieces_as_cells(self: Found, rows: Int[np.ndarray, "some"]) -> Found:
        """Those of some pieces, each a cell of its own."""
        return replace(self._of_pieces(rows), num_cells=len(rows), cell=np.arange(len(rows)))

    def _of_pieces(self: Found, rows: Int[np.ndarray, "some"]) -> Found:
        if len(rows) == len(self.cell) and (rows == np.arange(len(rows))).all():
            return self
        pairs, piece = run_members(self.first_pair, rows)
        columns = {name: getattr(self, name)[rows] for name in ("cell", "origin", "center", "distance", "best")}
        return replace(self._of_pairs(pairs), pieces=self.pieces[:, rows], piece=piece, **columns)

    def _of_pairs(self: Found, pairs: Int[np.ndarray, "some"] | Bool[np.ndarray, "pairs"]) -> Found:
        return replace(self, piece=self.piece[pairs], source=self.source[pairs], by_all=self.by_all[pairs])

    def parts(
        self, parent: PartIndex, axis: PartIndex, is_upper: PartSide, lo: PartCorner, hi: PartCorner
    ) -> "VisibleSources":
        """Of parts of the cells: boxes that lie in a cell each and are cut from it along one axis."""
        return settled_cells(*self.cut(parent, axis, is_upper, lo, hi), lo, hi)

    def cut(
        self: Found, parent: PartIndex, axis: PartIndex, is_upper: PartSide, lo: PartCorner, hi: PartCorner
    ) -> tuple[Found, Bool[np.ndarray, "some"]]:
        """Parts of the cells with the pairs of these, before anything is asked of them, and which pieces were cut."""
        pieces, cell, rows, is_cut = cut_parts(self.pieces, self.first_piece, parent, axis, is_upper, lo, hi)
        return replace(self._of_pieces(rows), num_cells=len(parent), cell=cell, pieces=pieces), is_cut

    def append(self: Found, *others: Found) -> Found:
        """Of these cells followed by others."""
        several = (self, *others)
        columns = {
            name: np.concatenate([getattr(each, name) for each in several], axis=int(name == "pieces"))
            for name in ("cell", "pieces", "origin", "center", "distance", "best", "piece", "source", "by_all")
        }
        # Cells and pieces are counted on from one to the next.
        for name, counts in (("cell", [e.num_cells for e in several]), ("piece", [len(e.cell) for e in several])):
            columns[name] += np.repeat(np.cumsum([0, *counts[:-1]]), [len(getattr(each, name)) for each in several])
        return replace(self, num_cells=sum(each.num_cells for each in several), **columns)


def visible_sources(sight: Sight, regions: TurnRegions, domain: Box) -> VisibleSources:
    """Those of the domain as one cell: the triangles of free space, and all sources that each may use."""
    triangles = regions.triangulation.triangles.transpose(2, 0, 1)
    pieces, triangle = clip_to_box(triangles, domain.lo, domain.hi)
    origin, found = np.arange(len(triangle)), []
    # Of no pieces, one part without any.
    for chunk in parts(np.diff(regions.first)[triangle] + 1, _CHUNK) or [slice(0, 0)]:
        # Of each piece the goal, and the turn points that see some of its triangle.
        part, count = pieces[:, chunk], len(origin[chunk])
        entry, piece = run_members(regions.first, triangle[chunk])
        goal = np.zeros(count, int)
        piece = np.concatenate([np.arange(count), piece])
        source = np.concatenate([goal, regions.turns.vertex[regions.turn[entry]]])
        order = np.argsort(piece, kind="stable")
        of_pieces = goal, part, origin[chunk], centers(part), np.full(count, np.inf), goal
        unsettled = VisibleSources(sight, 1, *of_pieces, piece[order], source[order], np.zeros(len(piece), bool))
        found.append(_settled(unsettled, np.ones(count, bool)))
    together = found[0].append(*found[1:])
    return replace(together, num_cells=1, cell=np.zeros_like(together.cell))


def sources_of_boxes(
    sight: Sight, regions: TurnRegions, lo: Float[np.ndarray, "cells 2"], hi: Float[np.ndarray, "cells 2"]
) -> VisibleSources:
    """Those of boxes as cells, whatever they are parts of."""
    triangles = regions.triangulation.triangles.transpose(2, 0, 1)
    pieces, cell, triangle = clip_to_boxes(triangles, lo, hi)
    some = areas(pieces) > 0
    pieces, cell, triangle = pieces[:, some], cell[some], triangle[some]
    entry, piece = run_members(regions.first, triangle)
    goal, count = np.zeros(len(cell), int), len(cell)
    piece = np.concatenate([np.arange(count), piece])
    source = np.concatenate([goal, regions.turns.vertex[regions.turn[entry]]])
    order = np.argsort(piece, kind="stable")
    of_pieces = cell, pieces, triangle, centers(pieces), np.full(count, np.inf), goal
    unseen = np.zeros(len(piece), bool)
    unsettled = VisibleSources(sight, len(lo), *of_pieces, piece[order], source[order], unseen)
    return settled_cells(unsettled, np.ones(count, bool), lo, hi)


def filled(
    cell: Int[np.ndarray, "pieces"],
    pieces: Pieces,
    origin: Int[np.ndarray, "pieces"],
    walls: shapely.STRtree,
    boxes: tuple[Float[np.ndarray, "cells 2"], Float[np.ndarray, "cells 2"]],
) -> tuple[Pieces, Int[np.ndarray, "pieces"], OfPieces, OfPieces]:
    """Where several pieces fill a cell that lies in free space altogether, the first of them is all of it.

    Returns:
        The pieces; the origin of each; which stay, those without area do not; and which are of such cells.
    """
    (lo, hi), area = boxes, areas(pieces)
    total, count = (np.bincount(cell, weight, len(lo)) for weight in (area, None))
    whole = (total >= _FILLED * np.prod(hi - lo, axis=1)) & (count > 1)
    whole[whole] = ~meet_walls(walls, lo[whole], hi[whole])
    is_merged = whole[cell]
    first = np.flatnonzero(is_merged & np.append(True, cell[1:] != cell[:-1])[: len(cell)])
    stays = (area > 0) & ~is_merged
    if len(first):
        pieces, origin, stays[first] = pieces.copy(), origin.copy(), True
        pieces[:, first], origin[first] = boxes_as_pieces(lo[whole], hi[whole]), -1
    return pieces, origin, stays, is_merged


def settled_cells(
    found: Found, changed: OfPieces, lo: Float[np.ndarray, "cells 2"], hi: Float[np.ndarray, "cells 2"]
) -> Found:
    """Settled, after the pieces of cells that lie in free space altogether are put together."""
    pieces, origin, stays, is_merged = filled(found.cell, found.pieces, found.origin, found.sight.walls, (lo, hi))
    if is_merged.any():
        # The piece that is the whole cell has the sources of all, none of which is known to be seen by all of it.
        owner = np.where(is_merged, found.first_piece[found.cell], np.arange(len(stays)))
        key = owner[found.piece] * np.int64(len(found.sources.points)) + found.source
        _, index = np.unique(key, return_index=True)
        found = replace(found._of_pairs(index), pieces=pieces, origin=origin)
        found = replace(found, piece=owner[found.piece], by_all=found.by_all & ~is_merged[found.piece])
    rows = np.flatnonzero(stays)
    return _settled(replace(found._of_pieces(rows), num_cells=len(lo)), (changed | is_merged)[rows])


def _settled(found: Found, changed: OfPieces) -> Found:
    """After what no point of the changed pieces can use is left out, and pieces from which nothing leads to the goal.

    What is seen of one's center is what is seen of all, or of a part; a source that another one beats wherever the
    piece is, or the way by its center, is not needed.
    """
    center = found.center.copy()
    center[changed] = centers(found.pieces[:, changed])
    # At most that by the center before, which is in the same free convex piece, or in the cell that is one now.
    found = replace(found, center=center, distance=found.distance + np.linalg.norm(center - found.center, axis=1))
    open_ = np.flatnonzero(changed[found.piece] & ~found.by_all)
    bends = found.sight.may_bend(found.pieces[:, found.piece[open_]], found.source[open_])
    keep = np.ones(len(found.piece), bool)
    keep[open_[~bends]] = False
    open_ = open_[bends]
    piece, source = found.piece[open_], found.source[open_]
    view = found.sight.cones.view[source]
    seen, alike = found.sight.shadows.see(view, found.pieces[:, piece], center[piece])
    by_all, by_center = found.by_all.copy(), found.by_all | ~changed[found.piece]
    by_all[open_], by_center[open_] = seen & alike, seen
    keep[open_[alike & ~seen]] = False
    # Far from the origin rounding may leave none to a piece that is all but a line: then it keeps those that it had.
    keep |= (np.bincount(found.piece[keep], minlength=len(changed)) == 0)[found.piece]
    return undominated(replace(found, by_all=by_all)._of_pairs(keep), changed, by_center[keep])


def undominated(found: Found, changed: OfPieces, by_center: Bool[np.ndarray, "pairs"]) -> Found:
    """With the distance at the centers of changed pieces, and without pairs that another one beats everywhere.

    A center that none of the sources is said to see keeps the bound of its distance that it has.
    """
    sources, pairs = found.sources, np.flatnonzero(changed[found.piece] & by_center)
    piece, source = found.piece[pairs], found.source[pairs]
    length = sources.distances[source] + np.linalg.norm(found.center[piece] - sources.points[source], axis=1)
    order = np.lexsort((found.rank(source), ~found.by_all[pairs], length, piece))
    order = order[np.append(True, piece[order[1:]] != piece[order[:-1]])] if len(order) else order
    best_pair, distance, best = np.full(len(changed), -1), found.distance.copy(), found.best.copy()
    best_pair[piece[order]], distance[piece[order]], best[piece[order]] = pairs[order], length[order], source[order]
    by_best = np.append(found.by_all, False)[best_pair]
    several = np.bincount(found.piece, minlength=len(changed)) > 1
    rivals = np.flatnonzero((changed & several & np.isfinite(distance))[found.piece])
    rivals = rivals[best_pair[found.piece[rivals]] != rivals]
    piece, source = found.piece[rivals], found.source[rivals]
    apex = np.where(by_best[piece, None], sources.points[best[piece]], found.center[piece])
    offset = np.where(by_best, sources.distances[best], distance)[piece]
    lowest, _ = difference_of_cones(
        found.pieces[:, piece], sources.points[source], sources.distances[source], apex, offset
    )
    keep = np.isfinite(distance)[found.piece]
    keep[rivals[lowest > np.where(by_best[piece], -_LEAD * found.sight.tolerance, 0.0)]] = False
    found = replace(found, distance=distance, best=best)._of_pairs(keep)
    return found._of_pieces(np.flatnonzero(np.isfinite(distance)))
