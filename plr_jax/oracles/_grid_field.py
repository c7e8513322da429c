"""Distances known on a grid."""

from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float, Int

from plr_jax._arrays import as_numbers, as_points, with_inf_for_masked
from plr_jax._types import ArrayLike, Distances
from plr_jax.geometry.box import Box


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
        vars(self).update(values=_checked_values(values, bounds.dim), bounds=bounds)

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
        x = as_points("x", x, self.dim)
        distances = np.full(len(x), np.inf)
        inside = np.flatnonzero(self.bounds.contains(x))
        shape = np.array(self.values.shape[::-1])
        place = (self.bounds.wrapped(x[inside]) - self.bounds.lo) / self.bounds.width * shape
        has_value = np.isfinite(self._at(np.minimum(place.astype(np.intp), shape - 1)))  # of a point at hi: the last
        distances[inside[has_value]] = self._interpolated(place[has_value] - 0.5)
        return distances

    def _interpolated(self, place: Float[np.ndarray, "n dim"]) -> Distances:
        """Distances at places counted in cells from the center of the first, near a cell with a value."""
        lower = np.floor(place).astype(np.intp)
        beyond, last = place - lower, np.array(self.values.shape[::-1]) - 1
        total, total_weight = np.zeros(len(place)), np.zeros(len(place))
        for corner in product((0, 1), repeat=self.dim):
            weight = np.where(corner, beyond, 1 - beyond).prod(axis=1)
            cell = lower + corner
            value = self._at(np.where(self.bounds.periodic, cell % (last + 1), np.clip(cell, 0, last)))
            weight *= np.isfinite(value)
            total += weight * np.where(np.isfinite(value), value, 0.0)
            total_weight += weight
        return total / total_weight

    def _at(self, cell: Int[np.ndarray, "n dim"]) -> Float[np.ndarray, "n"]:
        """Values of cells given along the coordinates."""
        return self.values[tuple(cell.T[::-1])]


def _checked_values(values: ArrayLike, dim: int) -> Float[np.ndarray, "..."]:
    expected = f"distances on a grid of {dim} axes"
    numbers = np.array(as_numbers("values", with_inf_for_masked(values), expected))
    if numbers.ndim != dim or numbers.size == 0:
        raise ValueError(f"values must be {expected}, as the bounds have, at least one, got shape {numbers.shape}.")
    numbers[np.isnan(numbers)] = np.inf
    if numbers.min() < 0:
        cell = tuple(map(int, np.unravel_index(np.argmin(numbers), numbers.shape)))
        raise ValueError(f"values must be at least 0, got {numbers[cell]:g} at {cell}; mask what has no distance.")
    numbers.flags.writeable = False
    return numbers
