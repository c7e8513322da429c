"""Replanning for teams on their way, and teams that get new goals; an independent test checks all paths."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from planner_helpers import ROOM, TRIO

from plr_jax import DiscRobot, Problem, Workspace, scenes, validate
from plr_jax._problem import motion_costs
from plr_jax.planners import BLOptions, Solution, Status, bl_plan, lifelong, replan, replanning

HALLS = Workspace(((0, 0), (10, 6)), [shapely.box(4, 1, 6, 2.5), shapely.box(4, 3.5, 6, 5)])


def at_time(problem, solution, at, goals=None, workspace=None):
    goals = problem.goals if goals is None else goals
    return Problem(workspace or problem.workspace, problem.robots, solution.path_at(at), goals)


def assert_solves(problem, solution):
    assert solution.path is not None and validate(problem, solution.path).valid
    assert solution.cost == pytest.approx(validate(problem, solution.path).cost)


@pytest.mark.parametrize("problem", [scenes.crowd(4), TRIO], ids=["crowd", "mixed"])
def test_unchanged_problem_keeps_rest_of_path(problem):
    solution = bl_plan(problem)
    at = 0.37 * solution.makespan
    now = at_time(problem, solution, at)
    rest = replan(now, solution, at)
    assert_solves(now, rest)
    assert rest.makespan == pytest.approx(solution.makespan - at)
    times = np.linspace(0, rest.makespan, 20)[:-1]
    np.testing.assert_allclose(rest.path_at(times)[..., :2], solution.path_at(at + times)[..., :2], atol=1e-9)
    done = replan(at_time(problem, solution, 1e6), solution, 1e6)
    assert done.cost == 0 and done.makespan == 0


@pytest.mark.parametrize(("problem", "goal"), [(TRIO, (7, 4)), (scenes.four_rooms(4), (4.28, 5.21))])
def test_new_goal_of_one_robot_keeps_other_paths(problem, goal):
    solution, goals = bl_plan(problem), problem.goals.copy()
    goals[0, :2] = goal
    at = 0.37 * solution.makespan
    now = at_time(problem, solution, at, goals)
    found, rest = replan(now, solution, at), replan(at_time(problem, solution, at), solution, at)
    assert_solves(now, found)
    assert found.stats.found_by == "replan"
    if problem is TRIO:  # no other robot has to make way
        costs = [motion_costs(now, each.path[:-1], each.path[1:]).sum(axis=0) for each in (found, rest)]
        assert costs[0][1:] == pytest.approx(costs[1][1:]) and costs[0][0] != pytest.approx(costs[1][0])


def test_robots_go_around_new_obstacle():
    problem = Problem(HALLS, [DiscRobot(0.4)] * 2, [(1, 3), (1, 5.5)], [(9, 3), (9, 5.5)])
    solution = bl_plan(problem)
    closed = HALLS.with_obstacles(add=[shapely.box(4.9, 2.5, 5.1, 3.5)])
    now = at_time(problem, solution, 1.0, workspace=closed)
    found = replan(now, solution, 1.0)
    assert_solves(now, found)
    assert found.stats.found_by == "replan" and found.cost > solution.cost


def test_exchanged_goals_are_reached():
    problem = Problem(ROOM, [DiscRobot(0.4)] * 2, [(1, 2), (1, 4)], [(9, 2), (9, 4)])
    solution = bl_plan(problem)
    now = at_time(problem, solution, 7.9, goals=problem.goals[::-1])
    assert_solves(now, replan(now, solution, 7.9))


def test_standing_robot_does_not_move(monkeypatch):
    problem = Problem(HALLS, [DiscRobot(0.4)] * 2, [(1, 3), (9, 3)], [(9, 3), (1, 3)])
    solution = bl_plan(problem)
    before = Problem(HALLS, [DiscRobot(0.4)] * 2, [(1, 3), (5, 3)], [(9, 3), (5, 3)])
    path = np.stack([before.starts, before.goals])
    assert not validate(before, path).valid
    under_way = replace_path(solution, path)
    found = replan(before, under_way, 0.0, standing=[1])
    assert_solves(before, found)
    assert found.path is not None
    assert (found.path[:, 1] == before.starts[1]).all() and found.cost > 8.5
    hall = Workspace(((0, 0), (4, 1)))
    problem = Problem(hall, [DiscRobot(0.4)] * 2, [(0.5, 0.5), (2, 0.5)], [(3.5, 0.5), (2, 0.5)])
    monkeypatch.setattr(replanning, "_MOST_STATES", 500)
    stuck = replan(problem, replace_path(solution, np.stack([problem.starts, problem.goals])), 0.0, standing=[1])
    assert stuck.path is None and stuck.status is Status.EXHAUSTED


def test_path_above_cost_factor_is_planned_again():
    """A robot goes around the far end of a wall. Around the near end, a point's way is 10 long: a lower bound."""
    room = Workspace(((0, 0), (10, 20)), [shapely.box(5, 0, 5.001, 1), shapely.box(5, 5, 5.001, 18)])
    problem = Problem(room, [DiscRobot(0.1)] * 2, [(1, 8), (1, 1)], [(9, 8), (1, 1)])
    path = np.stack([problem.starts, [(5, 19), (1, 1)], problem.goals])
    under_way = replace_path(bl_plan(problem), path)
    assert validate(problem, path).valid and 2 * np.hypot(4, 11) == pytest.approx(validate(problem, path).cost)
    kept = replan(problem, under_way, 0.0, BLOptions(lower_bound=10.0))
    assert kept.status is Status.SOLVED and kept.lower_bound == 10 and kept.cost > 23
    strict = BLOptions(lower_bound=10.0, cost_factor=1.1)
    beside = replan(problem, under_way, 0.0, strict, standing=[1])
    assert beside.status is Status.EXHAUSTED and beside.cost == kept.cost
    again = replan(problem, under_way, 0.0, strict)
    assert_solves(problem, again)
    assert again.status is Status.SOLVED and 10 <= again.cost <= 11 and again.lower_bound == 10
    # If the planner reaches a limit without a path, the path that costs too much is returned.
    limited = BLOptions(("lacam",), lower_bound=10.0, cost_factor=1.1, max_expansions=1)
    late = replan(problem, under_way, 0.0, limited)
    assert late.cost == kept.cost and late.status is Status.EXPANSION_LIMIT


