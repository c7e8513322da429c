"""Pages: two-level tables of small PLRs with deep trees, which cost a query no more reads than a flat table.

The first slots are the leaves themselves, one each. A coarse block that one leaf covers has that leaf's slot; most
points are in such blocks. Any other has a *page*: a slot for each cell of a grid just as fine along each axis as the
block's own leaves need. A query reads the block's *word* and then, at the slot, the leaf's numbers, which are kept
slot by slot: a flat table reads as often, a slot's leaf and the leaf's numbers.

A word holds a mask of those bits of a point's place within the block that the page tells apart, and above them the
page's first slot. So the slot is that start plus the masked bits, without a shift for each axis. The lower bits along
an axis that a mask leaves out are gaps between the slots of its page, and other pages lie in these gaps.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int, UInt32

from plr_jax._arrays import padded
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.query.grid import (
    FRACTION_BITS,
    WORD_BITS,
    block_shapes,
    enumerate_boxes,
    num_pairs,
    row_major,
    slots_in_blocks,
    spread_bits,
)
from plr_jax.plr.query.reads import Picked, gather, shift_right

# Two-level tables of any size: each coarse block has a little table of its own, just as fine as its leaves need.


_MAX_BLOCK_BITS = 16


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Blocks:
    """The coarse level of a two-level table; ``None`` in its place means one flat table.

    A block's *word* holds, from its lowest bit, how many bits of a point's place the block's own table resolves along
    each axis, ``width`` bits an axis, and above them where that table starts in ``leaf_of_slot``. Axes for which the
    first word has no room come in further words. One word is read with one gather, which is what a query costs.
    Each describes so many ``axes``; ``shift`` bits of a point's place along each axis are below its block.
    """

    words: tuple[UInt32[Array, "blocks"] | Picked, ...]
    shift: UInt32[Array, "dim"] | Picked
    axes: tuple[int, ...] = field(metadata={"static": True})
    width: int = field(metadata={"static": True})


def pack_blocks(
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


def choose_block_bits(cells: Cells, bits: Int[np.ndarray, "dim"], max_entries: int) -> Int[np.ndarray, "dim"]:
    """Coarse bits along each axis: those with which words and blocks' own tables take the fewest bytes."""
    best, fewest = None, np.inf
    block_bits = np.zeros_like(bits)
    while block_bits.sum() < min(_MAX_BLOCK_BITS, bits.sum()):
        block_bits[np.argmax(bits - block_bits)] += 1
        if num_pairs(cells, block_bits) > max_entries:
            break  # finer blocks meet more leaves
        slots = np.sum(2.0 ** block_shapes(cells, block_bits).sum(axis=1))
        size = 4 * 2.0 ** block_bits.sum() + 2 * slots
        if slots <= max_entries and size < fewest:
            best, fewest = block_bits.copy(), size
    if best is None:
        raise ValueError(
            f"The leaves are too deep for a query's tables: {bits.tolist()} splits along the axes. Lower max_depth."
        )
    return best


def leaves_of_slots(
    cells: Cells,
    block_bits: Int[np.ndarray, "dim"],
    shape: Int[np.ndarray, "blocks dim"],
    offset: Int[np.ndarray, "blocks_plus_one"],
) -> UInt32[np.ndarray, "slots"]:
    """The leaf of every slot of the tables of all blocks.

    Along the last axis a leaf covers slots in a row. It is written at the first slot of each of its runs, and from
    there to the start of the next, whichever leaf's that is.
    """
    leaf, block, first, count = slots_in_blocks(cells, block_bits, shape)
    count[:, -1] = 1
    pair, slot = enumerate_boxes(first, count)
    start = offset[block[pair]] + row_major(slot, shape[block[pair]])
    leaf_of_start = np.zeros(offset[-1], np.uint32)
    is_start = np.zeros(offset[-1], bool)
    leaf_of_start[start], is_start[start] = leaf[pair], True
    starts = np.flatnonzero(is_start)
    return np.repeat(leaf_of_start[starts], np.diff(starts, append=offset[-1]))


