"""The binary space partition of a PLR: dyadic cells, the tree whose leaves partition the domain, and grids."""

from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import product
from typing import Any, Self, TypeAlias, cast

import numpy as np
from jaxtyping import Bool, Float, Int, UInt64

from plr_jax._arrays import hash64, ragged_indices
from plr_jax.geometry.box import Box

PLACING = 2.0**-21  # largest distance of a point to the cell in which a 32-bit query puts it, in domain widths


class Rows:
    """A base class of dataclasses whose columns have one row for each item.

    The columns are those fields that are NumPy arrays, or objects with a method ``append``, such as other ``Rows``
    or :class:`CellSources`. Indexing selects the same rows of all columns.
    """

    def __len__(self) -> int:
        return len(next(iter(self._columns().values())))

    def __getitem__(self, index: Any) -> Self:
        return cast(Any, replace)(self, **{name: column[index] for name, column in self._columns().items()})

    def append(self, *others: Self) -> Self:
        """Concatenate the columns of this object and of ``others``; keep the other attributes of this object."""
        columns = {}
        for name, column in self._columns().items():
            parts = [getattr(other, name) for other in others]
            columns[name] = column.append(*parts) if hasattr(column, "append") else np.concatenate([column, *parts])
        return cast(Any, replace)(self, **columns)

    def _columns(self) -> dict[str, Any]:
        rows = {field.name: getattr(self, field.name) for field in fields(cast(Any, self))}
        return {name: each for name, each in rows.items() if isinstance(each, np.ndarray) or hasattr(each, "append")}


@dataclass(frozen=True, eq=False)
class Cells(Rows):
    """Dyadic cells of a domain.

    Along each axis, a cell reaches from ``position / 2**depth`` to ``(position + 1) / 2**depth``, in fractions of the
    domain (0 at its lower end, 1 at its upper end).
    """

    depth: Int[np.ndarray, "cells dim"]
    position: Int[np.ndarray, "cells dim"]

    @staticmethod
    def root(dim: int) -> "Cells":
        return Cells(np.zeros((1, dim), np.int64), np.zeros((1, dim), np.int64))

    @property
    def dim(self) -> int:
        return self.depth.shape[1]

    @property
    def fractions(self) -> tuple[Float[np.ndarray, "cells dim"], Float[np.ndarray, "cells dim"]]:
        """Lower and upper corners of the cells, as fractions of the domain (from 0 to 1 along each axis)."""
        size = np.ldexp(1.0, -self.depth)
        return self.position * size, (self.position + 1) * size

    def boxes(self, domain: Box) -> tuple[Float[np.ndarray, "cells dim"], Float[np.ndarray, "cells dim"]]:
        lo, hi = self.fractions
        return domain.at(lo), domain.at(hi)

    def grown_boxes(self, domain: Box) -> tuple[Float[np.ndarray, "cells dim"], Float[np.ndarray, "cells dim"]]:
        """Return the lower and upper corners of boxes that enclose the cells with a margin for rounding.

        The margin covers all points that a 32-bit query, by rounding, may assign to a cell.
        """
        lo, hi = self.boxes(domain)
        return lo - PLACING * domain.width, hi + PLACING * domain.width

    def longest_axis(self, domain: Box) -> Int[np.ndarray, " cells"]:
        return (domain.width * np.ldexp(1.0, -self.depth)).argmax(axis=1)

    def points(self, u: Float[np.ndarray, "k dim"], domain: Box) -> Float[np.ndarray, "cells k dim"]:
        """Return the ``k`` points of each cell with the local coordinates ``u``, from -1 to 1 across the cell."""
        x = np.empty((len(self), *u.shape))
        for axis in range(self.dim):  # NumPy is slow if the last axis is short
            fraction = (self.position[:, axis, None] + 0.5) + 0.5 * u[:, axis]
            fraction *= np.ldexp(1.0, -self.depth[:, axis])[:, None]
            x[:, :, axis] = domain.lo[axis] + domain.width[axis] * fraction
        return x

    def hashes(self) -> UInt64[np.ndarray, " cells"]:
        """Return a 64-bit hash of each cell's depths and positions. Cells with equal hashes are taken for equal."""
        numbers = (np.int64(1) << self.depth) + self.position  # 1 is the whole axis, 2 and 3 are its halves
        total = np.zeros(len(self), np.uint64)
        for along in numbers.T:
            total = hash64(total + along.astype(np.uint64))
        return total

    def split(self, axis: Int[np.ndarray, " cells"]) -> "Cells":
        """Halve cell ``i`` along ``axis[i]``; in the result, a cell's upper half follows its lower half."""
        parent = np.repeat(np.arange(len(self)), 2)
        return self[parent].halves(axis[parent], np.arange(len(parent)) % 2 == 1)

    def halves(self, axis: Int[np.ndarray, " cells"], is_upper: Bool[np.ndarray, " cells"]) -> "Cells":
        """Return one half of each cell, cut along its ``axis``: the upper half where ``is_upper``, else the lower."""
        halved = np.eye(self.dim, dtype=np.int64)[axis]
        return Cells(self.depth + halved, (self.position << halved) + halved * is_upper[:, None])


