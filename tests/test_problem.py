import numpy as np
import pytest

from plr_jax._problem import Problem, makespan, motion_costs, path_cost, separation
from plr_jax.geometry.workspace import Workspace
from plr_jax.robots.robot import footprint
from plr_jax.robots.shapes import DiscRobot, PointRobot, RectangleRobot

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
        (np.ma.masked_array([(0.1, 0.1)], [(0, 1)]), [(0.9, 0.1)], "starts must be numbers .* and some are masked"),
        ([(0.1, 0.1)], np.ma.masked_array([(0.9, 0.1)], [(0, 1)]), "goals must be numbers .* and some are masked"),
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


def disc_problem(starts, goals, radii=(0.1,), workspace=ROOM):
    return Problem(workspace, [DiscRobot(r) for r in radii], starts, goals)


@pytest.mark.parametrize(
    ("starts", "goals", "message"),
    [
        ([(0.1, 0.1), (0.33, 0.5)], [(0.1, 0.3), (0.1, 0.8)],
         r"^Robot 1 starts in collision with obstacle 0 at \[0.33, 0.5\] \(clearance -0.03\)\.$"),
        ([(0.1, 0.1), (0.1, 0.4)], [(0.09, 0.1), (0.1, 0.8)], r"Robot 0 has its goal outside the bounds by 0.01"),
        ([(0.1, 0.1), (0.1, 0.27)], [(0.9, 0.1), (0.9, 0.5)],
         r"Robots 0 and 1 overlap at their starts: .* \(clearance -0.03\)"),
        ([(0.1, 0.1), (0.1, 0.5)], [(0.9, 0.1), (0.9, 0.1)],
         r"Robots 0 and 1 overlap at their goals: .* \(clearance -0.2\)"),
        ([(0.5, 0.9), (0.1, 0.5)], [(0.5, 0.5), (0.9, 0.1)], r"Robot 0 has its goal in collision .*clearance -0.2"),
    ],
)  # fmt: skip
def test_discs_that_overlap_something_are_refused(starts, goals, message):
    with pytest.raises(ValueError, match=message):
        disc_problem(starts, goals, (0.1, 0.1))


def test_discs_may_touch_everything():
    disc_problem([(0.3, 0.5), (0.1, 0.5)], [(0.1, 0.1), (0.3, 0.1)], (0.1, 0.1))


def test_a_goal_cut_off_is_refused():
    message = r"Robot 0 has its goal .* cut off from its start .* for a disc of radius 0.11"
    disc_problem([(0.2, 0.5)], [(0.8, 0.5)], (0.1,))  # exactly as wide as the passage
    with pytest.raises(ValueError, match=message):
        disc_problem([(0.2, 0.5)], [(0.8, 0.5)], (0.11,))
    closed = Workspace(((0, 0), (1, 1)), [[(0.4, 0), (0.6, 0), (0.6, 1), (0.4, 1)]])
    with pytest.raises(ValueError, match=r"Robot 1 has its goal .* cut off .* no way for it"):
        Problem(closed, POINT * 2, [(0.1, 0.1), (0.2, 0.2)], [(0.2, 0.9), (0.9, 0.9)])
    with pytest.raises(ValueError, match=r"cut off .* for a disc of radius 0.125"):
        Problem(ROOM, [RectangleRobot(0.3, 0.25)], [(0.2, 0.5, 0)], [(0.8, 0.5, 0)])


def test_whether_a_point_contact_cuts_off_is_the_workspaces_choice():
    corners = [[(0, 0), (1, 0), (1, 1), (0, 1)], [(1, 1), (2, 1), (2, 2), (1, 2)]]
    Problem(Workspace(((0, 0), (2, 2)), corners, squeeze=True), POINT, [(0.5, 1.5)], [(1.5, 0.5)])
    with pytest.raises(ValueError, match="cut off"):
        Problem(Workspace(((0, 0), (2, 2)), corners), POINT, [(0.5, 1.5)], [(1.5, 0.5)])


