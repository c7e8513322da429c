"""Distances of pairs of cells, in JAX: the open length if they see each other, else the least sum over corners.

Cells have from none to dozens of corners, and a pair takes the product of two such numbers. But no path over a
corner is shorter than the open way over it: once a way is known, over the corners whose open way is the shortest,
most others need not be looked at. Pairs are sorted by how many blocks of corners their cells have, then by how many
pairs of blocks are left, and taken in chunks of pairs of about as many.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int, Int32, Integer, Num, Shaped, UInt32

from plr_jax._arrays import parts, runs
from plr_jax.pairs.grid_corners import FAR, MOST_BYTES, CornerLabels, CornerTable, corner_distances
from plr_jax.pairs.grid_sectors import corner_cells, open_length, taut_corners, units
from plr_jax.pairs.grid_sight import Cells, IllegalSteps, looked_up, narrow, sees, sight_of

# What a query of pairs reads: all derived from the cells of a grid.


BLOCK = 4
"""Corners of a cell that a query reads at once."""

GROUP = 16
"""Cells whose blocks are counted from where those of the first begin."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class GridTables:
    """A grid, the corners at which each cell is taut, and the distances between corners.

    Attributes:
        sight: Which cells see each other.
        group_block: Where the blocks of each 16 cells begin, in row-major order.
        cell_block: How much later those of each cell begin; of one more at the end.
        blocks: Numbers of corners; the last of a cell is repeated to fill its last block.
        row: Row of each corner.
        column: Column of each corner.
        distances: Those between corners.
    """

    sight: IllegalSteps
    group_block: Int32[Array, "groups"]
    cell_block: Integer[Array, "cells_plus_one"]
    blocks: Integer[Array, "blocks 4"]
    row: Int32[Array, "corners"]
    column: Int32[Array, "corners"]
    distances: CornerTable | CornerLabels

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the grid."""
        return self.sight.shape

    @property
    def connectivity(self) -> int:
        """4 or 8."""
        return self.sight.connectivity


def tables_of(free: Bool[np.ndarray, "rows columns"], connectivity: int, most_bytes: int = MOST_BYTES) -> GridTables:
    """The tables of a grid; raises ``TablesTooLarge`` if one of them takes more bytes."""
    first, corners = taut_corners(free, connectivity, most_bytes)
    first_block, blocks = _in_blocks(first, corners)
    group_block = first_block[::GROUP]
    cell_block = first_block - np.repeat(group_block, GROUP)[: len(first_block)]
    row, column = (places.astype(np.int32) for places in np.nonzero(corner_cells(free)))
    tables = GridTables(
        sight_of(free, connectivity),
        jnp.asarray(group_block, jnp.int32),
        jnp.asarray(narrow(cell_block)),
        jnp.asarray(blocks),
        jnp.asarray(row),
        jnp.asarray(column),
        distances=corner_distances(free, connectivity, most_bytes),
    )
    return jax.tree_util.tree_map(_not_empty, tables)


def _not_empty(table: Shaped[Array, "..."]) -> Shaped[Array, "..."]:
    """The table, or zeros: what is empty is read as well, though what is read is not used."""
    return table if table.size else jnp.zeros([max(size, 1) for size in table.shape], table.dtype)


def _in_blocks(
    first: Int[np.ndarray, "cells_plus_one"], corners: Int32[np.ndarray, "pairs"]
) -> tuple[Int[np.ndarray, "cells_plus_one"], Integer[np.ndarray, "blocks 4"]]:
    """Where the blocks of each cell begin, and the blocks, of corners that stand cell by cell."""
    counts = np.diff(first)
    num_blocks = -(-counts // BLOCK)
    first_block = np.concatenate([[0], np.cumsum(num_blocks)])
    blocks = np.empty((first_block[-1], BLOCK), np.min_scalar_type(corners.max(initial=0)))
    for some in parts(num_blocks, _BLOCKS_AT_ONCE):
        cell, block = runs(num_blocks[some])
        place = np.minimum(BLOCK * block[:, None] + np.arange(BLOCK), counts[some][cell, None] - 1)
        begin = first_block[some.start]
        blocks[begin : begin + len(cell)] = corners[first[some][cell, None] + place]
    return first_block, blocks


_BLOCKS_AT_ONCE = 2**20
_SORTED_BITS = 18  # of the place of a pair among those that are sorted at once
_CHUNK = 1024  # pairs taken at once
_MOST_TOLD = 2**7 - 1  # blocks of cells, as told apart when pairs are sorted
_WORD = 32  # bits
_ROUNDING = 2.0**-22  # more than what rounding in 32 bits can add, as a share

SLACK = 2.0**-20
"""How far below the truth an answer of an 8-connected grid may be, as a share: what a query rounds down, and a
diagonal step's length."""


