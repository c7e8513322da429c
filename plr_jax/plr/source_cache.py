"""Cache the *sources* of cells: corners (or the goal) to which shortest paths from points of a cell may go first."""

import numpy as np
from jaxtyping import Bool, Float

from plr_jax._arrays import batches, parts, take_ragged
from plr_jax._types import CellSources
from plr_jax.geometry.box import Box
from plr_jax.plr.tree import Cells, Tree

_POINTS_AT_ONCE = 1 << 16  # pairs of a convex piece of free space and a point that are tested at once
_PAIRS_AT_ONCE = 1 << 19  # pairs of a point and a source that are evaluated at once


class SourceCache:
    """A cache of the sources of cells, which computes the sources of a cell's half from the sources of the cell.

    ``root`` has the sources of the whole domain.
    """

    def __init__(self, domain: Box, root: CellSources) -> None:
        self._domain = domain
        self._parts: list[CellSources] = []
        # Hashes of known cells, sorted. Cells with equal hashes are taken for equal: among a million cells, two have
        # equal hashes of 64 bits with a probability of 3e-8.
        self._hashes = np.zeros(0, np.uint64)
        self._place = np.zeros((2, 0), np.int64)  # the part that holds each known cell, and its index in this part
        self._remember(Cells.root(2), root)

    def sources(self, cells: Cells) -> CellSources:
        """Return the sources of cells; cache them, and the sources of larger cells from which they come."""
        if len(new := cells[np.flatnonzero(~self._knows(cells))]):
            # 1. Find the parent of which each new cell is a half: the cell that is twice as wide along the first axis
            #    if it is cached, else along the second axis. A parent that is not cached comes from its own parent.
            by_axis = [Cells(np.maximum(new.depth - step, 0), new.position >> step) for step in np.eye(2, dtype=int)]
            axis = np.where((new.depth[:, 0] > 0) & self._knows(by_axis[0]) | (new.depth[:, 1] == 0), 0, 1)
            parents = by_axis[0].append(by_axis[1])[axis * len(new) + np.arange(len(new))]
            if len(unknown := np.flatnonzero(~self._knows(parents))):
                self.sources(parents[unknown])
            # 2. Cut each parent once for all of its halves: sort the new cells by parent. Halves are grown to include
            #    the points that queries assign to them by rounding.
            _, first, parent = np.unique(parents.hashes(), return_index=True, return_inverse=True)
            order = np.argsort(parent, kind="stable")
            is_upper = new.position[np.arange(len(new)), axis] % 2 == 1
            lo, hi = new[order].grown_boxes(self._domain)
            halves = self._recall(parents[first]).parts(parent[order], axis[order], is_upper[order], lo, hi)
            self._remember(new[order], halves)
        return self._recall(cells)

    def sources_of_leaves(self, tree: Tree) -> CellSources:
        """Return the sources of a tree's leaves.

        If some leaves are not cached, their sources are computed from the sources of the domain, level by level.
        """
        if not self._knows(tree.leaves).all():
            nodes = np.zeros(1, np.int64)  # of a level; `visible` has their sources
            visible = self.sources(Cells.root(2))
            while len(nodes):
                is_leaf = tree.child[nodes] < 0
                leaf, inner = np.flatnonzero(is_leaf), np.flatnonzero(~is_leaf)
                self._remember(tree.cells[nodes[leaf]], visible.of_cells(leaf))
                parent, axis = np.repeat(inner, 2), np.repeat(tree.axis[nodes[inner]], 2)
                nodes = tree.halves(nodes[inner])
                lo, hi = tree.cells[nodes].grown_boxes(self._domain)
                visible = visible.parts(parent, axis, np.arange(len(nodes)) % 2 == 1, lo, hi)
        return self._recall(tree.leaves)

    def _remember(self, cells: Cells, visible: CellSources) -> None:
        # Add the sources of cells, as a new part.
        hashes = np.append(self._hashes, cells.hashes())
        part = np.full(len(cells), len(self._parts))
        place = np.append(self._place, np.stack([part, np.arange(len(cells))]), axis=1)
        order = np.argsort(hashes, kind="stable")
        self._hashes, self._place = hashes[order], place[:, order]
        self._parts.append(visible)

    def _knows(self, cells: Cells) -> Bool[np.ndarray, " cells"]:
        hashes = cells.hashes()
        nearest = np.minimum(np.searchsorted(self._hashes, hashes), len(self._hashes) - 1)
        return self._hashes[nearest] == hashes

    def _recall(self, cells: Cells) -> CellSources:
        # Read each part once: sort the cells by part, and restore their order at the end.
        part, place = self._place[:, np.searchsorted(self._hashes, cells.hashes())]
        order = np.argsort(part, kind="stable")
        runs = np.split(order, np.flatnonzero(np.diff(part[order])) + 1)
        first, *others = (self._parts[part[run[0]]].of_cells(place[run]) for run in runs)
        return first.append(*others).of_cells(np.argsort(order)) if others else first


def distances_in_cells(visible: CellSources, x: Float[np.ndarray, "cells k 2"]) -> Float[np.ndarray, "cells k"]:
    """Return the exact distance to the goal at each point ``x[i, j]`` of cell ``i``; ``inf`` without a path.

    ``visible`` has the free space and the sources of each cell.
    """
    # 1. Find all pairs of a piece of free space and a point in it, as indices of pieces and of rows of `points`.
    num_columns, points = x.shape[1], x.reshape(-1, 2)
    distance = np.full(len(points), np.inf)
    containing = [np.zeros((2, 0), int)]
    for piece in batches(np.arange(len(visible.cell)), max(1, _POINTS_AT_ONCE // num_columns)):
        row, column = np.nonzero(visible.hold(piece, x[visible.cell[piece]]))
        containing.append(np.stack([piece[row], num_columns * visible.cell[piece[row]] + column]))
    piece, point = np.concatenate(containing, axis=1)
    # 2. Find each point's shortest path by way of a source that it sees. First take the sources that all of the piece
    #    sees; then test sight only where another source would be nearer.
    for batch in parts(np.diff(visible.first_pair)[piece], _PAIRS_AT_ONCE):
        pair, row = take_ragged(visible.first_pair, piece[batch])
        source, start = visible.source[pair], point[batch][row]
        dx, dy = (points[start] - visible.sources.points[source]).T
        length = visible.sources.distances[source] + np.sqrt(dx * dx + dy * dy)
        by_all = visible.by_all[pair]
        np.minimum.at(distance, start[by_all], length[by_all])
        unsure = np.flatnonzero(~by_all & (length < distance[start]))
        seen = unsure[visible.see(source[unsure], points[start[unsure]])]
        np.minimum.at(distance, start[seen], length[seen])
    return distance.reshape(x.shape[:2])
