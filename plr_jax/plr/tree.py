"""Dyadic cells: the nodes of a binary space partition that halves one axis at a time; and their tree."""

from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import product
from typing import Any, Self, cast

import numpy as np
from jaxtyping import Bool, Float, Int, UInt64

from plr_jax._arrays import hash64
from plr_jax.geometry.box import Box

PLACING = 2.0**-21
"""How far beside its cell, in widths of the domain, a query may place a point, as it computes in 32 bits."""


class Rows:
    """Base of a dataclass whose columns, arrays or rows themselves, are of equal length.

    Fields of other types are what all rows share.
    """

    def __getitem__(self, index: Any) -> Self:
        return cast(Any, replace)(self, **{name: column[index] for name, column in self._columns().items()})

    def append(self, *others: Self) -> Self:
        """These rows, followed by others."""
        columns = {}
        for name, column in self._columns().items():
            parts = [getattr(other, name) for other in others]
            columns[name] = column.append(*parts) if isinstance(column, Rows) else np.concatenate([column, *parts])
        return cast(Any, replace)(self, **columns)

    def _columns(self) -> dict[str, Any]:
        every = {field.name: getattr(self, field.name) for field in fields(cast(Any, self))}
        return {name: column for name, column in every.items() if isinstance(column, np.ndarray | Rows)}


@dataclass(frozen=True, eq=False)
class Cells(Rows):
    """A batch of dyadic cells of one domain.

    Along each axis a cell is the interval ``lo + [position, position + 1] * (hi - lo) / 2**depth`` of the domain
    ``[lo, hi]``, so a partition is exact in integers and independent of the domain's units.

    Attributes:
        depth: Number of splits along each axis.
        position: Index of the cell among the ``2**depth`` cells of its size, along each axis.
    """

    depth: Int[np.ndarray, "cells dim"]
    position: Int[np.ndarray, "cells dim"]

    @staticmethod
    def root(dim: int) -> "Cells":
        """The one cell that covers the whole domain."""
        return Cells(np.zeros((1, dim), np.int64), np.zeros((1, dim), np.int64))

    def __len__(self) -> int:
        return len(self.depth)

    @property
    def dim(self) -> int:
        """Number of axes."""
        return self.depth.shape[1]

    def boxes(self, domain: Box) -> tuple[Float[np.ndarray, "cells dim"], Float[np.ndarray, "cells dim"]]:
        """Lower and upper corners of the cells in the units of the domain."""
        size = np.ldexp(1.0, -self.depth)
        return domain.at(self.position * size), domain.at((self.position + 1) * size)

    def grown_boxes(self, domain: Box) -> tuple[Float[np.ndarray, "cells dim"], Float[np.ndarray, "cells dim"]]:
        """Corners of boxes that hold all points for which a query may ask a cell, which places points in 32 bits."""
        lo, hi = self.boxes(domain)
        return lo - PLACING * domain.width, hi + PLACING * domain.width

    def longest_axis(self, domain: Box) -> Int[np.ndarray, "cells"]:
        """The axis along which each cell is widest, the first of equals, in the units of the domain."""
        return (domain.width * np.ldexp(1.0, -self.depth)).argmax(axis=1)

    def points(self, u: Float[np.ndarray, "k dim"], domain: Box) -> Float[np.ndarray, "cells k dim"]:
        """Points of the domain at the local coordinates ``u`` (``[-1, 1]`` spans a cell) of every cell."""
        x = np.empty((len(self), *u.shape))
        for axis in range(self.dim):  # NumPy is slow where the last axis is short
            fraction = (self.position[:, axis, None] + 0.5) + 0.5 * u[:, axis]
            fraction *= np.ldexp(1.0, -self.depth[:, axis])[:, None]
            x[:, :, axis] = domain.lo[axis] + domain.width[axis] * fraction
        return x

    def hashes(self) -> UInt64[np.ndarray, "cells"]:
        """A hash of each cell."""
        numbers = (np.int64(1) << self.depth) + self.position  # 1 for the whole, 2 and 3 for halves, and so on
        total = np.zeros(len(self), np.uint64)
        for along in numbers.T:
            total = hash64(total + along.astype(np.uint64))
        return total

    def split(self, axis: Int[np.ndarray, "cells"]) -> "Cells":
        """Halve each cell along its axis: ``2 * cells`` children, a cell's two side by side, lower first."""
        halved = np.eye(self.dim, dtype=np.int64)[axis]
        depth = np.repeat(self.depth + halved, 2, axis=0)
        position = np.repeat(self.position << halved, 2, axis=0)
        position[1::2] += halved
        return Cells(depth, position)

    def halves(self, axis: Int[np.ndarray, "cells"], is_upper: Bool[np.ndarray, "cells"]) -> "Cells":
        """The lower or the upper half of each cell along its axis."""
        halved = np.eye(self.dim, dtype=np.int64)[axis]
        return Cells(self.depth + halved, (self.position << halved) + halved * is_upper[:, None])


