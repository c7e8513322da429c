import numpy as np
import pytest
from grid_helpers import drawn

from plr_jax._arrays import runs
from plr_jax.pairs.grid_corners import MOST_BYTES
from plr_jax.pairs.grid_corners import corner_cells, corners_in_sight, taut_corners

BLOCK = drawn(".....", ".....", "..#..", ".....", ".....")


def lists(free, connectivity):
    """Row and column of the taut corners of each cell."""
    places = np.argwhere(corner_cells(free))
    first, corners = taut_corners(free, connectivity, MOST_BYTES)
    cell, _ = runs(np.diff(first))
    found = {}
    for one, corner in zip(cell.tolist(), corners, strict=True):
        found.setdefault(divmod(one, free.shape[1]), []).append(tuple(places[corner].tolist()))
    return found


@pytest.mark.parametrize("connectivity", [4, 8])
def test_corners_of_one_block(connectivity):
    assert np.argwhere(corner_cells(BLOCK)).tolist() == [[1, 1], [1, 3], [3, 1], [3, 3]]
    assert np.argwhere(corner_cells(drawn("..", ".#"))).tolist() == [[0, 0]]
    assert not corner_cells(drawn(".#", "#.")).any() and not corner_cells(drawn("...", "...")).any()
    # Those that see each other with none between.
    assert np.transpose(corners_in_sight(BLOCK, connectivity)).tolist() == [[0, 1], [0, 2], [1, 3], [2, 3]]
    # A corner of one wall hides those of walls behind it in the same row.
    row = drawn("..#.#..", ".......")
    assert np.argwhere(corner_cells(row)).tolist() == [[1, 1], [1, 3], [1, 5]]
    assert np.transpose(corners_in_sight(row, connectivity)).tolist() == [[0, 1], [1, 2]]


@pytest.mark.parametrize("connectivity", [4, 8])
def test_the_corners_at_which_a_cell_is_taut(connectivity):
    found = lists(BLOCK, connectivity)
    # From above the block around its upper corners; straight above it, around both.
    assert found[0, 2] == [(1, 1), (1, 3)] and found[1, 2] == [(1, 1), (1, 3)]
    # From the corner of the grid a path passes no corner tautly but the two to the sides of the block.
    assert found[0, 0] == [(1, 3), (3, 1)]
