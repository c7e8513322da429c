"""Distances of all cells around agents to their goals, in JAX.

Whatever way leads out of a square of cells passes its rim. So from the rim, and from the goal where it is inside,
distances spread over the square step by step. And along the rim distances change by no more than a step from cell to
cell: where they differ by as much as can be between two cells, those between need not be asked for.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Int, Int32, Num, Shaped

from plr_jax.pairs.grid_corners import FAR
from plr_jax.pairs.grid_query import GridTables, cells_of, lengths_between_cells
from plr_jax.pairs.grid_sectors import open_length, units
from plr_jax.pairs.grid_sight import Cells, is_free

NO_WAY = -1
"""What stands for cells from which no path leads to the goal."""

_AT_ONCE = 2**13  # cells asked for at once
_AGENTS = 1024  # whose squares are looked at at once

# Agents are the last axis, along which processors work on many numbers at once.
Square, Marks = Int32[Array, "width width n"], Bool[Array, "width width n"]
Rim = Int32[Array, "rim n"]
_Row, _FreeRow = Int32[Array, "width n"], Bool[Array, "width n"]
_Known = tuple[Int32[Array, "n"], Int32[Array, "n"]]


@partial(jax.jit, static_argnames="radius")
def distances_around(
    tables: GridTables, goals: Num[Array, "n 2"], positions: Num[Array, "n 2"], radius: int
) -> Int32[Array, "n width width"]:
    """Whole steps from each cell of the squares around the cells of positions to those of goals."""
    (goal, goal_inside), (position, inside) = (cells_of(tables.shape, points) for points in (goals, positions))
    row, column, on_grid = squares_around(tables.shape, position, radius)
    in_grid = jnp.stack([jnp.where(on_grid, one, 0).ravel() for one in (row, column)], axis=-1)
    free = on_grid & is_free(tables.sight, in_grid).reshape(on_grid.shape)

    around = _around(radius)
    cells = jnp.stack([row[around], column[around]], axis=-1)
    # The corners toward the goal and away from it: mostly what is between them is so far that it needs no asking.
    turned = ((goal - position).prod(axis=1) < 0).astype(jnp.int32)
    asked_first = np.arange(len(around[0]))[:, None] % max(4 * radius, 1) == 2 * radius * turned
    lengths = _lengths_of_rim(tables, cells, free[around], goal, asked_first)
    is_goal = (row == goal[:, 0]) & (column == goal[:, 1])
    known = jnp.where(is_goal, 0, FAR).astype(jnp.int32).at[around].min(lengths)
    reached = _spread_in_parts(tables.connectivity, jnp.where(free, known, FAR), free)
    return whole_steps(tables.connectivity, reached, free & inside & goal_inside)


def squares_around(shape: tuple[int, int], position: Cells, radius: int) -> tuple[Square, Square, Marks]:
    """Rows and columns of the cells around positions, and which are cells of the grid."""
    offsets = jnp.asarray(np.indices((2 * radius + 1,) * 2) - radius, jnp.int32)
    row, column = (offset[..., None] + place for offset, place in zip(offsets, position.T, strict=True))
    return row, column, (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])


def whole_steps(connectivity: int, lengths: Square, answered: Marks) -> Int32[Array, "n width width"]:
    """Lengths of units in whole steps, agent by agent; -1 where they are far, or not answered."""
    steps = jnp.where(answered & (lengths < FAR), lengths // units(connectivity), NO_WAY)
    return jnp.moveaxis(steps, -1, 0)


def _around(radius: int) -> tuple[Int[np.ndarray, "rim"], Int[np.ndarray, "rim"]]:
    """Rows and columns of the rim of a square, from cell to neighboring cell, beginning with a corner."""
    side, last = np.arange(2 * radius), 2 * radius
    zero, far = np.zeros(2 * radius, int), np.full(2 * radius, last)
    if radius == 0:
        return np.zeros(1, int), np.zeros(1, int)
    return np.concatenate([zero, side, far, last - side]), np.concatenate([side, far, last - side, zero])


def _lengths_of_rim(
    tables: GridTables,
    cells: Int32[Array, "rim n 2"],
    free: Bool[Array, "rim n"],
    goal: Int32[Array, "n 2"],
    asked_first: Bool[Array, "rim n"],
) -> Rim:
    """Lengths from the cells of rims to goals in units, at least ``FAR`` where there is no path."""
    straight = int(open_length(tables.connectivity, 0, 1))
    beside_blocked = ~jnp.roll(free, 1, axis=0) | ~jnp.roll(free, -1, axis=0)
    place = jnp.arange(len(cells), dtype=jnp.int32)

    def nearest_known(lengths: Rim, known: Bool[Array, "rim n"], first: _Known, reverse: bool) -> tuple[Rim, Rim]:
        """Place and length of the last known cell until each, or of the first from each on."""

        def step(nearest: _Known, cell: tuple[Int32[Array, ""], Int32[Array, "n"], Bool[Array, "n"]]):
            place, length, is_known = cell
            nearest = jnp.where(is_known, place, nearest[0]), jnp.where(is_known, length, nearest[1])
            return nearest, nearest

        return lax.scan(step, first, (place, lengths, known), reverse=reverse)[1]

    def step(state: tuple[Rim, Bool[Array, "rim n"], Bool[Array, "rim n"]]):
        lengths, known, wanted = state
        lengths, known = _asked(tables, cells, goal, lengths, wanted), known | wanted
        # What is free is known at both ends of each row of free cells; the rim ends where it begins.
        begin, end = lax.argmax(known, 0, jnp.int32), len(cells) - 1 - lax.argmax(known[::-1], 0, jnp.int32)
        at_begin, at_end = (jnp.take_along_axis(lengths, one[None], axis=0)[0] for one in (begin, end))
        before, first = nearest_known(lengths, known, (end - len(cells), at_end), reverse=False)
        after, last = nearest_known(lengths, known, (begin + len(cells), at_begin), reverse=True)
        is_settled = (jnp.abs(last - first) == straight * (after - before)) | (first >= FAR)
        from_first = jnp.sign(last - first) * straight * (place[:, None] - before)
        new = free & ~known & is_settled
        wanted = free & ~known & ~new & ((before + after) // 2 % len(cells) == place[:, None])
        return jnp.where(new, jnp.where(first >= FAR, FAR, first + from_first), lengths), known | new, wanted

    start = free & (asked_first | beside_blocked)
    none = jnp.full(free.shape, FAR, jnp.int32), jnp.zeros(free.shape, bool), start
    return lax.while_loop(lambda state: state[2].any(), step, none)[0]


def _asked(
    tables: GridTables,
    cells: Int32[Array, "rim n 2"],
    goal: Int32[Array, "n 2"],
    lengths: Rim,
    wanted: Bool[Array, "rim n"],
) -> Rim:
    """The lengths, and those of the wanted cells."""
    size = min(_AT_ONCE, wanted.size)
    every = jnp.arange(wanted.size, dtype=jnp.int32).reshape(wanted.shape)
    none = jnp.zeros_like(lengths[0])
    count, until = lax.scan(lambda count, row: (count + row, count + row), none, wanted.astype(jnp.int32))
    end = jnp.cumsum(count)
    number = jnp.full(wanted.size + size, wanted.size, jnp.int32)  # agent by agent
    number = number.at[jnp.where(wanted, end - count + until - 1, len(number))].set(every, mode="drop")
    flat = cells.reshape(-1, 2)

    def with_some(some: Int32[Array, ""], lengths: Int32[Array, "cells"]) -> Int32[Array, "cells"]:
        asked = lax.dynamic_slice(number, (some * size,), (size,))
        of = jnp.minimum(asked, wanted.size - 1)
        start = goal[of % len(goal)]
        # Behind the last are cells that see themselves, which takes next to no time.
        ends = start, jnp.where((asked < wanted.size)[:, None], flat[of], start)
        found = lengths_between_cells(tables, *ends)
        return lengths.at[asked].set(found, mode="drop")

    return lax.fori_loop(0, -(-end[-1] // size), with_some, lengths.ravel()).reshape(lengths.shape)


def _spread_in_parts(connectivity: int, lengths: Square, free: Bool[Array, "width width n"]) -> Square:
    """As :func:`_spread`, of as many agents at once as caches hold."""
    agents = lengths.shape[-1]
    size = min(_AGENTS, max(agents, 1))

    def parts(table: Shaped[Array, "width width n"], fill: int) -> Shaped[Array, "parts width width size"]:
        filled = jnp.pad(table, ((0, 0), (0, 0), (0, -agents % size)), constant_values=fill)
        return jnp.moveaxis(filled.reshape(*table.shape[:2], -1, size), 2, 0)

    done = lax.map(lambda part: _spread(connectivity, *part), (parts(lengths, FAR), parts(free, False)))
    return jnp.moveaxis(done, 0, 2).reshape(*lengths.shape[:2], -1)[..., :agents]


def _spread(connectivity: int, lengths: Square, free: Bool[Array, "width width n"]) -> Square:
    """Lengths over the squares from where they are known, at least ``FAR`` where no path leads to."""
    straight, diagonal = (int(open_length(connectivity, rows, 1)) for rows in (0, 1))
    turns = (-1, 1) if connectivity == 8 else ()

    def beside(row: Shaped[Array, "width n"], border: int, right: int) -> Shaped[Array, "width n"]:
        return jnp.pad(row, ((1, 1), (0, 0)), constant_values=border)[1 + right : 1 + right + len(row)]

    def swept(lengths: Square, free: Bool[Array, "width width n"], turns: tuple[int, ...], reverse: bool) -> Square:
        """Lengths with those that steps from row to row lead to."""

        def step(last: tuple[_Row, _FreeRow], here: tuple[_Row, _FreeRow]) -> tuple[tuple[_Row, _FreeRow], _Row]:
            (last_row, last_free), (row, is_free) = last, here
            row = jnp.minimum(row, last_row + straight)
            for right in turns:
                is_legal = last_free & beside(is_free, False, right)
                row = jnp.minimum(row, jnp.where(is_legal, beside(last_row, FAR, right) + diagonal, FAR))
            row = jnp.where(is_free, row, FAR)
            return (row, is_free), row

        border = jnp.full_like(lengths[0], FAR), jnp.zeros_like(free[0])
        return lax.scan(step, border, (lengths, free), reverse=reverse)[1]

    across = free.swapaxes(0, 1)

    def step(state: tuple[Square, Bool[Array, ""]]) -> tuple[Square, Bool[Array, ""]]:
        best = state[0]
        for reverse in (False, True):
            best = swept(best, free, turns, reverse)
        best = best.swapaxes(0, 1)
        for reverse in (False, True):
            best = swept(best, across, (), reverse)
        best = best.swapaxes(0, 1)
        return best, (best < state[0]).any()

    return lax.while_loop(lambda state: state[1], step, (lengths, jnp.asarray(True)))[0]
