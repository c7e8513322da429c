"""Windows of distances around agents on a grid, in JAX.

A window is a square of cells around an agent, and its rim is the cells on its border. First find the distances from
rim cells to the goal. If the distances of two rim cells differ by the number of steps between the cells along the
rim, distances in between change by one step from cell to cell. Otherwise the distance of the cell halfway is looked
up as well. Then spread distances from the rim into the window, by sweeps.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Int32, Num, Shaped

from plr_jax._compiled import part_by_part
from plr_jax.pairs.grid_corners import FAR, STRAIGHT, open_length
from plr_jax.pairs.grid_query import Cells, GridTables, cells_of, is_free, lengths_between_cells

_RIM_CELLS_AT_ONCE = 2**13  # rim cells whose distances are computed together
_AGENTS = 1024  # agents whose squares are computed together
# Agents are the last axis, so that processors vectorize over them.
_Square = Int32[Array, "width width n"]
_Free = Bool[Array, "width width n"]
_Rim = Int32[Array, "rim n"]
_RimFlags = Bool[Array, "rim n"]
_RimCells = Int32[Array, "rim n 2"]
_Row, _FreeRow = Int32[Array, "width n"], Bool[Array, "width n"]


@partial(jax.jit, static_argnames="radius")
def distances_around(
    tables: GridTables, goals: Num[Array, "n 2"], positions: Num[Array, "n 2"], radius: int
) -> Int32[Array, "n width width"]:
    """Return path lengths to each agent's goal from all cells of a square around the agent.

    Lengths are in steps, rounded down; -1 without a path. ``goals`` and ``positions`` of agents are points. The
    square has ``radius`` cells on each side of the agent's cell.
    """
    # 1. Find the cells of the squares: offsets (rows, columns), agents last.
    (goal, goal_inside), (position, inside) = (cells_of(tables.shape, points) for points in (goals, positions))
    offsets = jnp.asarray(np.indices((2 * radius + 1,) * 2) - radius, jnp.int32)
    row, column = (offset[..., None] + place for offset, place in zip(offsets, position.T, strict=True))
    on_grid = (row >= 0) & (row < tables.shape[0]) & (column >= 0) & (column < tables.shape[1])
    in_grid = jnp.stack([jnp.where(on_grid, along, 0).ravel() for along in (row, column)], axis=-1)
    free = on_grid & is_free(tables, in_grid).reshape(on_grid.shape)
    # 2. Number the rim of a square from cell to neighbor cell, starting at a corner. With radius r:
    #
    #       0     1 ...   2r       `rim` has the rows and columns of these cells in the square.
    #     8r-1           2r+1
    #      ...            ...
    #       6r    ...  4r+1  4r
    side, zero, far = np.arange(2 * radius), np.zeros(2 * radius, int), np.full(2 * radius, 2 * radius)
    rim = np.concatenate([zero, side, far, far - side]), np.concatenate([side, far, far - side, zero])
    if radius == 0:
        rim = np.zeros(1, int), np.zeros(1, int)
    # 3. Find lengths of the rim. Look up first the corners toward and away from the goal: lengths between them mostly
    #    follow. The two corners are 2r and 6r if row and column change in opposite directions towards the goal, else
    #    0 and 4r.
    corner = jnp.where((goal - position).prod(axis=1) < 0, 2 * radius, 0)  # of each agent; the other is 4r further
    is_first = np.arange(len(rim[0]))[:, None] % max(4 * radius, 1) == corner
    lengths = _lengths_of_rim(tables, jnp.stack([row[rim], column[rim]], axis=-1), free[rim], goal, is_first)
    # 4. Spread lengths from the rim and the goal into the square.
    initial = jnp.where((row == goal[:, 0]) & (column == goal[:, 1]), 0, FAR).astype(jnp.int32).at[rim].min(lengths)
    reached = _spread(tables.connectivity, jnp.where(free, initial, FAR), free)
    answered = free & inside & goal_inside & (reached < FAR)
    return jnp.moveaxis(jnp.where(answered, reached // STRAIGHT[tables.connectivity], -1), -1, 0)


def _lengths_of_rim(tables: GridTables, cells: _RimCells, free: _RimFlags, goal: Cells, is_first: _RimFlags) -> _Rim:
    """Return the path length from each rim cell of each agent's square to the agent's goal; FAR without a path.

    ``cells`` are the rows and columns of the rim cells, and ``free`` says which are free. Lengths are in the units of
    :func:`open_length`. Only some lengths are looked up in the tables, first those of cells where ``is_first`` and
    of free cells beside a blocked rim cell. In two cases, the lengths between two cells of known length follow
    without a look-up:

    - The known lengths differ by the number of steps between both cells, since lengths of neighbor cells differ by at
      most one step.
    - No path leads from either cell: then no path leads from the free cells between them.

    In other cases, the length of the cell in the middle is looked up.
    """
    straight = int(open_length(tables.connectivity, 0, 1))
    place = jnp.arange(len(cells), dtype=jnp.int32)

    def extreme_known(is_known: _RimFlags, extreme: Any, outside: Int32[Array, " n"], reverse: bool) -> _Rim:
        # The extreme of the known places so far. (On CPUs, `scan` is several times faster here than `cummax`.)
        places = jnp.where(is_known, place[:, None], outside)
        return lax.scan(lambda last, here: 2 * (extreme(last, here),), outside, places, reverse=reverse)[1]

    def look_up_round(state: tuple[_Rim, _RimFlags, _RimFlags]):
        lengths, is_known, is_wanted = state
        lengths, is_known = _with_wanted(tables, cells, goal, lengths, is_wanted), is_known | is_wanted
        # 1. Find the nearest known cells before and after each cell. The rim is a cycle, so the last known cell is
        #    also before the first cell, at a negative place, and the first known cell is after the last cell.
        begin, end = lax.argmax(is_known, 0, jnp.int32), len(cells) - 1 - lax.argmax(is_known[::-1], 0, jnp.int32)
        before = extreme_known(is_known, jnp.maximum, end - len(cells), reverse=False)
        after = extreme_known(is_known, jnp.minimum, begin + len(cells), reverse=True)
        first, last = (jnp.take_along_axis(lengths, known % len(cells), axis=0) for known in (before, after))
        # 2. Settle the cells between two known cells whose lengths differ by all steps between them, or from which no
        #    path leads: then no path leads from the free cells between, either. Both known cells are in one run of
        #    free cells, so it suffices to test the first.
        is_settled = (jnp.abs(last - first) == straight * (after - before)) | (first >= FAR)
        from_first = jnp.sign(last - first) * straight * (place[:, None] - before)
        new = free & ~is_known & is_settled
        # 3. Of other runs, look up the cell in the middle.
        is_wanted = free & ~is_known & ~new & ((before + after) // 2 % len(cells) == place[:, None])
        return jnp.where(new, jnp.where(first >= FAR, FAR, first + from_first), lengths), is_known | new, is_wanted

    # Free cells next to a blocked cell of the rim are looked up at once, so that both ends of each run of free cells
    # are known.
    is_wanted = free & (is_first | ~jnp.roll(free, 1, axis=0) | ~jnp.roll(free, -1, axis=0))
    none = jnp.full(free.shape, FAR, jnp.int32), jnp.zeros(free.shape, bool), is_wanted
    return lax.while_loop(lambda state: state[2].any(), look_up_round, none)[0]


def _with_wanted(tables: GridTables, cells: _RimCells, goal: Cells, lengths: _Rim, is_wanted: _RimFlags) -> _Rim:
    """Return ``lengths``, replaced by path lengths from the tables where ``is_wanted``.

    ``cells`` are the cells on the rim (the border) of each agent's window. Lengths are those of paths from these
    cells to the agent's ``goal``.
    """
    # 1. List the wanted cells agent by agent, and for each agent in the order of its rim. `count` is the number of
    #    wanted cells of each agent, `until` the number on its rim up to and with each cell, and `end` the number of
    #    this agent and those before. So `end - count + until - 1` wanted cells come before a cell in the list. Cells
    #    are numbered in the order of `is_wanted.ravel()`; the list is filled up with a number beyond all cells. On
    #    CPUs, `scan` is several times faster here than `cumsum`.
    size = min(_RIM_CELLS_AT_ONCE, is_wanted.size)
    all_cells = jnp.arange(is_wanted.size, dtype=jnp.int32).reshape(is_wanted.shape)
    none = jnp.zeros_like(lengths[0])
    count, until = lax.scan(lambda count, row: (count + row, count + row), none, is_wanted.astype(jnp.int32))
    end = jnp.cumsum(count)
    wanted = jnp.full(is_wanted.size + size, is_wanted.size, jnp.int32)
    wanted = wanted.at[jnp.where(is_wanted, end - count + until - 1, len(wanted))].set(all_cells, mode="drop")
    # 2. Look them up in batches.

    def with_batch(number_of_batch: Int32[Array, ""], lengths: Int32[Array, "cells"]) -> Int32[Array, "cells"]:
        batch = lax.dynamic_slice(wanted, (number_of_batch * size,), (size,))
        cell = jnp.minimum(batch, is_wanted.size - 1)
        start = goal[cell % len(goal)]
        # Padding asks for the distance of a cell to itself, which is quick.
        ends = start, jnp.where((batch < is_wanted.size)[:, None], cells.reshape(-1, 2)[cell], start)
        return lengths.at[batch].set(lengths_between_cells(tables, *ends), mode="drop")

    return lax.fori_loop(0, -(-end[-1] // size), with_batch, lengths.ravel()).reshape(lengths.shape)


def _spread(connectivity: int, lengths: _Square, free: _Free) -> _Square:
    """Extend path lengths from some cells of each square to all free cells of the square.

    ``lengths`` are FAR in cells whose length is not yet known, and ``free`` says which cells are free.
    """
    straight, diagonal = (int(open_length(connectivity, rows, 1)) for rows in (0, 1))
    turns = (-1, 1) if connectivity == 8 else ()

    def beside(row: Shaped[Array, "width n"], border: int, right: int) -> Shaped[Array, "width n"]:
        # For each cell, the value of the cell so many columns to its right; `border` beyond the square.
        return jnp.pad(row, ((1, 1), (0, 0)), constant_values=border)[1 + right : 1 + right + len(row)]

    # 1. Sweep over the rows.
    def swept(lengths: _Square, free: _Free, turns: tuple[int, ...], reverse: bool) -> _Square:
        # One pass over the rows: each row takes lengths from the row before it, straight and by `turns` diagonally.
        def next_row(last: tuple[_Row, _FreeRow], here: tuple[_Row, _FreeRow]) -> tuple[tuple[_Row, _FreeRow], _Row]:
            (last_row, last_free), (row, is_free) = last, here
            row = jnp.minimum(row, last_row + straight)
            # A diagonal step comes from the last row, `right` columns further right, if both cells beside are free:
            #
            #     last row    from  free
            #     row         free  to         with `right` = -1
            for right in turns:
                is_legal = last_free & beside(is_free, False, right)
                row = jnp.minimum(row, jnp.where(is_legal, beside(last_row, FAR, right) + diagonal, FAR))
            row = jnp.where(is_free, row, FAR)
            return (row, is_free), row

        border = jnp.full_like(lengths[0], FAR), jnp.zeros_like(free[0])
        return lax.scan(next_row, border, (lengths, free), reverse=reverse)[1]

    # 2. Sweep down, up, right and left until nothing changes. A sweep to the side sweeps down the transposed square;
    #    diagonal steps are taken in sweeps down and up.
    def spread(*by_agent: Shaped[Array, "n width width"]) -> Int32[Array, "n width width"]:
        lengths, free = (jnp.moveaxis(table, 0, -1) for table in by_agent)

        def four_sweeps(state: tuple[_Square, Bool[Array, ""]]) -> tuple[_Square, Bool[Array, ""]]:
            best = state[0]
            for free_here, turns_here in ((free, turns), (free.swapaxes(0, 1), ())):
                for reverse in (False, True):
                    best = swept(best, free_here, turns_here, reverse)
                best = best.swapaxes(0, 1)
            return best, (best < state[0]).any()

        reached, _ = lax.while_loop(lambda state: state[1], four_sweeps, (lengths, jnp.asarray(True)))
        return jnp.moveaxis(reached, -1, 0)

    # 3. Take as many agents at once as fit into caches.
    by_agent = (jnp.moveaxis(table, -1, 0) for table in (lengths, free))
    return jnp.moveaxis(part_by_part(spread, _AGENTS, *by_agent), 0, -1)
