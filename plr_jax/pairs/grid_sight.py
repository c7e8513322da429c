"""Whether cells of a grid see each other: illegal steps between them, counted by at most four lookups.

Between cells of an 8-connected grid that are not in one row or column, diagonal steps tell: if they are all legal, so
are the straight ones. They start in a parallelogram, which is a rectangle in the coordinates ``(row, column - row)``,
so that sums over rows and slanted columns count them as a summed-area table counts what is in a rectangle.

Of what is illegal only that counts which is beside something free: between cells of which one is free there is some
of that if there is any, as rectangles are connected. So sums are small.

References:
    Crow, "Summed-area tables for texture mapping", SIGGRAPH 1984.
"""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int, Integer, Shaped, UInt32

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
    return IllegalSteps(jnp.asarray(narrow(flat)), jnp.asarray(bits_of(free)), free.shape, connectivity)


def bits_of(free: Bool[np.ndarray, "rows columns"]) -> UInt32[np.ndarray, "words"]:
    """Bits of the cells in row-major order, the lowest of a word first."""
    return np.packbits(np.pad(free.ravel(), (0, -free.size % 32)), bitorder="little").view("<u4")


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


def narrow(numbers: Int[np.ndarray, "n"]) -> Integer[np.ndarray, "n"]:
    """The same in as few bytes each as do."""
    return numbers.astype(np.min_scalar_type(numbers.max(initial=0)))


def looked_up(table: Shaped[Array, "rows ..."], index: Int[Array, "*n"]) -> Shaped[Array, "..."]:
    """Rows of a table, by indices that are known to be of it."""
    return table.at[index.astype(jnp.uint32)].get(mode="promise_in_bounds")
