"""Lookup tables: from a point to its leaf by arithmetic, not by descending a tree.

Cells are dyadic, so a point's place along an axis, as a binary fraction of the domain's width, begins with the bits
of its cell's position: its *slot*. A *flat* table has one entry a slot of the finest grid, ``2**sum(bits)`` in all,
with ``bits[a]`` the deepest split along axis ``a``. A deep tree would make that table huge although only a few of its
leaves are small, so past ``2**MAX_FLAT_BITS`` slots the grid is cut into *blocks*, and each block has a little table
of its own, just as fine along each axis as its own leaves need.

How large tables are the byte class of the file says, the exponent of the power of two that holds its bytes, so that
PLRs of one class and leaf model share compiled code: how many leaves there is room for and, by these, how many slots
there are. Beyond 16,384 leaves (planes of 32 KB, others of 16) there is room for the next power of two, and slots as
many where leaves need more than the class has. What is left is padding, which is never read.

In the plane and on a line no leaves need more slots than the class of a budget up to there has. Planes without a
budget may be as deep as if they had one of 32 KB, however small their file: in the plane up to 9 halvings along an
axis, for which their class may have too few slots.
"""

from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt16, UInt32

from plr_jax._arrays import padded, padded_size, runs
from plr_jax.geometry.box import Box
from plr_jax.plr.partition.cells import Cells

LARGEST = 1e30  # of coordinates, distances and slopes: far enough from the end of 32-bit floats
FRACTION_BITS = 23  # of a 32-bit float
WORD_BITS = 32
MIN_CLASS = 8
_SLOT_BITS = ((2**10, 14), (2**12, 16))  # of flat tables with up to so many rows; beyond, MAX_FLAT_BITS
MOST_ROWS = 2**14  # of a class whose tables are of one shape
MAX_FLAT_BITS = 18  # a flat table of 16-bit leaves then fits a core's second-level cache
_DEEP_BITS = 28  # of a point's place in all, beyond the classes above
_MAX_BITS_BEYOND_CLASS, _LEAST_ENTRIES_BITS, _MOST_ENTRIES_BITS = 9, 20, 27
_MAX_BLOCK_BITS = 16
_MAX_COLUMN_BYTES = 9 * 2**15  # about half of a core's second-level cache, the other half is for slots


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Blocks:
    """The coarse level of a two-level table; ``None`` in its place means one flat table.

    A block's *word* holds, from its lowest bit, how many bits of a point's place the block's own table resolves along
    each axis, ``width`` bits an axis, and above them where that table starts in ``leaf_of_slot``. Axes for which the
    first word has no room come in further words. One word is read with one gather, which is what a query costs.
    Each describes so many ``axes``; ``shift`` bits of a point's place along each axis are below its block.
    """

    words: tuple[UInt32[Array, "blocks"], ...]
    shift: UInt32[Array, "dim"]
    axes: tuple[int, ...] = field(metadata={"static": True})
    width: int = field(metadata={"static": True})


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Tables:
    """All that a query reads. Arrays are padded to few sizes, so PLRs of one class share compiled code.

    They are few, because every array adds to the cost of a call. All indices are unsigned: JAX counts a signed one
    from the end if it is negative, which takes time.

    Attributes:
        frame: One row a quantity, see :class:`Frame`; one column an axis.
        bits: Which bits of a point's place along each axis are its slot (flat table) or its block (two levels), as a
            mask, and how far right they belong in the index.
        blocks: Coarse level, or None for a flat table.
        leaf_of_slot: Leaf of each slot.
        numbers: What the leaf model reads of each leaf. Small tables have one row a number, which takes the least
            arithmetic. Large ones are one array in which a leaf's numbers stand side by side, so that a query waits
            for a cache line or two and not for one a number.
        leaf: The leaf model, whose ``evaluate`` makes a value of them.
    """

    frame: Float[Array, "6 dim"]
    bits: UInt32[Array, "2 dim"]
    blocks: Blocks | None
    leaf_of_slot: UInt16[Array, "slots"] | UInt32[Array, "slots"]
    numbers: Float[Array, "count padded"] | Float[Array, "numbers"]
    leaf: Any = field(metadata={"static": True})

    @property
    def dim(self) -> int:
        """Number of axes."""
        return self.frame.shape[1]

    def from_corner(self, domain: Box) -> "Tables":
        """The same for points counted from the domain's rounded lower corner, which 32-bit floats resolve."""
        return replace(self, frame=jnp.asarray(_frame(domain, table_corners(domain)[0])))


class Frame(IntEnum):
    """Rows of ``Tables.frame``: the domain in 32-bit floats.

    ``LO`` and ``HI`` are its corners, rounded outward, ``LO_REST`` and ``HI_REST`` by how much, and ``SCALE`` is one
    over its width. ``START`` is one minus ``LO_REST`` over the width: cells far from the origin so stay in place.
    """

    LO = 0
    HI = 1
    LO_REST = 2
    HI_REST = 3
    START = 4
    SCALE = 5


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


