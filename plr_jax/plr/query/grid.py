"""The grids that tables are made of: how large they are, which leaves meet which block, and where.

A *block* is a cell of a coarse grid of ``2**block_bits`` along the axes, its *shape* the bits of the finer grid that
its own leaves need.
"""

import numpy as np
from jaxtyping import Int

from plr_jax._arrays import runs
from plr_jax.plr.partition.cells import Cells

FRACTION_BITS = 23  # of a 32-bit float
WORD_BITS = 32
MIN_CLASS = 8
_SLOT_BITS = ((2**10, 14), (2**12, 16))  # of flat tables with up to so many rows; beyond, MAX_FLAT_BITS
MOST_ROWS = 2**14  # of a class whose tables are of one shape
MAX_FLAT_BITS = 18  # a flat table of 16-bit leaves then fits a core's second-level cache
_DEEP_BITS = 28  # of a point's place in all, beyond the classes above
_PAGED_DEPTH = 13  # along an axis, so that blocks and the page of a deepest leaf stay small
_MAX_BITS_BEYOND_CLASS, _LEAST_ENTRIES_BITS, _MOST_ENTRIES_BITS = 9, 20, 27


def block_shapes(cells: Cells, block_bits: Int[np.ndarray, "dim"]) -> Int[np.ndarray, "blocks dim"]:
    """Bits of every block's own table: the deepest split below the block among the leaves it meets."""
    below = np.maximum(cells.depth - block_bits, 0)
    leaf, block = leaves_in_blocks(cells, block_bits)
    shape = np.zeros((1 << block_bits.sum(), cells.dim), np.int64)
    np.maximum.at(shape, row_major(block, block_bits), below[leaf])
    return shape


def num_pairs(cells: Cells, block_bits: Int[np.ndarray, "dim"]) -> float:
    """How many pairs of a leaf and a block meet."""
    return np.sum(2.0 ** np.maximum(block_bits - cells.depth, 0).sum(axis=1))


def slots_in_blocks(
    cells: Cells, block_bits: Int[np.ndarray, "dim"], shape: Int[np.ndarray, "blocks dim"]
) -> tuple[
    Int[np.ndarray, "pairs"], Int[np.ndarray, "pairs"], Int[np.ndarray, "pairs dim"], Int[np.ndarray, "pairs dim"]
]:
    """All pairs of a leaf and a block that meet: their indices, the leaf's first slot in the block, and how many."""
    leaf, block = leaves_in_blocks(cells, block_bits)
    index = row_major(block, block_bits)
    below = np.maximum(cells.depth[leaf] - block_bits, 0)
    first = (cells.position[leaf] & ((np.int64(1) << below) - 1)) << (shape[index] - below)
    return leaf, index, first, np.int64(1) << (shape[index] - below)


def leaves_in_blocks(
    cells: Cells, block_bits: Int[np.ndarray, "dim"]
) -> tuple[Int[np.ndarray, "pairs"], Int[np.ndarray, "pairs dim"]]:
    """All pairs of a leaf and a block that meet: the leaf's index and the block's, along each axis."""
    first = np.where(
        cells.depth >= block_bits,
        cells.position >> np.maximum(cells.depth - block_bits, 0),
        cells.position << np.maximum(block_bits - cells.depth, 0),
    )
    return enumerate_boxes(first, np.int64(1) << np.maximum(block_bits - cells.depth, 0))


def enumerate_boxes(
    first: Int[np.ndarray, "boxes dim"], count: Int[np.ndarray, "boxes dim"]
) -> tuple[Int[np.ndarray, "points"], Int[np.ndarray, "points dim"]]:
    """Integer points of many boxes: the box's index and the point, for each."""
    box, rest = runs(count.prod(axis=1))
    points = np.empty((len(box), first.shape[1]), np.int64)
    for axis in reversed(range(first.shape[1])):
        rest, digit = np.divmod(rest, count[box, axis])
        points[:, axis] = first[box, axis] + digit
    return box, points


def spread_bits(bits: Int[np.ndarray, "dim"], most: int) -> Int[np.ndarray, "dim"]:
    """Up to so many bits, each along the axis with the most bits left."""
    chosen = np.zeros_like(bits)
    while chosen.sum() < min(most, bits.sum()):
        chosen[np.argmax(bits - chosen)] += 1
    return chosen


def row_major(
    slots: Int[np.ndarray, "n dim"], bits: Int[np.ndarray, "n dim"] | Int[np.ndarray, "dim"]
) -> Int[np.ndarray, "n"]:
    """Index of each slot in a table of ``2**bits`` slots along the axes."""
    index = np.zeros(len(slots), np.int64)
    for axis in range(slots.shape[1]):
        index = (index << bits[..., axis]) | slots[:, axis]
    return index


def byte_class(num_bytes: int) -> int:
    """The smallest exponent of a power of two that is at least so many bytes."""
    return max(MIN_CLASS, (num_bytes - 1).bit_length())


def rows_of_class(of_class: int, least_bytes: int | float) -> int:
    """Leaves for which the tables of a class have room, where a leaf takes so many bytes at the least."""
    return int((1 << of_class) / least_bytes)


def slot_bits_of_rows(rows: int) -> int:
    """Bits of the flat table of a class that has room for so many leaves."""
    return next((bits for most, bits in _SLOT_BITS if rows <= most), MAX_FLAT_BITS)


def max_axis_depth(dim: int, of_class: int | None, least_bytes: int | float, is_deep: bool) -> int:
    """How often a cell may be halved along one axis, for a class of files or for any.

    In the plane and on a line the slots of a class of up to ``MOST_ROWS`` suffice; trees that are to be deep, as of
    leaf models with pages or for a proof, may go as far as pages do. Else the tables' size is bounded.
    """
    rows = None if of_class is None else rows_of_class(of_class, least_bytes)
    if rows is None or rows > MOST_ROWS or dim > 2:
        return max(1, min(MAX_FLAT_BITS, _DEEP_BITS // dim))
    return max(slot_bits_of_rows(rows) // dim, _PAGED_DEPTH if is_deep else 0)


def max_entries(num_bytes: int) -> int:
    """Entries that the tables of a file of so many bytes may have: they bound what loading it takes."""
    bits = byte_class(num_bytes) + _MAX_BITS_BEYOND_CLASS
    return 1 << min(max(bits, _LEAST_ENTRIES_BITS), _MOST_ENTRIES_BITS)
