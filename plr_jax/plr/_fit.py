"""COMPUTECOEFFICIENTS for many cells at once: one oracle call, one batched least-squares fit.

A plane is fitted in the local coordinates ``u`` of its cell (``[-1, 1]`` along every axis), as its value at the
center and its half-differences: ``L(u) = center + half . u``. In those coordinates the design matrix of a cell
without unreachable samples is the same for all cells, so its pseudo-inverse is computed once.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._box import Box
from plr_jax._types import DistanceFn, Points
from plr_jax.plr._cells import Cells

WeightFn = Callable[[Points], Float[np.ndarray, "n"]]

# Ridge on the slope, relative to the number of samples: small enough to leave a determined fit as it is (relative
# change below 1e-8), large enough that a direction in which no sample varies gets slope zero.
_RIDGE = 1e-9
_RANK_TOLERANCE = 1e-9
_FACE_WEIGHT = 0.01


@dataclass(frozen=True, eq=False)
class Pattern:
    """Where a cell is sampled, the same in every cell.

    Attributes:
        u: Local coordinates of the samples; ``[-1, 1]`` spans the cell.
        weight: Weight of each sample in the fit.
    """

    u: Float[np.ndarray, "k dim"]
    weight: Float[np.ndarray, "k"]

    def __len__(self) -> int:
        return len(self.u)

    @cached_property
    def design(self) -> Float[np.ndarray, "k terms"]:
        """Rows ``[1 u]``: a plane's values at the samples are ``design @ [center half]``."""
        return np.concatenate([np.ones((len(self), 1)), self.u], axis=1)

    @cached_property
    def pseudo_inverse(self) -> Float[np.ndarray, "terms k"]:
        """Maps the values at all samples to the least-squares plane."""
        root = np.sqrt(self.weight)
        return np.linalg.pinv(self.design * root[:, None]) * root

    @cached_property
    def halves(self) -> list[Float[np.ndarray, "k terms_of_both"]]:
        """For each axis the designs of a plane in the lower and one in the upper half, side by side; 0 elsewhere."""
        uppers = [self.u[:, axis, None] > 0 for axis in range(self.u.shape[1])]
        return [np.concatenate([self.design * ~upper, self.design * upper], axis=1) for upper in uppers]

    @cached_property
    def halves_bases(self) -> list[Float[np.ndarray, "k terms_of_both"]]:
        """For each axis what maps the values at all samples to coordinates of the best fit by two planes.

        The coordinates belong to orthonormal functions, so the sum of their squares is the part of the values' sum
        of (weighted) squares that the planes explain.
        """
        root = np.sqrt(self.weight)[:, None]
        bases = []
        for design in self.halves:
            functions, size, _ = np.linalg.svd(design * root, full_matrices=False)
            bases.append(root * functions * (size > _RANK_TOLERANCE * size[0]))
        return bases


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


