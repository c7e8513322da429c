"""Costs of motions as rasters give them: a factor a cell, as every robot's cost map has it.

Values may be the bytes of ROS's ``costmap_2d`` or an occupancy grid, and may be inflated around lethal cells.
"""

from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import product
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from scipy import ndimage

from plr_jax._arrays import (
    as_bool,
    as_finite,
    as_numbers,
    as_points,
    parts,
    ragged_indices,
    set_fields,
    shortened,
    with_inf_for_masked,
)
from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box
from plr_jax.spaces._costs import Rates, Vectors
from plr_jax.spaces._space import as_boxes
from plr_jax.spaces._voxels import VoxelSpace

_MAX_AXES = 4
_MIN_FACTOR, _MAX_FACTOR = 1e-30, 1e30  # which 32 bits tell apart from nothing
_INTERPOLATIONS = ("bilinear", "nearest")
_POINTS_PER_BATCH = 8192  # points, of which all that is computed stays in the cache
_MAX_PATCHES = 3  # along an axis, of boxes over which bounds are the extremes themselves
# What rounding moves a place by, in roundings of it and of the raster's size, and a factor by, of itself: several
# times what the few operations of each amount to. All of an interpolation's terms are positive.
_COORDINATE_ROUNDING, _FACTOR_ROUNDING = 8 * np.finfo(float).eps, 256 * np.finfo(float).eps
_RADIUS_ROUNDING = (
    1e-9  # by what share distances of cells may exceed a radius: rounding of the bounds changes them by less
)
# Costs of costmap_2d, https://docs.ros.org/en/noetic/api/costmap_2d/html/cost__values_8h_source.html, and the values
# that tell of them in the occupancy grids in which Nav2 and ROS publish cost maps.
_MAX_COST, _INSCRIBED, _LETHAL, _UNKNOWN = 252, 253, 254, 255
_GRID_UNKNOWN, _GRID_MAX_COST, _GRID_INSCRIBED, _GRID_LETHAL = -1, 98, 99, 100
# Entries of all windows of a sparse table, 256 MiB; where there would be more, large blocks take more windows.
_MAX_ENTRIES = 2**26
# Windows that are looked up at a time.
_WINDOWS_PER_BATCH = 2**18

Raster = Float[np.ndarray, "..."]
Window = Float[np.ndarray, "..."] | Float32[np.ndarray, "..."]
Extremes = tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]
Entries = Int[np.ndarray, "n rank"]


