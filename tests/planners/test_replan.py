"""Teams that are under way, planned from where they are: by the independent check, and what stays as it was."""

from typing import Any, cast

import numpy as np
import pytest
import shapely
from planner_helpers import MIXED, ROOM

from plr_jax import BLOptions, DiscRobot, Problem, Solution, Status, Workspace, bl_plan, replan, scenes, validate

TEAMS = {"door": scenes.door(6), "crowd": scenes.crowd(10), "rooms": scenes.four_rooms(4), "mixed": MIXED}
HALLS = Workspace(((0, 0), (10, 6)), [shapely.box(4, 1, 6, 2.5), shapely.box(4, 3.5, 6, 5)])


@pytest.fixture(scope="module", params=TEAMS)
def under_way(request):
    problem = TEAMS[request.param]
    solution = bl_plan(problem)
    at = 0.37 * solution.makespan
    return problem, solution, at


def at_time(problem, solution, at, goals=None, workspace=None):
    return Problem(
        workspace or problem.workspace,
        problem.robots,
        solution.path_at(at),
        problem.goals if goals is None else goals,
    )


def assert_solves(problem, solution):
    assert solution.path is not None and validate(problem, solution.path).valid
    assert solution.cost == pytest.approx(validate(problem, solution.path).cost)


def test_where_nothing_has_changed_the_rest_of_the_path_is_left(under_way):
    problem, solution, at = under_way
    now = at_time(problem, solution, at)
    rest = replan(now, solution, at)
    assert_solves(now, rest)
    assert rest.makespan == pytest.approx(solution.makespan - at)
    times = np.linspace(0, rest.makespan, 20)[:-1]
    np.testing.assert_allclose(rest.path_at(times)[..., :2], solution.path_at(at + times)[..., :2], atol=1e-9)
    done = replan(at_time(problem, solution, 1e6), solution, 1e6)
    assert done.cost == 0 and done.makespan == 0


def test_a_robot_with_another_goal_is_planned_among_the_others_which_go_on(under_way):
    problem, solution, at = under_way
    goals, size = problem.goals.copy(), max(robot.circumscribed_radius for robot in problem.robots)
    rng, others = np.random.default_rng(0), np.concatenate([problem.goals[1:, :2], problem.goals[:1, :2]])
    while np.hypot(*(others - goals[0, :2]).T).min() < 2 * size + 0.1:
        x = problem.workspace.sample_free(1, int(rng.integers(1_000)))
        if problem.workspace.clearance(x)[0] > size + 0.1:
            goals[0, :2] = x
    now = at_time(problem, solution, at, goals)
    found = replan(now, solution, at)
    assert_solves(now, found)
    if found.stats.found_by == "replan" and len(problem.robots) == 4:  # nobody has to make way for it
        assert found.path is not None
        rest = solution.path[solution.times > at]
        for i in range(1, len(problem.robots)):
            np.testing.assert_array_equal(found.path[-1, i], rest[-1, i])


def test_robots_go_around_what_is_set_down_in_their_way():
    problem = Problem(HALLS, [DiscRobot(0.4)] * 2, [(1, 3), (1, 5.5)], [(9, 3), (9, 5.5)])
    solution = bl_plan(problem)
    closed = HALLS.with_obstacles(add=[shapely.box(4.9, 2.5, 5.1, 3.5)])
    now = at_time(problem, solution, 1.0, workspace=closed)
    found = replan(now, solution, 1.0)
    assert_solves(now, found)
    assert found.stats.found_by == "replan" and found.cost > solution.cost


def test_goals_that_are_exchanged_on_the_way():
    problem = Problem(ROOM, [DiscRobot(0.4)] * 2, [(1, 2), (1, 4)], [(9, 2), (9, 4)])
    solution = bl_plan(problem)
    now = at_time(problem, solution, 7.9, goals=problem.goals[::-1])
    assert_solves(now, replan(now, solution, 7.9))


def test_who_stands_is_gone_around_and_does_not_move():
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
    hall = Workspace(((0, 0), (10, 1)))
    problem = Problem(hall, [DiscRobot(0.4)] * 2, [(1, 0.5), (5, 0.5)], [(9, 0.5), (5, 0.5)])
    stuck = replan(problem, replace_path(solution, np.stack([problem.starts, problem.goals])), 0.0, standing=[1])
    assert stuck.path is None and stuck.status is Status.EXHAUSTED


def replace_path(solution, path):
    """A solution with another path, that need not be valid."""
    times = np.append(0.0, np.cumsum(np.hypot(*np.moveaxis(np.diff(path, axis=0), 2, 0)).max(axis=1)))
    return Solution(path, 1.0, float(times[-1]), 0.0, Status.SOLVED, solution.stats, solution.samples, times=times)


def test_what_is_wrong_is_said():
    problem = scenes.four_rooms(2)
    solution = bl_plan(problem)
    with pytest.raises(ValueError, match="starts must be where the solution has the robots"):
        replan(problem, solution, 2.0)
    with pytest.raises(ValueError, match="at must be a time of at least 0"):
        replan(problem, solution, -1.0)
    with pytest.raises(ValueError, match="must be one for the problem's robots"):
        replan(scenes.four_rooms(3), solution, 0.0)
    with pytest.raises(ValueError, match="must be a Solution that has a path"):
        replan(problem, cast("Any", solution.path), 0.0)
    with pytest.raises(ValueError, match="its goal must be its start"):
        replan(problem, solution, 0.0, standing=[1])
    with pytest.raises(ValueError, match="indices of the 2 robots"):
        replan(problem, solution, 0.0, standing=[2])


def test_past_the_limit_on_time_there_is_no_path():
    problem = Problem(ROOM, [DiscRobot(0.4)] * 2, [(1, 2), (1, 6)], [(9, 2), (9, 6)])
    solution = bl_plan(problem)
    now = at_time(problem, solution, 3.0, goals=[(1, 8), (9, 6)])
    late = replan(now, solution, 3.0, BLOptions(time_limit=1e-9))
    assert late.path is None and late.status is Status.TIME_LIMIT
