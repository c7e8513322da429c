"""What proofs are held against: brute-force distances, hard points, searches for large errors, A*."""

import math

import numpy as np
import pytest
import shapely

from experiments.baselines._brute_distance import MAZE, BruteDistance
from experiments.proving import _astar, _bounds, _degenerate, _sizes
from plr_jax import VisibilityGraph, Workspace, construct, scenes


def test_brute_force_agrees_with_the_oracle():
    problem = scenes.maze()
    workspace, goal = problem.workspace, problem.goals[0]
    brute, oracle = BruteDistance(MAZE, goal), VisibilityGraph(workspace, goal)
    x = workspace.sample_free(2_000, 3)
    np.testing.assert_allclose(brute(x), oracle(x), rtol=0, atol=1e-9)
    grid = workspace.bounds.grid(97).reshape(-1, 2)
    assert (np.isinf(brute(grid)) == np.isinf(oracle(grid))).all()


def test_brute_force_goes_around_a_box_as_by_hand():
    brute = BruteDistance([(0.4, -1.0, 0.6, 0.5)], np.array([0.1, 0.5]))
    around = math.hypot(0.3, 0.0) + 0.2 + math.hypot(0.3, 0.4)
    x = np.array([(0.9, 0.1), (0.9, 0.5), (0.5, 0.3), (0.1, 0.2)])
    np.testing.assert_allclose(brute(x), [around, 0.8, np.inf, 0.3], atol=1e-11)


def test_the_search_for_the_largest_error_meets_a_peak_that_samples_miss():
    """A PLR of one plane of the cone above a goal errs most at the goal."""
    oracle = VisibilityGraph(Workspace(((0, 0), (1, 1))), (0.37, 0.41))
    plr = construct(oracle, oracle.workspace.bounds, max_leaves=1)
    x = np.array([[0.9, 0.9]])
    errors = np.abs(np.asarray(plr(x), float) - oracle(x))
    found = _sizes.largest_found(plr, oracle, x, errors, smoke=True)
    assert found == pytest.approx(max(float(plr(oracle.goal)), *_corner_errors(plr, oracle)), rel=1e-3)


def _corner_errors(plr, oracle):
    corners = np.array([(0, 0), (0, 1), (1, 0), (1, 1)], float)
    return np.abs(np.asarray(plr(corners), float) - oracle(corners))


def test_a_bound_that_is_broken_is_counted():
    problem = scenes.maze()
    oracle = VisibilityGraph(problem.workspace, problem.goals[0])
    plrs = _bounds.certified(oracle, problem.workspace, 512, 0)
    rng = np.random.default_rng(0)
    further = {"further": lambda x: oracle(x) + 0.5}
    for row in _bounds.violations(problem.workspace, problem.goals[0], plrs, further, 2_000, rng):
        assert row["violations"] + row["by_tolerance"] == row["points"] > 0 and row["worst"] > 0.3
        assert len(row["examples"]) == 3 and row["examples"][0]["distance"] > row["examples"][0]["bounds"][1]


def test_points_that_reach_the_goal_by_tolerance_alone_are_told_apart():
    """Two rooms that touch in a point, as walls do: the goal is in one of them."""
    walls = [[(0, 0.5), (0.5, 0.5), (0.5, 1), (0, 1)], [(0.5, 0), (1, 0), (1, 0.5), (0.5, 0.5)]]
    goal = np.array([0.2, 0.2])
    x = shapely.points([(0.4, 0.4), (0.5, 0.5), (0.5 + 1e-10, 0.5 + 1e-10), (0.9, 0.9), (0.2, 0.5 + 1e-12)])
    part = _bounds.part_of_goal(Workspace(((0, 0), (1, 1)), walls), goal)
    np.testing.assert_array_equal(shapely.covers(part, x), [True, True, False, False, False])
    part = _bounds.part_of_goal(Workspace(((0, 0), (1, 1)), walls, squeeze=True), goal)
    np.testing.assert_array_equal(shapely.covers(part, x), [True, True, True, True, False])


def test_hard_points_are_free_and_near_walls():
    workspace = scenes.maze().workspace
    oracle = VisibilityGraph(workspace, (0.06, 0.07))
    plr = construct(oracle, workspace.bounds, max_leaves=16)
    x = _bounds.mixed_points(workspace, [plr], 6_000, np.random.default_rng(0))
    assert workspace.is_free(x).all()
    clearance = np.abs(workspace.clearance(x))
    assert ((clearance > 0) & (clearance < 1e-6)).mean() > 0.05


def test_a_star_crosses_an_open_grid_as_by_hand():
    rng = np.random.default_rng(3)
    grid = _astar.random_grid(Workspace(((0, 0), (1, 1))), rng)
    a, b = 0, len(grid.points) - 1
    step = np.abs(np.diff(grid.points, axis=0)).max(axis=0)
    count = np.rint(np.abs(grid.points[b] - grid.points[a]) / step.min())
    expected = step.min() * (np.sqrt(2) * count.min() + np.ptp(count))
    cost, expanded, nodes = _astar.a_star(grid, a, b, [0.0] * len(grid.points))
    assert cost == pytest.approx(expected) and nodes <= expanded <= len(grid.points)


@pytest.mark.parametrize(
    ("number", "message"),
    [
        (1206, "all but touch"),
        (3178, "all but touch"),
        (3776, "all but touch"),
        (993, "an origin that is near"),
    ],
)
def test_what_an_oracle_does_not_see_of_a_nearly_degenerate_map_is_refused(number, message):
    """The first of these was searched for minutes; of the others bounds that are not were told."""
    rng = np.random.default_rng([0, number])
    workspace = Workspace(*_degenerate.random_rings(rng))
    goal = workspace.sample_free(_degenerate.POINTS, int(rng.integers(2**31)))[0]
    with pytest.raises(ValueError, match=message):
        construct(VisibilityGraph(workspace, goal), workspace.bounds, max_leaves=16, certified=True)