def sample_pattern(dim: int, num_samples: int, margin: int | float, seed: int) -> Pattern:
    """The center, a scrambled Sobol sequence inside the cell, its corners if they are few, and its faces.

    A third of the samples lie on the faces. They find the free slivers behind a wall and the corners at which a
    distance bends most against its plane; they check the fit more than they shape it, so their weight is small.

    Args:
        dim: Number of axes.
        num_samples: Number of samples; at least ``dim + 1``.
        margin: How far samples reach beyond the cell, as a fraction of its width.
        seed: Seed of the scrambling.

    Returns:
        A pattern with coordinates in ``[-1 - 2 margin, 1 + 2 margin]``.
    """
    rng = np.random.default_rng(seed)
    center = np.zeros((1, dim))
    corners = np.array(list(product((-1.0, 1.0), repeat=dim)) if 4 * 2**dim <= num_samples else []).reshape(-1, dim)
    faces = _sobol(dim, num_samples // 3, rng)
    face = np.arange(len(faces)) % (2 * dim)
    faces[np.arange(len(faces)), face // 2] = 2.0 * (face % 2) - 1
    inside = _sobol(dim, num_samples - 1 - len(corners) - len(faces), rng)
    u = np.concatenate([center, inside, corners, faces]) * (1 + 2 * margin)
    weight = np.repeat([1.0, _FACE_WEIGHT], [1 + len(inside), len(corners) + len(faces)])
    return Pattern(u, weight)


def _sobol(dim: int, num_points: int, rng: np.random.Generator) -> Float[np.ndarray, "n dim"]:
    from scipy.stats import qmc  # half a second of import that a query does not need

    exponent = max(num_points - 1, 0).bit_length()
    return 2 * qmc.Sobol(dim, rng=rng).random_base2(exponent)[:num_points] - 1


def fit_cells(
    cells: Cells,
    domain: Box,
    distance_fn: DistanceFn,
    weight_fn: WeightFn | None,
    pattern: Pattern,
) -> CellFit:
    """Sample the distance in every cell and fit its plane (Section III-A of the paper)."""
    x = cells.points(pattern.u, domain).reshape(-1, cells.dim)
    distance = _call_oracle(distance_fn, x).reshape(len(cells), len(pattern))
    reachable = np.isfinite(distance)
    weight = reachable.astype(np.float64)
    if weight_fn is not None:
        weight *= _call_weights(weight_fn, x).reshape(weight.shape)
    value = np.where(reachable, distance, 0.0)
    # A cell to which no weight is given still gets the plane of its samples.
    fit_weight = weight if weight_fn is None else np.where((weight > 0).any(axis=1, keepdims=True), weight, reachable)
    center, half = compute_coefficients(pattern, value, fit_weight)
    residual = value - (center[:, None] + half @ pattern.u.T)
    residual *= reachable
    center = np.where(reachable.any(axis=1), center, np.inf)
    return CellFit(cells, pattern, reachable, weight, center, half, residual)


def compute_coefficients(
    pattern: Pattern, value: Float[np.ndarray, "cells k"], weight: Float[np.ndarray, "cells k"]
) -> tuple[Float[np.ndarray, "cells"], Float[np.ndarray, "cells dim"]]:
    """Weighted least-squares plane of every cell; a sample's weight is the pattern's times ``weight``.

    Where the samples of positive weight do not determine the plane, the slope of least norm is taken: one
    sample gives its value with slope zero, none gives zero.

    Returns:
        The value at the center ``(cells,)`` and the half-differences ``(cells, dim)``.
    """
    plane = value @ pattern.pseudo_inverse.T
    masked = _masked(weight)
    if len(masked):
        design, weight = pattern.design, weight[masked] * pattern.weight
        plane[masked] = _solve(_normal_matrices(design, weight), (weight * value[masked]) @ design)
    return plane[:, 0], plane[:, 1:]


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
        explained += (projection * _solve(_normal_matrices(design, weight), projection)).sum(axis=1)
    return explained


def _masked(weight: Float[np.ndarray, "cells k"]) -> Int[np.ndarray, "masked"]:
    return np.flatnonzero((weight != 1).any(axis=1))


def _normal_matrices(
    design: Float[np.ndarray, "k terms"], weight: Float[np.ndarray, "cells k"]
) -> Float[np.ndarray, "cells terms terms"]:
    """The matrices of the normal equations of every cell."""
    k, terms = design.shape
    products = (design[:, :, None] * design[:, None, :]).reshape(k, terms * terms)
    return (weight @ products).reshape(-1, terms, terms)


def _solve(
    normal: Float[np.ndarray, "cells terms terms"], projection: Float[np.ndarray, "cells terms"]
) -> Float[np.ndarray, "cells terms"]:
    """Planes that solve the normal equations; of slope zero in directions in which no sample varies."""
    terms, total = normal.shape[-1], normal[:, 0, 0].copy()
    ridge = np.where(total > 0, _RIDGE * total, 1.0)
    normal[:, range(1, terms), range(1, terms)] += ridge[:, None]
    normal[:, 0, 0] += total == 0
    return np.linalg.solve(normal, projection[..., None])[..., 0]


def _call_oracle(distance_fn: DistanceFn, x: Points) -> Float[np.ndarray, "n"]:
    distance = distance_fn(x)
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
