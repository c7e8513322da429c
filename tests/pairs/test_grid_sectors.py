import numpy as np
import pytest
from grid_helpers import drawn

from plr_jax.pairs.grid_sectors import FAR, corner_cells, corner_distances, seen_by_corners, taut_at_corners

BLOCK = drawn(".....", ".....", "..#..", ".....", ".....")


def lists(free, pairs):
    """Row and column of the corners of each cell."""
    corners = np.argwhere(corner_cells(free))
    found = {}
    for corner, cell in zip(*pairs, strict=True):
        found.setdefault(divmod(int(cell), free.shape[1]), []).append(tuple(corners[corner].tolist()))
    return {cell: sorted(of_cell) for cell, of_cell in found.items()}


def test_corners_of_one_block():
    assert np.argwhere(corner_cells(BLOCK)).tolist() == [[1, 1], [1, 3], [3, 1], [3, 3]]
    assert np.argwhere(corner_cells(drawn("..", ".#"))).tolist() == [[0, 0]]
    assert not corner_cells(drawn(".#", "#.")).any() and not corner_cells(drawn("...", "...")).any()
    found = lists(BLOCK, seen_by_corners(BLOCK, 4))  # those that see each other with none between
    assert found[1, 1] == [(1, 3), (3, 1)] and (1, 1) in found[0, 0] and (1, 3) not in found[0, 0]


@pytest.mark.parametrize("connectivity", [4, 8])
def test_the_corners_at_which_a_cell_is_taut(connectivity):
    found = lists(BLOCK, taut_at_corners(BLOCK, connectivity))
    # From above the block around its upper corners; straight above it, around both.
    assert found[0, 2] == [(1, 1), (1, 3)] and found[1, 2] == [(1, 1), (1, 3)]
    # From the corner of the grid a path passes no corner tautly but the two to the sides of the block.
    assert found[0, 0] == [(1, 3), (3, 1)]


def test_distances_of_corners_take_more_bits_if_they_are_long_and_are_far_if_no_path_joins_them():
    # In the order of the triangle: (0), (1 0), (2 0 1), (3 0 1 2).
    straight, octile = corner_distances(BLOCK, 4), corner_distances(BLOCK, 8)
    assert straight.dtype == np.uint16 and straight.tolist() == [0, 2, 0, 2, 4, 0, 4, 2, 2, 0]
    assert octile.tolist() == [985 * steps for steps in straight.tolist()]
    long = np.pad(BLOCK, ((0, 0), (0, 70)), constant_values=True)
    long[2, 70] = False
    octile = corner_distances(long, 8)
    assert corner_distances(long, 4).dtype == np.uint16 and octile.dtype == np.int32
    assert octile.max() == 985 * (71 - 1 - 2) + 2 * (1393 - 0)
    two = corner_distances(np.concatenate([BLOCK, np.zeros((1, 5), bool), BLOCK]), 4)
    assert (two[4 * 5 // 2 :][:4] == FAR[np.dtype(np.uint16)]).all()  # of the fifth corner to the first block's
