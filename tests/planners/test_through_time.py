"""One robot planned among others through time: against tests of motion pairs, and against hand values."""

import numpy as np
import pytest
import shapely
from planner_helpers import ROOM, TRIO

from plr_jax import DiscRobot, Problem, Workspace, scenes, validate
from plr_jax.collision.motions import motions_apart
from plr_jax.planners.through_time import ROWS_PER_STEP, Timetable, plan_through_time, subdivided
from plr_jax.robots import between

LENGTH = 0.15


def straight(problem, num_rows):
    """Return all robots on their straight ways, through walls too, each in a random part of the rows."""
    rng = np.random.default_rng(0)
    share = np.clip((np.arange(num_rows)[:, None] / num_rows - rng.uniform(0, 0.5, len(problem.robots))) * 2, 0, 1)
    return between(problem.starts[None], problem.goals[None], share[..., None])


def plan_of(timetable, i):
    motion, arrives = plan_through_time(timetable, i, ROWS_PER_STEP * LENGTH, 10_000)
    assert motion is not None
    return motion, arrives


@pytest.mark.parametrize("problem", [TRIO, scenes.crowd(6)], ids=["trio", "crowd"])
def test_motions_fit_where_robots_are_apart(problem):
    path, rng = straight(problem, 40), np.random.default_rng(1)
    timetable, others = Timetable(problem, path), problem.robots[:-1]
    timetable.ignored.add(len(others))
    for i, robot in enumerate(others):
        begin, end = problem.starts[i] + rng.uniform(-1, 1, (2, 12, problem.dof)) + [2.0, 1.0, 0.0][: problem.dof]
        row, count = rng.integers(0, 50, 12), rng.integers(0, 8, 12)
        fits = timetable.are_free(i, begin, end, row, count)
        for k in range(12):
            q = between(begin[[k]], end[[k]], np.linspace(0, 1, count[k] + 1)[:, None])
            at = np.minimum(row[k] + np.arange(count[k] + 1), len(path) - 1)
            meets = [
                ~motions_apart(robot, q[:-1], q[1:], other, path[at[:-1], j], path[at[1:], j], 1e-8).all()
                for j, other in enumerate(others)
                if j != i
            ]
            assert fits[k] == (not any(meets))


def test_place_is_free_after_last_robot_passed():
    problem = Problem(ROOM, [DiscRobot(0.5), DiscRobot(0.5)], [(1, 1), (1, 5)], [(9, 1), (9, 5)])
    path = np.stack([np.repeat([[1.0, 1.0]], 9, axis=0), [(1.0 + x, 5.0) for x in range(9)]], axis=1)
    timetable, place = Timetable(problem, path), np.array([5.0, 5.0])
    meetings, who = timetable.meetings(0, place[None])
    assert meetings.tolist() == [3, 4] and set(who.tolist()) == {1}
    free = timetable.next_free_rows(0, place)
    assert free.tolist() == [5] * 6 + [6, 7, 8]
    assert Timetable(problem, path, patience=3).next_free_rows(0, place)[:5].tolist() == [0, 5, 5, 5, 5]
    # A robot rests at its end forever, or for as many rows as the patience.
    assert not np.isfinite(timetable.next_free_rows(0, np.array([9.0, 5.0]))).any()
    patient = Timetable(problem, path, patience=4)
    assert patient.next_free_rows(0, np.array([9.0, 5.0]))[6:].min() == 12


def test_lone_robot_goes_straight_at_unit_speed():
    problem = Problem(ROOM, [DiscRobot(0.4)], [(1.03, 1.1)], [(8.7, 5.2)])
    motion, arrives = plan_of(Timetable(problem, problem.starts[None]), 0)
    assert arrives and len(motion) - 1 == np.ceil(np.hypot(7.67, 4.1) / LENGTH)
    np.testing.assert_array_equal(motion[[0, -1]], [problem.starts[0], problem.goals[0]])
    np.testing.assert_allclose(np.diff(np.diff(motion, axis=0), axis=0), 0, atol=1e-12)


def test_waiting_robot_goes_when_lane_is_free():
    """A hallway of one lane, with a bay: the first robot has it to itself until it is through."""
    hallway = Workspace(((0, 0), (10, 3)), [shapely.box(0, 1, 4, 3), shapely.box(5, 1, 10, 3)])
    problem = Problem(hallway, [DiscRobot(0.4)] * 2, [(0.5, 0.5), (4.5, 2.4)], [(9.5, 0.5), (0.5, 0.5)])
    first = between(problem.starts[:1], problem.goals[:1], np.linspace(0, 1, 61)[:, None])
    timetable = Timetable(problem, np.stack([first, np.repeat(problem.starts[1:], 61, axis=0)], axis=1))
    motion, arrives = plan_of(timetable, 1)
    timetable.move(1, motion)
    assert arrives and validate(problem, timetable.path).valid
    # The robot may leave before the first one has passed the bay, but enters the hallway after it.
    alone, _ = plan_of(Timetable(problem, problem.starts[None], patience=0), 1)
    assert len(alone) < len(motion) < 27 + len(alone)


def test_blocked_robot_goes_as_near_as_possible():
    hallway = Workspace(((0, 0), (10, 3)), [shapely.box(0, 1, 10, 3)])
    problem = Problem(hallway, [DiscRobot(0.4)] * 2, [(0.5, 0.5), (5, 0.5)], [(9.5, 0.5), (6, 0.5)])
    timetable = Timetable(problem, problem.starts[None])
    motion, arrives = plan_of(timetable, 0)
    assert not arrives and 3.6 < motion[-1, 0] <= 4.2
    timetable.ignored.add(1)
    assert plan_of(timetable, 0)[1]


def test_subdivided_path_keeps_rows_and_limits_lengths():
    path = straight(TRIO, 7)
    finer = subdivided(TRIO, path, LENGTH)
    costs = np.hypot(*np.moveaxis(np.diff(finer[..., :2], axis=0), 2, 0))
    assert (costs <= LENGTH * (1 + 1e-9)).all()
    rows = np.flatnonzero((finer[:, None] == path[None]).all(axis=(2, 3)).any(axis=1))
    assert len(rows) >= len(path)
