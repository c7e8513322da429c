"""What the cells of robots' cost maps cost: the bytes of ROS's ``costmap_2d``, its occupancy grids, its inflation."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from plr_jax._arrays import as_bool, as_finite, as_numbers, shortened
from plr_jax._types import ArrayLike

# https://docs.ros.org/en/noetic/api/costmap_2d/html/cost__values_8h_source.html
_DEAREST, _INSCRIBED, _LETHAL, _UNKNOWN = 252, 253, 254, 255
# Occupancy grids in which Nav2 and ROS publish cost maps: 1 to 252 as 1 to 98.
_GRID_UNKNOWN, _GRID_DEAREST, _GRID_INSCRIBED, _GRID_LETHAL = -1, 98, 99, 100

Raster = Float[np.ndarray, "..."]


def costmap_factors(values: ArrayLike, cost_travel_multiplier: float | int, unknown_is_free: bool) -> Raster:
    """Factors of ``costmap_2d``'s costs from 0 to 255, ``inf`` where they block; ``ValueError`` if they are none."""
    multiplier = as_finite("cost_travel_multiplier", cost_travel_multiplier)
    unknown_is_free = as_bool("unknown_is_free", unknown_is_free)
    costs = _in_range(values, 0, _UNKNOWN, "costs of costmap_2d; of an OccupancyGrid use from_occupancy_grid")
    factors = 1 + multiplier * np.minimum(costs, _DEAREST) / _DEAREST
    blocked = costs >= _INSCRIBED
    return np.where(blocked & (costs < _UNKNOWN) if unknown_is_free else blocked, np.inf, factors)


def grid_costs(values: ArrayLike) -> Raster:
    """Costs of ``costmap_2d`` that an occupancy grid from -1 to 100 tells of; ``ValueError`` if it is none."""
    grid = _in_range(values, _GRID_UNKNOWN, _GRID_LETHAL, "an OccupancyGrid's values; of bytes use from_costmap")
    costs = np.interp(grid, (0, 1, _GRID_DEAREST), (0, 1, _DEAREST))
    for value, cost in ((_GRID_INSCRIBED, _INSCRIBED), (_GRID_LETHAL, _LETHAL)):
        costs[grid >= value] = cost
    costs[grid < 0] = _UNKNOWN
    return costs


def inflated_factors(
    factors: Raster,
    pixel: Float[np.ndarray, "rank"],
    periodic: Sequence[bool],
    inscribed_radius: float | int,
    inflation_radius: float | int,
    cost_scaling_factor: float | int,
    cost_travel_multiplier: float | int,
) -> Raster:
    """Factors, ``inf`` where blocked, with those around what is blocked as the inflation layer of Nav2 has them.

    ``pixel`` has the sides of a cell along the raster's axes, ``periodic`` which of these are.
    """
    inscribed = as_finite("inscribed_radius", inscribed_radius)
    reach, scaling = (
        as_finite("inflation_radius", inflation_radius),
        as_finite("cost_scaling_factor", cost_scaling_factor),
    )
    multiplier = as_finite("cost_travel_multiplier", cost_travel_multiplier)
    free = np.isfinite(factors)
    if free.all():
        return factors
    around, middle = _periods(free, periodic)
    distance: Any = ndimage.distance_transform_edt(around, sampling=pixel)
    distance = distance[middle]
    share = np.where(distance <= reach, np.exp(-scaling * np.maximum(distance - inscribed, 0.0)), 0.0)
    return np.where(distance <= inscribed, np.inf, np.maximum(factors, 1 + multiplier * share))


def with_nearest_factors(factors: Raster, pixel: Float[np.ndarray, "rank"], periodic: Sequence[bool]) -> Raster:
    """Factors with those of the nearest cell that is not blocked where they are ``inf``."""
    blocked = np.isinf(factors)
    if not blocked.any():
        return factors
    around, middle = _periods(blocked, periodic)
    nearest: Any = ndimage.distance_transform_edt(around, sampling=pixel, return_distances=False, return_indices=True)
    return factors[tuple(at[middle] % size for at, size in zip(nearest, factors.shape, strict=True))]


def _periods(cells: np.ndarray, periodic: Sequence[bool]) -> tuple[np.ndarray, tuple[slice, ...]]:
    """Three periods of cells along periodic axes, and where the middle one is."""
    sizes = [size if wraps else 0 for size, wraps in zip(cells.shape, periodic, strict=True)]
    middle = tuple(slice(before, before + size) for before, size in zip(sizes, cells.shape, strict=True))
    return np.pad(cells, [(size, size) for size in sizes], mode="wrap"), middle


def _in_range(values: ArrayLike, least: int, most: int, what: str) -> Raster:
    expected = f"numbers from {least} to {most}, {what}"
    numbers = as_numbers("values", values, expected)
    wrong = ~((numbers >= least) & (numbers <= most))
    if wrong.any():
        raise ValueError(f"values must be {expected}, got {shortened(numbers[wrong][0].item())}.")
    return numbers