def replace_path(solution, path):
    """Return a solution with another path, which need not be valid."""
    times = np.append(0.0, np.cumsum(np.hypot(*np.moveaxis(np.diff(path, axis=0), 2, 0)).max(axis=1)))
    return Solution(path, 1.0, float(times[-1]), 0.0, Status.SOLVED, solution.stats, solution.samples, times=times)


def test_invalid_replan_arguments_raise():
    problem = scenes.four_rooms(2)
    solution = bl_plan(problem)
    broken = solution.path.copy()
    broken[1, 0, 0] = np.nan
    for arguments, message in (
        ((problem, solution, 2.0), "starts must be where the solution has the robots"),
        ((problem, solution, -1.0), "at must be a finite time of at least 0"),
        ((scenes.four_rooms(3), solution, 0.0), "must be for the problem's robots"),
        ((problem, solution.path, 0.0), "must be a Solution that has a path"),
        ((problem, replace(solution, path=broken), 0.0), "must have a finite path"),
        ((problem, solution, 0.0, BLOptions(), [1]), "its goal must be its start"),
        ((problem, solution, 0.0, BLOptions(), [2]), "indices of the 2 robots"),
    ):
        with pytest.raises(ValueError, match=message):
            replan(*arguments)


def test_replan_past_time_limit_returns_no_path():
    problem = Problem(ROOM, [DiscRobot(0.4)] * 2, [(1, 2), (1, 6)], [(9, 2), (9, 6)])
    solution = bl_plan(problem)
    now = at_time(problem, solution, 3.0, goals=[(1, 8), (9, 6)])
    late = replan(now, solution, 3.0, BLOptions(time_limit=1e-9))
    assert late.path is None and late.status is Status.TIME_LIMIT


# Goals that keep coming


def stream(problem, seed=0):
    """Return a function that gives random free goals, clear of the goals of other robots."""
    rng, size = np.random.default_rng(seed), max(robot.circumscribed_radius for robot in problem.robots)

    def next_goal(i, others):
        while True:
            goal = np.append(
                rng.uniform(problem.workspace.bounds.lo, problem.workspace.bounds.hi), rng.uniform(-3, 3)
            )
            apart = np.hypot(*(others[:, :2] - goal[:2]).T).min() > 2 * size + 0.1
            if apart and problem.workspace.clearance(goal[None, :2])[0] > size + 0.05:
                return goal[: problem.dof]

    return next_goal


def assert_served(problem, run, num_goals):
    assert run.status is Status.SOLVED and len(run.robots) == len(run.rows) == len(run.goals) >= num_goals
    report = validate(run.problem, run.path)
    assert report.valid, report.message
    np.testing.assert_array_equal(run.path[0], problem.starts)
    assert (np.diff(run.rows) >= 0).all() and len(run.times) == len(run.path)
    for i, row, goal in zip(run.robots.tolist(), run.rows.tolist(), run.goals, strict=True):
        dof = problem.robots[i].dof
        np.testing.assert_array_equal(run.path[row, i, :dof], goal[:dof])


