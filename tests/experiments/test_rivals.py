"""The rivals that experiments compare with, and inputs on which proofs failed once."""

import numpy as np
import pytest

from experiments import compare_summaries
from experiments.baselines._brute_distance import MAZE, BruteDistance
from experiments.benchmarks._numba_loop import numba_loop
from experiments.benchmarks._rivals import coded_grid, jax_grid, scipy_grid
from experiments.solving import _cars, _rivals, _speed_map
from experiments.summaries import _given, _node_tables
from experiments.summaries._given import Given
from plr_jax import BuildOptions, Euclidean, PlaneSpace, ReedsShepp, VisibilityGraph, Workspace, construct, scenes

pytestmark = pytest.mark.full


@pytest.mark.parametrize(("dim", "limit", "two_levels"), [(2, 40, False), (5, 2_000, True)])
def test_numba_loop_equals_the_plr(dim, limit, two_levels):
    pytest.importorskip("numba")
    tip = np.linspace(-1.3, 2.1, dim)
    domain = (np.full(dim, -3.0), np.linspace(2, 5, dim))
    options = BuildOptions(num_samples=32)
    plr = construct(lambda x: np.linalg.norm(x - tip, axis=1) ** 0.5, domain, max_leaves=limit, options=options)
    assert (plr.tables.blocks is not None) == two_levels
    x = np.random.default_rng(0).uniform(-4, 5.5, (20_000, dim)).astype(np.float32)
    expected = np.asarray(plr(x))
    answered = np.isfinite(expected)
    assert answered.any() and np.isinf(expected).any()
    answers = numba_loop(plr, False)(x)
    assert np.array_equal(np.isinf(answers), np.isinf(expected))
    # A point on a cell's face, to within rounding, may be given to either side.
    assert np.mean(np.abs(answers[answered] - expected[answered]) > 1e-5) < 1e-3


SQUARE = Workspace(((0, 0), (1, 1)))


@pytest.mark.parametrize("num_bytes", [200, 2_000])
def test_coded_grids_fit_and_interpolate(num_bytes):
    x = np.random.default_rng(0).random((1_000, 2))
    cone = Euclidean((0.3, 0.4))
    grid = coded_grid(SQUARE, cone, num_bytes, x, cone(x))
    assert 0.8 * num_bytes < grid.num_bytes <= num_bytes < grid.values.size
    by_scipy, by_jax = scipy_grid(grid).on_host(x), jax_grid(grid).on_host(x)
    np.testing.assert_allclose(by_scipy, by_jax, atol=1e-5)
    assert np.abs(by_scipy - cone(x)).mean() < 2 / num_bytes


def test_grids_interpolate_between_free_nodes():
    grid = _node_tables.grid_of(SQUARE, 20)
    table = np.stack([grid.free @ [1.0, 2.0], np.full(len(grid.free), 3.0)], axis=1)[grid.nearest]
    for x in np.random.default_rng(0).random((50, 2)):
        np.testing.assert_allclose(grid.read(table, x), [x @ [1.0, 2.0], 3.0], atol=1e-5)
    finest = _node_tables.finest_grid(SQUARE, lambda grid: grid.table_bytes(1, 8), 1_000)
    assert 800 < finest.table_bytes(1, 8) <= 1_000


def test_grids_without_obstacles_equal_straight_lines():
    space, goal = PlaneSpace(SQUARE), np.array([0.3, 0.4])
    x = SQUARE.sample_free(2_000, 5)
    exact = Euclidean(goal)(x)
    inside = ((x > 0.01) & (x < 0.99)).all(axis=1)  # beyond, fields go on as at their outer centers
    x, exact = x[inside], exact[inside]
    searched = _rivals.grid_search(space, goal, (64, 64), _rivals.all_neighbors(2, 4))
    assert np.abs(searched(x) - exact).max() < 0.015
    assert np.abs(_rivals.marched(space, goal, (64, 64))(x) - exact).max() < 0.006
    twice = _rivals.marched(space, goal, (64, 64), lambda q: np.full(len(q), 2.0))
    assert np.abs(twice(x) - 2 * exact).max() < 0.012


