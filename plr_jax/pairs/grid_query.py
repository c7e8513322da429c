"""Distances of pairs of cells, in JAX: the open length if they see each other, else the least sum over corners.

Cells have from none to dozens of corners, and a pair takes the product of two such numbers. So pairs are sorted by
how many blocks of corners their cells have, and taken in chunks of pairs of about as many.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from math import isqrt

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int, Int32, Integer, Num, Shaped, UInt32

from plr_jax._arrays import parts, runs
from plr_jax.pairs.grid_corners import FAR, corner_distances
from plr_jax.pairs.grid_sectors import corner_cells, open_length, taut_corners, units

# Whether cells see each other: illegal steps between them, counted by at most four lookups.
#
# Between cells of an 8-connected grid that are not in one row or column, diagonal steps tell: if they are all legal,
# so are the straight ones. They start in a parallelogram, which is a rectangle in the coordinates ``(row, column -
# row)``, so that sums over rows and slanted columns count them as a summed-area table counts what is in a rectangle.
#
# Of what is illegal only that counts which is beside something free: between cells of which one is free there is some
# of that if there is any, as rectangles are connected. So sums are small.
#
# References:
#     Crow, "Summed-area tables for texture mapping", SIGGRAPH 1984.


_WAYS, _IN_ROWS = 3, 2  # tables of a grid, and the place among them of that of its rows

Cells = Int[Array, "n 2"]
"""Row and column of each of some cells of the grid."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class IllegalSteps:
    """Sums that tell which cells see each other, see :func:`sees`.

    Attributes:
        sums: Tables with a row and a column of zeros before those of the grid, one after the other. Of a 4-connected
            grid, blocked cells above and before each. Of an 8-connected one, illegal diagonal steps as it is, and
            mirrored, and blocked cells before each in its row; then these three of the transposed grid. Only those
            beside a free cell count.
        free: Bits of the cells in row-major order, the lowest of a word first.
        shape: Rows and columns of the grid.
        connectivity: 4 or 8.
    """

    sums: Integer[Array, "sums"]
    free: UInt32[Array, "words"]
    shape: tuple[int, int] = field(metadata={"static": True})
    connectivity: int = field(metadata={"static": True})


def sight_of(free: Bool[np.ndarray, "rows columns"], connectivity: int) -> IllegalSteps:
    """The sums of a grid."""
    if connectivity == 4:
        beside = _with_margin(~free & (_beside_free(free) | _beside_free(free.T).T))
        sums = [beside.cumsum(axis=0).cumsum(axis=1)]
    else:
        sums = [
            table
            for grid in (free, free.T)
            for table in (
                _slanted_sums(grid),
                _slanted_sums(grid[:, ::-1]),
                _with_margin(~grid & _beside_free(grid)).cumsum(axis=1),
            )
        ]
    flat = np.concatenate([table.ravel() for table in sums])
    bits = np.packbits(np.pad(free.ravel(), (0, -free.size % 32)), bitorder="little").view("<u4")
    return IllegalSteps(jnp.asarray(_narrow(flat)), jnp.asarray(bits), free.shape, connectivity)


def is_free(sight: IllegalSteps, cells: Cells) -> Bool[Array, "n"]:
    """Whether cells of the grid are free."""
    cell = (cells[:, 0] * sight.shape[1] + cells[:, 1]).astype(jnp.uint32)
    return (sight.free[cell >> 5] >> (cell & 31) & 1).astype(bool)


def _beside_free(free: Bool[np.ndarray, "rows columns"]) -> Bool[np.ndarray, "rows columns"]:
    """Whether a cell beside each in its row is free."""
    around = np.pad(free, ((0, 0), (1, 1)))
    return around[:, :-2] | around[:, 2:]


def sees(sight: IllegalSteps, p: Cells, q: Cells) -> Bool[Array, "n"]:
    """Whether cells of the grid see each other; blocked ones see none."""
    count = _count_in_rectangles if sight.connectivity == 4 else _count_in_sectors
    return is_free(sight, p) & (count(sight, p, q) == 0)


def _count_in_rectangles(sight: IllegalSteps, p: Cells, q: Cells) -> Int[Array, "n"]:
    """Blocked cells in the rectangles between cells."""
    (row, column), (last_row, last_column) = jnp.minimum(p, q).T, jnp.maximum(p, q).T
    stride = sight.shape[1] + 1
    above, below = row * stride, (last_row + 1) * stride
    return _between(sight, below, column, last_column) - _between(sight, above, column, last_column)


