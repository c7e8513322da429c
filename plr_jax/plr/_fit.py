"""COMPUTECOEFFICIENTS for many cells at once: one oracle call, one batched least-squares fit.

A plane is fitted in the local coordinates ``u`` of its cell (``[-1, 1]`` along every axis), as its value at the
center and its half-differences: ``L(u) = center + half . u``. In those coordinates the design matrix of a cell
without blocked samples is the same for all cells, so its pseudo-inverse is computed once.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Bool, Float

from plr_jax._box import Box
from plr_jax._types import DistanceFn, Points
from plr_jax.plr._cells import Cells

WeightFn = Callable[[Points], Float[np.ndarray, "n"]]

# Ridge on the slope, relative to the number of samples: small enough to leave a determined fit as it is (relative
# change below 1e-8), large enough that a direction in which no sample varies gets slope zero.
_RIDGE = 1e-9


@dataclass(frozen=True, eq=False)
class CellFit:
    """Samples of a batch of cells and the plane fitted to each.

    Attributes:
        cells: The cells.
        u: Local coordinates of the samples, the same in every cell; the first is the center.
        reachable: Which samples reach the goal.
        weight: Weight of each sample; 0 where the goal cannot be reached.
        center: Value of the plane at the cell's center; ``inf`` for a cell without a reachable sample.
        half: Half-difference of the plane along each axis of the cell.
        residual: Sampled distance minus plane; 0 where the goal cannot be reached.
    """

    cells: Cells
    u: Float[np.ndarray, "k dim"]
    reachable: Bool[np.ndarray, "cells k"]
    weight: Float[np.ndarray, "cells k"]
    center: Float[np.ndarray, "cells"]
    half: Float[np.ndarray, "cells dim"]
    residual: Float[np.ndarray, "cells k"]


def sample_pattern(dim: int, num_samples: int, margin: int | float, seed: int) -> Float[np.ndarray, "k dim"]:
    """Local coordinates of a cell's samples: its center, its corners, then a scrambled Sobol sequence.

    A distance bends most against its plane at a cell's corners, so they are sampled wherever they are few.

    Args:
        dim: Number of axes.
        num_samples: Number of samples; at least ``dim + 1``.
        margin: How far samples reach beyond the cell, as a fraction of its width.
        seed: Seed of the scrambling.

    Returns:
        Coordinates in ``[-1 - 2 margin, 1 + 2 margin]``.
    """
    from scipy.stats import qmc  # half a second of import that a query does not need

    center = np.zeros((1, dim))
    corners = np.array(list(product((-1.0, 1.0), repeat=dim)) if 4 * 2**dim <= num_samples else []).reshape(-1, dim)
    rest = num_samples - 1 - len(corners)
    sobol = qmc.Sobol(dim, rng=np.random.default_rng(seed)).random_base2(max(rest - 1, 0).bit_length())[:rest]
    return np.concatenate([center, corners, 2 * sobol - 1]) * (1 + 2 * margin)


def fit_cells(
    cells: Cells,
    domain: Box,
    distance_fn: DistanceFn,
    weight_fn: WeightFn | None,
    u: Float[np.ndarray, "k dim"],
) -> CellFit:
    """Sample the distance in every cell and fit its plane (Section III-A of the paper)."""
    x = cells.points(u, domain).reshape(-1, cells.dim)
    distance = _call_oracle(distance_fn, x).reshape(len(cells), len(u))
    reachable = np.isfinite(distance)
    weight = reachable.astype(np.float64)
    if weight_fn is not None:
        weight *= _call_weights(weight_fn, x).reshape(weight.shape)
    value = np.where(reachable, distance, 0.0)
    # A cell to which no weight is given still gets the plane of its samples.
    center, half = compute_coefficients(u, value, np.where(weight.any(axis=1)[:, None], weight, reachable))
    residual = np.where(reachable, value - (center[:, None] + half @ u.T), 0.0)
    blocked = ~reachable.any(axis=1)
    return CellFit(cells, u, reachable, weight, np.where(blocked, np.inf, center), half, residual)


def compute_coefficients(
    u: Float[np.ndarray, "k dim"], value: Float[np.ndarray, "cells k"], weight: Float[np.ndarray, "cells k"]
) -> tuple[Float[np.ndarray, "cells"], Float[np.ndarray, "cells dim"]]:
    """Weighted least-squares plane of every cell.

    Where the samples of positive weight do not determine the plane, the slope of least norm is taken: one
    sample gives its value with slope zero, none gives zero.

    Returns:
        The value at the center ``(cells,)`` and the half-differences ``(cells, dim)``.
    """
    design = np.concatenate([np.ones((len(u), 1)), u], axis=1)
    full = (weight == 1).all(axis=1)
    plane = np.empty((len(value), design.shape[1]))
    plane[full] = value[full] @ np.linalg.pinv(design).T
    plane[~full] = _solve_normal_equations(design, value[~full], weight[~full])
    return plane[:, 0], plane[:, 1:]


def _solve_normal_equations(
    design: Float[np.ndarray, "k terms"],
    value: Float[np.ndarray, "cells k"],
    weight: Float[np.ndarray, "cells k"],
) -> Float[np.ndarray, "cells terms"]:
    k, terms = design.shape
    products = (design[:, :, None] * design[:, None, :]).reshape(k, terms * terms)
    normal = (weight @ products).reshape(-1, terms, terms)
    total = normal[:, 0, 0]
    ridge = np.where(total > 0, _RIDGE * total, 1.0)
    normal[:, range(1, terms), range(1, terms)] += ridge[:, None]
    normal[:, 0, 0] += total == 0
    return np.linalg.solve(normal, ((weight * value) @ design)[..., None])[..., 0]


def sum_of_squares_after_split(fit: CellFit) -> Float[np.ndarray, "cells dim"]:
    """Sum of squared errors of a cell's samples if its halves along each axis were fitted apart.

    A least-squares problem over the residuals of the cell's own plane, which lies in the span of both halves.
    """
    squares = np.zeros(fit.half.shape)
    for axis in range(fit.u.shape[1]):
        for side in (fit.u[:, axis] <= 0, fit.u[:, axis] > 0):
            u, residual, weight = fit.u[side], fit.residual[:, side], fit.weight[:, side]
            center, half = compute_coefficients(u, residual, weight)
            rest = residual - (center[:, None] + half @ u.T)
            squares[:, axis] += np.sum(weight * rest * rest, axis=1)
    return squares


def _call_oracle(distance_fn: DistanceFn, x: Points) -> Float[np.ndarray, "n"]:
    distance = np.asarray(distance_fn(x), dtype=np.float64)
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
