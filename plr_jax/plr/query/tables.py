"""Lookup tables: from a point to its leaf by arithmetic, not by descending a tree.

Cells are dyadic, so a point's place along an axis, as a binary fraction of the domain's width, begins with the bits
of its cell's position: its *slot*. A *flat* table has one entry a slot of the finest grid, ``2**sum(bits)`` in all,
with ``bits[a]`` the deepest split along axis ``a``. A deep tree would make that table huge although only a few of its
leaves are small, so past ``2**MAX_FLAT_BITS`` slots the grid is cut into *blocks*, and each block has a little table
of its own, just as fine along each axis as its own leaves need.
"""

from dataclasses import dataclass, field
from enum import IntEnum
from functools import reduce

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Integer, Num, UInt16, UInt32

from plr_jax.geometry.box import Box
from plr_jax.plr.leaves.plane.codec import LARGEST
from plr_jax.plr.partition.cells import Cells

MAX_FLAT_BITS = 18  # a flat table of 16-bit leaves then fits a core's second-level cache
_MAX_BLOCK_BITS = 16
_FRACTION_BITS = 23  # of a 32-bit float
_WORD_BITS = 32
_MAX_SLOTS = 2**28
# Sizes of tables: few, so that a PLR of another goal finds its query compiled. Padding is never read.
_SLOT_SIZES = (2**6, 2**10, 2**14, 2**18)
_LEAF_SIZES = (2**4, 2**6, 2**8, 2**10, 2**12, 2**14, 2**16)
_MAX_COLUMN_BYTES = 9 * 2**15  # about half of a core's second-level cache, the other half is for slots


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Blocks:
    """The coarse level of a two-level table; ``None`` in its place means one flat table.

    A block's *word* holds, from its lowest bit, how many bits of a point's place the block's own table resolves along
    each axis, ``width`` bits an axis, and above them where that table starts in ``leaf_of_slot``. Axes for which the
    first word has no room come in further words. One word is read with one gather, which is what a query costs.

    Attributes:
        words: For every word its value in each block.
        shift: Bits of a point's place below its block, along each axis.
        axes: For every word the number of axes it describes.
        width: Bits of an axis in a word.
    """

    words: tuple[UInt32[Array, "blocks"], ...]
    shift: UInt32[Array, "dim"]
    axes: tuple[int, ...] = field(metadata={"static": True})
    width: int = field(metadata={"static": True})


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Tables:
    """All that a query reads. Arrays are padded to few sizes, so PLRs of like size share compiled code.

    They are few, because every array adds to the cost of a call. All indices are unsigned: JAX counts a signed one
    from the end if it is negative, which takes time.

    Attributes:
        frame: One row a quantity, see :class:`Frame`; one column an axis.
        bits: Which bits of a point's place along each axis are its slot (flat table) or its block (two levels), as a
            mask, and how far right they belong in the index.
        blocks: Coarse level, or None for a flat table.
        leaf_of_slot: Leaf of each slot.
        planes: What each leaf has; of a PLR the value of its plane at the domain's rounded lower corner, and its
            slopes. Small tables have one row a number, which takes the least arithmetic. Large ones are one array in
            which a leaf's numbers stand side by side, so that a query waits for a cache line or two and not for one a
            number.
    """

    frame: Float[Array, "6 dim"]
    bits: UInt32[Array, "2 dim"]
    blocks: Blocks | None
    leaf_of_slot: UInt16[Array, "slots"] | UInt32[Array, "slots"]
    planes: Float[Array, "terms padded"] | Float[Array, "coefficients"]

    @property
    def dim(self) -> int:
        """Number of axes."""
        return self.frame.shape[1]

    @property
    def coefficients(self) -> Float[Array, "terms padded"]:
        """The planes, padding included: values at the rounded lower corner, then slopes along the axes."""
        return self.planes if self.planes.ndim == 2 else self.planes.reshape(-1, self.dim + 1).T


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


def lookup(tables: Tables, x: Float[Array, "*batch dim"]) -> UInt32[Array, "*batch"]:
    """Index of the leaf that holds each point, to within the last bit of a 32-bit fraction of the domain.

    Points outside the domain, and NaN, get some leaf.
    """
    words = [_place(tables, x, axis) for axis in range(tables.dim)]
    mask, right = tables.bits
    index = reduce(jnp.bitwise_or, [_shift_right(word & mask[axis], right[axis]) for axis, word in enumerate(words)])
    if tables.blocks is not None:
        index = _index_in_block(tables.blocks, words, index)
    return _gather(tables.leaf_of_slot, index).astype(jnp.uint32)


