from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from grid_helpers import all_pairs, drawn, mosaic, pairs_of_tiles

from plr_jax import GridGraph, GridPairs, construct_grid_pairs, scenes
from plr_jax._types import BoundingFn, DimensionedFn

ROOT = 2**0.5
ROOMS = drawn(
    ".......#",
    ".##....#",
    ".##.##..",
    "....##..",
    "##......",
    "...##.#.",
    ".#.##.##",
    ".#....#.",
)
"""With a cell in the last row that no path joins to the others."""


def pairs_of(free, connectivity):
    return construct_grid_pairs(GridGraph(free, connectivity=connectivity))


@pytest.fixture(scope="module", params=[4, 8])
def rooms(request):
    return GridGraph(ROOMS, connectivity=request.param)


@pytest.mark.parametrize(("connectivity", "expected"), [(4, [0, 3, 8, np.inf]), (8, [0, 3, 6 + ROOT, np.inf])])
def test_a_drawn_grid(connectivity, expected):
    pairs = pairs_of(drawn("...#.", "...#.", "..##.", "....."), connectivity)
    x, y = [[0, 0], [2, 1], [2, 0], [3, 0]], [[0.9, 0.9], [1, 3], [4, 2], [2, 0]]
    np.testing.assert_allclose(pairs(x, y), expected, rtol=1e-6)


@pytest.mark.parametrize("connectivity", [4, 8])
@pytest.mark.parametrize("seed", [0, 1])
def test_all_pairs_of_many_random_grids_are_exact_and_never_above_the_truth(connectivity, seed):
    graph = GridGraph(mosaic(seed, 12, 8), connectivity=connectivity)
    x, y = pairs_of_tiles(12, 8)
    truth = graph.between(x, y)
    found = np.asarray(construct_grid_pairs(graph)(x, y), np.float64)
    assert (found <= truth).all()
    np.testing.assert_allclose(found, truth, rtol=1e-6)
    assert connectivity == 8 or (found == truth).all()


@pytest.mark.parametrize("connectivity", [4, 8])
def test_pairs_of_a_published_map(data_dir, connectivity):
    graph = GridGraph(scenes.read_cells(data_dir / "movingai/dao/den312d.map"), connectivity=connectivity)
    pairs = construct_grid_pairs(graph)
    starts, goals = all_pairs(graph.free)
    some = np.random.default_rng(0).choice(len(starts), 200_000, replace=False)
    truth = graph.between(starts[some], goals[some])
    found = np.asarray(pairs(starts[some], goals[some]), np.float64)
    assert (found <= truth).all()
    np.testing.assert_allclose(found, truth, rtol=1e-6)
    assert pairs.num_bytes < 300  # the map has 5,265 cells


def test_published_lengths(data_dir):
    scenario = scenes.read_scen(data_dir / "movingai/dao/den520d.map.scen")
    pairs = pairs_of(scenes.read_cells(data_dir / "movingai/dao/den520d.map"), 8)
    np.testing.assert_allclose(pairs(scenario.starts, scenario.goals), scenario.octile_lengths, rtol=1e-5, atol=5e-3)
    assert pairs.num_bytes < 1300


def test_symmetric_and_zero_on_the_diagonal(rooms):
    pairs = construct_grid_pairs(rooms)
    x, y = all_pairs(ROOMS)
    np.testing.assert_array_equal(pairs(x, y), pairs(y, x))
    free = np.argwhere(ROOMS)[:, ::-1]
    np.testing.assert_array_equal(pairs(free, free + 0.75), 0)


def test_outside_blocked_and_not_joined_are_inf(rooms):
    pairs = construct_grid_pairs(rooms)
    bad = [[7, 0], [-0.01, 0], [0, 8], [8, 0], [np.nan, 0], [0, np.inf], [7, 7], [-1e30, 0]]
    assert np.isinf(pairs(bad, [0, 0])).all() and np.isinf(pairs([0, 0], bad)).all()
    assert np.isinf(pairs(bad[:6], bad[:6])).all()
    assert pairs([7, 7], [7.5, 7.5]) == 0
    nearly = np.nextafter(1.0, 0)  # as a 32-bit float it would be the next cell's
    assert pairs([nearly, 0], [0, 0]) == 0


def test_bounds_hold_the_truth(rooms):
    x, y = all_pairs(ROOMS)
    lower, upper = construct_grid_pairs(rooms).bounds(x, y)
    truth = rooms.between(x, y)
    assert (np.asarray(lower, np.float64) <= truth).all() and (truth <= np.asarray(upper, np.float64)).all()
    assert (np.asarray(upper) <= np.asarray(lower) * (1 + 2e-6)).all()