def grown_domain(domain: Box) -> Box:
    """Return a box that contains all points that a 32-bit query, by rounding, may take for points of the domain."""
    lo, hi = Cells.root(domain.dim).grown_boxes(domain)
    return Box(lo[0], hi[0])


MAX_DEPTH = 60  # a leaf's path from the root, one bit per split, fits a 64-bit integer


@dataclass(frozen=True, eq=False)
class Tree:
    """A binary tree of cells; nodes are stored level by level from the root, left (lower half) to right."""

    cells: Cells
    axis: Int[np.ndarray, " nodes"]  # along which each node is halved, 0 for a leaf
    child: Int[np.ndarray, " nodes"]  # each node's lower child, which the upper child follows; -1 for a leaf
    node_of_leaf: Int[np.ndarray, "leaves"]  # in left-to-right traversal order
    splits: list[Int[np.ndarray, " _"]]  # the split nodes of each level
    order: Int[np.ndarray, "leaves"]  # index of each leaf among the cells from which tree_of built the tree

    @cached_property
    def leaves(self) -> Cells:
        return self.cells[self.node_of_leaf]

    @cached_property
    def leaf_of_node(self) -> Int[np.ndarray, " nodes"]:
        """For each node that is a leaf, the index of this leaf; -1 for a split node."""
        leaf = np.full(len(self.child), -1)
        leaf[self.node_of_leaf] = np.arange(len(self.node_of_leaf))
        return leaf

    def halves(self, nodes: Int[np.ndarray, " splits"]) -> Int[np.ndarray, "halves"]:
        """Return both children of each node, the lower one first."""
        return (self.child[nodes][:, None] + np.arange(2)).ravel()


def tree_of(cells: Cells) -> Tree:
    """Build the tree whose leaves are the given cells, which partition the domain.

    A node is split along the first axis along which all leaves in it are narrower than the node.
    """
    # The tree grows level by level. All arrays of nodes are of the current level.
    node = np.zeros(len(cells), np.int64)  # of each leaf: the node of the level that contains it, at last its own
    active = np.arange(len(cells))  # leaves below the level
    node_depth = np.zeros((1, cells.dim), np.int64)
    axes = []
    while len(active):
        # 1. Along each axis, by how many halvings all leaves of a node are narrower at least.
        narrower = np.full(node_depth.shape, np.iinfo(np.int64).max)
        for axis in range(cells.dim):  # ``np.minimum.at`` is fast only with one index array
            below = cells.depth[active, axis] - node_depth[node[active], axis]
            np.minimum.at(narrower[:, axis], node[active], below)
        # 2. Split nodes along the first such axis; without one, a node is a leaf.
        is_inner = np.any(narrower, axis=1)
        split_axis = np.argmax(narrower > 0, axis=1)
        axes.append(np.where(is_inner, split_axis, -1))
        # 3. Move leaves to their half: the next binary digit of their position. Inner node i has the halves 2 i and
        #    2 i + 1.
        active = active[is_inner[node[active]]]
        along = split_axis[node[active]]
        below = cells.depth[active, along] - node_depth[node[active], along] - 1
        is_upper = (cells.position[active, along] >> below) & 1
        node[active] = 2 * (np.cumsum(is_inner) - 1)[node[active]] + is_upper
        halved = np.eye(cells.dim, dtype=np.int64)[split_axis[is_inner]]
        node_depth = np.repeat(node_depth[is_inner] + halved, 2, axis=0)
    tree = tree_of_axes(axes, cells.dim)
    # 4. The level of a leaf (its number of splits) and its place in that level identify its node.
    first = np.cumsum([0, *(len(axis) for axis in axes)])
    index = np.empty(len(tree.child), np.int64)
    index[first[cells.depth.sum(axis=1)] + node] = np.arange(len(cells))
    return replace(tree, order=index[tree.node_of_leaf])


