"""Corners of grids: which see each other, which cells are taut at which corners, and distances between corners."""

import jax
import numpy as np
import pytest
from grid_helpers import dijkstra, drawn, mosaic

from plr_jax.pairs import grid_corners
from plr_jax.pairs.grid_corners import CornerLabels, CornerTable, corner_cells, corner_distances, corners_in_sight

BLOCK = drawn(".....", ".....", "..#..", ".....", ".....")


def corridor(columns):
    """Return a corridor with a block at each end."""
    free = np.pad(np.concatenate([BLOCK, BLOCK]), ((0, 0), (0, columns)), constant_values=True)
    free[2, columns] = False
    return free


def lengths(free, connectivity):
    """Return the distances of all corners, in units."""
    corners = np.arange(np.count_nonzero(corner_cells(free)), dtype=np.int32)
    return corner_distances(free, connectivity).between(corners[:, None], corners[None])


@pytest.fixture(params=[grid_corners.MOST_IN_TABLE, 0], ids=["table", "labels"])
def kept(request, monkeypatch):
    """Run a test with distances stored as for few corners, and as for many."""
    monkeypatch.setattr(grid_corners, "MOST_IN_TABLE", request.param)


@pytest.mark.usefixtures("kept")
@pytest.mark.parametrize("connectivity", [4, 8])
def test_corner_distances_equal_dijkstra(connectivity):
    free = mosaic(connectivity, 2, 12)
    found, places = lengths(free, connectivity), np.argwhere(corner_cells(free))
    step = 1 if connectivity == 4 else 985
    for row, place in zip(found, places.tolist(), strict=True):
        truth = dijkstra(free, tuple(place), connectivity)[tuple(places.T)]
        np.testing.assert_array_equal(row >= grid_corners.FAR, np.isinf(truth))
        np.testing.assert_allclose(row[np.isfinite(truth)] / step, truth[np.isfinite(truth)], rtol=1e-6)
    if connectivity == 8:
        corners = np.arange(len(places), dtype=np.int32)
        between = jax.jit(corner_distances(free, connectivity).between)
        np.testing.assert_array_equal(between(corners[:, None], corners[None]), found)


@pytest.mark.parametrize("connectivity", [4, 8])
def test_centers_are_near_and_differences_small(connectivity):
    long = corridor(300)
    found = corner_distances(long, connectivity)
    assert isinstance(found, CornerTable)
    assert found.differences.dtype == (np.int8 if connectivity == 4 else np.int16)
    assert 2 <= len(found.between_centers) < len(found.center)
    assert lengths(long, connectivity).max() > (300 if connectivity == 4 else 300 * 985)


# Paths of 65 steps, to which the grid's legs of 130 steps are added. Labels need room for sums of two lengths.
@pytest.mark.parametrize(("steps", "fits"), [(100, False), (180, False), (300, True)])
def test_too_long_paths_raise(kept, monkeypatch, steps, fits):
    monkeypatch.setattr(grid_corners, "FAR", steps * 985)
    if fits:
        assert lengths(corridor(60), 8).max() > 60 * 985
    else:
        with pytest.raises(ValueError, match="are too long"):
            corner_distances(corridor(60), 8)


def test_corners_of_a_spiral_have_few_ancestors(monkeypatch):
    monkeypatch.setattr(grid_corners, "MOST_IN_TABLE", 0)
    spiral = np.zeros((121, 121), bool)  # one cell wide, from the middle out
    row, column, length = 60, 60, 2
    for turn, (down, right) in zip(range(116), [(0, 1), (1, 0), (0, -1), (-1, 0)] * 29, strict=True):
        for _ in range(length):
            spiral[row, column] = True
            row, column = row + down, column + right
        length += 2 * (turn % 2)
    found = corner_distances(spiral, 4)
    assert isinstance(found, CornerLabels) and len(found.first) > 100
    assert len(found.ancestor) < 12 * len(found.first)


def test_too_large_tables_raise_before_they_are_made(kept, monkeypatch):
    free = np.random.default_rng(0).random((30, 30)) > 0.2
    for limit, most in (("_MOST_BYTES", 1000), ("_MOST_WORK", 100)):
        with monkeypatch.context() as patch, pytest.raises(ValueError, match="too many corners for tables"):
            patch.setattr(grid_corners, limit, most)
            corner_distances(free, 4)


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
