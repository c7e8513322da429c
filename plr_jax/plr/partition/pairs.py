"""Pairs of leaves that have something in common, found down two trees of one domain at once."""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Int

from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.partition.tree import Tree

Pairs: TypeAlias = Int[np.ndarray, "rows pairs"]


Keep: TypeAlias = Callable[[Pairs, int, int, Int[np.ndarray, "pairs"]], Bool[np.ndarray, "pairs"]]
"""Which pairs stay, once the node of a side gave way to its lower (0) or upper (1) half, split by an axis each."""


def leaf_pairs(a: Tree, b: Tree, pairs: Pairs, keep: Keep) -> Int[np.ndarray, "rows leaf_pairs"]:
    """Pairs of leaves below pairs of nodes: the larger node gives way to its children, until both are leaves.

    Args:
        a: The tree of the first nodes.
        b: That of the second ones.
        pairs: Nodes of ``a``, of ``b``, and what else there is to tell of a pair, which its children inherit.
        keep: Which of the children's pairs have in common what is looked for.

    Returns:
        Numbers of leaves in the order of their tree's traversal, and what else there is to tell.
    """
    trees, found = (a, b), []
    depths = [tree.cells.depth.sum(axis=1) for tree in trees]
    while pairs.shape[1]:
        inner = np.stack([tree.child[nodes] >= 0 for tree, nodes in zip(trees, pairs, strict=False)])
        found.append(pairs[:, ~inner.any(axis=0)])
        first = inner[0] & (~inner[1] | (depths[0][pairs[0]] <= depths[1][pairs[1]]))
        children = []
        for side, which in enumerate((first, inner.any(axis=0) & ~first)):
            parents = pairs[:, which]
            axis = trees[side].axis[parents[side]]
            for half in range(2):
                child = parents.copy()
                child[side] = trees[side].child[parents[side]] + half
                children.append(child[:, keep(child, side, half, axis)])
        pairs = np.concatenate(children, axis=1)
    leaves = np.concatenate(found, axis=1) if found else pairs.copy()
    for side, tree in enumerate(trees):
        leaves[side] = tree.leaf_of_node[leaves[side]]
    return leaves


def overlap(
    a: Cells, i: Int[np.ndarray, "n"], b: Cells, j: Int[np.ndarray, "n"], axis: Int[np.ndarray, "n"]
) -> Bool[np.ndarray, "n"]:
    """Whether cells overlap along an axis: of dyadic intervals one then contains the other."""
    common = np.minimum(a.depth[i, axis], b.depth[j, axis])
    return a.position[i, axis] >> (a.depth[i, axis] - common) == b.position[j, axis] >> (b.depth[j, axis] - common)


def overlapping_leaves(a: Tree, b: Tree) -> Int[np.ndarray, "2 pairs"]:
    """All pairs of leaves of two trees of one domain whose interiors meet."""

    def keep(pairs: Pairs, side: int, half: int, axis: Int[np.ndarray, "pairs"]) -> Bool[np.ndarray, "pairs"]:
        return overlap(a.cells, pairs[0], b.cells, pairs[1], axis)

    return leaf_pairs(a, b, np.zeros((2, 1), np.int64), keep)
