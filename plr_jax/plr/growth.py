"""Growing a partition best-first (Algorithm 1 of the paper), its rules, its limits, and a way to stop early.

The leaf of the largest priority is split first, as with a priority queue, but no leaf waits for its turn: each
round splits all leaves that are sure enough to be split, and the splits beyond the budget are taken back at the
end. The result is the tree that splitting one leaf at a time gives, whatever the size of a round. A budget of bytes
is spent on the best tree among prefixes of the splits, and on the bits that its numbers are worth.
"""

import os
import warnings
from bisect import bisect_right
from collections.abc import Callable, Sequence, Sized
from dataclasses import dataclass
from typing import TypeAlias, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int
from tqdm import tqdm

from plr_jax._arrays import row_products
from plr_jax.plr.certificate import Proof
from plr_jax.plr.coding import body_size
from plr_jax.plr.sampling import CellFit, Sampler, normal_matrices, solve_planes
from plr_jax.plr.tree import Cells, Rows

DEFAULT_MAX_LEAVES = 512
_BYTES_A_NODE = 200

GrowingTree = TypeVar("GrowingTree", bound=Sized)
"""A partition under construction; its length is its number of leaves."""


class BudgetTooSmall(ValueError):
    """A budget of bytes is too small even for one leaf.

    Attributes:
        num_bytes: How many bytes are enough.
    """

    def __init__(self, max_bytes: float, num_bytes: int, what: str = "one leaf"):
        super().__init__(max_bytes, num_bytes, what)  # all of them, so that it can be pickled
        self.num_bytes = num_bytes

    def __str__(self) -> str:
        max_bytes, num_bytes, what = self.args
        return f"max_bytes={max_bytes:g} is too small: {what} takes {num_bytes} bytes; allow at least that."


class ConstructionInterrupted(UserWarning):
    """Ctrl-C ended a construction early; what it returns is the PLR built so far."""


@dataclass(frozen=True, eq=False)
class Limits:
    """When to stop: see :func:`construct`.

    No cell is halved more than ``max_axis_depth`` times along one axis, which bounds a query's tables. Files have
    room for the ``proof``, with which errors are those that are proven, and take ``frame_bytes`` besides bits.
    """

    max_depth: int
    max_axis_depth: int
    max_leaves: int
    max_bytes: float
    tolerance: float
    proof: Proof
    frame_bytes: int

    def file_size(self, dim: int, num_leaves: int, num_bits: int) -> int:
        """Bytes of a file of so many leaves, of which the model keeps so many bits."""
        of_proof = self.proof.num_bits(num_leaves, body_size(dim, num_leaves, num_bits))
        return self.frame_bytes + body_size(dim, num_leaves, num_bits + of_proof)

    def require_room(self, num_bytes: int) -> None:
        """Raise ``BudgetTooSmall`` if a file of one leaf, of so many bytes, is larger than ``max_bytes``."""
        if num_bytes > self.max_bytes:
            raise BudgetTooSmall(self.max_bytes, num_bytes)


def check_memory(num_nodes: float, bytes_a_node: float = _BYTES_A_NODE) -> None:
    """Raise ``ValueError`` if a tree of so many nodes does not fit into this machine's memory."""
    needed = num_nodes * bytes_a_node
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else np.inf
    if needed > memory:
        raise ValueError(
            f"The limits allow {num_nodes / 2:.3g} leaves or more, which would need about {needed / 2**30:.3g} GiB; "
            f"this machine has {memory / 2**30:.3g}. Give a smaller max_depth, max_leaves, max_bytes or a tolerance."
        )


def grow(tree: GrowingTree, split_some: Callable[[GrowingTree], GrowingTree | None], limits: Limits) -> GrowingTree:
    """Split in rounds, from the root alone, until ``split_some`` gives None instead of a larger tree.

    Returns the last tree. An interrupt (Ctrl-C) loses the round, never the tree so far, which then comes with a
    ``ConstructionInterrupted`` warning.
    """
    total = limits.max_leaves if limits.max_leaves < 1e9 else None
    with tqdm(desc="construct", unit=" leaves", total=total, delay=2, leave=False, disable=None) as progress:
        try:
            while (larger := split_some(tree)) is not None:
                progress.update(len(larger) - len(tree))
                tree = larger
        except KeyboardInterrupt:
            message = f"Interrupted at {len(tree)} leaves: the PLR is the one built so far."
            warnings.warn(message, ConstructionInterrupted, stacklevel=4)
    return tree


# The nodes of a growing tree, and the order in which a priority queue would split them.


NEVER = -np.inf


