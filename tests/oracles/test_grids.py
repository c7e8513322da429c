import itertools

import networkx as nx
import numpy as np
import pytest
from grid_helpers import all_pairs, drawn, published_queries
from grid_helpers import dijkstra as dijkstra_of_grid
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage
from scipy.interpolate import RegularGridInterpolator
from voxel_helpers import random_volume

from plr_jax import Box, GridField, GridGraph, VoxelGraph, scenes
from plr_jax._types import DimensionedFn

DOOR = drawn("..#..", ".....", "..#..")


def at(oracle, *points):
    return oracle(np.array(points, float)).tolist()


def test_all_points_of_a_cell_have_its_distance():
    graph = GridGraph(DOOR, (0.7, 0.2))
    assert at(graph, (0, 0), (1, 0), (4, 0), (4, 2), (0, 2)) == [0, 1, 6, 6, 2]
    assert at(graph, (0, 1), (0.999, 1.999), (4.5, 0.5)) == [1, 1, 6]
    assert graph.dim == 2 and isinstance(graph, DimensionedFn)


def test_diagonal_steps_do_not_cut_corners():
    assert at(GridGraph(DOOR, (1, 0), connectivity=8), (2, 1), (3, 0), (0, 1)) == [2, 4, pytest.approx(2**0.5)]
    assert at(GridGraph(drawn(".#", "#."), (0, 0), connectivity=8), (1, 1)) == [np.inf]


def test_squeezing_steps_join_cells_that_touch_in_a_corner():
    free = np.random.default_rng(0).random((30, 40)) > 0.6
    free[0, 0] = True
    label, _ = ndimage.label(free, np.ones((3, 3)))
    graph = GridGraph(free, (0, 0), connectivity=8, squeeze=True)
    cells = np.argwhere(np.ones_like(free))[:, ::-1]
    np.testing.assert_array_equal(np.isfinite(graph(cells)), label.ravel() == label[0, 0])
    passed = GridGraph(DOOR, (1, 0), connectivity=8, squeeze=True)
    assert at(passed, (2, 1), (3, 0)) == pytest.approx([2**0.5, 2 * 2**0.5])


def test_blocked_and_outside_points_are_unreachable():
    graph = GridGraph(drawn("..#."), (0, 0))
    outside = [(-1e-9, 0), (4, 0), (0, 1), (0, -0.1), (np.nan, 0), (0, np.nan), (np.inf, 0)]
    assert at(graph, (2, 0), (3, 0), *outside) == [np.inf] * 9
    assert graph(np.zeros((0, 2))).shape == (0,)


@pytest.mark.parametrize("connectivity", [4, 8])
def test_grid_distances_equal_textbook_dijkstra(connectivity):
    rng = np.random.default_rng(connectivity)
    for _ in range(10):
        free = rng.random(rng.integers(1, 9, 2)) > 0.3
        free[0, 0] = True
        expected = dijkstra_of_grid(free, (0, 0), connectivity)
        cells = np.argwhere(np.ones_like(free))[:, ::-1]
        found = GridGraph(free, (0, 0), connectivity=connectivity)(cells)
        np.testing.assert_allclose(found, expected.ravel(), rtol=1e-12)


def test_between_equals_oracles_of_each_goal():
    x, y = all_pairs(DOOR)
    order = np.random.default_rng(0).permutation(len(x))
    graph = GridGraph(DOOR, connectivity=8)
    found = graph.between(x[order], y[order])
    expected = [graph.with_goal(start)(end[None])[0] for start, end in zip(x[order], y[order], strict=True)]
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    assert graph.between([[2, 0], [9, 9], [0, 0]], [[2, 0], [0, 0], [np.nan, 0]]).tolist() == [np.inf] * 3
    assert graph.between(np.zeros((0, 2)), np.zeros((0, 2))).shape == (0,)


