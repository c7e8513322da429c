"""The tree over a partition's leaves: level by level, as a file stores it, and as a table of nodes."""

from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Bool, Int

from plr_jax.plr.partition.cells import Cells

MAX_DEPTH = 60  # a leaf's path, one bit a split, fits a 64-bit integer


@dataclass(frozen=True, eq=False)
class Level:
    """The nodes of one depth, left to right.

    Attributes:
        inner: Which nodes are split.
        axis: The axis of each split node.
    """

    inner: Bool[np.ndarray, "nodes"]
    axis: Int[np.ndarray, "splits"]


@dataclass(frozen=True, eq=False)
class Tree:
    """The nodes of a tree, level by level from the root.

    Attributes:
        cells: Cell of each node.
        axis: Axis along which each node is split; 0 for a leaf.
        child: Lower child of each node, the upper one following it; -1 for a leaf.
        node_of_leaf: Node of each leaf, leaves in the order of the tree's traversal.
        level_start: First node of each level, and the number of nodes.
        order: Index of each leaf among the cells that the tree was made for.
    """

    cells: Cells
    axis: Int[np.ndarray, "nodes"]
    child: Int[np.ndarray, "nodes"]
    node_of_leaf: Int[np.ndarray, "leaves"]
    level_start: Int[np.ndarray, "levels_plus_one"]
    order: Int[np.ndarray, "leaves"]

    @property
    def leaves(self) -> Cells:
        """Cells of the leaves, in the order of the tree's traversal."""
        return self.cells[self.node_of_leaf]

    def splits(self) -> list[Int[np.ndarray, "splits"]]:
        """The split nodes, level by level."""
        levels = [np.arange(*ends) for ends in zip(self.level_start[:-1], self.level_start[1:], strict=True)]
        return [nodes[self.child[nodes] >= 0] for nodes in levels]


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


def cells_of(levels: list[Level], dim: int) -> Cells:
    """Leaves of a tree given by its levels, in order of its traversal."""
    nodes, path = Cells.root(dim), np.zeros(1, np.int64)
    leaves, paths = Cells.root(dim)[:0], []
    for depth, level in enumerate(levels):
        leaves = leaves.append(nodes[~level.inner])
        paths.append(path[~level.inner])
        nodes = nodes[level.inner].split(level.axis)
        path = np.repeat(path[level.inner], 2)
        path[1::2] |= 1 << (MAX_DEPTH - depth)
    return leaves[np.argsort(np.concatenate(paths), kind="stable")]


def corner_bits(dim: int) -> Int[np.ndarray, "corners dim"]:
    """Corners of a cell in the order used everywhere: 0 for the lower, 1 for the upper end along each axis."""
    return np.array(list(product((0, 1), repeat=dim)))


def tree_of(cells: Cells) -> Tree:
    """The tree whose leaves are the given cells, in any order."""
    levels, order = levels_of(cells)
    sizes = np.array([len(level.inner) for level in levels])
    level_start = np.concatenate([[0], np.cumsum(sizes)])
    nodes, parts = Cells.root(cells.dim), []
    axis, child = np.zeros(level_start[-1], np.int64), np.full(level_start[-1], -1)
    for level, start in zip(levels, level_start[:-1], strict=True):
        parts.append(nodes)
        split = start + np.flatnonzero(level.inner)
        axis[split] = level.axis
        child[split] = start + len(level.inner) + 2 * np.arange(len(split))
        nodes = nodes[level.inner].split(level.axis)
    all_cells = parts[0].append(*parts[1:])
    return Tree(all_cells, axis, child, _nodes_of(all_cells, child, cells[order]), level_start, order)


def _nodes_of(nodes: Cells, child: Int[np.ndarray, "nodes"], leaves: Cells) -> Int[np.ndarray, "leaves"]:
    """Node of each leaf: both lists sorted alike."""
    leaf_nodes = np.flatnonzero(child < 0)
    of_node = np.lexsort((*nodes.depth[leaf_nodes].T, *nodes.position[leaf_nodes].T))
    of_leaf = np.lexsort((*leaves.depth.T, *leaves.position.T))
    found = np.empty(len(leaves), np.int64)
    found[of_leaf] = leaf_nodes[of_node]
    return found
