"""PairPLR: what it answers for which points, in compiled functions too, gradients, its file, and one goal of it."""

import math
import tracemalloc
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pair_helpers import MAZE, exact, serpentine, stored_ring, two_batches
from piece_helpers import TEN, box
from scipy.sparse import csr_array

import plr_jax
from plr_jax import Box, PairPLR, VisibilityGraph, Workspace, construct_pairs, scenes
from plr_jax.pairs.pair_plr import pairs_from_bytes
from plr_jax.plr.tree import Cells, tree_of

INSIDE = np.array([0.1, 0.1])


@pytest.mark.usefixtures("either_way")
def test_maze_is_exact_symmetric_and_zero_on_diagonal(maze):
    assert maze.num_bytes == len(maze.to_bytes()) <= 1024
    x, y = two_batches(MAZE, 4000)
    np.testing.assert_allclose(maze(x, y), exact(MAZE, x, y), atol=1e-6)
    np.testing.assert_array_equal(maze(x, y), maze(y, x))
    np.testing.assert_array_equal(maze(x, x), np.zeros(4000))


def test_distances_around_one_wall_by_hand():
    wall = construct_pairs(Workspace(TEN, [box(4, 0, 6, 8)]), max_bytes=512)
    around, over = 2 * math.hypot(2, 4) + 2, 2 * math.hypot(4, 8) + 2
    x = jnp.array([(2, 4), (2, 4), (2, 9), (4, 8), (4, 3), (0, 0), (4, 0), (3, 3)], float)
    y = jnp.array([(8, 4), (2, 9), (8, 9), (6, 8), (4, 7), (10, 0), (6, 0), (3, 3)], float)
    expected = np.array([around, 5, 6, 2, 4, over, 18, 0])
    np.testing.assert_allclose(wall(x, y), expected, rtol=1e-6)
    lower, upper = wall.bounds(x, y)
    assert (lower <= expected).all() and (expected <= upper).all()
    for goal in ((10.0, 0.0), wall.prepared((10.0, 0.0))):
        assert wall((-3.0, -4.0), goal, outside="clamp") == pytest.approx(over + 5, rel=1e-6)
        assert np.isnan(wall((-3.0, -4.0), goal, outside="nan")) and np.isinf(wall((-3.0, -4.0), goal))


@pytest.mark.full
def test_tracing_promotes_no_ranks_and_types(maze):
    def answers(pairs, x, y):
        return pairs(x, y), pairs(x, y, outside="clamp"), pairs(x, pairs.prepared(y)), *pairs.bounds(x, y)

    with jax.numpy_rank_promotion("raise"), jax.numpy_dtype_promotion("strict"):
        found = jax.eval_shape(answers, maze, *np.zeros((2, 3, 2), np.float32))
    assert {(each.shape, each.dtype) for each in found} == {((3,), np.dtype(np.float32))}


@pytest.mark.usefixtures("either_way")
def test_points_of_64_bits_are_answered_in_64_bits(maze):
    """Beside corners, the path is that of the points, not of the points rounded to 32 bits."""
    x, y = two_batches(MAZE, 500, seed=2)
    with jax.enable_x64(True):
        np.testing.assert_allclose(maze(x, y), exact(MAZE, x, y), atol=1e-6)
        np.testing.assert_array_equal(maze(x, y), maze(y, x))
        ahead, here, behind = (np.asarray(maze(x + step, y)) for step in (1e-9, 0, -1e-9))
        assert (np.abs(ahead - 2 * here + behind) < 1e-14).mean() > 0.9 < (ahead != here).mean()


@pytest.mark.usefixtures("either_way")
def test_outside_is_infinite_and_nan_stays(maze):
    far = [(1.1, 0.5), (0.5, -0.1), (np.inf, 0.5), (1e300, 0.5)]
    with np.errstate(over="raise"):
        assert np.isinf(maze(far, INSIDE)).all() and np.isinf(maze(INSIDE, far)).all()
    assert np.isnan(maze(np.array([np.nan, 0.5]), INSIDE)) and np.isnan(maze(INSIDE, np.array([np.nan, 2.0])))
    assert np.isfinite(maze([(0, 0), (1, 1), (1, 0), (0, 1)], INSIDE)).all()  # corners of the domain


