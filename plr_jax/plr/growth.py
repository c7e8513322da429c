"""Grow the partition of a PLR by splitting its worst leaves (Algorithm 1 of the paper), within the user's limits.

Each round splits many leaves at once. Splits beyond the limits are undone at the end. So the tree is the same as if a
priority queue split one leaf at a time (:func:`split_order` tells why). A byte budget also determines the number of
bits of each coefficient.
"""

import os
import warnings
from bisect import bisect_right
from collections.abc import Callable, Sequence, Sized
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import row_products
from plr_jax._progress import Progress
from plr_jax.plr.certificate import Proof
from plr_jax.plr.coding import bits_of_set, body_size
from plr_jax.plr.sampling import CellFit, OfTerms, Sampler, is_closed, solve_planes
from plr_jax.plr.tree import Cells, Rows

DEFAULT_MAX_LEAVES = 512
_BYTES_A_NODE = 200  # memory of a node during construction
Priorities: TypeAlias = Float[np.ndarray, " cells"]
Axes: TypeAlias = Int[np.ndarray, " cells"]
GrowingTree = TypeVar("GrowingTree", bound=Sized)  # a partition; its length is its number of leaves


class BudgetTooSmall(ValueError):
    """An error: a byte budget is too small even for a file with a single leaf, which takes ``num_bytes``."""

    def __init__(self, max_bytes: float, num_bytes: int):
        super().__init__(max_bytes, num_bytes)  # all arguments, for pickling
        self.num_bytes = num_bytes

    def __str__(self) -> str:
        max_bytes, num_bytes = self.args
        return f"max_bytes={max_bytes:g} is too small: one leaf takes {num_bytes} bytes. Allow at least that many."


class ConstructionInterrupted(UserWarning):
    """A warning that an interrupt (Ctrl-C) ended a construction early; the result is what was built so far."""


class Limits(NamedTuple):
    """The limits of a construction, which ends at the first limit that it reaches."""

    max_depth: int
    max_axis_depth: int  # most halvings of a cell along one axis, which limit the size of lookup tables
    max_leaves: int
    max_bytes: float
    tolerance: float
    proof: Proof
    frame_bytes: int  # size of a file without its bit stream of leaves and proof

    def file_size(self, dim: int, num_leaves: int, num_bits: int, num_cut_off: int = 0) -> int:
        """Return the largest size in bytes of a file whose leaves take ``num_bits`` bits, including its proof.

        ``num_cut_off`` is the number of leaves that the file lists as cut off from the goal.
        """
        num_bits += bits_of_set(num_cut_off, num_leaves)
        of_proof = self.proof.num_bits(num_leaves, body_size(dim, num_leaves, num_bits))
        return self.frame_bytes + body_size(dim, num_leaves, num_bits + of_proof)

    def require_room(self, num_bytes: int) -> None:
        if num_bytes > self.max_bytes:
            raise BudgetTooSmall(self.max_bytes, num_bytes)


def check_memory(num_nodes: float, bytes_a_node: float = _BYTES_A_NODE) -> None:
    """Raise a ``ValueError`` if a tree of ``num_nodes`` nodes needs more memory than the machine has."""
    needed = num_nodes * bytes_a_node
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else np.inf
    if needed > memory:
        need = f"{num_nodes / 2:.3g} leaves or more, which would need about {needed / 2**30:.3g} GiB"
        advice = "Reduce max_depth, max_leaves or max_bytes, or set a tolerance"
        raise ValueError(f"The limits allow {need}; this machine has {memory / 2**30:.3g}. {advice}.")


def grow(tree: GrowingTree, split_some: Callable[[GrowingTree], GrowingTree | None], limits: Limits) -> GrowingTree:
    """Call ``split_some`` until it returns None instead of a larger tree, or until Ctrl-C; return the last tree."""
    total = limits.max_leaves if limits.max_leaves < 1e9 else None
    with Progress("construct", "leaves", total) as progress:
        try:
            while (larger := split_some(tree)) is not None:
                progress.update(len(larger) - len(tree))
                tree = larger
        except KeyboardInterrupt:
            message = f"Interrupted at {len(tree)} leaves: the PLR is the one built so far."
            warnings.warn(message, ConstructionInterrupted, stacklevel=4)
    return tree


