"""Optimized paths: short where the shortest is known, never invalid, never costlier, never under way for longer."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plr_jax import (
    DiscRobot,
    Euclidean,
    PointRobot,
    Problem,
    RectangleRobot,
    VisibilityGraph,
    Workspace,
    bl_plan,
    construct,
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
ALONE = Problem(ROOM, [PointRobot()], [[1, 1]], [[9, 8]])
PAST = Problem(BOX, [PointRobot()], [[1, 4.5]], [[9, 4.5]])
# Descents run 50 iterations at a time: multiples of it, and as many guesses, share what is compiled.
QUICK = {"num_retimings": 1, "num_iterations": 200}
ONE_GUESS = {"num_retimings": 0, "num_iterations": 200}


def through(problem, *rows):
    """A path from the starts through some rows to the goals."""
    return np.stack([problem.starts, *(np.array(row, dtype=float) for row in rows), problem.goals])


DETOUR = through(SWAP, [[2, 8], [8, 2]], [[8, 8], [2, 2]])  # with much room between the discs
TWO_DETOURS = np.stack([DETOUR, DETOUR * [[[1]], [[0.9]], [[1.1]], [[1]]]])
BELOW, ABOVE = through(PAST, [[3, 1]], [[7, 1]]), through(PAST, [[3, 9]], [[7, 9]])


def optimized(problem, paths, **options):
    """The result, its claims verified."""
    result = optimize_paths(problem, paths, **options)
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
    interrupted = np.isnan(result.history).all(axis=0)
    assert np.isfinite(result.history[:, ~interrupted]).all() and (np.diff(interrupted.astype(int)) >= 0).all()
    for guess, after in zip(np.reshape(paths, (-1, *np.shape(paths)[-3:])), result.paths, strict=True):
        before = validate(problem, guess)
        if before.valid:
            assert validate(problem, after).valid and path_cost(problem, after) <= before.cost * (1 + 1e-12)
            longest = makespan(problem, guess) * options.get("makespan_factor", 1)
            assert makespan(problem, after) <= longest * (1 + 1e-12)
    return result


# --- how short -------------------------------------------------------------------------------------------


def test_in_an_empty_room_a_jagged_path_becomes_a_straight_line():
    result = optimized(ALONE, through(ALONE, *np.random.default_rng(0).uniform(0, 10, (12, 1, 2))))
    assert result.cost == pytest.approx(np.hypot(8, 7), rel=1e-4)
    assert repr(result) == "OptimizedPaths(1 of 1 valid, cost 10.63, makespan 10.63)"
    shortest_already = optimized(ALONE, through(ALONE))
    assert shortest_already.cost == pytest.approx(np.hypot(8, 7), rel=1e-12)


def test_robots_that_stay_where_they_are():
    problem = Problem(ROOM, SWAP.robots, SWAP.starts, SWAP.starts)
    result = optimized(problem, SWAP.starts[None], **QUICK)
    assert result.valid.all() and result.cost == 0


@pytest.mark.parametrize("robot, corner", [(PointRobot(), 0.0), (DiscRobot(0.5), 0.5)])
def test_past_one_obstacle_a_path_becomes_two_tangents(robot, corner):
    result = optimized(Problem(BOX, [robot], PAST.starts, PAST.goals), BELOW)
    # By symmetry: a tangent to the circle about the corner (4, 3), an arc, and straight on to the middle.
    away, below = np.hypot(3, 1.5), np.arctan2(1.5, 3)
    turn = below + np.arcsin(corner / away)
    exact = 2 * (np.sqrt(away**2 - corner**2) + corner * turn + 1)
    assert exact - 1e-6 <= result.cost <= 1.001 * exact


def test_of_a_batch_the_cheapest_valid_path_is_returned():
    result = optimized(PAST, np.stack([ABOVE, BELOW]))
    assert result.valid.all() and result.costs[1] < result.costs[0]
    np.testing.assert_array_equal(result.path, result.paths[1])


def test_far_from_the_origin_paths_are_as_good():
    """Also where 32-bit floats do not hold the middle of the workspace: they are 0.5 apart at 4.2e6."""
    shift = np.array([500_000.4, 4_200_000.2])
    there = Workspace((shift, shift + 10), [np.array([(4, 3), (6, 3), (6, 7), (4, 7)]) + shift])
    far = Problem(there, PAST.robots, PAST.starts + shift, PAST.goals + shift)
    cost = optimize_paths(PAST, BELOW).cost
    assert optimized(far, BELOW + shift).cost == pytest.approx(cost, rel=1e-3)


def test_two_discs_swap_places_almost_straight():
    result = optimized(SWAP, DETOUR, num_retimings=1)
    # Neither can do better than to swerve by a radius where they meet.
    assert 12 < result.cost <= 1.003 * 4 * np.hypot(3, 0.5) < 0.6 * path_cost(SWAP, DETOUR)


def test_a_rectangle_turns_no_more_than_it_must():
    problem = Problem(ROOM, [RectangleRobot(2, 0.5)], [[2, 2, 3.0]], [[8, 3, -3.0]])
    result = optimized(problem, through(problem, [[4, 6, -2.5]], [[6, 1, 3.1]]))
    turn = 2 * np.pi - 6.0
    assert result.cost == pytest.approx(np.hypot(6, 1) + turn * problem.rotation_weights[0], rel=1e-3)


def test_rectangles_and_a_disc_that_waits_stay_valid_and_turns_take_time():
    robots = [RectangleRobot(1.5, 0.4), DiscRobot(0.4)]
    problem = Problem(BOX, robots, [[2, 2, 0], [8, 2, 0]], [[8, 2.5, 1], [2, 2.5, 0]], rotation_weight=2.0)
    path = through(problem, [[2, 2, 0.6], [8, 0.6, 0]], [[5, 2.2, 0], [8, 0.6, 0]], [[8, 2.5, 1], [2, 0.6, 0]])
    assert validate(problem, path).valid
    result = optimized(problem, path, **QUICK)
    assert result.cost < 0.9 * path_cost(problem, path)


@given(st.integers(0, 10_000), st.integers(0, 12))
@settings(max_examples=4, deadline=None)
def test_a_valid_path_stays_valid_and_becomes_no_costlier(seed, steps):
    rng = np.random.default_rng(seed)
    tame = DETOUR + rng.normal(0, 0.3, (4, 2, 2)) * [[[0]], [[1]], [[1]], [[0]]]
    wild = np.concatenate([DETOUR[:2], rng.uniform(0.5, 9.5, (steps, 2, 2)), DETOUR[2:]])
    for path in (tame, wild):
        optimized(SWAP, path, num_retimings=1, num_iterations=50, seed=seed)


# --- how long under way ----------------------------------------------------------------------------------


def test_a_team_takes_more_time_only_if_it_may():
    """Three discs change rooms; if time costs nothing, they wait for one another at the doors."""
    problem = scenes.four_rooms(3)
    path = bl_plan(problem, sum_of_distances(robot_distance_fns(problem))).path
    kept, some, free = (
        optimized(problem, path, num_retimings=7, num_iterations=300, makespan_factor=factor)
        for factor in (1, 1.05, np.inf)
    )
    assert free.makespan > 1.1 * makespan(problem, path)
    # Time that robots may not take costs them next to nothing.
    assert kept.cost < 1.002 * free.cost and kept.cost < path_cost(problem, path) and some.cost < 1.002 * free.cost


def test_each_path_of_a_batch_has_its_own_time():
    """In the second, the robots make the same detours one after the other, which takes twice as long."""
    problem = Problem(ROOM, SWAP.robots, [[2, 2], [2, 8]], [[8, 2], [8, 8]])
    b, (c, d), at_once = problem.starts[1], problem.goals, [[5, 4], [5, 6]]
    together = through(problem, at_once, [c, d], [c, d])
    in_turn = through(problem, [[5, 4], b], [c, b], [c, [5, 6]])
    given = np.stack([together, in_turn])
    before = np.array([makespan(problem, path) for path in given])
    assert before[1] == pytest.approx(2 * before[0])
    result = optimized(problem, given, **ONE_GUESS)
    np.testing.assert_allclose(result.costs, 12, rtol=1e-3)
    assert result.makespans[1] > 1.2 * before[0]


def test_a_guess_that_is_not_valid_may_take_any_time():
    """It is shorter than every path around the box."""
    straight = through(PAST, [[4.2, 3.1]], [[5.8, 3.1]])
    assert not validate(PAST, straight).valid
    result = optimized(PAST, np.stack([straight, through(PAST, [[4.5, 2.9]], [[5.5, 2.9]])]))
    assert result.valid[0] and result.makespans[0] > makespan(PAST, straight)


# --- options ---------------------------------------------------------------------------------------------


def test_wide_margins_are_kept_where_there_is_room():
    assert validate(SWAP, optimized(SWAP, DETOUR, margin=0.2, **QUICK).path).clearance > 0.15


def test_smoothness_makes_bends_wider():
    sharp, smooth = (optimized(PAST, BELOW, smoothness=weight).path for weight in (0.0, 30.0))
    sharpest, smoothest = (np.abs(np.diff(each, 2, axis=0)).max() for each in (sharp, smooth))
    assert smoothest < 0.7 * sharpest


def test_a_batch_is_optimized_as_its_paths_are_one_by_one_and_again():
    together, again = (optimized(SWAP, TWO_DETOURS, **ONE_GUESS) for _ in range(2))
    np.testing.assert_array_equal(together.paths, again.paths)
    for path, cost in zip(TWO_DETOURS, together.costs, strict=True):
        assert optimized(SWAP, path, **ONE_GUESS).cost == pytest.approx(cost, rel=1e-3)


def test_a_guide_brings_a_guess_around_a_wall():
    wall = Workspace(((0, 0), (10, 10)), [[(4, 0), (4.5, 0), (4.5, 8), (4, 8)]])
    problem = Problem(wall, [PointRobot()], [[1, 4]], [[9, 3]])
    oracle = VisibilityGraph(wall, problem.goals[0])
    plr = construct(oracle, wall.bounds, max_bytes=1024)
    result = optimized(problem, through(problem), distance_fns=[plr], num_iterations=1500)
    assert result.valid.all() and result.cost <= 1.01 * oracle(problem.starts)[0]
    assert not optimized(problem, through(problem), **ONE_GUESS).valid.any()


def test_a_guide_without_a_gradient_at_the_goal_spoils_nothing():
    def straight(x):
        return jnp.linalg.norm(x - PAST.goals[0], axis=1)  # whose gradient at the goal is NaN

    result = optimized(PAST, ABOVE, distance_fns=[straight], **QUICK)
    assert result.cost < 0.95 * path_cost(PAST, ABOVE)


def test_a_guess_too_far_out_for_32_bits_stays_as_it_is():
    result = optimize_paths(SWAP, through(SWAP, [[2, 1e30], [8, 2]]), **QUICK)
    assert not result.valid.any() and np.isfinite(result.paths).all()


# --- where it ends ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def whole():
    return optimize_paths(SWAP, DETOUR, **QUICK)


def test_a_path_in_a_narrow_place_that_bold_steps_leave_is_shortened_by_gentle_ones(monkeypatch, whole):
    gentle, improve = [], driver._improve

    def spoiled(problem, scene, guesses, aims, best, progress):
        if progress[0] == 0:  # the bold descents find nothing
            return True
        gentle.append(progress[0])
        return improve(problem, scene, guesses, aims, best, progress)

    monkeypatch.setattr(driver, "_improve", spoiled)
    shortened = optimize_paths(SWAP, DETOUR, **QUICK)
    assert gentle and validate(SWAP, shortened.path).valid
    assert whole.cost <= shortened.cost < path_cost(SWAP, DETOUR) - 1


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
def test_an_interrupted_descent_gives_valid_paths_as_far_as_it_came(calls, monkeypatch, whole):
    interrupt_after(calls, "advance", monkeypatch)
    with pytest.warns(OptimizationInterrupted, match="best found so far"):
        result = optimized(SWAP, DETOUR, **QUICK)
    np.testing.assert_array_equal(np.isnan(result.history[0]), np.arange(200) >= 50 * calls)
    assert result.valid.all() and whole.cost < result.cost


def test_interrupted_between_two_paths_the_second_stays_as_it_was(monkeypatch):
    interrupt_after(1, "_better", monkeypatch)
    with pytest.warns(OptimizationInterrupted):
        result = optimize_paths(SWAP, TWO_DETOURS, **ONE_GUESS)
    assert result.valid.all() and result.costs[0] < 0.9 * path_cost(SWAP, TWO_DETOURS[0])
    assert result.costs[1] == pytest.approx(path_cost(SWAP, TWO_DETOURS[1]), rel=1e-12)


@pytest.mark.parametrize("num_iterations", [1, 7, 50, 51, 130])
def test_iterations_in_parts_are_all_of_them(num_iterations):
    progress = np.linspace(0, 1, num_iterations, dtype=np.float32)
    parts = driver._parts(progress)
    np.testing.assert_array_equal(parts[parts <= 1], progress)
    assert parts.size - num_iterations < len(parts) and parts.shape[1] <= 50


# --- arguments -------------------------------------------------------------------------------------------

BARS = Problem(ROOM, [RectangleRobot(1.0, 0.5)] * 2, [(1, 1, 0), (1, 4, 0)], [(9, 1, 0), (9, 4, 0)])


def norm_of(dim=None):
    def norm(q):
        return jnp.linalg.norm(q, axis=1)

    if dim is not None:
        norm.dim = dim
    return norm


def test_a_function_sees_as_many_coordinates_as_it_says():
    made = [norm_of(), norm_of(2)]
    fns = driver.differentiable(BARS, made)
    # A trip through JAX, which takes pytrees apart.
    q = jnp.array([[3.0, 4.0, 12.0]])
    np.testing.assert_allclose([jax.jit(lambda fn, q: fn(q))(fn, q)[0] for fn in fns], [13, 5])
    assert jax.tree.structure(fns) == jax.tree.structure(driver.differentiable(BARS, made))


def test_pytrees_are_taken_as_they_are():
    plr = construct(Euclidean((1, 1)), ((0, 0), (10, 10)), max_leaves=4)
    one_array = jax.tree_util.Partial(lambda goal, q: jnp.linalg.norm(q - goal, axis=1), np.zeros(3))
    for fn in (plr, one_array):
        assert driver.differentiable(BARS, [fn, fn]) == (fn, fn)
    assert driver.differentiable(BARS, None) == ()


@pytest.mark.parametrize(
    "problem, path, options, message",
    [
        (SWAP, DETOUR[:, :1], {}, r"Paths must have shape .* = \(2, 2\), .* got \(4, 1, 2\)"),
        (SWAP, DETOUR[0], {}, "Paths must have shape"),
        (SWAP, DETOUR[:0], {}, "at least one guess of one step"),
        (SWAP, "abc", {}, "Paths must be numbers"),
        (SWAP, DETOUR + 0j, {}, "Paths must be numbers"),
        (SWAP, np.ma.masked_greater(DETOUR, 7), {}, "Paths must be numbers .* and some are masked"),
        (SWAP, DETOUR * np.array([1, np.nan, 1, 1])[:, None, None], {}, "Paths must be finite; path 0"),
        (SWAP, DETOUR[::-1], {}, "Path 0 must have the problem's starts as its first row"),
        (SWAP, DETOUR[:-1], {}, "Path 0 must have the problem's goals as its last row"),
        *((SWAP, DETOUR, options, message) for options, message in (
        ({"num_retimings": -1}, "num_retimings must be an integer >= 0, got -1"),
        ({"num_iterations": 0}, "num_iterations must be an integer >= 1, got 0"),
        ({"seed": -1}, "seed must be an integer >= 0, got -1"),
        ({"margin": 0.0}, "margin must be a positive finite number"),
        ({"margin": np.nan}, "margin must be a positive finite number"),
        *(
            ({"makespan_factor": x}, "makespan_factor must be a number of at least 1")
            for x in (0.99, np.nan, -np.inf)
        ),
        ({"smoothness": -1.0}, "smoothness must be a finite number of at least 0"),
        ({"distance_fns": [jnp.sum]}, "one a robot, 2, got 1"),
        (
            {"distance_fns": [VisibilityGraph(SWAP.workspace, [8, 5])] * 2},
            r"distance_fns\[0\] must be a function that JAX",
        ),
        ({"distance_fns": [jnp.sum] * 2}, r"points \(n, dim\) to distances \(n,\), got \(\)"),
        )),
        *((BARS, through(BARS), {"distance_fns": [norm_of(), norm_of(dim)]},
           rf"distance_fns\[1\] takes {dim} coordinates, configurations have 3") for dim in (0, 4)),
    ],
)  # fmt: skip
def test_other_arguments_are_refused(problem, path, options, message):
    with pytest.raises(ValueError, match=message):
        optimize_paths(problem, path, **options)