def build_tables(
    domain: Box, cells: Cells, numbers: Float[np.ndarray, "leaves count"], leaf: Any, num_bytes: int
) -> Tables:
    """Tables of a partition whose leaf ``i`` is ``cells[i]`` and has ``numbers[i]``.

    The size of the file fixes that of the tables and bounds it: raises ``ValueError`` if the leaves are too deep.
    """
    bits = cells.depth.max(axis=0)
    of_class = byte_class(max(num_bytes, leaf.least_bytes * len(cells)))
    flat = bits.sum() <= MAX_FLAT_BITS
    block_bits = 0 * bits if flat else _choose_block_bits(cells, bits, max_entries(num_bytes))
    shape = _block_shapes(cells, block_bits)
    offset = np.concatenate([[0], np.cumsum(np.int64(1) << shape.sum(axis=1))])
    leaf_of_slot = _leaves_of_slots(cells, block_bits, shape, offset)
    rows = rows_of_class(of_class, leaf.least_bytes)
    slot_bits = max(slot_bits_of_rows(rows), (len(leaf_of_slot) - 1).bit_length())
    if rows > MOST_ROWS:  # too large to be padded to what the class may need at the most
        rows = padded_size(len(cells))
    table = padded(numbers.astype(np.float32), rows)
    index_type = np.uint16 if rows <= 2**16 else np.uint32
    top = bits if flat else block_bits
    below = FRACTION_BITS - top
    bits = np.stack([((1 << top) - 1) << below, FRACTION_BITS - np.cumsum(top[::-1])[::-1]])
    return Tables(
        frame=jnp.asarray(_frame(domain, np.zeros(domain.dim))),
        bits=jnp.asarray(bits.astype(np.uint32)),
        blocks=None if flat else _pack_blocks(shape, offset, below),
        leaf_of_slot=jnp.asarray(padded(leaf_of_slot.astype(index_type), 1 << slot_bits)),
        numbers=jnp.asarray(table.ravel() if table.nbytes > _MAX_COLUMN_BYTES else np.ascontiguousarray(table.T)),
        leaf=leaf,
    )


def byte_class(num_bytes: int) -> int:
    """The smallest exponent of a power of two that is at least so many bytes."""
    return max(MIN_CLASS, (num_bytes - 1).bit_length())


def rows_of_class(of_class: int, least_bytes: int) -> int:
    """Leaves for which the tables of a class have room, where a leaf takes so many bytes at the least."""
    return (1 << of_class) // least_bytes


def slot_bits_of_rows(rows: int) -> int:
    """Bits of the flat table of a class that has room for so many leaves."""
    return next((bits for most, bits in _SLOT_BITS if rows <= most), MAX_FLAT_BITS)


