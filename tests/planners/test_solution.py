import numpy as np
import pytest

from plr_jax import DiscRobot, Problem, RectangleRobot, Workspace
from plr_jax.planners import Solution, Stats, Status
from plr_jax.planners._solution import solution_of, straight_line_bound

ROOM = Workspace(((0, 0), (10, 10)))
PROBLEM = Problem(
    ROOM,
    [DiscRobot(0.5), RectangleRobot(2, 1)],
    [(1, 1, 7), (5, 5, 3.0)],
    [(4, 5, 7), (5, 8, -3.0)],
    rotation_weight=2.0,
)
TURN = 2 * np.pi - 6  # from heading 3 to -3 by the shorter way


def test_the_bound_is_the_cost_of_straight_motions():
    assert straight_line_bound(PROBLEM) == pytest.approx(5 + 3 + 2 * TURN)


def test_a_solution_computes_its_costs_from_the_path():
    path = np.array([[(1, 1, 7), (5, 5, 3.0)], [(1, 5, 7), (5, 5, -3.0)], [(4, 5, 7), (5, 8, -3.0)]])
    solution = solution_of(PROBLEM, path, 8.0, Status.SOLVED, Stats(3), path)
    assert solution.solved and solution.path is path and solution.lower_bound == 8.0
    assert solution.cost == pytest.approx(4 + 3 + 3 + 2 * TURN)
    assert solution.makespan == pytest.approx(4 + 3)


def test_no_path_costs_infinitely_much():
    solution = solution_of(PROBLEM, None, 8.0, Status.EXHAUSTED, Stats(1), PROBLEM.starts[None])
    assert not solution.solved and solution.path is None
    assert solution.cost == solution.makespan == np.inf and solution.lower_bound == 8.0


def test_a_path_may_be_there_whatever_the_status():
    path = np.stack([PROBLEM.starts, PROBLEM.goals])
    for status in Status:
        assert solution_of(PROBLEM, path, 0.0, status, Stats(2), path).solved


def test_the_statuses_are_messages():
    assert len(set(Status)) == 6
    assert all(" " in status and status == str(status) for status in Status)


def test_seconds_to_the_first_path():
    assert Stats(1).first_solution == np.inf
    assert Stats(1, history=((0.25, 9.0), (0.5, 8.0))).first_solution == 0.25


def test_statistics_of_two_solutions_share_nothing():
    first, second = Stats(1), Stats(1)
    first.seconds["search"] = 1.0
    assert second.seconds == {}


def test_the_repr_says_what_matters():
    solution = Solution(
        None, 12.3456, 7.0, 10.0, Status.TIME_LIMIT, Stats(1234, seconds={"a": 0.5, "b": 1.0}), PROBLEM.starts[None]
    )
    assert repr(solution) == "Solution(TIME_LIMIT: cost 12.35, lower bound 10, 1,234 nodes, 1.5 s)"
