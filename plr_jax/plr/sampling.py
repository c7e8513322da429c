"""Sampling the distance function in cells, and fitting a plane to each cell."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import product
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import as_distances, as_numbers, as_values, row_products
from plr_jax._types import DistanceFn, Distances, Points
from plr_jax.geometry.box import Box
from plr_jax.geometry.convex_pieces import areas
from plr_jax.plr.cell_memory import CellMemory
from plr_jax.plr.folding import Folding
from plr_jax.plr.tree import Cells, Rows

# Where a cell is sampled, the same in every cell, and what of a fit depends on that alone.


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
    def reaches_beyond(self) -> bool:
        """Whether some samples are outside their cell."""
        return bool((np.abs(self.u) > 1).any())

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


@lru_cache(maxsize=8)
def sample_pattern(dim: int, num_samples: int, margin: int | float, seed: int) -> Pattern:
    """The center, a scrambled Sobol sequence inside the cell, its corners if they are few, and its faces.

    A third of the samples lie on the faces. They find the free slivers behind a wall and the corners at which a
    distance bends most against its plane; they check the fit more than they shape it, so their weight is small.
    There must be ``dim + 1`` or more; their coordinates are in ``[-1 - 2 margin, 1 + 2 margin]``.
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


# Direction numbers of Joe and Kuo for the first axes: degree and inner coefficients of a primitive polynomial, then
# the initial numbers. SciPy has them for 21,201 axes, but takes 0.35 s to import.
_DIRECTIONS = ((0, 0, ()), (1, 0, (1,)), (2, 1, (1, 3)), (3, 1, (1, 3, 1)), (3, 2, (1, 1, 1)), (4, 1, (1, 1, 3, 3)))
_SOBOL_BITS = 30


def _sobol(dim: int, num_points: int, rng: np.random.Generator) -> Float[np.ndarray, "n dim"]:
    """Return a Sobol sequence in ``[-1, 1]``, scrambled as by ``scipy.stats.qmc.Sobol``, to the bit.

    References:
        Matousek, "On the L2-discrepancy for anchored boxes", 1998, for the scrambling.
    """
    if dim > len(_DIRECTIONS):
        from scipy.stats import qmc

        return 2 * qmc.Sobol(dim, rng=rng).random_base2(max(num_points - 1, 0).bit_length())[:num_points] - 1
    place, rng = np.arange(_SOBOL_BITS)[::-1], rng.spawn(1)[0]
    numbers = np.ones((dim, _SOBOL_BITS), np.int64)
    for row, (degree, inner, first) in zip(numbers, _DIRECTIONS, strict=False):
        row[:degree] = first
        for k in range(degree, _SOBOL_BITS * (degree > 0)):
            row[k] = row[k - degree] ^ (row[k - degree] << degree)
            for i in range(1, degree):
                row[k] ^= (inner >> (degree - 1 - i) & 1) * (row[k - i] << i)
    bits = (numbers << place)[:, :, None] >> place & 1
    shift = rng.integers(2, size=(dim, _SOBOL_BITS)) @ (1 << place[::-1])
    lower = np.tril(rng.integers(2, size=(dim, _SOBOL_BITS, _SOBOL_BITS)), -1) + np.eye(_SOBOL_BITS, dtype=np.int64)
    scrambled = bits @ lower.transpose(0, 2, 1) % 2 @ (1 << place)
    gray = np.arange(num_points) ^ (np.arange(num_points) >> 1)
    chosen = np.where((gray[:, None] >> place[::-1] & 1)[:, None] == 1, scrambled, 0)
    return 2 * (np.bitwise_xor.reduce(chosen, axis=2) ^ shift) * 2.0**-_SOBOL_BITS - 1


# COMPUTECOEFFICIENTS for many cells at once: the plane of each cell's samples, by batched least squares.
#
# A plane is fitted in the local coordinates ``u`` of its cell (``[-1, 1]`` along every axis), as its value at the
# center and its half-differences: ``L(u) = center + half . u``. In those coordinates the design matrix of a cell
# without unreachable samples is the same for all cells, so its pseudo-inverse is computed once.


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
    plane = row_products(value, pattern.pseudo_inverse.T)
    masked = masked_cells(weight)
    if len(masked):
        design, weight = pattern.design, weight[masked] * pattern.weight
        plane[masked] = solve_planes(normal_matrices(design, weight), row_products(weight * value[masked], design))
    return plane[:, 0], plane[:, 1:]


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
    return row_products(weight, products).reshape(-1, terms, terms)