def index_in_block(
    blocks: Blocks, places: list[UInt32[Array, "*batch"]], block: UInt32[Array, "*batch"]
) -> UInt32[Array, "*batch"]:
    """Index into ``leaf_of_slot`` of points in given blocks."""
    index = start = jnp.zeros_like(block)
    axis = 0
    for number, (table, axes) in enumerate(zip(blocks.words, blocks.axes, strict=True)):
        word = gather(table, block)
        for slot in range(axes):
            bits = (word >> np.uint32(slot * blocks.width)) & np.uint32(2**blocks.width - 1)
            within = places[axis] & ((np.uint32(1) << (blocks.shift[axis] & np.uint32(WORD_BITS - 1))) - np.uint32(1))
            index = (index << bits) | shift_right(within, blocks.shift[axis] - bits)
            axis += 1
        if number == 0:
            start = word >> np.uint32(axes * blocks.width)
    return start + index


_BLOCK_BITS = (10, 12, 14, 16)  # few, as words of each number are compiled for; the fewest are read the fastest
_MOST_PAIRS = 2**20


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Pages:
    """What leads from a block to a slot.

    Attributes:
        words: A block's mask and, above it, the first slot of its page.
        bits: Which bits of a point's place along each axis tell slots of a block apart, as a mask, how far right they
            belong in the index, and at which bit of a word its start is (the same for all axes).
    """

    words: UInt32[Array, "blocks"] | Picked
    bits: UInt32[Array, "3 dim"] | Picked


class PagedLeaves(NamedTuple):
    """A partition's pages, the bits of its blocks along each axis, and the leaf of every slot."""

    pages: Pages
    block_bits: Int[np.ndarray, "dim"]
    leaf_of_slot: Int[np.ndarray, "slots"]


def build_pages(cells: Cells, most_slots: int) -> PagedLeaves | None:
    """Pages on the coarsest blocks with which so many slots suffice; None if there are none."""
    bits = cells.depth.max(axis=0)
    for most_bits in _BLOCK_BITS:
        block_bits = spread_bits(bits, most_bits)
        if num_pairs(cells, block_bits) > _MOST_PAIRS:
            break  # finer blocks meet more leaves
        if not _can_be_read(bits, bits - block_bits, most_slots):
            continue
        shape = block_shapes(cells, block_bits)
        if len(cells) + np.sum(2.0 ** shape[shape.any(axis=1)].sum(axis=1)) > most_slots:
            continue
        start, num_slots = _place_pages(shape, bits - block_bits, len(cells))
        if num_slots <= most_slots:
            return _fill_pages(cells, block_bits, shape, start, num_slots, 1 << most_bits)
    return None


def _can_be_read(bits: Int[np.ndarray, "dim"], page_bits: Int[np.ndarray, "dim"], most_slots: int) -> bool:
    """Whether words have room for a mask of a page and a start, and no bits of a place belong farther left."""
    fits_word = page_bits.sum() + most_slots.bit_length() <= WORD_BITS
    return bool(fits_word and (_right_of_place(bits, page_bits) >= 0).all())


