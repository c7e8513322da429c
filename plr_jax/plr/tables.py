"""Lookup tables that map a point to its leaf by bit arithmetic, without descending a tree.

The highest bits of a point's position along each axis select an entry. There are 3 layouts:

- A *flat* table has one entry for each cell of a regular grid: the cell's leaf.
- *Blocks* are for PLRs whose flat table would be too large. Each cell of a coarse grid, a block, has a finer grid of
  its own. The table has an entry for each cell of the finer grids: the cell's leaf.
- *Pages* are for small PLRs with deep trees. They are like blocks, but entries store leaf parameters instead of leaf
  indices, which saves a read.
"""

from dataclasses import dataclass, field, replace
from math import ceil, prod
from operator import ge
from typing import Any, TypeAlias

import jax
import numpy as np
from jaxtyping import Array, Float, Int, Shaped, UInt16, UInt32

from plr_jax._arrays import padded, padded_size
from plr_jax._compiled import pytree
from plr_jax.geometry.box import Box
from plr_jax.plr.folding import Folding
from plr_jax.plr.frame import FRACTION_BITS, WORD_BITS, Mirrors, folding_numbers, frame_of, unresolved_types
from plr_jax.plr.sizes import MOST_ROWS, byte_class, max_entries, rows_of_class, slot_bits_of_rows
from plr_jax.plr.tree import Cells, PerAxis, enumerate_boxes, leaves_in_blocks, num_pairs, row_major, spread_bits

PerBlock: TypeAlias = Int[np.ndarray, "blocks dim"]
Pairs: TypeAlias = Int[np.ndarray, " pairs"]
OfPairs: TypeAlias = Int[np.ndarray, "pairs dim"]
_MAX_BLOCK_BITS = 16  # most halvings of the grid of blocks, summed over the axes
_BLOCK_BITS = (10, 12, 14, 16)  # few choices, as code is compiled for each; fewer bits are read faster
_MOST_PAIRS = 2**20  # most pairs of leaf and block while pages are built
_PAGED_ENTRIES_PER_ROW = 4  # least number of entries with pages, for each leaf of the size class
_PAGED_ENTRIES = [2**13, 2**14, 2**15, 3 * 2**14, 2**16]  # few numbers of them, as code is compiled for each
_MAX_COLUMN_BYTES = 9 * 2**15  # about half of a core's second-level cache; the other half is for leaf indices


def gather(table: Shaped[Array, " n"], index: UInt32[Array, "*batch"]) -> Shaped[Array, "*batch"]:
    """Return ``table[index]`` without a bounds check; all indices must be valid."""
    return table.at[index].get(mode="promise_in_bounds")


@pytree
class Trie:
    """A lookup table of several PLRs in one array, which a query reads level by level, from coarse to fine."""

    # An entry 2 * i leads to row i of the leaf parameters, an entry 2 * i + 1 to the child table that begins at i.
    entries: UInt32[Array, " entries"]
    bits: UInt32[Array, "levels 2 dim"]  # masks of a point's fraction bits, and their right shifts in an index
    start: UInt32[Array, "*batch"]  # first entry of one PLR, or of each point's PLR


@dataclass(frozen=True, eq=False)
class PerPointTable:
    """Small arrays, one for each query point, in one flat array: data of the PLR of a stack that the point queries.

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
    along each axis, then the start of the block's table in ``leaf_of_slot`` of :class:`Tables`. Axes for which the
    first word has no room go into further words. Each word costs a query one read.
    """

    words: tuple[UInt32[Array, " blocks"], ...]
    shift: UInt32[Array, " dim"]  # number of a point's fraction bits below those that identify the block
    axes: tuple[int, ...] = field(metadata={"static": True})  # number of axes in each array of words
    width: int = field(metadata={"static": True})  # bits of a word per axis


def block_shapes(cells: Cells, block_bits: PerAxis) -> PerBlock:
    """Return how often each *block* must be halved along each axis until each resulting cell lies in one leaf.

    A block is a cell of a coarse grid with ``2**block_bits`` cells along each axis. Row ``i`` of the result is for
    the block with the row-major index ``i``. ``cells`` are the leaves.
    """
    leaf, block = leaves_in_blocks(cells, block_bits)
    shape = np.zeros((1 << block_bits.sum(), cells.dim), np.int64)
    np.maximum.at(shape, row_major(block, block_bits), np.maximum(cells.depth - block_bits, 0)[leaf])
    return shape


