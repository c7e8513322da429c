"""Axis-aligned boxes, such as the bounds of a workspace or the domain of a PLR, and 2-D slices of them."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float

from plr_jax import _arrays
from plr_jax._arrays import shortened
from plr_jax._types import ArrayLike

FreeFn: TypeAlias = Callable[[Float[np.ndarray, "n dim"]], ArrayLike]  # whether each point is free, (n,)
_TIE = 1 - 2.0**-40  # keeps rounding from moving a point that is exactly half a period away


@dataclass(frozen=True, eq=False)
class Box:
    """A closed axis-aligned box ``[lo, hi]``. Its width along every axis must be positive, else ``ValueError``.

    Along a *periodic* axis, such as an angle, coordinates count modulo the box's width, which is the *period*. Both
    ends of such an axis are the same place, the *seam*, and every finite coordinate lies in the box.

    Args:
        lo: Lower corner, ``(dim,)``, finite.
        hi: Upper corner, ``(dim,)``, finite and above ``lo`` along every axis.
        periodic: Whether each axis is periodic, one bool per axis. None: no axis is.
    """

    lo: Float[np.ndarray, "dim"]
    hi: Float[np.ndarray, "dim"]
    periodic: tuple[bool, ...]

    def __init__(self, lo: ArrayLike, hi: ArrayLike, periodic: ArrayLike | None = None):
        lo, hi = _arrays.as_finite_point("Box lo", lo), _arrays.as_finite_point("Box hi", hi)
        if lo.shape != hi.shape:
            raise ValueError(f"Box corners must have equal length, got lo of {lo.size} and hi of {hi.size} numbers.")
        if (is_flat := hi <= lo).any():
            axis = is_flat.argmax()
            got = f"lo={lo[axis]:g} and hi={hi[axis]:g} on axis {axis}"
            raise ValueError(f"Box must have positive width along every axis, got {got}.")
        axes = (False,) * lo.size if periodic is None else periodic
        axes = tuple(axes) if isinstance(axes, Iterable) else (axes,)
        if len(axes) != lo.size:
            raise ValueError(f"Box periodic must be {lo.size} bools, one per axis, got {shortened(periodic)}.")
        periodic = tuple(_arrays.as_bool("Each of Box periodic", axis) for axis in axes)
        _arrays.set_fields(self, lo=lo, hi=hi, periodic=periodic)

    @classmethod
    def of(cls, value: "Box | ArrayLike", name: str = "The box") -> "Box":
        """Return a Box unchanged, or build a Box from its corners ``(lo, hi)``; errors call the value ``name``."""
        if isinstance(value, Box):
            return value
        try:
            lo, hi = value
            len(lo)
        except (TypeError, ValueError):
            raise ValueError(f"{name} must be a Box or its corners (lo, hi), got {shortened(value)}.") from None
        return cls(lo, hi)

    @property
    def dim(self) -> int:
        """Number of axes."""
        return self.lo.size

    @property
    def width(self) -> Float[np.ndarray, "dim"]:
        """Edge length along each axis, ``(dim,)``."""
        return self.hi - self.lo

    def at(self, fraction: Float[np.ndarray, "*n axes"]) -> Float[np.ndarray, "*n dim"]:
        """Return the points ``lo + fraction * width``.

        Fractions have shape ``(..., dim)``, or ``(..., 1)`` if they are equal along all axes.
        """
        # All faces of cells and voxels come from this formula, so that equal faces are equal to the bit.
        return np.where(fraction == 1, self.hi, self.lo + self.width * fraction)

    @property
    def is_periodic(self) -> bool:
        """Whether any axis is periodic."""
        return any(self.periodic)

    @property
    def in_single(self) -> tuple[Float[np.ndarray, "dim"], Float[np.ndarray, "dim"]]:
        """Lower and upper corner as 32-bit floats, rounded outward: points of the box stay inside when rounded."""
        lo, hi = self.lo.astype(np.float32), self.hi.astype(np.float32)
        lo = np.where(lo > self.lo, np.nextafter(lo, np.float32(-np.inf)), lo)
        return lo, np.where(hi < self.hi, np.nextafter(hi, np.float32(np.inf)), hi)

    @property
    def single_rests(self) -> Float[np.ndarray, "2 dim"]:
        """Distances, ``(2, dim)``, of the corners :attr:`in_single` below ``lo`` and above ``hi``, rounded down."""
        lo, hi = self.in_single
        rests = np.nextafter(np.stack([self.lo - lo, hi - self.hi]).astype(np.float32), np.float32(-1))
        return np.maximum(rests, np.float32(0))

    def settled(self, x: ArrayLike, is_free: FreeFn | None = None, reach: float = 0.0) -> ArrayLike:
        """Move 32-bit points ``(..., dim)`` that rounding alone has put outside the box or into obstacles.

        A free point beside a wall, rounded to 32 bits, may lie in the wall. So if a point of 32-bit floats is not
        free, points that differ from it by one step along some axes are tried, and the first free point replaces it.
        A step is the spacing of 32-bit floats at the coordinate or, if larger, at ``reach``, the size of a body at
        the point. Without ``is_free``, all points of the box are free.

        Points of another type or shape, also 64-bit points, are returned unchanged. Other results are 64-bit floats.
        """
        if not _arrays.is_single(x) or np.shape(x)[-1:] != (self.dim,):
            return x
        single, (lo, hi) = np.asarray(x), self.in_single
        x = np.where((lo <= single) & (single <= hi), np.clip(single.astype(np.float64), self.lo, self.hi), single)
        if is_free is None:
            return x
        moved = x.reshape(-1, self.dim).copy()
        steps = np.spacing(np.maximum(np.abs(single), np.float32(reach))).reshape(-1, self.dim)
        pending = np.flatnonzero(np.isfinite(moved).all(axis=1))
        # Try the point itself, then points with one coordinate moved by a step, then two, ..., until one is free.
        for signs in sorted(product((0, 1, -1), repeat=self.dim), key=np.count_nonzero):
            if not len(pending):
                break
            candidates = x.reshape(-1, self.dim)[pending] + signs * steps[pending]
            free = _arrays.as_booleans("is_free", is_free(candidates), len(candidates))
            moved[pending[free]], pending = candidates[free], pending[~free]
        return moved.reshape(x.shape)

    def moved(self, by: ArrayLike) -> "Box":
        """Return the box translated by a vector ``(dim,)``."""
        return Box(self.lo + by, self.hi + by, self.periodic)

    def contains(self, x: ArrayLike) -> Bool[np.ndarray, " n"]:
        """Return whether points ``(n, dim)`` lie in the box.

        Along periodic axes, every finite coordinate lies in the box. NaN never does.
        """
        x = _arrays.as_points("x", x, self.dim)
        inside = (self.lo <= x) & (x <= self.hi)
        if self.is_periodic:
            inside |= np.array(self.periodic) & np.isfinite(x)
        return np.all(inside, axis=1)

    def wrapped(self, x: ArrayLike) -> Float[np.ndarray, "*batch dim"]:
        """Move coordinates of points ``(..., dim)`` along periodic axes by whole periods into ``[lo, hi)``.

        Infinite coordinates and NaN are not moved. A moved coordinate within rounding errors of the seam becomes
        ``lo``.
        """
        x = wrapped = self._points("x", x)
        for axis in np.flatnonzero(self.periodic):
            lo, hi, column = self.lo[axis], self.hi[axis], x[..., axis]
            if column.size and not (lo <= column.min() and column.max() < hi):
                wrapped = x.copy() if wrapped is x else wrapped
                outside = np.isfinite(column) & ((column < lo) | (column >= hi))
                column, period = column[outside], hi - lo
                # `above` is the distance above ``lo``, modulo the period; the remainder by `fmod` is exact.
                above = np.mod(np.fmod(column, period) - lo, period)
                rounding = 2 * np.spacing(np.maximum(np.abs(column), max(abs(lo), abs(hi))))
                is_at_seam = (np.minimum(above, period - above) <= rounding) | (lo + above >= hi)
                wrapped[outside, axis] = np.where(is_at_seam, lo, lo + above)
        return wrapped

    def image_near(self, x: ArrayLike, reference: ArrayLike) -> Float[np.ndarray, "*batch dim"]:
        """Move points ``(..., dim)`` by whole periods along periodic axes to be nearest to the points ``reference``.

        All points must be finite; the two shapes broadcast.
        """
        x, reference = self._points("x", x), self._points("reference", reference)
        if not self.is_periodic:
            return np.broadcast_arrays(x, reference)[0]
        # Subtract the number of whole periods in the difference, rounded.
        return x - self.width * np.where(self.periodic, np.rint(_TIE * (x - reference) / self.width), 0.0)

    def difference(self, a: ArrayLike, b: ArrayLike) -> Float[np.ndarray, "*batch dim"]:
        """Return ``a - b`` for finite points ``(..., dim)``, the short way around periodic axes."""
        return self.image_near(a, b) - np.asarray(b, np.float64)

    def _points(self, name: str, value: ArrayLike) -> Float[np.ndarray, "*batch dim"]:
        points = _arrays.as_numbers(name, value, f"numbers of shape (..., {self.dim})")
        if points.shape[-1:] != (self.dim,):
            raise ValueError(f"{name} must have shape (..., {self.dim}), got {points.shape}.")
        return points

    def grid(self, resolution: int) -> Float[np.ndarray, "rows columns 2"]:
        """Return the centers, ``(rows, columns, 2)``, of nearly square cells that fill a 2-D box, lowest row first.

        The longer side of the box has ``resolution`` cells; the shorter side has at most as many, but at least one.
        """
        if self.dim != 2:
            raise ValueError(f"A grid of rows and columns needs a box of 2 dimensions, got {self.dim}.")
        _arrays.require_integer("resolution", resolution, 1)
        counts = np.maximum(1, np.rint(resolution * self.width / self.width.max())).astype(int)
        along = zip(self.lo, self.width, counts, strict=True)
        return np.stack(np.meshgrid(*(lo + width * (np.arange(n) + 0.5) / n for lo, width, n in along)), axis=-1)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Box) or self.periodic != other.periodic:
            return False
        return np.array_equal(self.lo, other.lo) and np.array_equal(self.hi, other.hi)

    def __hash__(self) -> int:
        return hash((self.lo.tobytes(), self.hi.tobytes(), self.periodic))

    def __repr__(self) -> str:
        return self._written(self.lo.tolist(), self.hi.tolist())

    def __str__(self) -> str:
        return self._written(_arrays.format_numbers(self.lo), _arrays.format_numbers(self.hi))

    def _written(self, lo: list[float], hi: list[float]) -> str:
        periodic = f", periodic={self.periodic}" if self.is_periodic else ""
        return f"Box({lo}, {hi}{periodic})"


class Slice(NamedTuple):
    """A 2-D slice of a box: coordinates along the two ``axes`` vary, all other coordinates are those of ``at``."""

    domain: Box
    axes: tuple[int, int]
    at: Float[np.ndarray, " dim"]

    @classmethod
    def of(cls, domain: Box, at: Mapping[int, float | int] | None) -> "Slice":
        """Return a slice of the box ``domain``: ``at`` maps each fixed axis to its coordinate, the other two vary."""
        at = {} if at is None else at
        are_axes = isinstance(at, Mapping) and set(at) <= set(range(domain.dim))
        if not are_axes or any(isinstance(axis, bool | float | np.floating) for axis in at):
            raise ValueError(f"at must map axes to coordinates, such as {{2: 0.5}}, got {shortened(at)}.")
        shown = [axis for axis in range(domain.dim) if axis not in at]
        if len(shown) != 2:
            expected = f"at must fix {domain.dim - 2} of {domain.dim} coordinates"
            raise ValueError(f"A picture has two axes, so {expected}, got {len(at)}.")
        point = (domain.lo + domain.hi) / 2
        point[list(at)] = _arrays.as_finite_point("The coordinates of at", list(at.values())) if at else []
        if not domain.contains(point[None])[0]:
            raise ValueError(f"at must lie in {domain}, got {shortened(dict(at))}.")
        return cls(domain, (shown[0], shown[1]), domain.wrapped(point))

    @property
    def box(self) -> Box:
        axes = list(self.axes)
        return Box(self.domain.lo[axes], self.domain.hi[axes], [self.domain.periodic[axis] for axis in axes])

    def grid(self, resolution: int) -> Float[np.ndarray, "rows columns dim"]:
        """Return the centers of nearly square cells that fill the slice, as points of ``domain``.

        The cells are those of :meth:`Box.grid`.
        """
        centers = self.box.grid(resolution)
        points = np.broadcast_to(self.at, (*centers.shape[:2], self.domain.dim)).copy()
        points[..., list(self.axes)] = centers
        return points
