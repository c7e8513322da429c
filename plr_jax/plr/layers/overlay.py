"""Two partitions of one domain laid over each other."""

import numpy as np
from jaxtyping import Int

from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.partition.tree import Tree


def leaves_that_meet(one: Tree, other: Tree) -> tuple[Int[np.ndarray, "pairs"], Int[np.ndarray, "pairs"], Cells]:
    """All pairs of a leaf of one partition and a leaf of the other that have inner points in common, and those cells.

    Leaves are numbered in the order of the trees' traversals.
    """
    a = b = np.zeros(1, np.int64)
    parts: list[tuple[np.ndarray, np.ndarray]] = []
    while len(a):
        is_inner = one.child[a] >= 0
        done = ~is_inner & (other.child[b] < 0)
        parts.append((a[done], b[done]))
        # Of a pair of nodes the one whose cell is the larger is halved, or that which is no leaf.
        by_size = one.cells.depth[a].sum(axis=1) <= other.cells.depth[b].sum(axis=1)
        halves_one = is_inner & (by_size | (other.child[b] < 0))
        halves_other = ~halves_one & ~done
        a, b = (
            np.concatenate([_children(one, a[halves_one]), np.repeat(a[halves_other], 2)]),
            np.concatenate([np.repeat(b[halves_one], 2), _children(other, b[halves_other])]),
        )
        meets = _meet(one.cells[a], other.cells[b])
        a, b = a[meets], b[meets]
    a, b = (np.concatenate(nodes) for nodes in zip(*parts, strict=True))
    first, second = one.cells[a], other.cells[b]
    is_deeper = first.depth >= second.depth
    common = Cells(
        np.where(is_deeper, first.depth, second.depth), np.where(is_deeper, first.position, second.position)
    )
    return one.leaf_of_node[a], other.leaf_of_node[b], common


def _children(tree: Tree, node: Int[np.ndarray, "n"]) -> Int[np.ndarray, "children"]:
    return (tree.child[node][:, None] + np.arange(2)).ravel()


def _meet(one: Cells, other: Cells) -> np.ndarray:
    """Whether cells have inner points in common: along every axis one holds the other."""
    below = one.depth - other.depth
    return (one.position >> np.maximum(below, 0) == other.position >> np.maximum(-below, 0)).all(axis=1)
