import numpy as np
import pytest
from grid_helpers import dijkstra, drawn, mosaic

from plr_jax.pairs.grid_corners import FAR, corner_distances
from plr_jax.pairs.grid_sectors import corner_cells

BLOCK = drawn(".....", ".....", "..#..", ".....", ".....")


def lengths(free, connectivity):
    """Distances of all corners, in units."""
    found = corner_distances(free, connectivity)
    corners = len(found.center)
    high, low = np.maximum.outer(np.arange(corners), np.arange(corners)), np.minimum.outer(*2 * [np.arange(corners)])
    between = found.between_centers[np.ix_(found.center, found.center)]
    return between + found.differences[high * (high + 1) // 2 + low]


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
    assert found.differences.dtype == (np.int8 if connectivity == 4 else np.int16)
    assert 2 <= len(found.between_centers) < len(found.center)
    assert lengths(long, connectivity).max() > (300 if connectivity == 4 else 300 * 985)


def test_paths_that_are_too_long_are_refused():
    long = np.pad(BLOCK, ((0, 0), (0, 2**20)), constant_values=True)
    long[2, 2**20] = False
    assert lengths(long, 4).max() > 2**20
    with pytest.raises(ValueError, match="are too long"):
        corner_distances(long, 8)
