"""A box as queries know it, in 32-bit floats, and how large the tables of a query are. Nothing here needs JAX."""

from enum import IntEnum
from typing import Literal, TypeAlias, cast, get_args

import numpy as np
from jaxtyping import Float, Int

from plr_jax._arrays import ragged_indices, shortened
from plr_jax.geometry.box import Box
from plr_jax.plr.folding import Folding
from plr_jax.plr.tree import Cells

FRACTION_BITS = 23  # of a 32-bit float
WORD_BITS = 32
MIN_CLASS = 8
_SLOT_BITS = ((2**10, 14), (2**12, 16))  # of flat tables with up to so many rows; beyond, MAX_FLAT_BITS
MOST_ROWS = 2**14  # of a class whose tables are of one shape
MAX_FLAT_BITS = 18  # a flat table of 16-bit leaves then fits a core's second-level cache
_DEEP_BITS = 28  # of a point's place in all, beyond the classes above
_PAGED_DEPTH = 13  # along an axis, so that blocks and the page of a deepest leaf stay small
_MAX_BITS_BEYOND_CLASS, _LEAST_ENTRIES_BITS, _MOST_ENTRIES_BITS = 9, 20, 27


def block_shapes(cells: Cells, block_bits: Int[np.ndarray, "dim"]) -> Int[np.ndarray, "blocks dim"]:
    """Bits of every block's own table: the deepest split below the block among the leaves it meets."""
    below = np.maximum(cells.depth - block_bits, 0)
    leaf, block = leaves_in_blocks(cells, block_bits)
    shape = np.zeros((1 << block_bits.sum(), cells.dim), np.int64)
    np.maximum.at(shape, row_major(block, block_bits), below[leaf])
    return shape


def num_pairs(cells: Cells, block_bits: Int[np.ndarray, "dim"]) -> float:
    """How many pairs of a leaf and a block meet."""
    return np.sum(2.0 ** np.maximum(block_bits - cells.depth, 0).sum(axis=1))


def slots_in_blocks(
    cells: Cells, block_bits: Int[np.ndarray, "dim"], shape: Int[np.ndarray, "blocks dim"]
) -> tuple[
    Int[np.ndarray, "pairs"], Int[np.ndarray, "pairs"], Int[np.ndarray, "pairs dim"], Int[np.ndarray, "pairs dim"]
]:
    """All pairs of a leaf and a block that meet: their indices, the leaf's first slot in the block, and how many."""
    leaf, block = leaves_in_blocks(cells, block_bits)
    index = row_major(block, block_bits)
    below = np.maximum(cells.depth[leaf] - block_bits, 0)
    first = (cells.position[leaf] & ((np.int64(1) << below) - 1)) << (shape[index] - below)
    return leaf, index, first, np.int64(1) << (shape[index] - below)


def leaves_in_blocks(
    cells: Cells, block_bits: Int[np.ndarray, "dim"]
) -> tuple[Int[np.ndarray, "pairs"], Int[np.ndarray, "pairs dim"]]:
    """All pairs of a leaf and a block that meet: the leaf's index and the block's, along each axis."""
    first = np.where(
        cells.depth >= block_bits,
        cells.position >> np.maximum(cells.depth - block_bits, 0),
        cells.position << np.maximum(block_bits - cells.depth, 0),
    )
    return enumerate_boxes(first, np.int64(1) << np.maximum(block_bits - cells.depth, 0))


def enumerate_boxes(
    first: Int[np.ndarray, "boxes dim"], count: Int[np.ndarray, "boxes dim"]
) -> tuple[Int[np.ndarray, "points"], Int[np.ndarray, "points dim"]]:
    """Integer points of many boxes: the box's index and the point, for each."""
    box, rest = ragged_indices(count.prod(axis=1))
    points = np.empty((len(box), first.shape[1]), np.int64)
    for axis in reversed(range(first.shape[1])):
        rest, digit = np.divmod(rest, count[box, axis])
        points[:, axis] = first[box, axis] + digit
    return box, points


def spread_bits(bits: Int[np.ndarray, "dim"], most: int) -> Int[np.ndarray, "dim"]:
    """Up to so many bits, each along the axis with the most bits left."""
    chosen = np.zeros_like(bits)
    while chosen.sum() < min(most, bits.sum()):
        chosen[np.argmax(bits - chosen)] += 1
    return chosen


def row_major(
    slots: Int[np.ndarray, "n dim"], bits: Int[np.ndarray, "n dim"] | Int[np.ndarray, "dim"]
) -> Int[np.ndarray, "n"]:
    """Index of each slot in a table of ``2**bits`` slots along the axes."""
    index = np.zeros(len(slots), np.int64)
    for axis in range(slots.shape[1]):
        index = (index << bits[..., axis]) | slots[:, axis]
    return index


def byte_class(num_bytes: int) -> int:
    """The smallest exponent of a power of two that is at least so many bytes."""
    return max(MIN_CLASS, (num_bytes - 1).bit_length())


def rows_of_class(of_class: int, least_bytes: int | float) -> int:
    """Leaves for which the tables of a class have room, where a leaf takes so many bytes at the least."""
    return int((1 << of_class) / least_bytes)


def slot_bits_of_rows(rows: int) -> int:
    """Bits of the flat table of a class that has room for so many leaves."""
    return next((bits for most, bits in _SLOT_BITS if rows <= most), MAX_FLAT_BITS)


def max_axis_depth(dim: int, of_class: int | None, least_bytes: int | float, is_deep: bool) -> int:
    """How often a cell may be halved along one axis, for a class of files or for any.

    In the plane and on a line the slots of a class of up to ``MOST_ROWS`` suffice; trees that are to be deep, as of
    leaf models with pages or for a proof, may go as far as pages do. Else the tables' size is bounded.
    """
    rows = None if of_class is None else rows_of_class(of_class, least_bytes)
    if rows is None or rows > MOST_ROWS or dim > 2:
        return max(1, min(MAX_FLAT_BITS, _DEEP_BITS // dim))
    return max(slot_bits_of_rows(rows) // dim, _PAGED_DEPTH if is_deep else 0)


def max_entries(num_bytes: int) -> int:
    """Entries that the tables of a file of so many bytes may have: they bound what loading it takes."""
    bits = byte_class(num_bytes) + _MAX_BITS_BEYOND_CLASS
    return 1 << min(max(bits, _LEAST_ENTRIES_BITS), _MOST_ENTRIES_BITS)


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
    box = folding.box
    lo, hi = box.lo.astype(np.float32), box.hi.astype(np.float32)
    lo = np.where(lo < box.lo, np.nextafter(lo, np.float32(np.inf)), lo)
    hi = np.where(hi > box.hi, np.nextafter(hi, np.float32(-np.inf)), hi)
    endless = np.array([[-np.inf], [np.inf]], np.float32)
    return (
        np.stack([center, exact - center]).astype(np.float32),
        np.where(folding.domain.periodic, endless, [lo, hi]),
    )


def mirrored_axes(folding: Folding) -> tuple[tuple[int, tuple[int, ...]], ...]:
    """For each mirror its pivot, and the axes that it reverses."""
    reversed_axes = [tuple(map(int, np.flatnonzero(mirror))) for mirror in folding.mirrors]
    return tuple(zip(folding.pivots, reversed_axes, strict=True))
