"""Distances between pairs of grid cells in JAX.

Cells that see each other are as far apart as on an empty grid. Otherwise a shortest path passes two obstacle corners:
one that is stored for its first cell, and one that is stored for its last cell. A cell has up to dozens of corners,
stored in blocks of four. From a cell to its corner, the path is as long as on an empty grid.

First choose for each of the two cells the corner through which a path on an empty grid would be shortest. Compute the
length of the path through these two corners. Then try only the blocks with a corner through which a path on an empty
grid would be shorter than this length.
"""

from collections.abc import Callable, Sequence
from dataclasses import field
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.export import is_symbolic_dim
from jaxtyping import Array, Bool, Float, Int, Int32, Integer, Num, UInt32

from plr_jax._arrays import parts, ragged_indices
from plr_jax._compiled import part_by_part, pytree
from plr_jax.pairs import grid_corners
from plr_jax.pairs.grid_corners import FAR, STRAIGHT, CornerLabels, CornerTable, Grid, looked_up, open_length

# Tables of sums of an 8-connected grid, first of the grid, then of its transpose: two of slanted sums, of the grid
# and its mirror image, and one of row sums.
_TABLES = 3
_IN_ROWS = 2  # index of the row sums
BLOCK = 4  # corners of a cell that are read in one step
GROUP = 16  # cells whose block offsets share a base
_BLOCKS_AT_ONCE = 2**20  # blocks filled together during construction
_SORTED_BITS = 18  # bits of the index of a pair among the pairs sorted together
_CHUNK = 1024  # pairs per chunk
_MOST_FEW = 2**14  # pairs of cells, and pairs of blocks of their corners, that NumPy tries in some milliseconds
_MOST_SORTED = 2**7 - 1  # larger numbers of blocks count as this in sorting
_WORD = 32  # bits of a word
_ROUNDING = 2.0**-22  # more than the relative error of rounding in 32 bits
# Relative error of an answer on an 8-connected grid, from rounding down and from the length of a diagonal step.
SLACK = 2.0**-20
Cells = Int[Array, "n 2"] | Int[np.ndarray, "n 2"]  # rows and columns; functions of cells answer NumPy in NumPy
Ints = Int[Array, "*n"] | Int[np.ndarray, "*n"]
Flags = Bool[Array, "n"] | Bool[np.ndarray, "n"]
_Points = Num[Array, "*batch 2"] | Num[np.ndarray, "*batch 2"]
_Steps = Float[Array, "*batch"] | Float[np.ndarray, "*batch"]
_Lengths = Int32[Array, "n"]
_Bits = UInt32[Array, "n"]  # of each cell, one bit for each of 32 blocks of corners
_Scalar = Int[Array, ""]
_Corners = Int32[Array, "n 4"]  # a block of corners of each cell, or their distances
_Sums = Int[np.ndarray, "rows_plus_one columns_plus_one"]


@pytree
class GridTables:
    """Arrays of a grid: free cells, corners where shortest paths from each cell may turn first, corner distances.

    The corners of a cell are stored in blocks of four. Prefix sums count blocked cells and illegal diagonal steps:
    from them, :func:`sees` finds how many are between two cells.
    """

    free: UInt32[Array, " words"]  # one bit for each cell in row-major order, lowest bit of a word first
    sums: Integer[Array, " sums"]  # flattened tables, each with a row and a column of zeros in front
    group_block: Int32[Array, " groups"]  # first block of corners of each group of 16 cells, in row-major order
    cell_block: Integer[Array, " cells_plus_one"]  # first block of each cell, relative to its group's first block
    blocks: Integer[Array, "blocks 4"]  # corners of cells; a cell's last corner fills up its last block
    row: Int32[Array, " corners"]
    column: Int32[Array, " corners"]
    distances: CornerTable | CornerLabels
    shape: tuple[int, int] = field(metadata={"static": True})
    connectivity: int = field(metadata={"static": True})