def _count_in_sectors(sight: IllegalSteps, p: Cells, q: Cells) -> Int[Array, "n"]:
    """Illegal diagonal steps in the parallelograms between cells; of cells in one line the blocked ones.

    The grid is looked at so that the way leads to higher rows and columns, by no fewer columns than rows.
    """
    way = q - p
    transposed = jnp.abs(way[:, 0]) > jnp.abs(way[:, 1])
    mirrored = way[:, 0] * way[:, 1] < 0
    straight = (way == 0).any(axis=1)
    rows, columns = sight.shape
    width = jnp.where(transposed, rows, columns)
    (row, column), (other_row, other_column) = (jnp.where(transposed, end[:, ::-1].T, end.T) for end in (p, q))
    column, other_column = (jnp.where(mirrored, width - 1 - end, end) for end in (column, other_column))
    row, last_row = jnp.minimum(row, other_row), jnp.maximum(row, other_row)
    column, last_column = jnp.minimum(column, other_column), jnp.maximum(column, other_column)

    table = (
        (rows + 1)
        * (columns + 1)
        * (_WAYS * transposed.astype(p.dtype) + jnp.where(straight, _IN_ROWS, mirrored.astype(p.dtype)))
    )
    first, last = (table + (end + 1) * (width + 1) for end in (row, last_row))
    aside = last_row - row
    until_last = _between(sight, last, column + aside, last_column)
    return until_last - jnp.where(straight, 0, _between(sight, first, column, last_column - aside))


def _between(
    sight: IllegalSteps, row: Int[Array, "n"], column: Int[Array, "n"], last_column: Int[Array, "n"]
) -> Int[Array, "n"]:
    """What the sums of a row, that begins there, increase by from before a column to the last one."""
    return sight.sums[row + last_column + 1].astype(jnp.int32) - sight.sums[row + column].astype(jnp.int32)


def _slanted_sums(free: Bool[np.ndarray, "rows columns"]) -> Int[np.ndarray, "rows_plus_one columns_plus_one"]:
    """Illegal diagonal steps that end in the rows until each cell's, at no greater ``column - row``."""
    cells = np.stack([free[1:, 1:], free[:-1, :-1], free[1:, :-1], free[:-1, 1:]])
    illegal = cells.any(axis=0) & ~cells.all(axis=0)
    sums = _with_margin(np.pad(illegal, ((1, 0), (1, 0)))).cumsum(axis=1)
    for row in range(1, len(sums)):
        sums[row, 1:] += sums[row - 1, :-1]
    return sums


def _with_margin(table: Bool[np.ndarray, "rows columns"]) -> Int[np.ndarray, "rows_plus_one columns_plus_one"]:
    return np.pad(table.astype(np.int64), ((1, 0), (1, 0)))


# What a query of pairs reads: all derived from the cells of a grid.


BLOCK = 4
"""Corners of a cell that a query reads at once."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class GridTables:
    """A grid, the corners at which each cell is taut, and the distances between corners.

    Attributes:
        sight: Which cells see each other.
        group_block: Where the blocks of each 16 cells begin, in row-major order.
        cell_block: How much later those of each cell begin; of one more at the end.
        blocks: Numbers of corners; the last of a cell is repeated to fill its last block.
        places: Cell of each corner, in row-major order.
        center: Center of each corner.
        between_centers: Their distances in units, row by row; at least ``FAR`` if there is no path.
        differences: How much longer the way from each corner to those before it and to itself is.
    """

    sight: IllegalSteps
    group_block: Int32[Array, "groups"]
    cell_block: Integer[Array, "cells_plus_one"]
    blocks: Integer[Array, "blocks 4"]
    places: UInt32[Array, "corners"]
    center: Integer[Array, "corners"]
    between_centers: Int32[Array, "center_pairs"]
    differences: Integer[Array, "pairs"]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the grid."""
        return self.sight.shape

    @property
    def connectivity(self) -> int:
        """4 or 8."""
        return self.sight.connectivity


def tables_of(free: Bool[np.ndarray, "rows columns"], connectivity: int) -> GridTables:
    """The tables of a grid."""
    first, corners = taut_corners(free, connectivity)
    first_block, blocks = _in_blocks(first, corners)
    group_block = first_block[::_GROUP]
    cell_block = first_block - np.repeat(group_block, _GROUP)[: len(first_block)]
    distances = corner_distances(free, connectivity)
    tables = (
        blocks,
        np.flatnonzero(corner_cells(free)).astype(np.uint32),
        _narrow(distances.center),
        distances.between_centers.ravel(),
        distances.differences,
    )
    # What is empty is read as well, though what is read is not used.
    tables = (table if len(table) else np.zeros((1, *table.shape[1:]), table.dtype) for table in tables)
    return GridTables(
        sight_of(free, connectivity),
        jnp.asarray(group_block, jnp.int32),
        jnp.asarray(_narrow(cell_block)),
        *map(jnp.asarray, tables),
    )


