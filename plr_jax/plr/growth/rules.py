"""SHOULDSPLIT and SPLIT, the two strategies of Algorithm 1.

A ``should_split`` rule gives every cell a priority: the leaf of the largest priority is split next, and never
one of priority 0 or below. A ``split`` rule gives the axis along which a cell would be halved.
"""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from jaxtyping import Float, Int

from plr_jax.plr.sampling.cell_fit import CellFit
from plr_jax.plr.sampling.plane_fits import normal_matrices, solve_planes

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
            squares[masked, axis] = total[masked] - _explained(fit.pattern.halves[axis], residual[masked], weight)
    return squares


def _explained(
    halves: Float[np.ndarray, "k terms_of_both"],
    residual: Float[np.ndarray, "cells k"],
    weight: Float[np.ndarray, "cells k"],
) -> Float[np.ndarray, "cells"]:
    """Part of the residuals' weighted sum of squares that least-squares planes in both halves explain."""
    explained = np.zeros(len(residual))
    for design in np.split(halves, 2, axis=1):
        projection = (weight * residual) @ design
        explained += (projection * solve_planes(normal_matrices(design, weight), projection)).sum(axis=1)
    return explained