BAR = RectangleRobot(0.4, 0.1)


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ((0.25, 0.5, 0), "Robot 0 starts in collision with obstacle 0"),
        ((0.2, 0.1, np.pi / 2), "Robot 0 starts outside the bounds by 0.1"),
        ((0.5, 0.82, 0.01), "Robot 0 starts in collision"),
    ],
)
def test_rectangles_that_overlap_something_are_refused(start, message):
    with pytest.raises(ValueError, match=message):
        Problem(ROOM, [BAR], [start], [(0.2, 0.3, 0)])
    Problem(ROOM, [BAR], [(0.2, 0.5, 0)], [(0.2, 0.3, 3 * np.pi)])


def test_rectangles_that_overlap_one_another_are_refused():
    for second, free in (((0.3, 0.4, np.pi / 2), True), ((0.3, 0.25, np.pi / 2), False), ((0.2, 0.2, 0), True)):
        try:
            Problem(ROOM, [BAR, BAR], [(0.2, 0.1, 0), second], [(0.2, 0.9, 0), (0.8, 0.9, 0)])
            refused = False
        except ValueError as error:
            refused = "Robots 0 and 1 overlap at their starts" in str(error)
        assert refused != free


def test_a_team_with_a_rectangle_has_headings_those_of_discs_ignored():
    made = Problem(ROOM, [DiscRobot(0.1), BAR], [(0.2, 0.2, 7), (0.2, 0.5, 0)], [(0.2, 0.1, 1), (0.8, 0.7, 1.6)])
    assert made.dof == 3
    np.testing.assert_allclose(made.rotation_weights, [0, np.hypot(0.4, 0.1) / 2])
    with pytest.raises(ValueError, match=r"\(robots, dof\) = \(2, 3\), got \(2, 2\)"):
        Problem(ROOM, [DiscRobot(0.1), BAR], [(0.2, 0.2), (0.2, 0.5)], [(0.2, 0.9), (0.8, 0.9)])


@pytest.mark.parametrize("weight", [-1, np.nan, np.inf])
def test_rotation_weights_are_checked(weight):
    with pytest.raises(ValueError, match="rotation_weight must be a finite number"):
        Problem(ROOM, POINT, [(0.1, 0.1)], [(0.2, 0.2)], rotation_weight=weight)


def test_costs_sum_lengths_and_weighted_turns_and_the_makespan_waits_for_the_last():
    robots = [DiscRobot(0.1), BAR]
    starts, goals = [(0.2, 0.1, 0), (0.5, 0.9, 3)], [(0.2, 0.2, 5), (0.6, 0.9, -3)]
    made = Problem(ROOM, robots, starts, goals, rotation_weight=2)
    path = np.array([starts, [(0.2, 0.1, 0), (0.6, 0.9, 3)], goals])
    turn = 2 * np.pi - 6
    assert path_cost(made, path) == pytest.approx(0.1 + 0.1 + 2 * turn)
    assert makespan(made, path) == pytest.approx(0.1 + max(0.1, 2 * turn))
    np.testing.assert_allclose(motion_costs(made, path[:-1], path[1:]), [[0, 0.1], [0.1, 2 * turn]])
    assert path_cost(made, path[:1]) == makespan(made, path[:1]) == 0
    for bad in (path[0], path[:, :1], path[:0], "path"):
        with pytest.raises(ValueError, match="A path must"):
            path_cost(made, bad)


@pytest.mark.parametrize("seed", range(12))
def test_the_first_two_robots_that_overlap_are_named(seed):
    rng = np.random.default_rng(seed)
    shapes = [DiscRobot(0.02), PointRobot(), BAR, DiscRobot(0.05), RectangleRobot(0.1, 0.05)]
    robots = [shapes[k] for k in rng.integers(0, 5, 30)]
    q = np.append(rng.uniform(0.3, 4.7, (30, 2)), rng.uniform(-4, 4, (30, 1)), axis=1)
    cores = [footprint(robot, x) for robot, x in zip(robots, q, strict=True)]
    gaps = [(separation(cores[i], cores[j]) - robots[i].rounding - robots[j].rounding, i, j)
            for j in range(30) for i in range(j)]  # fmt: skip
    overlaps = [(i, j, gap) for gap, i, j in gaps if gap < 0]
    room = Workspace(((0, 0), (5, 5)))
    if not overlaps:
        Problem(room, robots, q, q)
        return
    with pytest.raises(
        ValueError, match="Robots {} and {} overlap at their starts: .* .clearance {:.3g}".format(*overlaps[0])
    ):
        Problem(room, robots, q, q)
