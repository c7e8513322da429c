"""PairPLR: what it answers for which points, in compiled functions too, gradients, its file, and one goal of it."""

import math
import subprocess
import sys
import tracemalloc
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pair_helpers import MAZE, TEN, exact, serpentine, stored_ring, two_batches
from piece_helpers import box

import plr_jax
from plr_jax import Box, PairPLR, VisibilityGraph, Workspace, construct_pairs, scenes
from plr_jax.pairs.pair_plr import pairs_from_bytes
from plr_jax.pairs.stored import PairsFileData
from plr_jax.plr.tree import Cells, tree_of

INSIDE = np.array([0.1, 0.1])


@pytest.mark.usefixtures("either_way")
def test_the_maze_is_exact_in_a_kilobyte_symmetric_to_the_last_bit_and_zero_on_the_diagonal(maze):
    assert maze.num_bytes == len(maze.to_bytes()) <= 1024
    x, y = two_batches(MAZE, 4000)
    np.testing.assert_allclose(maze(x, y), exact(MAZE, x, y), atol=1e-6)
    np.testing.assert_array_equal(maze(x, y), maze(y, x))
    np.testing.assert_array_equal(maze(x, x), np.zeros(4000))


@pytest.mark.usefixtures("either_way")
@pytest.mark.full
def test_hand_drawn_distances_promote_no_shapes_and_types(wall):
    around = math.hypot(2, 4) + 2 + math.hypot(2, 4)
    x = jnp.array([(2, 4), (2, 4), (2, 9), (4, 8), (4, 3), (0, 0), (4, 0), (3, 3)], float)
    y = jnp.array([(8, 4), (2, 9), (8, 9), (6, 8), (4, 7), (10, 0), (6, 0), (3, 3)], float)
    expected = np.array([around, 5, 6, 2, 4, 2 * math.hypot(4, 8) + 2, 18, 0])
    plr = wall.to((8.0, 4.0))
    with jax.numpy_rank_promotion("raise"), jax.numpy_dtype_promotion("strict"):
        np.testing.assert_allclose(wall(x, y), expected, rtol=1e-6)
        lower, upper = wall.bounds(x, y)
        assert (lower <= expected).all() and (expected <= upper).all()
        # Both ends are clamped: a way straight to the left side, and one from below along the wall.
        np.testing.assert_allclose(wall(x - 10, y[0], outside="clamp") >= 0, True)
        np.testing.assert_allclose(plr.waypoint(x[:1]), [(4, 8)], atol=1e-5)


@pytest.mark.usefixtures("either_way")
@pytest.mark.full
def test_64_bits_are_answered_in_64(maze):
    """And beside corners the way is that of the points, not of what 32 bits leave of them."""
    x, y = two_batches(MAZE, 500, seed=2)
    with jax.enable_x64(True):
        for ends in ((x, y), (jnp.asarray(x), jnp.asarray(y)), (jnp.asarray(x, jnp.float32), y)):
            assert maze(*ends).dtype == np.float64 and maze.bounds(*ends)[0].dtype == np.float64
        assert maze(*map(partial(jnp.asarray, dtype=jnp.float32), (x, y))).dtype == np.float32
        np.testing.assert_allclose(maze(x, y), exact(MAZE, x, y), atol=1e-6)
        np.testing.assert_array_equal(maze(x, y), maze(y, x))
        ahead, here, behind = (np.asarray(maze(x + step, y)) for step in (1e-9, 0, -1e-9))
        assert (np.abs(ahead - 2 * here + behind) < 1e-14).mean() > 0.9 < (ahead != here).mean()


@pytest.mark.usefixtures("either_way")
def test_outside_is_infinite_nan_stays_and_the_corners_of_the_domain_are_inside(maze):
    far = [(1.1, 0.5), (0.5, -0.1), (np.inf, 0.5), (1e300, 0.5)]
    with np.errstate(over="raise"):
        assert np.isinf(maze(far, INSIDE)).all() and np.isinf(maze(INSIDE, far)).all()
    assert np.isnan(maze(np.array([np.nan, 0.5]), INSIDE)) and np.isnan(maze(INSIDE, np.array([np.nan, 2.0])))
    assert np.isfinite(maze([(0, 0), (1, 1), (1, 0), (0, 1)], INSIDE)).all()