def slots_in_blocks(cells: Cells, block_bits: PerAxis, shape: PerBlock) -> tuple[Pairs, Pairs, OfPairs, OfPairs]:
    """Return all pairs of a leaf and a block (a cell of a coarse grid) that overlap, and where they overlap.

    The coarse grid has ``2**block_bits`` cells along each axis. The finer grid in block ``i`` has ``2**shape[i]``
    cells along each axis (:func:`block_shapes`). For each pair, return the index of the leaf and the row-major index
    of the block. Also return the overlap in the finer grid of this block: its first cell, and its number of cells
    along each axis.
    """
    #   position of a leaf along an axis, in binary   | block | `below` bits |
    #   its first slot in the block                           | `below` bits | zeros |      `shape` bits
    leaf, block = leaves_in_blocks(cells, block_bits)
    index = row_major(block, block_bits)
    below = np.maximum(cells.depth[leaf] - block_bits, 0)
    first = (cells.position[leaf] & ((np.int64(1) << below) - 1)) << (shape[index] - below)
    return leaf, index, first, np.int64(1) << (shape[index] - below)


def pack_blocks(shape: PerBlock, offset: Int[np.ndarray, " blocks_plus_one"], shift: PerAxis) -> Blocks:
    """Pack the data of blocks, the cells of a coarse grid, into 32-bit words (see :class:`Blocks`).

    ``shape`` has log2 of the size of each block's table by axis, ``offset`` the start of each table and the end of
    the last. ``shift`` has, by axis, the number of bits of a point's position below the bits that identify its block.
    """
    #   first word  | start | ... | size of axis 1 | size of axis 0 |      `width` bits a size
    #   next word           | ... | size of axis k | size of axis k - 1 |  with axes that do not fit
    width = max(1, int(shape.max()).bit_length())
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


def choose_block_bits(cells: Cells, bits: PerAxis, most_entries: int) -> PerAxis:
    """Choose how often a coarse grid halves each axis, so that the lookup tables of its cells take the least memory.

    ``bits`` has the largest number of halvings of a leaf along each axis. ``ValueError`` if, for every coarse grid
    tried, the tables have more than ``most_entries`` entries.
    """
    best, fewest = None, np.inf
    for most in range(1, 1 + min(_MAX_BLOCK_BITS, int(bits.sum()))):
        block_bits = spread_bits(bits, most)
        if num_pairs(cells, block_bits) > most_entries:
            break  # finer blocks meet more leaves
        slots = np.sum(2.0 ** block_shapes(cells, block_bits).sum(axis=1))
        size = 4 * 2.0 ** block_bits.sum() + 2 * slots  # bytes
        if slots <= most_entries and size < fewest:
            best, fewest = block_bits, size
    if best is not None:
        return best
    raise ValueError(f"Leaves are too deep for a query's tables: {bits.tolist()} splits by axis. Lower max_depth.")


def leaves_of_slots(
    cells: Cells, block_bits: PerAxis, shape: PerBlock, offset: Int[np.ndarray, " blocks_plus_one"]
) -> UInt32[np.ndarray, " slots"]:
    """Return the leaf in each entry of the lookup tables of all *blocks* (cells of a coarse grid), table by table.

    ``block_bits`` says how often the coarse grid halves each axis. ``shape`` has log2 of the size of each block's
    table along each axis. The table of block ``i`` has the entries ``offset[i]`` up to ``offset[i + 1]``.
    """
    # Write a leaf at the first slot of each of its runs along the last axis, and repeat it up to the next run.
    leaf, block, first, count = slots_in_blocks(cells, block_bits, shape)
    count[:, -1] = 1
    pair, slot = enumerate_boxes(first, count)
    leaf_of_start = np.full(offset[-1], -1, np.int32)
    leaf_of_start[offset[block[pair]] + row_major(slot, shape[block[pair]])] = leaf[pair]
    starts = np.flatnonzero(leaf_of_start >= 0)
    return np.repeat(leaf_of_start[starts].astype(np.uint32), np.diff(starts, append=offset[-1]))