@jax.jit
def evaluate_pairs(
    tables: GridTables, x: Num[Array, "*batch 2"], y: Num[Array, "*batch 2"]
) -> Float[Array, "*batch"]:
    """Length of a shortest path between the cells of points; ``inf`` without one, or where a point is in none."""
    batch = x.shape[:-1]
    (p, p_inside), (q, q_inside) = (cells_of(tables.shape, points.reshape(-1, 2)) for points in (x, y))
    return in_steps(tables.connectivity, lengths_between_cells(tables, p, q), p_inside & q_inside).reshape(batch)


@jax.jit
def evaluate_to(
    tables: GridTables, from_goal: Int32[Array, "corners"], goal: Int[Array, "2"], x: Num[Array, "*batch 2"]
) -> Float[Array, "*batch"]:
    """As :func:`evaluate_pairs`, with one cell whose distance from each corner is known."""
    p, inside = cells_of(tables.shape, x.reshape(-1, 2))
    q = jnp.broadcast_to(goal, p.shape)
    size = min(_CHUNK, max(len(p), 1))
    chunks = jnp.pad(p, ((0, -len(p) % size), (0, 0))).reshape(-1, size, 2)

    def to_goal(corners: Int32[Array, "n 4"]) -> Int32[Array, "n 4"]:
        return looked_up(from_goal, corners)

    around = lax.map(lambda cells: _least_around(tables, cells, to_goal, cells.shape[:1]), chunks)
    lengths = _where_seen(tables, p, q, around.reshape(-1)[: len(p)])
    return in_steps(tables.connectivity, lengths, inside).reshape(x.shape[:-1])


@jax.jit
def corners_from(tables: GridTables, goal: Int[Array, "2"]) -> Int32[Array, "corners"]:
    """Distance in units of each corner from a cell by way of the corners at which the cell is taut."""
    every = jnp.arange(len(tables.row), dtype=jnp.int32)
    cells = jnp.broadcast_to(goal, (len(every), 2))
    return _least_around(
        tables, cells, lambda corners: tables.distances.between(every[:, None], corners), every.shape
    )


def cells_of(shape: tuple[int, int], x: Num[Array, "n 2"]) -> tuple[Cells, Bool[Array, "n"]]:
    """Row and column of the cell of each point, or of some cell, and whether the point is in one."""
    place = jnp.floor(x)[:, ::-1]
    inside = ((place >= 0) & (place < jnp.asarray(shape, place.dtype)[None])).all(axis=1)
    return jnp.where(inside[:, None], place, 0).astype(jnp.int32), inside


def lengths_between_cells(tables: GridTables, p: Cells, q: Cells) -> Int32[Array, "n"]:
    """Lengths in units of shortest paths between cells, at least ``FAR`` without one."""
    size = min(1 << _SORTED_BITS, max(len(p), 1))
    filled = jnp.pad(jnp.stack([p, q]), ((0, 0), (0, -len(p) % size), (0, 0)))
    pairs = filled.reshape(2, -1, size, 2).swapaxes(0, 1)
    return lax.map(lambda ends: _lengths_at_once(tables, *ends), pairs).reshape(-1)[: len(p)]


def _lengths_at_once(tables: GridTables, p: Cells, q: Cells) -> Int32[Array, "n"]:
    """As above, of at most so many pairs as are sorted at once."""
    seen = sees(tables.sight, p, q)
    first, then = (jnp.minimum(jnp.where(seen, 0, _blocks_of(tables, cells)[1]), _MOST_TOLD) for cells in (p, q))
    chunks = _sorted_chunks(first * (_MOST_TOLD + 1) + then)
    found = lax.map(lambda chunk: _most_likely(tables, p[chunk], q[chunk], seen[chunk]), chunks)
    length, *left = (jnp.zeros(len(p), one.dtype).at[chunks].set(one) for one in found)
    first, then = (lax.population_count(blocks).astype(jnp.int32) for blocks in left)
    chunks = _sorted_chunks(first * then)

    def of_chunk(chunk: Int32[Array, "size"]) -> Int32[Array, "size"]:
        ends = _Left(p[chunk], left[0][chunk]), _Left(q[chunk], left[1][chunk])
        return _least_of_those_left(tables, *ends, length[chunk])

    return length.at[chunks].set(lax.map(of_chunk, chunks))


def _sorted_chunks(work: Int32[Array, "n"]) -> Int32[Array, "chunks size"]:
    """Numbers of pairs, those with about as much work, less than 2**14, side by side."""
    key = work.astype(jnp.uint32) << _SORTED_BITS | jnp.arange(len(work), dtype=jnp.uint32)
    order = (jnp.sort(key) & ((1 << _SORTED_BITS) - 1)).astype(jnp.int32)
    size = min(_CHUNK, len(work))
    return jnp.pad(order, (0, -len(work) % size), mode="edge").reshape(-1, size)