def test_batches_broadcast(maze):
    x, y = (points.reshape(3, 20, 2) for points in two_batches(MAZE, 60))
    assert maze(x, y[0, 0]).shape == (3, 20) and maze(x[0, 0], y[0, 0]).shape == ()
    np.testing.assert_array_equal(maze(x[:, :1], y), maze(np.repeat(x[:, :1], 20, axis=1), y))
    goals = maze.prepared(np.zeros((0, 2)))
    assert maze(x[0, :0], y[0, 0]).shape == maze(np.zeros((0, 2)), goals).shape == (0,)


@pytest.mark.usefixtures("unchecked_types")
def test_tables_are_made_once_and_are_a_tree_of_arrays(maze):
    pairs = pairs_from_bytes(maze.to_bytes())
    assert repr(pairs) == repr(maze) and "tables" not in vars(pairs) and "tables" not in vars(pairs.with_label("new"))
    jax.eval_shape(lambda: pairs.tables.step)  # tables that are built while a function is traced
    assert not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(vars(pairs)["tables"]))
    assert pairs.with_label("new").tables is pairs.tables
    moved = jax.tree.map(jnp.asarray, pairs)
    assert moved.to_bytes() == maze.to_bytes() and moved.with_label("new").tables is moved.tables
    np.testing.assert_array_equal(moved(INSIDE, 1 - INSIDE), maze(INSIDE, 1 - INSIDE))
    assert "stacked" in repr(jax.tree.map(lambda leaf: np.stack([leaf, leaf]), pairs))
    paths = {jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_leaves_with_path(pairs)}
    assert {".file", ".tables.distances"} <= paths


def test_loading_takes_memory_in_proportion_to_bytes():
    """Few bytes may hold many corners, whose tables take hundreds of megabytes."""
    data = serpentine(8192).to_bytes()
    pairs_from_bytes(serpentine(64).to_bytes())  # import what loading imports
    tracemalloc.start()
    pairs = pairs_from_bytes(data)
    grown = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert grown < 500 * len(data) < 2**23 and pairs.num_corners == 8192


def test_outline_whose_walls_cross_raises_when_its_region_is_needed():
    points = np.random.default_rng(0).integers(0, 1000, (300, 2))
    with pytest.raises(ValueError, match="300 walls of its outline cross one another too often"):
        stored_ring(points, (1000, 1000)).outline.contains(np.ones((1, 2)))


def test_prepared_goals_answer_as_points(maze):
    x, y = two_batches(MAZE, 60, seed=9)
    x[-3:], y[:2] = [(2, 0.5), (0.5, np.nan), (0.3, 0.3)], [(0.5, 1.5), (np.nan, 0.5)]
    goals, every = maze.prepared(y), np.asarray(maze(x[:, None], y))
    near = partial(np.testing.assert_allclose, atol=1e-6)
    near(maze(x[:, None], goals), every)
    near(maze(x, goals), np.diag(every))
    near(maze(x.reshape(6, 10, 2), maze.prepared(y[7])), every[:, 7].reshape(6, 10))
    near(maze(x[5], jax.tree.map(lambda each: each[2:], goals)), every[5, 2:])
    np.testing.assert_array_equal(maze.bounds(x[:, None], goals), maze.bounds(x[:, None], y))
    with jax.enable_x64(True):
        single, double = jnp.asarray(y, jnp.float32), np.dtype(float)
        assert maze(x, single).dtype == maze(x, maze.prepared(y)).dtype == double != maze(single, single).dtype
        assert {bound.dtype for bound in maze.bounds(x, y)} == {double}


@pytest.mark.full
def test_prepared_goals_have_gradients_in_points_under_jit_and_vmap(maze):
    x, y = (jnp.asarray(points, jnp.float32) for points in two_batches(MAZE, 60, seed=9))
    ask = jax.value_and_grad(lambda x, pairs, y: pairs(x, pairs.prepared(y)))
    distances, gradients = jax.jit(jax.vmap(ask, (0, None, 0)))(x, maze, y)
    np.testing.assert_allclose(distances, exact(MAZE, x, y), atol=1e-6)
    np.testing.assert_allclose(gradients, jax.jit(jax.vmap(jax.grad(maze)))(x, y), atol=1e-6)
    bounds = jax.jit(lambda x, y: (maze.bounds(x, maze.prepared(y)), maze.bounds(x, y)))(x, y)
    np.testing.assert_array_equal(*bounds)


