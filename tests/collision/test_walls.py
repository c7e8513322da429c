"""Collisions of robots that move with walls and bounds, against hand-made contacts and Shapely."""

import numpy as np
import pytest
import shapely
from piece_helpers import box
from robot_helpers import BAR, DISC, POINT, ROBOTS, along, random_motions, shapes

from plr_jax.collision.walls import MotionTest, motion_test
from plr_jax.geometry.workspace import Workspace
from plr_jax.robots import DiscRobot, PolygonRobot, RectangleRobot

UP = np.pi / 2
# A pillar in the middle of a 4 x 4 room, and a slanted thin wall.
ROOM = Workspace(((0, 0), (4, 4)), [box(1.8, 1.8, 2.2, 2.2), [(3, 0.2), (3.02, 0.2), (3.82, 1.0), (3.8, 1.0)]])


def is_free(robot, q0, q1, workspace=ROOM):
    return bool(motion_test(workspace, robot)(np.array([q0], dtype=float), np.array([q1], dtype=float))[0])


# In each case the robot touches the pillar, whose top is y = 2.2; moved up, it is clear of it.
TOUCHING = {
    "a point slides": (POINT, (1, 2.2, 0), (3, 2.2, 0)),
    "a disc slides": (DISC, (1, 2.5, 0), (3, 2.5, 0)),
    "a disc drops on it": (DISC, (2, 3.5, 0), (2, 2.5, 0)),
    "a disc passes the corner": (
        DISC, (1.2 + 0.3 / 2**0.5, 3.2 + 0.3 / 2**0.5, 0), (3.2 + 0.3 / 2**0.5, 1.2 + 0.3 / 2**0.5, 0)),
    "a bar slides": (BAR, (1, 2.35, 0), (3, 2.35, 0)),
    "an upright bar slides": (BAR, (1, 2.65, UP), (3, 2.65, UP)),
    "a bar on its corner slides": (
        RectangleRobot(1, 1), (1, 2.2 + 0.5**0.5, np.pi / 4), (3, 2.2 + 0.5**0.5, np.pi / 4)),
    "a bar turns upright": (
        BAR, (2, 2.2 + BAR.circumscribed_radius, 0), (2, 2.2 + BAR.circumscribed_radius, UP)),
}  # fmt: skip


@pytest.mark.parametrize("case", TOUCHING.values(), ids=TOUCHING)
def test_touching_is_free_and_overlap_is_not(case):
    robot, (x0, y0, t0), (x1, y1, t1) = case
    for lift, expected in ((1e-6, True), (0.0, True), (-1e-6, False), (-0.2, False)):
        if t0 == t1 or lift != 0.0:  # a turn that touches may be refused
            assert is_free(robot, (x0, y0 + lift, t0), (x1, y1 + lift, t1)) == expected
            assert is_free(robot, (x1, y1 + lift, t1), (x0, y0 + lift, t0)) == expected


def test_bounds_are_walls():
    for robot, reach in ((POINT, 0.0), (DISC, 0.3), (BAR, 0.15)):
        assert is_free(robot, (1, reach, 0), (2.2, reach, 0))
        assert not is_free(robot, (1, reach - 1e-6, 0), (2.2, reach - 1e-6, 0))
        assert not is_free(robot, (1, 1, 0), (1, -3, 0))
        assert not is_free(robot, (-20, -20, 0), (-20, -20, 0))
        assert not is_free(robot, (-5, 1, 0), (9, 1, 0))


def test_body_with_reference_point_on_wall_needs_free_side():
    wedge, block = PolygonRobot([(0, 0), (1, 0), (0, 1)]), Workspace(((0, 0), (10, 10)), [box(2, 2, 9, 9)])
    for heading, free in ((0.0, False), (UP, True), (2 * UP, True), (3 * UP, False)):
        assert is_free(wedge, (2, 5, heading), (2, 5.5, heading), block) == free


def test_long_motions_do_not_jump_over_thin_walls():
    thin = Workspace(((0, 0), (10, 1)), [box(5, 0, 5 + 1e-6, 1)])
    for robot in (POINT, DiscRobot(0.1), RectangleRobot(0.2, 0.1)):
        assert not is_free(robot, (1, 0.5, 0), (9, 0.5, 0.4), thin)
        assert is_free(robot, (1, 0.5, 0), (4.5, 0.5, 0.4), thin)


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("step", [0.2, 1.5])
def test_wall_verdicts_agree_with_dense_samples(robot, step):
    rng = np.random.default_rng(4)
    n, num_samples = 120, 41
    q0, q1 = random_motions(rng, n, 4.0, step, 1.0)
    q1[: n // 3, 2] = q0[: n // 3, 2]
    answer = MotionTest(ROOM, robot)(q0, q1)
    bodies = shapes(robot, along(q0, q1, num_samples))
    blocked = shapely.difference(shapely.box(-20, -20, 20, 20), ROOM.free_space)
    shapely.prepare(blocked)
    distance = shapely.distance(bodies, blocked) - robot.rounding
    distance[shapely.relate_pattern(bodies, blocked, "T********")] = -1.0
    distance = distance.reshape(n, num_samples).min(axis=1)
    assert not answer[distance < -1e-8].any()
    speed = np.linalg.norm((q1 - q0)[:, :2], axis=1) + robot.circumscribed_radius * np.abs(q1 - q0)[:, 2]
    assert answer[distance > speed / (num_samples - 1) / 2 + 1e-6].all()
    assert 0.05 < answer.mean() < 0.95


def test_disc_verdict_equals_distance_of_its_path():
    rng = np.random.default_rng(5)
    q0, q1 = random_motions(rng, 3000, 4.0, 0.5, 0.0)
    lines = shapely.linestrings(np.stack([q0[:, :2], q1[:, :2]], axis=1))
    blocked = shapely.difference(shapely.box(-20, -20, 20, 20), ROOM.free_space)
    expected = shapely.distance(lines, blocked) >= DISC.radius
    np.testing.assert_array_equal(MotionTest(ROOM, DISC)(q0[:, :2], q1[:, :2]), expected)


def test_sliding_bar_verdict_equals_its_swept_hull():
    rng = np.random.default_rng(6)
    q0, q1 = random_motions(rng, 3000, 4.0, 0.5, 0.0)
    ends = [shapely.get_coordinates(shapes(BAR, q)).reshape(len(q), 5, 2) for q in (q0, q1)]
    hulls = shapely.convex_hull(shapely.multipoints(np.concatenate(ends, axis=1)))
    expected = shapely.covers(ROOM.free_space, hulls)
    np.testing.assert_array_equal(MotionTest(ROOM, BAR)(q0, q1), expected)