def _most_likely(
    tables: GridTables, p: Cells, q: Cells, seen: Bool[Array, "n"]
) -> tuple[Int32[Array, "n"], UInt32[Array, "n"], UInt32[Array, "n"]]:
    """Length of the way over the corners of both cells nearest to both, and which blocks may have better corners.

    No path over a corner is shorter than the open way over it. Of cells that see each other no corner is looked at.
    """
    (corner, leg), (other, other_leg) = _nearest_to_both(tables, p, q, seen), _nearest_to_both(tables, q, p, seen)
    way = leg + tables.distances.between(corner, other) + other_leg
    length = jnp.where((leg < FAR) & (other_leg < FAR), jnp.minimum(way, FAR), FAR)
    length = jnp.where(seen, open_length(tables.connectivity, *jnp.abs(p - q).T), length)
    to_beat = jnp.where((length < FAR) & ~seen, length, 0)  # if no path joins these corners none joins any
    return length, _better_blocks(tables, p, q, to_beat), _better_blocks(tables, q, p, to_beat)


def _nearest_to_both(
    tables: GridTables, cells: Cells, others: Cells, seen: Bool[Array, "n"]
) -> tuple[Int32[Array, "n"], Int32[Array, "n"]]:
    """The corner of each cell on the shortest open way to another, and how far the cell is from it."""
    first, count = _blocks_of(tables, cells)
    count = jnp.where(seen, 0, count)

    def with_block(block: Int[Array, ""], best: tuple[Int32[Array, "n"], ...]) -> tuple[Int32[Array, "n"], ...]:
        corners = looked_up(tables.blocks, first + jnp.minimum(block, jnp.maximum(count - 1, 0))).astype(jnp.int32)
        ways = _legs(tables, cells, corners) + _legs(tables, others, corners)
        least = ways.min(axis=1)
        corner = jnp.where(ways == least[:, None], corners, -1).max(axis=1)
        nearer = least < best[0]
        return jnp.where(nearer, least, best[0]), jnp.where(nearer, corner, best[1])

    far = jnp.full(len(cells), FAR, jnp.int32)
    _, corner = lax.fori_loop(0, count.max(), with_block, (far, jnp.zeros_like(far)))
    return corner, jnp.where(count > 0, _legs(tables, cells, corner[:, None])[:, 0], FAR)


def _better_blocks(tables: GridTables, cells: Cells, others: Cells, length: Int32[Array, "n"]) -> UInt32[Array, "n"]:
    """Which of the first 32 blocks of each cell have a corner whose open way to another is shorter than a path."""
    first, count = _blocks_of(tables, cells)
    count = jnp.where(length > 0, count, 0)

    def with_block(block: Int[Array, ""], bits: UInt32[Array, "n"]) -> UInt32[Array, "n"]:
        corners = looked_up(tables.blocks, first + jnp.minimum(block, jnp.maximum(count - 1, 0))).astype(jnp.int32)
        ways = _legs(tables, cells, corners) + _legs(tables, others, corners)
        better = (ways.min(axis=1) < length) & (block < count)
        return bits | better.astype(jnp.uint32) << block.astype(jnp.uint32)

    none = jnp.zeros(len(cells), jnp.uint32)
    return lax.fori_loop(0, jnp.minimum(count.max(), _WORD), with_block, none)


