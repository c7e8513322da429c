"""Half a turn goes counterclockwise, whatever rounding made of it, for all who ask which way a robot turns."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plr_jax import BLOptions, PointRobot, PolygonRobot, Problem, Workspace, bl_plan, path_cost, validate
from plr_jax.collision.team import motions_apart
from plr_jax.collision.walls import MotionTest
from plr_jax.optimize.trajectory.scaled_problem import subdivided, unwrapped
from plr_jax.planners import Stats, Status
from plr_jax.planners._solution import solution_of
from plr_jax.plot._paths import timeline
from plr_jax.robots.robot import shorter_turn, smaller_angle

HAND = PolygonRobot([(0, -0.05), (3, -0.05), (3, 0.05), (0, 0.05)])  # about its left end
NOWHERE = np.zeros((0, 1, 3))

headings = st.floats(-100, 100)
ulps = st.integers(-64, 64)
sides = st.sampled_from([-1, 1])
wraps = st.sampled_from(
    [
        lambda theta: theta,
        lambda theta: theta % (2 * np.pi),
        lambda theta: np.remainder(theta + np.pi, 2 * np.pi) - np.pi,
        lambda theta: np.arctan2(np.sin(theta), np.cos(theta)),
        lambda theta: theta + 34 * np.pi,
    ]
)


def half_turn_from(theta, side, k):
    """The heading on the other side, so many of the last digits off."""
    return theta + side * np.pi + k * np.spacing(abs(theta) + np.pi)


@given(headings, sides, ulps, wraps, wraps)
def test_rounding_and_wrapping_never_change_the_way(theta, side, k, wrap, wrap_other):
    ends = np.array([[wrap(theta)], [wrap_other(half_turn_from(theta, side, k))]])
    for first, last in (ends, ends[::-1]):
        assert shorter_turn(first, last)[0] == pytest.approx(np.pi, abs=1e-11)
        assert smaller_angle(first, last)[0] == pytest.approx(np.pi, abs=1e-11)


@given(st.lists(headings, min_size=3, max_size=3), sides, ulps)
def test_the_angle_is_a_metric_and_the_size_of_the_turn(thetas, side, k):
    for a, b, c in (np.array(thetas), np.array([thetas[0], half_turn_from(thetas[0], side, k), thetas[1]])):
        ab, bc, ac = smaller_angle(np.array([a, b, a]), np.array([b, c, c]))
        assert ab == smaller_angle(np.array([b]), np.array([a]))[0] and 0 <= ab <= np.pi
        assert ac <= ab + bc + 1e-12
        assert abs(shorter_turn(np.array([a]), np.array([b]))[0]) == pytest.approx(ab, abs=1.3e-9)


def posted(theta, goal, ahead):
    """A hand that turns half around, with a small obstacle in its way if it goes through a heading."""
    x, y = 2 * np.cos(ahead), 2 * np.sin(ahead)
    post = [(x - 0.1, y - 0.1), (x + 0.1, y - 0.1), (x + 0.1, y + 0.1), (x - 0.1, y + 0.1)]
    return Problem(Workspace(((-4, -4), (4, 4)), [post]), [HAND], [(0, 0, theta)], [(0, 0, goal)])


@given(headings, sides, ulps)
@settings(max_examples=8)
def test_all_turn_the_same_way(theta, side, k):
    goal = half_turn_from(theta, side, k)
    path = np.array([[(0, 0, theta)], [(0, 0, goal)]])
    middle = theta + np.pi / 2
    for ahead, free in ((middle, False), (theta - np.pi / 2, True)):
        problem = posted(theta, goal, ahead)
        assert validate(problem, path).valid == free
        assert MotionTest(problem.workspace, HAND)(path[0], path[1])[0] == free
        post = np.array([[2 * np.cos(ahead), 2 * np.sin(ahead), 0]])
        assert motions_apart(HAND, path[0], path[1], PointRobot(), post, post, 0.0)[0] == free
    solution = solution_of(problem, path, 0.0, Status.SOLVED, Stats(0), NOWHERE)
    motion = timeline(problem, path)
    assert solution.path_at(solution.makespan / 2)[0, 2] == pytest.approx(middle)
    assert motion.at(np.array([motion.duration / 2]))[0, 0, 2] == pytest.approx(middle)
    assert subdivided(problem, path, 3)[1, 0, 2] == pytest.approx(middle)
    assert unwrapped(path)[1, 0, 2] == pytest.approx(theta + np.pi)
    assert path_cost(problem, path) == pytest.approx(HAND.circumscribed_radius * np.pi, rel=1e-9)


@pytest.mark.parametrize(("y", "theta", "k"), [(9.6, -3.141092653589793, -3), (0.4, 0.0005, 1)])
def test_a_planned_half_turn_is_valid(y, theta, k):
    """Beside a wall, where the hand has room for one of the two ways."""
    start, goal = (5.0, y, theta), (5.0, y, half_turn_from(theta, -1, k))
    problem = Problem(Workspace(((0, 0), (10, 10))), [HAND], [start], [goal])
    primitives = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 4)]
    solution = bl_plan(problem, None, BLOptions(step=2.5, primitives=primitives))
    assert solution.solved and validate(problem, solution.path).valid
