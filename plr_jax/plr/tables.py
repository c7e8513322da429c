"""Lookup tables: from a point to its leaf by arithmetic, not by descending a tree.

Cells are dyadic, so a point's place along an axis, as a binary fraction of the domain's width, begins with the bits
of its cell's position: its *slot*. A *flat* table has one entry a slot of the finest grid, ``2**sum(bits)`` in all,
with ``bits[a]`` the deepest split along axis ``a``. A deep tree would make that table huge although only a few of its
leaves are small, so past ``2**MAX_FLAT_BITS`` slots the grid is cut into *blocks*, and each block has a little table
of its own, just as fine along each axis as its own leaves need. Where a leaf model has deep trees, blocks of small
PLRs have *pages* instead (see below), whatever their depth: they are read about as fast as a flat table.

How large tables are the byte class of the file says, the exponent of the power of two that holds its bytes, so that
PLRs of one class and leaf model share compiled code: how many leaves there is room for and, by these, how many slots
there are. Beyond 16,384 leaves (planes of 32 KB, tied ones of 16, cones of 8) there is room for the next power of
two, and slots as many where leaves need more than the class has. What is left is padding, which is never read.

In the plane and on a line leaves of small classes need no more slots than the class of a budget has. There are two
exceptions, for which their class may have too few: planes without a budget may be as deep as if they had one of
32 KB, however small their file, in the plane up to 9 halvings along an axis; and what is certified while it grows may
be as deep as if it had pages. Pages nearly always fit the slots of their class, four a leaf that
it has room for, as blocks may be finer in four steps; else 65,536 slots, and else the leaves get no pages.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from math import prod
from operator import ge
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt16, UInt32

from plr_jax._arrays import padded, padded_size
from plr_jax.geometry.box import Box
from plr_jax.plr.folding import Folding
from plr_jax.plr.frame import (
    FRACTION_BITS,
    MAX_FLAT_BITS,
    MOST_ROWS,
    WORD_BITS,
    block_shapes,
    byte_class,
    enumerate_boxes,
    folding_numbers,
    frame_of,
    max_entries,
    mirrored_axes,
    num_pairs,
    row_major,
    rows_of_class,
    slot_bits_of_rows,
    slots_in_blocks,
    spread_bits,
    unresolved_types,
)
from plr_jax.plr.tree import Cells


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Trie:
    """The entries of several PLRs, and where the search of each point starts.

    Attributes:
        entries: Of all rows, all first pages, all others.
        bits: Of each level, which bits of a point's place along each axis tell entries of a page apart, as a mask,
            and how far right they belong in the index.
        start: Where the first page begins; of each point's PLR, or of the first PLR.
    """

    entries: UInt32[Array, "entries"]
    bits: UInt32[Array, "levels 2 dim"]
    start: UInt32[Array, "*batch"]


@dataclass(frozen=True, eq=False)
class PerPointTable:
    """An array that differs from point to point: as it were one of several, which one ``start`` says.

    It is indexed as an array is, up to numbers, of which there is one a point.

    Attributes:
        flat: The several arrays, one behind the other.
        shape: Of one of them.
        start: Where in ``flat`` each point's begins.
        dtype: The type of numbers that are read.
    """

    flat: Array
    shape: tuple[int, ...]
    start: UInt32[Array, "*batch"]
    dtype: Any

    def astype(self, dtype: Any) -> "PerPointTable":
        """The same, of numbers of another type."""
        return replace(self, dtype=dtype)

    def __iter__(self) -> Iterator[Any]:
        return (self[i] for i in range(self.shape[0]))

    def __getitem__(self, key: Any) -> Any:
        first, *rest = key if isinstance(key, tuple) else (key,)
        if isinstance(first, slice):
            return jnp.stack([self[(i, *rest)] for i in range(*first.indices(self.shape[0]))])
        size = prod(self.shape[1:])
        inner = replace(self, shape=self.shape[1:], start=self.start + np.uint32(int(first) * size))
        if rest:
            return inner[tuple(rest)]
        if inner.shape:
            return inner
        return self.flat.at[inner.start].get(mode="promise_in_bounds").astype(self.dtype)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class FoldedDomain:
    """A domain whose points are folded before their leaves are looked up.

    Attributes:
        frame: The domain, as ``Tables.frame`` is one.
        center: The center in 32-bit floats, and what they leave of it.
        corners: Of the box of folded points, rounded inward; infinite along periodic axes.
        axes: The axes of folded coordinates, one a row; None if they are those of the domain.
        mirrors: For each mirror its pivot, and the axes that it reverses.
        periodic: The periodic axes.
    """

    frame: Float[Array, "7 dim"] | PerPointTable
    center: Float[Array, "2 dim"] | PerPointTable
    corners: Float[Array, "2 dim"] | PerPointTable
    axes: Float[Array, "dim dim"] | PerPointTable | None
    mirrors: tuple[tuple[int, tuple[int, ...]], ...] = field(metadata={"static": True})
    periodic: tuple[int, ...] = field(metadata={"static": True})

    @property
    def dim(self) -> int:
        """Number of axes."""
        return self.frame.shape[1]


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

    words: tuple[UInt32[Array, "blocks"], ...]
    shift: UInt32[Array, "dim"]
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
        words.append(jax.device_put(word.astype(np.uint32)))
        axes.append(here.shape[1])
        room = WORD_BITS // width
    return Blocks(tuple(words), jax.device_put(shift.astype(np.uint32)), tuple(axes), width)


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


# Pages: two-level tables of small PLRs with deep trees, which cost a query no more reads than a flat table.
#
# The first slots are the leaves themselves, one each. A coarse block that one leaf covers has that leaf's slot; most
# points are in such blocks. Any other has a *page*: a slot for each cell of a grid just as fine along each axis as
# the block's own leaves need. A query reads the block's *word* and then, at the slot, the leaf's numbers, which are
# kept slot by slot: a flat table reads as often, a slot's leaf and the leaf's numbers.
#
# A word holds a mask of those bits of a point's place within the block that the page tells apart, and above them the
# page's first slot. So the slot is that start plus the masked bits, without a shift for each axis. The lower bits
# along an axis that a mask leaves out are gaps between the slots of its page, and other pages lie in these gaps.


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

    words: UInt32[Array, "blocks"]
    bits: UInt32[Array, "3 dim"]


def build_pages(
    cells: Cells, most_slots: int
) -> tuple[Pages, Int[np.ndarray, "dim"], Int[np.ndarray, "slots"]] | None:
    """Pages on the coarsest blocks with which so many slots suffice; None if there are none.

    With them the bits of blocks along each axis, and the leaf of every slot.
    """
    bits = cells.depth.max(axis=0)
    for most_bits in _BLOCK_BITS:
        block_bits = spread_bits(bits, most_bits)
        if num_pairs(cells, block_bits) > _MOST_PAIRS:
            break  # finer blocks meet more leaves
        # Words have room for a mask of a page and a start, and no bits of a place belong farther left.
        page_bits = bits - block_bits
        below = np.cumsum(page_bits[::-1])[::-1] - page_bits  # of all later axes, in an index
        right_of_place = FRACTION_BITS - bits - below
        if page_bits.sum() + most_slots.bit_length() > WORD_BITS or (right_of_place < 0).any():
            continue
        shape = block_shapes(cells, block_bits)
        if len(cells) + np.sum(2.0 ** shape[shape.any(axis=1)].sum(axis=1)) > most_slots:
            continue
        start, num_slots = _place_pages(shape, page_bits, below, len(cells))
        if num_slots > most_slots:
            continue
        # Words of all blocks, and leaves of all slots.
        leaf, block, first, count = slots_in_blocks(cells, block_bits, shape)
        alone = ~shape[block].any(axis=1)
        start[block[alone]] = leaf[alone]
        pair, slot = enumerate_boxes(first, count)
        leaf_of_slot = np.zeros(num_slots, np.int64)
        gaps = page_bits - shape[block[pair]]
        leaf_of_slot[start[block[pair]] + np.sum(slot << (gaps + below), axis=1)] = leaf[pair]
        leaf_of_slot[: len(cells)] = np.arange(len(cells))
        mask = np.sum(((1 << shape) - 1) << (page_bits - shape + below), axis=1)
        words = padded((start << page_bits.sum()) | mask, 1 << most_bits)
        place_bits = [((1 << page_bits) - 1) << (FRACTION_BITS - bits), right_of_place]
        place_bits.append(np.full_like(bits, page_bits.sum()))
        pages = Pages(jax.device_put(words.astype(np.uint32)), jax.device_put(np.stack(place_bits).astype(np.uint32)))
        return pages, block_bits, leaf_of_slot
    return None


def _place_pages(
    shape: Int[np.ndarray, "blocks dim"], page_bits: Int[np.ndarray, "dim"], below: Int[np.ndarray, "dim"], first: int
) -> tuple[Int[np.ndarray, "blocks"], int]:
    """First slot of every block's page, from a given one on, and where the last page ends; 0 of a block without one.

    The largest come first, those of one shape together. They take the smallest room that holds one, else a new one of
    the finest grid: all of it, if there are as many; else it is halved for one, along one axis after another, into
    every other slot, until the room has the page's shape.
    """
    finest = tuple(page_bits.tolist())
    rooms: dict[tuple[int, ...], list[int]] = {}
    start, end = np.zeros(len(shape), np.int64), first
    order = np.flatnonzero(shape.any(axis=1))
    order = order[np.lexsort((*shape[order].T, -shape[order].sum(axis=1)))]
    for blocks in np.split(order, 1 + np.flatnonzero((shape[order[1:]] != shape[order[:-1]]).any(axis=1))):
        page = tuple(shape[blocks[0]].tolist()) if len(blocks) else ()
        while len(blocks):
            holding = [room for room, places in rooms.items() if places and all(map(ge, room, page))]
            room = page if rooms.get(page) else min(holding, key=sum, default=None)
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


_PAGED_SLOTS_A_ROW, _LEAST_PAGED_SLOTS, _MOST_PAGED_SLOTS = 4, 2**13, 2**16
_MAX_COLUMN_BYTES = 9 * 2**15  # about half of a core's second-level cache, the other half is for slots


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
        blocks: Coarse level of a two-level table, or None.
        pages: Coarse level of a table with pages, or None; without either it is flat.
        leaf_of_slot: Leaf of each slot.
        leaf_parameters: What the leaf model reads of each leaf, or of each slot of a table with pages. Small tables have one
            row a number, which takes the least arithmetic, and so have pages, as most of their slots are hardly ever
            read. Large ones are one array in which a leaf's numbers stand side by side, so that a query waits for a
            cache line or two and not for one a number.
        leaf: The leaf model, whose ``value`` makes a value of them.
        periodic: The periodic axes, around which points are wrapped.
        folding: How points are folded before all this; None if they are not.
        trie: What leads from a point's place to a row of the numbers, in stacks of many PLRs; then none of the others
            is read.
        unresolved: Types of points that cannot be answered, see :func:`unresolved_types`.
    """

    frame: Float[Array, "7 dim"] | PerPointTable
    bits: UInt32[Array, "2 dim"]
    blocks: Blocks | None
    pages: Pages | None
    leaf_of_slot: UInt16[Array, "slots"] | UInt32[Array, "slots"]
    leaf_parameters: Float[Array, "count padded"] | Float[Array, "numbers"]
    leaf: Any = field(metadata={"static": True})
    periodic: tuple[int, ...] = field(metadata={"static": True}, default=())
    folding: FoldedDomain | None = None
    trie: Trie | None = None
    unresolved: tuple[str, ...] = field(metadata={"static": True}, default=())

    @property
    def dim(self) -> int:
        """Number of axes."""
        return self.frame.shape[1]

    def with_folding(self, folding: Folding | None, origin: Float[np.ndarray, "dim"]) -> "Tables":
        """The same, of points that are folded, and counted from an origin."""
        if folding is None:
            return self
        domain, (center, corners) = folding.domain.moved(-origin), folding_numbers(folding, origin)
        window = FoldedDomain(
            frame=jax.device_put(frame_of(domain)),
            center=jax.device_put(center),
            corners=jax.device_put(corners),
            axes=jax.device_put(folding.axes.astype(np.float32)) if folding.is_turned else None,
            mirrors=mirrored_axes(folding),
            periodic=tuple(np.flatnonzero(domain.periodic).tolist()),
        )
        return replace(self, folding=window, unresolved=unresolved_types(domain))


