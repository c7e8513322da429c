"""Cost distance over a raster: the least accumulated cost between each cell and the nearest source.

- If costs do not depend on the direction, scikit-fmm marches over the cells, each divided into an odd number of
  nodes along both axes. So directions hardly matter, as they do for shortest paths over 8 or 16 neighbors.
- If heights give directed costs, Dijkstra's algorithm runs over edges that are up to six cells long.

References:
    Sethian, "A fast marching level set method for monotonically advancing fronts", 1996.
    Tobler, "Three presentations on geographical analysis and modeling", 1993.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise, product
from math import gcd
from typing import Any

import numpy as np
import skfmm
from jaxtyping import Bool, Float, Int
from scipy import ndimage
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from plr_jax._arrays import as_bool, as_numbers, as_points, shortened, with_inf_for_masked
from plr_jax._types import ArrayLike
from plr_jax.eikonal.solve import solve_eikonal
from plr_jax.geometry.box import Box
from plr_jax.oracles import GridField
from plr_jax.plr._construct import construct
from plr_jax.plr._plr import PLR
from plr_jax.spaces import RasterCost

_FINE_NODES, _MOST_NODES = 1_500_000, 1 << 24  # least number of nodes; most nodes if cells are divided
_NO_DATA = "_FillValue", "nodata", "missing_value"  # attributes of a DataArray
_ATTRIBUTES_OF_COSTS = {*_NO_DATA, "units", "long_name", "standard_name"}  # do not hold for distances
_X_NAMES, _Y_NAMES = {"x", "lon", "longitude", "easting"}, {"y", "lat", "latitude", "northing"}
_DEGREES = {"lon", "longitude", "lat", "latitude"}
_MOST_STARTS = 4_000_000  # most nodes around all sources
_LARGEST_RATIO = 1e5  # of two costs; at 1e6, scikit-fmm returns NaN
_TINY = 1e-9  # distance, in steps, from a source to the front if the front is too near to lie between nodes
_BOUND_LEAVES = 20_000  # cells of the convex program that proves lower bounds
_ROUNDING = 1e-9  # relative error of the cost of a path: far more than its sums round
_REACH = 6  # most cells along each axis of an edge of a directed search
_MOST_DIRECTED = 1 << 22  # cells of a directed search, which take about 2 kB each

Raster = Float[np.ndarray, "rows columns"]
Nearest = Int[np.ndarray, "rows columns"]
Sides = Float[np.ndarray, "2"]
Points = Float[np.ndarray, "k 2"]
Slope = Callable[[Float[np.ndarray, "..."]], Float[np.ndarray, "..."]]


def tobler(slope: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Return seconds per meter of walking at slopes, rise over run, by Tobler's hiking function."""
    return 0.6 * np.exp(3.5 * np.abs(slope + 0.05))


@dataclass(frozen=True, eq=False)
class CostDistance:
    """A result of :func:`cost_distance`; arrays have the shape of the raster, and its coordinates if it has some.

    Attributes:
        distance: Cost distance to the nearest source; ``inf`` where no source can be reached.
        nearest: Number of that source, from 0; -1 where no source can be reached. It may be another source whose
            distance is at most about 1 % larger.
        lower, upper: Proven bounds of the distance at the centers of cells; None if not asked for.
        plr: The distance as a PLR over the raster's box; None if not asked for.
    """

    distance: Any
    nearest: Any
    lower: Any = None
    upper: Any = None
    plr: PLR | None = None


