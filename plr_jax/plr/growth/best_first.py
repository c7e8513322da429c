"""Algorithm 1 of the paper, in rounds, for models whose leaves are fitted one by one; and its rules.

The leaf of the largest priority is split first, as with a priority queue, but no leaf waits for its turn: each
round splits all leaves that are sure enough to be split, and the splits beyond the budget are taken back at the
end. The result is the tree that splitting one leaf at a time gives, whatever the size of a round. A budget of bytes
is spent on the best tree among prefixes of the splits, and on the bits that its numbers are worth.
"""

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Float, Int

from plr_jax.plr.growth.limits import Limits, Nodes, check_memory, grow, split_order
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.sampling.cell_fit import CellFit, Sampler, normal_matrices, solve_planes

# SHOULDSPLIT and SPLIT, the two strategies of Algorithm 1.
#
# A ``should_split`` rule gives every cell a priority: the leaf of the largest priority is split next, and never
# one of priority 0 or below. A ``split`` rule gives the axis along which a cell would be halved.


ShouldSplitRule: TypeAlias = Callable[[CellFit], Float[np.ndarray, "cells"]]
SplitRule: TypeAlias = Callable[[CellFit], Int[np.ndarray, "cells"]]

# The longest side of a cell is at most 2**3 times its shortest (in fractions of the domain): enough for thin walls,
# and it stops a cell that mostly lies in an obstacle from being halved along the wall for ever.
MAX_ASPECT_BITS = 3


def largest_error(fit: CellFit) -> Float[np.ndarray, "cells"]:
    """Largest (weighted) error ``abs(L - V)`` over a cell's samples: best-first refinement.

    Args:
        fit: Some cells, their samples and planes.

    Returns:
        A priority for each cell, in units of distance; 0, so never to be split, where no sample is reachable.
    """
    return np.max(fit.weight * np.abs(fit.residual), axis=1)


def center_error(fit: CellFit) -> Float[np.ndarray, "cells"]:
    """(Weighted) error at the cell's center, the rule of Section III-B of the paper.

    A cell whose center cannot be reached is judged by its largest sample error, so that an obstacle in the middle
    does not hide a bad fit around it.

    Args:
        fit: Some cells, their samples and planes.

    Returns:
        A priority for each cell, in units of distance; 0, so never to be split, where no sample is reachable.
    """
    at_center = fit.weight[:, 0] * np.abs(fit.residual[:, 0])
    return np.where(fit.reachable[:, 0], at_center, largest_error(fit))


def maximum_depth(fit: CellFit) -> Float[np.ndarray, "cells"]:
    """Split every cell that has a reachable sample, breadth first, until the limits: the paper's simplest rule.

    Args:
        fit: Some cells, their samples and planes.

    Returns:
        A priority for each cell: ``inf``, or 0 where no sample is reachable.
    """
    return np.where(np.isfinite(fit.center), np.inf, 0.0)


def best_axis(fit: CellFit) -> Int[np.ndarray, "cells"]:
    """The axis whose two halves, fitted apart, leave the smallest sum of squared errors over the samples.

    Args:
        fit: Some cells, their samples and planes.

    Returns:
        An axis for each cell, of those along which its halves are at most 8 times narrower than along another.
    """
    return best_open_axis(fit, _sum_of_squares_after_split(fit))


def best_open_axis(fit: CellFit, cost: Float[np.ndarray, "cells dim"]) -> Int[np.ndarray, "cells"]:
    """The axis of the least cost, of those along which a cell may be halved without getting too narrow."""
    depth = fit.cells.depth
    closed = depth - depth.min(axis=1, keepdims=True) >= MAX_ASPECT_BITS
    closed |= depth >= fit.max_axis_depth
    return np.argmin(np.where(closed, np.inf, cost), axis=1)


def cyclic_axis(fit: CellFit) -> Int[np.ndarray, "cells"]:
    """The axes in turn, as in Section III-B of the paper: axis ``n`` is followed by ``(n + 1) mod dim``.

    Args:
        fit: Some cells, their samples and planes.

    Returns:
        An axis for each cell, one for all cells of one depth.
    """
    return fit.cells.depth.sum(axis=1) % fit.cells.dim


def _sum_of_squares_after_split(fit: CellFit) -> Float[np.ndarray, "cells dim"]:
    """Sum of squared errors of a cell's samples if its halves along each axis were fitted apart.

    A least-squares problem over the residuals of the cell's own plane, which lies in the span of both halves. What
    the planes of the halves explain of the residuals' sum of squares is taken from it.
    """
    residual, masked = fit.residual, fit.masked
    weight = fit.weight[masked] * fit.pattern.weight
    total = np.square(residual) @ fit.pattern.weight
    total[masked] = (weight * np.square(residual[masked])).sum(axis=1)
    squares = np.empty(fit.half.shape)
    for axis, basis in enumerate(fit.pattern.halves_bases):
        squares[:, axis] = total - np.square(residual @ basis).sum(axis=1)
        if len(masked):
            explained = np.zeros(len(masked))  # by planes in both halves
            for design in np.split(fit.pattern.halves[axis], 2, axis=1):
                projection = (weight * residual[masked]) @ design
                explained += (projection * solve_planes(normal_matrices(design, weight), projection)).sum(axis=1)
            squares[masked, axis] = total[masked] - explained
    return squares


_BYTES_SLACK = 1.15  # leaves grown beyond the budget, so that fewer bits for more leaves is a choice
_ROUNDING_SHARE = 0.2  # of the error of the fit, that of rounding when bytes do not matter much
_SAMPLES_AT_ONCE = 2**20
_LAST_SHARE = 32  # of the splits so far, as many as this fraction are made in one last round

