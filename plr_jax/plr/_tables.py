"""Lookup tables: from a point to its leaf by arithmetic, not by descending a tree.

Cells are dyadic, so a point's place along an axis, as a binary fraction of the domain's width, begins with the bits
of its cell's position: its *slot*. A *flat* table has one entry a slot of the finest grid, ``2**sum(bits)`` in all,
with ``bits[a]`` the deepest split along axis ``a``. A deep tree would make that table huge although only a few of its
leaves are small, so past ``2**MAX_FLAT_BITS`` slots the grid is cut into *blocks*, and each block has a little table
of its own, just as fine along each axis as its own leaves need.
"""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Integer, Num

from plr_jax._box import Box
from plr_jax.plr._cells import Cells
from plr_jax.plr._planes import LARGEST

MAX_FLAT_BITS = 18  # a flat table of 16-bit leaves then fits a core's second-level cache
_MAX_BLOCK_BITS = 16
_FRACTION_BITS = 23  # of a 32-bit float
_WORD_BITS = 32
_MAX_SLOTS = 2**28


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Blocks:
    """The coarse level of a two-level table; ``None`` in its place means one flat table.

    A block's *word* holds, from its lowest bit, how many bits of a point's place the block's own table resolves along
    each axis, ``width`` bits an axis, and above them where that table starts in ``leaf_of_slot``. Axes for which the
    first word has no room come in further words. One word is read with one gather, which is what a query costs.

    Attributes:
        words: For every word its value in each block.
        axes: For every word the number of axes it describes.
        width: Bits of an axis in a word.
    """

    words: tuple[Int[Array, "blocks"], ...]
    axes: tuple[int, ...] = field(metadata={"static": True})
    width: int = field(metadata={"static": True})


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Tables:
    """All that a query reads. Arrays are padded to powers of two, so PLRs of like size share compiled code.

    Attributes:
        lo: Lower corner of the domain, rounded down to a 32-bit float.
        hi: Upper corner of the domain, rounded up.
        lo_rest: What the rounding took from the lower corner.
        hi_rest: What the rounding added to the upper corner.
        lo_fraction: ``lo_rest`` over the width of the domain, so that cells far from the origin stay in place.
        scale: One over the width of the domain.
        shift: Bits of a point's place below its slot (flat table) or its block (two levels), along each axis.
        stride: Stride of the index of the slot, or of the block, along each axis.
        blocks: Coarse level, or None for a flat table.
        leaf_of_slot: Leaf of each slot.
        slope: Slope of each leaf, one array an axis.
        intercept: Value of each leaf's plane at ``lo``.
    """

    lo: Float[Array, "dim"]
    hi: Float[Array, "dim"]
    lo_rest: Float[Array, "dim"]
    hi_rest: Float[Array, "dim"]
    lo_fraction: Float[Array, "dim"]
    scale: Float[Array, "dim"]
    shift: Int[Array, "dim"]
    stride: Int[Array, "dim"]
    blocks: Blocks | None
    leaf_of_slot: Integer[Array, "slots"]
    slope: tuple[Float[Array, "leaves"], ...]
    intercept: Float[Array, "leaves"]


def lookup(tables: Tables, x: Float[Array, "*batch dim"]) -> Int[Array, "*batch"]:
    """Index of the leaf that holds each point, to within the last bit of a 32-bit fraction of the domain.

    Points outside the domain, and NaN, get some leaf.
    """
    place = [_place(tables, x, axis) for axis in range(x.shape[-1])]
    index = (place[0] >> tables.shift[0]) * tables.stride[0]
    for axis in range(1, len(place)):
        index += (place[axis] >> tables.shift[axis]) * tables.stride[axis]
    if tables.blocks is not None:
        index = _index_in_block(tables.blocks, tables.shift, place, index)
    return _gather(tables.leaf_of_slot, index).astype(jnp.int32)


