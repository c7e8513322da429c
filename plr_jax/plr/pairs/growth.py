"""Which cells to halve: those in much of whose free space a query tries corners in vain.

A leaf lists every corner that some point of it may turn at first. A query tries the corners of a list one after the
other, and drops those that its point does not see. All of these are corners that only a part of the cell sees. So
cells are halved in the order of their free area times the number of such corners.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import run_members
from plr_jax.geometry.box import Box
from plr_jax.geometry.convex_pieces import areas
from plr_jax.plr.growth.limits import Limits, grow
from plr_jax.plr.pairs.visible_corners import VisibleCorners
from plr_jax.plr.partition.cells import Cells

_SHARE = 0.25  # of the largest key, above which cells are halved in a round


@dataclass(frozen=True, eq=False)
class Lists:
    """Cells and the corners listed for each.

    Attributes:
        cells: The cells.
        cell: The cell of each entry, ascending.
        corner: Its corner.
        by_all: Whether all of the cell sees it.
    """

    cells: Cells
    cell: Int[np.ndarray, "entries"]
    corner: Int[np.ndarray, "entries"]
    by_all: Bool[np.ndarray, "entries"]

    def of_cells(self, rows: Int[np.ndarray, "some"]) -> "Lists":
        """Those of some cells."""
        first = np.searchsorted(self.cell, np.arange(len(self.cells) + 1))
        entries, cell = run_members(first, rows)
        return Lists(self.cells[rows], cell, self.corner[entries], self.by_all[entries])

    def append(self, other: "Lists") -> "Lists":
        """Those of these cells followed by others."""
        return Lists(
            self.cells.append(other.cells),
            np.concatenate([self.cell, len(self.cells) + other.cell]),
            np.concatenate([self.corner, other.corner]),
            np.concatenate([self.by_all, other.by_all]),
        )


@dataclass(frozen=True, eq=False)
class _ListTree:
    """All nodes so far, with their lists, and the leaves among them with all that is known of them.

    Attributes:
        lists: Of all nodes.
        key: How soon each is to be halved; not before its parent.
        is_leaf: Which nodes are leaves.
        visible: Of the leaves, in order.
    """

    lists: Lists
    key: Float[np.ndarray, "nodes"]
    is_leaf: Bool[np.ndarray, "nodes"]
    parent: Int[np.ndarray, "nodes"]
    visible: VisibleCorners

    def __len__(self) -> int:
        return int(self.is_leaf.sum())

    def leaves_above(self, key: float) -> Lists:
        """The leaves of the tree in which only nodes with larger keys are halved."""
        is_halved = ~self.is_leaf & (self.key > key)
        of_halved = np.append(True, is_halved[self.parent[1:]])
        return self.lists.of_cells(np.flatnonzero(of_halved & ~is_halved))


def grow_lists(
    root: VisibleCorners, domain: Box, limits: Limits, most_leaves: int, num_bytes: Callable[[Lists], int]
) -> Lists:
    """The leaves whose file has as many bytes as the limits allow, or fewer if no cell is worth halving."""
    lists = _lists_of(root, Cells.root(2))
    tree = _ListTree(lists, _keys(root, lists, limits), np.ones(1, bool), np.full(1, -1), root)

    def halved(tree: _ListTree) -> _ListTree | None:
        leaves = np.flatnonzero(tree.is_leaf)
        largest = tree.key[leaves].max()
        if largest <= 0 or len(tree) >= most_leaves or num_bytes(tree.leaves_above(0.0)) > limits.max_bytes:
            return None
        return _halved(tree, leaves[tree.key[leaves] > _SHARE * largest], domain, limits)

    tree = grow(tree, halved, limits)
    keys = np.unique(np.append(tree.key[~tree.is_leaf], 0.0))
    low, high = 0, len(keys) - 1  # with the last key as threshold nothing is halved
    while low < high:
        middle = (low + high) // 2
        leaves = tree.leaves_above(keys[middle])
        fits = len(leaves.cells) <= most_leaves and num_bytes(leaves) <= limits.max_bytes
        low, high = (low, middle) if fits else (middle + 1, high)
    return tree.leaves_above(keys[low])


def _halved(tree: _ListTree, nodes: Int[np.ndarray, "nodes"], domain: Box, limits: Limits) -> _ListTree:
    """The tree after some of its leaves are halved, along their longer sides."""
    leaves = np.flatnonzero(tree.is_leaf)
    cells = tree.lists.cells[nodes]
    axis = cells.longest_axis(domain)
    both = cells.split(axis)
    place, is_upper = np.repeat(np.searchsorted(leaves, nodes), 2), np.tile([False, True], len(nodes))
    visible = tree.visible.halves(place, np.repeat(axis, 2), is_upper, *both.grown_boxes(domain))
    lists = _lists_of(visible, both)
    key = np.minimum(_keys(visible, lists, limits), np.repeat(tree.key[nodes], 2))
    is_leaf = tree.is_leaf.copy()
    is_leaf[nodes] = False
    stay = np.flatnonzero(is_leaf[leaves])
    return _ListTree(
        tree.lists.append(lists),
        np.append(tree.key, key),
        np.append(is_leaf, np.ones(len(both), bool)),
        np.append(tree.parent, np.repeat(nodes, 2)),
        tree.visible.of_cells(stay).append(visible),
    )


def _lists_of(visible: VisibleCorners, cells: Cells) -> Lists:
    return Lists(cells, *visible.lists())


def _keys(visible: VisibleCorners, lists: Lists, limits: Limits) -> Float[np.ndarray, "cells"]:
    """Free area of each cell times how many of its corners are not seen by all of it; 0 where it is to stay."""
    area = np.bincount(visible.cell, areas(visible.pieces), len(lists.cells))
    doubtful = np.bincount(lists.cell, ~lists.by_all, len(lists.cells))
    return np.where((lists.cells.depth < limits.max_axis_depth).all(axis=1), area * doubtful, 0.0)
