"""Optimized paths: short where the shortest is known, never invalid, never costlier, never under way for longer."""

import itertools
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plr_jax import (
    DiscRobot,
    PointRobot,
    Problem,
    RectangleRobot,
    VisibilityGraph,
    Workspace,
    bl_plan,
    construct,
    descend,
    makespan,
    path_cost,
    robot_distance_fns,
    scenes,
    sum_of_distances,
    validate,
)
from plr_jax.optimize import OptimizationInterrupted, optimize_paths
from plr_jax.optimize.trajectory import optimize_paths as driver

ROOM = Workspace(((0, 0), (10, 10)))
BOX = Workspace(((0, 0), (10, 10)), [[(4, 3), (6, 3), (6, 7), (4, 7)]])
SWAP = Problem(ROOM, [DiscRobot(0.5)] * 2, [[2, 5], [8, 5]], [[8, 5], [2, 5]])
# Descents run 50 iterations at a time: multiples of it, and as many guesses, share what is compiled.
QUICK = {"num_retimings": 1, "num_iterations": 200}
ONE_GUESS = {"num_retimings": 0, "num_iterations": 200}


def through(problem, *rows):
    """A path from the starts through some rows to the goals."""
    return np.stack([problem.starts, *(np.array(row, dtype=float) for row in rows), problem.goals])


def detour():
    """Two discs that pass one another with much room between them."""
    return through(SWAP, [[2, 8], [8, 2]], [[8, 8], [2, 2]])


def checked(problem, result):
    """The result, its claims verified."""
    assert result.paths.shape[2:] == problem.starts.shape
    for path, cost, span, valid in zip(result.paths, result.costs, result.makespans, result.valid, strict=True):
        np.testing.assert_array_equal(path[[0, -1]], [problem.starts, problem.goals])
        assert cost == pytest.approx(path_cost(problem, path), rel=1e-12)
        assert span == makespan(problem, path)
        assert valid == validate(problem, path).valid
    assert (result.path is None) == (not result.valid.any()) == (not np.isfinite(result.cost))
    assert (result.path is None) == (not np.isfinite(result.makespan))
    if result.path is not None:
        assert result.makespan == makespan(problem, result.path)
        assert result.cost == pytest.approx(path_cost(problem, result.path), rel=1e-12)
        assert result.cost == pytest.approx(result.costs[result.valid].min(), rel=1e-12)
    assert np.isfinite(result.history).all()
    return result


def test_in_an_empty_room_a_jagged_path_becomes_a_straight_line():
    problem = Problem(ROOM, [PointRobot()], [[1, 1]], [[9, 8]])
    rows = np.random.default_rng(0).uniform(0, 10, (12, 1, 2))
    result = checked(problem, optimize_paths(problem, through(problem, *rows)))
    assert result.cost == pytest.approx(np.hypot(8, 7), rel=1e-4)
    assert repr(result) == "OptimizedPaths(1 of 1 valid, cost 10.63, makespan 10.63)"


@pytest.mark.parametrize("robot, corner", [(PointRobot(), 0.0), (DiscRobot(0.5), 0.5)])
def test_past_one_obstacle_a_path_becomes_two_tangents(robot, corner):
    problem = Problem(BOX, [robot], [[1, 4.5]], [[9, 4.5]])
    result = checked(problem, optimize_paths(problem, through(problem, [[3, 1]], [[7, 1]])))
    # By symmetry: a tangent to the circle about the corner (4, 3), an arc, and straight on to the middle.
    away, below = np.hypot(3, 1.5), np.arctan2(1.5, 3)
    turn = below + np.arcsin(corner / away)
    exact = 2 * (np.sqrt(away**2 - corner**2) + corner * turn + 1)
    assert exact - 1e-6 <= result.cost <= 1.001 * exact


def test_two_discs_swap_places_almost_straight():
    result = checked(SWAP, optimize_paths(SWAP, detour(), num_retimings=1))
    # Neither can do better than to swerve by a radius where they meet.
    assert 12 < result.cost <= 1.003 * 4 * np.hypot(3, 0.5) < 0.6 * path_cost(SWAP, detour())


def test_a_rectangle_turns_no_more_than_it_must():
    problem = Problem(ROOM, [RectangleRobot(2, 0.5)], [[2, 2, 3.0]], [[8, 3, -3.0]])
    result = checked(problem, optimize_paths(problem, through(problem, [[4, 6, -2.5]], [[6, 1, 3.1]])))
    turn = 2 * np.pi - 6.0
    assert result.cost == pytest.approx(np.hypot(6, 1) + turn * problem.rotation_weights[0], rel=1e-3)


