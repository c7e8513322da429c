"""Algorithm 1 of the paper, in rounds: many cells are sampled, fitted and split together.

The leaf of the largest priority is split first, as with a priority queue, but no leaf waits for its turn: each
round splits all leaves that are sure enough to be split, and the splits beyond the budget are taken back at the
end. The result is the tree that splitting one leaf at a time gives, whatever the size of a round.
"""

import os
import warnings
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float, Int
from tqdm import tqdm

from plr_jax._box import Box
from plr_jax._types import ArrayLike, DistanceFn
from plr_jax.plr._cells import Cells
from plr_jax.plr._file import encode, size_in_bytes
from plr_jax.plr._fit import CellFit, Pattern, WeightFn, fit_cells, sample_pattern
from plr_jax.plr._planes import FLOAT_BITS, MAX_BITS, MIN_BITS, StoredPlanes, encode_planes
from plr_jax.plr._plr import PLR, from_bytes
from plr_jax.plr._split import ShouldSplitRule, SplitRule, best_axis, largest_error
from plr_jax.plr._tree import MAX_DEPTH

DEFAULT_MAX_LEAVES = 512
_SAMPLES_AT_ONCE = 2**20
_BYTES_A_NODE = 200
_MAX_SLOT_BITS = 28  # of all axes together: bounds the tables of a query
_BUDGET_BITS = range(8, 17)  # center values that construction chooses from under a budget of bytes
_BYTES_SLACK = 1.15  # leaves grown beyond the budget, so that fewer bits for more leaves is a choice
_NEVER = -np.inf


