import numpy as np
import pytest
from grid_helpers import all_pairs, dijkstra, drawn

from plr_jax import GridGraph, scenes
from plr_jax._types import CellGraph, DimensionedFn

DOOR = drawn("..#..", ".....", "..#..")


def at(oracle, *points):
    return oracle(np.array(points, float)).tolist()


def test_steps_to_four_neighbors_of_a_cell_all_of_whose_points_have_its_distance():
    graph = GridGraph(DOOR, (0.7, 0.2))
    assert at(graph, (0, 0), (1, 0), (4, 0), (4, 2), (0, 2)) == [0, 1, 6, 6, 2]
    assert at(graph, (0, 1), (0.999, 1.999), (4.5, 0.5)) == [1, 1, 6]
    assert graph.dim == 2 and isinstance(graph, DimensionedFn) and isinstance(graph, CellGraph)


def test_diagonal_steps_cut_no_corner():
    graph = GridGraph(DOOR, (1, 0), connectivity=8)
    assert at(graph, (2, 1), (3, 0), (0, 1)) == [2, 4, pytest.approx(2**0.5)]
    assert at(GridGraph(drawn(".#", "#."), (0, 0), connectivity=8), (1, 1)) == [np.inf]


def test_no_path_no_cell_no_distance():
    graph = GridGraph(drawn("..#."), (0, 0))
    outside = [(-1e-9, 0), (4, 0), (0, 1), (0, -0.1), (np.nan, 0), (0, np.nan), (np.inf, 0)]
    assert at(graph, (2, 0), (3, 0), *outside) == [np.inf] * 9
    assert graph(np.zeros((0, 2))).shape == (0,)


@pytest.mark.parametrize("connectivity", [4, 8])
def test_distances_are_those_of_a_search_by_the_book(connectivity):
    rng = np.random.default_rng(connectivity)
    for _ in range(10):
        free = rng.random(rng.integers(1, 9, 2)) > 0.3
        free[0, 0] = True
        expected = dijkstra(free, (0, 0), connectivity)
        cells = np.argwhere(np.ones_like(free))[:, ::-1]
        found = GridGraph(free, (0, 0), connectivity=connectivity)(cells)
        np.testing.assert_allclose(found, expected.ravel(), rtol=1e-12)


def test_between_is_each_goals_distance():
    x, y = all_pairs(DOOR)
    order = np.random.default_rng(0).permutation(len(x))
    graph = GridGraph(DOOR, connectivity=8)
    found = graph.between(x[order], y[order])
    expected = [graph.with_goal(start)(end[None])[0] for start, end in zip(x[order], y[order], strict=True)]
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    assert graph.between([[2, 0], [9, 9], [0, 0]], [[2, 0], [0, 0], [np.nan, 0]]).tolist() == [np.inf] * 3
    assert graph.between(np.zeros((0, 2)), np.zeros((0, 2))).shape == (0,)


@pytest.mark.parametrize("name", ["dao/den312d", "dao/den101d", "da2/ht_store"])
def test_published_lengths(data_dir, name):
    scenario = scenes.read_scen(data_dir / f"movingai/{name}.map.scen")
    graph = GridGraph(scenes.read_cells(data_dir / f"movingai/{name}.map"), connectivity=8)
    found = graph.between(scenario.starts, scenario.goals)
    np.testing.assert_allclose(found, scenario.octile_lengths, rtol=1e-5, atol=5e-3)


def test_cells_of_a_file_are_in_its_order(tmp_path):
    (tmp_path / "a.map").write_text("type octile\nheight 2\nwidth 3\nmap\n.@G\nST.\n")
    np.testing.assert_array_equal(scenes.read_cells(tmp_path / "a.map"), drawn(".#.", ".#."))


def test_a_grid_is_kept_as_it_was():
    free = DOOR.copy()
    graph = GridGraph(free, (0, 0))
    free[:] = False
    assert at(graph, (1, 0)) == [1]
    with pytest.raises(ValueError, match="read-only"):
        graph.free[0, 0] = False


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: GridGraph(DOOR.astype(int)), "booleans of shape .*got int64 of shape"),
        (lambda: GridGraph(DOOR[0]), "booleans of shape"),
        (lambda: GridGraph(DOOR[:0]), "at least one"),
        (lambda: GridGraph(DOOR, connectivity=6), "connectivity must be 4 or 8, got 6"),
        (lambda: GridGraph(DOOR, (2, 0)), "The goal must be in a free cell"),
        (lambda: GridGraph(DOOR, (5, 0)), "The goal must be in a free cell"),
        (lambda: GridGraph(DOOR)(np.zeros((1, 2))), "no goal: use"),
        (lambda: GridGraph(DOOR, (0, 0))(np.zeros((1, 3))), r"x must have shape \(n, 2\)"),
        (lambda: GridGraph(DOOR).between(np.zeros((1, 2)), np.zeros((2, 2))), "as many points, got 1 and 2"),
    ],
)
def test_bad_input_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