PASSING = (  # a rectangle, and a disc that waits for it
    [[2, 2, 0], [5, 2.2, 0], [8, 2.5, 1], [8, 2.5, 1]],
    [[8, 0.6, 0], [8, 0.6, 0], [8, 0.6, 0], [2, 0.6, 0]],
)


def test_rectangles_and_a_disc_stay_valid():
    robots = [RectangleRobot(1.5, 0.4), DiscRobot(0.4)]
    problem = Problem(BOX, robots, [[2, 2, 0], [8, 2, 0]], [[8, 2.5, 1], [2, 2.5, 0]])
    path = through(problem, *([rectangle, disc] for rectangle, disc in zip(PASSING[0], PASSING[1], strict=True)))
    assert validate(problem, path).valid
    result = checked(problem, optimize_paths(problem, path, **ONE_GUESS))
    assert result.valid.all() and result.cost < 0.9 * path_cost(problem, path)


@given(st.integers(0, 10_000), st.integers(0, 12))
@settings(max_examples=4, deadline=None)
def test_a_valid_path_stays_valid_and_becomes_no_costlier(seed, steps):
    rng = np.random.default_rng(seed)
    tame = detour() + rng.normal(0, 0.3, (4, 2, 2)) * [[[0]], [[1]], [[1]], [[0]]]
    wild = np.concatenate([detour()[:2], rng.uniform(0.5, 9.5, (steps, 2, 2)), detour()[2:]])
    for path in (tame, wild):
        before = validate(SWAP, path)
        result = checked(SWAP, optimize_paths(SWAP, path, num_retimings=1, num_iterations=50, seed=seed))
        if before.valid:
            assert result.valid[0] and result.cost <= before.cost * (1 + 1e-12)
            assert result.makespan <= makespan(SWAP, path) * (1 + 1e-12)


def test_a_team_takes_more_time_only_if_it_may():
    """Three discs change rooms; if time costs nothing, they wait for one another at the doors."""
    problem = scenes.four_rooms(3)
    path = bl_plan(problem, sum_of_distances(robot_distance_fns(problem))).path
    before, options = makespan(problem, path), {"num_retimings": 7, "num_iterations": 300}
    kept, some, free = (
        checked(problem, optimize_paths(problem, path, **options, makespan_factor=factor))
        for factor in (1, 1.05, np.inf)
    )
    assert kept.makespan <= before * (1 + 1e-12) and some.makespan <= 1.05 * before * (1 + 1e-12)
    assert free.makespan > 1.1 * before
    # Time that robots may not take costs them next to nothing.
    assert kept.cost < 1.002 * free.cost and kept.cost < path_cost(problem, path)


def test_each_path_of_a_batch_has_its_own_time():
    """In the second, the robots make the same detours one after the other, which takes twice as long."""
    problem = Problem(ROOM, SWAP.robots, [[2, 2], [2, 8]], [[8, 2], [8, 8]])
    b, (c, d), at_once = problem.starts[1], problem.goals, [[5, 4], [5, 6]]
    together = through(problem, at_once, [c, d], [c, d])
    in_turn = through(problem, [[5, 4], b], [c, b], [c, [5, 6]])
    given = np.stack([together, in_turn])
    before = np.array([makespan(problem, path) for path in given])
    assert before[1] == pytest.approx(2 * before[0])
    result = checked(problem, optimize_paths(problem, given, **ONE_GUESS))
    assert result.valid.all() and (result.makespans <= before * (1 + 1e-12)).all()
    np.testing.assert_allclose(result.costs, 12, rtol=1e-3)
    assert result.makespans[1] > 1.2 * before[0]


def test_turns_take_time_too():
    robots = [RectangleRobot(1.5, 0.4), DiscRobot(0.4)]
    problem = Problem(ROOM, robots, [[2, 2, 0], [8, 5, 0]], [[8, 2.5, 3], [2, 5, 0]], rotation_weight=2.0)
    path = through(problem, [[2, 2, 2.5], [8, 5, 0]], [[5, 4, -3.0], [5, 8, 0]])
    assert validate(problem, path).valid
    result = checked(problem, optimize_paths(problem, path, **QUICK))
    assert result.makespan <= makespan(problem, path) and result.cost < 0.9 * path_cost(problem, path)


