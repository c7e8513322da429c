"""Lookup tables that map a point to its leaf by bit arithmetic, without descending a tree.

The highest bits of a point's position (``frame.py``) are its *slot*, a cell of a regular grid. There are 3 layouts:

- A *flat* table has one entry for each slot: the slot's leaf.
- *Blocks*, where a flat table exceeds its size class: each cell of a coarse grid (block) has its own grid of slots.
- *Pages*, for small PLRs with deep trees: as blocks, but slots store leaf parameters, which saves a read.
"""

import math
from dataclasses import dataclass, field, replace
from math import prod
from operator import ge
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

PerAxis = Int[np.ndarray, "dim"]
PerBlock = Int[np.ndarray, "blocks dim"]
_MAX_BLOCK_BITS = 16
_BLOCK_BITS = (10, 12, 14, 16)  # few choices, as code is compiled for each; fewer bits are read faster
_MOST_PAIRS = 2**20  # most pairs of leaf and block while pages are built
# Slots with pages: at least four for each leaf of the size class. Few sizes, as code is compiled for each.
_PAGED_SLOTS_A_ROW, _PAGED_SLOTS = 4, [2**13, 2**14, 2**15, 3 * 2**14, 2**16]
_MAX_COLUMN_BYTES = 9 * 2**15  # about half of a core's second-level cache; the other half is for slots


def gather(table: Shaped[Array, " n"], index: UInt32[Array, "*batch"]) -> Shaped[Array, "*batch"]:
    """Return ``table[index]`` without a bounds check."""
    return table.at[index].get(mode="promise_in_bounds")


@pytree
class Trie:
    """A lookup table of several PLRs in one array, which a query reads level by level, from coarse to fine."""

    entries: UInt32[Array, " entries"]
    bits: UInt32[Array, "levels 2 dim"]  # masks of a point's fraction bits, and their right shifts in an index
    start: UInt32[Array, "*batch"]  # first entry of one PLR, or of each point's PLR


@dataclass(frozen=True, eq=False)
class PerPointTable:
    """Small arrays, one for each query point, in one flat array; ``t[i, j]`` reads that entry for all points."""

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
    mirrors: tuple[tuple[int, tuple[int, ...]], ...] = field(metadata={"static": True})
    periodic: tuple[int, ...] = field(metadata={"static": True})

    @property
    def dim(self) -> int:
        return self.frame.shape[1]


@pytree
class Blocks:
    """The coarse level of a lookup table: each cell of a coarse grid, a *block*, has a table for a finer grid.

    A block's *word* has, from its lowest bit, log2 of the finer grid's size along each axis, then the table's start
    in ``leaf_of_slot``. Axes that do not fit go into further words, each of which costs a query one more read.
    """

    words: tuple[UInt32[Array, " blocks"], ...]
    shift: UInt32[Array, " dim"]  # number of a point's fraction bits below those that identify the block
    axes: tuple[int, ...] = field(metadata={"static": True})  # how many each array of words describes
    width: int = field(metadata={"static": True})  # bits of a word per axis


def pack_blocks(shape: PerBlock, offset: Int[np.ndarray, " blocks_plus_one"], shift: PerAxis) -> Blocks:
    # ``shape`` has log2 of the sizes of the blocks' tables by axis, ``offset`` their starts. ``shift`` counts the
    # bits of a point's position below those of its block, by axis.
    width = max(1, int(shape.max()).bit_length())
    room = (WORD_BITS - int(offset[-1]).bit_length()) // width
    first, words, axes = offset[:-1], [], []
    while not words or sum(axes) < shape.shape[1]:
        here = shape[:, sum(axes) : sum(axes) + room]
        word = np.zeros(len(shape), np.int64) if words else first
        for column in here.T[::-1]:
            word = (word << width) | column
        words.append(jax.device_put(word.astype(np.uint32)))
        axes.append(here.shape[1])
        room = WORD_BITS // width
    return Blocks(tuple(words), jax.device_put(shift.astype(np.uint32)), tuple(axes), width)