def evaluate_tables(tables: Tables, x: Num[Array, "*batch dim"]) -> Float[Array, "*batch"]:
    """Value of the leaf's plane at each point; ``inf`` outside the closed domain, NaN for NaN."""
    x = x.astype(jnp.promote_types(x.dtype, jnp.float32))
    leaf, corner = lookup(tables, jax.lax.stop_gradient(x)), tables.frame[Frame.LO].astype(x.dtype)
    terms = 1 + tables.dim
    value = number_of_leaf(tables, leaf, 0, terms).astype(x.dtype)
    for axis in range(tables.dim):
        value += number_of_leaf(tables, leaf, 1 + axis, terms).astype(x.dtype) * (x[..., axis] - corner[axis])
    outside, answer = outside_domain(tables, x)
    return jnp.where(outside, answer, value)


def outside_domain(
    tables: Tables, x: Float[Array, "*batch dim"]
) -> tuple[Bool[Array, "*batch"], Float[Array, "*batch"]]:
    """Whether each point is outside the closed domain, and the answer there: ``inf``, NaN for NaN."""
    x, frame = jax.lax.stop_gradient(x), tables.frame.astype(x.dtype)
    outside, answer = jnp.zeros(x.shape[:-1], bool), jnp.full(x.shape[:-1], jnp.inf, x.dtype)
    for axis in range(tables.dim):
        above = x[..., axis] - frame[Frame.LO, axis]
        answer += jnp.abs(above)  # NaN if any coordinate is
        if x.dtype == jnp.float64:  # which can tell the true corners from the rounded ones
            below = frame[Frame.HI, axis] - x[..., axis]
            outside |= (above < frame[Frame.LO_REST, axis]) | (below < frame[Frame.HI_REST, axis])
        else:
            outside |= (above < 0) | (x[..., axis] > frame[Frame.HI, axis])
    return outside, answer


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
    domain: Box, cells: Cells, numbers: Float[np.ndarray, "leaves count"], max_flat_bits: int = MAX_FLAT_BITS
) -> Tables:
    """Tables of a partition: leaf ``i`` is ``cells[i]`` and has ``numbers[i]``.

    Of a PLR these are the height of its plane at ``table_corners`` and the plane's slopes.
    """
    bits = cells.depth.max(axis=0)
    if bits.max() > _FRACTION_BITS:
        raise ValueError(f"A cell is split {bits.max()} times along one axis; a query resolves {_FRACTION_BITS}.")
    flat = bits.sum() <= max_flat_bits
    block_bits = 0 * bits if flat else _choose_block_bits(cells, bits)
    shape = _block_shapes(cells, block_bits)
    offset = np.concatenate([[0], np.cumsum(np.int64(1) << shape.sum(axis=1))])
    leaf_of_slot = _leaves_of_slots(cells, block_bits, shape, offset)
    top = bits if flat else block_bits
    below = _FRACTION_BITS - top
    bits = np.stack([((1 << top) - 1) << below, _FRACTION_BITS - np.cumsum(top[::-1])[::-1]])
    return Tables(
        frame=jnp.asarray(_frame(domain)),
        bits=jnp.asarray(bits.astype(np.uint32)),
        blocks=None if flat else _pack_blocks(shape, offset, below),
        leaf_of_slot=jnp.asarray(_padded(leaf_of_slot)),
        planes=jnp.asarray(_lay_out(numbers)),
    )


def _frame(domain: Box) -> Float[np.ndarray, "6 dim"]:
    lo, hi = table_corners(domain)
    # Rounded toward zero, so that the corners themselves stay inside.
    rest = np.nextafter(np.stack([domain.lo - lo, hi - domain.hi]).astype(np.float32), np.float32(-1))
    frame = np.empty((len(Frame), domain.dim), np.float32)
    frame[Frame.LO], frame[Frame.HI] = lo, hi
    frame[Frame.LO_REST], frame[Frame.HI_REST] = np.maximum(rest, 0)
    frame[Frame.START], frame[Frame.SCALE] = 1 - (domain.lo - lo) / domain.width, 1 / domain.width
    return frame


def _lay_out(
    numbers: Float[np.ndarray, "leaves count"],
) -> Float[np.ndarray, "count padded"] | Float[np.ndarray, "numbers"]:
    """What a query reads of every leaf as ``Tables.planes`` describes, padded with zeros."""
    padded = np.zeros((_padded_size(len(numbers), _LEAF_SIZES), numbers.shape[1]), np.float32)
    padded[: len(numbers)] = numbers
    return padded.ravel() if padded.nbytes > _MAX_COLUMN_BYTES else np.ascontiguousarray(padded.T)


def number_of_leaf(tables: Tables, leaf: UInt32[Array, "*batch"], which: int, count: int) -> Float[Array, "*batch"]:
    """One of the ``count`` numbers of each leaf that the tables were built of."""
    if tables.planes.ndim == 2:
        return _gather(tables.planes[which], leaf)
    return _gather(tables.planes, leaf * np.uint32(count) + np.uint32(which))


