import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from plr_jax.robots.robot import DiscRobot, PointRobot, RectangleRobot, footprint, shorter_turn, team_dof


def test_radii_of_the_discs_within_and_around():
    assert (PointRobot().inscribed_radius, PointRobot().circumscribed_radius) == (0.0, 0.0)
    assert (DiscRobot(0.4).inscribed_radius, DiscRobot(0.4).circumscribed_radius) == (0.4, 0.4)
    rectangle = RectangleRobot(3.0, 4.0)
    assert (rectangle.inscribed_radius, rectangle.circumscribed_radius) == (1.5, 2.5)


@pytest.mark.parametrize("size", [0, -1, np.nan, np.inf, "wide", None])
def test_sizes_must_be_positive_and_finite(size):
    for make in (DiscRobot, lambda x: RectangleRobot(x, 1), lambda x: RectangleRobot(1, x)):
        with pytest.raises(ValueError, match="must be a positive finite number, got"):
            make(size)


def test_robots_are_values():
    assert DiscRobot(1) == DiscRobot(1.0)
    assert len({PointRobot(), PointRobot(), RectangleRobot(2, 1), RectangleRobot(1, 2)}) == 3


def test_a_team_has_headings_if_any_robot_has_corners():
    assert team_dof([PointRobot(), DiscRobot(1)]) == 2
    assert team_dof([DiscRobot(1), RectangleRobot(2, 1)]) == 3


def turn(a, b):
    return float(shorter_turn(np.array([a], float), np.array([b], float))[0])


@pytest.mark.parametrize(
    ("a", "b", "by"),
    [(0.1, 0.3, 0.2), (0.3, 0.1, -0.2), (3, -3, 2 * np.pi - 6), (0, 40 * np.pi + 1, 1), (0, np.pi, np.pi),
     (0, -np.pi, np.pi)],
)  # fmt: skip
def test_the_turn_is_the_shorter_one_and_half_a_turn_goes_counterclockwise(a, b, by):
    assert turn(a, b) == pytest.approx(by, abs=1e-12)


@given(st.floats(-50, 50), st.floats(-50, 50))
def test_a_turn_leads_to_the_heading_and_is_at_most_half(a, b):
    by = turn(a, b)
    assert -np.pi < by <= np.pi
    assert abs(np.exp(1j * (a + by)) - np.exp(1j * b)) < 1e-12


def test_footprints():
    assert shapely.equals(footprint(DiscRobot(2.0), np.array([1.0, 2.0, 9.0])), shapely.Point(1, 2))
    upright = footprint(RectangleRobot(4.0, 2.0), np.array([1.0, 2.0, np.pi / 2]))
    assert shapely.symmetric_difference(upright, shapely.box(0, 0, 2, 4)).area < 1e-12
