"""What the cells of robots' cost maps cost: the bytes of ROS's ``costmap_2d``, its occupancy grids, its inflation."""

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
    inscribed_radius: float | int,
    inflation_radius: float | int,
    cost_scaling_factor: float | int,
    cost_travel_multiplier: float | int,
) -> Raster:
    """Factors, ``inf`` where blocked, with those around what is blocked as the inflation layer of Nav2 has them.

    ``pixel`` has the sides of a cell along the raster's axes.
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
    distance: Any = ndimage.distance_transform_edt(free, sampling=pixel)
    share = np.where(distance <= reach, np.exp(-scaling * np.maximum(distance - inscribed, 0.0)), 0.0)
    return np.where(distance <= inscribed, np.inf, np.maximum(factors, 1 + multiplier * share))


def with_nearest_factors(factors: Raster, pixel: Float[np.ndarray, "rank"]) -> Raster:
    """Factors with those of the nearest cell that is not blocked where they are ``inf``."""
    blocked = np.isinf(factors)
    if not blocked.any():
        return factors
    nearest: Any = ndimage.distance_transform_edt(
        blocked, sampling=pixel, return_distances=False, return_indices=True
    )
    return factors[tuple(nearest)]


def _in_range(values: ArrayLike, least: int, most: int, what: str) -> Raster:
    expected = f"numbers from {least} to {most}, {what}"
    numbers = as_numbers("values", values, expected)
    wrong = ~((numbers >= least) & (numbers <= most))
    if wrong.any():
        raise ValueError(f"values must be {expected}, got {shortened(numbers[wrong][0].item())}.")
    return numbers