def choose_block_bits(cells: Cells, bits: PerAxis, max_entries: int) -> PerAxis:
    """Choose how often a coarse grid halves each axis, so that its cells' lookup tables take the least memory.

    ``bits`` has the halvings of the finest leaves by axis. ``ValueError`` if all tables exceed ``max_entries``.
    """
    best, fewest = None, np.inf
    for most in range(1, 1 + min(_MAX_BLOCK_BITS, int(bits.sum()))):
        block_bits = spread_bits(bits, most)
        if num_pairs(cells, block_bits) > max_entries:
            break  # finer blocks meet more leaves
        slots = np.sum(2.0 ** block_shapes(cells, block_bits).sum(axis=1))
        size = 4 * 2.0 ** block_bits.sum() + 2 * slots
        if slots <= max_entries and size < fewest:
            best, fewest = block_bits, size
    if best is None:
        raise ValueError(
            f"Leaves are too deep for a query's tables: {bits.tolist()} splits by axis. Lower max_depth."
        )
    return best


def leaves_of_slots(
    cells: Cells, block_bits: PerAxis, shape: PerBlock, offset: Int[np.ndarray, " blocks_plus_one"]
) -> UInt32[np.ndarray, " slots"]:
    # ``shape`` has log2 of the sizes of the blocks' tables by axis, ``offset`` their first entries.
    # Write a leaf at the first slot of each of its runs along the last axis, and repeat it up to the next run.
    leaf, block, first, count = slots_in_blocks(cells, block_bits, shape)
    count[:, -1] = 1
    pair, slot = enumerate_boxes(first, count)
    start = offset[block[pair]] + row_major(slot, shape[block[pair]])
    leaf_of_start = np.zeros(offset[-1], np.uint32)
    is_start = np.zeros(offset[-1], bool)
    leaf_of_start[start], is_start[start] = leaf[pair], True
    starts = np.flatnonzero(is_start)
    return np.repeat(leaf_of_start[starts], np.diff(starts, append=offset[-1]))


@pytree
class Pages:
    """The coarse level of a lookup table whose entries, called *slots*, each hold the parameters of a leaf.

    The first slots hold all leaves in order. A *block*, a cell of a coarse grid, refers to one of these slots if it
    lies in one leaf. Any other block has a *page*: slots for a finer grid that separates the leaves in the block. A
    point's slot is the page's start plus some bits of the point's position, which a mask selects. If these bits are
    not adjacent, the page has gaps, which slots of other pages fill.
    """

    words: UInt32[Array, " blocks"]  # mask of the fraction bits that index the page; above it, the page's start
    bits: UInt32[Array, "3 dim"]  # mask of fraction bits below a block, their right shift, width of a word's mask


def build_pages(
    cells: Cells, classes: list[int], numbers_a_slot: int
) -> tuple[Pages, PerAxis, Int[np.ndarray, " slots"], int] | None:
    """Build a lookup table with pages (:class:`Pages`); None if leaves are too many or too deep for such a table.

    Return the pages, how often their grid halves each axis, the leaf in each slot, and the number of slots after
    padding. It is one of ``classes``, which rise; the table takes least memory.
    """
    bits, best, fewest = cells.depth.max(axis=0), None, np.inf
    for most_bits in _BLOCK_BITS:
        block_bits = spread_bits(bits, most_bits)
        if num_pairs(cells, block_bits) > _MOST_PAIRS:
            break  # finer blocks meet more leaves
        # Skip blocks whose words cannot hold mask and start, or whose fraction bits would need a left shift.
        page_bits = bits - block_bits
        below = np.cumsum(page_bits[::-1])[::-1] - page_bits  # index bits of all later axes
        right_of_place = FRACTION_BITS - bits - below
        if page_bits.sum() + classes[-1].bit_length() > WORD_BITS or (right_of_place < 0).any():
            continue
        shape = block_shapes(cells, block_bits)
        if len(cells) + np.sum(2.0 ** shape[shape.any(axis=1)].sum(axis=1)) > classes[-1]:
            continue
        start, num_slots = _place_pages(shape, page_bits, below, len(cells))
        slots = next((each for each in classes if num_slots <= each), None)
        if slots is not None and (size := (4 << most_bits) + slots * (2 + 4 * numbers_a_slot)) < fewest:
            best, fewest = (block_bits, page_bits, below, shape, start, num_slots, slots), size
        if slots == classes[0]:
            break  # finer blocks take more memory
    if best is None:
        return None
    block_bits, page_bits, below, shape, start, num_slots, slots = best
    leaf, block, first, count = slots_in_blocks(cells, block_bits, shape)
    alone = ~shape[block].any(axis=1)
    start[block[alone]] = leaf[alone]
    pair, slot = enumerate_boxes(first, count)
    leaf_of_slot = np.zeros(num_slots, np.int64)
    gaps = page_bits - shape[block[pair]]
    leaf_of_slot[start[block[pair]] + np.sum(slot << (gaps + below), axis=1)] = leaf[pair]
    leaf_of_slot[: len(cells)] = np.arange(len(cells))
    mask = np.sum(((1 << shape) - 1) << (page_bits - shape + below), axis=1)
    words = padded((start << page_bits.sum()) | mask, 1 << int(block_bits.sum()))
    place = ((1 << page_bits) - 1) << (FRACTION_BITS - bits), FRACTION_BITS - bits - below, page_bits.sum() + 0 * bits
    pages = Pages(jax.device_put(words.astype(np.uint32)), jax.device_put(np.stack(place).astype(np.uint32)))
    return pages, block_bits, leaf_of_slot, slots


