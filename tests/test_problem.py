"""Problems: refusals of impossible ones, and costs of paths."""

from contextlib import nullcontext

import numpy as np
import pytest
from robot_helpers import AnyShape

from plr_jax import DiscRobot, PointRobot, Problem, RectangleRobot, Workspace, makespan, path_cost
from plr_jax._problem import motion_costs, separation
from plr_jax.robots import footprint

WALL = [(0.4, 0.0), (0.6, 0.0), (0.6, 0.8), (0.4, 0.8)]
ROOM = Workspace(((0, 0), (1, 1)), [WALL])
POINT, DISCS, BAR = (PointRobot(),), [DiscRobot(0.1)] * 2, RectangleRobot(0.4, 0.1)
FINE = [(0.9, 0.1)]


def problem(starts, goals, robots=POINT, **options):
    return Problem(ROOM, robots, starts, goals, **options)


def test_configurations_become_read_only_float64_arrays():
    starts = np.array([[0, 1]])
    made = problem(starts, FINE)
    assert made.starts.dtype == made.goals.dtype == np.float64
    assert made.starts.shape == made.goals.shape == (1, 2)
    assert made.robots == (PointRobot(),)
    starts[0] = 7
    np.testing.assert_array_equal(made.starts, [[0.0, 1.0]])
    with pytest.raises(ValueError, match="read-only"):
        made.starts[0] = 7.0


def test_robots_may_touch_walls_and_robots():
    problem([(0.4, 0.3)], [(1.0, 1.0)])
    problem([(0.3, 0.5), (0.1, 0.5)], [(0.1, 0.1), (0.3, 0.1)], DISCS)
    problem([(0.2, 0.5, 0)], [(0.2, 0.3, 3 * np.pi)], [BAR])
    problem([(0.2, 0.1, 0), (0.3, 0.4, np.pi / 2)], [(0.2, 0.9, 0), (0.8, 0.9, 0)], [BAR, BAR])
    problem([(0.2, 0.1, 0), (0.2, 0.2, 0)], [(0.2, 0.9, 0), (0.8, 0.9, 0)], [BAR, BAR])
    rod, pole = AnyShape(((-0.1, 0), (0.1, 0)), dof=2), AnyShape(((0, -0.1), (0, 0.1)), dof=2)
    problem([(0.2, 0.5)] * 3, [(0.2, 0.9)] * 3, [PointRobot(), rod, pole])


IMPOSSIBLE = [
    ([(0.43, 0.5)], FINE, POINT,
     r"Robot 0 starts in collision with obstacle 0 at \[0.43, 0.5\] \(clearance -0.03\)"),
    ([(0.1, 0.1)], [(0.5, 0.7)], POINT,
     r"Robot 0 has its goal in collision with obstacle 0 at .*\(clearance -0.1\)"),
    ([(0.1, 1.5)], FINE, POINT, r"Robot 0 starts outside the bounds: \[0.1, 1.5\]"),
    ([(0.1, np.nan)], FINE, POINT, "starts must be finite.*robot 0"),
    ([(0.1, 0.1)], [(np.inf, 0.1)], POINT, "goals must be finite.*robot 0"),
    (np.ma.masked_array([(0.1, 0.1)], [(0, 1)]), FINE, POINT, "starts must be numbers .* and some are masked"),
    ((0.1, 0.1), FINE, POINT, r"starts must have shape \(robots, dof\) = \(1, 2\), got \(2,\)"),
    (FINE, [(0.9, 0.1, 0.0)], POINT, r"goals must have shape .*\(1, 2\), got \(1, 3\): no robot can turn"),
    (FINE, FINE * 2, POINT, r"goals must have shape .*\(1, 2\), got \(2, 2\)"),
    (FINE, [("left", "top")], POINT, "goals must be numbers"),
    (np.empty((0, 2)), np.empty((0, 2)), (), "at least one robot"),
    ([(0.1, 0.1), (0.33, 0.5)], [(0.1, 0.3), (0.1, 0.8)], DISCS,
     r"^Robot 1 starts in collision with obstacle 0 at \[0.33, 0.5\] \(clearance -0.03\): move it\.$"),
    ([(0.1, 0.1), (0.1, 0.4)], [(0.09, 0.1), (0.1, 0.8)], DISCS,
     r"Robot 0 has its goal outside the bounds by 0.01"),
    ([(0.1, 0.1), (0.1, 0.27)], [(0.9, 0.1), (0.9, 0.5)], DISCS,
     r"Robots 0 and 1 overlap at their starts: .* \(clearance -0.03\)"),
    ([(0.25, 0.5, 0)], [(0.2, 0.3, 0)], [BAR], "Robot 0 starts in collision with obstacle 0"),
    ([(0.2, 0.1, np.pi / 2)], [(0.2, 0.3, 0)], [BAR], "Robot 0 starts outside the bounds by 0.1"),
    ([(0.2, 0.1, 0), (0.3, 0.25, np.pi / 2)], [(0.2, 0.9, 0), (0.8, 0.9, 0)], [BAR, BAR],
     "Robots 0 and 1 overlap at their starts"),
    ([(0.2, 0.2), (0.2, 0.5)], [(0.2, 0.9), (0.8, 0.9)], [DISCS[0], BAR],
     r"\(robots, dof\) = \(2, 3\), got \(2, 2\): robot 1 can turn, so each row is \(x, y, heading in radians\)"),
    ([(0.2, 0.5)], [(0.8, 0.5)], [DiscRobot(0.11)],
     r"Robot 0 has its goal .* cut off from its start .* for a disc of radius 0.11"),
    ([(0.2, 0.5, 0)], [(0.8, 0.5, 0)], [RectangleRobot(0.3, 0.25)], r"cut off .* for a disc of radius 0.125"),
]  # fmt: skip


