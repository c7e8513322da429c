"""Which sources the points of a cell may use: all that some of them may, and those that every one of them can."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import parts, run_members
from plr_jax._types import Sources
from plr_jax.geometry.box import Box
from plr_jax.geometry.convex_pieces import (
    Pieces,
    areas,
    boxes_as_pieces,
    centers,
    clip_to_box,
    contain,
    cut_parts,
    difference_of_cones,
)
from plr_jax.geometry.corners import TurnRegions
from plr_jax.oracles.cells.sight import Sight, Walls

_CHUNK = 1 << 16  # pairs of a piece and a source at a time, where there are many
_FILLED = 1 - 1e-9
"""Share of a cell's area that its pieces fill, for it to be worth asking whether a wall is in it."""
_OF_PIECES = ("origin", "center", "distance", "best")
Found = TypeVar("Found", bound="VisibleSources")
_LEAD = 1 / 128
"""Tolerances by which a source may be better yet and is left out; cells are halved less often."""


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
        return self.sight.sources

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
        return self.sight.see_points(source, points)

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
        of_pieces = {name: getattr(self, name)[rows] for name in ("cell", *_OF_PIECES)}
        return replace(
            self,
            pieces=self.pieces[:, rows],
            piece=piece,
            source=self.source[pairs],
            by_all=self.by_all[pairs],
            **of_pieces,
        )

    def parts(
        self,
        parent: Int[np.ndarray, "parts"],
        axis: Int[np.ndarray, "parts"],
        is_upper: Bool[np.ndarray, "parts"],
        lo: Float[np.ndarray, "parts 2"],
        hi: Float[np.ndarray, "parts 2"],
    ) -> "VisibleSources":
        """Of parts of the cells: boxes that lie in a cell each and are cut from it along one axis."""
        return settled_cells(*self.cut(parent, axis, is_upper, lo, hi), lo, hi)

    def cut(
        self: Found,
        parent: Int[np.ndarray, "parts"],
        axis: Int[np.ndarray, "parts"],
        is_upper: Bool[np.ndarray, "parts"],
        lo: Float[np.ndarray, "parts 2"],
        hi: Float[np.ndarray, "parts 2"],
    ) -> tuple[Found, Bool[np.ndarray, "pieces"]]:
        """Parts of the cells with the pairs of these, before anything is asked of them, and which pieces were cut."""
        pieces, cell, rows, is_cut = cut_parts(self.pieces, self.first_piece, parent, axis, is_upper, lo, hi)
        inherited = replace(self._of_pieces(rows), num_cells=len(parent), cell=cell, pieces=pieces)
        return inherited, is_cut

    def append(self: Found, *others: Found) -> Found:
        """Of these cells followed by others."""
        if not others:
            return self
        several = (self, *others)
        cells = np.cumsum([0] + [each.num_cells for each in several])
        pieces = np.cumsum([0] + [len(each.cell) for each in several])
        columns = {
            name: np.concatenate([getattr(each, name) for each in several])
            for name in (*_OF_PIECES, "source", "by_all")
        }
        return type(self)(
            sight=self.sight,
            num_cells=int(cells[-1]),
            cell=np.concatenate([each.cell + start for each, start in zip(several, cells[:-1], strict=True)]),
            pieces=np.concatenate([each.pieces for each in several], axis=1),
            piece=np.concatenate([each.piece + start for each, start in zip(several, pieces[:-1], strict=True)]),
            **columns,
        )


def visible_sources(sight: Sight, regions: TurnRegions, domain: Box) -> VisibleSources:
    """Those of the domain as one cell: the triangles of free space, and all sources that each may use."""
    triangles = regions.triangulation.triangles.transpose(2, 0, 1)
    pieces, triangle = clip_to_box(triangles, domain.lo, domain.hi)
    # Of no pieces, one part without any.
    chunks = parts(np.diff(regions.first)[triangle] + 1, _CHUNK) or [slice(0, 0)]
    found = [_of_triangles(sight, regions, pieces, triangle, chunk) for chunk in chunks]
    first, *others = found
    return replace(first.append(*others), num_cells=1, cell=np.zeros(sum(len(p.cell) for p in found), int))


