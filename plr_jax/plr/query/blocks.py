"""Two-level tables of any size: each coarse block has a little table of its own, just as fine as its leaves need."""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int, UInt32

from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.query.grid import WORD_BITS, block_shapes, enumerate_boxes, num_pairs, row_major, slots_in_blocks
from plr_jax.plr.query.picked import Picked, gather

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


def shift_right(x: UInt32[Array, "*batch"], by: UInt32[Array, "*#batch"]) -> UInt32[Array, "*batch"]:
    """Shift by less than 32 bits, which the mask tells the compiler: it then need not provide for more."""
    return x >> (by & np.uint32(WORD_BITS - 1))
