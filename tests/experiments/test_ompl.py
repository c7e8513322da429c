"""Baselines of OMPL: compiled tests of motions against the package's own, and the paths they return."""

import numpy as np
import pytest
from robot_helpers import random_motions

from experiments.baselines import ompl as ompl_module
from experiments.baselines.ompl import Done, Found, ompl_plan, task_of
from plr_jax import DiscRobot, PointRobot, Problem, RectangleRobot, Workspace, validate
from plr_jax.collision.motions import motions_apart
from plr_jax.collision.walls import MotionTest
from plr_jax.planners import Status

pytestmark = pytest.mark.full

pytest.importorskip("ompl.base", reason="OMPL baselines: pip install 'plr-jax[baselines]'")
motions = pytest.importorskip("experiments.baselines.ompl_motions", reason="OMPL baselines need numba")

BOX, WEDGE = [(2.0, 2.0), (3.0, 2.0), (3.0, 3.0), (2.0, 3.0)], [(0.5, 3.0), (1.2, 4.0), (0.2, 4.2)]
WORKSPACE, DISC, POINT = Workspace(((0, 0), (5, 5)), [BOX]), DiscRobot(0.3), PointRobot()
TEAMS = {
    "discs": [DISC, DiscRobot(0.15), POINT],
    "mixed": [DISC, RectangleRobot(0.9, 0.3), POINT, RectangleRobot(0.5, 0.4)],
}


def problem_of(*robots, workspace=WORKSPACE):
    """Robots along the bottom, to be moved to the top in reversed order."""
    turns = any(isinstance(robot, RectangleRobot) for robot in robots)
    starts, goals = np.zeros((2, len(robots), 3 if turns else 2))
    starts[:, 0] = goals[::-1, 0] = np.linspace(0.5, 4.5, len(robots))
    starts[:, 1], goals[:, 1] = 0.5, 4.5
    return Problem(workspace, robots, starts, goals)


def scene_of(problem):
    task = task_of(problem, "RRTConnect", 0, 1.0, None)
    return motions.Scene(task.sizes, task.walls, task.tolerance)


@pytest.mark.parametrize("team", TEAMS)
@pytest.mark.parametrize("step", [0.0, 0.3, 1.2])
def test_compiled_motion_tests_equal_the_packages_own(team, step):
    problem = problem_of(*TEAMS[team], workspace=Workspace(((0, 0), (5, 5)), [BOX, WEDGE]))
    robots, workspace, rng, n = problem.robots, problem.workspace, np.random.default_rng(7), 2000
    moved = [random_motions(rng, n, 5.0, step, min(step, 2.5)) for _ in robots]
    q0, q1 = (np.stack([motion[end] for motion in moved], axis=1) for end in (0, 1))
    scene = scene_of(problem)
    got = np.array([motions.is_motion_free(a, b, scene.address) for a, b in zip(q0, q1, strict=True)])
    expected = np.ones(n, dtype=bool)
    for i, robot in enumerate(robots):
        expected &= workspace.is_free(q0[:, i, :2]) & MotionTest(workspace, robot)(q0[:, i], q1[:, i])
        for j in range(i):
            both = (robots[j], q0[:, j], q1[:, j])
            expected &= motions_apart(robot, q0[:, i], q1[:, i], *both, workspace.tolerance)
    assert 5 < expected.sum() < n - 5
    assert not (got & ~expected).any()
    # Near contact with a turning rectangle, the kernel may refuse.
    assert (expected & ~got).sum() <= (2 if team == "mixed" else 0)


def test_rectangle_and_disc_change_sides():
    """With headings beyond half a turn, as users have them; the disc's is arbitrary."""
    workspace = Workspace(((0, 0), (6, 4)), [[(2.8, 0), (3.2, 0), (3.2, 2.4), (2.8, 2.4)]])
    starts, goals = [(1.2, 1.0, 3.5), (5.0, 1.0, 0.0)], [(4.8, 1.0, 7.0), (1.0, 1.0, 9.0)]
    problem = Problem(workspace, [RectangleRobot(1.6, 0.4), DISC], starts, goals)
    solution = ompl_plan(problem, "RRTConnect", seed=2, time_limit=30.0, cost_target=40.0)
    report = validate(problem, solution.path)
    assert report.valid and solution.status is Status.SOLVED, report.message
    np.testing.assert_array_equal(solution.path[[0, -1]], [problem.starts, problem.goals])
    assert solution.lower_bound < solution.cost == pytest.approx(report.cost, rel=1e-12) and solution.cost <= 40
    assert solution.stats.history[-1][1] == solution.cost


def test_invalid_paths_are_dropped():
    walls = Workspace(((0, 0), (10, 10)), [[(4, 0), (6, 0), (6, 6), (4, 6)]])
    problem = Problem(walls, [POINT], [(1, 1)], [(9, 1)])
    middles = (5, 1), (5, 9.1), (5, 9.9)
    through, over, far_over = (np.array([[(1, 1, 0)], [(*at, 0)], [(9, 1, 0)]], float) for at in middles)

    def found(*paths):
        messages = [Found(float(seconds), path) for seconds, path in enumerate(paths)]
        messages = [*messages, Done(True, 9.0, np.zeros((4, 1, 3)), 10, 6)]
        with pytest.warns(UserWarning, match="is not valid and was dropped: Robot 0 collides with obstacle 0"):
            return ompl_module._solution(problem, "RRTstar", messages)

    solution = found(far_over, over, through)
    assert [seconds for seconds, _ in solution.stats.history] == [0.0, 1.0]
    np.testing.assert_array_equal(solution.path, over[..., :2])
    assert found(through).status is Status.TIME_LIMIT
