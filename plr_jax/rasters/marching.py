"""Approximate cost distances over large rasters, by fast marching (see ``eikonal/march.py``)."""

from functools import partial
from typing import Any

import numpy as np
from scipy import ndimage

from plr_jax.eikonal.march import marched
from plr_jax.geometry.graph import path_ends
from plr_jax.rasters.search import CENTER, UNITS, Cell, Nearest, Points, Raster, Sides, cells_of, mean_along, search

_LARGEST_RATIO = 1e5  # of two costs; at 1e6, scikit-fmm returns NaN
_RADIUS = 16  # cells around each source where a search for paths replaces the march
_MOST_NEAR = 1 << 21  # about the largest number of such cells


def march(cost: Raster, side: Sides, points: Points, wraps: bool) -> tuple[Raster, Nearest]:
    """Return approximate cost distances of all cells by fast marching, and the index of each cell's nearest source.

    The sources are ``points``; ``side`` is the width and height of a cell. If ``wraps``, the last column meets the
    first one. Without a path to a source, the distance is ``inf`` and the index -1.
    """
    least, most = cost.min(), cost.max(where=np.isfinite(cost), initial=0)
    if most > _LARGEST_RATIO * least:
        expected = f"costs of so large a raster must differ by a factor of at most {_LARGEST_RATIO:,.0f}"
        advice = "Reduce the largest, or make their cells barriers."
        raise ValueError(f"{expected}, got costs from {least:g} to {most:g}. {advice}")
    cost = cost / least  # scikit-fmm ignores some small costs
    is_open: Any = np.isfinite(cost)
    modes: Any = "constant", "wrap" if wraps else "constant"
    # 1. Search for paths among the cells near sources. Costs up to the least cost at the border of these cells
    #    (`level`) are right: to leave the cells and return costs more.
    is_near = np.zeros(cost.shape, bool)
    is_near[tuple(cells_of(points, side, cost.shape).T)] = True
    radius = int(np.sqrt(_MOST_NEAR / is_near.sum()) / 2)
    is_near = ndimage.maximum_filter(is_near, 2 * min(radius, _RADIUS) + 1, mode=modes) & is_open
    options: Any = {"squeeze": False, "scale": None, "relief": None}
    start, _, nearest, _ = search(np.where(is_near, cost, np.inf), side, points, wraps, **options)
    at_border = is_near & ndimage.maximum_filter(is_open & ~is_near, 3, mode=modes)
    level = float(start[at_border].min(initial=np.inf))
    # 2. March from these cells.
    distance = marched(is_open, cost, start, level, side[::-1], (False, wraps))
    # 3. Find the nearest source of each cell.
    if len(points) == 1:
        return least * distance, np.where(np.isfinite(distance), 0, -1)
    label = np.where(start <= level, nearest, -1).astype(np.int32)
    del start, nearest, is_near, at_border
    return least * distance, _reached_sources(distance, cost, label, side, wraps)


def _reached_sources(distance: Raster, cost: Raster, label: Nearest, side: Sides, wraps: bool) -> Nearest:
    """Return the index of the source that steepest descent of the distance reaches from each cell of a raster.

    ``side`` is the width and height of a cell. ``label`` is the source's index where it is known, else -1.
    """
    # 1. Find the next cell of each cell (o): of the sixteen cells around it (x), the one through which the distance
    #    is least. Try eight steps and their opposites.
    #
    #      . x . x .      For a step (i, j), `beside((0, 0), values)` are the values of all cells from which the step
    #      x x x x x      stays in the raster, and `beside((i, j), values)` those of the cells to which it leads.
    #      . x o x .
    #      x x x x x
    #      . x . x .
    #
    toward = np.arange(distance.size, dtype=np.int32 if distance.size < 2**31 else np.int64).reshape(distance.shape)
    least = np.where(label >= 0, -np.inf, np.inf)  # a cell with a known source has no next cell
    if wraps:  # the longest step has two columns
        tables = distance, cost, toward, least
        distance, cost, toward, least = (np.pad(table, ((0, 0), (2, 2)), mode="wrap") for table in tables)
    index = toward.copy()
    for i, j in ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (1, -2), (2, 1), (2, -1)):
        row, column = max(-i, 0), max(-j, 0)  # of the first cell from which the step stays in the raster

        def beside(cell: Cell, values: np.ndarray) -> np.ndarray:
            rows, columns = (n - abs(step) for n, step in zip(values.shape, (i, j), strict=True))  # noqa: B023
            return values[row + cell[0] :, column + cell[1] :][:rows, :columns]  # noqa: B023

        mean_cost = mean_along((UNITS * i, UNITS * j), CENTER, partial(beside, values=cost))
        cost_of_step = float(np.hypot(*(side[::-1] * (i, j)))) * mean_cost
        for a, b in (((0, 0), (i, j)), ((i, j), (0, 0))):
            through = beside(b, distance) + cost_of_step
            is_better = (through < beside(a, least)) & (beside(b, distance) < beside(a, distance))
            beside(a, least)[is_better] = through[is_better]
            beside(a, toward)[is_better] = beside(b, index)[is_better]
    del index, least
    # 2. Follow the next cells. They have smaller distances, so paths end: in cells with a source, or where no next
    #    cell is better.
    if wraps:
        toward = toward[:, 2:-2]
    return label.ravel()[path_ends(toward.ravel())].reshape(label.shape)