def _narrow(numbers: Int[np.ndarray, "n"]) -> Integer[np.ndarray, "n"]:
    """The same in as few bytes each as do."""
    return numbers.astype(np.min_scalar_type(numbers.max(initial=0)))


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


_GROUP = 16  # cells
_BLOCKS_AT_ONCE = 2**20
_SORTED_BITS = 14  # of the place of a pair among those that are sorted at once
_CHUNK = 1024  # pairs taken at once
_MOST_BLOCKS = 2**8 - 1  # told apart when pairs are sorted
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
    (p, p_inside), (q, q_inside) = (_cells_of(tables, points.reshape(-1, 2)) for points in (x, y))
    lengths = _where_seen(tables, p, q, _around_corners(tables, p, q))
    return _in_steps(tables, lengths, p_inside & q_inside).reshape(batch)


@jax.jit
def evaluate_to(
    tables: GridTables, from_goal: Int32[Array, "corners"], goal: Int[Array, "2"], x: Num[Array, "*batch 2"]
) -> Float[Array, "*batch"]:
    """As :func:`evaluate_pairs`, with one cell whose distance from each corner is known."""
    p, inside = _cells_of(tables, x.reshape(-1, 2))
    q = jnp.broadcast_to(goal, p.shape)
    size = min(_CHUNK, max(len(p), 1))
    chunks = jnp.pad(p, ((0, -len(p) % size), (0, 0))).reshape(-1, size, 2)

    def to_goal(corners: Int32[Array, "n 4"]) -> Int32[Array, "n 4"]:
        return _gather(from_goal, corners)

    around = lax.map(lambda cells: _least_around(tables, cells, to_goal, cells.shape[:1]), chunks)
    lengths = _where_seen(tables, p, q, around.reshape(-1)[: len(p)])
    return _in_steps(tables, lengths, inside).reshape(x.shape[:-1])


@jax.jit
def corners_from(tables: GridTables, goal: Int[Array, "2"]) -> Int32[Array, "corners"]:
    """Distance in units of each corner from a cell by way of the corners at which the cell is taut."""
    every = jnp.arange(len(tables.places), dtype=jnp.int32)
    cells = jnp.broadcast_to(goal, (len(every), 2))
    return _least_around(
        tables, cells, lambda corners: _lengths_between(tables, every[:, None], corners), every.shape
    )


def _cells_of(tables: GridTables, x: Num[Array, "n 2"]) -> tuple[Cells, Bool[Array, "n"]]:
    """Row and column of the cell of each point, or of some cell, and whether the point is in one."""
    place = jnp.floor(x)[:, ::-1]
    inside = ((place >= 0) & (place < jnp.asarray(tables.shape, place.dtype)[None])).all(axis=1)
    return jnp.where(inside[:, None], place, 0).astype(jnp.int32), inside


def _around_corners(tables: GridTables, p: Cells, q: Cells) -> Int32[Array, "n"]:
    """Least length of a path from one cell of each pair to a corner, to a corner, and to the other cell."""
    size = min(1 << _SORTED_BITS, max(len(p), 1))
    filled = jnp.pad(jnp.stack([p, q]), ((0, 0), (0, -len(p) % size), (0, 0)))
    pairs = filled.reshape(2, -1, size, 2).swapaxes(0, 1)
    return lax.map(lambda ends: _around_corners_sorted(tables, *ends), pairs).reshape(-1)[: len(p)]


def _around_corners_sorted(tables: GridTables, p: Cells, q: Cells) -> Int32[Array, "n"]:
    """As above, of at most so many pairs that are sorted at once."""
    counts = [jnp.minimum(_blocks_of(tables, cells)[1], _MOST_BLOCKS).astype(jnp.uint32) for cells in (p, q)]
    work = counts[0] * (_MOST_BLOCKS + 1) + counts[1]
    place = jnp.arange(len(p), dtype=jnp.uint32)
    order = (jnp.sort(work << _SORTED_BITS | place) & ((1 << _SORTED_BITS) - 1)).astype(jnp.int32)
    size = min(_CHUNK, len(p))
    chunks = jnp.pad(order, (0, -len(p) % size), mode="edge").reshape(-1, size)
    lengths = lax.map(lambda chunk: _around_corners_at_once(tables, p[chunk], q[chunk]), chunks)
    return jnp.zeros(len(p), jnp.int32).at[chunks].set(lengths)