def tree_of_axes(axes: list[Int[np.ndarray, " _"]], dim: int) -> Tree:
    """Build a tree from the split axes of its nodes, an array for each level; -1 instead of an axis marks a leaf."""
    child = np.full(sum(map(len, axes)), -1)
    cells = Cells.root(dim)  # of a level
    levels, splits, first = [], [], 0  # the first node of a level
    for axis in axes:
        inner = np.flatnonzero(axis >= 0)
        split = first + inner
        first += len(axis)
        child[split] = first + 2 * np.arange(len(split))
        levels.append(cells)
        splits.append(split)
        cells = cells[inner].split(axis[inner])
    node_of_leaf = np.flatnonzero(child < 0)[leaf_order(axes)]
    axis = np.maximum(np.concatenate(axes), 0)
    return Tree(levels[0].append(*levels[1:]), axis, child, node_of_leaf, splits, np.arange(len(node_of_leaf)))


def leaf_order(axes: list[Int[np.ndarray, " _"]]) -> Int[np.ndarray, " leaves"]:
    """Return the indices of a tree's leaves in the order of a traversal from left to right.

    ``axes`` has an array of split axes for each level; -1 marks a leaf. Leaves are counted level by level.
    """
    # A leaf's path from the root, one bit for each split from the highest bit down, 1 for the upper half, sorts them.
    paths, path = [], np.zeros(1, np.int64)  # of the leaves above a level, and of each node of the level
    for depth, axis in enumerate(axes):
        paths.append(path[axis < 0])
        path = (path[axis >= 0, None] + np.array([0, 1 << (MAX_DEPTH - depth)])).ravel()
    return np.argsort(np.concatenate(paths))


def corner_bits(dim: int) -> Int[np.ndarray, "corners dim"]:
    """Return the corners of the unit cube, one per row, as bits in binary order: the last axis varies fastest."""
    return np.array(list(product((0, 1), repeat=dim)))


# Regular grids over the domain, with ``2**bits`` cells along each axis.
PerAxis: TypeAlias = Int[np.ndarray, " dim"]
# Integer points, such as the coordinates of grid cells, and before them the index of each point's leaf or box.
IndexedPoints: TypeAlias = tuple[Int[np.ndarray, " points"], Int[np.ndarray, "points dim"]]


def num_pairs(cells: Cells, block_bits: PerAxis) -> float:
    """Count the overlapping pairs of a leaf and a cell of a grid with ``2**block_bits`` cells along each axis."""
    return np.sum(2.0 ** np.maximum(block_bits - cells.depth, 0).sum(axis=1))


def leaves_in_blocks(cells: Cells, block_bits: PerAxis) -> IndexedPoints:
    """Return all overlapping pairs of a leaf (its index) and a cell of a coarse grid (its integer coordinates).

    The grid has ``2**block_bits`` cells along each axis.
    """
    # Along an axis, a leaf as narrow as a block lies in one block; a wider leaf covers 2**(block_bits - depth)
    # blocks.
    finer_bits = np.maximum(block_bits - cells.depth, 0)
    first = (cells.position >> np.maximum(cells.depth - block_bits, 0)) << finer_bits
    return enumerate_boxes(first, np.int64(1) << finer_bits)


def enumerate_boxes(first: Int[np.ndarray, "boxes dim"], count: Int[np.ndarray, "boxes dim"]) -> IndexedPoints:
    """Enumerate the integer points ``p`` of all boxes ``first <= p < first + count``.

    Return the index of each point's box, and each point.
    """
    # Points of a box are numbered in row-major order; the digits of this number, the last axis lowest, are the
    # offsets.
    box, index = ragged_indices(count.prod(axis=1))
    points = np.empty((len(box), first.shape[1]), np.int64)
    for axis in reversed(range(first.shape[1])):
        index, digit = np.divmod(index, count[box, axis])
        points[:, axis] = first[box, axis] + digit
    return box, points


def row_major(slots: Int[np.ndarray, "n dim"], bits: Int[np.ndarray, "n dim"] | PerAxis) -> Int[np.ndarray, " n"]:
    """Return the row-major index of each cell ``slots[i]`` in a grid with ``2**bits`` cells along each axis.

    ``bits`` is ``(n, dim)``, or ``(dim,)`` if all grids are equal.
    """
    index = np.zeros(len(slots), np.int64)
    for axis in range(slots.shape[1]):
        index = (index << bits[..., axis]) | slots[:, axis]
    return index


def spread_bits(bits: PerAxis, most: int) -> PerAxis:
    """Distribute up to ``most`` halvings over the axes; axis ``i`` needs ``bits[i]`` halvings.

    Each halving goes to the axis that still needs the most. Return the number of halvings of each axis.
    """
    chosen = np.zeros_like(bits)
    while chosen.sum() < min(most, bits.sum()):
        chosen[np.argmax(bits - chosen)] += 1
    return chosen