@pytest.mark.full
def test_gradients_are_those_of_the_first_legs_and_zero_where_there_is_none(maze):
    x, y = two_batches(MAZE, 200, seed=3)
    gradients = jax.jit(jax.vmap(jax.grad(maze, argnums=(0, 1))))
    step = 1e-5
    for found, at in zip(gradients(jnp.asarray(x), jnp.asarray(y)), ((x, y), (y, x)), strict=True):
        np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-5)
        for axis, shift in enumerate(step * np.eye(2)):
            difference = exact(MAZE, at[0] + shift, at[1]) - exact(MAZE, at[0] - shift, at[1])
            error = np.abs(np.asarray(found)[:, axis] - difference / (2 * step))
            assert np.median(error) < 1e-3 and (error < 1e-2).mean() > 0.97  # but where the way on changes
    beyond = np.where(np.arange(200)[:, None] % 2, 1.1, INSIDE)
    for found in gradients(jnp.asarray(beyond), jnp.tile(INSIDE, (200, 1))):
        np.testing.assert_array_equal(found, 0)


def test_jit_vmap_and_shapes_agree(maze):
    x, y = (jnp.asarray(points.reshape(3, 20, 2)) for points in two_batches(MAZE, 60))
    expected = maze(x, y)
    assert expected.shape == (3, 20) and maze(x, y[0, 0]).shape == (3, 20) and maze(x[0, 0], y[0, 0]).shape == ()
    np.testing.assert_allclose(jax.vmap(jax.vmap(maze))(x, y), expected, atol=1e-6)
    np.testing.assert_allclose(jax.jit(lambda pairs, x, y: pairs(x, y))(maze, x, y), expected, rtol=3e-7, atol=6e-8)
    np.testing.assert_allclose(maze(np.asarray(x, np.float64), np.asarray(y)), expected, atol=1e-6)


@pytest.mark.full
def test_large_batches_are_answered_as_small_ones(maze):
    x, y = two_batches(MAZE, 20_000, seed=1)
    every = np.asarray(maze(x, y))
    np.testing.assert_allclose(jax.jit(maze.__call__)(x, y), every, rtol=3e-7, atol=3e-7)
    for part in (slice(0, 4000), slice(16_000, 20_000)):
        np.testing.assert_allclose(every[part], maze(x[part], y[part]), rtol=3e-7, atol=3e-7)


