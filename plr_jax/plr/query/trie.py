"""A trie: one table of many PLRs, of as many levels as the deepest needs, each of a few bits of a point's place.

A *page* has an entry for each cell of a regular grid: the first page of a PLR for those of the domain, which nearly
always say the leaf at once, any other for those of one cell of the level above that several leaves share. An entry is
odd if it leads to a page, and then half of it is where the page begins; else half of it is the row of the leaf's
numbers. At the index of a row there is an entry of that same row: a read of what is found already finds it again.

That takes more reads than pages (``pages.py``) and less memory, for which the reads of many PLRs wait. And nothing
else differs from one PLR to the next. First pages, which all points read, stand side by side.

References:
    Srinivasan, Varghese, "Fast address lookups using controlled prefix expansion", TOCS 1999.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int, UInt32

from plr_jax._arrays import padded, size_in_eighths
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.query.grid import (
    FRACTION_BITS,
    enumerate_boxes,
    leaves_in_blocks,
    num_pairs,
    row_major,
    spread_bits,
)

_FIRST_BITS = 10  # of a first page: those of a thousand PLRs take 4 MB, and others are seldom read
_PAGE_BITS = 6  # of others, at the most
_MOST_DEPTH = FRACTION_BITS - _PAGE_BITS  # along an axis, so that no bits of a place belong farther left in an index
_MOST_ENTRIES = 2**22  # of one PLR, at the most, before leaves that share pages are seen to
_MOST_INDICES = 2**31  # an entry has one bit for other things


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

    def of(self, which: UInt32[Array, "*batch"], first_bits: int) -> "Trie":
        """The same for points of given PLRs."""
        return Trie(self.entries, self.bits, self.start + (which << np.uint32(first_bits)))


def trie_levels(bits: Int[np.ndarray, "dim"]) -> list[Int[np.ndarray, "dim"]]:
    """Where levels begin and end: so many bits of a place along each axis, from none to all of them."""
    ends = [0 * bits, spread_bits(bits, _FIRST_BITS)]
    for left in range(-(-int((bits - ends[1]).sum()) // _PAGE_BITS), 0, -1):
        rest = bits - ends[-1]
        ends.append(ends[-1] + spread_bits(rest, -(-int(rest.sum()) // left)))
    return ends


def can_be_in_trie(cells: Cells, levels: Sequence[Int[np.ndarray, "dim"]]) -> bool:
    """Whether a partition is shallow enough, and its pages few."""
    if cells.depth.max() > _MOST_DEPTH:
        return False
    most = 0.0
    for begin, end in pairwise(levels):
        pairs = num_pairs(cells[(cells.depth > begin).any(axis=1)], begin)
        most += min(pairs, 2.0 ** begin.sum()) * 2.0 ** (end - begin).sum()
    return bool(most <= _MOST_ENTRIES)


def build_trie(
    partitions: Sequence[Cells], rows: Sequence[Int[np.ndarray, "_"]], levels: Sequence[Int[np.ndarray, "dim"]]
) -> Trie:
    """The trie of several partitions that can be in one, of which each leaf's numbers are in a given row."""
    num_rows = 1 + max(int(of_leaf.max()) for of_leaf in rows)
    end = num_rows + len(partitions) * (1 << int(levels[1].sum()))
    first_pages, others = [], []
    for cells, of_leaf in zip(partitions, rows, strict=True):
        for number, pages in enumerate(_pages(cells, of_leaf, levels, end)):
            if number == 0:
                first_pages.append(pages)
            else:
                others.append(pages)
                end += len(pages)
    if end >= _MOST_INDICES:
        raise ValueError(f"{len(partitions):,} PLRs have tables too large for one stack; make several of fewer PLRs.")
    entries = np.concatenate([2 * np.arange(num_rows, dtype=np.uint32), *first_pages, *others])
    bits = np.stack([_bits_of_level(begin, end) for begin, end in pairwise(levels)]).astype(np.uint32)
    entries = padded(entries, size_in_eighths(len(entries)))
    return Trie(jnp.asarray(entries), jnp.asarray(bits), jnp.asarray(np.uint32(num_rows)))


def _pages(
    cells: Cells, row: Int[np.ndarray, "leaves"], levels: Sequence[Int[np.ndarray, "dim"]], next_start: int
) -> Iterator[UInt32[np.ndarray, "entries"]]:
    """The pages of each level of one partition, side by side; those of the second level on start at a given index."""
    page = np.zeros(1, np.int64)  # of this level: the indices of their cells in the grid of the level above
    for number, (begin, end) in enumerate(pairwise(levels)):
        entries = np.zeros((len(page), 1 << (end - begin).sum()), np.int64)
        is_here = (cells.depth <= end).all(axis=1) & ((cells.depth > begin).any(axis=1) | (number == 0))
        here = cells[is_here]
        leaf, place = enumerate_boxes(here.position << (end - here.depth), np.int64(1) << (end - here.depth))
        entries[_in_pages(place, page, begin, end)] = 2 * row[is_here][leaf]
        _, place = leaves_in_blocks(cells[(cells.depth > end).any(axis=1)], end)
        next_page, first = np.unique(row_major(place, end), return_index=True)
        if len(next_page):
            starts = next_start + (np.arange(len(next_page)) << (levels[number + 2] - end).sum())
            entries[_in_pages(place[first], page, begin, end)] = 2 * starts + 1
            next_start = int(starts[-1]) + (1 << (levels[number + 2] - end).sum())
        yield entries.ravel().astype(np.uint32)
        page = next_page
        if not len(page):
            return


def _in_pages(
    place: Int[np.ndarray, "n dim"],
    page: Int[np.ndarray, "pages"],
    begin: Int[np.ndarray, "dim"],
    end: Int[np.ndarray, "dim"],
) -> tuple[Int[np.ndarray, "n"], Int[np.ndarray, "n"]]:
    """The page and the entry there of places in the grid of a level that has these pages."""
    step = end - begin
    return np.searchsorted(page, row_major(place >> step, begin)), row_major(place & ((1 << step) - 1), step)


def _bits_of_level(begin: Int[np.ndarray, "dim"], end: Int[np.ndarray, "dim"]) -> Int[np.ndarray, "2 dim"]:
    """Mask and shift that make an index into a page of the bits of a point's place between two levels."""
    step = end - begin
    mask = ((1 << step) - 1) << (FRACTION_BITS - end)
    return np.stack([mask, FRACTION_BITS - end - (np.cumsum(step[::-1])[::-1] - step)])