NEVER = -np.inf
Leaves: TypeAlias = Int[np.ndarray, " leaves"]  # indices of the nodes that are leaves


@dataclass(frozen=True, eq=False)
class Nodes(Rows):
    """A table of the nodes of a growing tree, parents before children; its ``len`` is the number of leaves."""

    cells: Cells
    coefficients: Float[np.ndarray, "nodes terms"]
    # Mean absolute error over samples that reach the goal, weighted by the pattern; users' error weights do not
    # count.
    error: Float[np.ndarray, " nodes"]
    volume: Float[np.ndarray, " nodes"]  # share of the domain's volume that these samples represent
    axis: Int[np.ndarray, " nodes"]  # along which the node is or would be split
    key: Float[np.ndarray, " nodes"]  # the least priority on the path from the root; -inf if it may not be split
    child: Int[np.ndarray, " nodes"]  # the lower child, which the upper child follows; -1 for a leaf
    is_cut_off: Bool[np.ndarray, " nodes"]  # whether the cell has free points, none of which can reach the goal

    def __len__(self) -> int:
        return (len(self.key) + 1) // 2  # a binary tree of n leaves has 2 n - 1 nodes

    def leaves_of_splits(self, splits: Int[np.ndarray, " splits"]) -> Leaves:
        """Return the leaves of the tree in which only the nodes ``splits`` are split.

        ``splits`` must contain all ancestors of each of its nodes.
        """
        is_leaf = np.zeros(len(self.key), bool)
        is_leaf[0] = True
        is_leaf[self.child[splits]] = is_leaf[self.child[splits] + 1] = True
        is_leaf[splits] = False
        return np.flatnonzero(is_leaf)


def split_order(nodes: Nodes) -> Int[np.ndarray, " splits"]:
    """Return the nodes that are or may be split, in the order in which a priority queue would split them."""
    # A priority queue splits node b only after its parent a. If b is more urgent than a, it is split right after a,
    # before all nodes that had to wait for a. So the queue's order is the order of
    #   key(b) = min(priority(b), key(a)),
    # the least priority on the path from the root, largest key first. Among equal keys, nodes with smaller indices
    # come first (where a queue may have another order), so parents come before children. Thus the first n nodes of
    # this order are the n splits of a tree.
    candidates = np.flatnonzero(nodes.key > NEVER)
    return candidates[np.argsort(-nodes.key[candidates], kind="stable")]


def nodes_of_fit(
    fit: CellFit, coefficients: OfTerms, parent_key: Priorities, priority: Any, axis: Any, limits: Limits
) -> Nodes:
    """Turn fitted cells into leaves of the growing tree.

    ``parent_key`` has the key of each cell's parent: the least priority on the path from the root to it. ``priority``
    and ``axis`` are the results of the rules ``should_split`` and ``split`` for the cells. A cell may be split if its
    priority is larger than the tolerance and than :attr:`CellFit.noise`, and if the cell is not too deep.
    """
    priority = checked_priorities(fit, priority)
    axis = checked_axes(fit, axis)
    # Residuals are 0 at samples that do not reach the goal.
    volume = fit.reachable.astype(np.float64) @ fit.pattern.weight
    error = np.abs(fit.residual) @ fit.pattern.weight / np.where(volume > 0, volume, 1)
    may_split = (priority > np.maximum(limits.tolerance, fit.noise)) & is_within_depth(fit.cells, axis, limits)
    key = np.where(may_split, np.minimum(priority, parent_key), NEVER)
    volume = volume / fit.pattern.weight.sum() * np.ldexp(1.0, -fit.cells.depth.sum(axis=1))
    return Nodes(fit.cells, coefficients, error, volume, axis, key, np.full(len(fit), -1), fit.is_cut_off)


