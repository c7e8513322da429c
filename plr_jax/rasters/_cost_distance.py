"""Cost distance over a raster: the least accumulated cost between each cell and the nearest of given points."""

import math
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from plr_jax._arrays import as_bool, as_numbers, as_point, as_points, shortened
from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box
from plr_jax.oracles import GridField
from plr_jax.plr._construct import construct
from plr_jax.plr._plr import PLR
from plr_jax.rasters.lower_bound import ROUNDING, lower_bound
from plr_jax.rasters.marching import march
from plr_jax.rasters.mercator import march_over_degrees
from plr_jax.rasters.search import PathTree, Points, Raster, Relief, Slope, cells_of, search
from plr_jax.rasters.search_grid import SearchGrid
from plr_jax.spaces._data_arrays import data_array_box, is_data_array, is_in_degrees, opened, raster_values
from plr_jax.spaces._raster_cost import nearest_cells

# Numbers of cells for a search for paths, which takes about 4 kB for each cell that is no barrier:
_FINE_CELLS = 60_000  # smaller rasters are divided into about so many parts: 240 MB
MOST_CELLS = 1 << 21  # most cells by default: 8 GB
MOST_ON_REQUEST = 1 << 22  # most cells if the search is needed: for bounds, heights, or squeezing paths: 17 GB
_MOST_LATITUDE = 85.0  # degrees: parallels shrink to a point at the poles
_TOLERANCE = 0.01  # of coordinates of rasters, as a share of a cell
_ROUNDING = 1e-6  # of coordinates of points, as a share of a cell
_KEPT = "crs", "grid_mapping"  # attributes and encodings of a DataArray that hold for distances too


