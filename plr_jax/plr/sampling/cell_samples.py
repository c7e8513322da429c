"""COMPUTECOEFFICIENTS for many cells at once: one oracle call, one batched least-squares fit.

A plane is fitted in the local coordinates ``u`` of its cell (``[-1, 1]`` along every axis), as its value at the
center and its half-differences: ``L(u) = center + half . u``. In those coordinates the design matrix of a cell
without unreachable samples is the same for all cells, so its pseudo-inverse is computed once.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._types import DistanceFn, Points
from plr_jax.geometry.box import Box
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.sampling.pattern import Pattern

WeightFn = Callable[[Points], Float[np.ndarray, "n"]]

# Ridge on the slope, relative to the number of samples: small enough to leave a determined fit as it is (relative
# change below 1e-8), large enough that a direction in which no sample varies gets slope zero.
_RIDGE = 1e-9


FitRule: TypeAlias = Callable[
    [Pattern, Float[np.ndarray, "cells k"], Float[np.ndarray, "cells k"]],
    tuple[Float[np.ndarray, "cells"], Float[np.ndarray, "cells dim"]],
]
"""COMPUTECOEFFICIENTS: from the pattern, the values and their weights to centers and half-differences."""


@dataclass(frozen=True, eq=False)
class CellFit:
    """Samples of a batch of cells and the plane fitted to each.

    Attributes:
        cells: The cells.
        pattern: Where they were sampled; the first sample is the center.
        reachable: Which samples reach the goal.
        weight: Weight that the caller gives each sample; 0 where the goal cannot be reached.
        center: Value of the plane at the cell's center; ``inf`` for a cell without a reachable sample.
        half: Half-difference of the plane along each axis of the cell.
        residual: Sampled distance minus plane; 0 where the goal cannot be reached.
    """

    cells: Cells
    pattern: Pattern
    reachable: Bool[np.ndarray, "cells k"]
    weight: Float[np.ndarray, "cells k"]
    center: Float[np.ndarray, "cells"]
    half: Float[np.ndarray, "cells dim"]
    residual: Float[np.ndarray, "cells k"]

    @cached_property
    def masked(self) -> Int[np.ndarray, "masked"]:
        """Cells in which not every sample has weight 1."""
        return _masked(self.weight)


def least_squares(
    pattern: Pattern, value: Float[np.ndarray, "cells k"], weight: Float[np.ndarray, "cells k"]
) -> tuple[Float[np.ndarray, "cells"], Float[np.ndarray, "cells dim"]]:
    """The plane of the smallest (weighted) sum of squared errors: the paper's fit, best for the mean error.

    A sample's weight is the pattern's times ``weight``. Where the samples of positive weight do not determine the
    plane, the slope of least norm is taken: one sample gives its value with slope zero, none gives zero.

    Args:
        pattern: Where the cells are sampled.
        value: Distance at each sample of each cell, finite.
        weight: Weight of each, >= 0; 0 where the goal cannot be reached.

    Returns:
        The value at the center ``(cells,)`` and the half-differences ``(cells, dim)``.

    References:
        Section III-A of the paper.
    """
    plane = value @ pattern.pseudo_inverse.T
    masked = _masked(weight)
    if len(masked):
        design, weight = pattern.design, weight[masked] * pattern.weight
        plane[masked] = solve_planes(_normal_matrices(design, weight), (weight * value[masked]) @ design)
    return plane[:, 0], plane[:, 1:]


def midrange(
    pattern: Pattern, value: Float[np.ndarray, "cells k"], weight: Float[np.ndarray, "cells k"]
) -> tuple[Float[np.ndarray, "cells"], Float[np.ndarray, "cells dim"]]:
    """The slope of :func:`least_squares`, at the height that makes the largest error smallest.

    Above and below the plane the samples of positive weight then err equally far. Meant for a ``tolerance``: fewer
    leaves for the same largest error, at about twice the mean error for the same leaves.

    Args:
        pattern: Where the cells are sampled.
        value: Distance at each sample of each cell, finite.
        weight: Weight of each, >= 0; 0 where the goal cannot be reached.

    Returns:
        The value at the center ``(cells,)`` and the half-differences ``(cells, dim)``.
    """
    center, half = least_squares(pattern, value, weight)
    residual = value - (center[:, None] + half @ pattern.u.T)
    counts = weight > 0
    counts |= ~counts.any(axis=1, keepdims=True)
    highest = residual.max(axis=1, where=counts, initial=-np.inf)
    lowest = residual.min(axis=1, where=counts, initial=np.inf)
    return center + 0.5 * (highest + lowest), half


def fit_cells(
    cells: Cells,
    domain: Box,
    distance_fn: DistanceFn,
    weight_fn: WeightFn | None,
    pattern: Pattern,
    compute_coefficients: FitRule = least_squares,
) -> CellFit:
    """Sample the distance in every cell and fit its plane (Section III-A of the paper)."""
    x = cells.points(pattern.u, domain).reshape(-1, cells.dim)
    distance = call_oracle(distance_fn, x).reshape(len(cells), len(pattern))
    reachable = np.isfinite(distance)
    weight = reachable.astype(np.float64)
    if weight_fn is not None:
        weight *= _call_weights(weight_fn, x).reshape(weight.shape)
    value = np.where(reachable, distance, 0.0)
    # A cell to which no weight is given still gets the plane of its samples.
    fit_weight = weight if weight_fn is None else np.where((weight > 0).any(axis=1, keepdims=True), weight, reachable)
    center, half = compute_coefficients(pattern, value, fit_weight)
    _check_planes(center, half, cells)
    residual = value - (center[:, None] + half @ pattern.u.T)
    residual *= reachable
    center = np.where(reachable.any(axis=1), center, np.inf)
    return CellFit(cells, pattern, reachable, weight, center, half, residual)


def _check_planes(center: Float[np.ndarray, "..."], half: Float[np.ndarray, "..."], cells: Cells) -> None:
    if np.shape(center) != (len(cells),) or np.shape(half) != (len(cells), cells.dim):
        raise ValueError(
            f"compute_coefficients must return shapes ({len(cells)},) and ({len(cells)}, {cells.dim}), a center "
            f"value and half-differences a cell, got {np.shape(center)} and {np.shape(half)}."
        )
    if not (np.isfinite(center).all() and np.isfinite(half).all()):
        raise ValueError("compute_coefficients must return finite planes, got NaN or infinity.")


def sum_of_squares_after_split(fit: CellFit) -> Float[np.ndarray, "cells dim"]:
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
        explained += (projection * solve_planes(_normal_matrices(design, weight), projection)).sum(axis=1)
    return explained


def _masked(weight: Float[np.ndarray, "cells k"]) -> Int[np.ndarray, "masked"]:
    differs = weight != 1
    return np.flatnonzero(differs.any(axis=1)) if differs.any() else np.zeros(0, np.int64)


def _normal_matrices(
    design: Float[np.ndarray, "k terms"], weight: Float[np.ndarray, "cells k"]
) -> Float[np.ndarray, "cells terms terms"]:
    """The matrices of the normal equations of every cell."""
    k, terms = design.shape
    products = (design[:, :, None] * design[:, None, :]).reshape(k, terms * terms)
    return (weight @ products).reshape(-1, terms, terms)


def solve_planes(
    normal: Float[np.ndarray, "cells terms terms"], projection: Float[np.ndarray, "cells terms"]
) -> Float[np.ndarray, "cells terms"]:
    """Planes that solve the normal equations; of slope zero in directions in which no sample varies."""
    terms, total = normal.shape[-1], normal[:, 0, 0].copy()
    ridge = np.where(total > 0, _RIDGE * total, 1.0)
    normal[:, range(1, terms), range(1, terms)] += ridge[:, None]
    normal[:, 0, 0] += total == 0
    return np.linalg.solve(normal, projection[..., None])[..., 0]


def call_oracle(distance_fn: DistanceFn, x: Points) -> Float[np.ndarray, "n"]:
    distance = distance_fn(x.copy())  # it may compute in place
    try:
        distance = np.asarray(distance)
        distance = distance if distance.dtype.kind == "c" else distance.astype(np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"distance_fn must return an array of numbers, got {distance!r}.") from error
    if distance.dtype.kind == "c":
        raise ValueError("distance_fn must return real numbers, got complex ones.")
    if distance.shape != (len(x),):
        raise ValueError(
            f"distance_fn must return one distance a point, shape ({len(x)},) for points of shape {x.shape}, "
            f"got shape {distance.shape}."
        )
    bad = np.isnan(distance) | (distance == -np.inf)
    if bad.any():
        first = int(np.argmax(bad))
        raise ValueError(
            f"distance_fn must return numbers, or inf where the goal cannot be reached, got {distance[first]} "
            f"at {x[first].tolist()}."
        )
    return distance


def _call_weights(weight_fn: WeightFn, x: Points) -> Float[np.ndarray, "n"]:
    weight = np.asarray(weight_fn(x), dtype=np.float64)
    if weight.shape != (len(x),) or not np.isfinite(weight).all() or (weight < 0).any():
        raise ValueError(
            f"weight_fn must return one finite weight >= 0 a point, shape ({len(x)},), got shape {weight.shape} "
            f"with values from {weight.min(initial=np.inf):g} to {weight.max(initial=-np.inf):g}."
        )
    return weight
