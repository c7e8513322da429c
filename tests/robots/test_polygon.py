import numpy as np
import pytest
from shapely.geometry import Polygon

from plr_jax.robots.shapes import PolygonRobot, RectangleRobot

TRIANGLE = [(-1.0, -1.0), (2.0, -1.0), (-1.0, 3.0)]


def test_vertices_are_kept_counterclockwise_and_open_the_first_one_first():
    for given in (TRIANGLE, [TRIANGLE[0], TRIANGLE[2], TRIANGLE[1]], [*TRIANGLE, TRIANGLE[0]], Polygon(TRIANGLE)):
        robot = PolygonRobot(given)
        np.testing.assert_array_equal(robot.vertices[0], TRIANGLE[0])
        np.testing.assert_array_equal(robot.core, TRIANGLE)
        assert robot == PolygonRobot(TRIANGLE) and hash(robot) == hash(PolygonRobot(TRIANGLE))
    with pytest.raises(ValueError, match="read-only"):
        robot.vertices[0] = 7.0


def test_radii_are_about_the_reference_point():
    robot = PolygonRobot(TRIANGLE)  # of sides 3, 4 and 5; its incircle of radius 1 is about the origin
    assert robot.inscribed_radius == pytest.approx(1.0)
    assert robot.circumscribed_radius == pytest.approx(10**0.5)
    assert (robot.dof, robot.rounding, robot.half_sides) == (3, 0.0, None)
    assert robot.breadth == pytest.approx(2.4)  # its height over the longest side


def test_the_reference_point_may_lie_on_the_boundary():
    assert PolygonRobot([(0, 0), (1, 0), (0, 1)]).inscribed_radius == 0.0
    assert PolygonRobot([(0.1, 0.2), (-0.1, -0.2), (1, -1)]).inscribed_radius == pytest.approx(0.0, abs=1e-15)


def test_a_polygon_that_is_a_rectangle_has_its_sides():
    box = PolygonRobot([(-1, 0.5), (-1, -0.5), (1, -0.5), (1, 0.5)])
    np.testing.assert_array_equal(box.half_sides, RectangleRobot(2, 1).half_sides)
    assert box != RectangleRobot(2, 1)


@pytest.mark.parametrize(
    ("vertices", "message"),
    [
        ([(0, 0), (1, 0)], "2 distinct vertices"),
        ([(0, 0), (1, 1), (2, 2)], "zero area"),
        ([(0, 0), (1, 0), (0, np.nan)], "not finite"),
        ([(-1, -1), (0, -0.5), (1, -1), (0, 1)], "must be convex"),
        ([(np.cos(a), np.sin(a)) for a in 0.8 * np.pi * np.arange(5)], "not a simple polygon"),
        ([(1, 1), (2, 1), (1, 2)], r"must have its reference point.*1\.41 outside"),
        ([(0, 0, 0)] * 3, r"must have shape \(n, 2\)"),
        ("triangle", "must be numbers"),
        ([(np.cos(a), np.sin(a)) for a in np.linspace(0, 6, 1_001)], "must be at most 1,000, got 1,001"),
        (Polygon([(-3, -3), (3, -3), (0, 3)], [[(-1, -1), (1, -1), (0, 1)]]), "one polygon without holes"),
    ],
)
def test_what_is_no_convex_polygon_about_the_origin_is_refused(vertices, message):
    with pytest.raises(ValueError, match=f"PolygonRobot vertices.*{message}"):
        PolygonRobot(vertices)