def test_bounds_of_speed_maps_contain_their_factors():
    boxes = _speed_map.MAPS["two regions, 10 x as fast"]
    rng = np.random.default_rng(0)
    ends = np.sort(rng.random((2, 3_000, 2)), axis=0)
    lower, upper = boxes.bounds(*ends)
    for share in rng.random((20, 3_000, 2)):
        factor = boxes(ends[0] + share * (ends[1] - ends[0]))
        assert ((lower <= factor) & (factor <= upper)).all()
    touching = boxes.bounds(boxes.hi, boxes.hi + 0.01)
    np.testing.assert_allclose(touching, [(0.1, 0.1), (1, 1)])
    np.testing.assert_allclose(boxes.bounds(boxes.lo, boxes.hi), 0.1)


def test_brute_force_and_polygon_rival_equal_the_oracle():
    problem = scenes.maze()
    workspace, goal = problem.workspace, problem.goals[0]
    brute, oracle = BruteDistance(MAZE, goal), VisibilityGraph(workspace, goal)
    x = workspace.sample_free(2_000, 3)
    np.testing.assert_allclose(brute(x), oracle(x), rtol=0, atol=1e-9)
    grid = workspace.bounds.grid(97).reshape(-1, 2)
    assert (np.isinf(brute(grid)) == np.isinf(oracle(grid))).all()
    pairs = _given.draw_pairs(oracle, 20, 50, 1)
    ((_, polygon),) = compare_summaries.polygon(Given(oracle, 1_024, pairs, 0, True))
    assert polygon.num_bytes == 4 * 28
    for ends in ((x, y := np.tile(goal, (len(x), 1))), (y, x)):
        np.testing.assert_allclose(polygon(*ends), oracle(x), rtol=0, atol=1e-6)


def test_maps_too_far_from_the_origin_are_refused():
    workspace = Workspace(((-55037950.56443232, 51192343.53759958), (-55037950.46443233, 51192343.53859958)))
    oracle = VisibilityGraph(workspace, (-55037950.559271306, 51192343.53810345))
    with pytest.raises(ValueError, match="move the origin"):
        construct(oracle, workspace.bounds, max_leaves=16, certified=True)


def test_bounds_hold_between_obstacles_that_nearly_touch():
    sliver = "25746.20448833581 16511.540618084946 25746.41801413055 16384.010589615387 25746.41801512221 "
    sliver += "16384.01058961705"
    blade = "25746.21120528183 16507.528885731157 25669.129247229936 16464.089320283372 26621.20448833581 "
    blade += "16436.540618084946"
    obstacles = [np.array(corners.split(), float).reshape(3, 2) for corners in (sliver, blade)]
    bounds = (25621.20448833581, 16249.040618084948), (26621.20448833581, 16549.04061808495)
    workspace = Workspace(bounds, obstacles)
    oracle = VisibilityGraph(workspace, (25674.12932443736, 16508.751242945484))
    plr, x = construct(oracle, workspace.bounds, max_leaves=16, certified=True), workspace.sample_free(2_000, 0)
    distance, (lower, upper) = oracle(x), plr.bounds(x)
    assert (lower <= distance).all() and (distance <= upper).all()


def test_table_of_a_car_folds_reflections():
    oracle = ReedsShepp((0, 0, 0), 1.0)
    poses = np.array([(0.0, 0, 0), (-25, 25, -np.pi), (12.5, -7.5, np.pi / 4), (12.5, 7.5, np.pi)])
    table = _cars.lookup_table(oracle, (21, 11, 8))
    np.testing.assert_allclose(_cars.looked_up(table, poses), oracle(poses), atol=1e-5)
