"""Lookup tables that map a point to its leaf by bit arithmetic, without descending a tree.

The highest bits of a point's position select an entry (*blocks* and *slots*: ``frame.py``). There are two layouts:

- A *flat* table has one entry for each cell of a regular grid: the cell's leaf.
- *Blocks*, where a flat table exceeds its size class: each block has its own grid of slots, and each slot an entry.
  For small PLRs with deep trees, entries store leaf parameters instead of leaf indices, which saves a read.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from math import ceil, prod
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float, Int, Shaped, UInt16, UInt32

from plr_jax._arrays import padded, padded_size
from plr_jax._compiled import pytree
from plr_jax.geometry.box import Box
from plr_jax.plr.folding import Folding
from plr_jax.plr.frame import (
    FRACTION_BITS,
    MOST_ROWS,
    WORD_BITS,
    Mirrors,
    PerAxis,
    PerBlock,
    block_shapes,
    byte_class,
    enumerate_boxes,
    folding_numbers,
    frame_of,
    max_entries,
    num_pairs,
    row_major,
    rows_of_class,
    slot_bits_of_rows,
    slots_in_blocks,
    spread_bits,
    unresolved_types,
)
from plr_jax.plr.tree import Cells

_MAX_BLOCK_BITS = 16  # most halvings of the grid of blocks, summed over the axes
_MOST_PAIRS = 2**20  # most pairs of a leaf and a block, unless a table may have more slots
# Tables whose slots store leaf parameters. Choices are few, as code is compiled for each.
_BLOCK_BITS = (10, 12, 14, 16)  # halvings of the grid of blocks; fewer bits are read faster
_SLOTS = [2**13, 2**14, 2**15, 3 * 2**14, 2**16]  # number of slots
_SLOTS_PER_ROW = 4  # least number of slots for each leaf of the size class
_SIZE_BITS = 4  # least bits of a word per axis
_MAX_COLUMN_BYTES = 9 * 2**15  # about half of a core's second-level cache; the other half is for leaf indices


def gather(table: Shaped[Array, " n"], index: UInt32[Array, "*batch"]) -> Shaped[Array, "*batch"]:
    """Return ``table[index]`` without a bounds check; all indices must be valid."""
    return table.at[index].get(mode="promise_in_bounds")


@dataclass(frozen=True, eq=False)
class PerPointTable:
    """Small arrays, one for each query point, in one flat array.

    ``t[i, j]`` reads entry ``[i, j]`` of every small array.
    """

    flat: Array
    shape: tuple[int, ...]  # of each point's array
    start: UInt32[Array, "*batch"]  # where each point's array begins in ``flat``
    dtype: Any  # of the values when read

    def astype(self, dtype: Any) -> "PerPointTable":
        return replace(self, dtype=dtype)

    def __getitem__(self, key: Any) -> Any:
        places = np.arange(prod(self.shape), dtype=np.uint32).reshape(self.shape)[key]
        entries = [gather(self.flat, self.start + place).astype(self.dtype) for place in places.flat]
        return jax.numpy.stack(entries) if places.ndim else entries[0]


@pytree
class FoldedDomain:
    """A domain whose points are folded (mapped by mirror symmetries) before their leaves are looked up."""

    frame: Float[Array, "7 dim"] | PerPointTable  # rows as in :class:`Frame`
    center: Float[Array, "2 dim"] | PerPointTable  # see :func:`folding_numbers`
    corners: Float[Array, "2 dim"] | PerPointTable  # of the box of folded points
    axes: Float[Array, "dim dim"] | PerPointTable | None  # one per row; None if they are the domain's
    # Each mirror has a pivot and all axes that it reverses: it mirrors points whose pivot coordinate is negative.
    mirrors: Mirrors = field(metadata={"static": True})
    periodic: tuple[int, ...] = field(metadata={"static": True})

    @property
    def dim(self) -> int:
        return self.frame.shape[1]


@pytree
class Blocks:
    """The coarse level of a lookup table: each cell of a coarse grid, a *block*, has a table for a finer grid.

    A block has one or more 32-bit *words*. The first word has, from its lowest bit, log2 of the finer grid's size
    along each axis, then the start of the block's table in ``leaf_of_slot``. Axes for which the first word has no
    room go into further words. Each word costs a query one read.
    """

    words: tuple[UInt32[Array, " blocks"], ...]
    shift: UInt32[Array, " dim"]  # number of a point's fraction bits below those that identify the block
    axes: tuple[int, ...] = field(metadata={"static": True})  # number of axes in each array of words
    width: int = field(metadata={"static": True})  # bits of a word per axis


def pack_blocks(
    shape: PerBlock, offset: Int[np.ndarray, " blocks_plus_one"], shift: PerAxis, least_width: int = 1
) -> Blocks:
    """Pack each block's data into words: log2 of its table's size by axis (``shape``) and the start (``offset``).

    ``shift`` has the number of bits of a point's position below those of its block, by axis. A size takes at least
    ``least_width`` bits.
    """
    #   first word  | start | ... | size of axis 1 | size of axis 0 |      `width` bits a size
    #   next word           | ... | size of axis k | size of axis k - 1 |  with axes that do not fit
    width = max(least_width, int(shape.max()).bit_length())
    axes_per_word = (WORD_BITS - int(offset[-1]).bit_length()) // width
    words, axes = [], []
    while not words or sum(axes) < shape.shape[1]:
        sizes = shape[:, sum(axes) : sum(axes) + axes_per_word]
        word = np.zeros(len(shape), np.int64) if words else offset[:-1]
        for size in sizes.T[::-1]:
            word = (word << width) | size
        words.append(jax.device_put(word.astype(np.uint32)))
        axes.append(sizes.shape[1])
        axes_per_word = WORD_BITS // width  # later words have no start
    return Blocks(tuple(words), jax.device_put(shift.astype(np.uint32)), tuple(axes), width)


def index_bits(bits: PerAxis) -> UInt32[Array, "2 dim"]:
    """Return masks and right shifts that turn fraction bits into an index in a grid of ``2**bits`` cells per axis."""
    mask = ((1 << bits) - 1) << (FRACTION_BITS - bits)
    return jax.device_put(np.stack([mask, FRACTION_BITS - np.cumsum(bits[::-1])[::-1]]).astype(np.uint32))


def num_slots(cells: Cells, shape: PerBlock) -> float:
    """Return the number of slots of leaves, and of blocks of the given ``shape`` that lie in several leaves."""
    return len(cells) + np.sum(2.0 ** shape[shape.any(axis=1)].sum(axis=1))


def choose_block_bits(
    partitions: Sequence[Cells], bits: PerAxis, most_slots: int, choices: Iterable[int], bytes_a_slot: int
) -> PerAxis | None:
    """Choose how often a coarse grid halves each axis, so that the lookup tables of PLRs take the least memory.

    ``partitions`` has the leaves of each PLR, and ``bits`` the halvings of the finest leaves by axis; ``choices``,
    ascending, are sums of the halvings. Return None if the tables of a PLR always exceed ``most_slots`` slots.
    """
    best, fewest = None, np.inf
    for most_bits in choices:
        block_bits = spread_bits(bits, most_bits)
        if max(num_pairs(cells, block_bits) for cells in partitions) > max(_MOST_PAIRS, most_slots):
            break  # finer blocks meet more leaves
        slots = [num_slots(cells, block_shapes(cells, block_bits)) for cells in partitions]
        size = len(partitions) * 4 * 2.0 ** block_bits.sum() + bytes_a_slot * sum(slots)  # bytes
        if max(slots) <= most_slots and size < fewest:
            best, fewest = block_bits, size
    return best


def leaves_of_slots(
    cells: Cells, block_bits: PerAxis, shape: PerBlock, has_own_slots: bool
) -> tuple[Int[np.ndarray, " blocks_plus_one"], UInt32[np.ndarray, " slots"]]:
    """Return the first slot of each block's table, and the number of all slots; also return the leaf of each slot.

    ``shape`` has log2 of the sizes of the blocks' tables by axis. If ``has_own_slots``, the first slots are those of
    the leaves, in their order, and a block that lies in one leaf has this leaf's slot instead of a table.
    """
    leaf, block, first, count = slots_in_blocks(cells, block_bits, shape)
    num_own = len(cells) if has_own_slots else 0
    is_alone = has_own_slots & ~shape.any(axis=1)
    offset = num_own + np.append(0, np.cumsum(np.where(is_alone, 0, 1 << shape.sum(axis=1))))
    offset[block[is_alone[block]]] = leaf[is_alone[block]]
    # Write a leaf at the first slot of each of its runs along the last axis, and repeat it up to the next run.
    count[:, -1] = 1
    pair, slot = enumerate_boxes(first, count)
    start = offset[block[pair]] + row_major(slot, shape[block[pair]])
    leaf_of_start = np.full(offset[-1], -1, np.int32)
    leaf_of_start[:num_own] = np.arange(num_own)
    leaf_of_start[start] = leaf[pair]
    starts = np.flatnonzero(leaf_of_start >= 0)
    return offset, np.repeat(leaf_of_start[starts].astype(np.uint32), np.diff(starts, append=offset[-1]))


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Tables:
    """Arrays that a query reads, padded so that PLRs whose files have similar sizes share compiled code."""

    # Arrays are few, as each adds to the cost of a call. Indices are unsigned, as JAX spends time on negative ones.
    frame: Float[Array, "7 dim"] | PerPointTable  # domain in 32-bit floats, rows as in :class:`Frame`
    bits: UInt32[Array, "2 dim"]  # mask of the fraction bits that index an entry or block, and their right shift
    blocks: Blocks | None
    leaf_of_slot: UInt16[Array, " slots"] | UInt32[Array, " slots"]
    # For each leaf or, if `is_by_slot`, for each slot: see :func:`arrange_parameters`.
    leaf_parameters: Float[Array, "count padded"] | Float[Array, " numbers"]
    leaf: Any = field(metadata={"static": True})
    is_by_slot: bool = field(metadata={"static": True}, default=False)
    periodic: tuple[int, ...] = field(metadata={"static": True}, default=())
    folding: FoldedDomain | None = None
    first_block: UInt32[Array, "*batch"] | None = (
        None  # in a stack of PLRs: number of the first block of each point's PLR
    )
    # Float types too coarse for this domain.
    unresolved: tuple[str, ...] = field(metadata={"static": True}, default=())
    straight: list[Any] | None = None  # arrays of a :class:`StraightBound`, a lower bound of all answers

    @property
    def dim(self) -> int:
        return self.frame.shape[1]

    def with_folding(self, folding: Folding | None, origin: Float[np.ndarray, "dim"]) -> "Tables":
        """Return tables whose queries first mirror points into the *folded* domain.

        The folded domain is the part of the domain that the leaves cover. The points of queries are relative to
        ``origin``. If ``folding`` is None, return these tables unchanged.
        """
        if folding is None:
            return self
        domain = folding.domain.moved(-origin)
        *arrays, mirrors = folding_numbers(folding, origin)
        periodic = tuple(np.flatnonzero(domain.periodic).tolist())
        window = FoldedDomain(*map(jax.device_put, (frame_of(domain), *arrays)), mirrors=mirrors, periodic=periodic)
        return replace(self, folding=window, unresolved=unresolved_types(domain))


def build_tables(
    domain: Box, cells: Cells, leaf_parameters: Float[np.ndarray, "leaves count"], leaf: Any, num_bytes: int
) -> Tables:
    """Build the lookup tables that map points to the parameters of their leaves, for a file of ``num_bytes`` bytes.

    ``leaf`` is the leaf model. ``ValueError`` if the tables would be too large.
    """
    size_class = byte_class(max(num_bytes, ceil(leaf.least_bytes * len(cells))))
    rows_of_file = rows_of_class(size_class, leaf.least_bytes)
    # Large tables are padded for their own number of leaves, not for the most leaves of the class.
    rows = rows_of_file if rows_of_file <= MOST_ROWS else padded_size(len(cells))
    leaf_parameters = leaf_parameters.astype(np.float32)
    # 1. Choose the grid of blocks: whose slots store leaf parameters, if that is possible, else leaf indices. A flat
    # table is the table of a single block, the domain.
    bits, block_bits = cells.depth.max(axis=0), None
    if leaf.has_deep_trees and rows <= MOST_ROWS:
        bytes_a_slot = 2 + leaf_parameters.itemsize * leaf_parameters.shape[1]
        block_bits = choose_block_bits([cells], bits, _SLOTS[-1], _BLOCK_BITS, bytes_a_slot)
    is_by_slot = block_bits is not None
    is_flat = not is_by_slot and bits.sum() <= slot_bits_of_rows(rows_of_file)
    if block_bits is None:
        choices = [0] if is_flat else range(1, 1 + min(_MAX_BLOCK_BITS, int(bits.sum())))
        block_bits = choose_block_bits([cells], bits, max_entries(num_bytes), choices, 2)
    if block_bits is None:
        deepest = bits.tolist()
        raise ValueError(f"Leaves are too deep for a query's tables: {deepest} splits by axis. Lower max_depth.")
    # 2. Fill the slots. `top` has the halvings of the grid whose cells are the first entries that a query reads.
    shape = block_shapes(cells, block_bits)
    offset, leaf_of_slot = leaves_of_slots(cells, block_bits, shape, not is_flat)
    leaf_of_slot = leaf_of_slot.astype(np.uint16 if rows <= 2**16 else np.uint32)
    top = bits if is_flat else block_bits
    blocks = None if is_flat else pack_blocks(shape, offset, FRACTION_BITS - top, _SIZE_BITS if is_by_slot else 1)
    if is_by_slot:
        slots = next(number for number in _SLOTS if number >= max(len(leaf_of_slot), _SLOTS_PER_ROW * rows))
        arranged = np.ascontiguousarray(padded(leaf_parameters[leaf_of_slot], slots).T)
    else:
        slots = 1 << max(slot_bits_of_rows(rows_of_file), (len(leaf_of_slot) - 1).bit_length())
        arranged = arrange_parameters(padded(leaf_parameters, rows))
    return Tables(
        frame=jax.device_put(frame_of(domain)),
        bits=index_bits(top),
        blocks=blocks,
        leaf_of_slot=jax.device_put(padded(leaf_of_slot, slots)),
        leaf_parameters=jax.device_put(arranged),
        leaf=leaf,
        is_by_slot=is_by_slot,
        periodic=tuple(np.flatnonzero(domain.periodic).tolist()),
        unresolved=unresolved_types(domain),
    )


def arrange_parameters(parameters: Float[np.ndarray, "rows count"]) -> Float[np.ndarray, "..."]:
    # Columns take the least arithmetic, a flat table saves cache misses.
    return parameters.ravel() if parameters.nbytes > _MAX_COLUMN_BYTES else np.ascontiguousarray(parameters.T)
