"""Distances known on a grid."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import product

import numpy as np
from jaxtyping import Float, Int

from plr_jax._arrays import as_numbers, as_points, set_fields, with_inf_for_masked
from plr_jax._types import ArrayLike, Distances, Points
from plr_jax.geometry.box import Box

_AT_ONCE = 8192  # points, of which all that is computed stays in the cache


@dataclass(frozen=True, eq=False, init=False)
class GridField:
    """Distances computed elsewhere at the cell centers of a grid, interpolated between them.

    The grid's **last** axis runs along the first coordinate of a point, and its first axis along the last one:
    ``values[row, column]`` is at ``(x, y)`` with ``x`` in that column and ``y`` in that row, row 0 at the lowest
    ``y``, as in :meth:`Box.grid`. Fields of scikit-fmm over a ``meshgrid`` are so, and arrays of xarray of dimensions
    ``("y", "x")`` that increase; give ``values[::-1]`` of a raster, whose row 0 is at the top, and ``values.T`` of a
    table ``[x, y, ...]``.

    Interpolation is multilinear between the centers of cells with a value: where some around a point have none,
    weights of the others are scaled to a sum of 1. In the outer halves of the cells at the bounds the distance is
    that of the nearest point between centers; along a periodic axis the last cells are neighbors of the first.

    Args:
        values: Distance at each center, of any dimension, at least 0; ``inf``, NaN or masked where the goal cannot
            be reached.
        bounds: The box that the cells fill, or its corners ``(lo, hi)``: of the outer cells, not of their centers.

    Attributes:
        values: As given, ``inf`` where masked or NaN; read-only.
        bounds: The box.

    Raises:
        ValueError: If the values are no numbers of at least 0, there are none, or the bounds are no box of as many
            dimensions.
    """

    values: Float[np.ndarray, "..."]
    bounds: Box

    def __init__(self, values: ArrayLike, bounds: Box | ArrayLike):
        bounds = Box.of(bounds, "The bounds")
        expected = f"distances on a grid of {bounds.dim} axes"
        numbers = np.array(as_numbers("values", with_inf_for_masked(values), expected), order="C")
        if numbers.ndim != bounds.dim or numbers.size == 0:
            raise ValueError(
                f"values must be {expected}, as the bounds have, at least one, got shape {numbers.shape}."
            )
        numbers[np.isnan(numbers)] = np.inf
        if numbers.min() < 0:
            cell = tuple(map(int, np.unravel_index(np.argmin(numbers), numbers.shape)))
            raise ValueError(
                f"values must be at least 0, got {numbers[cell]:g} at {cell}; mask what has no distance, and "
                "give np.maximum(values, 0) of a field that is negative within the goal."
            )
        numbers.flags.writeable = False
        set_fields(self, values=numbers, bounds=bounds)

    def __repr__(self) -> str:
        return f"GridField({' x '.join(map(str, self.values.shape))} cells, {self.bounds})"

    @property
    def dim(self) -> int:
        """Number of coordinates of a point."""
        return self.bounds.dim

    def __call__(self, x: ArrayLike) -> Distances:
        """Interpolated distance at each point.

        Args:
            x: Points, ``(n, dim)``.

        Returns:
            Distances, ``(n,)``; ``inf`` where the cell that holds the point has no value, outside the bounds, and for
            points with a NaN.

        Raises:
            ValueError: If ``x`` has another shape.
        """
        x = as_points("x", self.bounds.settled(x), self.dim)
        distances = np.full(len(x), np.inf)
        for begin in range(0, len(x), _AT_ONCE):
            part = x[begin : begin + _AT_ONCE]
            inside = np.flatnonzero(self.bounds.contains(part))
            distances[begin + inside] = self._interpolated(part[inside])
        return distances

    def _interpolated(self, x: Points) -> Distances:
        """Distances at points of the box."""
        sizes = self.values.shape[::-1]
        places = ((self.bounds.wrapped(x) - self.bounds.lo) / self.bounds.width * sizes).T
        nearest, sides = [], []
        for place, size, is_periodic in zip(places, sizes, self.bounds.periodic, strict=True):
            nearest.append(np.minimum(place.astype(np.intp), size - 1))
            # The cells whose centers are below and above, and their weights.
            lower = np.floor(place - 0.5).astype(np.intp)
            beyond = place - 0.5 - lower
            below, above = (
                (each % size if is_periodic else np.clip(each, 0, size - 1)) for each in (lower, lower + 1)
            )
            sides.append([(below, 1 - beyond), (above, beyond)])
        total, total_weight = np.zeros(len(x)), np.zeros(len(x))
        for corner in product(*sides):
            value = self._at([cell for cell, _ in corner])
            weight = reduce(np.multiply, (weight for _, weight in corner)) * np.isfinite(value)
            total += weight * np.where(np.isfinite(value), value, 0.0)
            total_weight += weight
        # Where the nearest cell has a value, weights sum to a part of 1 at least.
        return np.divide(total, total_weight, out=np.full(len(x), np.inf), where=np.isfinite(self._at(nearest)))

    def _at(self, cell: Sequence[Int[np.ndarray, "n"]]) -> Float[np.ndarray, "n"]:
        """Values of cells, given by their number along each coordinate."""
        return self.values.take(np.ravel_multi_index(tuple(cell[::-1]), self.values.shape))