def _place(tables: Tables, x: Float[Array, "*batch dim"], axis: int) -> UInt32[Array, "*batch"]:
    """A point's place along an axis, in units of ``2**-23`` of the domain's width, in the lower 23 bits of a word.

    Those are the fraction bits of one plus the place, a 32-bit float from 1 to below 2. The last place is for the
    upper edge, which belongs to the last cell.
    """
    lo, start, scale = (tables.frame[row, axis].astype(x.dtype) for row in (Frame.LO, Frame.START, Frame.SCALE))
    placed = ((x[..., axis] - lo) * scale + start).astype(jnp.float32)
    last = np.float32(2 - 2.0**-_FRACTION_BITS)
    return jax.lax.bitcast_convert_type(jnp.where(placed < last, placed, last), jnp.uint32)


def _index_in_block(
    blocks: Blocks, places: list[UInt32[Array, "*batch"]], block: UInt32[Array, "*batch"]
) -> UInt32[Array, "*batch"]:
    """Index into ``leaf_of_slot`` of points in given blocks."""
    index = start = jnp.zeros_like(block)
    axis = 0
    for number, (table, axes) in enumerate(zip(blocks.words, blocks.axes, strict=True)):
        word = _gather(table, block)
        for slot in range(axes):
            bits = (word >> np.uint32(slot * blocks.width)) & np.uint32(2**blocks.width - 1)
            within = places[axis] & (
                (np.uint32(1) << (blocks.shift[axis] & np.uint32(_WORD_BITS - 1))) - np.uint32(1)
            )
            index = (index << bits) | _shift_right(within, blocks.shift[axis] - bits)
            axis += 1
        if number == 0:
            start = word >> np.uint32(axes * blocks.width)
    return start + index


def _pack_blocks(
    shape: Int[np.ndarray, "blocks dim"], offset: Int[np.ndarray, "blocks_plus_one"], shift: Int[np.ndarray, "dim"]
) -> Blocks:
    """The words of all blocks; the first has the offset above the axes for which there is room."""
    width = max(1, int(shape.max()).bit_length())
    room = (_WORD_BITS - int(offset[-1]).bit_length()) // width
    first, words, axes = offset[:-1], [], []
    while not words or sum(axes) < shape.shape[1]:
        here = shape[:, sum(axes) : sum(axes) + room]
        word = np.zeros(len(shape), np.int64) if words else first
        for column in here.T[::-1]:
            word = (word << width) | column
        words.append(jnp.asarray(word.astype(np.uint32)))
        axes.append(here.shape[1])
        room = _WORD_BITS // width
    return Blocks(tuple(words), jnp.asarray(shift.astype(np.uint32)), tuple(axes), width)


def _gather(table: Integer[Array, "n"] | Float[Array, "n"], index: UInt32[Array, "*batch"]):
    return table.at[index].get(mode="promise_in_bounds")


def _shift_right(x: UInt32[Array, "*batch"], by: UInt32[Array, "*#batch"]) -> UInt32[Array, "*batch"]:
    """Shift by less than 32 bits, which the mask tells the compiler: it then need not provide for more."""
    return x >> (by & np.uint32(_WORD_BITS - 1))


def _choose_block_bits(cells: Cells, bits: Int[np.ndarray, "dim"]) -> Int[np.ndarray, "dim"]:
    """Coarse bits along each axis: those with which words and blocks' own tables take the fewest bytes."""
    best, fewest = None, np.inf
    block_bits = np.zeros_like(bits)
    while block_bits.sum() < min(_MAX_BLOCK_BITS, bits.sum()):
        block_bits[np.argmax(bits - block_bits)] += 1
        slots = np.sum(2.0 ** _block_shapes(cells, block_bits).sum(axis=1))
        size = 4 * 2.0 ** block_bits.sum() + 2 * slots
        if slots <= _MAX_SLOTS and size < fewest:
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
    total = count.prod(axis=1)
    box = np.repeat(np.arange(len(first)), total)
    rest = np.arange(len(box)) - np.repeat(np.cumsum(total) - total, total)
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
) -> UInt16[np.ndarray, "slots"] | UInt32[np.ndarray, "slots"]:
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
    leaf_of_start = np.zeros(offset[-1], np.uint16 if len(cells) <= 2**16 else np.uint32)
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


def _padded(values: Integer[np.ndarray, "n"]) -> Integer[np.ndarray, "padded"]:
    padded = np.zeros(_padded_size(len(values), _SLOT_SIZES), values.dtype)
    padded[: len(values)] = values
    return padded


def _padded_size(n: int, sizes: tuple[int, ...]) -> int:
    """The first of the sizes that is large enough; beyond them, the next power of two."""
    return next((size for size in sizes if size >= n), 1 << (n - 1).bit_length())
