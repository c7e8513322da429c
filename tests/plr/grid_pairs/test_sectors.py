import numpy as np
import pytest
from grid_helpers import drawn

from plr_jax.pairs.grid_sectors import FAR, corner_cells, corner_distances, seen_by_corners, taut_at_corners

BLOCK = drawn(
    ".....",
    ".....",
    "..#..",
    ".....",
    ".....",
)


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


@pytest.mark.parametrize("connectivity", [4, 8])
def test_the_corners_at_which_a_cell_is_taut(connectivity):
    found = lists(BLOCK, taut_at_corners(BLOCK, connectivity))
    # From above the block around its upper corners; straight above it, around both.
    assert found[0, 2] == [(1, 1), (1, 3)] and found[1, 2] == [(1, 1), (1, 3)]
    # From the corner of the grid a path passes no corner tautly but the two to the sides of the block.
    assert (1, 1) not in found.get((0, 0), []) and found[0, 0] == [(1, 3), (3, 1)]


def test_corners_that_see_each_other_with_none_between():
    found = lists(BLOCK, seen_by_corners(BLOCK, 4))
    assert found[1, 1] == [(1, 3), (3, 1)] and (1, 1) in found[0, 0] and (1, 3) not in found[0, 0]


def test_distances_of_corners():
    # In the order of the triangle: (0), (1 0), (2 0 1), (3 0 1 2).
    straight = corner_distances(BLOCK, 4)
    assert straight.dtype == np.uint16 and straight.tolist() == [0, 2, 0, 2, 4, 0, 4, 2, 2, 0]
    octile = corner_distances(BLOCK, 8)
    assert octile.tolist() == [985 * steps for steps in straight.tolist()]


def test_long_distances_take_more_bits():
    long = np.pad(BLOCK, ((0, 0), (0, 70)), constant_values=True)
    long[2, 70] = False
    assert corner_distances(long, 4).dtype == np.uint16
    octile = corner_distances(long, 8)
    assert octile.dtype == np.int32 and octile.max() == 985 * (71 - 1 - 2) + 2 * (1393 - 0)


def test_corners_that_no_path_joins_are_far():
    two = np.concatenate([BLOCK, np.zeros((1, 5), bool), BLOCK])
    distances = corner_distances(two, 4)
    row = distances[4 * 5 // 2 :][:4]  # of the fifth corner to those of the first block
    assert (row == FAR[np.dtype(np.uint16)]).all()
