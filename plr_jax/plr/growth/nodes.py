"""The nodes of a growing tree, and the order in which a priority queue would split them."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax.plr.growth.limits import Limits
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.sampling.cell_fit import CellFit

NEVER = -np.inf


@dataclass(frozen=True, eq=False)
class Nodes:
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

    @staticmethod
    def concatenate(parts: Sequence["Nodes"]) -> "Nodes":
        """Nodes one after another, at least one part."""
        first, *others = parts
        if not others:
            return first
        cells = first.cells.append(*(part.cells for part in others))
        columns = [column.name for column in fields(Nodes) if column.name != "cells"]
        return Nodes(cells, *(np.concatenate([getattr(part, name) for part in parts]) for name in columns))

    def __getitem__(self, index) -> "Nodes":
        columns = {column.name: getattr(self, column.name)[index] for column in fields(Nodes)}
        return Nodes(**columns)

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