def _sums_of(free: Grid, connectivity: int) -> Int[np.ndarray, " sums"]:
    """Build prefix sums of a grid, with which :func:`sees` counts blocked cells and illegal steps between two cells.

    The result is ``GridTables.sums``: one table for a 4-connected grid, six for an 8-connected grid, flattened and
    joined. Steps are diagonal, and illegal if one of the four cells around the step is blocked.
    """
    # A table of sums has a row and a column of zeros in front. Entry (r + 1, c + 1) counts
    # - 4-connected: blocked cells in rows up to r and columns up to c;
    # - 8-connected, row sums: blocked cells in row r and columns up to c;
    # - 8-connected, slanted sums: illegal diagonal steps that end in cells # of the sketch:
    #
    #        # . . . .  r - 2    A step ends in cell (r, c) and begins in cell (r - 1, c - 1). It is illegal if one of
    #        # # . . .  r - 1    the four cells of its square is blocked.
    #        # # # . .  r
    #            c
    #
    # Only blocked cells beside a free cell count, and only illegal steps whose square also has a free cell. This
    # suffices, since `sees` counts between a free cell p and a cell q: on the way from p to any blocked cell in
    # between, the first blocked cell is beside a free cell, and the first square with a blocked cell also has a free
    # one.

    def sums_along_rows(marks: Grid) -> _Sums:
        return np.pad(marks.astype(np.int64), ((1, 0), (1, 0))).cumsum(axis=1)

    def is_beside_free(grid: Grid) -> Grid:
        around = np.pad(grid, ((0, 0), (1, 1)))
        return around[:, :-2] | around[:, 2:]

    def slanted_sums(grid: Grid) -> _Sums:
        cells = np.stack([grid[1:, 1:], grid[:-1, :-1], grid[1:, :-1], grid[:-1, 1:]])
        sums = sums_along_rows(np.pad(cells.any(axis=0) & ~cells.all(axis=0), ((1, 0), (1, 0))))
        for row in range(1, len(sums)):
            sums[row, 1:] += sums[row - 1, :-1]
        return sums

    if connectivity == 4:  # one table: the blocked cells above and before each cell
        tables = [sums_along_rows(~free & (is_beside_free(free) | is_beside_free(free.T).T)).cumsum(axis=0)]
    else:
        tables = []
        for grid in (free, free.T):  # illegal steps of the grid and of its mirror image, blocked cells in rows
            tables += [slanted_sums(grid), slanted_sums(grid[:, ::-1]), sums_along_rows(~grid & is_beside_free(grid))]
    return np.concatenate([table.ravel() for table in tables])


def is_free(tables: GridTables, cells: Cells) -> Flags:
    # Cell i, in row-major order, has bit i % 32 of word i // 32.
    cell = (cells[:, 0] * tables.shape[1] + cells[:, 1]).astype(np.uint32)
    return (looked_up(tables.free, cell >> 5) >> (cell & 31) & 1).astype(bool)


