"""Corners of grids: which see each other, which cells are taut at which corners, and distances between corners."""

import jax.numpy as jnp
import numpy as np
import pytest
from grid_helpers import dijkstra, drawn, mosaic

from plr_jax.pairs import grid_corners
from plr_jax.pairs.grid_corners import (
    FAR,
    CornerLabels,
    CornerTable,
    corner_cells,
    corner_distances,
    corners_in_sight,
)


def lengths(free, connectivity):
    """Distances of all corners, in units."""
    corners = np.arange(np.count_nonzero(corner_cells(free)), dtype=np.int32)
    found = corner_distances(free, connectivity)
    return np.asarray(found.between(jnp.asarray(corners)[:, None], jnp.asarray(corners)[None]))


@pytest.fixture(params=[grid_corners.MOST_IN_TABLE, 0], ids=["table", "labels"])
def kept(request, monkeypatch):
    """Distances as they are kept of few corners, and of many."""
    monkeypatch.setattr(grid_corners, "MOST_IN_TABLE", request.param)


@pytest.mark.usefixtures("kept")
@pytest.mark.parametrize("connectivity", [4, 8])
def test_distances_of_corners_are_those_of_a_search(connectivity):
    free = mosaic(connectivity, 2, 12)
    found, places = lengths(free, connectivity), np.argwhere(corner_cells(free))
    step = 1 if connectivity == 4 else 985
    for row, place in zip(found, places.tolist(), strict=True):
        truth = dijkstra(free, tuple(place), connectivity)[tuple(places.T)]
        np.testing.assert_array_equal(row >= FAR, np.isinf(truth))
        np.testing.assert_allclose(row[row < FAR] / step, truth[row < FAR], rtol=1e-6)


@pytest.mark.parametrize("connectivity", [4, 8])
def test_centers_are_near_and_differences_small(connectivity):
    long = np.pad(np.concatenate([BLOCK, BLOCK]), ((0, 0), (0, 300)), constant_values=True)
    long[2, 300] = False
    found = corner_distances(long, connectivity)
    assert isinstance(found, CornerTable)
    assert found.differences.dtype == (np.int8 if connectivity == 4 else np.int16)
    assert 2 <= len(found.between_centers) < len(found.center)
    assert lengths(long, connectivity).max() > (300 if connectivity == 4 else 300 * 985)


@pytest.mark.usefixtures("kept")
def test_paths_that_are_too_long_are_refused():
    long = np.pad(BLOCK, ((0, 0), (0, 2**20)), constant_values=True)
    long[2, 2**20] = False
    assert lengths(long, 4).max() > 2**20
    for free in (long, np.ones((1, 2**20), bool)):
        with pytest.raises(ValueError, match="are too long"):
            corner_distances(free, 8)


def test_a_corner_of_a_long_corridor_has_few_ancestors(monkeypatch):
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


def test_tables_that_take_too_much_are_refused_before_they_are_made(kept, monkeypatch):
    free = np.random.default_rng(0).random((30, 30)) > 0.2
    for limit, most in (("_MOST_BYTES", 1000), ("_MOST_WORK", 100)):
        with monkeypatch.context() as patch, pytest.raises(ValueError, match="too many corners for tables"):
            patch.setattr(grid_corners, limit, most)
            corner_distances(free, 4)


BLOCK = drawn(".....", ".....", "..#..", ".....", ".....")


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
