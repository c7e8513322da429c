"""Distances of pairs, in JAX: the open length if the cells see each other, else the least sum over their corners.

Cells have from none to dozens of corners, and a pair takes the product of two such numbers. So pairs are sorted by
how many blocks of corners their cells have, and taken in chunks of pairs of about as many.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int, Int32, Num, Shaped

from plr_jax.plr.grid_pairs.corner_distances import FAR
from plr_jax.plr.grid_pairs.lengths import open_length, units
from plr_jax.plr.grid_pairs.sight import Cells, sees
from plr_jax.plr.grid_pairs.tables import GridTables

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
    return _least_around(tables, cells, lambda corners: _between(tables, every[:, None], corners), every.shape)


def _cells_of(tables: GridTables, x: Num[Array, "n 2"]) -> tuple[Cells, Bool[Array, "n"]]:
    """Row and column of the cell of each point, or of some cell, and whether the point is in one."""
    place = jnp.floor(x)[:, ::-1]
    inside = ((place >= 0) & (place < jnp.asarray(tables.shape))).all(axis=1)
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
            return _between(tables, corners[:, :, None], others[:, None])

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


def _between(tables: GridTables, a: Int32[Array, "*#n"], b: Int32[Array, "*#n"]) -> Int32[Array, "*#n"]:
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
    steps = whole + rest / units(tables.connectivity)
    steps = jnp.where(rest == 0, whole.astype(steps.dtype), steps * (1 - _ROUNDING))
    return jnp.where(inside & (length < _far(tables)), steps, jnp.inf)
