"""Goals that keep coming: all that a team does is checked independently, and goals are where they are said."""

import numpy as np
import pytest
import shapely
from planner_helpers import MIXED

from plr_jax import DiscRobot, Problem, Status, Workspace, bl_plan, lifelong, scenes, validate


def stream(problem, seed=0):
    """Random free goals, clear of those of the others."""
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
    [(scenes.door(6), 12), (scenes.crowd(8), 24), (scenes.four_rooms(4), 10), (MIXED, 9)],
    ids=["door", "crowd", "rooms", "mixed"],
)
def test_goals_are_served_and_all_motions_are_valid(problem, num_goals):
    run = lifelong(problem, stream(problem), num_goals)
    assert_served(problem, run, num_goals)
    assert np.bincount(run.robots, minlength=len(problem.robots)).min() > 0


def test_the_same_goals_are_served_in_the_same_way():
    problem = scenes.crowd(6)
    first, second = (lifelong(problem, stream(problem), 10) for _ in range(2))
    np.testing.assert_array_equal(first.path, second.path)


def test_the_loop_that_plans_from_nothing_serves_goals_as_well():
    problem = scenes.crowd(4)
    run = lifelong(problem, stream(problem), 8, plan=bl_plan)
    assert_served(problem, run, 8)
    assert run.num_from_nothing == 1 + len(run.seconds)


def test_a_lone_robot_goes_from_goal_to_goal_straight_and_at_unit_speed():
    problem = Problem(Workspace(((0, 0), (10, 10))), [DiscRobot(0.3)], [(1, 1)], [(9, 1)])
    corners = iter([(9, 9), (1, 9), (1, 1), (9, 1)] * 2)
    run = lifelong(problem, lambda i, others: next(corners), 5)
    assert_served(problem, run, 5)
    np.testing.assert_allclose(run.times[run.rows], 8.0 * np.arange(1, 6))


def test_goals_that_are_taken_wait_and_goals_that_are_exchanged_are_served():
    """Two robots want to be where the other one is, over and over, in a room with a bay."""
    room = Workspace(((0, 0), (6, 3)), [shapely.box(0, 1.2, 2, 3), shapely.box(4, 1.2, 6, 3)])
    problem = Problem(room, [DiscRobot(0.4)] * 2, [(0.6, 0.6), (5.4, 0.6)], [(5.4, 0.6), (0.6, 0.6)])
    ends = [(0.6, 0.6), (5.4, 0.6)]
    side = [1, 0]

    def next_goal(i, others):
        side[i] = 1 - side[i]
        return ends[side[i]]

    run = lifelong(problem, next_goal, 8)
    assert_served(problem, run, 8)
    assert np.bincount(run.robots).min() >= 3


def test_it_ends_when_interrupted_with_what_was_done():
    problem, calls = scenes.crowd(4), iter(range(5))

    def next_goal(i, others):
        if next(calls) == 4:
            raise KeyboardInterrupt
        return goals(i, others)

    goals = stream(problem)
    run = lifelong(problem, next_goal, 50)
    assert run.status is Status.INTERRUPTED and 5 <= len(run.robots) < 50
    assert validate(run.problem, run.path).valid


def test_what_is_wrong_is_said():
    problem = scenes.crowd(4)
    with pytest.raises(ValueError, match="num_goals must be an integer >= 1"):
        lifelong(problem, stream(problem), 0)
    with pytest.raises(ValueError, match=r"next goal of robot \d must be numbers of shape \(2,\), got shape \(\)"):
        lifelong(problem, lambda i, others: 1.0, 9)
    with pytest.raises(ValueError, match="outside the bounds"):
        lifelong(problem, lambda i, others: (50, 50), 9)