def solve_planes(
    normal: Float[np.ndarray, "cells terms terms"], projection: Float[np.ndarray, "cells terms"]
) -> Float[np.ndarray, "cells terms"]:
    """Planes that solve the normal equations; of slope zero in directions in which no sample varies."""
    terms, total = normal.shape[-1], normal[:, 0, 0].copy()
    ridge = np.where(total > 0, _RIDGE * total, 1.0)
    normal[:, range(1, terms), range(1, terms)] += ridge[:, None]
    normal[:, 0, 0] += total == 0
    return np.linalg.solve(normal, projection[..., None])[..., 0]


_FEW_A_TERM = 2  # reachable samples a coefficient of a plane

WeightFn = Callable[[Points], Float[np.ndarray, "n"]]


@dataclass(frozen=True, eq=False)
class CellFit(Rows):
    """Samples of a batch of cells and the plane fitted to each.

    Attributes:
        cells: The cells.
        pattern: Where they were sampled; the first sample is the center.
        max_axis_depth: How often a cell may be halved along one axis.
        reachable: Which samples reach the goal.
        weight: Weight that the caller gives each sample; 0 where the goal cannot be reached.
        value: Sampled distance; 0 where the goal cannot be reached.
        center: Value of the plane at the cell's center; ``inf`` for a cell without a reachable sample.
        half: Half-difference of the plane along each axis of the cell.
        residual: Sampled distance minus the cell's function, which is the plane unless a leaf model fits another one;
            0 where the goal cannot be reached.
    """

    cells: Cells
    pattern: Pattern
    max_axis_depth: int
    reachable: Bool[np.ndarray, "cells k"]
    weight: Float[np.ndarray, "cells k"]
    value: Float[np.ndarray, "cells k"]
    center: Float[np.ndarray, "cells"]
    half: Float[np.ndarray, "cells dim"]
    residual: Float[np.ndarray, "cells k"]

    def __len__(self) -> int:
        return len(self.cells)

    @cached_property
    def masked(self) -> Int[np.ndarray, "masked"]:
        """Cells in which not every sample has weight 1."""
        return masked_cells(self.weight)

    @property
    def is_hardly_seen(self) -> Bool[np.ndarray, "cells"]:
        """Cells whose free part the samples hardly met, or missed.

        A plane passes through a few samples, or there is none, and no error shows.
        """
        return self.reachable.sum(axis=1) <= _FEW_A_TERM * (1 + self.cells.dim)

    @property
    def can_split(self) -> Bool[np.ndarray, "cells"]:
        """Which cells may still be halved along some axis."""
        return np.any(self.cells.depth < self.max_axis_depth, axis=1)

    @property
    def noise(self) -> Float[np.ndarray, "cells"]:
        """Errors too small for a split to mend: below the resolution of 32-bit floats, weighted as errors are."""
        return np.finfo(np.float32).eps * np.abs(self.value).max(axis=1) * self.weight.max(axis=1)


@dataclass(frozen=True, eq=False)
class Sampler:
    """How cells are sampled and fitted: what stays the same throughout a construction.

    Cells of which too little was seen are sampled again with the dense pattern. Where there is a ``memory``, as of
    distance functions that answer for whole cells, it answers for samples inside them.
    """

    distance_fn: DistanceFn
    domain: Box
    weight_fn: WeightFn | None
    pattern: Pattern
    dense_pattern: Pattern
    max_axis_depth: int
    compute_coefficients: FitRule = least_squares
    memory: CellMemory | None = None

    def __call__(self, cells: Cells) -> CellFit:
        """Sample the distance in every cell and fit its plane (Section III-A of the paper)."""
        pattern = self.pattern
        points = cells.points(pattern.u, self.domain)
        if pattern.reaches_beyond:
            points = self.domain.wrapped(points)
        x = points.reshape(-1, cells.dim)
        if self.memory is None or pattern.reaches_beyond:
            distance = call_oracle(self.distance_fn, x).reshape(len(cells), len(pattern))
        else:
            distance = self.memory.distances(cells, points)
        reachable = np.isfinite(distance)
        weight = reachable.astype(np.float64)
        if self.weight_fn is not None:
            weight *= call_weights(self.weight_fn, x).reshape(weight.shape)
        value = np.where(reachable, distance, 0.0)
        weight_of_fit = weight if self.weight_fn is None else weights_of_fit(reachable, weight)
        center, half = self.compute_coefficients(pattern, value, weight_of_fit)
        _check_planes(center, half, cells)
        residual = value - (center[:, None] + row_products(half, pattern.u.T))
        residual *= reachable
        center = np.where(reachable.any(axis=1), center, np.inf)
        return CellFit(cells, pattern, self.max_axis_depth, reachable, weight, value, center, half, residual)

    def densely(self, cells: Cells) -> CellFit:
        """Sample cells again with many more points: those that :attr:`CellFit.is_hardly_seen`."""
        return replace(self, pattern=self.dense_pattern)(cells)

    def root(self, pieces_suffice: bool = False) -> CellFit:
        """The whole domain as one cell.

        Raises ``ValueError`` if no sample reaches the goal, and no free piece either if these suffice.
        """
        fit = self(Cells.root(self.domain.dim))
        has_pieces = pieces_suffice and self.memory is not None and len(self.memory.sources(fit.cells).cell) > 0
        if not (fit.reachable.any() or has_pieces):
            raise ValueError(
                "distance_fn found nothing reachable: it returned inf at every sample of the domain. Check that the "
                "goal lies in free space and that the domain is the part of the world it is in; if free space is a "
                "tiny part of the domain, raise num_samples."
            )
        return fit