def _of_triangles(
    sight: Sight, regions: TurnRegions, pieces: Pieces, triangle: Int[np.ndarray, "pieces"], chunk: slice
) -> VisibleSources:
    """Some pieces of triangles as one cell: the goal and the turn points that see some of its triangle for each."""
    part, origin = pieces[:, chunk], np.arange(pieces.shape[1])[chunk]
    count = part.shape[1]
    entry, piece = run_members(regions.first, triangle[chunk])
    piece = np.concatenate([np.arange(count), piece])
    source = np.concatenate([np.zeros(count, int), regions.turns.vertex[regions.turn[entry]]])
    order = np.argsort(piece, kind="stable")
    piece, source = piece[order], source[order]
    cell, unknown, by_all = np.zeros(count, int), np.full(count, np.inf), np.zeros(len(piece), bool)
    unsettled = VisibleSources(sight, 1, cell, part, origin, centers(part), unknown, cell, piece, source, by_all)
    return _settled(unsettled, np.ones(count, bool))


def are_filled(
    cell: Int[np.ndarray, "pieces"],
    area: Float[np.ndarray, "pieces"],
    walls: Walls,
    lo: Float[np.ndarray, "cells 2"],
    hi: Float[np.ndarray, "cells 2"],
) -> Bool[np.ndarray, "cells"]:
    """Which cells of several pieces lie in free space altogether."""
    total, count = (np.bincount(cell, weight, len(lo)) for weight in (area, None))
    filled = np.flatnonzero((total >= _FILLED * np.prod(hi - lo, axis=1)) & (count > 1))
    result = np.zeros(len(lo), bool)
    result[filled[~walls.meet(lo[filled], hi[filled])]] = True
    return result


def settled_cells(
    found: Found,
    changed: Bool[np.ndarray, "pieces"],
    lo: Float[np.ndarray, "cells 2"],
    hi: Float[np.ndarray, "cells 2"],
) -> Found:
    """Settled, after the pieces of cells that lie in free space altogether are put together."""
    area = areas(found.pieces)
    merged = are_filled(found.cell, area, found.sight.walls, lo, hi)
    stays = area > 0
    if merged.any():
        is_merged = merged[found.cell]
        is_first = np.append(True, found.cell[1:] != found.cell[:-1])
        stays = (stays & ~is_merged) | (is_merged & is_first)
        whole = found.cell[is_merged & is_first]
        pieces, origin = found.pieces.copy(), found.origin.copy()
        pieces[:, is_merged & is_first] = boxes_as_pieces(lo[whole], hi[whole])
        origin[is_merged & is_first] = -1
        owner = np.where(is_merged, np.flatnonzero(is_first)[np.cumsum(is_first) - 1], np.arange(len(area)))
        key = owner[found.piece] * np.int64(len(found.sources.points)) + found.source
        _, index = np.unique(key, return_index=True)
        found = replace(
            found,
            pieces=pieces,
            origin=origin,
            piece=owner[found.piece[index]],
            source=found.source[index],
            by_all=found.by_all[index] & ~is_merged[found.piece[index]],
        )
        changed = changed | is_merged
    rows = np.flatnonzero(stays)
    found, changed = found._of_pieces(rows), changed[rows]
    return _settled(replace(found, num_cells=len(lo)), changed)


def _settled(found: Found, changed: Bool[np.ndarray, "pieces"]) -> Found:
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
    seen, alike = found.sight.see(source, found.pieces[:, piece], center[piece])
    by_all, by_center = found.by_all.copy(), found.by_all | ~changed[found.piece]
    by_all[open_], by_center[open_] = seen & alike, seen
    keep[open_[alike & ~seen]] = False
    # Far from the origin rounding may leave none to a piece that is all but a line: then it keeps those that it had.
    keep |= (np.bincount(found.piece[keep], minlength=len(changed)) == 0)[found.piece]
    found = replace(found, piece=found.piece[keep], source=found.source[keep], by_all=by_all[keep])
    return undominated(found, changed, by_center[keep])


def undominated(found: Found, changed: Bool[np.ndarray, "pieces"], by_center: Bool[np.ndarray, "pairs"]) -> Found:
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
    by_best = best_pair >= 0
    by_best[by_best] = found.by_all[best_pair[by_best]]
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
    found = replace(
        found,
        distance=distance,
        best=best,
        piece=found.piece[keep],
        source=found.source[keep],
        by_all=found.by_all[keep],
    )
    return found._of_pieces(np.flatnonzero(np.isfinite(distance)))