@dataclass(frozen=True, eq=False, init=False)
class RasterCost:
    """A cost map whose factors are given at the cells of a raster, of one to four axes.

    The raster's **last** axis runs along the first coordinate, and its first axis along the last one, as
    :class:`GridField` has it: ``values[row, column]`` is at ``(x, y)`` with ``x`` in that column and ``y`` in that
    row, row 0 at the lowest ``y``. Give ``values[::-1]`` of a picture, whose row 0 is at the top, and ``values.T`` of
    a table ``[x, y, ...]``.

    What is blocked is for the space to keep out, such as the one of :meth:`space`: there the factor is that of the
    nearest cell of the array which is not, so that between a blocked cell and its neighbors it stays finite. Outside
    the bounds it is that of the nearest place within, but around periodic axes, along which the last cells are
    neighbors of the first. Of configurations of more coordinates than the raster has axes the leading ones count:
    headings cost as positions do.

    Args:
        values: The factor at the center of each cell, from 1e-30 to 1e30; ``inf``, NaN or masked where it is blocked.
        bounds: The box that the cells fill, or its corners ``(lo, hi)``: of the outer cells, not of their centers.
        interpolation: ``"bilinear"``, multilinear between the centers of cells and constant in the outer halves of
            those at the bounds; or ``"nearest"``, constant in each cell, and at the border of two the upper one's.
            Bounds of the nearest one are wider, as over every box that touches a border both cells count.

    Attributes:
        values: As given, ``inf`` where blocked; read-only.
        domain: The box of the bounds.
        interpolation: The same.

    Raises:
        ValueError: If the values are no such numbers, all are blocked, the bounds are no box of as many dimensions,
            or the interpolation is another.
    """

    values: Float[np.ndarray, "..."]
    domain: Box
    interpolation: str
    _lethal: Bool[np.ndarray, "..."]  # the cells around which ``inflated`` raises costs

    def __init__(self, values: ArrayLike, bounds: Box | ArrayLike, interpolation: str = "bilinear"):
        domain = Box.of(bounds, "The bounds")
        if interpolation not in _INTERPOLATIONS:
            raise ValueError(f"interpolation must be 'bilinear' or 'nearest', got {shortened(interpolation)}.")
        expected = f"factors on a raster of {domain.dim} axes"
        factors = np.array(as_numbers("values", with_inf_for_masked(values), expected), order="C")
        if factors.ndim != domain.dim or factors.ndim > _MAX_AXES or factors.size == 0:
            raise ValueError(
                f"values must be {expected}, as the bounds have, {_MAX_AXES} at most, the last one along x, and at "
                f"least one, got shape {factors.shape}."
            )
        factors[np.isnan(factors)] = np.inf
        wrong = ~((factors >= _MIN_FACTOR) & (factors <= _MAX_FACTOR)) & (factors != np.inf)
        if wrong.any():
            cell = tuple(map(int, np.unravel_index(np.argmax(wrong), wrong.shape)))
            raise ValueError(
                f"values must be from {_MIN_FACTOR:g} to {_MAX_FACTOR:g}, and inf where a cell is blocked, got "
                f"{factors[cell]:g} at {cell}; of the bytes of a cost map use RasterCost.from_costmap."
            )
        if np.isinf(factors).all():
            raise ValueError(f"values must leave a cell that is not blocked, got {factors.shape} that all are.")
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
        """The cost map of a robot, as ROS's ``costmap_2d`` has it in bytes.

        A cost from 0 to 252 makes the factor ``1 + cost_travel_multiplier * cost / 252``: what the planner Smac 2D
        of Nav2 takes for a step of length 1. NavFn's is the same with a multiplier of 4.03, its ``50 + 0.8 * cost``
        over 50. Costs 253, of cells in which the robot's inscribed circle meets an obstacle, and 254, lethal, block.

        Args:
            values: The costs, from 0 to 255, row 0 at the lowest ``y``, as messages of ROS have them.
            bounds: As for the class.
            cost_travel_multiplier: How much more than a free cell the dearest one costs, at least 0.
            unknown_is_free: Whether 255, unknown, may be passed, as dear as 252, which is how NavFn takes it;
                else it blocks.
            interpolation: As for the class.

        Returns:
            The cost map.

        Raises:
            ValueError: If the values are not from 0 to 255, or as for the class.
        """
        multiplier = as_finite("cost_travel_multiplier", cost_travel_multiplier)
        costs = _in_range(values, 0, _UNKNOWN, "costs of costmap_2d; of an OccupancyGrid use from_occupancy_grid")
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
        """The cost map of a robot, as it is published: ROS's ``OccupancyGrid``.

        Args:
            values: -1 unknown, 0 free, 1 to 98 costs from 1 to 252, 99 inscribed, 100 lethal; row 0 at the lowest
                ``y``.
            bounds: As for the class.
            cost_travel_multiplier: As for :meth:`from_costmap`.
            unknown_is_free: As for :meth:`from_costmap`.
            interpolation: As for the class.

        Returns:
            The cost map.

        Raises:
            ValueError: If the values are not from -1 to 100, or as for the class.
        """
        grid = _in_range(values, _GRID_UNKNOWN, _GRID_LETHAL, "an OccupancyGrid's values; of bytes use from_costmap")
        costs = np.interp(grid, (0, 1, _GRID_MAX_COST), (0, 1, _MAX_COST))
        costs[grid >= _GRID_INSCRIBED] = _INSCRIBED
        costs[grid >= _GRID_LETHAL] = _LETHAL
        costs[grid < 0] = _UNKNOWN
        return cls.from_costmap(
            costs,
            bounds,
            cost_travel_multiplier=cost_travel_multiplier,
            unknown_is_free=unknown_is_free,
            interpolation=interpolation,
        )

    def inflated(
        self,
        inscribed_radius: float | int,
        *,
        inflation_radius: float | int = 0.55,
        cost_scaling_factor: float | int = 10.0,
        cost_travel_multiplier: float | int = 2.0,
    ) -> "RasterCost":
        """The cost map with higher costs around lethal cells, as the inflation layer of Nav2 makes them.

        Lethal are the costs 254 of :meth:`from_costmap` and 100 of :meth:`from_occupancy_grid`, and of other cost
        maps all blocked cells. Around cells that are blocked because they are unknown or inscribed, costs stay.

        A cell is blocked if its center is at most ``inscribed_radius`` from the center of a lethal cell, even where
        ``inflation_radius`` is less: then the space of a point is that of the robot. Up to ``inflation_radius`` its
        cost is at least
        ``252 * exp(-cost_scaling_factor * (distance - inscribed_radius))``. Factors follow from costs as in
        :meth:`from_costmap`, but costs are not rounded to bytes, as steps would widen the bounds.

        Args:
            inscribed_radius: Of the robot, in the units of the bounds, at least 0.
            inflation_radius: How far costs are raised, rounded up to whole cells as Nav2 does (of the shorter side
                where cells are not square).
            cost_scaling_factor: By what power of e they fall a unit of distance.
            cost_travel_multiplier: As for :meth:`from_costmap`.

        Returns:
            The cost map.

        Raises:
            ValueError: If a number is negative or not finite, or nothing is left that is not blocked.

        References:
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
        share = np.where(distance <= reach, np.exp(-scaling * np.maximum(distance - inscribed, 0.0)), 0.0)
        factors = np.where(distance <= inscribed, np.inf, np.maximum(self.values, 1 + multiplier * share))
        cost = RasterCost(factors, self.domain, self.interpolation)
        set_fields(cost, _lethal=self._lethal)
        return cost

    def __repr__(self) -> str:
        shape = " x ".join(map(str, self.values.shape))
        return f"RasterCost({shape} cells, {self.domain}, {self.interpolation!r})"

    @property
    def dim(self) -> int:
        """Number of axes."""
        return self.domain.dim

    @property
    def free(self) -> Bool[np.ndarray, "..."]:
        """Which cells are not blocked, in the order of the values."""
        return np.isfinite(self.values)

    def space(self, radius: float | int = 0.0) -> VoxelSpace:
        """The configuration space of what is not blocked.

        Args:
            radius: Of a disc or ball that keeps off what is blocked, in the units of the bounds; 0 for a point.

        Returns:
            The space, in the bounds; the cost of a motion is its length.

        Raises:
            ValueError: If the radius is no such number, or an axis is periodic.
        """
        return VoxelSpace(self.free.T, self.domain, radius)

    def __call__(self, q: ArrayLike) -> Rates:
        """The factor at configurations.

        Args:
            q: Configurations, ``(n, dof)``, of at least as many coordinates as the raster has axes.

        Returns:
            The factors, ``(n,)``; NaN where one of these coordinates is not finite.

        Raises:
            ValueError: If ``q`` has another shape.
        """
        q = self._leading_coordinates("q", q)
        factors = np.full(len(q), np.nan)
        known = np.flatnonzero(np.isfinite(q).all(axis=1))
        for begin in range(0, len(known), _POINTS_PER_BATCH):
            part = known[begin : begin + _POINTS_PER_BATCH]
            coords = self._cell_coordinates(q[part])
            coords = np.where(self.domain.periodic, coords % self._sizes, self._clipped(coords))
            factors[part] = self._interpolated(coords)
        return factors

    def bounds(self, lo: Vectors, hi: Vectors) -> tuple[Rates, Rates]:
        """Bounds of the factor over closed boxes, which may reach beyond the raster's.

        Args:
            lo: Lower corners, ``(n, dof)``, finite.
            hi: Upper corners, finite and nowhere below.

        Returns:
            The extremes, but for rounding outward (to 32 bits where more than a cell counts), of ``"nearest"``, where
            all cells count that the box touches, and of ``"bilinear"`` over boxes between at most four centers along
            each axis; over larger ones those of the cells whose centers surround the box.

        Raises:
            ValueError: If the shapes are others or differ, or corners are not those of boxes.
        """
        lo, hi = self._leading_coordinates("lo", lo), self._leading_coordinates("hi", hi)
        as_boxes(lo, hi, self.dim)
        first, last = self._rounded_outward(lo, hi)
        above = np.floor(last) if self.interpolation == "nearest" else np.ceil(last)
        least, most = np.empty(len(first)), np.empty(len(first))
        patches = np.maximum((above - np.floor(first)).max(axis=1), 1)
        is_large = (patches > _MAX_PATCHES) | (self.interpolation == "nearest")
        ends = (np.floor(first[is_large]).astype(np.intp), above[is_large].astype(np.intp))
        least[is_large], most[is_large] = self._table.extremes(*ends)
        for count in range(1, _MAX_PATCHES + 1):
            few = np.flatnonzero(~is_large & (patches == count))
            step = max(1, _POINTS_PER_BATCH // (count + 1) ** self.dim)
            for begin in range(0, len(few), step):
                part = few[begin : begin + step]
                factors = self._patch_corner_factors(first[part], last[part], count)
                least[part], most[part] = factors.min(axis=1), factors.max(axis=1)
        return (1 - _FACTOR_ROUNDING) * least, (1 + _FACTOR_ROUNDING) * most

    def _patch_corner_factors(self, first: Vectors, last: Vectors, count: int) -> Float[np.ndarray, "n breaks"]:
        """Factors at the corners of what boxes of coords cut out of patches between centers, up to so many an axis.

        Over each such part the factor is multilinear: its extremes are there.
        """
        lines = np.clip(np.floor(first)[:, None] + np.arange(count + 1)[:, None], first[:, None], last[:, None])
        which = np.array(list(product(range(count + 1), repeat=self.dim)))
        coords = lines[:, which, np.arange(self.dim)]
        return self._interpolated(coords.reshape(-1, self.dim)).reshape(coords.shape[:2])

    def _interpolated(self, coords: Vectors) -> Rates:
        """Factors at coords in cells, from the center of the first one or, for the nearest one, from its border."""
        below = np.floor(coords).astype(np.intp)
        if self.interpolation == "nearest":
            return self._cell_factors(below)
        beyond = coords - below
        total = np.zeros(len(coords))
        for corner in product((0, 1), repeat=self.dim):
            weights = (beyond[:, axis] if up else 1 - beyond[:, axis] for axis, up in enumerate(corner))
            total += reduce(np.multiply, weights) * self._cell_factors(below + corner)
        return total

    def _cell_factors(self, cell: Int[np.ndarray, "n dim"]) -> Rates:
        """Factors of cells, given by their numbers along each coordinate; around periodic axes, else the nearest."""
        modes: Any = tuple("wrap" if periodic else "clip" for periodic in self.domain.periodic)
        return self._filled_factors.take(np.ravel_multi_index(tuple(cell.T), self._filled_factors.shape, mode=modes))

    def _leading_coordinates(self, name: str, value: ArrayLike) -> Vectors:
        """The leading coordinates of configurations, as many as the raster has axes."""
        points = as_points(name, value)
        if points.shape[1] < self.dim:
            raise ValueError(f"{name} must have at least {self.dim} coordinates, as {self} has, got {points.shape}.")
        return points[:, : self.dim]

    def _cell_coordinates(self, q: Vectors) -> Vectors:
        """Where configurations are in cells, from the center of the first one, or for the nearest from its border."""
        coords = (q - self.domain.lo) / self.domain.width * self._sizes
        return coords if self.interpolation == "nearest" else coords - 0.5

    def _clipped(self, coords: Vectors) -> Vectors:
        return np.clip(coords, 0, self._sizes - 1)

    def _rounded_outward(self, lo: Vectors, hi: Vectors) -> tuple[Vectors, Vectors]:
        """Boxes as boxes of coords, larger by what rounding may have moved any place in them.

        Around periodic axes they begin in the first period, and are one long at most.
        """
        first, last = self._cell_coordinates(lo), self._cell_coordinates(hi)
        reach = _COORDINATE_ROUNDING * (self._sizes + np.maximum(np.abs(first), np.abs(last)))
        first, last = first - reach, last + reach
        turns = np.floor(first / self._sizes) * self._sizes
        is_whole = last - first >= self._sizes
        around = np.where(is_whole, 0, first - turns), np.where(is_whole, self._sizes, last - turns)
        within = self._clipped(first), self._clipped(last)
        first, last = (np.where(self.domain.periodic, *each) for each in zip(around, within, strict=True))
        return first, last

    @property
    def _sizes(self) -> Float[np.ndarray, "dim"]:
        """Numbers of cells along each coordinate."""
        return np.array(self.values.shape[::-1], np.float64)

    @property
    def _sides(self) -> Float[np.ndarray, "dim"]:
        """Sides of a cell along the raster's axes."""
        return (self.domain.width / self._sizes)[::-1]

    def _three_periods(self, cells: Bool[np.ndarray, "..."]) -> tuple[Bool[np.ndarray, "..."], tuple[slice, ...]]:
        """Three periods of cells along periodic axes, and where the middle one is."""
        wraps = self.domain.periodic[::-1]
        sizes = [size if periodic else 0 for size, periodic in zip(cells.shape, wraps, strict=True)]
        middle = tuple(slice(before, before + size) for before, size in zip(sizes, cells.shape, strict=True))
        return np.pad(cells, [(size, size) for size in sizes], mode="wrap"), middle

    @cached_property
    def _filled_factors(self) -> Float[np.ndarray, "..."]:
        """Factors in the order of coordinates, those of blocked cells filled."""
        factors = self.values
        if not self.free.all():
            around, middle = self._three_periods(~self.free)
            nearest: Any = ndimage.distance_transform_edt(
                around, sampling=self._sides, return_distances=False, return_indices=True
            )
            factors = factors[tuple(index[middle] % size for index, size in zip(nearest, factors.shape, strict=True))]
        return np.ascontiguousarray(factors.T)

    @cached_property
    def _table(self) -> "SparseTable":
        """Extremes of blocks of cells; around periodic axes, of two periods."""
        axes = zip(self._filled_factors.shape, self.domain.periodic, strict=True)
        more = [(0, size + 1 if periodic else 0) for size, periodic in axes]
        return SparseTable(
            np.pad(self._filled_factors, more, mode="wrap") if self.domain.is_periodic else self._filled_factors
        )