def cost_distance(
    costs: Any,
    sources: ArrayLike,
    *,
    cell_size: float | ArrayLike = 1.0,
    heights: ArrayLike | None = None,
    slope_cost: Slope | str = "tobler",
    from_sources: bool = False,
    bounds: bool = False,
    max_bytes: int | None = None,
) -> CostDistance:
    """Compute the least accumulated cost between every cell of a raster and the nearest source.

    ``result = plr_jax.cost_distance(costs, sources)`` has ``result.distance`` and ``result.nearest``, arrays of the
    raster's shape. Mean errors are mostly below 0.6 % of the mean distance, and largest where costs jump. Rasters of
    more than 1.8 million cells are not divided: there, errors are a few percent where costs jump from cell to cell.

    Args:
        costs: Costs per unit of length, ``(rows, columns)``, positive: an array, a masked array or an xarray
            ``DataArray`` of two dimensions, y and x, with evenly spaced coordinates in units of length. NaN, ``inf``,
            masked cells and a ``DataArray``'s no-data value are barriers. No path passes between two barriers that
            touch in a corner.
        sources: Points ``(k, 2)``, rows ``(x, y)``; or a boolean mask of the raster's shape, whose cells are numbered
            as by ``np.argwhere(mask)``. Points of a ``DataArray`` have its coordinates. In an array, row 0 has the
            lowest y: ``costs[i, j]`` covers x from ``j`` to ``j + 1`` and y from ``i`` to ``i + 1``, times
            ``cell_size``. So pass ``costs[::-1]`` if row 0 is the north.
        cell_size: Side of a cell, or both ``(x, y)``; for arrays only.
        heights: Height of each cell, in the unit of ``cell_size``, for directed costs; barriers like those of costs.
        slope_cost: With heights, the factor of the cost at each slope, rise over run along the path: a function of
            arrays, or ``"tobler"``, the seconds of a hiker per meter.
        from_sources: With heights, whether paths lead from the sources to the cells. By default they lead to the
            sources.
        bounds: Whether to prove bounds, between which the distance then lies; takes some 20 s, and not with heights.
        max_bytes: If given, the result has a PLR of at most so many bytes.

    Raises:
        ValueError: If costs or heights are not such a raster, a source is outside of it or in a barrier, there is no
            source, an option is out of its range, or ``bounds`` comes with heights.
    """
    # 1. The raster with the lowest coordinates first, and the sources in it.
    cost, box, order = _raster(costs, cell_size)
    side, rise = box.width / cost.shape[::-1], None
    if heights is not None:
        rise = _values("heights", heights)
        if rise.shape != cost.shape or cost.size > _MOST_DIRECTED:
            most = f"shape {cost.shape}, of at most {_MOST_DIRECTED:,} cells"
            raise ValueError(f"heights must have {most}, got {rise.shape}.")
        _require_aligned("heights", heights, costs)
        rise = rise[order]
        cost = np.where(np.isfinite(rise), cost, np.inf)
    _require_aligned("A mask of sources", sources, costs)
    points, cells = _as_sources(sources, cost, box, order)
    # 2. Distances and nearest sources; bounds by a relaxed problem, and by the costs of paths between cells.
    lower = upper = plr = None
    if rise is None:
        distance, nearest = _marched(cost, side, points)
    else:
        slope_fn = tobler if isinstance(slope_cost, str) and slope_cost == "tobler" else slope_cost
        if not callable(slope_fn) or bounds:
            got = "bounds=True" if bounds else f"slope_cost={shortened(slope_cost)}"
            raise ValueError(f'With heights, slope_cost must be "tobler" or a function, without bounds, got {got}.')
        distance, nearest = _over_edges(cost, side, cells, rise, slope_fn, as_bool("from_sources", from_sources))
    if as_bool("bounds", bounds):
        lower, upper = _bounds(cost, box, points, cells, np.isfinite(distance))
        distance = np.clip(distance, lower, upper)
    if max_bytes is not None:
        plr = construct(GridField(distance, box), box, leaf="continuous", max_bytes=max_bytes)

    # 3. Results in the order and with the coordinates of the given raster.
    def like_costs(name: str, values: np.ndarray | None) -> Any:
        if values is None or not _is_data_array(costs):
            return values if values is None else values[order]
        result = costs.copy(data=values[order]).rename(name)
        result.attrs = {key: each for key, each in costs.attrs.items() if key not in _ATTRIBUTES_OF_COSTS}
        return result

    named = {"distance": distance, "nearest": nearest, "lower": lower, "upper": upper}
    return CostDistance(**{name: like_costs(name, values) for name, values in named.items()}, plr=plr)