def test_a_guess_that_is_not_valid_may_take_any_time():
    """It is shorter than every path around the box."""
    problem = Problem(BOX, [PointRobot()], [[1, 4.5]], [[9, 4.5]])
    guess = through(problem, [[4.5, 2.9]], [[5.5, 2.9]])
    straight = through(problem, [[4.2, 3.1]], [[5.8, 3.1]])
    assert not validate(problem, straight).valid
    result = checked(problem, optimize_paths(problem, np.stack([straight, guess])))
    assert result.valid[0] and result.makespans[0] > makespan(problem, straight)


def test_what_is_shortest_already_is_left_as_it_is():
    problem = Problem(ROOM, [PointRobot()], [[1, 1]], [[9, 8]])
    result = checked(problem, optimize_paths(problem, through(problem)))
    assert result.cost == pytest.approx(np.hypot(8, 7), rel=1e-12)


def test_robots_that_stay_where_they_are():
    problem = Problem(ROOM, [DiscRobot(0.5)] * 2, SWAP.starts, SWAP.starts)
    result = checked(problem, optimize_paths(problem, SWAP.starts[None], **QUICK))
    assert result.valid.all() and result.cost == 0


def test_wide_margins_are_kept_where_there_is_room():
    path = detour()
    result = checked(SWAP, optimize_paths(SWAP, path, margin=0.2, **QUICK))
    assert validate(SWAP, result.path).clearance > 0.15


def test_smoothness_makes_bends_wider():
    problem = Problem(BOX, [PointRobot()], [[1, 4.5]], [[9, 4.5]])
    path = through(problem, [[3, 1]], [[7, 1]])
    sharp, smooth = (checked(problem, optimize_paths(problem, path, smoothness=w)).path for w in (0.0, 30.0))
    sharpest, smoothest = (np.abs(np.diff(each, 2, axis=0)).max() for each in (sharp, smooth))
    assert smoothest < 0.7 * sharpest


def test_a_batch_is_optimized_as_its_paths_are_one_by_one_and_again():
    paths = np.stack([detour(), detour() * [[[1]], [[0.9]], [[1.1]], [[1]]]])
    together = checked(SWAP, optimize_paths(SWAP, paths, **ONE_GUESS))
    again = optimize_paths(SWAP, paths, **ONE_GUESS)
    np.testing.assert_array_equal(together.paths, again.paths)
    for k, path in enumerate(paths):
        alone = checked(SWAP, optimize_paths(SWAP, path, **ONE_GUESS))
        assert alone.cost == pytest.approx(together.costs[k], rel=1e-3)


@pytest.mark.parametrize("shift", [(1e5, -3e5), (500_000.4, 4_200_000.2)])
def test_far_from_the_origin_paths_are_as_good(shift):
    """Also where 32-bit floats do not hold the middle of the workspace: they are 0.5 apart at 4.2e6."""
    ring = np.array([(4, 3), (6, 3), (6, 7), (4, 7)]) + shift
    there = Workspace((shift, np.add(shift, 10)), [ring])
    near = Problem(BOX, [PointRobot()], [[1, 4.5]], [[9, 4.5]])
    far = Problem(there, near.robots, near.starts + shift, near.goals + shift)
    path = through(near, [[3, 1]], [[7, 1]])
    cost = optimize_paths(near, path).cost
    assert checked(far, optimize_paths(far, path + shift)).cost == pytest.approx(cost, rel=1e-3)


def test_a_guide_brings_a_guess_around_a_wall():
    wall = Workspace(((0, 0), (10, 10)), [[(4, 0), (4.5, 0), (4.5, 8), (4, 8)]])
    problem = Problem(wall, [PointRobot()], [[1, 4]], [[9, 3]])
    oracle = VisibilityGraph(wall, problem.goals[0])
    plr = construct(oracle, wall.bounds, max_bytes=1024)
    exact = oracle(problem.starts)[0]

    def plain(x):
        return plr(x)

    for fn in (plr, plain):
        result = checked(problem, optimize_paths(problem, through(problem), distance_fns=[fn], num_iterations=1500))
        assert result.valid.all() and result.cost <= 1.01 * exact
    assert not checked(problem, optimize_paths(problem, through(problem), **ONE_GUESS)).valid.any()


def test_a_guide_without_a_gradient_at_the_goal_spoils_nothing():
    problem = Problem(BOX, [PointRobot()], [[1, 4.5]], [[9, 4.5]])
    path = through(problem, [[3, 9]], [[7, 9]])

    def straight(x):
        return jnp.linalg.norm(x - problem.goals[0], axis=1)  # whose gradient at the goal is NaN

    result = checked(problem, optimize_paths(problem, path, distance_fns=[straight], **QUICK))
    assert result.cost < 0.95 * path_cost(problem, path)