def max_axis_depth(dim: int, of_class: int | None, least_bytes: int) -> int:
    """How often a cell may be halved along one axis, for a class of files or for any.

    In the plane and on a line the slots of a class of up to ``MOST_ROWS`` suffice; else the tables' size is bounded.
    """
    rows = None if of_class is None else rows_of_class(of_class, least_bytes)
    if rows is None or rows > MOST_ROWS or dim > 2:
        return max(1, min(MAX_FLAT_BITS, _DEEP_BITS // dim))
    return slot_bits_of_rows(rows) // dim


def max_entries(num_bytes: int) -> int:
    """Entries that the tables of a file of so many bytes may have: they bound what loading it takes."""
    bits = byte_class(num_bytes) + _MAX_BITS_BEYOND_CLASS
    return 1 << min(max(bits, _LEAST_ENTRIES_BITS), _MOST_ENTRIES_BITS)


def _frame(domain: Box, origin: Float[np.ndarray, "dim"]) -> Float[np.ndarray, "6 dim"]:
    """The domain in 32-bit floats, for points counted from an origin."""
    lo, hi = table_corners(domain)
    # Rounded toward zero, so that the corners themselves stay inside.
    rest = np.nextafter(np.stack([domain.lo - lo, hi - domain.hi]).astype(np.float32), np.float32(-1))
    frame = np.empty((len(Frame), domain.dim), np.float32)
    frame[Frame.LO], frame[Frame.HI] = lo - origin, hi - origin
    frame[Frame.LO_REST], frame[Frame.HI_REST] = np.maximum(rest, 0)
    frame[Frame.START], frame[Frame.SCALE] = 1 - (domain.lo - lo) / domain.width, 1 / domain.width
    return frame


def _pack_blocks(
    shape: Int[np.ndarray, "blocks dim"], offset: Int[np.ndarray, "blocks_plus_one"], shift: Int[np.ndarray, "dim"]
) -> Blocks:
    """The words of all blocks; the first has the offset above the axes for which there is room."""
    width = max(1, int(shape.max()).bit_length())
    room = (WORD_BITS - int(offset[-1]).bit_length()) // width
    first, words, axes = offset[:-1], [], []
    while not words or sum(axes) < shape.shape[1]:
        here = shape[:, sum(axes) : sum(axes) + room]
        word = np.zeros(len(shape), np.int64) if words else first
        for column in here.T[::-1]:
            word = (word << width) | column
        words.append(jnp.asarray(word.astype(np.uint32)))
        axes.append(here.shape[1])
        room = WORD_BITS // width
    return Blocks(tuple(words), jnp.asarray(shift.astype(np.uint32)), tuple(axes), width)


def _choose_block_bits(cells: Cells, bits: Int[np.ndarray, "dim"], max_entries: int) -> Int[np.ndarray, "dim"]:
    """Coarse bits along each axis: those with which words and blocks' own tables take the fewest bytes."""
    best, fewest = None, np.inf
    block_bits = np.zeros_like(bits)
    while block_bits.sum() < min(_MAX_BLOCK_BITS, bits.sum()):
        block_bits[np.argmax(bits - block_bits)] += 1
        if np.sum(2.0 ** np.maximum(block_bits - cells.depth, 0).sum(axis=1)) > max_entries:
            break  # so many pairs of a leaf and a block that meet; finer blocks meet more leaves
        slots = np.sum(2.0 ** _block_shapes(cells, block_bits).sum(axis=1))
        size = 4 * 2.0 ** block_bits.sum() + 2 * slots
        if slots <= max_entries and size < fewest:
            best, fewest = block_bits.copy(), size
    if best is None:
        raise ValueError(
            f"The leaves are too deep for a query's tables: {bits.tolist()} splits along the axes. Lower max_depth."
        )
    return best


def _block_shapes(cells: Cells, block_bits: Int[np.ndarray, "dim"]) -> Int[np.ndarray, "blocks dim"]:
    """Bits of every block's own table: the deepest split below the block among the leaves it meets."""
    below = np.maximum(cells.depth - block_bits, 0)
    leaf, block = _leaves_in_blocks(cells, block_bits)
    shape = np.zeros((1 << block_bits.sum(), cells.dim), np.int64)
    np.maximum.at(shape, _row_major(block, block_bits), below[leaf])
    return shape


def _leaves_in_blocks(
    cells: Cells, block_bits: Int[np.ndarray, "dim"]
) -> tuple[Int[np.ndarray, "pairs"], Int[np.ndarray, "pairs dim"]]:
    """All pairs of a leaf and a block that meet: the leaf's index and the block's, along each axis."""
    first = np.where(
        cells.depth >= block_bits,
        cells.position >> np.maximum(cells.depth - block_bits, 0),
        cells.position << np.maximum(block_bits - cells.depth, 0),
    )
    return _enumerate_boxes(first, np.int64(1) << np.maximum(block_bits - cells.depth, 0))


def _enumerate_boxes(
    first: Int[np.ndarray, "boxes dim"], count: Int[np.ndarray, "boxes dim"]
) -> tuple[Int[np.ndarray, "points"], Int[np.ndarray, "points dim"]]:
    """Integer points of many boxes: the box's index and the point, for each."""
    box, rest = runs(count.prod(axis=1))
    points = np.empty((len(box), first.shape[1]), np.int64)
    for axis in reversed(range(first.shape[1])):
        rest, digit = np.divmod(rest, count[box, axis])
        points[:, axis] = first[box, axis] + digit
    return box, points


def _leaves_of_slots(
    cells: Cells,
    block_bits: Int[np.ndarray, "dim"],
    shape: Int[np.ndarray, "blocks dim"],
    offset: Int[np.ndarray, "blocks_plus_one"],
) -> UInt32[np.ndarray, "slots"]:
    """The leaf of every slot of the tables of all blocks.

    Along the last axis a leaf covers slots in a row. It is written at the first slot of each of its runs, and from
    there to the start of the next, whichever leaf's that is.
    """
    leaf, block = _leaves_in_blocks(cells, block_bits)
    index = _row_major(block, block_bits)
    bits = shape[index]
    below = np.maximum(cells.depth[leaf] - block_bits, 0)
    first = (cells.position[leaf] & ((np.int64(1) << below) - 1)) << (bits - below)
    count = np.int64(1) << (bits - below)
    count[:, -1] = 1
    pair, slot = _enumerate_boxes(first, count)
    start = offset[index[pair]] + _row_major(slot, bits[pair])
    leaf_of_start = np.zeros(offset[-1], np.uint32)
    is_start = np.zeros(offset[-1], bool)
    leaf_of_start[start], is_start[start] = leaf[pair], True
    starts = np.flatnonzero(is_start)
    return np.repeat(leaf_of_start[starts], np.diff(starts, append=offset[-1]))


def _row_major(
    slots: Int[np.ndarray, "n dim"], bits: Int[np.ndarray, "n dim"] | Int[np.ndarray, "dim"]
) -> Int[np.ndarray, "n"]:
    """Index of each slot in a table of ``2**bits`` slots along the axes."""
    index = np.zeros(len(slots), np.int64)
    for axis in range(slots.shape[1]):
        index = (index << bits[..., axis]) | slots[:, axis]
    return index
