"""The nodes of a growing tree, and the order in which a priority queue would split them."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float, Int

from plr_jax.plr.growth.limits import Limits
from plr_jax.plr.growth.rules import max_axis_depth
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.sampling.cell_samples import CellFit

NEVER = -np.inf


@dataclass(frozen=True, eq=False)
class Nodes:
    """All nodes of the growing tree, parents before children.

    Attributes:
        cells: Their cells.
        center: Value of each plane at the cell's center; ``inf`` if no sample reaches the goal.
        half: Half-differences of each plane.
        error: Mean error over the reachable samples.
        share: Share of the domain's volume that a node's reachable samples stand for.
        axis: Axis along which the node is or would be split.
        key: Rank of the node's split: its priority, but never above its parent's; ``-inf`` if it may not be split.
        child: Index of the lower child, the upper one following it; -1 for a leaf.
    """

    cells: Cells
    center: Float[np.ndarray, "nodes"]
    half: Float[np.ndarray, "nodes dim"]
    error: Float[np.ndarray, "nodes"]
    share: Float[np.ndarray, "nodes"]
    axis: Int[np.ndarray, "nodes"]
    key: Float[np.ndarray, "nodes"]
    child: Int[np.ndarray, "nodes"]

    @staticmethod
    def concatenate(parts: Sequence["Nodes"]) -> "Nodes":
        """Nodes one after another, at least one part."""
        first, *others = parts
        if not others:
            return first
        cells = first.cells.append(*(part.cells for part in others))
        columns = [column.name for column in fields(Nodes) if column.name != "cells"]
        return Nodes(cells, *(np.concatenate([getattr(part, name) for part in parts]) for name in columns))


def split_order(nodes: Nodes) -> Int[np.ndarray, "splits"]:
    """Nodes that are or may be split, in the order in which a priority queue would split them.

    A child's key is at most its parent's, so every prefix of this order is a tree.
    """
    candidates = np.flatnonzero(nodes.key > NEVER)
    return candidates[np.argsort(-nodes.key[candidates], kind="stable")]


def nodes_of_fit(
    fit: CellFit,
    bound: Float[np.ndarray, "cells"],
    priority: Float[np.ndarray, "..."],
    axis: Int[np.ndarray, "..."],
    limits: Limits,
) -> Nodes:
    """Leaves of a round: their fits, and whether and when each may be split.

    Args:
        fit: Samples and planes of the round's cells.
        bound: Key of each cell's parent, above which its own may not rise.
        priority: What the ``should_split`` rule says.
        axis: What the ``split`` rule says.
        limits: Limits on depth and error.
    """
    _check_rules(fit, priority, axis)
    depth = fit.cells.depth
    volume = fit.reachable.astype(np.float64) @ fit.pattern.weight
    error = np.abs(fit.residual) @ fit.pattern.weight / np.where(volume > 0, volume, 1)
    at_limit = depth.sum(axis=1) >= limits.max_depth
    at_limit |= depth[np.arange(len(depth)), axis] >= max_axis_depth(fit.cells.dim)
    # Errors below the resolution of 32-bit floats are noise, not something a split could mend.
    noise = np.finfo(np.float32).eps * np.abs(np.where(np.isfinite(fit.center), fit.center, 0))
    noise *= fit.weight.max(axis=1)  # priorities are weighted errors
    worth_it = (priority > np.maximum(limits.tolerance, noise)) & ~at_limit
    return Nodes(
        cells=fit.cells,
        center=fit.center,
        half=fit.half,
        error=error,
        share=volume / fit.pattern.weight.sum() * np.ldexp(1.0, -depth.sum(axis=1)),
        axis=axis,
        key=np.where(worth_it, np.minimum(priority, bound), NEVER),
        child=np.full(len(depth), -1),
    )


def _check_rules(fit: CellFit, priority: Float[np.ndarray, "..."], axis: Int[np.ndarray, "..."]) -> None:
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