def is_within_depth(cells: Cells, axis: Axes, limits: Limits) -> Bool[np.ndarray, " cells"]:
    """Return whether each cell can be halved along its ``axis`` without exceeding the limits of depth."""
    along = cells.depth[np.arange(len(cells)), axis]
    return (cells.depth.sum(axis=1) < limits.max_depth) & (along < limits.max_axis_depth)


def checked_priorities(fit: CellFit, answer: Any) -> Priorities:
    """Return the answer of the rule ``should_split``, with other priorities for urgent cells (see :class:`CellFit`).

    The priority of an urgent cell is near the largest float, halved with each split, so that large cells come first.
    ``ValueError`` unless the answer has a priority for each cell.
    """
    priority = np.asarray(answer, float)
    if priority.shape != (len(fit),) or np.isnan(priority).any():
        expected = f"one priority a cell, shape ({len(fit)},) without NaN"
        raise ValueError(f"should_split must return {expected}, got shape {priority.shape}.")
    highest = np.ldexp(np.finfo(np.float64).max, -fit.cells.depth.sum(axis=1))
    return np.where(fit.urgent_axis >= 0, highest, priority)


def checked_axes(fit: CellFit, answer: Any) -> Axes:
    """Return the answer of the rule ``split``, with ``fit.urgent_axis`` for urgent cells (see :class:`CellFit`).

    ``ValueError`` unless the answer has an axis for each cell.
    """
    axis, dim = np.asarray(answer), fit.cells.dim
    least, most = axis.min(initial=dim), axis.max(initial=-1)
    if axis.shape != (len(fit),) or least < 0 or most >= dim:
        expected = f"one axis from 0 to {dim - 1} a cell, shape ({len(fit)},)"
        raise ValueError(f"split must return {expected}, got shape {axis.shape} with values from {least} to {most}.")
    return np.where(fit.urgent_axis >= 0, fit.urgent_axis, axis)


# The rules SHOULDSPLIT and SPLIT of Algorithm 1. The leaf of the largest positive priority is split next.
ShouldSplitRule: TypeAlias = Callable[[CellFit], Priorities]
SplitRule: TypeAlias = Callable[[CellFit], Axes]


def largest_error(fit: CellFit) -> Priorities:
    """Return each cell's largest weighted sample error, in units of distance; 0 if no sample reaches the goal."""
    return np.max(fit.weight * np.abs(fit.residual), axis=1)


def center_error(fit: CellFit) -> Priorities:
    """Return each cell's weighted absolute error at its center, in units of distance (Section III-B of the paper).

    If the center does not reach the goal, return :func:`largest_error`, so that an obstacle hides no bad fit.
    """
    at_center = fit.weight[:, 0] * np.abs(fit.residual[:, 0])
    return np.where(fit.reachable[:, 0], at_center, largest_error(fit))


def maximum_depth(fit: CellFit) -> Priorities:
    """Return the priority ``inf`` for each cell; 0 if no sample of the cell reaches the goal.

    Cells of equal priority are split in the order in which they were made, so the tree grows breadth first.
    """
    return np.where(np.isfinite(fit.center), np.inf, 0.0)


def best_axis(fit: CellFit) -> Axes:
    """Return each cell's axis whose two halves, fitted separately, have the smallest sum of squared errors.

    Two kinds of axes are excluded. Along the first kind, the cell has been halved ``max_axis_depth`` times. Along the
    second kind, the halves would be shorter than 1/8 of another side, in fractions of the domain's sides; 8 is
    ``2**MAX_ASPECT_BITS``. If all axes are excluded, return axis 0.
    """
    cost = _sum_of_squares_after_split(fit)
    return np.argmin(np.where(is_closed(fit.cells.depth, fit.max_axis_depth), np.inf, cost), axis=1)