@pytest.mark.parametrize("name", ["dao/den312d", "da2/ht_store"])
def test_lengths_equal_published_octile_lengths(data_dir, name):
    starts, goals, lengths = published_queries(data_dir / f"movingai/{name}.map.scen")
    graph = GridGraph(scenes.read_cells(data_dir / f"movingai/{name}.map"), connectivity=8)
    np.testing.assert_allclose(graph.between(starts, goals), lengths, rtol=1e-5, atol=5e-3)


def test_cells_are_read_in_file_order(tmp_path):
    (tmp_path / "a.map").write_text("type octile\nheight 2\nwidth 3\nmap\n.@G\nST.\n")
    np.testing.assert_array_equal(scenes.read_cells(tmp_path / "a.map"), drawn(".#.", ".#."))


CUBE = np.ones((3, 3, 3), bool)


def voxel_edges(free, most, sides):
    """Yield pairs of free voxels joined by a step of up to ``most`` axes whose box is free, and the step's length."""
    for start in map(tuple, np.argwhere(free)):
        for step in itertools.product((-1, 0, 1), repeat=3):
            corners = {tuple(np.add(start, part)) for part in itertools.product(*[{0, s} for s in step])}
            inside = all(0 <= k < n for voxel in corners for k, n in zip(voxel, free.shape, strict=True))
            if 0 < np.count_nonzero(step) <= most and inside and all(free[voxel] for voxel in corners):
                yield start, tuple(np.add(start, step)), np.linalg.norm(np.multiply(step, sides))


@pytest.mark.parametrize(("moves", "most"), [(6, 1), (18, 2), (26, 3)])
def test_voxel_distances_equal_networkx(moves, most):
    rng = np.random.default_rng(moves)
    for sides in ((1, 1, 1), (1, 0.3, 2)):
        free = random_volume(rng, 3, 5, 0.3)
        graph = VoxelGraph(free, (0, 0, 0), moves, Box((0, 0, 0), np.array(free.shape) * sides))
        plain = nx.Graph([((0, 0, 0), (0, 0, 0))])
        plain.add_weighted_edges_from(voxel_edges(free, most, sides))
        distance = nx.single_source_dijkstra_path_length(plain, (0, 0, 0))
        expected = [distance.get(voxel, np.inf) for voxel in np.ndindex(free.shape)]
        np.testing.assert_allclose(graph((np.argwhere(np.ones_like(free)) + 0.5) * sides), expected, rtol=1e-12)


def test_all_points_of_a_voxel_have_its_distance():
    free = CUBE.copy()
    free[1, 1] = False
    graph = VoxelGraph(free, (0.2, 0.9, 0.5), 6)
    assert graph([[2, 0, 0], [2.9, 0.5, 0.999], [3, 3, 3], [0, 1, 0]]).tolist() == [2, 2, 6, 1]
    assert graph([[1.5, 1.5, 1], [-0.1, 0, 0], [3.1, 0, 0], [np.nan, 0, 0], [np.inf, 0, 0]]).tolist() == [np.inf] * 5
    assert graph(np.zeros((0, 3))).shape == (0,)
    assert graph.dim == 3 and isinstance(graph, DimensionedFn)
    other = graph.with_goal((2.5, 0.5, 0.5))
    assert other([[0, 0, 0]]) == [2] and other.goal.tolist() == [2.5, 0.5, 0.5] and graph([[0, 0, 0]]) == [0]


def test_diagonal_steps_need_free_voxels_around_them():
    free = np.ones((2, 2, 2), bool)
    assert VoxelGraph(free, (0, 0, 0))([[1, 1, 1]]) == pytest.approx(3**0.5)
    free[1, 0, 1] = False
    assert VoxelGraph(free, (0, 0, 0))([[1, 1, 1]]) == pytest.approx(1 + 2**0.5)
    parted = np.zeros((2, 2, 2), bool)
    parted[0, 0, 0] = parted[1, 1, 1] = True
    assert VoxelGraph(parted, (0, 0, 0))([[1, 1, 1]]) == [np.inf]


