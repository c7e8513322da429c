"""Cost maps given as rasters, also from ROS: one factor of the motion cost per cell."""

import warnings
from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import product
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from plr_jax._arrays import as_bool, as_finite, as_numbers, as_points, parts, ragged_indices, set_fields, shortened
from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box
from plr_jax.spaces._costs import Numbers, Vectors
from plr_jax.spaces._data_arrays import data_array_box, is_data_array, is_in_degrees, opened, raster_values
from plr_jax.spaces._space import as_boxes, batches
from plr_jax.spaces._voxels import VoxelSpace

_MAX_AXES = 4
_MIN_FACTOR, _MAX_FACTOR = 1e-30, 1e30  # representable in float32 with room to spare
_INTERPOLATIONS = ("bilinear", "nearest")
_POINTS_PER_BATCH = 8192  # intermediate arrays of this many points stay in the cache
# A patch is a box between neighboring cell centers, in which the factor is multilinear. Bounds are exact extremes
# over boxes that meet at most this many patches along each axis.
_MAX_PATCHES = 3
# Relative rounding errors of cell coordinates and of factors: several times the sum over the few operations of each.
_COORDINATE_ROUNDING = 8 * np.finfo(float).eps
_FACTOR_ROUNDING = 256 * np.finfo(float).eps  # all terms of an interpolation are positive, so nothing cancels
_RADIUS_ROUNDING = 1e-9  # a cell this share beyond a radius counts as within: rounding of the bounds is smaller
# Costs of costmap_2d, https://docs.ros.org/en/noetic/api/costmap_2d/html/cost__values_8h_source.html, and the
# corresponding values of the occupancy grids in which Nav2 and ROS publish cost maps.
_MAX_COST, _INSCRIBED, _LETHAL, _UNKNOWN = 252, 253, 254, 255
_GRID_UNKNOWN, _GRID_MAX_COST, _GRID_INSCRIBED, _GRID_LETHAL = -1, 98, 99, 100
_MAX_ENTRIES = 2**26  # entries of a sparse table (256 MiB); a larger table lacks levels, so large blocks take longer
_WINDOWS_PER_BATCH = 2**18  # lookups in a sparse table at a time, which bounds the memory
Raster = Float[np.ndarray, "..."]
Entries = Int[np.ndarray, "n rank"]


