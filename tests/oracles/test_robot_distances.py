import numpy as np

from plr_jax import DiscRobot, PointRobot, Problem, RectangleRobot, Workspace, exact_lower_bound, robot_distance_fns

CORNER = Workspace(((0, 0), (10, 10)), [[(4, 0), (6, 0), (6, 5), (4, 5)]])


def test_disc_goes_around_a_corner_at_its_radius():
    problem = Problem(CORNER, [DiscRobot(1.0)], [(1.0, 1.0)], [(9.0, 1.0)])
    (distance,) = robot_distance_fns(problem)
    # A tangent to each rounded corner, an arc from its direction to the horizontal, and the flat between them.
    tangent = np.sqrt(3**2 + 4**2 - 1)
    arc = np.arctan2(4, 3) + np.arcsin(1 / 5)
    expected = 2 * (tangent + arc) + 2
    assert 0.998 * expected <= distance(problem.starts)[0] <= expected
    (of_center,) = robot_distance_fns(problem, inflated=False)
    np.testing.assert_allclose(of_center(problem.starts), 2 * np.hypot(3, 4) + 2)


def test_goal_of_a_disc_may_touch_a_wall():
    problem = Problem(CORNER, [DiscRobot(0.3)], [(1.0, 1.0)], [(3.7, 2.0)])
    (distance,) = robot_distance_fns(problem)
    np.testing.assert_allclose(distance(np.array([[1.0, 1.0]])), np.hypot(2.7, 1), atol=1e-6)


def test_teams_of_several_shapes():
    workspace = Workspace(((0, 0), (10, 10)))
    robots = [PointRobot(), DiscRobot(0.5), RectangleRobot(2.0, 1.0)]
    problem = Problem(workspace, robots, [(1, 1, 0), (1, 4, 0), (2, 8, 0)], [(9, 1, 0), (9, 4, 0), (8, 8, 0)])
    lengths = [f(start[None, :2])[0] for f, start in zip(robot_distance_fns(problem), problem.starts, strict=True)]
    np.testing.assert_allclose(lengths, [8, 8, 6])
    assert exact_lower_bound(problem) == sum(lengths)


def test_disc_fits_a_passage_exactly_as_wide():
    lower, upper = [(4, 0), (6, 0), (6, 4.5), (4, 4.5)], [(4, 5.5), (6, 5.5), (6, 16), (4, 16)]
    workspace = Workspace(((0, 0), (10, 20)), [lower, upper])
    problem = Problem(workspace, [DiscRobot(0.5)] * 2, [(2, 5), (8, 12)], [(8, 5), (5, 18)])
    (through, _) = robot_distance_fns(problem)
    np.testing.assert_allclose(through(problem.starts[:1]), 6, rtol=1e-9)
    slot = Problem(Workspace(((0, 0), (10, 1))), [DiscRobot(0.5)], [(0.5, 0.5)], [(9.5, 0.5)])
    np.testing.assert_allclose(robot_distance_fns(slot)[0](slot.starts), 9, rtol=1e-9)