def grown_domain(domain: Box) -> Box:
    """The box that holds all points for which a query may ask a domain."""
    lo, hi = Cells.root(domain.dim).grown_boxes(domain)
    return Box(lo[0], hi[0])


# The tree over a partition's leaves.


MAX_DEPTH = 60  # a leaf's path, one bit a split, fits a 64-bit integer


@dataclass(frozen=True, eq=False)
class Tree:
    """The nodes of a tree, level by level from the root, left to right in each level.

    Attributes:
        cells: Cells of the nodes.
        axis: The axis along which each node is split, 0 for a leaf.
        child: The lower child of each node, which the upper one follows; -1 for a leaf.
        node_of_leaf: Nodes that are leaves, in the order of the tree's traversal.
        splits: Nodes that are split, for each level.
        order: For each leaf in this order, its index among the cells that the tree was made for.
    """

    cells: Cells
    axis: Int[np.ndarray, "nodes"]
    child: Int[np.ndarray, "nodes"]
    node_of_leaf: Int[np.ndarray, "leaves"]
    splits: list[Int[np.ndarray, "_"]]
    order: Int[np.ndarray, "leaves"]

    @cached_property
    def leaves(self) -> Cells:
        """Cells of the leaves, in the order of the tree's traversal."""
        return self.cells[self.node_of_leaf]

    @cached_property
    def leaf_of_node(self) -> Int[np.ndarray, "nodes"]:
        """Which leaf a node is, in the order of the tree's traversal; -1 if none."""
        leaf = np.full(len(self.child), -1)
        leaf[self.node_of_leaf] = np.arange(len(self.node_of_leaf))
        return leaf

    def halves(self, nodes: Int[np.ndarray, "splits"]) -> Int[np.ndarray, "halves"]:
        """Both halves of some nodes that are split, side by side."""
        return (self.child[nodes][:, None] + np.arange(2)).ravel()


def tree_of(cells: Cells) -> Tree:
    """The tree whose leaves are the given cells, in any order.

    A node's cell can be halved along every axis along which all its leaves are narrower than itself; where there
    are several, any gives a tree of the same leaves, and the first is taken.
    """
    node = np.zeros(len(cells), np.int64)
    active = np.arange(len(cells))
    node_depth = np.zeros((1, cells.dim), np.int64)
    axes = []
    while len(active):
        narrower = np.full(node_depth.shape, np.iinfo(np.int64).max)
        for each_axis in range(cells.dim):  # NumPy is fast here for single indices alone
            below = cells.depth[active, each_axis] - node_depth[node[active], each_axis]
            np.minimum.at(narrower[:, each_axis], node[active], below)
        inner = np.any(narrower, axis=1)
        axis = np.argmax(narrower > 0, axis=1)
        axes.append(np.where(inner, axis, -1))
        active = active[inner[node[active]]]
        split = axis[node[active]]
        below = cells.depth[active, split] - node_depth[node[active], split] - 1
        upper = (cells.position[active, split] >> below) & 1
        node[active] = 2 * (np.cumsum(inner) - 1)[node[active]] + upper
        node_depth = np.repeat(node_depth[inner] + np.eye(cells.dim, dtype=np.int64)[axis[inner]], 2, axis=0)
    tree = tree_of_axes(axes, cells.dim)
    # A node's place in its level, and the level, which is how often the cell was halved, name a leaf.
    first = np.cumsum([0, *(len(axis) for axis in axes)])
    index = np.empty(len(tree.child), np.int64)
    index[first[cells.depth.sum(axis=1)] + node] = np.arange(len(cells))
    return replace(tree, order=index[tree.node_of_leaf])


def tree_of_axes(axes: list[Int[np.ndarray, "_"]], dim: int) -> Tree:
    """The tree whose nodes are split along given axes, level by level; -1 for a leaf."""
    num_nodes = sum(map(len, axes))
    child, path = np.full(num_nodes, -1), np.zeros(num_nodes, np.int64)
    nodes, parts, splits, first = Cells.root(dim), [], [], 0
    for depth, axis in enumerate(axes):
        inner = np.flatnonzero(axis >= 0)
        split = first + inner
        first += len(axis)
        child[split] = first + 2 * np.arange(len(split))
        path[child[split]] = path[split]
        path[child[split] + 1] = path[split] | (1 << (MAX_DEPTH - depth))
        parts.append(nodes)
        splits.append(split)
        nodes = nodes[inner].split(axis[inner])
    leaves = np.flatnonzero(child < 0)
    node_of_leaf = leaves[np.argsort(path[leaves])]
    axis = np.maximum(np.concatenate(axes), 0)
    return Tree(parts[0].append(*parts[1:]), axis, child, node_of_leaf, splits, np.arange(len(leaves)))


def corner_bits(dim: int) -> Int[np.ndarray, "corners dim"]:
    """Corners of a cell in the order used everywhere: 0 for the lower, 1 for the upper end along each axis."""
    return np.array(list(product((0, 1), repeat=dim)))