def cyclic_axis(fit: CellFit) -> Axes:
    """Return each cell's number of halvings modulo ``dim``: axes take turns, as in Section III-B of the paper."""
    return fit.cells.depth.sum(axis=1) % fit.cells.dim


def _sum_of_squares_after_split(fit: CellFit) -> Float[np.ndarray, "cells dim"]:
    # Let r be the residual and W = diag(w) the weights of a cell's samples, and D the design matrix of one half. A
    # plane that is fitted to r there lowers the sum of w r^2 by
    #   p' (D' W D)^-1 p,  with p = D' W r.
    # Both halves together lower it by |B' r|^2, if the columns of W^-1/2 B are an orthonormal basis of all functions
    # W^1/2 f, where f is a plane in either half.
    # - Cells whose samples all have weight 1 share W and B, which is `halves_bases`.
    # - Each of the `masked` cells, with samples that do not reach the goal or have another weight, has its own W.
    residual, masked = fit.residual, fit.masked
    weight = fit.weight[masked] * fit.pattern.weight
    total = row_products(np.square(residual), fit.pattern.weight)
    total[masked] = (weight * np.square(residual[masked])).sum(axis=1)
    squares = np.empty(fit.cells.depth.shape)
    for axis, basis in enumerate(fit.pattern.halves_bases):
        squares[:, axis] = total - np.square(row_products(residual, basis)).sum(axis=1)
        if len(masked):
            explained = np.zeros(len(masked))
            for design in np.split(fit.pattern.halves[axis], 2, axis=1):
                projection = row_products(weight * residual[masked], design)
                explained += (projection * solve_planes(design, weight, projection)).sum(axis=1)
            squares[masked, axis] = total[masked] - explained
    return squares


_BYTES_SLACK = 1.15  # growth beyond the byte budget, so that more leaves of fewer bits can be chosen at the end
_ROUNDING_SHARE = 0.2  # file sizes during growth are estimated for this ratio of rounding error to the fit's error
_SAMPLES_AT_ONCE = 2**20  # about as many samples of cells are fitted at once
_LAST_SHARE = 32  # a round makes at least 1/32 of all splits that were made or are possible, if so many are allowed
# Function ``(fit, parent_keys)`` that turns fitted cells, and their parents' keys, into nodes of a growing tree.
NodesOf: TypeAlias = Callable[[CellFit, Priorities], Nodes]


class Encoding(NamedTuple):
    """The size of a file and the rounding error of its leaves, as functions of the number of bits per value."""

    choices: Sequence[int]  # numbers of bits to choose from
    size: Callable[[Nodes, Leaves, int], int]  # bytes of a file, by nodes, leaves and bits per value
    rounding_error: Callable[[Nodes, Leaves, int], float]  # mean error of rounded values