@pytree
class Pages:
    """The coarse level of a lookup table in which each entry holds the parameters of a leaf.

    The table begins with one entry for each leaf, in order. Each cell of a coarse grid, a *block*, has a word that
    leads to an entry. If the block lies in one leaf, this is the leaf's own entry. Any other block has a *page*, a
    table with an entry for each cell of a finer grid. An index in the page consists of those bits of the point's
    position that a mask in the word selects. The mask may leave gaps between the entries of a page; other pages use
    these gaps.
    """

    words: UInt32[Array, " blocks"]  # mask of the fraction bits that index the page; above it, the page's start
    # Rows: mask of the fraction bits below a block; their right shift; number of index bits of the largest page.
    bits: UInt32[Array, "3 dim"]


def build_pages(
    cells: Cells, entry_counts: list[int], parameters_per_entry: int
) -> tuple[Pages, PerAxis, UInt16[np.ndarray, " entries"], int] | None:
    """Build a lookup table whose coarse grid refers each cell to a leaf or to a *page*, a table for a finer grid.

    Choose the coarse grid for which the table takes the least memory; see :class:`Pages`. Return None if leaves are
    too many or too deep. The table is padded to the least sufficient of ``entry_counts`` (ascending); each entry
    holds ``parameters_per_entry`` numbers. Return the pages, how often the coarse grid halves each axis, the leaf in
    each entry, and the padded number of entries.
    """
    # 1. Choose the coarse grid. An index into a page has a field of `page_bits` bits for each axis, the last axis
    #    lowest, with `later_bits` bits below it. A page that is halved less often along an axis uses the highest
    #    `shape` bits of the field; the bits below them are gaps (see the example in `_place_pages`):
    #
    #      fraction bits of an axis  | block_bits | page_bits | not used |
    #      index into a page         | ... | shape | gaps | later_bits |
    bits = cells.depth.max(axis=0)
    best, fewest = None, np.inf
    for most_bits in _BLOCK_BITS:
        block_bits = spread_bits(bits, most_bits)
        if num_pairs(cells, block_bits) > _MOST_PAIRS:
            break  # finer blocks meet more leaves
        # Skip blocks whose words cannot hold mask and start, or whose fraction bits would need a left shift.
        page_bits = bits - block_bits
        later_bits = np.cumsum(page_bits[::-1])[::-1] - page_bits
        right_shift = FRACTION_BITS - bits - later_bits
        if page_bits.sum() + entry_counts[-1].bit_length() > WORD_BITS or (right_shift < 0).any():
            continue
        shape = block_shapes(cells, block_bits)
        if len(cells) + np.sum(2.0 ** shape[shape.any(axis=1)].sum(axis=1)) > entry_counts[-1]:
            continue
        start, num_entries = _place_pages(shape, page_bits, later_bits, len(cells))
        total = next((count for count in entry_counts if num_entries <= count), None)
        # Bytes: 4 for each of 2**most_bits blocks (shallow trees, with fewer blocks, are charged for as many); an
        # entry takes 2 for the leaf's index, and 4 a parameter.
        if total is not None and (size := (4 << most_bits) + total * (2 + 4 * parameters_per_entry)) < fewest:
            best, fewest = (block_bits, page_bits, later_bits, shape, start, num_entries, total), size
        if total == entry_counts[0]:
            break  # finer blocks take more memory
    if best is None:
        return None
    block_bits, page_bits, later_bits, shape, start, num_entries, total = best
    # 2. A block in one leaf refers to the leaf's own entry, with the mask 0.
    leaf, block, first, count = slots_in_blocks(cells, block_bits, shape)
    is_alone = ~shape[block].any(axis=1)
    start[block[is_alone]] = leaf[is_alone]
    # 3. Write the leaves of all pages. Blocks in one leaf write this leaf into its own entry, which holds it anyway.
    #    Entries in gaps that no page fills keep leaf 0; no point reads them.
    pair, slot = enumerate_boxes(first, count)
    leaf_of_entry = np.zeros(num_entries, np.uint16)
    gaps = page_bits - shape[block[pair]]
    leaf_of_entry[start[block[pair]] + np.sum(slot << (gaps + later_bits), axis=1)] = leaf[pair]
    leaf_of_entry[: len(cells)] = np.arange(len(cells))
    # 4. Pack the masks and starts of blocks into words.
    mask = np.sum(((1 << shape) - 1) << (page_bits - shape + later_bits), axis=1)
    words = (start << page_bits.sum()) | mask
    below_block = ((1 << page_bits) - 1) << (FRACTION_BITS - bits)
    rows = np.stack([below_block, FRACTION_BITS - bits - later_bits, np.full_like(bits, page_bits.sum())])
    pages = Pages(jax.device_put(words.astype(np.uint32)), jax.device_put(rows.astype(np.uint32)))
    return pages, block_bits, leaf_of_entry, total


