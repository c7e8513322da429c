"""Distances of all cells around agents to their goals, in JAX.

Whatever way leads out of a square of cells passes its rim. So only the cells of the rim are asked for, and from
these, and from the goal where it is inside, distances spread over the square step by step.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Int32, Num, Shaped

from plr_jax.pairs.grid_corners import FAR
from plr_jax.pairs.grid_query import GridTables, cells_of, lengths_between_cells
from plr_jax.pairs.grid_sectors import open_length, units
from plr_jax.pairs.grid_sight import is_free

Square = Int32[Array, "n width width"]

NO_WAY = -1
"""What stands for cells from which no path leads to the goal."""


@partial(jax.jit, static_argnames="radius")
def distances_around(
    tables: GridTables, goals: Num[Array, "n 2"], positions: Num[Array, "n 2"], radius: int
) -> Int32[Array, "n width width"]:
    """Whole steps from each cell of the squares around the cells of positions to those of goals."""
    (goal, goal_inside), (position, inside) = (cells_of(tables, points) for points in (goals, positions))
    offsets = jnp.asarray(np.moveaxis(np.indices((2 * radius + 1,) * 2) - radius, 0, -1), jnp.int32)
    cells = position[:, None, None] + offsets[None]
    on_grid = ((cells >= 0) & (cells < jnp.asarray(tables.shape, jnp.int32))).all(axis=-1)
    in_grid = jnp.where(on_grid[..., None], cells, 0).reshape(-1, 2)
    free = on_grid & is_free(tables.sight, in_grid).reshape(on_grid.shape)

    # The rim, as places of the flat square.
    rim = np.flatnonzero(abs(np.indices((2 * radius + 1,) * 2) - radius).max(axis=0).ravel() == radius)
    flat_cells, flat_free = cells.reshape(len(cells), -1, 2), free.reshape(len(cells), -1)
    of_rim = jnp.where(flat_free[:, rim, None], flat_cells[:, rim], position[:, None])
    lengths = lengths_between_cells(tables, of_rim.reshape(-1, 2), jnp.repeat(goal, len(rim), axis=0))
    known = jnp.where((flat_cells == goal[:, None]).all(axis=-1), 0, FAR).astype(jnp.int32)
    known = known.at[:, rim].min(lengths.reshape(len(cells), len(rim))).reshape(free.shape)
    reached = _spread(tables.connectivity, jnp.where(free, known, FAR), free)
    answered = free & (reached < FAR) & (inside & goal_inside)[:, None, None]
    return jnp.where(answered, reached // units(tables.connectivity), NO_WAY)


def _spread(connectivity: int, lengths: Square, free: Bool[Array, "n width width"]) -> Square:
    """Lengths over the squares from where they are known, at least ``FAR`` where no path leads to."""
    straight, diagonal = (int(open_length(connectivity, rows, 1)) for rows in (0, 1))
    width = lengths.shape[-1]

    def beside(
        table: Shaped[Array, "n width width"], down: int, right: int, border: int
    ) -> Shaped[Array, "n width width"]:
        around = jnp.pad(table, ((0, 0), (1, 1), (1, 1)), constant_values=border)
        return around[:, 1 + down : 1 + down + width, 1 + right : 1 + right + width]

    ways = [(down, right) for down in (-1, 0, 1) for right in (-1, 0, 1) if abs(down) + abs(right) == 1]
    turns = [(down, right) for down in (-1, 1) for right in (-1, 1)] if connectivity == 8 else []
    is_open = {
        (down, right): free & (beside(free, down, 0, False) & beside(free, 0, right, False)) for down, right in turns
    }

    def step(state: tuple[Square, Bool[Array, ""]]) -> tuple[Square, Bool[Array, ""]]:
        lengths, _ = state
        best = lengths
        for way in ways:
            best = jnp.minimum(best, beside(lengths, *way, FAR) + straight)
        for way in turns:
            best = jnp.minimum(best, jnp.where(is_open[way], beside(lengths, *way, FAR) + diagonal, FAR))
        best = jnp.where(free, best, FAR)
        return best, (best < lengths).any()

    return lax.while_loop(lambda state: state[1], step, (lengths, jnp.asarray(True)))[0]
