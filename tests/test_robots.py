"""Shapes of robots: their geometry, how they turn, and the planner with shapes of other classes."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from robot_helpers import PEBBLE, WING, AnyShape, sled

from plr_jax import DiscRobot, PointRobot, Problem, RectangleRobot, Workspace, plot, scenes, validate
from plr_jax.collision.motions import motions_apart
from plr_jax.collision.walls import MotionTest
from plr_jax.metrics import path_cost
from plr_jax.planners import Stats, Status, bl_plan
from plr_jax.planners._solution import make_solution
from plr_jax.plot._paths import timeline
from plr_jax.robots import PolygonRobot, shorter_turn, smaller_angle


@pytest.mark.parametrize("size", [0, -1, np.nan, np.inf, "wide", None])
def test_sizes_must_be_positive_and_finite(size):
    for make in (DiscRobot, lambda x: RectangleRobot(x, 1), lambda x: RectangleRobot(1, x)):
        with pytest.raises(ValueError, match="must be a positive finite number, got"):
            make(size)


# A door, 1.2 wide, between two rooms.
DOOR = Workspace(((0, 0), (6, 3)), [shapely.box(2.9, 0, 3.1, 0.9), shapely.box(2.9, 2.1, 3.1, 3)])


def swap(first, second):
    ends = np.array([(1.0, 1.0, 0.3), (5.0, 2.0, -2.0)])[:, : max(first.dof, second.dof)]
    return Problem(DOOR, [first, second], ends, ends[::-1])


@pytest.mark.parametrize("first, second", [(PEBBLE, DiscRobot(0.25)), (sled(), PointRobot())])
def test_new_convex_shapes_can_be_planned_for(first, second, tmp_path):
    problem = swap(first, second)
    solution = bl_plan(problem)
    report = validate(problem, solution.path)
    assert solution.solved and report.valid, report.message
    if first == PEBBLE:
        assert (solution.path[:, 1, 2] == problem.starts[1, 2]).all(), "discs keep the heading of their start"
        plot.animate(problem, solution.path, seconds=0.08).save(tmp_path / "path.gif")
        with Image.open(tmp_path / "path.gif") as image:
            assert image.n_frames == 3


def test_rotation_weight_is_distance_of_farthest_point():
    ends = [(1.0, 0.6, 0.0), (1.0, 1.6, 0.0), (1.0, 2.6, 0.0)]
    problem = Problem(DOOR, [RectangleRobot(0.8, 0.6), PEBBLE, DiscRobot(0.1)], ends, ends)
    np.testing.assert_allclose(problem.rotation_weights, [0.5, 0.36 + 0.12, 0.0])
    assert Problem(DOOR, [sled()], [(1, 1)], [(2, 1)]).dof == 2


def test_scene_file_refuses_unknown_shape(tmp_path):
    with pytest.raises(ValueError, match=r"Robot 0 must have one of the shapes .* polygon to be saved, got AnyShape"):
        scenes.save(swap(PEBBLE, WING), tmp_path / "a.json")
    assert list(tmp_path.iterdir()) == []


SQUARE = AnyShape(((-1, -1), (1, -1), (1, 1), (-1, 1)))


def test_problem_refuses_invalid_shapes():
    for robot, message in (
        (replace(SQUARE, body=SQUARE.body[::-1]), "be convex, its vertices counterclockwise"),
        (replace(SQUARE, body=(*SQUARE.body, (-1, 1))), "each given once"),
        (replace(SQUARE, body=()), "core of finite vertices"),
        (replace(SQUARE, body=((np.nan, 0),)), "core of finite vertices"),
        (replace(SQUARE, rounding=-1.0), "finite rounding"),
        (replace(SQUARE, dof=4), "dof of 2 or 3"),
        (AnyShape(((1.0, 0.0),), rounding=0.5), "reference point"),
    ):
        with pytest.raises(ValueError, match=f"Robot 0 must .*{message}"):
            Problem(Workspace(((0, 0), (9, 9))), [robot], [(4, 4, 0)], [(5, 5, 0)])


def test_disc_may_turn_about_a_point_of_its_rim():
    """Half a turn swings the disc past a point that it only touches at both ends."""
    wheel = AnyShape(((0.5, 0.0),), rounding=0.5)
    room = Workspace(((0, 0), (9, 9)))
    problem = Problem(room, [wheel, PointRobot()], [(4, 4, 0), (4, 4.9, 0)], [(4, 4, np.pi), (4, 4.9, 0)])
    assert wheel.inscribed_radius == 0.0 and wheel.circumscribed_radius == 1.0
    report = validate(problem, [problem.starts, problem.goals])
    assert not report.valid and report.who == (0, 1)


TRIANGLE = [(-1.0, -1.0), (2.0, -1.0), (-1.0, 3.0)]


def test_vertices_become_counterclockwise_and_open():
    for ring in (TRIANGLE, np.array(TRIANGLE)[[0, 2, 1]], [*TRIANGLE, TRIANGLE[0]], shapely.Polygon(TRIANGLE)):
        robot = PolygonRobot(ring)
        np.testing.assert_array_equal(robot.vertices[0], TRIANGLE[0])
        np.testing.assert_array_equal(robot.core, TRIANGLE)
        assert robot == PolygonRobot(TRIANGLE) and hash(robot) == hash(PolygonRobot(TRIANGLE))
    with pytest.raises(ValueError, match="read-only"):
        robot.vertices[0] = 7.0


def test_polygon_radii_and_breadth():
    robot = PolygonRobot(TRIANGLE)  # of sides 3, 4 and 5; its incircle of radius 1 is about the origin
    assert robot.inscribed_radius == pytest.approx(1.0)
    assert robot.circumscribed_radius == pytest.approx(10**0.5)
    assert (robot.dof, robot.rounding, robot.half_sides) == (3, 0.0, None)
    assert robot.breadth == pytest.approx(2.4)  # its height over the longest side


def test_reference_point_may_lie_on_boundary():
    assert PolygonRobot([(0, 0), (1, 0), (0, 1)]).inscribed_radius == 0.0
    assert PolygonRobot([(0.1, 0.2), (-0.1, -0.2), (1, -1)]).inscribed_radius == pytest.approx(0.0, abs=1e-15)


def test_rectangular_polygon_has_half_sides():
    box = PolygonRobot([(-1, 0.5), (-1, -0.5), (1, -0.5), (1, 0.5)])
    np.testing.assert_array_equal(box.half_sides, RectangleRobot(2, 1).half_sides)
    assert box != RectangleRobot(2, 1)


def test_invalid_polygon_vertices_raise():
    for vertices, message in (
        ([(0, 0), (1, 0)], "2 distinct vertices"),
        ([(0, 0), (1, 1), (2, 2)], "zero area"),
        ([(0, 0), (1, 0), (0, np.nan)], "must have finite coordinates"),
        ([(-1, -1), (0, -0.5), (1, -1), (0, 1)], "must be convex"),
        ([(np.cos(a), np.sin(a)) for a in 0.8 * np.pi * np.arange(5)], "not a simple polygon"),
        ([(1, 1), (2, 1), (1, 2)], r"must have its reference point.*1\.41 outside"),
        ([(0, 0, 0)] * 3, r"must have shape \(n, 2\)"),
        ("triangle", "must be numbers"),
        ([(np.cos(a), np.sin(a)) for a in np.linspace(0, 6, 1_001)], "must be at most 1,000, got 1,001"),
        (shapely.Polygon([(-3, -3), (3, -3), (0, 3)], [[(-1, -1), (1, -1), (0, 1)]]), "one polygon without holes"),
    ):
        with pytest.raises(ValueError, match=f"PolygonRobot vertices.*{message}"):
            PolygonRobot(vertices)


HAND = PolygonRobot([(0, -0.05), (3, -0.05), (3, 0.05), (0, 0.05)])  # about its left end
NOWHERE = np.zeros((0, 1, 3))

headings = st.floats(-100, 100)
ulps = st.integers(-64, 64)
sides = st.sampled_from([-1, 1])
TURNS = lambda a: a, lambda a: a % (2 * np.pi), lambda a: np.arctan2(np.sin(a), np.cos(a)), lambda a: a + 34 * np.pi
wraps = st.sampled_from(TURNS)


def half_turn_from(theta, side, k):
    """Return the opposite heading, ``k`` units in the last place off."""
    return theta + side * np.pi + k * np.spacing(abs(theta) + np.pi)


@given(headings, headings)
def test_shorter_turn_reaches_heading(a, b):
    (by,) = shorter_turn(np.array([a]), np.array([b]))
    assert -np.pi < by <= np.pi
    assert abs(np.exp(1j * (a + by)) - np.exp(1j * b)) < 1e-12


@given(headings, sides, ulps, wraps, wraps)
def test_half_turns_are_counterclockwise_despite_rounding(theta, side, k, wrap, wrap_other):
    ends = np.array([[wrap(theta)], [wrap_other(half_turn_from(theta, side, k))]])
    for first, last in (ends, ends[::-1]):
        assert shorter_turn(first, last)[0] == pytest.approx(np.pi, abs=1e-11)
        assert smaller_angle(first, last)[0] == pytest.approx(np.pi, abs=1e-11)


@given(st.lists(headings, min_size=3, max_size=3), sides, ulps)
def test_smaller_angle_is_a_metric(thetas, side, k):
    for a, b, c in (np.array(thetas), np.array([thetas[0], half_turn_from(thetas[0], side, k), thetas[1]])):
        ab, bc, ac = smaller_angle(np.array([a, b, a]), np.array([b, c, c]))
        assert ab == smaller_angle(np.array([b]), np.array([a]))[0] and 0 <= ab <= np.pi
        assert ac <= ab + bc + 1e-12
        assert abs(shorter_turn(np.array([a]), np.array([b]))[0]) == pytest.approx(ab, abs=1.3e-9)


def posted(theta, goal, ahead):
    """Return a hand that makes half a turn, with a small obstacle at the heading ``ahead``."""
    x, y = 2 * np.cos(ahead), 2 * np.sin(ahead)
    post = [(x - 0.1, y - 0.1), (x + 0.1, y - 0.1), (x + 0.1, y + 0.1), (x - 0.1, y + 0.1)]
    return Problem(Workspace(((-4, -4), (4, 4)), [post]), [HAND], [(0, 0, theta)], [(0, 0, goal)])


def test_all_modules_turn_half_turns_the_same_way():
    theta, goal = -40.0, half_turn_from(-40.0, -1, 3)
    path = np.array([[(0, 0, theta)], [(0, 0, goal)]])
    middle = theta + np.pi / 2
    for ahead, free in ((middle, False), (theta - np.pi / 2, True)):
        problem = posted(theta, goal, ahead)
        assert validate(problem, path).valid == free
        assert MotionTest(problem.workspace, HAND)(path[0], path[1])[0] == free
        post = np.array([[2 * np.cos(ahead), 2 * np.sin(ahead), 0]])
        assert motions_apart(HAND, path[0], path[1], PointRobot(), post, post, 0.0)[0] == free
    solution = make_solution(problem, path, 0.0, Status.SOLVED, Stats(0), NOWHERE)
    motion = timeline(problem, path)
    assert solution.path_at(solution.makespan / 2)[0, 2] == pytest.approx(middle)
    assert motion.at(np.array([motion.duration / 2]))[0, 0, 2] == pytest.approx(middle)
    assert path_cost(problem, path) == pytest.approx(HAND.circumscribed_radius * np.pi, rel=1e-9)
