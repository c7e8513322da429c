"""A box as queries know it, and how it is folded: in 32-bit floats."""

from enum import IntEnum
from typing import Literal, TypeAlias, cast, get_args

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import shortened
from plr_jax.geometry.box import Box
from plr_jax.plr.folding.folding import Folding
from plr_jax.plr.query.grid import FRACTION_BITS

LARGEST = 1e30  # of coordinates, distances and slopes: far enough from the end of 32-bit floats
_FAR = 4.0  # widths from the origin, beyond which 32-bit coordinates resolve a domain worse than its tables do

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
    lo, hi = domain.lo.astype(np.float32), domain.hi.astype(np.float32)
    return (
        np.where(lo > domain.lo, np.nextafter(lo, np.float32(-np.inf)), lo),
        np.where(hi < domain.hi, np.nextafter(hi, np.float32(np.inf)), hi),
    )


def inner_corners(box: Box) -> Float[np.ndarray, "2 dim"]:
    """Corners of a box as 32-bit floats, rounded inward."""
    lo, hi = box.lo.astype(np.float32), box.hi.astype(np.float32)
    lo = np.where(lo < box.lo, np.nextafter(lo, np.float32(np.inf)), lo)
    return np.stack([lo, np.where(hi > box.hi, np.nextafter(hi, np.float32(-np.inf)), hi)])


def frame_of(domain: Box) -> Float[np.ndarray, "7 dim"]:
    """The domain in 32-bit floats."""
    lo, hi = table_corners(domain)
    # Rounded toward zero, so that the corners themselves stay inside.
    rest = np.nextafter(np.stack([domain.lo - lo, hi - domain.hi]).astype(np.float32), np.float32(-1))
    frame = np.empty((len(Frame), domain.dim), np.float32)
    frame[Frame.LO], frame[Frame.HI] = lo, hi
    frame[Frame.LO_REST], frame[Frame.HI_REST] = np.maximum(rest, 0)
    frame[Frame.START], frame[Frame.SCALE] = 1 - (domain.lo - lo) / domain.width, 1 / domain.width
    top = 2 - 2.0**-FRACTION_BITS - frame[Frame.START].astype(np.float64)
    rounded = top.astype(np.float32)
    frame[Frame.TOP] = np.where(rounded > top, np.nextafter(rounded, np.float32(0)), rounded)
    return frame


def corner_if_far(domain: Box) -> Corner | None:
    """The lower corner of a domain that is far from the origin along some axis; else None."""
    is_far = np.maximum(np.abs(domain.lo), np.abs(domain.hi)) > _FAR * domain.width
    return domain.lo if is_far.any() else None


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
