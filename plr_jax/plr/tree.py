"""Dyadic cells: the nodes of a binary space partition that halves one axis at a time; and their tree."""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from jaxtyping import Bool, Float, Int, UInt64

from plr_jax._arrays import mixed
from plr_jax.geometry.box import Box

PLACING = 2.0**-21
"""How far beside its cell, in widths of the domain, a query may place a point, as it computes in 32 bits."""


@dataclass(frozen=True, eq=False)
class Cells:
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

    def __getitem__(self, index) -> "Cells":
        return Cells(self.depth[index], self.position[index])

    def append(self, *others: "Cells") -> "Cells":
        """These cells followed by the others."""
        parts = (self, *others)
        return Cells(
            np.concatenate([part.depth for part in parts]), np.concatenate([part.position for part in parts])
        )

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
            total = mixed(total + along.astype(np.uint64))
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


# The tree over a partition's leaves: level by level, as a file stores it, and as a table of nodes.


MAX_DEPTH = 60  # a leaf's path, one bit a split, fits a 64-bit integer


@dataclass(frozen=True, eq=False)
class Level:
    """The nodes of one depth, left to right: which are split, and the axis of each of those."""

    inner: Bool[np.ndarray, "nodes"]
    axis: Int[np.ndarray, "splits"]


@dataclass(frozen=True, eq=False)
class Tree:
    """The nodes of a tree, level by level from the root.

    A leaf's ``axis`` is 0 and its ``child`` -1; of another node ``child`` is the lower one, the upper one follows it.
    Leaves stand in the order of the tree's traversal, ``order`` is their index among the cells the tree was made for;
    ``splits`` are the split nodes of each level.
    """

    cells: Cells
    axis: Int[np.ndarray, "nodes"]
    child: Int[np.ndarray, "nodes"]
    node_of_leaf: Int[np.ndarray, "leaves"]
    splits: list[Int[np.ndarray, "_"]]
    order: Int[np.ndarray, "leaves"]

    @property
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


def levels_of(cells: Cells) -> tuple[list[Level], Int[np.ndarray, "leaves"]]:
    """Levels of a tree whose leaves are the cells, and the leaves' indices in order of its traversal.

    A node's cell can be halved along every axis along which all its leaves are narrower than itself; where there
    are several, any gives a tree of the same leaves, and the first is taken.
    """
    node = np.zeros(len(cells), np.int64)
    path = np.zeros(len(cells), np.int64)
    active = np.arange(len(cells))
    node_depth = np.zeros((1, cells.dim), np.int64)
    levels = []
    while len(active):
        narrower = np.full(node_depth.shape, np.iinfo(np.int64).max)
        for each_axis in range(cells.dim):  # NumPy is fast here for single indices alone
            below = cells.depth[active, each_axis] - node_depth[node[active], each_axis]
            np.minimum.at(narrower[:, each_axis], node[active], below)
        inner = np.any(narrower, axis=1)
        axis = np.argmax(narrower > 0, axis=1)
        levels.append(Level(inner, axis[inner]))
        active = active[inner[node[active]]]
        split = axis[node[active]]
        below = cells.depth[active, split] - node_depth[node[active], split] - 1
        upper = (cells.position[active, split] >> below) & 1
        path[active] |= upper << (MAX_DEPTH + 1 - len(levels))
        node[active] = 2 * (np.cumsum(inner) - 1)[node[active]] + upper
        node_depth = np.repeat(node_depth[inner] + np.eye(cells.dim, dtype=np.int64)[axis[inner]], 2, axis=0)
    return levels, np.argsort(path, kind="stable")


def corner_bits(dim: int) -> Int[np.ndarray, "corners dim"]:
    """Corners of a cell in the order used everywhere: 0 for the lower, 1 for the upper end along each axis."""
    return np.array(list(product((0, 1), repeat=dim)))


def tree_of(cells: Cells) -> Tree:
    """The tree whose leaves are the given cells, in any order."""
    levels, order = levels_of(cells)
    return replace(tree_of_levels(levels, cells.dim), order=order)


def tree_of_levels(levels: list[Level], dim: int) -> Tree:
    """The tree of given levels."""
    num_nodes = sum(len(level.inner) for level in levels)
    axis, child, path = np.zeros(num_nodes, np.int64), np.full(num_nodes, -1), np.zeros(num_nodes, np.int64)
    nodes, parts, splits, first = Cells.root(dim), [], [], 0
    for depth, level in enumerate(levels):
        split = first + np.flatnonzero(level.inner)
        first += len(level.inner)
        axis[split] = level.axis
        child[split] = first + 2 * np.arange(len(split))
        path[child[split]] = path[split]
        path[child[split] + 1] = path[split] | (1 << (MAX_DEPTH - depth))
        parts.append(nodes)
        splits.append(split)
        nodes = nodes[level.inner].split(level.axis)
    leaves = np.flatnonzero(child < 0)
    node_of_leaf = leaves[np.argsort(path[leaves])]
    return Tree(parts[0].append(*parts[1:]), axis, child, node_of_leaf, splits, np.arange(len(leaves)))