def _place_pages(
    shape: PerBlock, page_bits: PerAxis, later_bits: PerAxis, first_entry: int
) -> tuple[Int[np.ndarray, " blocks"], int]:
    """Return the entry at which the page (lookup table) of each block begins, and the end of all pages.

    A buddy allocator places pages by decreasing size, from entry ``first_entry`` on. ``shape`` has log2 of each
    page's size by axis; a block whose ``shape`` is 0 along all axes has no page. ``page_bits`` has log2 of the
    largest page's size by axis. ``later_bits`` has, for each axis, the sum of the ``page_bits`` of all later axes.
    """
    # Pages interleave. Example: the largest page has 2 x 4 entries, with page_bits (1, 2) and later_bits (2, 0), so
    # an index has the bits `a b b`: one of axis 0, two of axis 1.
    #
    #     entry            0 1 2 3 4 5 6 7
    #     page of 2 x 2    *   *   *   *      begins at 0; its indices have the bits `a b .`, with a gap
    #     page of 1 x 2      o   o            begins at 1, in the gaps; its indices have the bits `. b .`
    #
    # Halving a free range along an axis separates its entries by the lowest bit of the axis's field that the range
    # uses: the halves begin a `step`, the value of this bit, apart. Here, halving all 8 entries along axis 1 gives
    # the even and the odd entries, with a step of 1; halving the odd ones along axis 0 gives 1, 3 and 5, 7.
    finest = tuple(page_bits.tolist())
    free_starts: dict[tuple[int, ...], Int[np.ndarray, " _"]] = {}  # starts of free ranges, by their shape
    start = np.zeros(len(shape), np.int64)
    end = first_entry
    # 1. Sort blocks with a page by decreasing size, then shape, and take all blocks of one shape at once.
    order = np.flatnonzero(shape.any(axis=1))
    order = order[np.lexsort((*shape[order].T, -shape[order].sum(axis=1)))]
    for blocks in np.split(order, 1 + np.flatnonzero((shape[order[1:]] != shape[order[:-1]]).any(axis=1))):
        page = tuple(shape[blocks[0]].tolist()) if len(blocks) else ()
        while len(blocks):
            # 2. Take ranges of the smallest shape into which the pages fit, or append one as large as any page.
            fitting = (each for each, starts in free_starts.items() if len(starts) and all(map(ge, each, page)))
            free_range = min(fitting, key=sum, default=None)
            if free_range is None:  # no range of the shape `finest` is free, as any page fits into it
                free_range = finest
                free_starts[finest] = np.array([end])
                end += 1 << sum(finest)
            count = -(-len(blocks) >> (sum(free_range) - sum(page)))  # ceil(pages / pages per range)
            taken, free_starts[free_range] = np.split(free_starts[free_range], [count])
            # 3. Place pages in ranges of their own shape. Halve larger ranges, and try again.
            if free_range == page:
                start[blocks[: len(taken)]] = taken
                blocks = blocks[len(taken) :]
                continue
            axis = next(axis for axis, wanted in enumerate(page) if free_range[axis] > wanted)
            half = (*free_range[:axis], free_range[axis] - 1, *free_range[axis + 1 :])
            step = 1 << int(later_bits[axis] + page_bits[axis] - free_range[axis])
            free_starts[half] = np.concatenate([free_starts.get(half, taken[:0]), taken, taken + step])
    return start, end


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Tables:
    """Arrays that a query reads, padded so that PLRs whose files have similar sizes share compiled code."""

    # Arrays are few, as each adds to the cost of a call. Indices are unsigned, as JAX spends time on negative ones.
    frame: Float[Array, "7 dim"] | PerPointTable  # domain in 32-bit floats, rows as in :class:`Frame`
    # Mask of the fraction bits that index an entry or block, and their right shift. With a trie: None.
    bits: UInt32[Array, "2 dim"] | Any
    blocks: Blocks | None
    pages: Pages | None
    leaf_of_slot: UInt16[Array, " slots"] | UInt32[Array, " slots"] | Any  # with a trie: None
    # For each leaf or, with pages, for each entry: see :func:`arrange_parameters`. Merged tables set it last.
    leaf_parameters: Float[Array, "count padded"] | Float[Array, " numbers"] | Any
    leaf: Any = field(metadata={"static": True})
    periodic: tuple[int, ...] = field(metadata={"static": True}, default=())
    folding: FoldedDomain | None = None
    trie: Trie | None = None  # in stacks of many PLRs, used instead of all other lookup tables
    # Float types too coarse for this domain.
    unresolved: tuple[str, ...] = field(metadata={"static": True}, default=())
    straight: list[Any] | None = None  # arrays of a :class:`StraightBound`, a lower bound of all answers

    @property
    def dim(self) -> int:
        return self.frame.shape[1]

    def with_folding(self, folding: Folding, origin: Float[np.ndarray, "dim"]) -> "Tables":
        """Return tables whose queries first mirror points into the *folded* domain.

        The folded domain is the part of the domain that the leaves cover. The points of queries are relative to
        ``origin``.
        """
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
    blocks = pages = paged = None
    # `top` has the halvings of the grid whose cells are the first entries that a query reads.
    # 1. Try pages.
    if leaf.has_deep_trees and rows <= MOST_ROWS:
        counts = [count for count in _PAGED_ENTRIES if count >= _PAGED_ENTRIES_PER_ROW * rows]
        paged = build_pages(cells, counts, leaf_parameters.shape[1])
    if paged is not None:
        pages, top, leaf_of_slot, slots = paged
        arranged = np.ascontiguousarray(padded(leaf_parameters[leaf_of_slot], slots).T)
    # 2. Else build a flat table, or blocks.
    else:
        bits = cells.depth.max(axis=0)
        is_flat = bits.sum() <= slot_bits_of_rows(rows_of_file)
        # A flat table is the table of a single block, the domain.
        block_bits = 0 * bits if is_flat else choose_block_bits(cells, bits, max_entries(num_bytes))
        shape = block_shapes(cells, block_bits)
        offset = np.concatenate([[0], np.cumsum(np.int64(1) << shape.sum(axis=1))])
        leaf_of_slot = leaves_of_slots(cells, block_bits, shape, offset)
        leaf_of_slot = leaf_of_slot.astype(np.uint16 if rows <= 2**16 else np.uint32)
        slots = 1 << max(slot_bits_of_rows(rows_of_file), (len(leaf_of_slot) - 1).bit_length())
        top = bits if is_flat else block_bits
        blocks = None if is_flat else pack_blocks(shape, offset, FRACTION_BITS - top)
        arranged = arrange_parameters(padded(leaf_parameters, rows))
    # 3. Masks that select the highest fraction bits along each axis. In the row-major index, the bits of an axis
    #    stand above the bits of all later axes: shift them right by FRACTION_BITS - (bits of this and later axes).
    mask = ((1 << top) - 1) << (FRACTION_BITS - top)
    right = FRACTION_BITS - np.cumsum(top[::-1])[::-1]
    periodic = tuple(np.flatnonzero(domain.periodic).tolist())
    numbers = frame_of(domain), np.stack([mask, right]).astype(np.uint32), padded(leaf_of_slot, slots), arranged
    frame, masks, entries, arranged = jax.device_put(numbers)
    return Tables(frame, masks, blocks, pages, entries, arranged, leaf, periodic, unresolved=unresolved_types(domain))


def arrange_parameters(parameters: Float[np.ndarray, "rows count"]) -> Float[np.ndarray, "..."]:
    # Columns take the least arithmetic, a flat table saves cache misses.
    return parameters.ravel() if parameters.nbytes > _MAX_COLUMN_BYTES else np.ascontiguousarray(parameters.T)
