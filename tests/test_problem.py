import numpy as np
import pytest

from plr_jax._problem import Problem
from plr_jax._robot import PointRobot
from plr_jax._workspace import Workspace

WALL = [(0.4, 0.0), (0.6, 0.0), (0.6, 0.8), (0.4, 0.8)]
ROOM = Workspace(((0, 0), (1, 1)), [WALL])


POINT = (PointRobot(),)


def problem(starts, goals, robots=POINT):
    return Problem(ROOM, robots, starts, goals)


def test_configurations_become_float64_arrays_that_stay_as_they_are():
    starts = np.array([[0, 1]])
    made = problem(starts, [(0.9, 0.1)])
    assert made.starts.dtype == made.goals.dtype == np.float64
    assert made.starts.shape == made.goals.shape == (1, 2)
    assert made.robots == (PointRobot(),)
    starts[0] = 7
    np.testing.assert_array_equal(made.starts, [[0.0, 1.0]])
    with pytest.raises(ValueError, match="read-only"):
        made.starts[0] = 7.0


def test_boundaries_are_free():
    problem([(0.4, 0.3)], [(1.0, 1.0)])


@pytest.mark.parametrize(
    ("starts", "goals", "message"),
    [
        (
            [(0.43, 0.5)],
            [(0.9, 0.1)],
            r"Robot 0 starts in collision with obstacle 0 at \[0.43, 0.5\] \(clearance -0.03\)",
        ),
        (
            [(0.1, 0.1)],
            [(0.5, 0.7)],
            r"Robot 0 has its goal in collision with obstacle 0 at .*\(clearance -0.1\)",
        ),
        ([(0.1, 1.5)], [(0.9, 0.1)], r"Robot 0 starts outside the bounds: \[0.1, 1.5\]"),
        ([(0.1, 0.1)], [(-1e-6, 0.1)], "Robot 0 has its goal outside the bounds"),
        ([(0.1, np.nan)], [(0.9, 0.1)], "starts must be finite.*robot 0"),
        ([(0.1, 0.1)], [(np.inf, 0.1)], "goals must be finite.*robot 0"),
        ((0.1, 0.1), [(0.9, 0.1)], r"starts must have shape \(robots, dof\) = \(1, 2\), got \(2,\)"),
        ([(0.1, 0.1)], [(0.9, 0.1, 0.0)], r"goals must have shape .*\(1, 2\), got \(1, 3\)"),
        ([(0.1, 0.1)], [(0.9, 0.1)] * 2, r"goals must have shape .*\(1, 2\), got \(2, 2\)"),
        ([(0.1, 0.1)], [("left", "top")], "goals must be numbers"),
        ([(0.1, 0.1)], [(0.1,), (0.1, 0.2)], "goals must be numbers"),
    ],
)
def test_impossible_problems_are_refused(starts, goals, message):
    with pytest.raises(ValueError, match=message):
        problem(starts, goals)


def test_the_robot_at_fault_is_named():
    with pytest.raises(ValueError, match="Robot 1 starts in collision"):
        problem([(0.1, 0.1), (0.5, 0.5)], [(0.9, 0.1), (0.9, 0.9)], [PointRobot()] * 2)


def test_a_problem_needs_robots():
    with pytest.raises(ValueError, match="at least one robot"):
        problem(np.empty((0, 2)), np.empty((0, 2)), ())