def _bounds(
    cost: Raster, box: Box, points: Points, cells: Int[np.ndarray, "k 2"], reached: Bool[np.ndarray, "rows columns"]
) -> tuple[Raster, Raster]:
    """Return proven bounds at the centers of cells: by a convex program, and by the costs of actual paths."""
    side, cost_map = box.width / cost.shape[::-1], RasterCost(cost, box, "nearest")
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".* outside of its bounds")  # of an estimate that is not used here
        plr = solve_eikonal(cost_map.space(), points + box.lo, cost_map=cost_map, max_leaves=_BOUND_LEAVES)
    centers = box.at((np.stack(np.meshgrid(*map(np.arange, cost.shape[::-1])), axis=-1) + 0.5) / cost.shape[::-1])
    lower, upper = (np.asarray(each, float) for each in plr.bounds(centers))
    # A path over edges begins at the center of a cell, to which its source has a straight way.
    paths, _ = _over_edges(cost, side, cells)
    to_center = cost[tuple(cells.T)] * np.linalg.norm(points - (cells[:, ::-1] + 0.5) * side, axis=1)
    upper = np.minimum(upper, (paths + to_center.max()) * (1 + _ROUNDING))
    return np.where(reached, lower, np.inf), np.where(reached, upper, np.inf)


def _is_data_array(costs: Any) -> bool:
    return all(hasattr(costs, name) for name in ("dims", "coords", "attrs"))


def _values(name: str, raster: Any) -> Raster:
    """Return a raster as 64-bit floats, ``inf`` where it is masked, NaN or no data."""
    values = np.array(as_numbers(name, with_inf_for_masked(raster), "a raster of numbers"))
    if _is_data_array(raster):
        for key in _NO_DATA:
            values[values == raster.attrs.get(key)] = np.inf
    values[np.isnan(values)] = np.inf
    return values


def _require_aligned(name: str, raster: Any, costs: Any) -> None:
    """Require that a raster with coordinates has those of the costs; ``ValueError`` if not."""
    if not (_is_data_array(raster) and _is_data_array(costs)):
        return
    pairs = [(raster[axis].values, costs[axis].values) for axis in costs.dims if axis in raster.dims]
    if raster.dims != costs.dims or not all(a.shape == b.shape and np.allclose(a, b) for a, b in pairs):
        raise ValueError(
            f"{name} must have the dimensions {costs.dims} and coordinates of costs, got other ones: use "
            "reindex_like(costs) or interp_like(costs)."
        )


def _raster(costs: Any, cell_size: float | ArrayLike) -> tuple[Raster, Box, tuple[slice, slice]]:
    """Return costs by ascending coordinates, ``inf`` in barriers; their box; slices that restore the order."""
    cost = _values("costs", costs)
    if cost.ndim != 2 or cost.size == 0:
        raise ValueError(
            f"costs must have shape (rows, columns), got {cost.shape}. For one band of several, use "
            'costs.squeeze("band") or costs[0].'
        )
    size = as_numbers("cell_size", cell_size, "one or two positive numbers")
    if size.shape not in ((), (2,)) or not (np.isfinite(size) & (size > 0)).all():
        raise ValueError(f"cell_size must be one or two positive numbers, got {shortened(cell_size)}.")
    side = np.array(np.broadcast_to(size, 2))
    lo, order = np.zeros(2), (slice(None), slice(None))
    if _is_data_array(costs):
        if (size != 1).any():
            raise ValueError(f"cell_size is for arrays, and this DataArray has coordinates, got {cell_size}.")
        if str(costs.dims[0]).lower() in _X_NAMES or str(costs.dims[1]).lower() in _Y_NAMES:
            raise ValueError(f"costs must have the dimensions y and x in this order, got {costs.dims}: transpose it.")
        for axis, name in enumerate(costs.dims[::-1]):
            if str(name).lower() in _DEGREES or str(costs[name].attrs.get("units", "")).startswith("degree"):
                message = (
                    f"Coordinates {name!r} seem to be degrees, so that lengths are in degrees: project the raster."
                )
                warnings.warn(message, UserWarning, stacklevel=3)
            along = as_numbers(f"coordinates {name!r}", costs[name].values, "numbers")
            steps = np.diff(along)
            if len(steps):
                side[axis] = abs(along[-1] - along[0]) / len(steps)
                if not (np.abs(np.abs(steps) - side[axis]) <= 1e-3 * side[axis]).all() or side[axis] == 0:
                    spaced = f"got steps from {steps.min():g} to {steps.max():g}"
                    raise ValueError(f"coordinates {name!r} must be evenly spaced, {spaced}.")
                if along[0] > along[-1]:
                    backward = slice(None, None, -1)
                    order = (order[0], backward) if axis == 0 else (backward, order[1])
            lo[axis] = along.min() - side[axis] / 2
    cost = cost[order]
    if (wrong := np.argwhere(cost <= 0)).size:
        got = f"{cost[tuple(wrong[0])]:g} in {len(wrong)} cells"
        raise ValueError(
            f"costs must be positive, got {got}. For free passage use a small cost, for barriers NaN or a mask."
        )
    return cost, Box(lo, lo + side * cost.shape[::-1]), order


