import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from solution_helpers import NONE, PROBLEM, ROOM, SOLUTION, TURN, findings, found_by_a_planner

from plr_jax import Problem, RectangleRobot, makespan
from plr_jax._problem import motion_costs
from plr_jax.planners import Solution, Stats, Status
from plr_jax.planners._solution import solution_of, straight_line_bound


def test_the_bound_is_the_cost_of_straight_motions():
    assert straight_line_bound(PROBLEM) == pytest.approx(5 + 3 + 2 * TURN)


def test_a_solution_computes_its_costs_from_the_path():
    path = np.array([[(1, 1, 7), (5, 5, 3.0)], [(1, 5, 7), (5, 5, -3.0)], [(4, 5, 7), (5, 8, -3.0)]])
    solution = solution_of(PROBLEM, path, 8.0, Status.SOLVED, Stats(3), path)
    assert solution.solved and solution.path is path and solution.lower_bound == 8.0
    assert solution.cost == pytest.approx(4 + 3 + 3 + 2 * TURN)
    assert solution.makespan == pytest.approx(4 + 3)
    assert solution.makespan == makespan(PROBLEM, path) == solution.times[-1]
    np.testing.assert_allclose(solution.times, [0, 4, 7])


def test_no_path_costs_infinitely_much():
    solution = solution_of(PROBLEM, None, 8.0, Status.EXHAUSTED, Stats(1), PROBLEM.starts[None])
    assert not solution.solved and solution.path is None and solution.times is None
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
    text = "Solution(TIME_LIMIT: cost 12.35, makespan 7, lower bound 10, 1,234 nodes, 1.5 s)"
    assert repr(solution) == text


def test_robots_share_a_clock():
    """In the first motion the disc goes 4 at unit speed, and the rectangle turns through pi by the shorter way."""
    at = SOLUTION.path_at([0, 1, 2, 4, 5, 7])
    np.testing.assert_allclose(at[:, 0, :2], [(1, 1), (1, 2), (1, 3), (1, 5), (2, 5), (4, 5)])
    np.testing.assert_allclose(at[:, 1, 1], [5, 5, 5, 5, 6, 8])
    np.testing.assert_allclose(at[:3, 1, 2], [3, 3 + TURN / 4, 3 + TURN / 2])
    np.testing.assert_allclose(at[3:, 1, 2], -3)


def test_times_beyond_the_ends_are_those_of_the_ends():
    at = SOLUTION.path_at([-np.inf, -1, -0.0, 0, SOLUTION.makespan, 8, np.inf])
    np.testing.assert_array_equal(at[:4], [PROBLEM.starts] * 4)
    np.testing.assert_array_equal(at[4:], [PROBLEM.goals] * 3)


def test_times_may_have_any_shape():
    np.testing.assert_array_equal(SOLUTION.path_at(2), SOLUTION.path_at([2])[0])
    assert SOLUTION.path_at([]).shape == (0, 2, 3)
    times = np.linspace(0, 7, 6)
    np.testing.assert_array_equal(SOLUTION.path_at(times.reshape(2, 3)).reshape(6, 2, 3), SOLUTION.path_at(times))


@given(findings(), st.lists(st.floats(0, 1), min_size=2, max_size=20))
@settings(max_examples=60, deadline=None)
def test_no_robot_is_faster_than_the_clock_and_one_keeps_up_with_it(found, shares):
    solution = found_by_a_planner(*found)
    if solution.path is None:
        return
    times, scale = np.sort(shares) * solution.makespan, 1e-9 * (1 + solution.makespan)
    at = solution.path_at(times)
    spent = motion_costs(PROBLEM, at[:-1], at[1:])
    assert (spent.max(axis=1) <= np.diff(times) + scale).all()
    np.testing.assert_array_equal(solution.path_at([0, solution.makespan])[-1], solution.path[-1])
    if solution.makespan > 0:
        np.testing.assert_array_equal(solution.path_at(0), solution.path[0])
    last_at_its_time = np.append(np.diff(solution.times) > 0, True)
    last_at_its_time &= (solution.times > 0) & (solution.times < solution.makespan)
    rows = solution.path_at(solution.times[last_at_its_time])
    np.testing.assert_array_equal(rows, solution.path[last_at_its_time])
    moving = np.flatnonzero(np.diff(solution.times) > scale)
    halves = solution.times[moving] + np.diff(solution.times)[moving] / 2
    half_way = motion_costs(PROBLEM, solution.path[moving], solution.path_at(halves))
    np.testing.assert_allclose(half_way.max(axis=1), np.diff(solution.times)[moving] / 2, rtol=1e-6, atol=scale)


def test_a_turn_that_costs_nothing_is_made_at_once_but_not_before_the_start():
    free = Problem(ROOM, [RectangleRobot(2, 1)], [(3, 3, 0)], [(7, 3, 1)], rotation_weight=0)
    path = np.array([[(3, 3, 0)], [(3, 3, 1)], [(7, 3, 1)]])
    at = solution_of(free, path, 0.0, Status.SOLVED, Stats(1), path).path_at([0, 1e-300, 2, 4])
    np.testing.assert_array_equal(at[:, 0], [(3, 3, 0), (3, 3, 1), (5, 3, 1), (7, 3, 1)])


@pytest.mark.parametrize("path", [PROBLEM.starts[None], np.stack([PROBLEM.starts] * 3)], ids=["one row", "three"])
def test_robots_that_stay_where_they_are(path):
    still = solution_of(PROBLEM, path, 0.0, Status.SOLVED, Stats(1), path)
    assert still.makespan == 0
    np.testing.assert_array_equal(still.path_at([-1, 0, 1]), [PROBLEM.starts] * 3)


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ([0.0, np.nan], "times must not be NaN"),
        ("soon", "times must be numbers, such as an array"),
        ([1j], "times must be numbers"),
        (np.ma.masked_greater([1.0, 2.0], 1.5), "times must be numbers, such as .* and some are masked"),
        (None, "times must not be NaN|times must be numbers"),
    ],
)
def test_what_is_no_time(times, message, unchecked_types):
    with pytest.raises(ValueError, match=message):
        SOLUTION.path_at(times)


def test_without_a_path_there_is_nowhere_to_be():
    with pytest.raises(ValueError, match="no path to follow, the planner ended because: the frontier is empty"):
        NONE.path_at([0.0])