def _around_corners_at_once(tables: GridTables, p: Cells, q: Cells) -> Int32[Array, "n"]:
    """As above, of pairs with about as many blocks of corners."""

    def to_other_cell(corners: Int32[Array, "n 4"]) -> Int32[Array, "n 4"]:
        def to(others: Int32[Array, "n 4"]) -> Int32[Array, "n 4 4"]:
            return _lengths_between(tables, corners[:, :, None], others[:, None])

        return _least_around(tables, q, to, corners.shape)

    return _least_around(tables, p, to_other_cell, p.shape[:1])


def _least_around(
    tables: GridTables,
    cells: Cells,
    onward: Callable[[Int32[Array, "n 4"]], Int32[Array, "n *ends 4"]],
    shape: tuple[int, ...],
) -> Int32[Array, "n *ends"]:
    """Least length of a path from each cell by way of one of its corners to one or more ends; far if it has none.

    ``onward`` gives the lengths of the rest of the way, from four corners of each cell.
    """
    first, count = _blocks_of(tables, cells)
    alike = (len(cells), *(1 for _ in shape[1:]))

    def with_block(block: Int[Array, ""], least: Int32[Array, "n *ends"]) -> Int32[Array, "n *ends"]:
        # Of a cell with fewer blocks its last one, again.
        corners = _gather(tables.blocks, first + jnp.minimum(block, jnp.maximum(count - 1, 0))).astype(jnp.int32)
        row, column = jnp.divmod(_gather(tables.places, corners), np.uint32(tables.shape[1]))
        rows, columns = (
            jnp.abs(row.astype(jnp.int32) - cells[:, :1]),
            jnp.abs(column.astype(jnp.int32) - cells[:, 1:]),
        )
        legs = open_length(tables.connectivity, rows, columns)
        return jnp.minimum(least, (legs.reshape(*alike, -1) + onward(corners)).min(axis=-1))

    far = jnp.full(shape, FAR, jnp.int32)
    return jnp.where(count.reshape(alike) > 0, lax.fori_loop(0, count.max(), with_block, far), far)


def _where_seen(tables: GridTables, p: Cells, q: Cells, around: Int32[Array, "n"]) -> Int32[Array, "n"]:
    """Length in units between cells that see each other, of others the way around corners."""
    open_way = open_length(tables.connectivity, *jnp.abs(p - q).T)
    return jnp.where(sees(tables.sight, p, q), open_way, around)


def _blocks_of(tables: GridTables, cells: Cells) -> tuple[Int32[Array, "n"], Int32[Array, "n"]]:
    """Where the blocks of each cell's corners begin, and how many there are."""
    cell = cells[:, 0] * tables.shape[1] + cells[:, 1]
    first, end = (
        _gather(tables.group_block, one // _GROUP) + _gather(tables.cell_block, one).astype(jnp.int32)
        for one in (cell, cell + 1)
    )
    return first, end - first


def _lengths_between(tables: GridTables, a: Int32[Array, "*#n"], b: Int32[Array, "*#n"]) -> Int32[Array, "*#n"]:
    """Distances in units between corners."""
    high, low = jnp.maximum(a, b), jnp.minimum(a, b)
    center, other = (_gather(tables.center, corner).astype(jnp.int32) for corner in (a, b))
    between = _gather(tables.between_centers, center * isqrt(len(tables.between_centers)) + other)
    return between + _gather(tables.differences, (high * (high + 1) >> 1) + low).astype(jnp.int32)


def _gather(table: Shaped[Array, "rows ..."], index: Int32[Array, "*n"]) -> Shaped[Array, "..."]:
    """Rows of a table, by indices that are known to be of it."""
    return table.at[index.astype(jnp.uint32)].get(mode="promise_in_bounds")


def _in_steps(tables: GridTables, length: Int32[Array, "n"], inside: Bool[Array, "n"]) -> Float[Array, "n"]:
    """Lengths of units in steps, never rounded up; ``inf`` if far, or not inside."""
    whole, rest = jnp.divmod(length, units(tables.connectivity))
    part = rest / units(tables.connectivity)
    whole = whole.astype(part.dtype)
    steps = jnp.where(rest == 0, whole, (whole + part) * (1 - _ROUNDING))
    return jnp.where(inside & (length < FAR), steps, jnp.inf)