def _as_sources(
    sources: ArrayLike, cost: Raster, box: Box, order: tuple[slice, slice]
) -> tuple[Float[np.ndarray, "k 2"], Int[np.ndarray, "k 2"]]:
    """Return sources relative to the lower corner of the raster, and the row and column of each one's cell."""
    shape, side = np.array(cost.shape), box.width / cost.shape[::-1]
    if np.dtype(getattr(sources, "dtype", float)).kind == "b":
        if np.shape(sources) != cost.shape:
            raise ValueError(f"A mask of sources must have the raster's shape {cost.shape}, got {np.shape(sources)}.")
        cells = np.argwhere(np.ma.filled(sources, False) if np.ma.isMaskedArray(sources) else np.asarray(sources))
        for axis in (0, 1):
            if order[axis].step == -1:
                cells[:, axis] = shape[axis] - 1 - cells[:, axis]
        points = (cells[:, ::-1] + 0.5) * side
    elif np.shape(sources) == cost.shape and cost.shape[1] != 2:
        raise ValueError("A mask of sources must be boolean, got numbers of the raster's shape: use sources != 0.")
    else:
        points = as_points("sources", sources, 2) - box.lo
        cells = np.floor(points / side)[:, ::-1]
        cells[points[:, ::-1] == box.width[::-1]] -= 1  # the upper border belongs to the last cell
    if not len(points):
        raise ValueError("sources must have at least one source, got none.")

    def first(wrong: Bool[np.ndarray, "k"]) -> str:
        number = int(np.argmax(wrong))
        return f"source {number} at {(points[number] + box.lo).tolist()}, one of {wrong.sum()}"

    is_outside = ~((cells >= 0) & (cells < shape)).all(axis=1)
    if is_outside.any():
        raise ValueError(f"sources must lie in the raster {box}, rows (x, y), got {first(is_outside)}.")
    cells = cells.astype(np.int64)
    is_barred: Any = ~np.isfinite(cost[tuple(cells.T)])
    if is_barred.any():
        raise ValueError(
            f"sources must not lie in barriers, got {first(is_barred)}: move it. For a mask of sources, use mask & "
            "np.isfinite(costs)."
        )
    return points, cells