class _Left(NamedTuple):
    """Cells, and which of the first 32 blocks of each may have better corners; of those behind these all may."""

    cells: Cells
    blocks: UInt32[Array, "n"]

    def words(self, tables: GridTables) -> Int32[Array, ""]:
        """How many words with a bit for each block there are."""
        return -(-_blocks_of(tables, self.cells)[1].max() // _WORD)

    def word(self, tables: GridTables, number: Int[Array, ""]) -> UInt32[Array, "n"]:
        """One of these words."""
        behind = jnp.clip(_blocks_of(tables, self.cells)[1] - number * _WORD, 0, _WORD).astype(jnp.uint32)
        every = jnp.where(behind == 0, 0, ~jnp.uint32(0) >> jnp.minimum(_WORD - behind, _WORD - 1))
        return jnp.where(number == 0, self.blocks, every)

    def corners(self, tables: GridTables, number: Int[Array, ""], bits: UInt32[Array, "n"]) -> Int32[Array, "n 4"]:
        """Those of the block of the lowest bit; of any one without a bit."""
        place = lax.population_count(~bits & (bits - 1)).astype(jnp.int32) + number * _WORD
        first, _ = _blocks_of(tables, self.cells)
        return looked_up(tables.blocks, jnp.where(bits != 0, first + place, 0)).astype(jnp.int32)


def _least_of_those_left(
    tables: GridTables, left: _Left, others_left: _Left, length: Int32[Array, "n"]
) -> Int32[Array, "n"]:
    """The length, or less over a corner of a block that is left, a corner of one of the other's, and to the other."""

    def with_words(words: Int[Array, ""], length: Int32[Array, "n"]) -> Int32[Array, "n"]:
        word, other_word = jnp.divmod(words, others_left.words(tables))
        blocks, other_blocks = left.word(tables, word), others_left.word(tables, other_word)

        def with_blocks(state: _BitsAndLength) -> _BitsAndLength:
            bits, other_bits, length = state
            corners, others = left.corners(tables, word, bits), others_left.corners(tables, other_word, other_bits)
            legs, other_legs = _legs(tables, left.cells, corners), _legs(tables, others_left.cells, others)
            between = tables.distances.between(corners[:, :, None], others[:, None])
            way = (legs[:, :, None] + between + other_legs[:, None]).min(axis=(1, 2))
            length = jnp.where((bits != 0) & (other_bits != 0), jnp.minimum(length, way), length)
            other_bits = other_bits & (other_bits - 1)
            is_last = other_bits == 0
            bits = jnp.where(is_last, bits & (bits - 1), bits)
            return bits, jnp.where(is_last, other_blocks, other_bits), length

        def some_left(state: _BitsAndLength) -> Bool[Array, ""]:
            return ((state[0] != 0) & (other_blocks != 0)).any()

        return lax.while_loop(some_left, with_blocks, (blocks, other_blocks, length))[2]

    return lax.fori_loop(0, left.words(tables) * others_left.words(tables), with_words, length)


_BitsAndLength = tuple[UInt32[Array, "n"], UInt32[Array, "n"], Int32[Array, "n"]]


def _legs(tables: GridTables, cells: Cells, corners: Int32[Array, "n k"]) -> Int32[Array, "n k"]:
    """Open lengths between cells and corners."""
    rows, columns = (looked_up(table, corners) for table in (tables.row, tables.column))
    return open_length(tables.connectivity, jnp.abs(rows - cells[:, :1]), jnp.abs(columns - cells[:, 1:]))


def _least_around(
    tables: GridTables,
    cells: Cells,
    onward: Callable[[Int32[Array, "n 4"]], Int32[Array, "n 4"]],
    shape: tuple[int, ...],
) -> Int32[Array, "n"]:
    """Least length of a path from each cell by way of one of its corners to one end; far if it has none.

    ``onward`` gives the lengths of the rest of the way, from four corners of each cell.
    """
    first, count = _blocks_of(tables, cells)

    def with_block(block: Int[Array, ""], least: Int32[Array, "n"]) -> Int32[Array, "n"]:
        # Of a cell with fewer blocks its last one, again.
        corners = looked_up(tables.blocks, first + jnp.minimum(block, jnp.maximum(count - 1, 0))).astype(jnp.int32)
        return jnp.minimum(least, (_legs(tables, cells, corners) + onward(corners)).min(axis=-1))

    far = jnp.full(shape, FAR, jnp.int32)
    return jnp.where(count > 0, lax.fori_loop(0, count.max(), with_block, far), far)


def _where_seen(tables: GridTables, p: Cells, q: Cells, around: Int32[Array, "n"]) -> Int32[Array, "n"]:
    """Length in units between cells that see each other, of others the way around corners."""
    open_way = open_length(tables.connectivity, *jnp.abs(p - q).T)
    return jnp.where(sees(tables.sight, p, q), open_way, around)


def _blocks_of(tables: GridTables, cells: Cells) -> tuple[Int32[Array, "n"], Int32[Array, "n"]]:
    """Where the blocks of each cell's corners begin, and how many there are."""
    cell = cells[:, 0] * tables.shape[1] + cells[:, 1]
    first, end = (
        looked_up(tables.group_block, one // GROUP) + looked_up(tables.cell_block, one).astype(jnp.int32)
        for one in (cell, cell + 1)
    )
    return first, end - first


def in_steps(connectivity: int, length: Int32[Array, "n"], inside: Bool[Array, "n"]) -> Float[Array, "n"]:
    """Lengths of units in steps, never rounded up; ``inf`` if far, or not inside."""
    whole, rest = jnp.divmod(length, units(connectivity))
    part = rest / units(connectivity)
    whole = whole.astype(part.dtype)
    steps = jnp.where(rest == 0, whole, (whole + part) * (1 - _ROUNDING))
    return jnp.where(inside & (length < FAR), steps, jnp.inf)
