"""Which corners the points of a cell may go to first, towards any goal: those that some of them see and turn at."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import run_members
from plr_jax.geometry.box import Box
from plr_jax.geometry.changes import sees_all
from plr_jax.geometry.convex_pieces import (
    Pieces,
    areas,
    boxes_as_pieces,
    clip_to_box,
    clip_to_boxes,
    convex_pieces,
    cut_parts,
)
from plr_jax.geometry.corners import CornerVisibility, ReflexCorners
from plr_jax.geometry.shadows import Shadows, shadows_of
from plr_jax.geometry.triangulation import Triangulation
from plr_jax.geometry.workspace import Workspace

_CHUNK = 1 << 17  # pairs of a piece and a corner at a time, where there are many


@dataclass(frozen=True, eq=False)
class VisibleCorners:
    """The free convex pieces of cells, and pairs of a piece and a corner at which a path from it may turn first.

    Pieces stand cell by cell, pairs piece by piece.

    Attributes:
        corners: All corners.
        shadows: What they see.
        num_cells: How many cells.
        cell: The cell of each piece.
        pieces: The pieces.
        piece: The piece of each pair.
        corner: The corner of each pair.
        by_all: Whether every point of the piece sees it.
    """

    corners: ReflexCorners
    shadows: Shadows
    num_cells: int
    cell: Int[np.ndarray, "pieces"]
    pieces: Pieces
    piece: Int[np.ndarray, "pairs"]
    corner: Int[np.ndarray, "pairs"]
    by_all: Bool[np.ndarray, "pairs"]

    @cached_property
    def first_piece(self) -> Int[np.ndarray, "cells_plus_one"]:
        """First piece of each cell, and their number."""
        return np.searchsorted(self.cell, np.arange(self.num_cells + 1))

    @cached_property
    def first_pair(self) -> Int[np.ndarray, "pieces_plus_one"]:
        """First pair of each piece, and their number."""
        return np.searchsorted(self.piece, np.arange(len(self.cell) + 1))

    def lists(self) -> tuple[Int[np.ndarray, "entries"], Int[np.ndarray, "entries"], Bool[np.ndarray, "entries"]]:
        """Cells and the corners listed for each, cell by cell, and whether all of the cell sees it."""
        count = np.int64(len(self.corners.points))
        key, index = np.unique(self.cell[self.piece] * count + self.corner, return_inverse=True)
        cell, corner = np.divmod(key, count)
        return cell, corner, np.bincount(index, self.by_all, len(key)) == np.diff(self.first_piece)[cell]

    def of_cells(self, cells: Int[np.ndarray, "some"]) -> "VisibleCorners":
        """The same of some of the cells, ascending."""
        rows, cell = run_members(self.first_piece, cells)
        return replace(self._of_pieces(rows), num_cells=len(cells), cell=cell)

    def append(self, other: "VisibleCorners") -> "VisibleCorners":
        """Of these cells followed by others."""
        return VisibleCorners(
            self.corners,
            self.shadows,
            self.num_cells + other.num_cells,
            np.concatenate([self.cell, self.num_cells + other.cell]),
            np.concatenate([self.pieces, other.pieces], axis=1),
            np.concatenate([self.piece, len(self.cell) + other.piece]),
            np.concatenate([self.corner, other.corner]),
            np.concatenate([self.by_all, other.by_all]),
        )

    def halves(
        self,
        parent: Int[np.ndarray, "halves"],
        axis: Int[np.ndarray, "halves"],
        is_upper: Bool[np.ndarray, "halves"],
        lo: Float[np.ndarray, "halves 2"],
        hi: Float[np.ndarray, "halves 2"],
    ) -> "VisibleCorners":
        """Of halves of the cells: the lower or the upper one along an axis, each with its box."""
        pieces, cell, rows, changed = cut_parts(self.pieces, self.first_piece, parent, axis, is_upper, lo, hi)
        part = replace(self._of_pieces(rows), num_cells=len(parent), cell=cell, pieces=pieces)
        stays = np.flatnonzero(areas(part.pieces) > 0)
        return _settled(part._of_pieces(stays), changed[stays])

    def _of_pieces(self, rows: Int[np.ndarray, "some"]) -> "VisibleCorners":
        """Those of some pieces, ascending, or repeated."""
        pairs, piece = run_members(self.first_pair, rows)
        return replace(
            self,
            cell=self.cell[rows],
            pieces=self.pieces[:, rows],
            piece=piece,
            corner=self.corner[pairs],
            by_all=self.by_all[pairs],
        )


def visible_corners(visibility: CornerVisibility, workspace: Workspace, domain: Box) -> VisibleCorners:
    """Those of the domain as one cell: the triangles of free space, and all corners that each may turn at."""
    pieces, _ = clip_to_box(convex_pieces(workspace.free_space), domain.lo, domain.hi)
    corners, shadows = visibility.corners, shadows_of(visibility.table)
    num_corners, parts = len(corners.points), []
    step = max(1, _CHUNK // max(1, num_corners))
    for begin in range(0, max(1, pieces.shape[1]), step):
        part = pieces[:, begin : begin + step]
        count = part.shape[1]
        piece, corner = np.repeat(np.arange(count), num_corners), np.tile(np.arange(num_corners), count)
        unknown = VisibleCorners(
            corners, shadows, 1, np.zeros(count, int), part, piece, corner, np.zeros(len(piece), bool)
        )
        found = _settled(unknown, np.ones(count, bool))
        parts.append((found.piece + begin, found.corner, found.by_all))
    piece, corner, by_all = (np.concatenate(column) for column in zip(*parts, strict=True))
    return VisibleCorners(corners, shadows, 1, np.zeros(pieces.shape[1], int), pieces, piece, corner, by_all)


def visible_of_lists(
    visibility: CornerVisibility,
    triangulation: Triangulation,
    boxes: tuple[Float[np.ndarray, "cells 2"], Float[np.ndarray, "cells 2"]],
    is_listed: Bool[np.ndarray, "cells corners"],
) -> VisibleCorners:
    """Those of cells, by their boxes, that may turn first at some of the corners that a list has for each."""
    pieces, cell, is_whole = _pieces_in(triangulation, *boxes)
    entry, piece = run_members(np.append(0, np.cumsum(is_listed.sum(axis=1))), cell)
    corner, by_all = np.nonzero(is_listed)[1][entry], np.zeros(len(piece), bool)
    # Of most boxes, which are free, all that is asked is whether all of them sees a corner.
    of_whole = np.flatnonzero(is_whole[piece])
    hulls = pieces[:, piece[of_whole], :4].transpose(1, 2, 0)
    by_all[of_whole] = sees_all(visibility.table, corner[of_whole], hulls)
    shadows = shadows_of(visibility.table)
    found = VisibleCorners(visibility.corners, shadows, len(is_listed), cell, pieces, piece, corner, by_all)
    return _settled(found, ~is_whole)


def _pieces_in(
    triangulation: Triangulation, lo: Float[np.ndarray, "boxes 2"], hi: Float[np.ndarray, "boxes 2"]
) -> tuple[Pieces, Int[np.ndarray, "pieces"], Bool[np.ndarray, "pieces"]]:
    """What of triangles lies in each box, box by box; the box of each piece, and whether it is all of it."""
    whole, locator = boxes_as_pieces(lo, hi), triangulation.locator
    triangle = locator.find((lo + hi) / 2)
    is_held = triangle >= 0
    for x in whole[:, :, :4].T:
        is_held &= (locator.heights(triangle, x) >= 0).all(axis=1)
    rest = np.flatnonzero(~is_held)
    triangles = np.ascontiguousarray(triangulation.triangles.transpose(2, 0, 1))
    pieces, box, _ = clip_to_boxes(triangles, lo[rest], hi[rest])
    stays = areas(pieces) > 0
    box = np.concatenate([np.flatnonzero(is_held), rest[box[stays]]])
    order = np.argsort(box, kind="stable")
    return np.concatenate([whole[:, is_held], pieces[:, stays]], axis=1)[:, order], box[order], is_held[box[order]]


def _settled(found: VisibleCorners, changed: Bool[np.ndarray, "pieces"]) -> VisibleCorners:
    """After corners are left out at which no path from a changed piece turns first, or that none of it sees."""
    may = np.ones(len(found.piece), bool)
    pairs = np.flatnonzero(changed[found.piece])
    may[pairs] = may_turn(found.corners, found.pieces[:, found.piece[pairs]], found.corner[pairs])
    by_all = found.by_all.copy()
    pairs = pairs[may[pairs] & ~by_all[pairs]]
    pieces = found.pieces[:, found.piece[pairs]]
    seen, alike = found.shadows.see(found.corner[pairs], pieces, pieces.mean(axis=2).T)
    by_all[pairs], may[pairs] = seen & alike, seen | ~alike
    return replace(found, piece=found.piece[may], corner=found.corner[may], by_all=by_all[may])


def may_turn(corners: ReflexCorners, pieces: Pieces, corner: Int[np.ndarray, "pieces"]) -> Bool[np.ndarray, "pieces"]:
    """Whether the line from some point of a piece to a corner may have both walls there on one side.

    From elsewhere it cuts off a part of the obstacle, and so no shortest path turns there.
    """
    # Corner by corner of the pieces: NumPy is slow where the last axis is short.
    x, y = np.ascontiguousarray(pieces.transpose(0, 2, 1)) - corners.points[corner].T[:, None]
    above = [wx * y - wy * x for wx, wy in (wall[corner].T for wall in corners.walls)]
    left = (above[0].max(axis=0) >= -corners.slack) & (above[1].max(axis=0) >= -corners.slack)
    right = (above[0].min(axis=0) <= corners.slack) & (above[1].min(axis=0) <= corners.slack)
    return left | right