def evaluate_tables(tables: Tables, x: Num[Array, "*batch dim"]) -> Float[Array, "*batch"]:
    """Value of the leaf's plane at each point; ``inf`` outside the closed domain, NaN for NaN."""
    x = x.astype(jnp.promote_types(x.dtype, jnp.float32))
    leaf = lookup(tables, jax.lax.stop_gradient(x))
    lo, hi = tables.lo.astype(x.dtype), tables.hi.astype(x.dtype)
    value = _gather(tables.intercept, leaf).astype(x.dtype)
    inside, beyond = jnp.ones(x.shape[:-1], bool), jnp.full(x.shape[:-1], jnp.inf, x.dtype)
    for axis, slope in enumerate(tables.slope):
        above, below = x[..., axis] - lo[axis], hi[axis] - x[..., axis]
        value += _gather(slope, leaf).astype(x.dtype) * above
        if x.dtype == jnp.float64:  # which can tell the true corners from the rounded ones
            inside &= (above >= tables.lo_rest[axis]) & (below >= tables.hi_rest[axis])
        else:
            inside &= (above >= 0) & (below >= 0)
        beyond += jnp.abs(above)  # NaN if any coordinate is
    return jnp.where(inside, value, jax.lax.stop_gradient(beyond))


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
    domain: Box,
    cells: Cells,
    slope: Float[np.ndarray, "leaves dim"],
    intercept: Float[np.ndarray, "leaves"],
    max_flat_bits: int = MAX_FLAT_BITS,
) -> Tables:
    """Tables of a partition: leaf ``i`` is ``cells[i]``, its plane ``intercept[i]`` high at ``table_corners``."""
    bits = cells.depth.max(axis=0)
    if bits.max() > _FRACTION_BITS:
        raise ValueError(f"A cell is split {bits.max()} times along one axis; a query resolves {_FRACTION_BITS}.")
    flat = bits.sum() <= max_flat_bits
    block_bits = 0 * bits if flat else _choose_block_bits(cells, bits)
    shape = _block_shapes(cells, block_bits)
    offset = np.concatenate([[0], np.cumsum(np.int64(1) << shape.sum(axis=1))])
    leaf_of_slot = np.zeros(_power_of_two(int(offset[-1])), np.uint16 if len(cells) <= 2**16 else np.int32)
    _fill_slots(leaf_of_slot, cells, block_bits, shape, offset)
    top = bits if flat else block_bits
    lo, hi = table_corners(domain)
    rest = np.stack([domain.lo - lo, hi - domain.hi])
    # Rounded toward zero, so that the corners themselves stay inside.
    rest = np.maximum(np.nextafter(rest.astype(np.float32), np.float32(-1)), 0)
    padded = _power_of_two(len(cells))
    return Tables(
        lo=jnp.asarray(lo),
        hi=jnp.asarray(hi),
        lo_rest=jnp.asarray(rest[0]),
        hi_rest=jnp.asarray(rest[1]),
        lo_fraction=jnp.asarray(((domain.lo - lo) / domain.width).astype(np.float32)),
        scale=jnp.asarray((1 / domain.width).astype(np.float32)),
        shift=jnp.asarray((_FRACTION_BITS - top).astype(np.int32)),
        stride=jnp.asarray((1 << (np.cumsum(top[::-1])[::-1] - top)).astype(np.int32)),
        blocks=None if flat else _pack_blocks(shape, offset),
        leaf_of_slot=jnp.asarray(leaf_of_slot),
        slope=tuple(jnp.asarray(_pad(column.astype(np.float32), padded)) for column in slope.T),
        intercept=jnp.asarray(_pad(intercept.astype(np.float32), padded)),
    )