def _place_pages(
    shape: PerBlock, page_bits: PerAxis, below: PerAxis, first: int
) -> tuple[Int[np.ndarray, " blocks"], int]:
    # A buddy allocator places pages by decreasing size, from the slot ``first`` on. Either half of a room that it
    # halves has every other slot. ``below`` counts the bits of later axes in the index of a slot in the largest page.
    finest = tuple(page_bits.tolist())
    rooms: dict[tuple[int, ...], Int[np.ndarray, " _"]] = {}  # starts of free rooms, by shape
    start, end = np.zeros(len(shape), np.int64), first
    order = np.flatnonzero(shape.any(axis=1))
    order = order[np.lexsort((*shape[order].T, -shape[order].sum(axis=1)))]
    for blocks in np.split(order, 1 + np.flatnonzero((shape[order[1:]] != shape[order[:-1]]).any(axis=1))):
        page = tuple(shape[blocks[0]].tolist()) if len(blocks) else ()
        while len(blocks):
            holding = (room for room, starts in rooms.items() if len(starts) and all(map(ge, room, page)))
            room = min(holding, key=sum, default=None)
            if room is None:
                room, rooms[finest], end = finest, np.array([end]), end + (1 << sum(finest))
            count = -(-len(blocks) >> (sum(room) - sum(page)))  # rooms that these pages need
            places, rooms[room] = np.split(rooms[room], [count])
            if room == page:
                start[blocks[: len(places)]], blocks = places, blocks[len(places) :]
                continue
            axis = next(axis for axis, wanted in enumerate(page) if room[axis] > wanted)
            half = (*room[:axis], room[axis] - 1, *room[axis + 1 :])
            step = 1 << int(below[axis] + page_bits[axis] - room[axis])
            rooms[half] = np.concatenate([rooms.get(half, places[:0]), places, places + step])
    return start, end


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Tables:
    """Arrays that a query reads, padded so that PLRs whose files have similar sizes share compiled code."""

    # Arrays are few, as each adds to the cost of a call. Indices are unsigned, as JAX spends time on negative ones.
    frame: Float[Array, "7 dim"] | PerPointTable  # domain in 32-bit floats, rows as in :class:`Frame`
    bits: UInt32[Array, "2 dim"]  # mask of the fraction bits that index an entry or block, and their right shift
    blocks: Blocks | None
    pages: Pages | None
    leaf_of_slot: UInt16[Array, " slots"] | UInt32[Array, " slots"]
    # For each leaf or, with pages, for each slot: see :func:`arrange_parameters`.
    leaf_parameters: Float[Array, "count padded"] | Float[Array, " numbers"]
    leaf: Any = field(metadata={"static": True})
    periodic: tuple[int, ...] = field(metadata={"static": True}, default=())
    folding: FoldedDomain | None = None
    trie: Trie | None = None  # in stacks of many PLRs, used instead of all other lookup tables
    unresolved: tuple[str, ...] = field(metadata={"static": True}, default=())  # too coarse float types
    straight: list[Any] | None = None  # arrays of a :class:`StraightBound`, below which no answer is

    @property
    def dim(self) -> int:
        return self.frame.shape[1]

    def with_folding(self, folding: Folding | None, origin: Float[np.ndarray, "dim"]) -> "Tables":
        """Return tables whose queries first mirror points (given minus ``origin``) into the part the tree covers."""
        if folding is None:
            return self
        domain, (*arrays, mirrors) = folding.domain.moved(-origin), folding_numbers(folding, origin)
        periodic = tuple(np.flatnonzero(domain.periodic).tolist())
        frame, center, corners, axes = map(jax.device_put, (frame_of(domain), *arrays))
        window = FoldedDomain(frame, center, corners, axes, mirrors, periodic)
        return replace(self, folding=window, unresolved=unresolved_types(domain))