@dataclass(frozen=True, eq=False)
class Nodes:
    """All nodes of the growing tree, parents before children.

    Attributes:
        cells: Their cells.
        center: Value of each plane at the cell's center; ``inf`` if blocked.
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

    def append(self, other: "Nodes") -> "Nodes":
        """These nodes followed by the others."""
        columns = {}
        for column in fields(self):
            mine, theirs = getattr(self, column.name), getattr(other, column.name)
            columns[column.name] = mine.append(theirs) if column.name == "cells" else np.concatenate([mine, theirs])
        return Nodes(**columns)


@dataclass(frozen=True, eq=False)
class Limits:
    """When to stop: see :func:`construct`."""

    max_depth: int
    max_leaves: int
    max_bytes: float
    tolerance: float
    coefficient_bits: int | None


def construct(
    distance_fn: DistanceFn,
    domain: Box | tuple[ArrayLike, ArrayLike],
    *,
    max_depth: int | None = None,
    max_leaves: int | None = None,
    max_bytes: int | None = None,
    tolerance: int | float | None = None,
    should_split: ShouldSplitRule = largest_error,
    split: SplitRule = best_axis,
    num_samples: int = 192,
    margin: int | float = 0,
    weight_fn: WeightFn | None = None,
    coefficient_bits: int | None = None,
    seed: int = 0,
) -> PLR:
    """Build a PLR of a distance function: Algorithm 1 of the paper.

    The default is best-first: the leaf of the largest sample error is split next, along the axis whose halves
    can be fitted best. The paper's own configuration is ``should_split=maximum_depth`` (or ``center_error`` with
    a tolerance), ``split=cyclic_axis``, ``max_depth=9``.

    Any limits may be combined; construction stops at the first that is met. Without any, at 512 leaves.

    Args:
        distance_fn: Distance to the goal for a batch of points ``(n, dim)``; ``inf`` where it cannot be reached.
        domain: The box to cover, a ``Box`` or its two corners.
        max_depth: Largest number of splits between the root and a leaf, at most 60.
        max_leaves: Largest number of leaves.
        max_bytes: Largest size of the file that :func:`save` writes.
        tolerance: Cells whose priority (the largest sample error, unless ``should_split`` says otherwise) is at
            most this are not split, in units of distance.
        should_split: Priority of a cell: ``largest_error``, ``center_error``, ``maximum_depth`` or your own.
        split: Axis along which to halve a cell: ``best_axis``, ``cyclic_axis`` or your own.
        num_samples: Samples of a cell, at its center, inside and on its faces; at least ``dim + 1``.
        margin: How far samples reach beyond their cell, as a fraction of its width ("within or near the cell").
        weight_fn: Weight of the error at each of a batch of points, finite and >= 0; where accuracy matters.
        coefficient_bits: Bits of a stored center value: 32 for floats, 4 to 20 for scaled integers, of which
            half-differences need fewer. None: 32 without ``max_bytes``; with it, as few as keep the rounding
            below the error of the fit.
        seed: Seed of the samples' scrambling. The same seed gives the same PLR.

    Returns:
        The PLR. If interrupted (Ctrl-C), the one built so far, with a warning.

    Raises:
        ValueError: If an argument is out of its range, the limits allow a tree larger than memory, a budget is too
            small for one leaf, ``distance_fn`` returns a wrong shape or NaN, or no sample reaches the goal.

    References:
        Section III-B of the paper.
    """
    domain = domain if isinstance(domain, Box) else Box(*domain)
    limits = _check_limits(max_depth, max_leaves, max_bytes, tolerance, coefficient_bits)
    if not isinstance(num_samples, int | np.integer) or num_samples < domain.dim + 1:
        raise ValueError(
            f"num_samples must be at least dim + 1 = {domain.dim + 1} to determine a plane, got {num_samples}."
        )
    if not 0 <= margin < np.inf:
        raise ValueError(f"margin must be a finite fraction >= 0 of a cell's width, got {margin}.")
    pattern = sample_pattern(domain.dim, int(num_samples), margin, seed)

    def fit(cells: Cells, bound: Float[np.ndarray, "cells"]) -> Nodes:
        return _fit_nodes(cells, bound, domain, distance_fn, weight_fn, pattern, should_split, split, limits)

    nodes = _grow(fit, domain.dim, limits)
    leaf, bits = _choose_leaves(nodes, limits)
    if len(leaf) == 0:
        smallest = _size(nodes, np.zeros(1, np.int64), coefficient_bits or min(_BUDGET_BITS))
        raise ValueError(f"max_bytes={max_bytes} is too small: one leaf takes {smallest} bytes; allow at least that.")
    return from_bytes(encode(domain, nodes.cells[leaf], _stored(nodes, leaf, bits)))


def _grow(fit, dim: int, limits: Limits) -> Nodes:
    """Split in rounds until every node that belongs to the final tree has been split."""
    nodes = fit(Cells.root(dim), np.array([np.inf]))
    if not np.isfinite(nodes.center[0]):
        raise ValueError(
            "distance_fn found nothing reachable: it returned inf at every sample of the domain. Check that the "
            "goal lies in free space and that the domain is the part of the world it is in; if free space is a "
            "tiny part of the domain, raise num_samples."
        )
    with tqdm(desc="construct", unit=" splits", delay=2, leave=False, disable=None) as progress:
        try:
            while len(batch := _next_batch(nodes, limits)):
                children = fit(nodes.cells[batch].split(nodes.axis[batch]), np.repeat(nodes.key[batch], 2))
                _check_memory(float(len(nodes.key) + len(children.key)))
                nodes.child[batch] = len(nodes.key) + 2 * np.arange(len(batch))
                nodes = nodes.append(children)
                progress.update(len(batch))
        except KeyboardInterrupt:
            warnings.warn(
                f"construct was interrupted; the PLR holds the {np.count_nonzero(nodes.child < 0)} leaves built so "
                "far.",
                stacklevel=3,
            )
            nodes.key[nodes.child < 0] = _NEVER
    return nodes


def _next_batch(nodes: Nodes, limits: Limits) -> Int[np.ndarray, "batch"]:
    """Leaves to split next: the better half of those that would be split if no better ones came up."""
    order = _split_order(nodes)
    wanted = order[: _splits_allowed(nodes, order, limits)]
    wanted = wanted[nodes.child[wanted] < 0]
    return wanted[: (len(wanted) + 1) // 2]


def _split_order(nodes: Nodes) -> Int[np.ndarray, "splits"]:
    """Nodes that are or may be split, in the order in which a priority queue would split them.

    A child's key is at most its parent's, so every prefix of this order is a tree.
    """
    candidates = np.flatnonzero(nodes.key > _NEVER)
    return candidates[np.argsort(-nodes.key[candidates], kind="stable")]


def _splits_allowed(nodes: Nodes, order: Int[np.ndarray, "splits"], limits: Limits) -> int:
    """How many splits the limits may allow at most, judged by the bytes a leaf takes so far."""
    allowed = limits.max_leaves - 1
    if np.isfinite(limits.max_bytes):
        leaf = _leaves_after(nodes, order[nodes.child[order] >= 0][:allowed])
        a_leaf = _size(nodes, leaf, _sufficient_bits(nodes, leaf, limits)) / len(leaf)
        allowed = min(allowed, int(_BYTES_SLACK * limits.max_bytes / a_leaf) + 1)
    return allowed


def _choose_leaves(nodes: Nodes, limits: Limits) -> tuple[Int[np.ndarray, "leaves"], int]:
    """Leaves of the best tree within the limits, and the bits of a center value."""
    order = _split_order(nodes)
    order = order[nodes.child[order] >= 0][: limits.max_leaves - 1]
    if not np.isfinite(limits.max_bytes):
        return _leaves_after(nodes, order), limits.coefficient_bits or FLOAT_BITS
    if limits.coefficient_bits is not None:
        return _leaves_within(nodes, order, limits.max_bytes, limits.coefficient_bits), limits.coefficient_bits
    choices = [(_leaves_within(nodes, order, limits.max_bytes, bits), bits) for bits in _BUDGET_BITS]
    return min(choices, key=lambda choice: _expected_error(nodes, *choice))


def _leaves_within(
    nodes: Nodes, order: Int[np.ndarray, "splits"], max_bytes: float, bits: int
) -> Int[np.ndarray, "leaves"]:
    """Leaves of the largest tree of the given order that fits into so many bytes; none if not even the root does."""
    enough, too_many = -1, len(order) + 1
    while too_many - enough > 1:
        middle = (enough + too_many) // 2
        fits = _size(nodes, _leaves_after(nodes, order[:middle]), bits) <= max_bytes
        enough, too_many = (middle, too_many) if fits else (enough, middle)
    return _leaves_after(nodes, order[:enough]) if enough >= 0 else np.empty(0, np.int64)


def _leaves_after(nodes: Nodes, splits: Int[np.ndarray, "splits"]) -> Int[np.ndarray, "leaves"]:
    """Leaves of the tree whose inner nodes are the given ones."""
    is_leaf = np.zeros(len(nodes.key), bool)
    is_leaf[0] = True
    is_leaf[nodes.child[splits]] = is_leaf[nodes.child[splits] + 1] = True
    is_leaf[splits] = False
    return np.flatnonzero(is_leaf)


def _stored(nodes: Nodes, leaf: Int[np.ndarray, "leaves"], bits: int) -> StoredPlanes:
    return encode_planes(nodes.center[leaf], nodes.half[leaf], bits)


def _size(nodes: Nodes, leaf: Int[np.ndarray, "leaves"], bits: int) -> int:
    return size_in_bytes(nodes.cells[leaf], _stored(nodes, leaf, bits))


def _sufficient_bits(nodes: Nodes, leaf: Int[np.ndarray, "leaves"], limits: Limits) -> int:
    """Bits that would be chosen for these leaves if bytes did not matter much."""
    if limits.coefficient_bits is not None:
        return limits.coefficient_bits
    return min(_BUDGET_BITS, key=lambda bits: abs(_rounding_error(nodes, leaf, bits) - 0.2 * _fit_error(nodes, leaf)))


def _expected_error(nodes: Nodes, leaf: Int[np.ndarray, "leaves"], bits: int) -> float:
    """Mean error over reachable points: of the fit and of the rounding, which are independent."""
    if len(leaf) == 0:
        return np.inf
    return float(np.hypot(_fit_error(nodes, leaf), _rounding_error(nodes, leaf, bits)))


def _fit_error(nodes: Nodes, leaf: Int[np.ndarray, "leaves"]) -> float:
    return float(np.sum(nodes.share[leaf] * nodes.error[leaf]) / np.sum(nodes.share[leaf]))


def _rounding_error(nodes: Nodes, leaf: Int[np.ndarray, "leaves"], bits: int) -> float:
    """Root mean square, over the cells, of rounding center and half-differences to a multiple of the step."""
    center = nodes.center[leaf][np.isfinite(nodes.center[leaf])]
    step = np.ptp(center) / (1 << bits)
    return float(step * np.sqrt((1 + nodes.cells.dim / 3) / 12))


def _fit_nodes(
    cells: Cells,
    bound: Float[np.ndarray, "cells"],
    domain: Box,
    distance_fn: DistanceFn,
    weight_fn: WeightFn | None,
    pattern: Pattern,
    should_split: ShouldSplitRule,
    split: SplitRule,
    limits: Limits,
) -> Nodes:
    """COMPUTECOEFFICIENTS for a round's cells, and the priority and axis of each one's own split."""
    at_once = max(1, _SAMPLES_AT_ONCE // len(pattern))
    parts = []
    for start in range(0, len(cells), at_once):
        part = slice(start, start + at_once)
        fit = fit_cells(cells[part], domain, distance_fn, weight_fn, pattern)
        parts.append(_node_of_fit(fit, bound[part], should_split(fit), split(fit), limits))
    nodes = parts[0]
    for part in parts[1:]:
        nodes = nodes.append(part)
    return nodes


def _node_of_fit(
    fit: CellFit,
    bound: Float[np.ndarray, "cells"],
    priority: Float[np.ndarray, "cells"],
    axis: Int[np.ndarray, "cells"],
    limits: Limits,
) -> Nodes:
    depth = fit.cells.depth
    volume = fit.reachable @ fit.pattern.weight
    error = np.abs(fit.residual) @ fit.pattern.weight / np.where(volume > 0, volume, 1)
    at_limit = depth.sum(axis=1) >= limits.max_depth
    at_limit |= depth[np.arange(len(depth)), axis] >= _MAX_SLOT_BITS // max(fit.cells.dim, 2)
    # Errors below the resolution of 32-bit floats are noise, not something a split could mend.
    noise = np.finfo(np.float32).eps * np.abs(np.where(np.isfinite(fit.center), fit.center, 0))
    worth_it = (priority > np.maximum(limits.tolerance, noise)) & ~at_limit
    return Nodes(
        cells=fit.cells,
        center=fit.center,
        half=fit.half,
        error=error,
        share=volume / fit.pattern.weight.sum() * np.ldexp(1.0, -depth.sum(axis=1)),
        axis=axis,
        key=np.where(worth_it, np.minimum(priority, bound), _NEVER),
        child=np.full(len(depth), -1),
    )


def _check_limits(
    max_depth: int | None,
    max_leaves: int | None,
    max_bytes: int | None,
    tolerance: int | float | None,
    coefficient_bits: int | None,
) -> Limits:
    """Limits with every None replaced, after checking their ranges."""
    for name, value, least in (
        ("max_depth", max_depth, 0),
        ("max_leaves", max_leaves, 1),
        ("max_bytes", max_bytes, 1),
    ):
        if value is not None and (value != int(value) or value < least):
            raise ValueError(f"{name} must be an integer >= {least}, got {value}.")
    if max_depth is not None and max_depth > MAX_DEPTH:
        raise ValueError(f"max_depth must be at most {MAX_DEPTH}, got {max_depth}.")
    if tolerance is not None and not 0 <= tolerance < np.inf:
        raise ValueError(f"tolerance must be a finite distance >= 0, got {tolerance}.")
    if coefficient_bits not in (None, FLOAT_BITS, *range(MIN_BITS, MAX_BITS + 1)):
        raise ValueError(
            f"coefficient_bits must be {FLOAT_BITS} (floats) or {MIN_BITS} to {MAX_BITS}, got {coefficient_bits}."
        )
    if max_depth is None and max_leaves is None and max_bytes is None and tolerance is None:
        max_leaves = DEFAULT_MAX_LEAVES
    most_leaves = min(max_leaves or np.inf, 8 * (max_bytes or np.inf), 2.0 ** (max_depth or MAX_DEPTH))
    if tolerance is None:
        _check_memory(2.0 * most_leaves)
    return Limits(
        max_depth=MAX_DEPTH if max_depth is None else int(max_depth),
        max_leaves=np.iinfo(np.int64).max if max_leaves is None else int(max_leaves),
        max_bytes=np.inf if max_bytes is None else float(max_bytes),
        tolerance=0.0 if tolerance is None else float(tolerance),
        coefficient_bits=coefficient_bits,
    )


def _check_memory(num_nodes: float) -> None:
    needed = num_nodes * _BYTES_A_NODE
    if needed > _machine_bytes():
        raise ValueError(
            f"The limits allow {num_nodes / 2:.3g} leaves or more, which would need about {needed / 2**30:.3g} GiB; "
            f"this machine has {_machine_bytes() / 2**30:.3g}. Lower max_depth, or also give max_leaves, max_bytes "
            "or a tolerance."
        )


def _machine_bytes() -> float:
    """Physical memory; unlimited where the system does not say."""
    if not hasattr(os, "sysconf"):
        return np.inf
    return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
