"""Algorithm 1 of the paper, in rounds, for models whose leaves are fitted one by one.

The leaf of the largest priority is split first, as with a priority queue, but no leaf waits for its turn: each
round splits all leaves that are sure enough to be split, and the splits beyond the budget are taken back at the
end. The result is the tree that splitting one leaf at a time gives, whatever the size of a round.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

from plr_jax.plr.growth.budget import Encoding, choose_leaves, splits_allowed
from plr_jax.plr.growth.limits import Limits, check_memory
from plr_jax.plr.growth.nodes import Nodes, split_order
from plr_jax.plr.growth.rounds import grow
from plr_jax.plr.partition.cells import Cells

_LAST_SHARE = 32  # of the splits so far, as many as this fraction are made in one last round

FitNodes = Callable[[Cells, Float[np.ndarray, "cells"]], Nodes]
"""COMPUTECOEFFICIENTS for a round's cells, none of which may be split before a split of the given key."""


def grow_best_first(
    root: Nodes, fit_nodes: FitNodes, limits: Limits, encoding: Encoding
) -> tuple[Nodes, Int[np.ndarray, "leaves"], int]:
    """Split until every node that belongs to the final tree has been split.

    Returns all nodes, which of them are the leaves of the tree, and the bits to store them with.
    """

    def split_some(nodes: Nodes) -> Nodes | None:
        batch = _next_batch(nodes, limits, encoding)
        if len(batch) == 0:
            return None
        children = fit_nodes(nodes.cells[batch].split(nodes.axis[batch]), np.repeat(nodes.key[batch], 2))
        grown = Nodes.concatenate([nodes, children])
        grown.child[batch] = len(nodes.key) + 2 * np.arange(len(batch))
        check_memory(float(len(grown.key)))
        return grown

    nodes = grow(root, split_some, limits)
    return nodes, *choose_leaves(nodes, limits, encoding)


def _next_batch(nodes: Nodes, limits: Limits, encoding: Encoding) -> Int[np.ndarray, "batch"]:
    """Leaves to split next: the better half of those that would be split if no better ones came up.

    Of the last few all: some are sampled in vain, but a round of a few takes as long as one of many.
    """
    order = split_order(nodes)
    wanted = order[: splits_allowed(nodes, order, limits, encoding)]
    wanted = wanted[nodes.child[wanted] < 0]
    return wanted[: max((len(wanted) + 1) // 2, len(order) // _LAST_SHARE)]
