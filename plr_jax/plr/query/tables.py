"""Lookup tables: from a point to its leaf by arithmetic, not by descending a tree.

Cells are dyadic, so a point's place along an axis, as a binary fraction of the domain's width, begins with the bits
of its cell's position: its *slot*. A *flat* table has one entry a slot of the finest grid, ``2**sum(bits)`` in all,
with ``bits[a]`` the deepest split along axis ``a``. A deep tree would make that table huge although only a few of its
leaves are small, so past ``2**MAX_FLAT_BITS`` slots the grid is cut into *blocks*, and each block has a little table
of its own, just as fine along each axis as its own leaves need. Where a leaf model has deep trees, blocks of small
PLRs have *pages* instead (see ``pages.py``), whatever their depth: they are read about as fast as a flat table.

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
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt16, UInt32

from plr_jax._arrays import padded, padded_size
from plr_jax.geometry.box import Box
from plr_jax.plr.folding.folding import Folding
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.query.folded import FoldedWindow
from plr_jax.plr.query.frame import frame_of, unresolved_types
from plr_jax.plr.query.grid import (
    FRACTION_BITS,
    MAX_FLAT_BITS,
    MOST_ROWS,
    block_shapes,
    byte_class,
    max_entries,
    rows_of_class,
    slot_bits_of_rows,
)
from plr_jax.plr.query.pages import (
    Blocks,
    Pages,
    build_pages,
    choose_block_bits,
    leaves_of_slots,
    pack_blocks,
)
from plr_jax.plr.query.reads import Picked
from plr_jax.plr.query.trie import Trie

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
        numbers: What the leaf model reads of each leaf, or of each slot of a table with pages. Small tables have one
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

    frame: Float[Array, "7 dim"] | Picked
    bits: UInt32[Array, "2 dim"] | Picked
    blocks: Blocks | None
    pages: Pages | None
    leaf_of_slot: UInt16[Array, "slots"] | UInt32[Array, "slots"] | Picked
    numbers: Float[Array, "count padded"] | Float[Array, "numbers"] | Picked
    leaf: Any = field(metadata={"static": True})
    periodic: tuple[int, ...] = field(metadata={"static": True}, default=())
    folding: FoldedWindow | None = None
    trie: Trie | None = None
    unresolved: tuple[str, ...] = field(metadata={"static": True}, default=())

    @property
    def dim(self) -> int:
        """Number of axes."""
        return self.frame.shape[1]

    def of_folding(self, folding: Folding | None, origin: Float[np.ndarray, "dim"]) -> "Tables":
        """The same, of points that are folded, and counted from an origin."""
        if folding is None:
            return self
        unresolved = unresolved_types(folding.domain.moved(-origin))
        return replace(self, folding=FoldedWindow.of(folding, origin), unresolved=unresolved)

    def of_folded_points(self) -> "Tables":
        """The same for points that are folded already."""
        return replace(self, folding=None)


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
    if leaf.has_deep_trees and rows <= MOST_ROWS:
        for slots in (max(_LEAST_PAGED_SLOTS, _PAGED_SLOTS_A_ROW * rows), _MOST_PAGED_SLOTS):
            if (paged := build_pages(cells, slots)) is not None:
                # Tables with pages and room for so many slots.
                of_slot = padded(numbers.astype(np.float32)[paged.leaf_of_slot], slots)
                return Tables(
                    frame=jnp.asarray(frame_of(domain)),
                    bits=_bits_of_index(paged.block_bits),
                    blocks=None,
                    pages=paged.pages,
                    leaf_of_slot=jnp.asarray(padded(paged.leaf_of_slot.astype(np.uint16), slots)),
                    numbers=jnp.asarray(np.ascontiguousarray(of_slot.T)),
                    leaf=leaf,
                    periodic=_periodic_axes(domain),
                    unresolved=unresolved_types(domain),
                )
    table = padded(numbers.astype(np.float32), rows)
    return _tables_by_leaf(domain, cells, table, leaf, slot_bits_of_rows(rows_of_file), max_entries(num_bytes))


def _tables_by_leaf(
    domain: Box, cells: Cells, table: Float[np.ndarray, "rows count"], leaf: Any, slot_bits: int, most_entries: int
) -> Tables:
    """A flat table or one of blocks, with room for ``2**slot_bits`` slots at the least."""
    bits = cells.depth.max(axis=0)
    flat = bits.sum() <= MAX_FLAT_BITS
    block_bits = 0 * bits if flat else choose_block_bits(cells, bits, most_entries)
    shape = block_shapes(cells, block_bits)
    offset = np.concatenate([[0], np.cumsum(np.int64(1) << shape.sum(axis=1))])
    leaf_of_slot = leaves_of_slots(cells, block_bits, shape, offset)
    slots = 1 << max(slot_bits, (len(leaf_of_slot) - 1).bit_length())
    index_type = np.uint16 if len(table) <= 2**16 else np.uint32
    top = bits if flat else block_bits
    return Tables(
        frame=jnp.asarray(frame_of(domain)),
        bits=_bits_of_index(top),
        blocks=None if flat else pack_blocks(shape, offset, FRACTION_BITS - top),
        pages=None,
        leaf_of_slot=jnp.asarray(padded(leaf_of_slot.astype(index_type), slots)),
        numbers=jnp.asarray(laid_out(table)),
        leaf=leaf,
        periodic=_periodic_axes(domain),
        unresolved=unresolved_types(domain),
    )


def laid_out(
    numbers: Float[np.ndarray, "rows count"],
) -> Float[np.ndarray, "count rows"] | Float[np.ndarray, "numbers"]:
    """Numbers of leaves as :class:`Tables` has them: one row a number, of large tables a leaf's side by side."""
    return numbers.ravel() if numbers.nbytes > _MAX_COLUMN_BYTES else np.ascontiguousarray(numbers.T)


def _periodic_axes(domain: Box) -> tuple[int, ...]:
    return tuple(axis for axis, is_periodic in enumerate(domain.periodic) if is_periodic)


def _bits_of_index(bits: Int[np.ndarray, "dim"]) -> UInt32[Array, "2 dim"]:
    """Mask and shift that make an index of the first bits along each axis of a point's place."""
    mask = ((1 << bits) - 1) << (FRACTION_BITS - bits)
    return jnp.asarray(np.stack([mask, FRACTION_BITS - np.cumsum(bits[::-1])[::-1]]).astype(np.uint32))
