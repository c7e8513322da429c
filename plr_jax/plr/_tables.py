"""Lookup tables: from a point to its leaf by arithmetic, not by descending a tree.

Cells are dyadic, so a point's slot along each axis is a multiply and a cast. A *flat* table has one entry a slot
of the finest grid, ``2**sum(bits)`` in all, with ``bits[a]`` the deepest split along axis ``a``. A deep tree would
make that table huge although only a few of its leaves are small, so past ``2**MAX_FLAT_BITS`` slots the grid is
cut into *blocks*, and each block has a little table of its own, just as fine as its own leaves need.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Integer, Num

from plr_jax._box import Box
from plr_jax.plr._cells import Cells

MAX_FLAT_BITS = 18
_MAX_BLOCK_BITS = 16
_SHAPE_BITS = 4  # bits of an axis in a block's packed shape: a block holds at most 2**15 slots along an axis


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Blocks:
    """The coarse level of a two-level table; ``None`` in its place means one flat table.

    Attributes:
        shift: Bits of a fine slot below the block's index, along each axis.
        shape: Bits of the block's own table along each axis, packed ``_SHAPE_BITS`` an axis.
        offset: Where the block's own table starts in ``leaf_of_slot``.
    """

    shift: Int[Array, "dim"]
    shape: Int[Array, "blocks"]
    offset: Int[Array, "blocks"]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Tables:
    """All that a query reads. Arrays are padded to powers of two, so PLRs of like size share compiled code.

    Attributes:
        lo: Lower corner of the domain.
        hi: Upper corner of the domain.
        scale: Slots a unit of length, along each axis.
        last: Index of the last slot along each axis.
        stride: Stride, along each axis, of the slot index or, in a two-level table, of the block index.
        blocks: Coarse level, or None for a flat table.
        leaf_of_slot: Leaf of each slot.
        slope: Slope of each leaf, one array an axis.
        intercept: Value of each leaf's plane at ``lo``.
    """

    lo: Float[Array, "dim"]
    hi: Float[Array, "dim"]
    scale: Float[Array, "dim"]
    last: Int[Array, "dim"]
    stride: Int[Array, "dim"]
    blocks: Blocks | None
    leaf_of_slot: Integer[Array, "slots"]
    slope: tuple[Float[Array, "leaves"], ...]
    intercept: Float[Array, "leaves"]


def lookup(tables: Tables, x: Float[Array, "*batch dim"]) -> Int[Array, "*batch"]:
    """Index of the leaf that holds each point; points outside the domain get the nearest edge's leaf."""
    slots = [_slot(tables, x, axis) for axis in range(x.shape[-1])]
    if tables.blocks is None:
        index = _ravel(slots, tables.stride)
    else:
        index = _index_in_blocks(tables.blocks, tables.stride, slots)
    return _gather(tables.leaf_of_slot, index).astype(jnp.int32)


def evaluate_tables(tables: Tables, x: Num[Array, "*batch dim"]) -> Float[Array, "*batch"]:
    """Value of the leaf's plane at each point; ``inf`` outside the closed domain, NaN for NaN."""
    x = x.astype(jnp.promote_types(x.dtype, jnp.float32))
    leaf = lookup(tables, jax.lax.stop_gradient(x))
    lo, hi = tables.lo.astype(x.dtype), tables.hi.astype(x.dtype)
    value = _gather(tables.intercept, leaf).astype(x.dtype)
    outside = jnp.zeros(x.shape[:-1], bool)
    for axis, slope in enumerate(tables.slope):
        coordinate = x[..., axis]
        value += _gather(slope, leaf).astype(x.dtype) * (coordinate - lo[axis])
        outside |= (coordinate < lo[axis]) | (coordinate > hi[axis])
    return jnp.where(outside, jnp.inf, value)


def table_corners(domain: Box) -> tuple[Float[np.ndarray, "dim"], Float[np.ndarray, "dim"]]:
    """Corners of the domain as 32-bit floats, rounded outward so that no point of the domain falls out of it."""
    lo, hi = domain.lo.astype(np.float32), domain.hi.astype(np.float32)
    return (
        np.where(lo > domain.lo, np.nextafter(lo, np.float32(-np.inf)), lo),
        np.where(hi < domain.hi, np.nextafter(hi, np.float32(np.inf)), hi),
    )