@pytest.mark.full
def test_hessians_equal_differences_of_gradients():
    wall = construct_pairs(Workspace(((0, 0), (1, 1)), [[(0.4, 0), (0.5, 0), (0.5, 0.7), (0.4, 0.7)]]), max_bytes=300)
    with jax.enable_x64(True):
        to_goal = wall.to((0.9, 0.1))
        functions = (lambda z: wall(z[:2], z[2:], outside="clamp"), lambda z: to_goal(z[:2], outside="clamp"))
        z, steps = np.random.default_rng(0).uniform(-0.5, 1.5, (300, 4)), 1e-6 * np.vstack([np.eye(4), -np.eye(4)])
        derivatives = jax.jit(lambda z: [[jax.vmap(of(f))(z) for of in (jax.grad, jax.hessian)] for f in functions])
        for gradient, hessian in derivatives(np.concatenate([z, *(z + step for step in steps)])):
            ahead, behind = np.split(np.reshape(gradient, (9, *z.shape))[1:], 2)
            expected = ((ahead - behind) / 2e-6).transpose(1, 2, 0)
            assert np.isclose(hessian[: len(z)], expected, rtol=1e-5, atol=1e-5).all(axis=(1, 2)).mean() > 0.97
            assert (np.abs(expected) > 0.5).any(axis=(1, 2)).mean() > 0.5


def test_wrong_goals_raise(maze):
    with pytest.raises(ValueError, match=r"goals must be points of shape \(..., 2\), got \(3,\)"):
        maze.prepared(np.zeros(3))
    other = construct_pairs(Workspace(((0, 0), (1, 1))), max_bytes=200)
    with pytest.raises(ValueError, match="prepared by these pairs"):
        maze(INSIDE, other.prepared(np.full(2, 0.5)))
    with pytest.raises(ValueError, match="prepared by these pairs"):
        maze.bounds(INSIDE, other.prepared(np.full(2, 0.5)))
    for wrong in ((2.0, 2.0), (np.nan, 0.0), (1.0,)):
        with pytest.raises(ValueError, match=r"goal|Goal"):
            maze.to(wrong)


@pytest.mark.parametrize("goal", [scenes.maze().goals[0], MAZE.sample_free(1, seed=1)[0]])
def test_one_goal_gives_a_plr_of_cones(maze, goal):
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


def test_leaves_are_halved_or_joined_for_one_goal(maze):
    stored = maze.stored
    single = replace(stored, tree=tree_of(Cells.root(2)), lists=csr_array(np.ones((1, maze.num_corners), bool)))
    coarse = pairs_from_bytes(single.to_bytes())
    goal, x = MAZE.sample_free(1, seed=8)[0], MAZE.sample_free(4000, seed=3)
    assert coarse.num_leaves == 1 and np.abs(np.asarray(coarse.to(goal)(x)) - maze(x, goal)).mean() < 1e-4
    assert maze.to(goal).num_leaves < maze.num_leaves


@pytest.mark.full
def test_distances_beside_slits_equal_visibility_graph(data_dir):
    workspace = scenes.read_workspace(data_dir / "jupedsim" / "arena.wkt")  # with contacts and slivers
    goal, x = workspace.sample_free(1, 1)[0], workspace.sample_free(5000, 2)
    pairs = construct_pairs(workspace)
    error = np.abs(np.asarray(pairs.to(goal)(x)) - VisibilityGraph(workspace, goal)(x))
    assert error.mean() < 1e-3
    # The first point of each pair is 1e-9 to 1e-6 beside a wall at the end of which a slit begins.
    x = [(49.521819585782964, 60.27599892689271), (49.521865085323995, 60.28508064139136)]
    x += [(49.52183551767964, 60.279178935609494), (49.523288979204466, 60.569285880)]
    y = [(58.755567397358625, 50.20885404118824), (58.96630933718653, 52.35301974687714)]
    y += [(60.85424855338122, 58.04282701548594), (55.72046457295163, 60.5199417119682)]
    expected = VisibilityGraph(workspace, goal).between(np.array(x), np.array(y))
    np.testing.assert_allclose(pairs.numpy()(x, y), expected, atol=2e-5 * workspace.bounds.width.max())


