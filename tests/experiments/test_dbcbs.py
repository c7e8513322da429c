import numpy as np
import pytest

from experiments import _dbcbs
from plr_jax import DiscRobot, RectangleRobot

pytestmark = pytest.mark.full

PROBLEM = """
environment:
  max: [6, 4.5]
  min: [0, 0]
  obstacles:
  - {center: [3, 1], size: [1, 2], type: box}
robots:
- {type: unicycle_first_order_0_sphere, start: [1, 1, 0.5], goal: [5, 1, 0]}
- {type: unicycle_first_order_0, start: [5, 3, 3.14], goal: [1.0, 3e0, 0]}
"""


def test_a_problem_and_a_solution(tmp_path):
    path = tmp_path / "problem.yaml"
    path.write_text(PROBLEM)
    problem = _dbcbs.read_problem(path)
    assert [type(robot) for robot in problem.robots] == [DiscRobot, RectangleRobot]
    np.testing.assert_array_equal(problem.starts, [[1, 1, 0], [5, 3, 3.14]])
    np.testing.assert_array_equal(problem.goals, [[5, 1, 0], [1, 3, 0]])
    assert problem.workspace.free_space.bounds == (0, 0, 6, 4.5) and problem.workspace.free_space.area == 25
    path.write_text("result:\n- states: [[0, 1, 2, 9], [3, 4, 5, 9]]\n- states: [[6, 7, 8, 9]]\n")
    np.testing.assert_array_equal(_dbcbs.read_trajectories(path), [[[0, 1, 2], [6, 7, 8]], [[3, 4, 5], [6, 7, 8]]])