def build_tables(
    domain: Box, cells: Cells, slope: Float[np.ndarray, "leaves dim"], intercept: Float[np.ndarray, "leaves"]
) -> Tables:
    """Tables of a partition: leaf ``i`` is ``cells[i]``, its plane ``intercept[i]`` high at ``table_corners``."""
    bits = cells.depth.max(axis=0)
    block_bits = _choose_block_bits(cells, bits)
    shape = _block_shapes(cells, block_bits)
    size = np.int64(1) << shape.sum(axis=1)
    offset = np.concatenate([[0], np.cumsum(size)])
    leaf_of_slot = np.zeros(_power_of_two(int(offset[-1])), np.uint16 if len(cells) <= 2**16 else np.int32)
    _fill_slots(leaf_of_slot, cells, block_bits, shape, offset)
    padded = _power_of_two(len(cells))
    blocks = None
    if block_bits.any():
        packed = (shape << (_SHAPE_BITS * np.arange(cells.dim))).sum(axis=1)
        blocks = Blocks(
            shift=jnp.asarray((bits - block_bits).astype(np.int32)),
            shape=jnp.asarray(packed.astype(np.int32)),
            offset=jnp.asarray(offset[:-1].astype(np.int32)),
        )
    lo, hi = table_corners(domain)
    return Tables(
        lo=jnp.asarray(lo),
        hi=jnp.asarray(hi),
        scale=jnp.asarray((np.ldexp(1.0, bits) / domain.width).astype(np.float32)),
        last=jnp.asarray(((1 << bits) - 1).astype(np.int32)),
        stride=_strides(bits if blocks is None else block_bits),
        blocks=blocks,
        leaf_of_slot=jnp.asarray(leaf_of_slot),
        slope=tuple(jnp.asarray(_pad(column.astype(np.float32), padded)) for column in slope.T),
        intercept=jnp.asarray(_pad(intercept.astype(np.float32), padded)),
    )


def _slot(tables: Tables, x: Float[Array, "*batch dim"], axis: int) -> Int[Array, "*batch"]:
    offset = x[..., axis] - tables.lo[axis].astype(x.dtype)
    slot = (offset * tables.scale[axis].astype(x.dtype)).astype(jnp.int32)
    return jnp.clip(slot, 0, tables.last[axis])


def _index_in_blocks(
    blocks: Blocks, stride: Int[Array, "dim"], slots: list[Int[Array, "*batch"]]
) -> Int[Array, "*batch"]:
    """Index into ``leaf_of_slot``: find the block, then the slot in the block's own table."""
    block = _ravel([slot >> blocks.shift[axis] for axis, slot in enumerate(slots)], stride)
    shape = _gather(blocks.shape, block)
    index = jnp.zeros_like(block)
    for axis, slot in enumerate(slots):
        bits = (shape >> (_SHAPE_BITS * axis)) & (2**_SHAPE_BITS - 1)
        within = (slot & ((1 << blocks.shift[axis]) - 1)) >> (blocks.shift[axis] - bits)
        index = (index << bits) | within
    return _gather(blocks.offset, block) + index


def _ravel(slots: list[Int[Array, "*batch"]], stride: Int[Array, "dim"]) -> Int[Array, "*batch"]:
    index = slots[0] * stride[0]
    for axis in range(1, len(slots)):
        index += slots[axis] * stride[axis]
    return index


def _gather(table: Integer[Array, "n"] | Float[Array, "n"], index: Int[Array, "*batch"]):
    return table.at[index].get(mode="promise_in_bounds")


def _choose_block_bits(cells: Cells, bits: Int[np.ndarray, "dim"]) -> Int[np.ndarray, "dim"]:
    """Coarse bits along each axis: none if one flat table will do, else those of the smallest tables."""
    if bits.sum() <= MAX_FLAT_BITS:
        return np.zeros_like(bits)
    best, best_size = None, np.inf
    block_bits = np.zeros_like(bits)
    while block_bits.sum() < _MAX_BLOCK_BITS:
        block_bits[np.argmax(bits - block_bits)] += 1
        if np.max(bits - block_bits) < 2**_SHAPE_BITS:
            size = 2.0 ** block_bits.sum() * 4 + np.sum(2.0 ** _block_shapes(cells, block_bits).sum(axis=1))
            if size < best_size:
                best, best_size = block_bits.copy(), size
    if best is None:
        raise ValueError(f"The tree is too deep for its tables: {bits.tolist()} splits along the axes.")
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


def _strides(bits: Int[np.ndarray, "dim"]) -> Int[Array, "dim"]:
    above = np.cumsum(bits[::-1])[::-1] - bits
    return jnp.asarray((1 << above).astype(np.int32))


def _power_of_two(n: int) -> int:
    return 1 << (n - 1).bit_length()


def _pad(values: Float[np.ndarray, "n"], size: int) -> Float[np.ndarray, "size"]:
    return np.concatenate([values, np.zeros(size - len(values), values.dtype)])