def tobler(slope: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Return the seconds that a hiker takes per horizontal meter at slopes (rise over run).

    Reference: Tobler, NCGIA report 93-1, 1993.
    """
    return 0.6 * np.exp(3.5 * np.abs(slope + 0.05))


@dataclass(frozen=True, eq=False)
class CostDistance:
    """A result of :func:`cost_distance`. Arrays have the shape of the raster; they are DataArrays if ``costs`` was.

    Attributes:
        distance: Cost distance from the center of each cell to the nearest source; ``inf`` where no source can be
            reached.
        nearest: Index of the nearest source. The index is -1 where no source can be reached; -1 is the no-data value
            if this is a ``DataArray``. Over large rasters (fast marching), cells to which two sources are about
            equally near may have the index of the farther one. Where costs jump, that source may be much farther.
        lower: Proven lower bound of the least cost at the centers of cells; None if not asked for.
        upper: Proven upper bound: ``distance``, rounded up. In our experiments, ``upper - lower`` is on average 1.5
            to 3.5 % of the mean distance. The difference may be up to 100 % of the distance near sources, and if
            costs of neighbors differ by a factor of 100 or more.
        plr: A PLR of the distance, without bounds; None if not asked for. Its values in barriers are finite. In other
            cells from which no source can be reached, its values are ``inf``, except near cells with a path to a
            source.
    """

    distance: Any
    nearest: Any
    lower: Any = None
    upper: Any = None
    plr: PLR | None = None
    _grid: SearchGrid | None = field(default=None, repr=False)
    _tree: PathTree | None = field(default=None, repr=False)

    def path(self, point: ArrayLike) -> Float[np.ndarray, "n 2"]:
        """Return the least-cost path from the cell of a point ``(x, y)`` to its nearest source.

        Returns:
            Vertices of the path, ``(n, 2)``, from the center of the cell to the source, even if ``from_sources`` was
            set. The path's cost is the ``distance`` in the cell. Along the border of two cells, the cheaper cell
            counts. With heights, the path ends at the center of the source's cell or, in a small raster whose cells
            are divided, of the source's part of the cell. In degrees, vertices are joined by straight lines of
            longitude and latitude, and a degree of longitude is as long as in the middle of the row, or row of parts;
            a path around a raster of 360 degrees has longitudes beyond the raster. If both ends are equal, there is
            one vertex; if the distance is ``inf``, as in barriers, there is none.

        Raises:
            ValueError: If the point is outside the raster, or the result has no paths because the raster has more
                than 2 million open cells (see :func:`cost_distance`).
        """
        if self._tree is None or self._grid is None:
            advice = "use max_bytes and plr_jax.descend(result.plr, plr_jax.RasterCost(...).space(), ...)"
            many = f"Over more than {MOST_CELLS:,} cells, about square"
            raise ValueError(f"{many}, distances come without paths. Follow a PLR instead: {advice}.")
        box, shape = self._grid.box, self._grid.shape
        place = _off_border(as_point("point", box.settled(point), 2), box, shape) - box.lo
        if not ((place >= 0) & (place <= box.width)).all():
            raise ValueError(f"point must lie in the raster {box}, got {shortened(point)}.")
        row, column = cells_of(place, box.width / shape[::-1], shape).tolist()
        path = self._grid.on_raster(self._tree.path(*self._grid.middle_of((row, column))))
        path[:1] = box.lo + (np.array([column, row]) + 0.5) * box.width / shape[::-1]
        return path


def cost_distance(
    costs: Any,
    sources: ArrayLike,
    *,
    cell_size: float | ArrayLike = 1.0,
    degrees: bool | None = None,
    squeeze: bool = False,
    heights: Any = None,
    slope_cost: Slope | str = "tobler",
    from_sources: bool = False,
    bounds: bool = False,
    max_bytes: int | None = None,
) -> CostDistance:
    """Compute the least accumulated cost between every cell of a raster and the nearest source.

        result = plr_jax.cost_distance(costs, [(300, 900), (1_900, 400)], cell_size=30)
        result.distance, result.nearest, result.path((500, 100))

    Distances are costs of paths. In our experiments without heights, errors are on average 0.03 to 0.2 % of the mean
    distance, and the largest error is 2.2 %. With heights, distances differ from distances on three times finer
    rasters by 0.5 % on average.

    The search for paths takes 4 kB of memory for each open cell (a cell that is no barrier). So for rasters of more
    than 2 million open cells, fast marching replaces the search, unless bounds, heights or ``squeeze`` are given.
    Fast marching takes about 140 bytes a cell, with the raster. The errors of fast marching are 0.1 to 0.3 % on
    average where costs change slowly, 0.5 to 7 % where costs jump, and more where they are random in each cell. A
    cell that is much longer than wide counts as several cells, as the search divides the cell into parts that are
    about square.

    Args:
        costs: Positive costs per unit of length, ``(rows, columns)``: an array, a masked array, an xarray
            ``DataArray`` of two dimensions, y and x, with evenly spaced coordinates, or the path of a raster file of
            one band, which needs ``pip install 'plr-jax[gis]'``. With heights, costs are factors without a unit, and
            may be a number if heights are a ``DataArray``. NaN, ``inf``, masked cells and the no-data value of a
            ``DataArray`` or a file are barriers.
        sources: Points ``(k, 2)``, rows ``(x, y)``; or a boolean mask of the raster's shape. Sources of a mask are
            numbered as by ``np.argwhere(mask)``. If ``costs`` has coordinates, points are in its coordinates. In an
            array, row 0 has the lowest y: ``costs[i, j]`` covers x from ``j`` to ``j + 1`` and y from ``i`` to
            ``i + 1``, times ``cell_size``. So pass ``costs[::-1]`` if row 0 is the north.
        cell_size: Side of a cell, or both sides ``(x, y)``; for arrays only.
        degrees: Whether coordinates are longitude and latitude in degrees. Lengths are then in meters on a sphere of
            the earth's mean radius, 6,371,008.8 m, and a raster of 360 degrees wraps around. Latitudes must be from
            -85 to 85. None: as the units of a ``DataArray``'s coordinates say or, without units, its reference
            system or, without one, the names of its dimensions.
        squeeze: Whether paths pass between two barriers that touch in a corner, as they do over 8-connected cells.
            (Through the common corner of two costly cells, such as those of a road, paths always pass, without
            entering these cells.)
        heights: Height of each cell, in the unit of length: an array, a ``DataArray`` or the path of a file, with the
            shape and the coordinates of ``costs``. With heights, costs depend on the direction of travel. Cells
            without a finite height are barriers.
        slope_cost: With heights, the factor of the cost at each slope, rise over run along the path: a function of
            arrays, or ``"tobler"``, the seconds that a hiker takes per horizontal meter.
        from_sources: With heights, whether paths lead from the sources to the cells (walking out) instead of to the
            sources (reaching help).
        bounds: Whether to prove bounds, for costs that are constant in each cell, in a plane; takes about 4 seconds
            of CPU time for 160,000 cells.
        max_bytes: If given, the result has a PLR of at most this many bytes.

    Raises:
        ValueError: If costs or heights are not rasters as described above. If lengths or costs are too large or too
            small for 64-bit numbers (the message states limits). If there is no source, or a source is outside of the
            raster or in a barrier. If an option is out of its range, or ``bounds`` comes with heights or degrees. If
            bounds, heights or ``squeeze`` come with more than 4 million open cells, or parts of long cells. If fast
            marching is used and costs differ by more than a factor of 100,000.
        FileNotFoundError: If there is no file at a path.
        ImportError: If a path is given, and rioxarray is missing.
    """
    # 1. The raster with the lowest coordinates first, its heights, and the sources in it.
    costs, heights = opened("costs", costs), opened("heights", heights)
    if is_data_array(heights) and not is_data_array(costs):
        if np.shape(costs) not in ((), heights.shape):
            expected = f"a number, or have the shape {heights.shape} of heights"
            raise ValueError(f"costs must be {expected}, got shape {np.shape(costs)}.")
        costs = _on_raster(heights, np.broadcast_to(np.ma.filled(costs, np.nan), heights.shape))
    cost, box, flips = _raster(costs, cell_size)
    box, in_degrees = _box_on_sphere(costs, box, cost.shape, degrees)
    if heights is not None:
        height = raster_values("heights", heights)
        if height.shape != cost.shape:
            raise ValueError(f"heights must have shape {cost.shape}, like costs, got {height.shape}.")
        _require_aligned("heights", heights, costs)
        height = height[flips]
        cost = np.where(np.isfinite(height), cost, np.inf)
    points = _as_sources(sources, costs, cost, box, flips)
    # 2. The grid for a search for paths or, over many cells, for a march; and the heights in the grid.
    squeeze = as_bool("squeeze", squeeze)
    if as_bool("bounds", bounds) and in_degrees:
        raise ValueError("Costs in degrees have no proven bounds, which need a plane: project the raster.")
    needs_paths = heights is not None or bounds or squeeze
    grid = SearchGrid.of(box, cost.shape, in_degrees, _FINE_CELLS)
    num_cells = int(np.isfinite(cost).sum()) * math.prod(grid.parts)
    if needs_paths and num_cells > MOST_ON_REQUEST:
        most = f"at most {MOST_ON_REQUEST:,} open cells, or parts of cells about as wide as high"
        got = f"{num_cells:,}: use larger or squarer cells"
        raise ValueError(f"With heights, bounds or squeeze, the raster must have {most}, got {got}.")
    relief = None
    slope_fn: Any = tobler if isinstance(slope_cost, str) and slope_cost == "tobler" else slope_cost
    if heights is not None:
        if not callable(slope_fn) or bounds:
            got = "bounds=True" if bounds else f"slope_cost={shortened(slope_cost)}"
            raise ValueError(f'With heights, slope_cost must be "tobler" or a function, without bounds, got {got}.')
        directed: Any = (lambda slope: slope_fn(-slope)) if as_bool("from_sources", from_sources) else slope_fn
        # Barriers get the height of the nearest cell.
        nearest_known = nearest_cells(np.isfinite(height), (box.width / cost.shape[::-1])[::-1])
        relief = Relief(grid.interpolated(height[nearest_known]), directed)
    # 3. Distances, nearest sources and bounds at the centers of cells.
    tree = None
    if num_cells <= MOST_CELLS or needs_paths:
        fine, places = grid.divided(cost), grid.in_plane(points)
        options: Any = {"wraps": box.periodic[0], "squeeze": squeeze, "scale": grid.scale, "relief": relief}
        distance, at_corners, nearest, tree = search(fine, grid.side, places, **options)
        results = [distance, nearest]
        if bounds:
            results += [lower_bound(fine, grid.side, places, distance, at_corners), distance * (1 + ROUNDING)]
        results = [grid.at_centers(table) for table in results]
    elif in_degrees:
        results = list(march_over_degrees(cost, box, points))
    else:
        results = list(march(cost, box.width / cost.shape[::-1], points - box.lo, wraps=False))
    plr = None
    if max_bytes is not None:
        plr = construct(GridField(results[0], box, np.isfinite(cost)), box, leaf="continuous", max_bytes=max_bytes)

    # 4. Results in the order and with the coordinates of the given raster: `flips` applied again.
    results[1] = results[1].astype(np.int32)  # older GIS read no GeoTIFF of 64-bit integers
    tables: list[Any] = [table[flips] for table in results]
    if is_data_array(costs):
        for k, name in enumerate(("distance", "nearest", "lower", "upper")[: len(tables)]):
            tables[k] = _on_raster(costs, tables[k]).rename(name)
        tables[1].attrs["_FillValue"] = -1  # files then know that -1 is no nearest source
    return CostDistance(*tables, plr=plr, _grid=grid, _tree=tree)


def _on_raster(raster: Any, values: np.ndarray) -> Any:
    """Return a DataArray of values with the coordinates and the reference system of ``raster``."""
    result = raster.copy(data=values)
    kept = ({key: table[key] for key in _KEPT if key in table} for table in (raster.attrs, raster.encoding))
    result.attrs, result.encoding = kept
    return result


def _box_on_sphere(costs: Any, box: Box, shape: tuple[int, int], degrees: bool | None) -> tuple[Box, bool]:
    """Return the raster's box, periodic along x if it spans 360 degrees, and whether the raster is in degrees."""
    if degrees is None:
        degrees = is_data_array(costs) and is_in_degrees(costs)
    if not as_bool("degrees", degrees):
        return box, False
    if not is_data_array(costs):
        needed = "a DataArray, whose coordinates are longitude and latitude"
        raise ValueError(f"degrees=True needs {needed}, got an array.")
    tolerance = _TOLERANCE * box.width / shape[::-1]
    if box.width[0] > 360 + tolerance[0]:
        raise ValueError(f"Longitudes must span at most 360 degrees, got {box.width[0]:g}: leave out columns.")
    if (np.abs([box.lo[1], box.hi[1]]) > _MOST_LATITUDE + tolerance[1]).any():
        rows = f"rows between latitudes -{_MOST_LATITUDE:g} and {_MOST_LATITUDE:g} degrees"
        got = f"{box.lo[1]:g} to {box.hi[1]:g}"
        raise ValueError(f"A raster in degrees must have {rows}, got {got}: crop it, for example by costs.sel.")
    if box.width[0] > 360 - tolerance[0]:
        box = Box(box.lo, (box.lo[0] + 360.0, box.hi[1]), (True, False))
    return box, True


def _require_aligned(name: str, raster: Any, costs: Any) -> None:
    # If both are a DataArray, they must have equal dimensions, coordinates and, if known, EPSG codes.
    if is_data_array(raster) and is_data_array(costs):
        is_aligned = raster.dims == costs.dims and raster.shape == costs.shape
        for axis in costs.dims if is_aligned else ():
            ours, given = (np.asarray(each[axis].values, float) for each in (costs, raster))
            tolerance = _TOLERANCE * np.abs(ours[-1] - ours[0]) / max(len(ours) - 1, 1)
            is_aligned &= bool((np.abs(ours - given) <= tolerance).all())
        with suppress(Exception):  # rioxarray may not be imported, or a reference system is not known
            is_aligned &= len({each.rio.crs.to_epsg() for each in (costs, raster)} - {None}) < 2
        if not is_aligned:
            expected = f"the dimensions {costs.dims}, coordinates and reference system of costs, got other ones"
            advice = "use reindex_like(costs), interp_like(costs) or rio.reproject_match(costs)"
            raise ValueError(f"{name} must have {expected}: {advice}.")


def _raster(costs: Any, cell_size: float | ArrayLike) -> tuple[Raster, Box, tuple[slice, slice]]:
    """Check ``costs``, and return them in the order of ascending coordinates; the raster's box; and ``flips``.

    Barriers have the cost ``inf``. ``flips`` are one slice per axis, which reverses the axis if its coordinates
    descend: applied once, they sort the cells; applied twice, they restore the given order.
    """
    # 1. Check the shape of costs, and the size of cells.
    cost = raster_values("costs", costs)
    if cost.ndim != 2 or cost.size == 0:
        advice = 'For one band of several, use costs.squeeze("band") or costs[0].'
        raise ValueError(f"costs must have shape (rows, columns), got {cost.shape}. {advice}")
    size = as_numbers("cell_size", cell_size, "one or two positive numbers")
    if size.shape not in ((), (2,)) or not (np.isfinite(size) & (size > 0)).all():
        raise ValueError(f"cell_size must be one or two positive numbers, got {shortened(cell_size)}.")
    box = Box(np.zeros(2), size * cost.shape[::-1])
    flips = slice(None), slice(None)
    if is_data_array(costs):
        if (size != 1).any():
            raise ValueError(f"cell_size is for arrays, and this DataArray has coordinates, got {cell_size}.")
        box, flips = data_array_box("costs", costs)
    # 2. Check the values.
    cost = cost[flips]
    if (wrong := np.argwhere(cost <= 0)).size:
        got = f"{cost[tuple(wrong[0])]:g} in {len(wrong)} cells"
        raise ValueError(f"costs must be positive, got {got}. Use a small cost for free passage, NaN for barriers.")
    # Products and squares of costs and lengths must neither overflow nor vanish. The cheapest motion across a cell
    # costs `low * cell`; along the longer side of the raster, a motion costs up to `high * width`.
    cell, width = float((box.width / cost.shape[::-1]).min()), float(box.width.max())
    low, high = float(cost.min()), float(cost.max(where=np.isfinite(cost), initial=0.0))
    fits = min(low, low * cell) >= 1e-290 and max(high, high * width) <= min(1e290, 1e140 * low * cell)
    if not (fits and cell >= 1e-140 and width <= 1e140):
        ranges = "1e-140 to 1e140; costs, also times lengths, from 1e-290 to 1e290 and at most 1e140 apart"
        got = f"costs {low:g} to {high:g}, lengths {cell:g} to {width:g}"
        raise ValueError(f"Lengths must be from {ranges}: got {got}. Use other units.")
    return cost, box, flips


def _off_border(points: Float[np.ndarray, "*k 2"], box: Box, shape: tuple[int, int]) -> Float[np.ndarray, "*k 2"]:
    # Points that rounding put outside of the raster lie on its border.
    points = box.wrapped(points)
    inside = np.clip(points, box.lo, box.hi)
    return np.where(np.abs(points - inside) <= _ROUNDING * box.width / shape[::-1], inside, points)


def _as_sources(sources: ArrayLike, costs: Any, cost: Raster, box: Box, flips: tuple[slice, slice]) -> Points:
    """Check the sources, which are points or a mask, and return points ``(k, 2)``.

    ``cost``, ``box`` and ``flips`` are the results of :func:`_raster` for the raster ``costs``.
    """
    # 1. Points: the centers of the mask's cells, in the order of the given raster; or points as given.
    side = box.width / cost.shape[::-1]

    def cells(x: Points) -> tuple[Any, ...]:
        return tuple(cells_of(np.clip(x - box.lo, 0, box.width), side, cost.shape).T)

    if np.dtype(getattr(sources, "dtype", float)).kind == "b":
        _require_aligned("A mask of sources", sources, costs)
        if np.shape(sources) != cost.shape:
            raise ValueError(f"A mask of sources must have the raster's shape {cost.shape}, got {np.shape(sources)}.")
        indices = zip(cost.shape, flips, np.nonzero(np.ma.filled(sources, False)), strict=True)
        row, column = (np.arange(count)[flip][index] for count, flip, index in indices)
        points = box.lo + (np.stack([column, row], axis=1) + 0.5) * side
    elif np.shape(sources) == cost.shape and cost.shape[1] != 2:
        raise ValueError("A mask of sources must be boolean, got numbers of the raster's shape: use sources != 0.")
    else:
        # Sources in 32 bits that rounding put outside of the raster or into a barrier move back.
        def is_open(x: Points) -> Bool[np.ndarray, " n"]:
            return box.contains(x) & np.isfinite(cost[cells(x)])

        points = _off_border(as_points("sources", box.settled(sources, is_open), 2), box, cost.shape)
    if not len(points):
        raise ValueError("sources must have at least one source, got none.")

    # 2. All points must lie in cells of the raster that are no barriers.
    def first(wrong: Bool[np.ndarray, " k"]) -> str:
        row = int(np.argmax(wrong))
        return f"source {row} at {points[row].tolist()}, one of {wrong.sum()}"

    is_outside: Any = ~box.contains(points)
    if is_outside.any():
        raise ValueError(f"sources must lie in the raster {box}, rows (x, y), got {first(is_outside)}.")
    is_barred: Any = ~np.isfinite(cost[cells(points)])
    if is_barred.any():
        advice = "A mask of sources needs & np.isfinite(costs), with costs read by mask_and_scale=True."
        raise ValueError(f"sources must not lie in barriers, got {first(is_barred)}: move it. {advice}")
    return points