def _place(tables: Tables, x: Float[Array, "*batch dim"], axis: int) -> Int[Array, "*batch"]:
    """A point's place along an axis, in units of ``2**-23`` of the domain's width.

    Those are the fraction bits of the float between 1 and 2. The largest place is for the upper edge, which belongs
    to the last cell; masking keeps every index in its table, whatever the point.
    """
    above = x[..., axis] - tables.lo[axis].astype(x.dtype)
    fraction = (above * tables.scale[axis].astype(x.dtype) - tables.lo_fraction[axis].astype(x.dtype)).astype(
        jnp.float32
    )
    last = np.float32(1 - 2.0**-_FRACTION_BITS)
    fraction = jnp.where(fraction < last, fraction, last)
    return jax.lax.bitcast_convert_type(fraction + np.float32(1), jnp.int32) & (2**_FRACTION_BITS - 1)


def _index_in_block(
    blocks: Blocks, shift: Int[Array, "dim"], place: list[Int[Array, "*batch"]], block: Int[Array, "*batch"]
) -> Int[Array, "*batch"]:
    """Index into ``leaf_of_slot`` of points in given blocks."""
    index = jnp.zeros_like(block)
    start, axis = index, 0
    for number, (table, axes) in enumerate(zip(blocks.words, blocks.axes, strict=True)):
        word = _gather(table, block)
        for slot in range(axes):
            bits = (word >> (slot * blocks.width)) & (2**blocks.width - 1)
            within = place[axis] & ((1 << shift[axis]) - 1)
            index = (index << bits) | (within >> (shift[axis] - bits))
            axis += 1
        if number == 0:
            start = jax.lax.shift_right_logical(word, axes * blocks.width)
    return start + index


def _pack_blocks(shape: Int[np.ndarray, "blocks dim"], offset: Int[np.ndarray, "blocks_plus_one"]) -> Blocks:
    """The words of all blocks; the first has the offset above the axes for which there is room."""
    width = max(1, int(shape.max()).bit_length())
    room = (_WORD_BITS - int(offset[-1]).bit_length()) // width
    first, words, axes = offset[:-1], [], []
    while not words or sum(axes) < shape.shape[1]:
        here = shape[:, sum(axes) : sum(axes) + room]
        word = np.zeros(len(shape), np.int64) if words else first
        for column in here.T[::-1]:
            word = (word << width) | column
        words.append(jnp.asarray(word.astype(np.uint32).view(np.int32)))
        axes.append(here.shape[1])
        room = _WORD_BITS // width
    return Blocks(tuple(words), tuple(axes), width)


def _gather(table: Integer[Array, "n"] | Float[Array, "n"], index: Int[Array, "*batch"]):
    return table.at[index].get(mode="promise_in_bounds")


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


def _fill_slots(
    leaf_of_slot: Integer[np.ndarray, "slots"],
    cells: Cells,
    block_bits: Int[np.ndarray, "dim"],
    shape: Int[np.ndarray, "blocks dim"],
    offset: Int[np.ndarray, "blocks_plus_one"],
) -> None:
    """Write every leaf into the slots it covers in the tables of the blocks that it meets."""
    leaf, block = _leaves_in_blocks(cells, block_bits)
    index = _row_major(block, block_bits)
    bits = shape[index]
    below = np.maximum(cells.depth[leaf] - block_bits, 0)
    first = (cells.position[leaf] & ((np.int64(1) << below) - 1)) << (bits - below)
    pair, slot = _enumerate_boxes(first, np.int64(1) << (bits - below))
    leaf_of_slot[offset[index[pair]] + _row_major(slot, bits[pair])] = leaf[pair]


def _row_major(
    slots: Int[np.ndarray, "n dim"], bits: Int[np.ndarray, "n dim"] | Int[np.ndarray, "dim"]
) -> Int[np.ndarray, "n"]:
    """Index of each slot in a table of ``2**bits`` slots along the axes."""
    index = np.zeros(len(slots), np.int64)
    for axis in range(slots.shape[1]):
        index = (index << bits[..., axis]) | slots[:, axis]
    return index


def _power_of_two(n: int) -> int:
    return 1 << (n - 1).bit_length()


def _pad(values: Float[np.ndarray, "n"], size: int) -> Float[np.ndarray, "size"]:
    return np.concatenate([values, np.zeros(size - len(values), values.dtype)])