def test_distances_to_a_goal_are_those_of_pairs(rooms):
    pairs = construct_grid_pairs(rooms)
    cells = np.argwhere(np.ones_like(ROOMS))[:, ::-1] + 0.5
    for goal in ([0, 0], [7.2, 7.9], [3, 3]):
        to_goal = pairs.to(goal)
        np.testing.assert_array_equal(to_goal(cells), pairs(cells, goal))
        assert to_goal.dim == 2 and isinstance(to_goal, DimensionedFn) and isinstance(to_goal, BoundingFn)
    assert to_goal(cells.reshape(8, 8, 2)).shape == (8, 8)


def test_compiled_functions_take_it_or_close_over_it(rooms):
    pairs = construct_grid_pairs(rooms)
    x, y = (jnp.asarray(points, jnp.float32) for points in all_pairs(ROOMS))
    expected = pairs(x, y)
    np.testing.assert_array_equal(jax.jit(pairs)(x, y), expected)
    np.testing.assert_array_equal(jax.jit(lambda pairs, x: pairs(x, y))(pairs, x), expected)
    np.testing.assert_array_equal(jax.vmap(pairs)(x[:50], y[:50]), expected[:50])
    assert pairs(x.reshape(-1, 2, 2)[:3], y[0]).shape == (3, 2)
    assert pairs(x[0], y[0]).shape == () and pairs(x[:0], y[:0]).shape == (0,)


@pytest.mark.parametrize("free", [drawn("."), drawn("#"), drawn("...", "..."), drawn(".#."), drawn("..", "##", "..")])
@pytest.mark.parametrize("connectivity", [4, 8])
def test_grids_without_corners(free, connectivity):
    graph = GridGraph(free, connectivity=connectivity)
    pairs = construct_grid_pairs(graph)
    x, y = (np.concatenate([points, np.zeros((1, 2))]) for points in all_pairs(free))
    np.testing.assert_allclose(pairs(x, y), graph.between(x, y), rtol=1e-6)
    assert pairs.num_corners <= 1


def test_files_answer_alike(rooms, tmp_path):
    pairs = construct_grid_pairs(rooms)
    pairs.save(tmp_path / "rooms.pairs")
    assert (tmp_path / "rooms.pairs").stat().st_size == pairs.num_bytes == len(pairs.to_bytes())
    loaded = GridPairs.load(tmp_path / "rooms.pairs")
    x, y = all_pairs(ROOMS)
    np.testing.assert_array_equal(loaded(x, y), pairs(x, y))
    assert loaded.to_bytes() == pairs.to_bytes() and str(rooms.connectivity) in repr(loaded)
    (tmp_path / "text").write_text("no pairs")
    with pytest.raises(ValueError, match=r"text cannot be read as pairs of a grid: it does not start"):
        GridPairs.load(tmp_path / "text")


def test_a_budget_is_kept_or_refused(rooms):
    size = construct_grid_pairs(rooms).num_bytes
    assert construct_grid_pairs(rooms, max_bytes=size).num_bytes == size
    with pytest.raises(ValueError, match=f"max_bytes must be at least {size}.*got {size - 1}"):
        construct_grid_pairs(rooms, max_bytes=size - 1)


def test_bad_input_is_refused(rooms, unchecked_types):
    pairs = construct_grid_pairs(rooms)
    cells: Any = ROOMS
    text: Any = "here"
    for call, message in [
        (lambda: pairs([[0, 0, 0]], [[0, 0]]), r"x must have shape \(\.\.\., 2\), got \(1, 3\)"),
        (lambda: pairs([0, 0], jnp.zeros(3)), r"y must have shape"),
        (lambda: pairs(np.zeros((2, 2)), np.zeros((3, 2))), "must be of one shape"),
        (lambda: pairs(text, [0, 0]), "x must be points"),
        (lambda: pairs.to([7, 0]), "The goal must be in a free cell"),
        (lambda: construct_grid_pairs(cells), "graph must be a grid, such as GridGraph"),
        (lambda: construct_grid_pairs(rooms, max_bytes=0), "max_bytes must be an integer >= 1"),
        (lambda: GridPairs.from_bytes(text), "bytes of a file"),
    ]:
        with pytest.raises(ValueError, match=message):
            call()


def test_points_far_outside_are_infinitely_far_and_complex_ones_are_refused(rooms):
    pairs = construct_grid_pairs(rooms)
    with np.errstate(over="raise"):
        np.testing.assert_array_equal(pairs([[1e300, 0], [-1e300, 0], [0, np.inf]], [0, 0]), np.inf)
    with pytest.raises(ValueError, match="real"):
        pairs(jnp.zeros(2, complex), jnp.zeros(2))


def test_no_shapes_and_types_are_promoted(rooms):
    x = jnp.array([(0.5, 0.5), (2.5, 1.5)])
    pairs = construct_grid_pairs(rooms)
    expected = np.asarray(pairs(x, x[::-1]))
    with jax.numpy_rank_promotion("raise"), jax.numpy_dtype_promotion("strict"):
        np.testing.assert_array_equal(pairs(x, x[::-1]), expected)
        np.testing.assert_array_equal(pairs.bounds(x, x[::-1])[0], expected)
