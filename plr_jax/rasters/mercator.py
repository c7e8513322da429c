"""Conversion of rasters in degrees to grids on Mercator's map, over which fast marching is possible.

On Mercator's map of the sphere, a small motion in any direction is longer by the factor 1 / cos(latitude) than on the
sphere. So the cost per meter of the map, the cost per meter of the sphere times cos(latitude), is equal in all
directions, as fast marching requires::

    raster, in degrees        Mercator's map

    +-----+-----+             +-----+-----+     Rows of the raster are taller on the map, the farther they are from
    |     |     |             |  o  |  o  |     the equator. Rows of the grid (o) are equally tall. Each row has the
    +-----+-----+             |  o  |  o  |     costs of the raster's row in which its middle lies, and no row of the
    |     |     |             +-----+-----+     raster is left out.
    +-----+-----+             |  o  |  o  |
                              +-----+-----+

Reference: Snyder, "Map projections: a working manual", 1987, chapter 7.
"""

from typing import Any

import numpy as np

from plr_jax.geometry.box import Box
from plr_jax.rasters.marching import march
from plr_jax.rasters.search import Nearest, Points, Raster, cells_of
from plr_jax.rasters.search_grid import EARTH_RADIUS

_EXACT = 1e-6  # tolerance of places on the map, in rows of the grid


def march_over_degrees(cost: Raster, box: Box, points: Points) -> tuple[Raster, Nearest]:
    """Return what :func:`march` returns, for a raster in degrees that fills a ``box``.

    ``cost`` is per meter of the sphere, in rows of ascending latitude; ``points`` are longitudes and latitudes. The
    raster wraps around if the box is periodic.
    """
    # 1. Rows of the grid: the smallest number of equal rows on the map that leaves out no row of the raster.
    rows, columns = cost.shape
    latitude = box.lo[1] + np.arange(2 * rows + 1) / (2 * rows) * box.width[1]
    borders, middles = (_mercator(latitude[first::2]) - _mercator(box.lo[1]) for first in (0, 1))
    num_rows = int(np.ceil(borders[-1] / np.diff(borders).min() * (1 - _EXACT)))
    side = np.array([EARTH_RADIUS * np.radians(box.width[0]) / columns, borders[-1] / num_rows])
    center = (np.arange(num_rows) + 0.5) * side[1]
    row_of = np.clip(np.searchsorted(borders, center) - 1, 0, rows - 1)
    on_map = cost[row_of] / np.cosh((center + _mercator(box.lo[1])) / EARTH_RADIUS)[:, None]
    # 2. Rows of the grid do not end where rows of the raster do. A source that is in a barrier of the grid moves to
    #    the nearest row of its cell.
    points = box.wrapped(points)
    x = EARTH_RADIUS * np.radians(points[:, 0] - box.lo[0])
    y = _mercator(points[:, 1]) - _mercator(box.lo[1])
    row = cells_of(points - box.lo, box.width / (columns, rows), cost.shape)[:, 0]
    first, last = (np.searchsorted(row_of, row, where) for where in ("left", "right"))
    is_in_barrier = np.isinf(on_map[tuple(cells_of(np.stack([x, y], axis=1), side, on_map.shape).T)])
    moved = np.clip(y, (first + _EXACT) * side[1], (last - _EXACT) * side[1])
    places = np.stack([x, np.where(is_in_barrier, moved, y)], axis=1)
    distance, nearest = march(on_map, side, places, box.periodic[0])
    # 3. The middle of each row of the raster lies `above` the center of the grid's row `middle_row`, in rows. Its
    #    distance is linear between this row (`here`) and the next (`there`). Where paths from these two rows lead in
    #    opposite directions, the distance has a peak (^) between them, where two continued lines meet:
    #
    #              ^
    #            /   \
    #       here       there
    #     before           after
    #
    place = middles / side[1] - 0.5
    middle_row = np.clip(np.rint(place).astype(int), 0, num_rows - 1)
    middle_row += np.sign(np.arange(rows) - row_of[middle_row])  # if it belongs to another row of the raster
    above = np.where(np.abs(place - middle_row) < _EXACT, 0.0, place - middle_row)
    toward, share = np.sign(above).astype(int), np.abs(above)[:, None]
    before, here, there, after = (distance[np.clip(middle_row + k * toward, 0, num_rows - 1)] for k in (-1, 0, 1, 2))
    with np.errstate(invalid="ignore"):  # differences of infinite numbers, which comparisons ignore
        between = here + share * (there - here)
        continued = np.minimum(here + share * (here - before), there + (1 - share) * (there - after))
        middle = np.fmax(between, continued)
    return np.where(np.isfinite(middle) & np.isfinite(here), middle, here), nearest[middle_row]


def _mercator(latitude: Any) -> Any:
    return EARTH_RADIUS * np.arcsinh(np.tan(np.radians(latitude)))
