"""Algorithm 1 of the paper, in rounds: many cells are sampled, fitted and split together.

The leaf of the largest priority is split first, as with a priority queue, but no leaf waits for its turn: each
round splits all leaves that are sure enough to be split, and the splits beyond the budget are taken back at the
end. The result is the tree that splitting one leaf at a time gives, whatever the size of a round.
"""

import warnings
from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int
from tqdm import tqdm

from plr_jax._arrays import require_integer
from plr_jax._types import ArrayLike, DistanceFn
from plr_jax.geometry.box import Box
from plr_jax.plr._plr import PLR, plr_of_leaves
from plr_jax.plr.growth.budget import choose_leaves, splits_allowed
from plr_jax.plr.growth.limits import Limits, check_limits, check_memory
from plr_jax.plr.growth.nodes import NEVER, Nodes, nodes_of_fit, split_order
from plr_jax.plr.growth.rules import ShouldSplitRule, SplitRule, best_axis, largest_error
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.sampling.cell_samples import FitRule, WeightFn, fit_cells, least_squares
from plr_jax.plr.sampling.pattern import sample_pattern

_SAMPLES_AT_ONCE = 2**20
_LAST_SHARE = 32  # of the splits so far, as many as this fraction are made in one last round


class ConstructionInterrupted(UserWarning):
    """Ctrl-C ended a construction early; what it returns is the PLR built so far."""


FitNodes = Callable[[Cells, Float[np.ndarray, "cells"]], Nodes]
"""COMPUTECOEFFICIENTS for a round's cells, none of which may be split before a split of the given key."""


def construct(
    distance_fn: DistanceFn,
    domain: Box | tuple[ArrayLike, ArrayLike],
    *,
    max_depth: int | None = None,
    max_leaves: int | None = None,
    max_bytes: int | None = None,
    tolerance: int | float | None = None,
    compute_coefficients: FitRule = least_squares,
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
        max_depth: Largest number of splits between the root and a leaf, at most 60. In any case no cell is halved
            more than ``28 // max(dim, 2)`` times along one axis (at least once).
        max_leaves: Largest number of leaves.
        max_bytes: Largest size of the file that :func:`save` writes.
        tolerance: Cells whose priority (the largest sample error, unless ``should_split`` says otherwise) is at
            most this are not split, in units of distance.
        compute_coefficients: Plane of a cell: ``least_squares``, ``midrange`` for a small largest error, or your own
            function of their kind.
        should_split: Priority of a cell: ``largest_error``, ``center_error``, ``maximum_depth`` or your own function
            of a ``CellFit``, from which the cell of the largest positive number is split next (True and False do).
        split: Axis along which to halve a cell: ``best_axis``, ``cyclic_axis`` or your own function of a ``CellFit``.
        num_samples: Samples of a cell, at its center, inside and on its faces; at least ``dim + 1``, with which a
            plane passes through its samples and shows no error: take several times as many.
        margin: How far samples reach beyond their cell, as a fraction from 0 to 1 of its width ("within or near the
            cell"). Averages the noise of an oracle such as a roadmap.
        weight_fn: Weight of the error at each of a batch of points, finite and >= 0; where accuracy matters.
        coefficient_bits: Bits of a stored center value: 32 for floats, 4 to 20 for scaled integers, of which
            half-differences need fewer. None: 32 without ``max_bytes``; with it, those from 8 to 16 with which
            the expected error, of the fit and of the rounding together, is least.
        seed: Seed of the samples' scrambling. The same seed gives the same PLR.

    Returns:
        The PLR. If interrupted (Ctrl-C), the one built so far, with a ``ConstructionInterrupted`` warning.

    Raises:
        ValueError: If an argument is out of its range, the limits allow a tree larger than memory, a budget is too
            small for one leaf, ``distance_fn`` returns a wrong shape or NaN, or no sample reaches the goal.

    References:
        Section III-B of the paper.
    """
    domain = Box.of(domain)
    limits = check_limits(max_depth, max_leaves, max_bytes, tolerance, coefficient_bits)
    if not isinstance(num_samples, int | np.integer) or num_samples < domain.dim + 1:
        raise ValueError(
            f"num_samples must be at least dim + 1 = {domain.dim + 1} to determine a plane, got {num_samples}."
        )
    if not (isinstance(margin, int | float | np.number) and 0 <= margin <= 1):
        raise ValueError(f"margin must be a fraction from 0 to 1 of a cell's width, got {margin!r}.")
    require_integer("seed", seed, 0)
    pattern = sample_pattern(domain.dim, int(num_samples), float(margin), int(seed))

    at_once = max(1, _SAMPLES_AT_ONCE // len(pattern))

    def fit_nodes(cells: Cells, bound: Float[np.ndarray, "cells"]) -> Nodes:
        parts = []
        for start in range(0, len(cells), at_once):
            part = slice(start, start + at_once)
            fit = fit_cells(cells[part], domain, distance_fn, weight_fn, pattern, compute_coefficients)
            priority, axis = np.asarray(should_split(fit), float), np.asarray(split(fit))
            parts.append(nodes_of_fit(fit, bound[part], priority, axis, limits))
        return Nodes.concatenate(parts)

    nodes = _grow(fit_nodes, domain.dim, limits)
    leaf, planes = choose_leaves(nodes, limits)
    return plr_of_leaves(domain, nodes.cells[leaf], planes)


def _grow(fit_nodes: FitNodes, dim: int, limits: Limits) -> Nodes:
    """Split in rounds until every node that belongs to the final tree has been split."""
    nodes = fit_nodes(Cells.root(dim), np.array([np.inf]))
    if not np.isfinite(nodes.center[0]):
        raise ValueError(
            "distance_fn found nothing reachable: it returned inf at every sample of the domain. Check that the "
            "goal lies in free space and that the domain is the part of the world it is in; if free space is a "
            "tiny part of the domain, raise num_samples."
        )
    with tqdm(desc="construct", unit=" splits", delay=2, leave=False, disable=None) as progress:
        try:
            while len(batch := _next_batch(nodes, limits)):
                children = fit_nodes(nodes.cells[batch].split(nodes.axis[batch]), np.repeat(nodes.key[batch], 2))
                grown = Nodes.concatenate([nodes, children])
                grown.child[batch] = len(nodes.key) + 2 * np.arange(len(batch))
                nodes = grown  # in one step: an interrupt before it loses this round, never the tree
                check_memory(float(len(nodes.key)))
                progress.update(len(batch))
        except KeyboardInterrupt:
            warnings.warn(
                f"Interrupted after {np.count_nonzero(nodes.child >= 0)} splits: the PLR is the one built so far.",
                ConstructionInterrupted,
                stacklevel=3,
            )
            nodes.key[nodes.child < 0] = NEVER
    return nodes


def _next_batch(nodes: Nodes, limits: Limits) -> Int[np.ndarray, "batch"]:
    """Leaves to split next: the better half of those that would be split if no better ones came up.

    Of the last few all: some are sampled in vain, but a round of a few takes as long as one of many.
    """
    order = split_order(nodes)
    wanted = order[: splits_allowed(nodes, order, limits)]
    wanted = wanted[nodes.child[wanted] < 0]
    return wanted[: max((len(wanted) + 1) // 2, len(order) // _LAST_SHARE)]