WIDE = Box((0, 0), (3, 2))
ROWS = np.array([[0.0, 1, 2], [10, 11, 12]])
"""Two rows, y = 0.5 and 1.5, of three columns, x = 0.5, 1.5 and 2.5."""


def test_field_is_linear_between_centers_and_constant_beyond():
    field = GridField(ROWS, ((0, 0), (3, 2)))
    assert at(field, (0, 0), (3, 2), (0, 1.5), (1, 0), (3, 1)) == [0, 12, 10, 0.5, 7]
    assert at(GridField([[7.0]], WIDE), (0, 0), (1, 2), (3, 2)) == [7, 7, 7]


def test_points_outside_a_field_are_unreachable():
    field = GridField(ROWS, WIDE)
    outside = [(-1e-9, 1), (3.0000001, 1), (1, -1e-9), (1, 2.0000001), (np.nan, 1), (1, np.nan), (np.inf, 1)]
    assert at(field, *outside) == [np.inf] * 7
    assert field(np.zeros((0, 2))).shape == (0,) and field(np.zeros((1, 2), np.float32)).dtype == np.float64


@pytest.mark.parametrize("blocked", [np.nan, np.inf, "masked"])
def test_cells_without_value_are_left_out_of_averages(blocked):
    values = np.ma.masked_less(ROWS, 1) if blocked == "masked" else np.where(ROWS < 1, blocked, ROWS)
    field = GridField(values, WIDE)
    assert at(field, (0.5, 0.5), (0.99, 0.99), (0, 0)) == [np.inf] * 3
    assert at(field, (1.01, 0.5), (0.5, 1.01), (2, 0.5)) == [1, 10, 1.5]
    # In the middle of four cells, three of them with a value; at a face the cell above decides.
    assert at(field, (1, 1)) == [pytest.approx((1 + 10 + 11) / 3)]
    assert at(field, (1.25, 1.25)) == [pytest.approx((3 * 1 + 3 * 10 + 9 * 11) / 15)]
    assert np.isinf(field.values).sum() == 1


@given(st.integers(1, 3), st.integers(0, 10**6))
def test_field_equals_interpolation_of_scipy(dim, seed):
    rng = np.random.default_rng(seed)
    shape = rng.integers(2, 5, dim)
    values, lo, width = rng.random(shape), rng.normal(size=dim), rng.random(dim) + 0.5
    centers = [lo[i] + width[i] * (np.arange(shape[i]) + 0.5) / shape[i] for i in range(dim)]
    x = np.array([rng.uniform(along[0], along[-1], 20) for along in centers]).T
    expected = RegularGridInterpolator(centers, values)(x)
    np.testing.assert_allclose(GridField(values.T, (lo, lo + width))(x), expected, atol=1e-12)


def test_field_is_interpolated_across_a_seam():
    field = GridField([[0.0], [1], [2], [3]], Box((0, 0), (1, 4), periodic=(False, True)))
    at_y = [(0.5, y) for y in (0, 4, 0.25, 3.75, -1.5, 8.5)]
    assert at(field, *at_y) == [1.5, 1.5, 0.75, 2.25, 2, 0]
    assert at(field, (1.5, 0.5), (0.5, np.inf)) == [np.inf, np.inf]


def test_masked_values_may_be_invalid():
    assert at(GridField(np.ma.masked_less(ROWS - 1, 0), WIDE), (1.5, 0.5), (0.5, 0.5)) == [0, np.inf]


def test_grids_are_copied_and_read_only():
    free, values = DOOR.copy(), ROWS.astype(int)
    graph, field = GridGraph(free, (0, 0)), GridField(values, WIDE)
    free[:] = False
    values += 5
    assert at(graph, (1, 0)) == [1] and at(field, (0.5, 0.5)) == [0]
    for array in (graph.free, field.values, VoxelGraph(CUBE, (0, 0, 0)).free):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = 1