@pytest.mark.full
def test_the_first_large_batch_of_a_process_compiles_one_program():
    program = """
import jax, numpy as np, plr_jax
events = []
jax.monitoring.register_event_duration_secs_listener(lambda event, _, **__: events.append(event))
pairs = plr_jax.construct_pairs(plr_jax.scenes.maze().workspace, max_bytes=1024)
np.asarray(pairs(*np.random.default_rng(0).random((2, 100_000, 2))))
print(events.count("/jax/core/compile/backend_compile_duration"))
"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "1"


@pytest.mark.full
def test_tables_are_made_once_when_they_are_first_needed(maze):
    x, y = two_batches(MAZE, 100, seed=4)
    expected = maze(x, y)
    many = [np.tile(points, (200, 1)) for points in (x, y)]  # more than NumPy answers
    for ask in (lambda pairs: pairs(*many)[:100], lambda pairs: jax.jit(pairs.__call__)(x, y)):
        pairs = pairs_from_bytes(maze.to_bytes())
        assert "tables" not in vars(pairs) and repr(pairs) == repr(maze)
        assert "tables" not in vars(pairs.with_label("new"))
        np.testing.assert_allclose(ask(pairs), expected, rtol=3e-7, atol=6e-8)
        tables = vars(pairs)["tables"]
        assert not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree_util.tree_leaves(tables))
        ask(pairs)
        assert vars(pairs)["tables"] is tables is pairs.with_label("new").tables
    fresh = pairs_from_bytes(maze.to_bytes())
    moved = jax.tree_util.tree_map(jnp.asarray, fresh)
    np.testing.assert_allclose(moved(x, y), expected, rtol=3e-7, atol=6e-8)
    assert moved.to_bytes() == maze.to_bytes()
    assert moved.with_label("new").tables is moved.tables
    assert "stacked" in repr(jax.tree_util.tree_map(lambda leaf: jnp.stack([leaf, leaf]), fresh))
    paths = {jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_leaves_with_path(fresh)}
    assert {".file", ".tables.distances"} <= paths


def test_to_load_a_file_takes_what_its_bytes_do():
    """Also where few bytes are of many corners, of which tables take hundreds of megabytes."""
    data = serpentine(8192).to_bytes()
    pairs_from_bytes(serpentine(64).to_bytes())  # what is loaded but once is there
    tracemalloc.start()
    pairs = pairs_from_bytes(data)
    grown = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert grown < 500 * len(data) < 2**23 and pairs.num_corners == 8192


def test_an_outline_of_nothing_is_found_out_when_its_region_is_needed():
    points = np.random.default_rng(0).integers(0, 1000, (300, 2))
    with pytest.raises(ValueError, match="300 walls of its outline cross one another too often"):
        stored_ring(points, (1000, 1000)).outline.contains(np.ones((1, 2)))


@pytest.mark.usefixtures("either_way")
@pytest.mark.full
def test_prepared_goals_are_answered_as_the_points_are_in_any_batch_and_by_compiled_functions(maze):
    x, y = two_batches(MAZE, 60, seed=9)
    x[-3:], y[:2] = [(2, 0.5), (0.5, np.nan), (0.3, 0.3)], [(0.5, 1.5), (np.nan, 0.5)]
    goals, every = maze.prepared(y), np.asarray(maze(x[:, None], y))
    near = partial(np.testing.assert_allclose, atol=1e-6)
    near(maze(x[2:-3], jax.tree.map(lambda each: each[2:-3], goals)), exact(MAZE, x[2:-3], y[2:-3]))
    near(maze(x[:, None], goals), every)
    near(maze(x, goals), np.diag(every))
    near(maze(x.reshape(6, 10, 2), maze.prepared(y[7])), every[:, 7].reshape(6, 10))
    near(maze(x[5], jax.tree.map(lambda each: each[2:], goals)), every[5, 2:])
    near(jax.jit(jax.vmap(lambda pairs, x, y: pairs(x, pairs.prepared(y)), (None, 0, 0)))(maze, x, y), np.diag(every))
    for outside in ("nan", "clamp"):
        inside = slice(2, None) if outside == "clamp" else slice(None)
        near(maze(x, goals, outside=outside)[inside], maze(x, y, outside=outside)[inside])
    gradient = jax.vmap(jax.grad(maze))
    near(gradient(jnp.asarray(x[2:-3]), goals := maze.prepared(y[2:-3])), gradient(jnp.asarray(x[2:-3]), y[2:-3]))
    with jax.enable_x64(True):
        assert maze(x[2:-3], goals).dtype == np.float64
        np.testing.assert_allclose(maze(x[2:-3], goals), maze(x[2:-3], y[2:-3]), atol=1e-6)
    with pytest.raises(ValueError, match=r"goals must be points of shape \(..., 2\), got \(3,\)"):
        maze.prepared(np.zeros(3))
    assert maze(np.zeros((0, 2)), maze.prepared(np.zeros((0, 2)))).shape == (0,)
    other = plr_jax.construct_pairs(plr_jax.Workspace(((0, 0), (1, 1))), max_bytes=200)
    with pytest.raises(ValueError, match="prepared by these pairs"):
        maze(x, other.prepared(np.full(2, 0.5)))


@pytest.mark.parametrize("goal", [scenes.maze().goals[0], MAZE.sample_free(1, seed=1)[0]])
def test_one_goal_is_an_ordinary_plr_of_corners_that_lead_there(maze, goal):
    plr, truth = maze.to(goal), VisibilityGraph(MAZE, goal)
    assert isinstance(plr, plr_jax.PLR) and plr.leaf.name == "cone"
    x = MAZE.sample_free(4000, 3)
    error = np.abs(np.asarray(plr(x)) - truth(x))
    assert error.mean() < 1e-5 and error.max() < 0.02
    sources = plr.stored.sources
    np.testing.assert_allclose(sources.offsets, truth(sources.points), atol=1e-5)
    leg = np.linalg.norm(sources.points - sources.points[sources.parent], axis=1)
    np.testing.assert_allclose(sources.offsets[sources.parent] + leg, sources.offsets, atol=1e-4)
    assert plr_jax.from_bytes(plr.to_bytes()).num_bytes == plr.num_bytes


@pytest.mark.full
def test_leaves_are_halved_for_one_goal_as_often_as_it_takes_and_joined_where_they_are_alike(maze):
    stored, count = maze.stored, maze.num_corners
    one_leaf = tree_of(Cells.root(2)), np.zeros(count, int), np.arange(count)
    single = PairsFileData(stored.domain, stored.outline, stored.corner, stored.edges, *one_leaf, stored.rounding)
    coarse = pairs_from_bytes(single.to_bytes())
    goal, x = MAZE.sample_free(1, seed=8)[0], MAZE.sample_free(4000, seed=3)
    assert coarse.num_leaves == 1 and np.abs(np.asarray(coarse.to(goal)(x)) - maze(x, goal)).mean() < 1e-4
    assert maze.to(goal).num_leaves < maze.num_leaves


@pytest.mark.full
def test_corners_whose_turns_lead_nowhere_are_no_sources(data_dir):
    workspace = scenes.read_workspace(data_dir / "jupedsim" / "arena.wkt")  # with contacts and slivers
    goal, x = workspace.sample_free(1, 1)[0], workspace.sample_free(5000, 2)
    plr = construct_pairs(workspace).to(goal)
    error = np.abs(np.asarray(plr(x)) - VisibilityGraph(workspace, goal)(x))
    assert error.mean() < 1e-3


def test_goals_outside_and_points_that_are_none_are_refused(maze):
    for wrong in ((2.0, 2.0), (np.nan, 0.0), (1.0,)):
        with pytest.raises(ValueError, match=r"goal|Goal"):
            maze.to(wrong)
    with pytest.raises(ValueError, match=r"shape \(\.\.\., 2\)"):
        maze(np.zeros((4, 3)), np.zeros(2))
    with pytest.raises(ValueError, match="real"):
        maze(np.zeros((4, 2), complex), np.zeros(2))
    for ask in (maze, jax.jit(maze.__call__), maze.bounds):
        with pytest.raises(ValueError, match=r"x and y must broadcast, got shapes \(3, 2\) and \(4, 2\)"):
            ask(np.ones((3, 2)), np.ones((4, 2)))
    with pytest.raises(ValueError, match=r"x and goals must broadcast, got shapes \(3, 2\) and \(4, 2\)"):
        maze(np.ones((3, 2)), maze.prepared(np.ones((4, 2))))


def test_properties(maze):
    assert isinstance(maze, PairPLR) and maze.domain == Box((0, 0), (1, 1))
    assert maze.num_corners == 12 and maze.num_leaves == len(maze.stored.cells)
    assert "num_corners=12" in repr(maze) and maze.resident_bytes > maze.num_bytes


@pytest.mark.usefixtures("either_way")
def test_lines_past_a_contact_are_straight_and_bounds_hold_there():
    """Where two obstacles touch, the free wedge between them ends. Lines pass its end, however near."""
    wedge = [[(5, 5), (0, 5.3), (0, 9), (5, 9)], [(5, 5), (0, 4.7), (0, 1), (5, 1)]]
    pairs = construct_pairs(Workspace(TEN, wedge), max_bytes=2**12)
    x = np.array([(5 + beside, y) for beside in (0, 1e-6, 5e-6, 1e-4) for y in (4.5, 5 - 1e-6)])
    y = x * (1, 0) + (0, 6)
    for answers in (pairs, pairs.numpy()):
        lower, upper = answers.bounds(x, y)
        np.testing.assert_allclose(answers(x, y), 6 - x[:, 1], rtol=1e-6)
        assert (lower <= 6 - x[:, 1]).all() and (6 - x[:, 1] <= upper).all()
        # From side to side nothing leads.
        assert np.isinf(answers((8, 5), (1, 5)))


@pytest.mark.usefixtures("either_way")
@pytest.mark.parametrize("gap", [0, 6e-9, 5e-8])
def test_gaps_that_32_bits_do_not_resolve_are_open_and_contacts_are_not(gap):
    """A path turns at the tip of a triangle, in the gap to a rectangle, or around the triangle's other end."""
    triangle, rectangle = [(0.243, 0.412), (0.887, 0.54), (0.374, 0.49)], (0.887 + gap, 0.412, 1, 0.54)
    pairs = construct_pairs(Workspace(((0, 0), (1, 1)), [triangle, box(*rectangle)]), max_bytes=2**11)
    through, around = math.hypot(0.387, 0.06) + math.hypot(0.087, 0.09), math.hypot(0.257, 0.188)
    expected = through if gap else around + math.hypot(0.557, 0.038)
    for answers in (pairs, pairs.numpy()):
        assert answers((0.5, 0.6), (0.8, 0.45)) == pytest.approx(expected, rel=1e-6)


@pytest.mark.usefixtures("either_way")
def test_lines_along_a_wall_do_not_pass_a_tip_that_touches_it():
    """The tip parts free space. A line along the wall runs through the contact, from one part into the other."""
    pairs = construct_pairs(Workspace(((0, 0), (8, 6)), [[(8, 3), (0, 2), (0, 5)]]), max_bytes=2**11)
    x = np.array([(8, 3 + above) for above in (1e-3, 6e-3, 0.1, 3)])
    for answers in (pairs, pairs.numpy()):
        assert np.isinf(answers(x, (8, 4e-9))).all()
        np.testing.assert_allclose(answers(x, x[:1]), x[:, 1] - 3.001, atol=1e-6)
