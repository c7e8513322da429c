"""What a query of pairs reads: all derived from the cells of a grid."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int, Int32, Integer, UInt32

from plr_jax._arrays import runs
from plr_jax.plr.grid_pairs.corner_distances import corner_distances
from plr_jax.plr.grid_pairs.sectors import corner_cells, taut_at_corners
from plr_jax.plr.grid_pairs.sight import IllegalSteps, sight_of

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