FitNodes = Callable[[Cells, Float[np.ndarray, "cells"]], Nodes]
"""COMPUTECOEFFICIENTS for a round's cells, none of which may be split before a split of the given key."""


@dataclass(frozen=True)
class Encoding:
    """How a model whose leaves are fitted one by one stores them, with a choice of how many bits.

    Attributes:
        choices: Bits that construction chooses from.
        size: Bytes of the file of these leaves, in so many bits.
        rounding_error: Root mean square, over the cells, of what rounding to so many bits changes.
    """

    choices: Sequence[int]
    size: Callable[[Nodes, Int[np.ndarray, "leaves"], int], int]
    rounding_error: Callable[[Nodes, Int[np.ndarray, "leaves"], int], float]


def fit_sampled(sampler: Sampler, nodes_of: Callable[[CellFit, Float[np.ndarray, "cells"]], Nodes]) -> FitNodes:
    """How a round's cells are fitted from samples of each, those of which too little was seen from more of them."""
    at_once = max(1, _SAMPLES_AT_ONCE // len(sampler.pattern))

    def fit_nodes(cells: Cells, bound: Float[np.ndarray, "cells"]) -> Nodes:
        parts = [slice(start, start + at_once) for start in range(0, len(cells), at_once)]
        first, *others = (fit_part(cells[part], bound[part]) for part in parts)
        return first.append(*others)

    def fit_part(cells: Cells, bound: Float[np.ndarray, "cells"]) -> Nodes:
        fit = sampler(cells)
        few = fit.is_hardly_seen
        if not few.any():
            return nodes_of(fit, bound)
        order = np.concatenate([np.flatnonzero(~few), np.flatnonzero(few)])
        fits = (fit[~few], bound[~few]), (sampler.densely(cells[few]), bound[few])
        first, *others = (nodes_of(*each) for each in fits if len(each[1]))
        return first.append(*others)[np.argsort(order)]

    return fit_nodes


def grow_best_first(
    root: Nodes, fit_nodes: FitNodes, limits: Limits, encoding: Encoding
) -> tuple[Nodes, Int[np.ndarray, "leaves"], int]:
    """Split until every node that belongs to the final tree has been split.

    Returns all nodes, which of them are the leaves of the tree, and the bits to store them with.
    """

    def split_some(nodes: Nodes) -> Nodes | None:
        """The nodes after a round; None if no leaf is to be split."""
        # The better half of those that would be split if no better ones came up; of the last few all, as a round of a
        # few takes as long as one of many.
        order = split_order(nodes)
        allowed = limits.max_leaves - 1
        if np.isfinite(limits.max_bytes):  # then at most about as many as the bytes a leaf takes so far allow
            leaf = nodes.leaves_after(order[nodes.child[order] >= 0][:allowed])
            enough = _ROUNDING_SHARE * _fit_error(nodes, leaf)
            bits = min(encoding.choices, key=lambda bits: abs(encoding.rounding_error(nodes, leaf, bits) - enough))
            a_leaf = encoding.size(nodes, leaf, bits) / len(leaf)
            allowed = min(allowed, int(_BYTES_SLACK * limits.max_bytes / a_leaf) + 1)
        wanted = order[:allowed]
        wanted = wanted[nodes.child[wanted] < 0]
        batch = wanted[: max((len(wanted) + 1) // 2, len(order) // _LAST_SHARE)]
        if len(batch) == 0:
            return None
        children = fit_nodes(nodes.cells[batch].split(nodes.axis[batch]), np.repeat(nodes.key[batch], 2))
        grown = nodes.append(children)
        grown.child[batch] = len(nodes.key) + 2 * np.arange(len(batch))
        check_memory(float(len(grown.key)))
        return grown

    nodes = grow(root, split_some, limits)
    return nodes, *_choose_leaves(nodes, limits, encoding)


def _choose_leaves(nodes: Nodes, limits: Limits, encoding: Encoding) -> tuple[Int[np.ndarray, "leaves"], int]:
    """Leaves of the best tree within the limits, and the bits to store them with.

    Raises:
        BudgetTooSmall: If the budget of bytes is too small for one leaf.
    """
    limits.require_room(encoding.size(nodes, np.zeros(1, np.int64), min(encoding.choices)))
    order = split_order(nodes)
    order = order[nodes.child[order] >= 0][: limits.max_leaves - 1]

    def most_leaves(bits: int) -> Int[np.ndarray, "leaves"]:
        """Those of the largest tree of that order that fits into the bytes; none if not even the root does."""
        if np.isinf(limits.max_bytes):
            return nodes.leaves_after(order)
        enough = bisect_right(
            range(len(order) + 1),
            limits.max_bytes,
            key=lambda number: encoding.size(nodes, nodes.leaves_after(order[:number]), bits),
        )
        return nodes.leaves_after(order[: enough - 1]) if enough else np.empty(0, np.int64)

    def expected_error(leaf: Int[np.ndarray, "leaves"], bits: int) -> float:
        """Mean error over reachable points: of the fit and of the rounding, which are independent."""
        return np.hypot(_fit_error(nodes, leaf), encoding.rounding_error(nodes, leaf, bits)) if len(leaf) else np.inf

    within = [(most_leaves(bits), bits) for bits in encoding.choices]
    return min(within, key=lambda choice: (expected_error(*choice), -choice[1]))


def _fit_error(nodes: Nodes, leaf: Int[np.ndarray, "leaves"]) -> float:
    share = nodes.share[leaf]
    return float(np.sum(share * nodes.error[leaf]) / np.sum(share)) if share.any() else 0.0
