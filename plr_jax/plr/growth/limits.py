"""Growing in rounds, with progress and a way to stop early, up to limits of depth, number, size and error."""

import os
import warnings
from collections.abc import Callable, Sized
from dataclasses import dataclass, fields
from typing import Any, TypeVar, cast

import numpy as np
from jaxtyping import Bool, Float, Int
from tqdm import tqdm

from plr_jax.plr.certificate import Proof
from plr_jax.plr.coding import body_size
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.sampling.cell_fit import CellFit

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


Columns = TypeVar("Columns", bound="Rows")


class Rows:
    """What a dataclass inherits whose columns are arrays, or rows themselves, of equal length."""

    def __getitem__(self: Columns, index: Any) -> Columns:
        return type(self)(*(column[index] for column in self._columns()))

    def append(self: Columns, *others: Any) -> Columns:
        """These rows, followed by others."""
        if not others:
            return self
        every = zip(self._columns(), *(other._columns() for other in others), strict=True)
        return type(self)(
            *(
                np.concatenate(parts) if isinstance(parts[0], np.ndarray) else parts[0].append(*parts[1:])
                for parts in every
            )
        )

    def _columns(self) -> list[Any]:
        return [getattr(self, column.name) for column in fields(cast(Any, self))]


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