def sees(tables: GridTables, p: Cells, q: Cells) -> Flags:
    """Return, for each pair of cells ``p[i]`` and ``q[i]``, whether they see each other.

    Two cells see each other if both are free and no obstacle blocks any path between them that would be shortest on
    an empty grid.
    """
    # It suffices to test that p is free: if only q is blocked, the sums count q, a cell before q, or a step before q.
    xp: Any = np if isinstance(p, np.ndarray) else jnp
    sums = xp.asarray(tables.sums)

    def between(row: Ints, column: Ints, last_column: Ints) -> Ints:
        # The sum over columns; `row` is the index in `sums` of the first entry of a row. Sums may be unsigned.
        return sums[row + last_column + 1].astype(np.int32) - sums[row + column].astype(np.int32)

    if tables.connectivity == 4:  # the rectangle between the cells must be free
        (row, column), (last_row, last_column) = xp.minimum(p, q).T, xp.maximum(p, q).T
        stride = tables.shape[1] + 1
        above, below = row * stride, (last_row + 1) * stride
        return is_free(tables, p) & (between(below, column, last_column) == between(above, column, last_column))
    # If the cells are in one row or column, no cell between may be blocked. Else no diagonal step of the
    # parallelogram between them may be illegal:
    #
    #        row   p . . . .          `aside` is the number of rows from p to q. The slanted sum of the last row,
    #                . . . . .        from column + aside to last_column, counts the steps that end in this slanted
    #   last_row       . . . . q      band in the last row or above. The slanted sum of the first row, from column
    #                                 to last_column - aside, counts the steps that end in the first row or above.
    #
    # 1. Transpose and mirror so that the path leads up in rows and columns, by no fewer columns than rows.
    offset = q - p
    is_transposed = xp.abs(offset[:, 0]) > xp.abs(offset[:, 1])
    is_mirrored = offset[:, 0] * offset[:, 1] < 0
    is_straight = (offset == 0).any(axis=1)
    rows, columns = tables.shape
    width = xp.where(is_transposed, rows, columns)
    (row, column), (other_row, other_column) = (xp.where(is_transposed, end[:, ::-1].T, end.T) for end in (p, q))
    column, other_column = (xp.where(is_mirrored, width - 1 - end, end) for end in (column, other_column))
    row, last_row = xp.minimum(row, other_row), xp.maximum(row, other_row)
    column, last_column = xp.minimum(column, other_column), xp.maximum(column, other_column)
    # 2. Choose the table, and compare the sums.
    number = _TABLES * is_transposed.astype(p.dtype) + xp.where(is_straight, _IN_ROWS, is_mirrored.astype(p.dtype))
    table = (rows + 1) * (columns + 1) * number
    first, last = (table + (end + 1) * (width + 1) for end in (row, last_row))
    aside = last_row - row
    until_first = xp.where(is_straight, 0, between(first, column, last_column - aside))
    return is_free(tables, p) & (between(last, column + aside, last_column) == until_first)


def _narrow(numbers: Int[np.ndarray, " n"]) -> Integer[np.ndarray, " n"]:
    # The same numbers, which are at least 0, in as few bytes as the largest one needs.
    return numbers.astype(np.min_scalar_type(numbers.max(initial=0)))


