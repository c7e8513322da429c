"""Distances of pairs of cells, in JAX: the open length if they see each other, else the least sum over corners.

Cells have from none to dozens of corners, and a pair takes the product of two such numbers. So pairs are sorted by
how many blocks of corners their cells have, and taken in chunks of pairs of about as many.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int, Int32, Integer, Num, Shaped, UInt32

from plr_jax._arrays import runs
from plr_jax.pairs.grid_sectors import FAR, corner_cells, corner_distances, open_length, taut_at_corners, units

# Whether cells see each other: illegal steps between them, counted by at most four lookups.
#
# Between cells of an 8-connected grid that are not in one row or column, diagonal steps tell: if they are all legal,
# so are the straight ones. They start in a parallelogram, which is a rectangle in the coordinates ``(row, column -
# row)``, so that sums over rows and slanted columns count them as a summed-area table counts what is in a rectangle.
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
            mirrored, and blocked cells before each in its row; then these three of the transposed grid.
        shape: Rows and columns of the grid.
        connectivity: 4 or 8.
    """

    sums: Integer[Array, "sums"]
    shape: tuple[int, int] = field(metadata={"static": True})
    connectivity: int = field(metadata={"static": True})


def sight_of(free: Bool[np.ndarray, "rows columns"], connectivity: int) -> IllegalSteps:
    """The sums of a grid."""
    if connectivity == 4:
        sums = [_with_margin(~free).cumsum(axis=0).cumsum(axis=1)]
    else:
        sums = [
            table
            for grid in (free, free.T)
            for table in (_slanted_sums(grid), _slanted_sums(grid[:, ::-1]), _with_margin(~grid).cumsum(axis=1))
        ]
    flat = np.concatenate([table.ravel() for table in sums])
    return IllegalSteps(jnp.asarray(flat.astype(np.min_scalar_type(flat.max()))), free.shape, connectivity)


def sees(sight: IllegalSteps, p: Cells, q: Cells) -> Bool[Array, "n"]:
    """Whether cells of the grid see each other; blocked ones see none."""
    return _count_in_rectangles(sight, p, q) == 0 if sight.connectivity == 4 else _count_in_sectors(sight, p, q) == 0


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
    legal = free[1:, 1:] & free[:-1, :-1] & free[1:, :-1] & free[:-1, 1:]
    sums = _with_margin(np.pad(~legal, ((1, 0), (1, 0)))).cumsum(axis=1)
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
        first_block: Where the blocks of each cell begin, in row-major order, and their number.
        blocks: Numbers of corners; the last of a cell is repeated to fill its last block.
        places: Cell of each corner, in row-major order.
        between: Distances in units of each corner to those before it and to itself, ``FAR`` if there is none.
    """

    sight: IllegalSteps
    first_block: Int32[Array, "cells_plus_one"]
    blocks: Integer[Array, "blocks 4"]
    places: UInt32[Array, "corners"]
    between: Integer[Array, "pairs"]

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
    corner, cell = taut_at_corners(free, connectivity)
    order = np.lexsort((corner, cell))
    first_block, blocks = _in_blocks(corner[order], np.bincount(cell, minlength=free.size))
    places = np.flatnonzero(corner_cells(free))
    between = corner_distances(free, connectivity)
    # What is empty is read as well, though what is read is not used.
    blocks, places, between = (
        table if len(table) else np.zeros((1, *table.shape[1:]), table.dtype) for table in (blocks, places, between)
    )
    return GridTables(
        sight=sight_of(free, connectivity),
        first_block=jnp.asarray(first_block, jnp.int32),
        blocks=jnp.asarray(blocks, np.min_scalar_type(blocks.max())),
        places=jnp.asarray(places, jnp.uint32),
        between=jnp.asarray(between),
    )


def _in_blocks(
    corners: Int[np.ndarray, "pairs"], counts: Int[np.ndarray, "cells"]
) -> tuple[Int[np.ndarray, "cells_plus_one"], Int[np.ndarray, "blocks 4"]]:
    """Where the blocks of each cell begin, and the blocks, of corners that stand cell by cell."""
    num_blocks = -(-counts // BLOCK)
    first = np.cumsum(counts) - counts
    cell, block = runs(num_blocks)
    place = np.minimum(BLOCK * block[:, None] + np.arange(BLOCK), counts[cell, None] - 1)
    return np.concatenate([[0], np.cumsum(num_blocks)]), corners[first[cell, None] + place]


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

    far = jnp.full(shape, _far(tables), jnp.int32)
    return jnp.where(count.reshape(alike) > 0, lax.fori_loop(0, count.max(), with_block, far), far)


def _where_seen(tables: GridTables, p: Cells, q: Cells, around: Int32[Array, "n"]) -> Int32[Array, "n"]:
    """Length in units between cells that see each other, of others the way around corners."""
    open_way = open_length(tables.connectivity, *jnp.abs(p - q).T)
    return jnp.where(sees(tables.sight, p, q), open_way, around)


def _blocks_of(tables: GridTables, cells: Cells) -> tuple[Int32[Array, "n"], Int32[Array, "n"]]:
    """Where the blocks of each cell's corners begin, and how many there are."""
    cell = cells[:, 0] * tables.shape[1] + cells[:, 1]
    first = tables.first_block[cell]
    return first, tables.first_block[cell + 1] - first


def _lengths_between(tables: GridTables, a: Int32[Array, "*#n"], b: Int32[Array, "*#n"]) -> Int32[Array, "*#n"]:
    """Distances in units between corners."""
    high, low = jnp.maximum(a, b), jnp.minimum(a, b)
    return _gather(tables.between, (high * (high + 1) >> 1) + low).astype(jnp.int32)


def _gather(table: Shaped[Array, "rows ..."], index: Int32[Array, "*n"]) -> Shaped[Array, "..."]:
    """Rows of a table, by indices that are known to be of it."""
    return table.at[index.astype(jnp.uint32)].get(mode="promise_in_bounds")


def _far(tables: GridTables) -> int:
    """What is no path, or more."""
    return FAR[np.dtype(tables.between.dtype)]


def _in_steps(tables: GridTables, length: Int32[Array, "n"], inside: Bool[Array, "n"]) -> Float[Array, "n"]:
    """Lengths of units in steps, never rounded up; ``inf`` if far, or not inside."""
    whole, rest = jnp.divmod(length, units(tables.connectivity))
    part = rest / units(tables.connectivity)
    whole = whole.astype(part.dtype)
    steps = jnp.where(rest == 0, whole, (whole + part) * (1 - _ROUNDING))
    return jnp.where(inside & (length < _far(tables)), steps, jnp.inf)