@pytest.mark.parametrize(("starts", "goals", "robots", "message"), IMPOSSIBLE)
def test_impossible_problems_raise(starts, goals, robots, message):
    with pytest.raises(ValueError, match=message):
        problem(starts, goals, robots)


def test_goal_cut_off_raises():
    problem([(0.2, 0.5)], [(0.8, 0.5)], DISCS[:1])  # exactly as wide as the passage
    closed = Workspace(((0, 0), (1, 1)), [[(0.4, 0), (0.6, 0), (0.6, 1), (0.4, 1)]])
    with pytest.raises(ValueError, match=r"Robot 1 has its goal .* cut off .* no path for it"):
        Problem(closed, POINT * 2, [(0.1, 0.1), (0.2, 0.2)], [(0.2, 0.9), (0.9, 0.9)])
    with pytest.raises(ValueError, match=r"Robot 0 has its goal .* cut off .* for a disc of radius 0.1"):
        Problem(closed, DISCS[:1], [(0.1, 0.1)], [(0.9, 0.9)])


def test_point_contact_cuts_off_unless_workspace_squeezes():
    corners = [[(0, 0), (1, 0), (1, 1), (0, 1)], [(1, 1), (2, 1), (2, 2), (1, 2)]]
    Problem(Workspace(((0, 0), (2, 2)), corners, squeeze=True), POINT, [(0.5, 1.5)], [(1.5, 0.5)])
    with pytest.raises(ValueError, match="cut off"):
        Problem(Workspace(((0, 0), (2, 2)), corners), POINT, [(0.5, 1.5)], [(1.5, 0.5)])
    for side in ((0.5, 1.5), (1.5, 0.5)):  # the contact belongs to both sides
        Problem(Workspace(((0, 0), (2, 2)), corners), POINT * 2, [side, (1, 1)], [(1, 1), side])


def test_team_with_rectangle_has_headings():
    made = problem([(0.2, 0.2, 7), (0.2, 0.5, 0)], [(0.2, 0.1, 1), (0.8, 0.7, 1.6)], [DISCS[0], BAR])
    assert made.dof == 3
    np.testing.assert_allclose(made.rotation_weights, [0, np.hypot(0.4, 0.1) / 2])


@pytest.mark.parametrize("weight", [-1, np.nan, np.inf])
def test_invalid_rotation_weight_raises(weight):
    with pytest.raises(ValueError, match="rotation_weight must be a finite number"):
        problem(FINE, FINE, rotation_weight=weight)


def test_path_cost_and_makespan():
    starts, goals = [(0.2, 0.1, 0), (0.5, 0.9, 3)], [(0.2, 0.2, 5), (0.6, 0.9, -3)]
    made = problem(starts, goals, [DISCS[0], BAR], rotation_weight=2)
    path = np.array([starts, [(0.2, 0.1, 0), (0.6, 0.9, 3)], goals])
    turn = 2 * np.pi - 6
    assert path_cost(made, path) == pytest.approx(0.1 + 0.1 + 2 * turn)
    assert makespan(made, path) == pytest.approx(0.1 + max(0.1, 2 * turn))
    np.testing.assert_allclose(motion_costs(made, path[:-1], path[1:]), [[0, 0.1], [0.1, 2 * turn]])
    assert path_cost(made, path[:1]) == makespan(made, path[:1]) == 0
    for bad in (path[0], path[:, :1], path[:0], "path"):
        with pytest.raises(ValueError, match="A path must"):
            path_cost(made, bad)


@pytest.mark.parametrize("seed", range(6))
def test_first_overlapping_robots_are_named(seed):
    rng = np.random.default_rng(seed)
    shapes = [DiscRobot(0.02), PointRobot(), BAR, DiscRobot(0.05), RectangleRobot(0.1, 0.05)]
    robots = [shapes[k] for k in rng.integers(0, 5, 30)]
    q = np.append(rng.uniform(0.3, 4.7, (30, 2)), rng.uniform(-4, 4, (30, 1)), axis=1)
    cores = [footprint(robot, x) for robot, x in zip(robots, q, strict=True)]
    gaps = [(separation(cores[i], cores[j]) - robots[i].rounding - robots[j].rounding, i, j)
            for j in range(30) for i in range(j)]  # fmt: skip
    overlaps = [(i, j, gap) for gap, i, j in gaps if gap < 0]
    room = Workspace(((0, 0), (5, 5)))
    named = "Robots {} and {} overlap at their starts: .* .clearance {:.3g}".format(*(overlaps or [(0, 0, 0)])[0])
    with pytest.raises(ValueError, match=named) if overlaps else nullcontext():
        Problem(room, robots, q, q)