def tables_of(free: Grid, connectivity: int) -> GridTables:
    """Build the tables of a grid that queries read."""
    first, corners = grid_corners.taut_corners(free, connectivity)
    # Pack the corners of each cell into blocks: the first block of cell i is
    # `group_block[i // GROUP] + cell_block[i]`, where small integers suffice for `cell_block`.
    counts = np.diff(first)
    num_blocks = -(-counts // BLOCK)
    first_block = np.concatenate([[0], np.cumsum(num_blocks)])
    blocks = np.empty((first_block[-1], BLOCK), np.min_scalar_type(corners.max(initial=0)))
    for part in parts(num_blocks, _BLOCKS_AT_ONCE):
        cell, block = ragged_indices(num_blocks[part])
        place = np.minimum(BLOCK * block[:, None] + np.arange(BLOCK), counts[part][cell, None] - 1)
        blocks[first_block[part.start] : first_block[part.stop]] = corners[first[part][cell, None] + place]
    group_block = first_block[::GROUP]
    cell_block = first_block - np.repeat(group_block, GROUP)[: len(first_block)]
    row, column = (places.astype(np.int32) for places in np.nonzero(grid_corners.corner_cells(free)))
    distances = grid_corners.corner_distances(free, connectivity)
    bits = np.packbits(np.pad(free.ravel(), (0, -free.size % 32)), bitorder="little").view("<u4")
    of_cells = bits, _narrow(_sums_of(free, connectivity)), group_block.astype(np.int32), _narrow(cell_block), blocks
    arrays = map(jnp.asarray, (*of_cells, row, column))
    tables = GridTables(*arrays, distances=distances, shape=free.shape, connectivity=connectivity)
    # Queries also read empty tables, and ignore the value: give empty tables one entry.
    return jax.tree.map(lambda a: a if a.size else jnp.zeros([max(n, 1) for n in a.shape], a.dtype), tables)


@jax.jit
def evaluate_pairs(tables: GridTables, x: _Points, y: _Points) -> _Steps:
    """Return path lengths in steps between the cells of points, ``inf`` outside the grid or without a path."""
    (p, p_is_inside), (q, q_is_inside) = (cells_of(tables.shape, points.reshape(-1, 2)) for points in (x, y))
    lengths = lengths_between_cells(tables, p, q)
    return _in_steps(tables.connectivity, lengths, p_is_inside & q_is_inside).reshape(x.shape[:-1])


def evaluate_few(tables: GridTables, x: _Points, y: _Points) -> _Steps | None:
    """Return path lengths in steps as :func:`evaluate_pairs` does, but computed in NumPy, without compilation.

    The result is None for so many pairs that compiled code is as fast.
    """
    # 1. Answer pairs of cells that see each other.
    (p, p_is_inside), (q, q_is_inside) = (cells_of(tables.shape, points.reshape(-1, 2)) for points in (x, y))
    if len(p) > _MOST_FEW:
        return None
    lengths = open_length(tables.connectivity, *np.abs(p - q).T)
    hidden = np.flatnonzero(p_is_inside & q_is_inside & ~sees(tables, p, q))
    # 2. For other pairs, try all combinations of a block of the first cell and a block of the second cell.
    #    Combination `number` has block `number // other_count` of the first cell, `number % other_count` of the
    #    second.
    (first, count), (other_first, other_count) = (_blocks_of(tables, cells[hidden]) for cells in (p, q))
    combinations: Any = count * other_count
    if combinations.sum() > _MOST_FEW:
        return None
    lengths[hidden] = FAR
    pair, number = ragged_indices(combinations)
    block, other_block = first[pair] + number // other_count[pair], other_first[pair] + number % other_count[pair]
    corners, others = (looked_up(tables.blocks, index).astype(np.int32) for index in (block, other_block))
    legs, other_legs = _legs(tables, p[hidden[pair]], corners), _legs(tables, q[hidden[pair]], others)
    between = tables.distances.between(corners[:, :, None], others[:, None])
    np.minimum.at(lengths, hidden[pair], (legs[:, :, None] + between + other_legs[:, None]).min(axis=(1, 2)))
    return _in_steps(tables.connectivity, lengths, p_is_inside & q_is_inside).reshape(x.shape[:-1])


@jax.jit
def evaluate_to(tables: GridTables, from_goal: Int32[Array, " corners"], goal: Int[Array, "2"], x: _Points) -> _Steps:
    """Return path lengths in steps from the cells of points ``x`` to the cell ``goal`` (row, column).

    ``from_goal`` has the path lengths from the goal to all obstacle corners, the result of :func:`corners_from`.
    """
    p, is_inside = cells_of(tables.shape, x.reshape(-1, 2))
    q = jnp.broadcast_to(goal, p.shape)
    around = partial(_least_around, tables, onward=partial(looked_up, from_goal))
    direct = open_length(tables.connectivity, *jnp.abs(p - q).T)
    lengths = jnp.where(sees(tables, p, q), direct, part_by_part(around, _CHUNK, p))
    return _in_steps(tables.connectivity, lengths, is_inside).reshape(x.shape[:-1])


@jax.jit
def corners_from(tables: GridTables, goal: Int[Array, "2"]) -> Int32[Array, " corners"]:
    """Return the lengths of shortest paths from a cell (row, column) to all obstacle corners, as integers.

    A straight step has the length ``STRAIGHT[connectivity]``.
    """
    all_corners = jnp.arange(len(tables.row), dtype=jnp.int32)
    cells = jnp.broadcast_to(goal, (len(all_corners), 2))
    return _least_around(tables, cells, lambda corners: tables.distances.between(all_corners[:, None], corners))


def cells_of(shape: tuple[int, int], x: Any) -> tuple[Cells, Flags]:
    """Return the rows and columns of the cells of points ``(x, y)``, and whether points are on the grid of ``shape``.

    Points off the grid get the cell (0, 0).
    """
    xp: Any = np if isinstance(x, np.ndarray) else jnp
    place = xp.floor(x)[:, ::-1]
    is_inside = ((place >= 0) & (place < xp.asarray(shape, place.dtype)[None])).all(axis=1)
    return xp.where(is_inside[:, None], place, 0).astype(np.int32), is_inside


def lengths_between_cells(tables: GridTables, p: Cells, q: Cells) -> _Lengths:
    return part_by_part(partial(_lengths_at_once, tables), 1 << _SORTED_BITS, p, q)


def _lengths_at_once(tables: GridTables, p: Cells, q: Cells) -> _Lengths:
    """Return integer path lengths between cells ``p[i]`` and ``q[i]``; FAR without a path.

    Pairs are answered in chunks. They are sorted first, so that the pairs of a chunk take equally long.
    """
    # A loop over blocks takes as long for a chunk as for its slowest pair.
    is_seen = sees(tables, p, q)
    if is_symbolic_dim(p.shape[0]):  # pairs of an unknown number are not sorted
        length, *bits = _most_likely(tables, p, q, is_seen)
        return _least_over_blocks(tables, (p, q), bits, length)
    # 1. Find the most likely paths. Sort pairs by the number of blocks of the first cell, then of the second cell.
    num_p, num_q = (jnp.minimum(jnp.where(is_seen, 0, _blocks_of(tables, end)[1]), _MOST_SORTED) for end in (p, q))
    chunks = _sorted_chunks(num_p * (_MOST_SORTED + 1) + num_q)
    by_chunk = lax.map(lambda chunk: _most_likely(tables, p[chunk], q[chunk], is_seen[chunk]), chunks)
    length, *bits = (jnp.zeros(len(p), column.dtype).at[chunks].set(column) for column in by_chunk)
    # 2. Try the blocks that may have shorter paths. Sort pairs by the number of combinations of such blocks.
    num_p, num_q = (lax.population_count(of_cell).astype(jnp.int32) for of_cell in bits)
    chunks = _sorted_chunks(num_p * num_q)

    def of_chunk(chunk: Int32[Array, " size"]) -> Int32[Array, " size"]:
        return _least_over_blocks(tables, (p[chunk], q[chunk]), [of_cell[chunk] for of_cell in bits], length[chunk])

    return length.at[chunks].set(lax.map(of_chunk, chunks))


def _sorted_chunks(work: _Lengths) -> Int32[Array, "chunks size"]:
    # Indices in ascending order of `work`, chunk by chunk; the last index is repeated to fill its chunk. Each sorted
    # integer holds the work in its high 14 bits, and the index of a pair in its low 18 bits.
    key = work.astype(jnp.uint32) << _SORTED_BITS | jnp.arange(len(work), dtype=jnp.uint32)
    order = (jnp.sort(key) & ((1 << _SORTED_BITS) - 1)).astype(jnp.int32)
    size = min(_CHUNK, len(work))
    return jnp.pad(order, (0, -len(work) % size), mode="edge").reshape(-1, size)


def _most_likely(tables: GridTables, p: Cells, q: Cells, is_seen: Flags) -> tuple[_Lengths, _Bits, _Bits]:
    """Return, for each pair of cells, the length of a probably shortest path, and blocks that may shorten it.

    A block is a group of four corners that a path may pass. The second result has the blocks of cells ``p``, the
    third the blocks of cells ``q``, as bits of an integer (see :func:`_least_over_blocks`). ``is_seen`` says which
    pairs of cells see each other. For these pairs, the length is exact, and there are no blocks.
    """
    corner, leg = _nearest_to_both(tables, p, q, is_seen)
    other, other_leg = _nearest_to_both(tables, q, p, is_seen)
    total = leg + tables.distances.between(corner, other) + other_leg
    length = jnp.where((leg < FAR) & (other_leg < FAR), jnp.minimum(total, FAR), FAR)
    length = jnp.where(is_seen, open_length(tables.connectivity, *jnp.abs(p - q).T), length)
    # If no path joins these corners, no path joins the cells, as all corners of a cell are joined to it.
    to_beat = jnp.where((length < FAR) & ~is_seen, length, 0)
    return length, _better_blocks(tables, p, q, to_beat), _better_blocks(tables, q, p, to_beat)


def _nearest_to_both(tables: GridTables, cells: Cells, others: Cells, is_seen: Flags) -> tuple[_Lengths, _Lengths]:
    """Choose the corner of each cell over which the path to the other cell would be shortest on an empty grid.

    Paths lead from ``cells[i]``, over one of the corners stored for this cell, to ``others[i]``. Return the index of
    the corner, and the path length from the cell to the corner. The length is FAR if the cell has no corner, or
    if ``is_seen`` says that both cells see each other.
    """
    first, count = _blocks_of(tables, cells)
    count = jnp.where(is_seen, 0, count)

    def with_block(block: _Scalar, best: tuple[_Lengths, ...]) -> tuple[_Lengths, ...]:
        corners = _corners_of_block(tables, first, count, block)
        lengths = _legs(tables, cells, corners) + _legs(tables, others, corners)
        least = lengths.min(axis=1)
        corner = jnp.where(lengths == least[:, None], corners, -1).max(axis=1)  # any of the nearest corners
        is_nearer = least < best[0]
        return jnp.where(is_nearer, least, best[0]), jnp.where(is_nearer, corner, best[1])

    far = jnp.full_like(count, FAR)
    _, corner = lax.fori_loop(0, count.max(), with_block, (far, jnp.zeros_like(far)))
    return corner, jnp.where(count > 0, _legs(tables, cells, corner[:, None])[:, 0], FAR)


def _better_blocks(tables: GridTables, cells: Cells, others: Cells, length: _Lengths) -> _Bits:
    # A bit for each of a cell's first 32 blocks: whether a path over one of its four corners would be shorter than
    # `length` on an empty grid, so that a path may be. Later blocks are always tried (`_least_over_blocks`).
    first, count = _blocks_of(tables, cells)
    count = jnp.where(length > 0, count, 0)

    def with_block(block: _Scalar, bits: _Bits) -> _Bits:
        corners = _corners_of_block(tables, first, count, block)
        lengths = _legs(tables, cells, corners) + _legs(tables, others, corners)
        is_better = (lengths.min(axis=1) < length) & (block < count)
        return bits | is_better.astype(jnp.uint32) << block.astype(jnp.uint32)

    return lax.fori_loop(0, jnp.minimum(count.max(), _WORD), with_block, jnp.zeros_like(count, jnp.uint32))


def _least_over_blocks(tables: GridTables, cells: Sequence[Cells], bits: list[_Bits], length: _Lengths) -> _Lengths:
    """Return, for each pair of cells, the length of the shortest path over two corners, but at most ``length``.

    Each corner is in a block of four corners of its cell. ``cells`` and ``bits`` have an array for the first cells of
    the pairs, then one for the second cells. A bit is set if its block, one of the cell's first 32 blocks, must be
    tried. Later blocks are always tried.
    """
    blocks = [_blocks_of(tables, end) for end in cells]
    num_words_p, num_words_q = (-(-count.max() // _WORD) for _, count in blocks)  # as the cell with most blocks needs

    def word(end: int, number: _Scalar) -> _Bits:
        # In later words, the bits of all blocks that exist. A shift by 32 bits is undefined, so a word without bits
        # is a case of its own.
        num_bits = jnp.clip(blocks[end][1] - number * _WORD, 0, _WORD).astype(jnp.uint32)
        all_bits = jnp.where(num_bits == 0, 0, ~jnp.uint32(0) >> jnp.minimum(_WORD - num_bits, _WORD - 1))
        return jnp.where(number == 0, bits[end], all_bits)

    def corners_and_legs(end: int, number: _Scalar, bits: _Bits) -> tuple[Ints, Ints]:
        # The corners of the block of the lowest set bit x: as many zeros are below it as ~x & (x - 1) has ones.
        block = blocks[end][0] + lax.population_count(~bits & (bits - 1)).astype(jnp.int32) + number * _WORD
        corners = looked_up(tables.blocks, jnp.where(bits != 0, block, 0)).astype(jnp.int32)
        return corners, _legs(tables, cells[end], corners)

    # Loop over all pairs of a word of the first cell and a word of the second cell, then over pairs of set bits.
    def with_pair_of_words(pair: _Scalar, length: _Lengths) -> _Lengths:
        number_p, number_q = jnp.divmod(pair, num_words_q)
        word_p, word_q = word(0, number_p), word(1, number_q)

        def with_pair_of_bits(state: tuple[_Bits, _Bits, _Lengths]) -> tuple[_Bits, _Bits, _Lengths]:
            # The lowest set bits are the next pair of blocks; x & (x - 1) clears the lowest set bit of x. For each
            # bit of the first cell, go through all bits of the second cell, then start these again.
            bits_p, bits_q, length = state
            corners_p, legs_p = corners_and_legs(0, number_p, bits_p)
            corners_q, legs_q = corners_and_legs(1, number_q, bits_q)
            between = tables.distances.between(corners_p[:, :, None], corners_q[:, None])
            total = (legs_p[:, :, None] + between + legs_q[:, None]).min(axis=(1, 2))
            length = jnp.where((bits_p != 0) & (bits_q != 0), jnp.minimum(length, total), length)
            bits_q = bits_q & (bits_q - 1)
            is_last = bits_q == 0
            bits_p = jnp.where(is_last, bits_p & (bits_p - 1), bits_p)
            return bits_p, jnp.where(is_last, word_q, bits_q), length

        start = word_p, word_q, length
        return lax.while_loop(lambda state: ((state[0] != 0) & (word_q != 0)).any(), with_pair_of_bits, start)[2]

    return lax.fori_loop(0, num_words_p * num_words_q, with_pair_of_words, length)


def _legs(tables: GridTables, cells: Cells, corners: Ints) -> Ints:
    # Path lengths on an empty grid from each cell to each corner in its row of `corners`.
    rows, columns = (looked_up(table, corners) for table in (tables.row, tables.column))
    return open_length(tables.connectivity, abs(rows - cells[:, :1]), abs(columns - cells[:, 1:]))


def _least_around(tables: GridTables, cells: Cells, onward: Callable[[_Corners], _Corners]) -> _Lengths:
    # The least length over a corner that is stored for the cell; `onward` maps corners to their distance to the goal.
    first, count = _blocks_of(tables, cells)

    def with_block(block: _Scalar, least: _Lengths) -> _Lengths:
        corners = _corners_of_block(tables, first, count, block)
        return jnp.minimum(least, (_legs(tables, cells, corners) + onward(corners)).min(axis=-1))

    far = jnp.full(cells.shape[:1], FAR, jnp.int32)
    return jnp.where(count > 0, lax.fori_loop(0, count.max(), with_block, far), far)


def _blocks_of(tables: GridTables, cells: Cells) -> tuple[Ints, Ints]:
    """Return the index of the first block of corners of each cell, and the number of the cell's blocks."""
    cell = cells[:, 0] * tables.shape[1] + cells[:, 1]
    of_group, of_cell = tables.group_block, tables.cell_block
    first, end = (looked_up(of_group, i // GROUP) + looked_up(of_cell, i).astype(np.int32) for i in (cell, cell + 1))
    return first, end - first


def _corners_of_block(tables: GridTables, first: Ints, count: Ints, block: _Scalar) -> _Corners:
    # Cells with fewer blocks get their last block once more.
    return looked_up(tables.blocks, first + jnp.minimum(block, jnp.maximum(count - 1, 0))).astype(jnp.int32)


def _in_steps(connectivity: int, length: Ints, is_inside: Flags) -> Any:
    """Convert integer path lengths to lengths in steps, rounded down, ``inf`` outside the grid or without a path."""
    xp: Any = np if isinstance(length, np.ndarray) else jnp
    dtype = jax.dtypes.canonicalize_dtype(np.float64)
    # A whole number of straight steps is exact. Other lengths are rounded down: answers are never above the truth.
    whole, remainder = xp.divmod(length, STRAIGHT[connectivity])
    fraction = remainder.astype(dtype) / STRAIGHT[connectivity]
    steps = xp.where(remainder == 0, whole.astype(dtype), (whole.astype(dtype) + fraction) * (1 - _ROUNDING))
    return xp.where(is_inside & (length < FAR), steps, np.inf)
