"""The tree over a partition's leaves, level by level: what a file stores instead of the leaves' boxes."""

from dataclasses import dataclass

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