@pytest.mark.parametrize(
    ("problem", "num_goals"),
    [
        pytest.param(scenes.crowd(4), 4, id="crowd-4"),
        pytest.param(TRIO, 3, id="mixed"),
        pytest.param(scenes.crowd(8), 24, id="crowd-8", marks=pytest.mark.full),
    ],
)
def test_lifelong_serves_goals_on_a_valid_path(problem, num_goals):
    run = lifelong(problem, stream(problem), num_goals)
    assert_served(problem, run, num_goals)
    assert np.bincount(run.robots, minlength=len(problem.robots)).min() > 0


def test_lifelong_with_other_planner_plans_from_nothing():
    problem = scenes.crowd(4)
    run = lifelong(problem, stream(problem), 3, plan=bl_plan)
    assert_served(problem, run, 3)
    assert run.num_from_nothing == 1 + len(run.seconds)


def test_lifelong_runs_repeat():
    problem = Problem(HALLS, [DiscRobot(0.4)] * 2, [(1, 3), (1, 5)], [(9, 3), (9, 5)])
    first, second = (lifelong(problem, stream(problem), 3) for _ in range(2))
    np.testing.assert_array_equal(first.path, second.path)


def test_lone_robot_goes_straight_to_each_goal():
    problem = Problem(Workspace(((0, 0), (10, 10))), [DiscRobot(0.3)], [(1, 1)], [(9, 1)])
    corners = iter([(9, 9), (1, 9), (1, 1), (9, 1)] * 2)
    run = lifelong(problem, lambda i, others: next(corners), 5)
    assert_served(problem, run, 5)
    np.testing.assert_allclose(run.times[run.rows], 8.0 * np.arange(1, 6))


BAYS = Workspace(((0, 0), (6, 3)), [shapely.box(0, 1.2, 2, 3), shapely.box(4, 1.2, 6, 3)])
HALL = Workspace(((0, 0), (8, 2)))  # discs can pass one another, but only if both make way


@pytest.mark.parametrize(
    ("room", "ends", "num_goals", "fewest"),
    [(BAYS, [(0.6, 0.6), (5.4, 0.6)], 8, 3), (HALL, [(1, 1), (7, 1)], 5, 2)],
)
def test_goals_taken_by_other_robots_are_served_later(room, ends, num_goals, fewest):
    """Two robots want to be where the other one is, over and over."""
    problem, side = Problem(room, [DiscRobot(0.4)] * 2, ends, ends[::-1]), [1, 0]

    def next_goal(i, others):
        side[i] = 1 - side[i]
        return ends[side[i]]

    run = lifelong(problem, next_goal, num_goals)
    assert_served(problem, run, num_goals)
    assert np.bincount(run.robots).min() >= fewest and (room is BAYS or run.num_from_nothing > 1)


def test_robot_that_stays_at_its_goal_is_served_when_another_arrives():
    problem = Problem(Workspace(((0, 0), (10, 10))), [DiscRobot(0.4)] * 2, [(1, 1), (3, 9)], [(2, 1), (1, 9)])
    places = {0: [(2, 1)], 1: [(3, 9), (1, 9)]}
    for plan in (None, bl_plan):
        run = lifelong(problem, lambda i, others: places[i][0] if i == 0 else places[i].pop(0), 4, plan=plan)
        places[1] = [(3, 9), (1, 9)]
        np.testing.assert_array_equal(run.robots, [0, 0, 1, 0, 1])
        np.testing.assert_allclose(run.times[run.rows], [1, 2, 2, 4, 4])


def test_interrupted_lifelong_returns_its_path():
    problem, calls = scenes.crowd(4), iter(range(5))

    def next_goal(i, others):
        if next(calls) == 4:
            raise KeyboardInterrupt
        return goals(i, others)

    goals = stream(problem)
    run = lifelong(problem, next_goal, 50)
    assert run.status is Status.INTERRUPTED and 5 <= len(run.robots) < 50
    assert validate(run.problem, run.path).valid


def test_invalid_lifelong_goals_raise():
    problem = scenes.four_rooms(2)
    with pytest.raises(ValueError, match="num_goals must be an integer >= 1"):
        lifelong(problem, stream(problem), 0)
    with pytest.raises(ValueError, match=r"next goal of robot \d must be numbers of shape \(2,\), got shape \(\)"):
        lifelong(problem, lambda i, others: 1.0, 9)
    with pytest.raises(ValueError, match="outside the bounds"):
        lifelong(problem, lambda i, others: (50, 50), 9)
