"""The frame that all readers of a PLR share: its domain in 32-bit floats, and mirrors of points of the domain."""

from enum import IntEnum
from typing import Literal, TypeAlias, cast, get_args

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import require_choice
from plr_jax.geometry.box import Box
from plr_jax.plr.folding import Folding

FRACTION_BITS = 23  # mantissa bits of a 32-bit float
WORD_BITS = 32

# How far from the origin a domain may be.
_FAR = 4.0  # a domain is far beyond this many widths from the origin: 32-bit coordinates are coarser than its tables
# Least number of 32-bit floats along an axis of the domain, by type of the points. With fewer, 32-bit points are off
# by more than 1e-4 widths, as much as a distance in a small file errs, and tables of 64-bit points are wrong.
_FEWEST_PLACES = {"float32": 2**12, "float64": 1 / 256}
LARGEST = 1e30  # bound of coordinates, distances and slopes, well below the largest 32-bit float

# A point, such as the domain's lower corner, relative to which other points are given.
Corner: TypeAlias = Float[np.ndarray, " dim"]
# For each mirror, its *pivot* axis and all axes that it reverses; it mirrors points of negative pivot coordinate.
Mirrors: TypeAlias = tuple[tuple[int, tuple[int, ...]], ...]
Outside: TypeAlias = Literal["inf", "clamp", "nan"]
"""Answer to a query outside the domain; ``"clamp"``: the value at the nearest point plus the distance to it."""


def as_outside(outside: str) -> Outside:
    require_choice("outside", outside, get_args(Outside))
    return cast(Outside, outside)


class Frame(IntEnum):
    """The rows of an array ``(7, dim)`` that describes a domain in 32-bit floats.

    To locate a point ``x`` of the domain, a query computes ``(x - LO) * SCALE + START``, a float at least 1 and below
    2. The mantissa bits of this float are the point's position, a binary fraction of the domain's width.
    """

    LO = 0  # lower corner, rounded outward
    HI = 1
    LO_REST = 2  # distance from LO to the exact corner, at least 0
    HI_REST = 3
    START = 4  # 1 - LO_REST / width
    SCALE = 5  # 1 / width
    TOP = 6  # largest fraction of the width for which TOP + START stays below 2


def table_corners(domain: Box) -> tuple[Float[np.ndarray, " dim"], Float[np.ndarray, " dim"]]:
    """Return the domain's corners as 32-bit floats, rounded outward."""
    if np.abs([domain.lo, domain.hi]).max() > LARGEST or domain.width.min() < 1 / LARGEST:
        expected = f"coordinates must be below {LARGEST:g} and its width above {1 / LARGEST:g}"
        raise ValueError(f"A domain's {expected}, got {domain}.")
    return domain.in_single


def is_far(domain: Box) -> bool:
    """Return whether an end of the domain is more than four times its width from the origin along some axis."""
    return bool((_largest_coordinates(domain) > _FAR * domain.width).any())


def unresolved_types(domain: Box) -> tuple[str, ...]:
    """Return the names of float types, such as "float32", that are too coarse to tell points of the domain apart."""
    apart = np.spacing(_largest_coordinates(domain).astype(np.float32)).astype(np.float64)
    places = (domain.width / apart).min()  # 32-bit floats along the axis with the fewest
    return tuple(dtype for dtype, fewest in _FEWEST_PLACES.items() if places < fewest)


def require_resolved(dtype: np.dtype, unresolved: tuple[str, ...]) -> None:
    if str(dtype) in unresolved:
        also = " or enable jax_enable_x64," if unresolved == ("float32",) else ""
        got = f"{dtype} points, or 32-bit tables, are too coarse this far out"
        advice = f"Pass NumPy float64 points outside of jit,{also} or build the PLR in coordinates with an origin"
        raise ValueError(f"Points must resolve the domain, but {got}. {advice} nearby.")


def _largest_coordinates(domain: Box) -> Corner:
    return np.maximum(np.abs(domain.lo), np.abs(domain.hi))


def in_parts(corners: Float[np.ndarray, "n dim"]) -> Float[np.ndarray, "n 3 dim"]:
    """Split each 64-bit coordinate into three 32-bit floats whose sum is the coordinate."""
    first = corners.astype(np.float32)
    second = (corners - first).astype(np.float32)
    return np.stack([first, second, (corners - first - second).astype(np.float32)], axis=1)


def frame_of(domain: Box) -> Float[np.ndarray, "7 dim"]:
    """Return the array ``(7, dim)`` that describes a domain to a query; :class:`Frame` explains its rows."""
    frame = np.empty((len(Frame), domain.dim), np.float32)
    frame[Frame.LO], frame[Frame.HI] = table_corners(domain)
    frame[Frame.LO_REST], frame[Frame.HI_REST] = domain.single_rests
    frame[Frame.START] = 1 - (domain.lo - frame[Frame.LO]) / domain.width
    frame[Frame.SCALE] = 1 / domain.width
    # The largest float below 2 is 2 - 2**-23. TOP is rounded down.
    top = 2 - 2.0**-FRACTION_BITS - frame[Frame.START].astype(np.float64)
    rounded = top.astype(np.float32)
    frame[Frame.TOP] = np.where(rounded > top, np.nextafter(rounded, np.float32(0)), rounded)
    return frame


def corner_if_far(domain: Box) -> Corner | None:
    """Return the domain's lower corner if the domain is far from the origin (:func:`is_far`); else None.

    Lookup tables of far domains take points relative to this corner.
    """
    return domain.lo if is_far(domain) else None


def folding_numbers(
    folding: Folding, origin: Corner
) -> tuple[Float[np.ndarray, "2 dim"], Float[np.ndarray, "2 dim"], Float[np.ndarray, "dim dim"] | None, Mirrors]:
    """Return a folding's center, corners, axes and mirrors in 32-bit floats, for points relative to ``origin``.

    The center is the sum of two rows of floats. The corners are the ends of the box of folded points: infinite along
    periodic axes, else rounded inward. Axes are None if the folding does not rotate points. A mirror is a pair: its
    *pivot* axis, and all axes that it reverses. It is applied to points whose coordinate along the pivot is negative.
    """
    exact = folding.center - origin
    center = exact.astype(np.float32)
    box = folding.box
    lo, hi = box.lo.astype(np.float32), box.hi.astype(np.float32)
    lo = np.where(lo < box.lo, np.nextafter(lo, np.float32(np.inf)), lo)
    hi = np.where(hi > box.hi, np.nextafter(hi, np.float32(-np.inf)), hi)
    reversed_axes = [tuple(map(int, np.flatnonzero(mirror))) for mirror in folding.mirrors]
    centers = np.stack([center, exact - center]).astype(np.float32)
    corners = np.where(folding.domain.periodic, np.array([[-np.inf], [np.inf]], np.float32), [lo, hi])
    axes = folding.axes.astype(np.float32) if folding.is_turned else None
    return centers, corners, axes, tuple(zip(folding.pivots, reversed_axes, strict=True))
