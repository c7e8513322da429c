"""COMPUTECOEFFICIENTS for many cells at once: the plane of each cell's samples, by batched least squares.

A plane is fitted in the local coordinates ``u`` of its cell (``[-1, 1]`` along every axis), as its value at the
center and its half-differences: ``L(u) = center + half . u``. In those coordinates the design matrix of a cell
without unreachable samples is the same for all cells, so its pseudo-inverse is computed once.
"""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from jaxtyping import Float, Int

from plr_jax.plr.sampling.pattern import Pattern

# Ridge on the slope, relative to the number of samples: small enough to leave a determined fit as it is (relative
# change below 1e-8), large enough that a direction in which no sample varies gets slope zero.
_RIDGE = 1e-9

FitRule: TypeAlias = Callable[
    [Pattern, Float[np.ndarray, "cells k"], Float[np.ndarray, "cells k"]],
    tuple[Float[np.ndarray, "cells"], Float[np.ndarray, "cells dim"]],
]
"""COMPUTECOEFFICIENTS: from the pattern, the values and their weights to centers and half-differences."""


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
    masked = masked_cells(weight)
    if len(masked):
        design, weight = pattern.design, weight[masked] * pattern.weight
        plane[masked] = solve_planes(normal_matrices(design, weight), (weight * value[masked]) @ design)
    return plane[:, 0], plane[:, 1:]


def midrange(
    pattern: Pattern, value: Float[np.ndarray, "cells k"], weight: Float[np.ndarray, "cells k"]
) -> tuple[Float[np.ndarray, "cells"], Float[np.ndarray, "cells dim"]]:
    """The slope of :func:`least_squares`, at the height that makes the largest error smallest.

    Above and below the plane the samples of positive weight then err equally far. Meant for a ``tolerance``: fewer
    leaves for the same largest error, at about twice the mean error for the same leaves. Takes and returns what
    :func:`least_squares` does.
    """
    center, half = least_squares(pattern, value, weight)
    residual = value - (center[:, None] + half @ pattern.u.T)
    counts = weight > 0
    counts |= ~counts.any(axis=1, keepdims=True)
    highest = residual.max(axis=1, where=counts, initial=-np.inf)
    lowest = residual.min(axis=1, where=counts, initial=np.inf)
    return center + 0.5 * (highest + lowest), half


def masked_cells(weight: Float[np.ndarray, "cells k"]) -> Int[np.ndarray, "masked"]:
    """Cells in which not every sample has weight 1."""
    differs = weight != 1
    return np.flatnonzero(differs.any(axis=1)) if differs.any() else np.zeros(0, np.int64)


def normal_matrices(
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