def _in_range(values: ArrayLike, least: int, most: int, what: str) -> Raster:
    expected = f"numbers from {least} to {most}, {what}"
    numbers = as_numbers("values", values, expected)
    wrong = ~((numbers >= least) & (numbers <= most))
    if wrong.any():
        raise ValueError(f"values must be {expected}, got {shortened(numbers[wrong][0].item())}.")
    return numbers


@dataclass(frozen=True, eq=False)
class SparseTable:
    """Extremes of blocks of an array of any rank, each the union of a few windows whose sides are powers of two.

    Of every place the table has the least and the largest entry in the window of each side that begins there, in 32
    bits, rounded outward. A block about as wide along every axis is covered by two windows an axis, a long one by
    more. Along an axis that is shorter than a window's side, the window is as long as the axis.

    Args:
        values: The entries, finite, of a size that 32 bits can tell.

    References:
        Bender and Farach-Colton, "The LCA problem revisited", 2000.
    """

    values: Raster

    def extremes(self, first: Entries, last: Entries) -> Extremes:
        """The least and the largest entry of blocks.

        Args:
            first: Their first entries along each axis, ``(n, rank)``.
            last: Their last ones, which count as well.

        Returns:
            The extremes, ``(n,)`` each: exact of entries that 32 bits hold, else up to a rounding outward.
        """
        least, most = np.empty(len(first)), np.empty(len(first))
        sides = np.array([side for side, _, _ in self._levels])
        level = np.count_nonzero((last - first + 1 >= sides[1:, None]).all(axis=2), axis=0)
        for each in np.unique(level):
            blocks = np.flatnonzero(level == each)
            counts = -(-(last - first + 1)[blocks] // sides[each])
            for part in parts(counts.prod(axis=1), _WINDOWS_PER_BATCH):
                which = blocks[part]
                least[which], most[which] = self._window_extremes(int(each), first[which], last[which], counts[part])
        return least, most

    def _window_extremes(self, level: int, first: Entries, last: Entries, counts: Entries) -> Extremes:
        """Extremes of blocks that are covered by so many windows of one level along each axis."""
        side, least, most = self._levels[level]
        totals = counts.prod(axis=1)
        block, rest = ragged_indices(totals)
        begin = np.empty((len(block), counts.shape[1]), np.intp)
        for axis in range(counts.shape[1]):
            rest, step = np.divmod(rest, counts[block, axis])
            begin[:, axis] = np.minimum(first[block, axis] + step * side[axis], last[block, axis] - side[axis] + 1)
        window = np.ravel_multi_index(tuple(begin.T), least.shape)
        starts = np.cumsum(totals) - totals
        return np.minimum.reduceat(least.take(window), starts), np.maximum.reduceat(most.take(window), starts)

    @cached_property
    def _levels(self) -> list[tuple[Int[np.ndarray, "rank"], Window, Window]]:
        """Sides of windows, and the least and the largest entry of those that begin at each place."""
        shape = np.array(self.values.shape)
        side, least, most = np.ones_like(shape), _as_float32(self.values, -np.inf), _as_float32(self.values, np.inf)
        levels, entries = [(side, self.values, self.values)], 0
        while (side < shape).any() and entries < _MAX_ENTRIES:
            step = np.minimum(side, shape - side)
            least, most = _merge_windows(np.minimum, least, step), _merge_windows(np.maximum, most, step)
            side, entries = side + step, entries + 2 * least.size
            levels.append((side, least, most))
        return levels


def _merge_windows(extreme: np.ufunc, windows: Window, step: Int[np.ndarray, "rank"]) -> Window:
    """Extremes of windows that are longer by a step along each axis, of two that overlap or touch."""
    for axis in np.flatnonzero(step):
        along = np.moveaxis(windows, axis, 0)
        windows = np.moveaxis(extreme(along[: -step[axis]], along[step[axis] :]), 0, axis)
    return np.ascontiguousarray(windows)


def _as_float32(values: Raster, toward: float) -> Float32[np.ndarray, "..."]:
    """Numbers in 32 bits, none moved but toward one side."""
    single = values.astype(np.float32)
    wrong = single < values if toward > 0 else single > values
    return np.where(wrong, np.nextafter(single, np.float32(toward)), single)