def build_tables(
    domain: Box, cells: Cells, numbers: Float[np.ndarray, "leaves count"], leaf: Any, num_bytes: int
) -> Tables:
    """Build lookup tables of leaf parameters (``numbers``); ``ValueError`` if the tables would be too large."""
    of_class = byte_class(max(num_bytes, math.ceil(leaf.least_bytes * len(cells))))
    rows_of_file = rows_of_class(of_class, leaf.least_bytes)
    # Large tables are padded for their own number of leaves, not for the most leaves of the class.
    rows = rows_of_file if rows_of_file <= MOST_ROWS else padded_size(len(cells))
    numbers, bits, blocks, paged = numbers.astype(np.float32), cells.depth.max(axis=0), None, None
    # 1. Try pages.
    if leaf.has_deep_trees and rows <= MOST_ROWS:
        least = _PAGED_SLOTS_A_ROW * rows
        paged = build_pages(cells, [slots for slots in _PAGED_SLOTS if slots >= least], numbers.shape[1])
    if paged is not None:
        pages, top, leaf_of_slot, slots = paged
        leaf_of_slot = leaf_of_slot.astype(np.uint16)
        of_leaves = np.ascontiguousarray(padded(numbers[leaf_of_slot], slots).T)
    # 2. Else build a flat table, or blocks.
    else:
        pages, flat = None, bits.sum() <= slot_bits_of_rows(rows_of_file)
        block_bits = 0 * bits if flat else choose_block_bits(cells, bits, max_entries(num_bytes))
        shape = block_shapes(cells, block_bits)
        offset = np.concatenate([[0], np.cumsum(np.int64(1) << shape.sum(axis=1))])
        leaf_of_slot = leaves_of_slots(cells, block_bits, shape, offset)
        leaf_of_slot = leaf_of_slot.astype(np.uint16 if rows <= 2**16 else np.uint32)
        slots = 1 << max(slot_bits_of_rows(rows_of_file), (len(leaf_of_slot) - 1).bit_length())
        top = bits if flat else block_bits
        blocks = None if flat else pack_blocks(shape, offset, FRACTION_BITS - top)
        of_leaves = arrange_parameters(padded(numbers, rows))
    # Select the highest fraction bits along each axis.
    mask = ((1 << top) - 1) << (FRACTION_BITS - top)
    return Tables(
        frame=jax.device_put(frame_of(domain)),
        bits=jax.device_put(np.stack([mask, FRACTION_BITS - np.cumsum(top[::-1])[::-1]]).astype(np.uint32)),
        blocks=blocks,
        pages=pages,
        leaf_of_slot=jax.device_put(padded(leaf_of_slot, slots)),
        leaf_parameters=jax.device_put(of_leaves),
        leaf=leaf,
        periodic=tuple(np.flatnonzero(domain.periodic).tolist()),
        unresolved=unresolved_types(domain),
    )


def arrange_parameters(numbers: Float[np.ndarray, "rows count"]) -> Float[np.ndarray, "..."]:
    # Columns take the least arithmetic, a flat table saves cache misses.
    return numbers.ravel() if numbers.nbytes > _MAX_COLUMN_BYTES else np.ascontiguousarray(numbers.T)
