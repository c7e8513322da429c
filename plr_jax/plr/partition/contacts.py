"""Which leaf touches another the most: where a function continues that a leaf has none of its own of."""

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.partition.pairs import Pairs, leaf_pairs
from plr_jax.plr.partition.tree import Tree, tree_of

_TOUCH = 2.0**-20  # what touching in a point along an axis counts, in finest slots


def neighbor_of_largest_contact(
    cells: Cells,
    unreachable: Int[np.ndarray, "unreachable"],
    reachable: Int[np.ndarray, "reachable"],
    periodic: tuple[bool, ...] = (),
) -> Int[np.ndarray, "unreachable"]:
    """For each unreachable leaf the reachable one that shares the largest face, edge or corner, the first of several.

    -1 where it touches none, across the seams of ``periodic`` axes neither.
    """
    tree, is_periodic = tree_of(cells), np.isin(np.arange(cells.dim), np.flatnonzero(periodic))
    mine, others = _touching(tree, unreachable, reachable, is_periodic)
    contact = _contacts(cells, mine, others, is_periodic)
    order = np.lexsort((others, -contact, mine))
    mine, others = mine[order], others[order]
    first = np.append(True, mine[1:] != mine[:-1])[: len(mine)]
    donor = np.full(len(cells), -1)
    donor[mine[first]] = others[first]
    return donor[unreachable]


def _touching(
    tree: Tree,
    unreachable: Int[np.ndarray, "unreachable"],
    reachable: Int[np.ndarray, "reachable"],
    is_periodic: Bool[np.ndarray, "dim"],
) -> tuple[Int[np.ndarray, "pairs"], Int[np.ndarray, "pairs"]]:
    """Pairs of an unreachable and a reachable leaf that touch."""
    holds = _holding(tree, unreachable), _holding(tree, reachable)

    def keep(pairs: Pairs, side: int, half: int, axis: Int[np.ndarray, "pairs"]) -> Bool[np.ndarray, "pairs"]:
        stays = holds[0][pairs[0]] & holds[1][pairs[1]]
        stays[stays] = _contacts(tree.cells, pairs[0, stays], pairs[1, stays], is_periodic) > 0
        return stays

    roots = np.zeros((2, int(holds[0][0] & holds[1][0])), np.int64)
    mine, others = tree.order[leaf_pairs(tree, tree, roots, keep)]
    return mine, others


def _holding(tree: Tree, leaves: Int[np.ndarray, "some"]) -> Bool[np.ndarray, "nodes"]:
    """Which nodes hold one of some leaves."""
    holds = np.zeros(len(tree.child), bool)
    holds[tree.node_of_leaf] = np.isin(tree.order, leaves)
    for splits in reversed(tree.splits):
        holds[splits] = holds[tree.child[splits]] | holds[tree.child[splits] + 1]
    return holds


def _contacts(
    cells: Cells, a: Int[np.ndarray, "n"], b: Int[np.ndarray, "n"], is_periodic: Bool[np.ndarray, "dim"]
) -> Float[np.ndarray, "n"]:
    """What pairs of cells share, as a share of the domain; 0 where they do not touch."""
    contact, finest = np.ones(len(a)), cells.depth.max(axis=0)
    for axis in range(cells.dim):
        up_a, up_b = finest[axis] - cells.depth[a, axis], finest[axis] - cells.depth[b, axis]
        lo_a, lo_b = cells.position[a, axis] << up_a, cells.position[b, axis] << up_b
        hi_a, hi_b = (cells.position[a, axis] + 1) << up_a, (cells.position[b, axis] + 1) << up_b
        low, high = np.maximum(lo_a, lo_b), np.minimum(hi_a, hi_b)
        touch = high == low
        if is_periodic[axis]:
            first, last = np.minimum(lo_a, lo_b), np.maximum(hi_a, hi_b)
            touch |= (high < low) & (first == 0) & (last == 1 << finest[axis])
        contact *= np.where(touch, _TOUCH, np.maximum(high - low, 0)) / 2.0 ** finest[axis]
    return contact