def build_tables(
    domain: Box, cells: Cells, numbers: Float[np.ndarray, "leaves count"], leaf: Any, num_bytes: int
) -> Tables:
    """Tables of a partition whose leaf ``i`` is ``cells[i]`` and has ``numbers[i]``.

    The size of the file fixes that of the tables and bounds it: raises ``ValueError`` if the leaves are too deep.
    """
    of_class = byte_class(max(num_bytes, math.ceil(leaf.least_bytes * len(cells))))
    rows_of_file = rows_of_class(of_class, leaf.least_bytes)
    # Large tables are not padded to what the class may need at the most.
    rows = rows_of_file if rows_of_file <= MOST_ROWS else padded_size(len(cells))
    numbers, bits, blocks, paged = numbers.astype(np.float32), cells.depth.max(axis=0), None, None
    # 1. Pages, with room for so many slots.
    if leaf.has_deep_trees and rows <= MOST_ROWS:
        slots = max(_LEAST_PAGED_SLOTS, _PAGED_SLOTS_A_ROW * rows)
        if (paged := build_pages(cells, slots)) is None:
            paged = build_pages(cells, slots := _MOST_PAGED_SLOTS)
    if paged is not None:
        pages, top, leaf_of_slot = paged
        leaf_of_slot = leaf_of_slot.astype(np.uint16)
        of_leaves = np.ascontiguousarray(padded(numbers[leaf_of_slot], slots).T)
    # 2. A flat table, or blocks.
    else:
        pages, flat = None, bits.sum() <= MAX_FLAT_BITS
        block_bits = 0 * bits if flat else choose_block_bits(cells, bits, max_entries(num_bytes))
        shape = block_shapes(cells, block_bits)
        offset = np.concatenate([[0], np.cumsum(np.int64(1) << shape.sum(axis=1))])
        leaf_of_slot = leaves_of_slots(cells, block_bits, shape, offset)
        leaf_of_slot = leaf_of_slot.astype(np.uint16 if rows <= 2**16 else np.uint32)
        slots = 1 << max(slot_bits_of_rows(rows_of_file), (len(leaf_of_slot) - 1).bit_length())
        top = bits if flat else block_bits
        blocks = None if flat else pack_blocks(shape, offset, FRACTION_BITS - top)
        of_leaves = arrange_parameters(padded(numbers, rows))
    # An index is made of the first bits along each axis of a point's place.
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


def arrange_parameters(
    numbers: Float[np.ndarray, "rows count"],
) -> Float[np.ndarray, "count rows"] | Float[np.ndarray, "numbers"]:
    """Numbers of leaves as :class:`Tables` has them: one row a number, of large tables a leaf's side by side."""
    return numbers.ravel() if numbers.nbytes > _MAX_COLUMN_BYTES else np.ascontiguousarray(numbers.T)