def _marched(cost: Raster, side: Sides, points: Points) -> tuple[Raster, Nearest]:
    """Return distances by fast marching over nodes, an odd number of them along each side of a cell."""
    # 1. Nodes, about as far apart along both axes. Costs are divided by the least one, as scikit-fmm ignores some.
    least, most = cost.min(), cost.max(where=np.isfinite(cost), initial=0)
    if most > _LARGEST_RATIO * least:
        raise ValueError(
            f"costs must differ by a factor of at most {_LARGEST_RATIO:g}, got costs from {least:g} to {most:g}. "
            "Reduce the largest, or make their cells barriers."
        )
    cost = cost / least
    num_nodes = min(max(9 * cost.size, _FINE_NODES), _MOST_NODES)
    wanted = side * np.sqrt(num_nodes / cost.size / side.prod()) + _TINY
    wanted = np.maximum(np.minimum(wanted, np.sqrt(_MOST_STARTS / len(points))), 1)
    parts = (wanted - 1).astype(int)[::-1] // 2 * 2 + 1
    cost = cost.repeat(parts[0], axis=0).repeat(parts[1], axis=1) if (parts > 1).any() else cost
    step, shape, is_open = side / parts[::-1], np.array(cost.shape), np.isfinite(cost)
    # 2. Straight motions between sources and nodes around them, in a source's cell or beside it. A cell beyond a
    #    corner counts if no barrier meets that corner.
    home = np.minimum((points / step).astype(np.int64)[:, ::-1], shape - 1)
    reach = (np.arange(-(count // 2) - 1, count // 2 + 2) for count in parts)
    place = home[:, None] + np.stack(np.meshgrid(*reach, indexing="ij"), axis=-1).reshape(-1, 2)
    source, which = np.nonzero(((place >= 0) & (place < shape)).all(axis=2))
    place = place[source, which]
    (i, j), (home_i, home_j) = place.T, home[source].T
    is_kept = is_open[i, j] & is_open[i, home_j] & is_open[home_i, j]
    source, place = source[is_kept], place[is_kept]
    length = np.linalg.norm((place[:, ::-1] + 0.5) * step - points[source], axis=1)
    at_source = cost[tuple(home.T)]
    straight = length * np.maximum(cost[tuple(place.T)], at_source[source])
    # 3. The front begins where straight motions cost `begin`, so that it leaves all sources at once.
    begin = at_source.min() * float(side.min()) / 2
    phi = (straight - begin) / cost[tuple(place.T)]
    is_home = (place == home[source]).all(axis=1)
    phi[is_home] = np.minimum(phi[is_home], -_TINY * step.min())
    last = np.lexsort((-source, -straight))  # among several sources, the nearest is written last
    node = tuple(place[last].T)
    front, distance, label = (
        np.full(cost.shape, side.max()),
        np.full(cost.shape, np.inf),
        np.full(cost.shape, -1, np.int32),
    )
    front[node], distance[node], label[node] = phi[last], straight[last], source[last]
    is_inside = (front < 0) & is_open
    distance[~is_inside], label[~is_inside] = np.inf, -1
    # 4. March.
    if (is_open & ~is_inside).any():
        time = skfmm.travel_time(np.ma.MaskedArray(front, ~is_open), 1 / cost, dx=step[::-1].tolist(), order=2)
        reached = ~np.ma.getmaskarray(time) & ~is_inside
        distance[reached] = np.asarray(time)[reached] + begin
    if len(points) > 1:
        label = _labels(distance, cost, step, label)
    centers = tuple(np.s_[count // 2 :: count] for count in parts)
    distance = least * distance[centers]
    return distance, label[centers] if len(points) > 1 else np.where(np.isfinite(distance), 0, -1)


def _labels(distance: Raster, cost: Raster, step: Sides, label: Nearest) -> Nearest:
    """Give each node the label of the source that steepest descent reaches.

    ``carried_goals`` is more exact, but takes 13 numbers and more a node: too many for rasters of 10^8 cells.
    """
    # 1. The next node: of sixteen around it, the one through which the distance is least.
    toward = np.arange(distance.size, dtype=np.int32 if distance.size < 2**31 else np.int64).reshape(distance.shape)
    number, least = toward.copy(), np.full(distance.shape, np.inf)
    for i, j in ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (1, -2), (2, 1), (2, -1)):
        first = np.maximum([0, 0], [-i, -j])
        last = np.array(distance.shape) - np.maximum([0, 0], [i, j])

        def part(values: np.ndarray, cell: tuple[int, int], first=first, last=last) -> np.ndarray:
            return values[first[0] + cell[0] : last[0] + cell[0], first[1] + cell[1] : last[1] + cell[1]]

        way = float(np.hypot(*(step[::-1] * (i, j)))) * _mean_along(i, j, partial(part, cost))
        for a, b in (((0, 0), (i, j)), ((i, j), (0, 0))):
            through = part(distance, b) + way
            is_better = (through < part(least, a)) & (part(distance, b) < part(distance, a))
            part(least, a)[is_better] = through[is_better]
            part(toward, a)[is_better] = part(number, b)[is_better]
    del number, least
    # 2. Replace each successor by its successor until nothing changes.
    toward = np.where(label >= 0, np.arange(label.size).reshape(label.shape), toward).ravel()
    while not np.array_equal(further := toward[toward], toward):
        toward = further
    return label.ravel()[toward].reshape(label.shape)


def _over_edges(
    cost: Raster,
    side: Sides,
    cells: Int[np.ndarray, "k 2"],
    height: Raster | None = None,
    slope_fn: Slope = tobler,
    from_sources: bool = False,
) -> tuple[Raster, Nearest]:
    """Return costs of shortest paths over straight edges between centers of cells, and the nearest sources."""
    # 1. Costs and heights with a rim of barriers. Barriers get the height of the nearest cell.
    if height is not None:
        nearest_open: Any = ndimage.distance_transform_edt(
            np.isinf(cost), sampling=side[::-1], return_distances=False, return_indices=True
        )
        height = np.pad(height[tuple(nearest_open)], _REACH, mode="edge")
    cost, (rows, columns) = np.pad(cost, _REACH, constant_values=np.inf), cost.shape

    def beside(values: np.ndarray, offset: tuple[int, int]) -> np.ndarray:
        i, j = _REACH + offset[0], _REACH + offset[1]
        return values[i : i + rows, j : j + columns]

    # 2. The cost of each edge: its length, times the mean cost along it, times the mean factor of its parts' slopes.
    edges = [(i, j) for i, j in product(range(-_REACH, _REACH + 1), repeat=2) if gcd(i, j) == 1]
    end, weight = np.empty((rows, columns, len(edges)), np.int32), np.empty((rows, columns, len(edges)))
    for number, (i, j) in enumerate(edges):
        length, count = float(np.hypot(*(side[::-1] * (i, j)))), max(abs(i), abs(j))
        weight[..., number] = length * _mean_along(i, j, partial(beside, cost))
        if height is not None:
            heights = []
            for part in range(count + 1):
                (i0, to_i), (j0, to_j) = (divmod(each * part, count) for each in (i, j))
                # One of the two coordinates is whole: between two cells, heights are interpolated.
                beyond, rest = (i0 + (to_i > 0), j0 + (to_j > 0)), max(to_i, to_j) / count
                heights.append((1 - rest) * beside(height, (i0, j0)) + rest * beside(height, beyond))
            slopes = np.diff(heights, axis=0) * (count if from_sources else -count) / length
            factor = np.broadcast_to(as_numbers("slope_cost", slope_fn(slopes), "numbers"), slopes.shape)
            if not (factor > 0).all():
                raise ValueError("slope_cost must return positive numbers, got some that are not.")
            weight[..., number] *= np.mean(factor, axis=0)
        ends = (np.clip(np.arange(size) + by, 0, size - 1) for size, by in ((rows, i), (columns, j)))
        end[..., number] = np.ravel_multi_index(np.ix_(*ends), (rows, columns))
    # 3. Shortest paths from all sources at once; an infinite weight is no edge.
    begins = np.arange(0, weight.size + 1, len(edges))
    graph = csr_array((weight.ravel(), end.ravel(), begins), shape=(rows * columns, rows * columns))
    node = np.ravel_multi_index(tuple(cells.T), (rows, columns))
    distance, _, source = dijkstra(graph, indices=node, min_only=True, return_predecessors=True)
    known, first = np.unique(node, return_index=True)
    is_reached = np.isfinite(distance)
    nearest = np.full(rows * columns, -1)
    nearest[is_reached] = first[np.searchsorted(known, source[is_reached])]
    return distance.reshape(rows, columns), nearest.reshape(rows, columns)


def _mean_along(i: int, j: int, cost_at: Callable[[tuple[int, int]], np.ndarray]) -> np.ndarray:
    """Return the mean cost along a straight motion to the cell ``(i, j)`` further; ``inf`` if barriers stop it.

    ``cost_at`` gives the costs of the cells that are so many rows and columns away from where motions begin.
    """
    ends = sorted({0.0, 1.0} | {(k + 0.5) / abs(each) for each in (i, j) for k in range(abs(each))})
    cells = [(round(i * (a + b) / 2), round(j * (a + b) / 2)) for a, b in pairwise(ends)]
    mean: Any = sum((b - a) * cost_at(cell) for (a, b), cell in zip(pairwise(ends), cells, strict=True))
    for a, b in pairwise(cells):
        if a[0] != b[0] and a[1] != b[1]:  # a corner: one of the other two cells there must be no barrier
            mean = np.where(np.isinf(np.minimum(cost_at((a[0], b[1])), cost_at((b[0], a[1])))), np.inf, mean)
    return mean