@dataclass(frozen=True, eq=False)
class Nodes(Rows):
    """All nodes of the growing tree, parents before children; as long as it has leaves.

    Attributes:
        error: Mean error over the reachable samples.
        share: Share of the domain's volume that a node's reachable samples stand for.
        key: Rank of the node's split: its priority, but never above its parent's; ``-inf`` if it may not be split.
        child: Index of the lower child, the upper one following it; -1 for a leaf.
    """

    cells: Cells
    coefficients: Float[np.ndarray, "nodes terms"]
    error: Float[np.ndarray, "nodes"]
    share: Float[np.ndarray, "nodes"]
    axis: Int[np.ndarray, "nodes"]
    key: Float[np.ndarray, "nodes"]
    child: Int[np.ndarray, "nodes"]

    def __len__(self) -> int:
        return (len(self.key) + 1) // 2

    def leaves_after(self, splits: Int[np.ndarray, "splits"]) -> Int[np.ndarray, "leaves"]:
        """Leaves of the tree whose inner nodes are the given ones."""
        is_leaf = np.zeros(len(self.key), bool)
        is_leaf[0] = True
        is_leaf[self.child[splits]] = is_leaf[self.child[splits] + 1] = True
        is_leaf[splits] = False
        return np.flatnonzero(is_leaf)


def split_order(nodes: Nodes) -> Int[np.ndarray, "splits"]:
    """Nodes that are or may be split, in the order in which a priority queue would split them.

    A child's key is at most its parent's, so every prefix of this order is a tree.
    """
    candidates = np.flatnonzero(nodes.key > NEVER)
    return candidates[np.argsort(-nodes.key[candidates], kind="stable")]


def nodes_of_fit(
    fit: CellFit,
    coefficients: Float[np.ndarray, "cells terms"],
    bound: Float[np.ndarray, "cells"],
    priority: Float[np.ndarray, "..."],
    axis: Int[np.ndarray, "..."],
    limits: Limits,
) -> Nodes:
    """Leaves of a round: their fits, and whether and when each may be split.

    The key of a cell's parent is the ``bound`` above which its own may not rise; ``priority`` and ``axis`` are what
    the rules say.
    """
    check_rules(fit, priority, axis)
    volume = fit.reachable.astype(np.float64) @ fit.pattern.weight
    error = np.abs(fit.residual) @ fit.pattern.weight / np.where(volume > 0, volume, 1)
    may_split = (priority > least_priority(fit, limits)) & is_open(fit.cells, axis, limits)
    return Nodes(
        cells=fit.cells,
        coefficients=coefficients,
        error=error,
        share=volume / fit.pattern.weight.sum() * np.ldexp(1.0, -fit.cells.depth.sum(axis=1)),
        axis=axis,
        key=np.where(may_split, np.minimum(priority, bound), NEVER),
        child=np.full(len(fit), -1),
    )


def least_priority(fit: CellFit, limits: Limits) -> Float[np.ndarray, "cells"]:
    """Priority that a cell must exceed to be split: the tolerance, and what a split can mend."""
    return np.maximum(limits.tolerance, fit.noise)


def is_open(cells: Cells, axis: Int[np.ndarray, "cells"], limits: Limits) -> Bool[np.ndarray, "cells"]:
    """Which cells the limits on depth allow to be halved along the given axes."""
    along = cells.depth[np.arange(len(cells)), axis]
    return (cells.depth.sum(axis=1) < limits.max_depth) & (along < limits.max_axis_depth)


def check_rules(fit: CellFit, priority: Float[np.ndarray, "..."], axis: Int[np.ndarray, "..."]) -> None:
    """Raise ``ValueError`` if a rule of the caller's does not answer as it should."""
    cells, dim = fit.cells.depth.shape
    if priority.shape != (cells,) or np.isnan(priority).any():
        raise ValueError(
            f"should_split must return one priority a cell, shape ({cells},) and no NaN, got shape {priority.shape}."
        )
    if axis.shape != (cells,) or (axis < 0).any() or (axis >= dim).any():
        raise ValueError(
            f"split must return one axis from 0 to {dim - 1} a cell, shape ({cells},), got shape {axis.shape} with "
            f"values from {axis.min(initial=dim)} to {axis.max(initial=-1)}."
        )


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
    total = row_products(np.square(residual), fit.pattern.weight)
    total[masked] = (weight * np.square(residual[masked])).sum(axis=1)
    squares = np.empty(fit.half.shape)
    for axis, basis in enumerate(fit.pattern.halves_bases):
        squares[:, axis] = total - np.square(row_products(residual, basis)).sum(axis=1)
        if len(masked):
            explained = np.zeros(len(masked))  # by planes in both halves
            for design in np.split(fit.pattern.halves[axis], 2, axis=1):
                projection = row_products(weight * residual[masked], design)
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