def fit_nodes(sampler: Sampler, nodes_of: NodesOf, cells: Cells, parent_key: Priorities) -> Nodes:
    """Sample and fit cells, about a million samples at a time, and return the nodes of a growing tree.

    ``parent_key`` has the keys of the cells' parents (see :class:`Nodes`). Cells in which few samples reach the goal
    are sampled again, more densely.
    """
    at_once = max(1, _SAMPLES_AT_ONCE // len(sampler.pattern))
    order, nodes = [], []
    for begin in range(0, len(cells), at_once):
        fit = sampler(cells[begin : begin + at_once])
        # Two patterns cannot share a CellFit: make the nodes of each, then restore the order of the cells.
        for is_dense in (False, True):
            if len(rows := np.flatnonzero(fit.is_hardly_seen == is_dense)):
                of_rows = replace(sampler, pattern=sampler.dense_pattern)(fit.cells[rows]) if is_dense else fit[rows]
                nodes.append(nodes_of(of_rows, parent_key[begin + rows]))
                order.append(begin + rows)
    return nodes[0].append(*nodes[1:])[np.argsort(np.concatenate(order))]


def grow_best_first(
    root: Nodes, sampler: Sampler, nodes_of: NodesOf, limits: Limits, encoding: Encoding
) -> tuple[Nodes, Leaves, int]:
    """Split the leaves of highest priority first, until a limit is reached.

    Return all nodes, the indices of the nodes that are leaves of the PLR, and the number of bits per stored value.
    """

    def split_some(nodes: Nodes) -> Nodes | None:
        # 1. Estimate how many splits the limits allow. For bytes: choose the bits whose rounding error is about
        #    _ROUNDING_SHARE of the fit's error -> bytes per leaf so far -> leaves that fit.
        order = split_order(nodes)
        allowed = limits.max_leaves - 1
        if np.isfinite(limits.max_bytes):
            leaf = nodes.leaves_of_splits(order[nodes.child[order] >= 0][:allowed])
            target = _ROUNDING_SHARE * _fit_error(nodes, leaf)
            bits = min(encoding.choices, key=lambda bits: abs(encoding.rounding_error(nodes, leaf, bits) - target))
            bytes_per_leaf = encoding.size(nodes, leaf, bits) / len(leaf)
            allowed = min(allowed, int(_BYTES_SLACK * limits.max_bytes / bytes_per_leaf) + 1)
        # 2. Split half of the leaves that would be split next, since their children may be more urgent than the other
        #    half. Near the end split all of them, since a round of few leaves takes as long as a round of many.
        #    Rounds go on until all of the first `allowed` nodes are split, which is what a priority queue does.
        unsplit = order[:allowed]
        unsplit = unsplit[nodes.child[unsplit] < 0]
        batch = unsplit[: max((len(unsplit) + 1) // 2, len(order) // _LAST_SHARE)]
        if len(batch) == 0:
            return None
        halves, keys = nodes.cells[batch].split(nodes.axis[batch]), np.repeat(nodes.key[batch], 2)
        grown = nodes.append(fit_nodes(sampler, nodes_of, halves, keys))
        grown.child[batch] = len(nodes.key) + 2 * np.arange(len(batch))
        check_memory(float(len(grown.key)))
        return grown

    nodes = grow(root, split_some, limits)
    return nodes, *_choose_leaves(nodes, limits, encoding)


def _choose_leaves(nodes: Nodes, limits: Limits, encoding: Encoding) -> tuple[Leaves, int]:
    """Choose the number of bits per stored value and the tree, within the limits, that have the least expected error.

    For each number of bits, only the largest tree that fits is tried. Return the indices of the leaves and the number
    of bits. ``BudgetTooSmall`` if not even one leaf fits.
    """
    limits.require_room(encoding.size(nodes, np.zeros(1, np.int64), min(encoding.choices)))
    order = split_order(nodes)
    order = order[nodes.child[order] >= 0][: limits.max_leaves - 1]

    def most_leaves(bits: int) -> Leaves:
        # Undo the last splits until the file fits, by bisection; no leaves if one leaf is too large.
        if np.isinf(limits.max_bytes):
            return nodes.leaves_of_splits(order)

        def size(num_splits: int) -> int:
            return encoding.size(nodes, nodes.leaves_of_splits(order[:num_splits]), bits)

        num_fitting = bisect_right(range(len(order) + 1), limits.max_bytes, key=size)
        return nodes.leaves_of_splits(order[: num_fitting - 1]) if num_fitting else np.empty(0, np.int64)

    def expected_error(leaf: Leaves, bits: int) -> float:
        # Errors of fit and rounding are combined as if they were independent.
        return np.hypot(_fit_error(nodes, leaf), encoding.rounding_error(nodes, leaf, bits)) if len(leaf) else np.inf

    within = [(most_leaves(bits), bits) for bits in encoding.choices]
    return min(within, key=lambda choice: (expected_error(*choice), -choice[1]))


def _fit_error(nodes: Nodes, leaf: Leaves) -> float:
    # The mean absolute error over all points that reach the goal.
    volume = nodes.volume[leaf]
    return float(np.sum(volume * nodes.error[leaf]) / np.sum(volume)) if volume.any() else 0.0