def with_unseen_planes(fit: CellFit, sampler: Sampler) -> CellFit:
    """With planes for cells whose free pieces no sample met: tangents at the center of the largest."""
    unseen = np.flatnonzero(~fit.reachable.any(axis=1))
    if sampler.memory is None or not len(unseen):
        return fit
    visible = sampler.memory.sources(fit.cells[unseen])
    order = np.lexsort((-areas(visible.pieces), visible.cell))
    first = order[np.append(True, np.diff(visible.cell[order]) > 0)[: len(order)]]
    cell, middle = unseen[visible.cell[first]], visible.center[first]
    toward = middle - visible.sources.points[visible.best[first]]
    length = np.linalg.norm(toward, axis=1, keepdims=True)
    slope = np.divide(toward, length, out=np.zeros_like(toward), where=length > 0)
    lo, hi = (corner[cell] for corner in fit.cells.boxes(sampler.domain))
    center, half = fit.center.copy(), fit.half.copy()
    center[cell] = visible.distance[first] + (slope * ((lo + hi) / 2 - middle)).sum(axis=1)
    half[cell] = slope * (hi - lo) / 2
    return replace(fit, center=center, half=half)


def call_oracle(distance_fn: DistanceFn, x: Points) -> Distances:
    """Distances at points, checked; a masked entry is one that cannot be reached."""
    try:
        answer = distance_fn(x.copy())  # it may compute in place
    except Exception as error:
        error.add_note(f"distance_fn was called with points (n, dim) = {x.shape}, and must answer distances (n,).")
        raise
    return as_distances("distance_fn", answer, x)


def call_weights(weight_fn: WeightFn, x: Points) -> Float[np.ndarray, "n"]:
    """Weights at points, checked; what is masked is no weight."""
    answer = as_numbers("weight_fn's answer", weight_fn(x.copy()), f"real numbers of shape ({len(x)},)")
    weight = as_values("weight_fn", answer, len(x))
    if not np.isfinite(weight).all() or (weight < 0).any():
        raise ValueError(
            f"weight_fn must return finite weights >= 0, got values from {weight.min(initial=np.inf):g} to "
            f"{weight.max(initial=-np.inf):g}."
        )
    return weight


def weights_of_fit(
    reachable: Bool[np.ndarray, "cells k"], weight: Float[np.ndarray, "cells k"]
) -> Float[np.ndarray, "cells k"]:
    """Weights with which to fit: a cell to which no weight is given is still fitted to its samples."""
    return np.where((weight > 0).any(axis=1, keepdims=True), weight, reachable)


def _check_planes(center: Float[np.ndarray, "..."], half: Float[np.ndarray, "..."], cells: Cells) -> None:
    if np.shape(center) != (len(cells),) or np.shape(half) != (len(cells), cells.dim):
        raise ValueError(
            f"compute_coefficients must return shapes ({len(cells)},) and ({len(cells)}, {cells.dim}), a center "
            f"value and half-differences a cell, got {np.shape(center)} and {np.shape(half)}."
        )
    if any(np.ma.is_masked(part) or not np.isfinite(part).all() for part in (center, half)):
        raise ValueError("compute_coefficients must return finite planes, got NaN, infinity or masked numbers.")


def folded_weights(weight_fn: WeightFn | None, folding: Folding, z: Points) -> Float[np.ndarray, "n"]:
    """Weights of errors at folded points: the largest of all points of the domain that fold there, 0 without any.

    Without a ``weight_fn`` every point of the domain has weight 1.
    """
    largest = np.zeros(len(z))
    for x, inside in folding.images(z):
        weight = 1.0 if weight_fn is None else call_weights(weight_fn, x[inside])
        largest[inside] = np.maximum(largest[inside], weight)
        if weight_fn is None and largest.all():
            break
    return largest