def test_wrong_points_raise(maze):
    with pytest.raises(ValueError, match=r"shape \(\.\.\., 2\)"):
        maze(np.zeros((4, 3)), np.zeros(2))
    with pytest.raises(ValueError, match="real"):
        maze(np.zeros((4, 2), complex), np.zeros(2))
    for ask in (maze, jax.jit(maze.__call__), maze.bounds):
        with pytest.raises(ValueError, match=r"x and y must broadcast, got shapes \(3, 2\) and \(4, 2\)"):
            ask(np.ones((3, 2)), np.ones((4, 2)))
    with pytest.raises(ValueError, match=r"x and goals must broadcast, got shapes \(3, 2\) and \(4, 2\)"):
        maze(np.ones((3, 2)), maze.prepared(np.ones((4, 2))))


def test_pairs_report_domain_counts_and_memory(maze):
    assert isinstance(maze, PairPLR) and maze.domain == Box((0, 0), (1, 1))
    assert maze.num_corners == 12 and maze.num_leaves == len(maze.stored.cells)
    assert "num_corners=12" in repr(maze) and maze.resident_bytes > maze.num_bytes


@pytest.mark.usefixtures("either_way")
def test_lines_past_a_contact_are_straight_within_bounds():
    """Where two obstacles touch, the free wedge between them ends. Lines pass its end, however near."""
    wedge = [[(5, 5), (0, 5.3), (0, 9), (5, 9)], [(5, 5), (0, 4.7), (0, 1), (5, 1)]]
    pairs = construct_pairs(Workspace(TEN, wedge), max_bytes=2**12)
    x = np.array([(5 + beside, y) for beside in (0, 1e-6, 5e-6, 1e-4) for y in (4.5, 5 - 1e-6)])
    y = x * (1, 0) + (0, 6)
    lower, upper = pairs.bounds(x, y)
    np.testing.assert_allclose(pairs(x, y), 6 - x[:, 1], rtol=1e-6)
    assert (lower <= 6 - x[:, 1]).all() and (6 - x[:, 1] <= upper).all()
    assert np.isinf(pairs((8, 5), (1, 5)))  # from side to side nothing leads


@pytest.mark.usefixtures("either_way")
@pytest.mark.parametrize("gap", [0, 6e-9, 5e-8])
def test_gaps_below_32_bits_are_open_and_contacts_closed(gap):
    """A path turns at the tip of a triangle, in the gap to a rectangle, or around the triangle's other end."""
    triangle, rectangle = [(0.243, 0.412), (0.887, 0.54), (0.374, 0.49)], (0.887 + gap, 0.412, 1, 0.54)
    pairs = construct_pairs(Workspace(((0, 0), (1, 1)), [triangle, box(*rectangle)]), max_bytes=2**11)
    through, around = math.hypot(0.387, 0.06) + math.hypot(0.087, 0.09), math.hypot(0.257, 0.188)
    expected = through if gap else around + math.hypot(0.557, 0.038)
    assert pairs((0.5, 0.6), (0.8, 0.45)) == pytest.approx(expected, rel=1e-6)


@pytest.mark.usefixtures("either_way")
def test_lines_along_a_wall_end_at_a_touching_tip():
    """The tip parts free space. A line along the wall runs through the contact, from one part into the other."""
    pairs = construct_pairs(Workspace(((0, 0), (8, 6)), [[(8, 3), (0, 2), (0, 5)]]), max_bytes=2**11)
    x = np.array([(8, 3 + above) for above in (1e-3, 6e-3, 0.1, 3)])
    assert np.isinf(pairs(x, (8, 4e-9))).all()
    np.testing.assert_allclose(pairs(x, x[:1]), x[:, 1] - 3.001, atol=1e-6)


def test_pairs_far_away_need_64_bit_points_and_have_the_bounds_of_the_origin():
    points, wall = np.array([(30, 150), (300, 150)]), np.array(box(140, 80, 170, 250))
    distance, widths = math.hypot(110, 70) + 30 + math.hypot(130, 70), []
    for origin in np.array([(0, 0), (5e5, 4.5e6)]):
        pairs = construct_pairs(Workspace((origin, origin + 335), [origin + wall]), max_bytes=500)
        x, y = origin + points
        for answers in (pairs, pairs.numpy()):
            lower, upper = answers.bounds(x, y)
            assert answers(x, y) == pytest.approx(distance, abs=1e-4) and lower < distance < upper
            widths.append(upper - lower)
    assert max(widths) < 1.1 * min(widths)
    for type_of in (jnp.asarray, np.float32):
        with pytest.raises(ValueError, match="too coarse"):
            pairs(type_of(x), type_of(y))