@dataclass(frozen=True, eq=False, init=False)
class RasterCost:
    """A cost map with one factor of the motion cost per cell of a raster, of one to four axes.

    Where the motion cost is a length, the factor is a cost per unit of length, not a speed. ``values[row, column]``
    belongs to ``(x, y)`` with ``x`` in that column and ``y`` in that row; row 0 has the lowest ``y``. In general the
    **last** array axis runs along the first coordinate, as in :class:`GridField`. Pass ``values[::-1]`` for a
    picture, whose row 0 is at the top, and ``values.T`` for a table indexed ``[x, y, ...]``.

    The cost map does not keep paths out of blocked cells; a space such as :meth:`space` does. A blocked cell has the
    factor of the nearest unblocked cell. Outside the bounds, the factor is that of the nearest point inside; along
    periodic axes the raster repeats. If configurations have more coordinates than the raster has axes, the leading
    coordinates select the factor; it also applies to changes of the other coordinates. Invalid arguments raise
    ``ValueError``.

    Args:
        values: The factor at the center of each cell, from 1e-30 to 1e30; ``inf``, NaN or masked where the cell is
            blocked. An xarray ``DataArray`` of the dimensions y and x may run from north to south, and its no-data
            cells are blocked. Instead of an array, pass the path of a
            file that rioxarray reads, such as a GeoTIFF of one band.
        bounds: The box that the cells fill, or its corners ``(lo, hi)``: outer cell borders, not cell centers. Leave
            it out for a ``DataArray`` or a file, which have coordinates.
        interpolation: ``"bilinear"`` interpolates multilinearly between cell centers and is constant in the outer
            half of border cells. ``"nearest"`` is constant in each cell. On a border between cells, it takes the
            upper cell; the method :meth:`bounds` takes both cells.
    """

    values: Float[np.ndarray, "..."]
    domain: Box
    interpolation: str
    _lethal: Bool[np.ndarray, "..."]  # the cells that ``inflated`` inflates: of lethal cost in ROS, else blocked

    def __init__(self, values: Any, bounds: Box | ArrayLike | None = None, interpolation: str = "bilinear"):
        order, values = (), opened("values", values)
        if is_data_array(values):
            if bounds is not None:
                raise ValueError("bounds are for arrays, and this DataArray has coordinates: leave the bounds out.")
            bounds, order = data_array_box("values", values)
            if is_in_degrees(values):
                advice = "project the raster, with rioxarray by raster.rio.reproject(raster.rio.estimate_utm_crs())"
                message = f"Coordinates {values.dims} seem to be degrees, so that lengths are in degrees: {advice}."
                warnings.warn(message, UserWarning, stacklevel=2)
        elif bounds is None:
            raise ValueError("bounds must be the box that the cells fill, got None.")
        domain = Box.of(bounds, "The bounds")
        if interpolation not in _INTERPOLATIONS:
            raise ValueError(f"interpolation must be 'bilinear' or 'nearest', got {shortened(interpolation)}.")
        expected = f"factors on a raster of {domain.dim} axes"
        factors = np.array(raster_values("values", values, expected)[order], order="C")
        if factors.ndim != domain.dim or factors.ndim > _MAX_AXES or factors.size == 0:
            expected += f", one per axis of the bounds and at most {_MAX_AXES}, with at least one cell"
            raise ValueError(f"values must be {expected}, got shape {factors.shape}. The last axis runs along x.")
        is_wrong = ~((factors >= _MIN_FACTOR) & (factors <= _MAX_FACTOR)) & (factors != np.inf)
        if is_wrong.any():
            cell = tuple(np.argwhere(is_wrong)[0].tolist())
            expected = f"from {_MIN_FACTOR:g} to {_MAX_FACTOR:g}, or inf for a blocked cell"
            advice = "For the bytes of a ROS cost map use RasterCost.from_costmap."
            raise ValueError(f"values must be {expected}, got {factors[cell]:g} at {cell}. {advice}")
        if np.isinf(factors).all():
            raise ValueError(f"values must leave a cell that is not blocked, got {factors.shape} blocked cells.")
        factors.flags.writeable = False
        set_fields(self, values=factors, domain=domain, interpolation=interpolation, _lethal=np.isinf(factors))

    @classmethod
    def from_costmap(
        cls,
        values: ArrayLike,
        bounds: Box | ArrayLike,
        *,
        cost_travel_multiplier: float | int = 2.0,
        unknown_is_free: bool = False,
        interpolation: str = "bilinear",
    ) -> "RasterCost":
        """Convert a robot's cost map: the bytes of ROS's ``costmap_2d``, row 0 at the lowest ``y``.

        A cost from 0 to 252 becomes the factor ``1 + cost_travel_multiplier * cost / 252``, as in Nav2's planner Smac
        2D. A multiplier of 4.03 reproduces NavFn, which uses ``(50 + 0.8 * cost) / 50``. Cells with cost 253 (within
        the robot's inscribed radius of an obstacle) and 254 (lethal) are blocked. Unknown cells, 255, are blocked
        too, unless ``unknown_is_free``: then they get the factor of cost 252, as in NavFn. Other arguments and errors
        are as for the class.
        """
        costs = _in_range(values, 0, _UNKNOWN, "costs of costmap_2d; for an OccupancyGrid use from_occupancy_grid")
        multiplier = as_finite("cost_travel_multiplier", cost_travel_multiplier)
        factors = 1 + multiplier * np.minimum(costs, _MAX_COST) / _MAX_COST
        blocked = costs >= _INSCRIBED
        if as_bool("unknown_is_free", unknown_is_free):
            blocked &= costs < _UNKNOWN
        cost = cls(np.where(blocked, np.inf, factors), bounds, interpolation)
        set_fields(cost, _lethal=costs == _LETHAL)
        return cost

    @classmethod
    def from_occupancy_grid(
        cls,
        values: ArrayLike,
        bounds: Box | ArrayLike,
        *,
        cost_travel_multiplier: float | int = 2.0,
        unknown_is_free: bool = False,
        interpolation: str = "bilinear",
    ) -> "RasterCost":
        """Convert a robot's cost map as ROS publishes it: an ``OccupancyGrid``, row 0 at the lowest ``y``.

        The values are -1 for unknown, 0 for free, 1 to 98 for costs from 1 to 252, 99 for inscribed, and 100 for
        lethal. Other arguments and errors are as for :meth:`from_costmap`.
        """
        expected = "values of an OccupancyGrid; for bytes of costmap_2d use from_costmap"
        grid = _in_range(values, _GRID_UNKNOWN, _GRID_LETHAL, expected)
        costs = np.interp(grid, (0, 1, _GRID_MAX_COST), (0, 1, _MAX_COST))
        costs[grid >= _GRID_INSCRIBED] = _INSCRIBED
        costs[grid >= _GRID_LETHAL] = _LETHAL
        costs[grid < 0] = _UNKNOWN
        options: Any = {"unknown_is_free": unknown_is_free, "interpolation": interpolation}
        return cls.from_costmap(costs, bounds, cost_travel_multiplier=cost_travel_multiplier, **options)

    def inflated(
        self,
        inscribed_radius: float | int,
        *,
        inflation_radius: float | int = 0.55,
        cost_scaling_factor: float | int = 10.0,
        cost_travel_multiplier: float | int = 2.0,
    ) -> "RasterCost":
        """Return a cost map with higher costs around lethal cells, as Nav2's inflation layer computes them.

        Lethal cells are those with cost 254 in :meth:`from_costmap` or 100 in :meth:`from_occupancy_grid`; in other
        cost maps all blocked cells are lethal. Unknown and inscribed cells are not inflated. Let ``distance`` be the
        distance from a cell's center to the center of the nearest lethal cell.

        - If ``distance`` is at most ``inscribed_radius``, the cell is blocked, even if ``inflation_radius`` is
          smaller. So a point moves in the result's :meth:`space` where a disc of this radius moves in the map.
        - If ``distance`` is at most ``inflation_radius``, the cost is at least
          ``252 * exp(-cost_scaling_factor * (distance - inscribed_radius))``. As in Nav2, ``inflation_radius`` is
          first rounded up to a multiple of the shortest side of a cell.

        Radii and distances are in units of the bounds. Costs become factors as in :meth:`from_costmap`, but are not
        rounded to bytes. ``ValueError`` if an argument is negative or not finite. See
        https://docs.nav2.org/configuration/packages/costmap-plugins/inflation.html.
        """
        inscribed = as_finite("inscribed_radius", inscribed_radius)
        reach = as_finite("inflation_radius", inflation_radius)
        scaling = as_finite("cost_scaling_factor", cost_scaling_factor)
        multiplier = as_finite("cost_travel_multiplier", cost_travel_multiplier)
        if not self._lethal.any():
            return self
        around, middle = self._three_periods(~self._lethal)
        distance: Any = ndimage.distance_transform_edt(around, sampling=self._sides)
        distance = distance[middle] * (1 - _RADIUS_ROUNDING)
        side = self._sides.min()
        reach = side * np.ceil(reach / side * (1 - _RADIUS_ROUNDING))
        decay = np.where(distance <= reach, np.exp(-scaling * np.maximum(distance - inscribed, 0.0)), 0.0)
        factors = np.where(distance <= inscribed, np.inf, np.maximum(self.values, 1 + multiplier * decay))
        cost = RasterCost(factors, self.domain, self.interpolation)
        set_fields(cost, _lethal=self._lethal)
        return cost

    def __repr__(self) -> str:
        return f"RasterCost({' x '.join(map(str, self.values.shape))} cells, {self.domain}, {self.interpolation!r})"

    @property
    def dim(self) -> int:
        """Number of axes."""
        return self.domain.dim

    @property
    def free(self) -> Bool[np.ndarray, "..."]:
        """Boolean mask of the cells that are not blocked, indexed like ``values``."""
        return np.isfinite(self.values)

    def space(self, radius: float | int = 0.0) -> VoxelSpace:
        """Return the configuration space of a point or ball among the blocked cells.

        ``radius`` is in units of the bounds; 0 is a point.
        """
        return VoxelSpace(self.free.T, self.domain, radius)

    def __call__(self, q: ArrayLike) -> Numbers:
        """Return the factor of the motion cost at configurations ``(n, dof)``, ``(n,)``.

        Only the leading coordinates count, one for each axis of the raster. The factor is NaN if one of the leading
        coordinates is not finite.
        """
        q = self._leading_coordinates("q", q)
        factors = np.full(len(q), np.nan)
        for part in batches(np.flatnonzero(np.isfinite(q).all(axis=1)), _POINTS_PER_BATCH):
            coords = self._cell_coordinates(q[part])
            clipped = np.clip(coords, 0, self._sizes - 1)
            factors[part] = self._interpolated(np.where(self.domain.periodic, coords % self._sizes, clipped))
        return factors

    def bounds(self, lo: Vectors, hi: Vectors) -> tuple[Numbers, Numbers]:
        """Return bounds of the factor of the motion cost over closed boxes, which may extend beyond the raster.

        With ``"nearest"``, the bounds are the extremes over all cells that the box touches. With ``"bilinear"``, the
        bounds are exact if the box meets at most three intervals between cell centers along each axis. Over larger
        boxes, they are the extremes over all cells whose centers surround the box. Bounds are rounded outward;
        extremes over many cells are also rounded to float32. Corners, ``(n, dof)``, must be finite with ``hi``
        nowhere below ``lo``.
        """
        lo, hi = self._leading_coordinates("lo", lo), self._leading_coordinates("hi", hi)
        as_boxes(lo, hi, self.dim)
        first, last = self._rounded_outward(lo, hi)
        above = np.floor(last) if self.interpolation == "nearest" else np.ceil(last)
        least, most = np.empty(len(first)), np.empty(len(first))
        # 1. Look up the extremes over all cells of large boxes.
        patches = np.maximum((above - np.floor(first)).max(axis=1), 1)
        by_table = (patches > _MAX_PATCHES) | (self.interpolation == "nearest")
        below = np.floor(first[by_table]).astype(np.intp)
        least[by_table], most[by_table] = self._table.extremes(below, above[by_table].astype(np.intp))
        # 2. Compute the extremes over other boxes. The lines of cell centers cut a box into pieces, one per patch.
        #    The factor is multilinear in a piece, so its extremes over the box are at corners of pieces.
        for count in range(1, _MAX_PATCHES + 1):
            few = np.flatnonzero(~by_table & (patches == count))
            corners = np.array(list(product(range(count + 1), repeat=self.dim)))
            for part in batches(few, max(1, _POINTS_PER_BATCH // len(corners))):
                lines = np.floor(first[part, None]) + np.arange(count + 1)[:, None]
                # Coordinates of the corners of all pieces, (boxes, (count + 1)**dim, dim).
                coords = np.clip(lines, first[part, None], last[part, None])[:, corners, np.arange(self.dim)]
                factors = self._interpolated(coords.reshape(-1, self.dim)).reshape(coords.shape[:2])
                least[part], most[part] = factors.min(axis=1), factors.max(axis=1)
        return (1 - _FACTOR_ROUNDING) * least, (1 + _FACTOR_ROUNDING) * most

    def _interpolated(self, coords: Vectors) -> Numbers:
        # With "nearest", cell k has coordinates from k to k + 1; else they count from the center of cell 0.
        below = np.floor(coords).astype(np.intp)
        if self.interpolation == "nearest":
            return self._cell_factors(below)
        beyond = coords - below
        total = np.zeros(len(coords))
        for corner in product((0, 1), repeat=self.dim):
            weights = (beyond[:, axis] if up else 1 - beyond[:, axis] for axis, up in enumerate(corner))
            total += reduce(np.multiply, weights) * self._cell_factors(below + corner)
        return total

    def _cell_factors(self, cell: Int[np.ndarray, "n dim"]) -> Numbers:
        modes: Any = tuple("wrap" if periodic else "clip" for periodic in self.domain.periodic)
        return self._filled_factors.take(np.ravel_multi_index(tuple(cell.T), self._filled_factors.shape, mode=modes))

    def _leading_coordinates(self, name: str, value: ArrayLike) -> Vectors:
        points = as_points(name, value)
        if points.shape[1] < self.dim:
            raise ValueError(f"{name} must have at least {self.dim} coordinates, as {self} has, got {points.shape}.")
        return points[:, : self.dim]

    def _cell_coordinates(self, q: Vectors) -> Vectors:
        # Whole numbers are cell centers, or cell borders for `"nearest"`.
        coords = (q - self.domain.lo) / self.domain.width * self._sizes
        return coords if self.interpolation == "nearest" else coords - 0.5

    def _rounded_outward(self, lo: Vectors, hi: Vectors) -> tuple[Vectors, Vectors]:
        # 1. Convert to units of cells, and enlarge by rounding errors.
        sizes = self._sizes
        first, last = self._cell_coordinates(lo), self._cell_coordinates(hi)
        rounding = _COORDINATE_ROUNDING * (sizes + np.maximum(np.abs(first), np.abs(last)))
        first, last = first - rounding, last + rounding
        # 2. Along periodic axes, shift by whole periods, so that 0 <= first < size. A box that is no shorter than a
        #    period becomes the whole period. Along other axes, clip to the coordinates of the outer cells.
        shift = np.floor(first / sizes) * sizes
        is_whole = last - first >= sizes
        lower = np.where(self.domain.periodic, np.where(is_whole, 0, first - shift), np.clip(first, 0, sizes - 1))
        upper = np.where(self.domain.periodic, np.where(is_whole, sizes, last - shift), np.clip(last, 0, sizes - 1))
        return lower, upper

    @property
    def _sizes(self) -> Float[np.ndarray, "dim"]:
        return np.array(self.values.shape[::-1], np.float64)

    @property
    def _sides(self) -> Float[np.ndarray, "dim"]:
        """Side lengths of a cell along each axis of ``values``."""
        return (self.domain.width / self._sizes)[::-1]

    def _three_periods(self, cells: Bool[np.ndarray, "..."]) -> tuple[Bool[np.ndarray, "..."], tuple[slice, ...]]:
        """Return an array with ``cells`` three times along each periodic axis, and the slices of the middle copy."""
        sizes = np.multiply(cells.shape, self.domain.periodic[::-1])  # of the copies before and after, 0 for none
        middle = tuple(slice(before, before + size) for before, size in zip(sizes, cells.shape, strict=True))
        return np.pad(cells, [(size, size) for size in sizes], mode="wrap"), middle

    @cached_property
    def _filled_factors(self) -> Float[np.ndarray, "..."]:
        """Cost factors, indexed by x first, in which blocked cells have the factor of the nearest unblocked cell."""
        factors = self.values
        if not self.free.all():
            around, middle = self._three_periods(self.free)
            nearest = nearest_cells(around, self._sides)
            factors = factors[tuple(index[middle] % size for index, size in zip(nearest, factors.shape, strict=True))]
        return np.ascontiguousarray(factors.T)

    @cached_property
    def _table(self) -> "SparseTable":
        # Periodic axes have two periods and one more cell: boxes begin below `size`, and end at most `size` later.
        factors = self._filled_factors
        padding = [(0, (size + 1) * wraps) for size, wraps in zip(factors.shape, self.domain.periodic, strict=True)]
        return SparseTable(np.pad(factors, padding, mode="wrap") if self.domain.is_periodic else factors)


def nearest_cells(wanted: Bool[np.ndarray, "..."], sides: Float[np.ndarray, " dim"]) -> Any:
    """Return, for each cell of a grid, the indices along all axes of the nearest cell that is ``wanted``."""
    nearest: Any = ndimage.distance_transform_edt(~wanted, sides, return_distances=False, return_indices=True)
    return tuple(nearest)


def _in_range(values: ArrayLike, least: int, most: int, what: str) -> Raster:
    expected = f"numbers from {least} to {most}, {what}"
    numbers = as_numbers("values", values, expected)
    wrong = ~((numbers >= least) & (numbers <= most))
    if wrong.any():
        raise ValueError(f"values must be {expected}, got {shortened(numbers[wrong][0].item())}.")
    return numbers


@dataclass(frozen=True, eq=False)
class SparseTable:
    """A table to look up the smallest and largest entry of any block of an array, as float32 rounded outward.

    Level ``k`` has the extremes of all windows whose side is ``2**k``, or the whole axis if that is shorter. A block
    is covered by windows of the largest level that fits into it. Windows may overlap, which does not change
    extremes::

        block     |-----------|
        windows   |-------|
                      |-------|

    A cube takes at most two windows along each axis, other blocks more along their longer axes. Bender and
    Farach-Colton, "The LCA problem revisited", 2000.
    """

    values: Raster

    def extremes(self, first: Entries, last: Entries) -> tuple[Numbers, Numbers]:
        """Return the least and the largest entry of each block, ``(n,)`` each.

        Block ``i`` has the indices from ``first[i]`` to ``last[i]``, both included, along each axis. Results may be
        rounded outward to float32.
        """
        least, most = np.empty(len(first)), np.empty(len(first))
        sides = np.array([side for side, _, _ in self._levels])
        # The number of levels after the first one whose windows fit is the largest such level.
        extent = last - first + 1
        level = np.count_nonzero((extent >= sides[1:, None]).all(axis=2), axis=0)
        for k in np.unique(level):
            blocks = np.flatnonzero(level == k)
            counts = -(-extent[blocks] // sides[k])  # windows along each axis: rounded up
            for part in parts(counts.prod(axis=1), _WINDOWS_PER_BATCH):
                rows = blocks[part]
                least[rows], most[rows] = self._window_extremes(int(k), first[rows], last[rows], counts[part])
        return least, most

    def _window_extremes(self, level: int, first: Entries, last: Entries, counts: Entries) -> tuple[Numbers, Numbers]:
        # `counts` windows along each axis cover a block: side by side, but the last one ends where the block ends.
        side, least, most = self._levels[level]
        totals = counts.prod(axis=1)
        block, index = ragged_indices(totals)
        window = np.zeros(len(block), np.intp)  # flat index of each window
        for axis, num in enumerate(least.shape):
            index, step = np.divmod(index, counts[block, axis])
            begin = np.minimum(first[block, axis] + step * side[axis], last[block, axis] - side[axis] + 1)
            window = window * num + begin
        starts = np.cumsum(totals) - totals
        return np.minimum.reduceat(least.take(window), starts), np.maximum.reduceat(most.take(window), starts)

    @cached_property
    def _levels(self) -> list[tuple[Int[np.ndarray, " rank"], Raster, Raster]]:
        # Each level has a size of windows, and the smallest and largest entry of each window of this size.
        shape = np.array(self.values.shape)
        side, num_entries = np.ones_like(shape), 0
        levels = [(side, self.values, self.values)]
        single = self.values.astype(np.float32)
        least = np.where(single > self.values, np.nextafter(single, np.float32(-np.inf)), single)
        most = np.where(single < self.values, np.nextafter(single, np.float32(np.inf)), single)
        while (side < shape).any() and num_entries < _MAX_ENTRIES:
            step = np.minimum(side, shape - side)  # doubles the side, up to the whole axis
            least, most = _merge_windows(np.minimum, least, step), _merge_windows(np.maximum, most, step)
            side = side + step
            num_entries += 2 * least.size
            levels.append((side, least, most))
        return levels


def _merge_windows(extreme: np.ufunc, windows: Raster, step: Int[np.ndarray, " rank"]) -> Raster:
    # Merge each window with the one that begins `step` later, along each axis.
    for axis in np.flatnonzero(step):
        along = np.moveaxis(windows, axis, 0)
        windows = np.moveaxis(extreme(along[: -step[axis]], along[step[axis] :]), 0, axis)
    return np.ascontiguousarray(windows)