def _place_pages(
    shape: Int[np.ndarray, "blocks dim"], page_bits: Int[np.ndarray, "dim"], first: int
) -> tuple[Int[np.ndarray, "blocks"], int]:
    """First slot of every block's page, from a given one on, and where the last page ends; 0 of a block without one.

    The largest come first, those of one shape together. They take the smallest room that holds one, else a new one of
    the finest grid: all of it, if there are as many; else it is halved for one, along one axis after another, into
    every other slot, until the room has the page's shape.
    """
    finest, below = tuple(page_bits.tolist()), _bits_below(page_bits)
    rooms: dict[tuple[int, ...], list[int]] = {}
    start, end = np.zeros(len(shape), np.int64), first
    order = np.flatnonzero(shape.any(axis=1))
    order = order[np.lexsort((*shape[order].T, -shape[order].sum(axis=1)))]
    for blocks in np.split(order, 1 + np.flatnonzero((shape[order[1:]] != shape[order[:-1]]).any(axis=1))):
        page = tuple(shape[blocks[0]].tolist()) if len(blocks) else ()
        while len(blocks):
            room = _smallest_that_holds(rooms, page)
            if room is None:
                room, end = finest, end + (1 << sum(finest))
                rooms.setdefault(room, []).append(end - (1 << sum(finest)))
            # Beside the first page, the others of a room begin as often along each axis as that is wider.
            beside = np.zeros(1, np.int64)
            for axis, wanted in enumerate(page):
                step = 1 << int(below[axis] + page_bits[axis] - room[axis])
                beside = (beside + (step * np.arange(1 << (room[axis] - wanted)))[:, None]).ravel()
            if len(blocks) >= len(beside):
                count = min(len(blocks) // len(beside), len(rooms[room]))
                places, rooms[room] = np.array(rooms[room][:count]), rooms[room][count:]
                placed, blocks = np.split(blocks, [count * len(beside)])
                start[placed] = (places[:, None] + beside).ravel()
                continue
            place = rooms[room].pop()
            for axis, wanted in enumerate(page):
                for bits in range(room[axis], wanted, -1):
                    room = (*room[:axis], bits - 1, *room[axis + 1 :])
                    rooms.setdefault(room, []).append(place + (1 << int(below[axis] + page_bits[axis] - bits)))
            start[blocks[0]], blocks = place, blocks[1:]
    return start, end


def _smallest_that_holds(rooms: dict[tuple[int, ...], list[int]], page: tuple[int, ...]) -> tuple[int, ...] | None:
    """Shape of the smallest free room that holds a page."""
    if rooms.get(page):
        return page
    free = (room for room, places in rooms.items() if places)
    holding = (room for room in free if all(has >= wanted for has, wanted in zip(room, page, strict=True)))
    return min(holding, key=sum, default=None)


def _fill_pages(
    cells: Cells,
    block_bits: Int[np.ndarray, "dim"],
    shape: Int[np.ndarray, "blocks dim"],
    start: Int[np.ndarray, "blocks"],
    num_slots: int,
    num_words: int,
) -> PagedLeaves:
    """Words of all blocks and leaves of all slots, of pages that start at given ones."""
    bits = cells.depth.max(axis=0)
    page_bits = bits - block_bits
    below = _bits_below(page_bits)
    leaf, block, first, count = slots_in_blocks(cells, block_bits, shape)
    alone = ~shape[block].any(axis=1)
    start[block[alone]] = leaf[alone]
    pair, slot = enumerate_boxes(first, count)
    leaf_of_slot = np.zeros(num_slots, np.int64)
    gaps = page_bits - shape[block[pair]]
    leaf_of_slot[start[block[pair]] + np.sum(slot << (gaps + below), axis=1)] = leaf[pair]
    leaf_of_slot[: len(cells)] = np.arange(len(cells))
    mask = np.sum(((1 << shape) - 1) << (page_bits - shape + below), axis=1)
    words = padded((start << page_bits.sum()) | mask, num_words)
    place_bits = [((1 << page_bits) - 1) << (FRACTION_BITS - bits), _right_of_place(bits, page_bits)]
    place_bits.append(np.full_like(bits, page_bits.sum()))
    pages = Pages(jnp.asarray(words.astype(np.uint32)), jnp.asarray(np.stack(place_bits).astype(np.uint32)))
    return PagedLeaves(pages, block_bits, leaf_of_slot)


def _bits_below(bits: Int[np.ndarray, "dim"]) -> Int[np.ndarray, "dim"]:
    """Bits of all later axes, below which each axis has its own in an index."""
    return np.cumsum(bits[::-1])[::-1] - bits


def _right_of_place(bits: Int[np.ndarray, "dim"], page_bits: Int[np.ndarray, "dim"]) -> Int[np.ndarray, "dim"]:
    """How far right of their place in a point's fraction the bits within a block belong; below 0 they do not fit."""
    return FRACTION_BITS - bits - _bits_below(page_bits)