def test_a_guess_too_far_out_for_32_bits_stays_as_it_is():
    far = through(SWAP, [[2, 1e30], [8, 2]])
    result = optimize_paths(SWAP, far, **QUICK)
    assert not result.valid.any() and np.isfinite(result.paths).all()


def test_a_path_in_a_narrow_place_that_bold_steps_leave_is_shortened_by_gentle_ones(monkeypatch):
    result = optimize_paths(SWAP, detour(), **QUICK)
    gentle, improve = [], driver._improve

    def spoiled(problem, scene, guesses, aims, best, progress):
        if progress[0] == 0:  # the bold descents find nothing
            return True
        gentle.append(progress[0])
        return improve(problem, scene, guesses, aims, best, progress)

    monkeypatch.setattr(driver, "_improve", spoiled)
    shortened = optimize_paths(SWAP, detour(), **QUICK)
    assert gentle and validate(SWAP, shortened.path).valid
    assert result.cost <= shortened.cost < path_cost(SWAP, detour()) - 1


def test_of_a_batch_the_cheapest_valid_path_is_returned():
    problem = Problem(BOX, [PointRobot()], [[1, 4.5]], [[9, 4.5]])
    above, below = through(problem, [[3, 9]], [[7, 9]]), through(problem, [[3, 1]], [[7, 1]])
    result = checked(problem, optimize_paths(problem, np.stack([above, below])))
    assert result.valid.all() and result.costs[1] < result.costs[0]
    np.testing.assert_array_equal(result.path, result.paths[1])


def interrupt_after(calls, name, monkeypatch):
    """Ctrl-C in place of a call of a function of the module, after some."""
    function, made = getattr(driver, name), []

    def interrupted(*arguments):
        made.append(arguments)
        if len(made) == calls + 1:
            raise KeyboardInterrupt
        return function(*arguments)

    monkeypatch.setattr(driver, name, interrupted)


@pytest.mark.parametrize("calls", [0, 1, 3])
def test_an_interrupted_descent_gives_valid_paths_as_far_as_it_came(calls, monkeypatch):
    whole = optimize_paths(SWAP, detour(), **QUICK)
    interrupt_after(calls, "advance", monkeypatch)
    with pytest.warns(OptimizationInterrupted, match="best found so far"):
        result = optimize_paths(SWAP, detour(), **QUICK)
    done = 50 * calls
    np.testing.assert_array_equal(result.history[0, done:], np.nan)
    assert np.isfinite(result.history[0, :done]).all()
    result = checked(SWAP, replace(result, history=result.history[:, :done]))
    before = path_cost(SWAP, detour())
    assert result.valid.all()
    assert whole.cost < result.cost <= before * (1 + 1e-12)


def test_interrupted_between_two_paths_the_second_stays_as_it_was(monkeypatch):
    paths = np.stack([detour(), detour() * [[[1]], [[0.9]], [[1.1]], [[1]]]])
    interrupt_after(1, "_better", monkeypatch)
    with pytest.warns(OptimizationInterrupted):
        result = optimize_paths(SWAP, paths, **ONE_GUESS)
    assert result.valid.all() and result.costs[0] < 0.9 * path_cost(SWAP, paths[0])
    assert result.costs[1] == pytest.approx(path_cost(SWAP, paths[1]), rel=1e-12)


def test_where_walls_are_many_way_points_are_joined_by_descents_first():
    problem = scenes.maze()
    points = [problem.starts[0], *problem.workspace.sample_free(3, seed=1), problem.goals[0]]
    crossing = np.stack(points)[:, None]
    assert not checked(problem, optimize_paths(problem, crossing, **QUICK)).valid.any()
    legs = [
        descend(lambda x: np.zeros(len(x)), problem.workspace, a[None], b).paths[0]
        for a, b in itertools.pairwise(points)
    ]
    joined = np.concatenate([problem.starts, *(leg[1:] for leg in legs)])[:, None]
    result = checked(problem, optimize_paths(problem, joined, **QUICK))
    assert result.valid.all() and result.cost < 0.95 * path_cost(problem, joined)


@pytest.mark.parametrize("num_iterations", [1, 7, 50, 51, 130])
def test_iterations_in_parts_are_all_of_them(num_iterations):
    progress = np.linspace(0, 1, num_iterations, dtype=np.float32)
    parts = driver._parts(progress)
    np.testing.assert_array_equal(parts[parts <= 1], progress)
    assert parts.size - num_iterations < len(parts) and parts.shape[1] <= 50
