"""A box as queries know it, and how it is folded: in 32-bit floats."""

from enum import IntEnum
from typing import Literal, TypeAlias, cast, get_args

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import shortened
from plr_jax.geometry.box import Box
from plr_jax.plr.folding.folding import Folding
from plr_jax.plr.query.grid import FRACTION_BITS

_FAR = 4.0  # widths from the origin, beyond which 32-bit coordinates resolve a domain worse than its tables do
_FEWEST_PLACES = {"float32": 64, "float64": 1 / 256}  # that 32-bit floats tell apart in a domain, or tables are wrong
LARGEST = 1e30  # of coordinates, distances and slopes: far enough from the end of 32-bit floats

Corner: TypeAlias = Float[np.ndarray, "dim"]
"""From where coordinates are counted."""

Outside: TypeAlias = Literal["inf", "clamp", "nan"]
"""What a query answers outside the domain.

``"clamp"`` is the value at the nearest point of the domain, and how far that is.
"""


def as_outside(outside: str) -> Outside:
    """One of them, or ``ValueError``."""
    if outside not in get_args(Outside):
        raise ValueError(f"outside must be 'inf', 'clamp' or 'nan', got {shortened(outside)}.")
    return cast(Outside, outside)


class Frame(IntEnum):
    """Rows of a frame: the domain in 32-bit floats.

    ``LO`` and ``HI`` are its corners, rounded outward, ``LO_REST`` and ``HI_REST`` by how much, and ``SCALE`` is one
    over its width. ``START`` is one minus ``LO_REST`` over the width: cells far from the origin so stay in place.
    ``TOP`` is the largest share of the width that is told apart: with ``START`` it is below 2.
    """

    LO = 0
    HI = 1
    LO_REST = 2
    HI_REST = 3
    START = 4
    SCALE = 5
    TOP = 6


def table_corners(domain: Box) -> tuple[Float[np.ndarray, "dim"], Float[np.ndarray, "dim"]]:
    """Corners of the domain as 32-bit floats, rounded outward so that no point of the domain falls out of it.

    Raises:
        ValueError: If 32-bit floats cannot hold the corners or the width.
    """
    if np.abs([domain.lo, domain.hi]).max() > LARGEST or domain.width.min() < 1 / LARGEST:
        raise ValueError(f"The domain must be within {LARGEST:g}, and wider than its inverse, got {domain}.")
    return domain.in_single


def is_far(domain: Box) -> bool:
    """Whether a domain is far from the origin, along some axis."""
    return bool((_largest_coordinates(domain) > _FAR * domain.width).any())


def unresolved_types(domain: Box) -> tuple[str, ...]:
    """Types of points that tables of a domain cannot answer, as it is too far from the origin."""
    apart = np.spacing(_largest_coordinates(domain).astype(np.float32)).astype(np.float64)
    places = (domain.width / apart).min()
    return tuple(dtype for dtype, fewest in _FEWEST_PLACES.items() if places < fewest)


def require_resolved(dtype: np.dtype, unresolved: tuple[str, ...]) -> None:
    """Raises ``ValueError`` for points of a type that is not resolved."""
    if str(dtype) in unresolved:
        also = " or enable jax_enable_x64," if unresolved == ("float32",) else ""
        raise ValueError(
            f"The domain is so far from the origin that {dtype} points, or 32-bit tables, cannot tell places in it "
            f"apart. Give NumPy's float64 points, outside of compiled functions,{also} or build it in coordinates "
            "whose origin is near."
        )


def _largest_coordinates(domain: Box) -> Corner:
    return np.maximum(np.abs(domain.lo), np.abs(domain.hi))


def in_parts(corners: Float[np.ndarray, "n dim"]) -> Float[np.ndarray, "n 3 dim"]:
    """Numbers of 64 bits as sums of three of 32."""
    first = corners.astype(np.float32)
    second = (corners - first).astype(np.float32)
    return np.stack([first, second, (corners - first - second).astype(np.float32)], axis=1)


def inner_corners(box: Box) -> Float[np.ndarray, "2 dim"]:
    """Corners of a box as 32-bit floats, rounded inward."""
    lo, hi = box.lo.astype(np.float32), box.hi.astype(np.float32)
    lo = np.where(lo < box.lo, np.nextafter(lo, np.float32(np.inf)), lo)
    return np.stack([lo, np.where(hi > box.hi, np.nextafter(hi, np.float32(-np.inf)), hi)])


def frame_of(domain: Box) -> Float[np.ndarray, "7 dim"]:
    """The domain in 32-bit floats."""
    lo, hi = table_corners(domain)
    frame = np.empty((len(Frame), domain.dim), np.float32)
    frame[Frame.LO], frame[Frame.HI] = lo, hi
    frame[Frame.LO_REST], frame[Frame.HI_REST] = domain.single_rests
    frame[Frame.START], frame[Frame.SCALE] = 1 - (domain.lo - lo) / domain.width, 1 / domain.width
    top = 2 - 2.0**-FRACTION_BITS - frame[Frame.START].astype(np.float64)
    rounded = top.astype(np.float32)
    frame[Frame.TOP] = np.where(rounded > top, np.nextafter(rounded, np.float32(0)), rounded)
    return frame


def corner_if_far(domain: Box) -> Corner | None:
    """The lower corner of a domain that is far from the origin along some axis; else None."""
    return domain.lo if is_far(domain) else None


def folding_numbers(
    folding: Folding, origin: Corner
) -> tuple[Float[np.ndarray, "2 dim"], Float[np.ndarray, "2 dim"]]:
    """A folding's center in 32-bit floats with what they leave of it, and the corners of the box of folded points.

    The center is counted from an origin. The corners are rounded inward, as what is clipped to others would still be
    outside, and infinite along periodic axes.
    """
    exact = folding.center - origin
    center = exact.astype(np.float32)
    endless = np.array([[-np.inf], [np.inf]], np.float32)
    return (
        np.stack([center, exact - center]).astype(np.float32),
        np.where(folding.domain.periodic, endless, inner_corners(folding.box)),
    )


def mirrored_axes(folding: Folding) -> tuple[tuple[int, tuple[int, ...]], ...]:
    """For each mirror its pivot, and the axes that it reverses."""
    reversed_axes = [tuple(map(int, np.flatnonzero(mirror))) for mirror in folding.mirrors]
    return tuple(zip(folding.pivots, reversed_axes, strict=True))
