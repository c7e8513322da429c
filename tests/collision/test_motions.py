"""Collisions of robots that move: motions of two robots, of teams, and of robots beside a team's path."""

from itertools import combinations, combinations_with_replacement

import numpy as np
import pytest
import shapely
from robot_helpers import BAR, DISC, PEBBLE, POINT, ROBOTS, WING, random_motions, sampled_distance

from plr_jax import DiscRobot, PointRobot, RectangleRobot, Workspace
from plr_jax.collision.motions import JointMotionTest, TeamTrajectory, circles, motions_apart, within_reach
from plr_jax.collision.walls import MotionTest

TOLERANCE = 1e-9
CORNER = BAR.circumscribed_radius
UP = np.pi / 2


def apart(robot_a, a0, a1, robot_b, b0, b1):
    q = (np.array([x], dtype=float) for x in (a0, a1, b0, b1))
    a0, a1, b0, b1 = q
    return bool(motions_apart(robot_a, a0, a1, robot_b, b0, b1, TOLERANCE)[0])


# BAR is 0.9 x 0.3, DISC has radius 0.3. In each case the two touch; moved up, the second one is clear.
STILL, GO = (0.0, 0.0, 0.0), (2.0, 0.0, 0.0)
CASES = {
    "discs pass head-on, side by side": (DISC, STILL, GO, DISC, (2.0, 0.6, 0), (0.0, 0.6, 0)),
    "a disc ends at a disc": (DISC, (0, -2, 0), STILL, DISC, (0, 0.6, 0), (0, 0.6, 0)),
    "discs follow one another": (DISC, STILL, (0, 9, 0), DISC, (0, 0.6, 0), (0, 9.6, 0)),
    "a point passes a disc": (POINT, STILL, GO, DISC, (1.0, 0.3, 0), (1.0, 0.3, 0)),
    "a point passes the end of an upright bar": (POINT, STILL, GO, BAR, (1.0, 0.45, UP), (1.0, 0.45, UP)),
    "a disc passes a bar's corner": (
        DISC, (-1, 1, 0), (1, -1, 0), BAR, (0.45 + 0.3 / 2**0.5, 0.15 + 0.3 / 2**0.5, 0), None),
    "bars slide along one another": (BAR, STILL, GO, BAR, (2.0, 0.3, 0), (0.0, 0.3, 0)),
    "a bar's side passes an upright bar's end": (BAR, STILL, GO, BAR, (1.0, 0.6, UP), (1.0, 0.6, UP)),
    "a bar passes a bar on its corner": (
        BAR, STILL, GO, RectangleRobot(1, 1), (1.0, 0.15 + 0.5**0.5, np.pi / 4), (1.0, 0.15 + 0.5**0.5, np.pi / 4)),
    "a wing's corner slides along a bar": (WING, STILL, GO, BAR, (1.0, 0.55, 0), (1.0, 0.55, 0)),
    "a wing's side slides along a bar's corner": (
        WING, (0, 0, 0), (0.5, -0.4, 0), BAR, (0.25 + 0.45, 0.2 + 0.15, 0), None),
    "a pebble slides along a bar": (PEBBLE, STILL, GO, BAR, (1.0, 0.21 + 0.12 + 0.15, 0), (1.0, 0.48, 0)),
    "a pebble passes a bar's corner": (
        PEBBLE, (-1, 1, 0), (1, -1, 0), BAR, (0.36 + 0.12 / 2**0.5 + 0.45, 0.12 / 2**0.5 + 0.15, 0), None),
    "a bar turns upright below a bar": (BAR, STILL, (0, 0, UP), BAR, (0, CORNER + 0.15, 0), None),
    "a bar turns upright below a disc": (BAR, STILL, (0, 0, UP), DISC, (0, CORNER + 0.3, 0), None),
    "a bar turns upright below a point": (BAR, STILL, (0, 0, UP), POINT, (0, CORNER, 0), None),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_touching_is_free_and_overlap_is_not(case):
    robot_a, a0, a1, robot_b, b0, b1 = case
    b1 = b0 if b1 is None else b1
    (xb0, yb0, tb0), (xb1, yb1, tb1) = b0, b1
    for lift, expected in ((1e-6, True), (0.0, True), (-1e-6, False), (-0.1, False)):
        if a0[2] != a1[2] and lift == 0.0:
            continue  # a turn that touches may be refused
        up0, up1 = (xb0, yb0 + lift, tb0), (xb1, yb1 + lift, tb1)
        assert apart(robot_a, a0, a1, robot_b, up0, up1) == expected
        assert apart(robot_b, up0, up1, robot_a, a0, a1) == expected
        assert apart(robot_a, a1, a0, robot_b, up1, up0) == expected  # backwards in time


@pytest.mark.parametrize(("robot_a", "robot_b"), list(combinations_with_replacement(ROBOTS, 2)))
def test_pair_verdicts_agree_with_dense_samples(robot_a, robot_b):
    rng = np.random.default_rng(3)
    n, num_samples = 60, 41
    a0, a1 = random_motions(rng, n, 1.5, 0.4, 1.5)
    b0, b1 = random_motions(rng, n, 1.5, 0.4, 1.5)
    a1[: n // 4, 2], b1[: n // 4, 2] = a0[: n // 4, 2], b0[: n // 4, 2]  # some do not turn
    answer = motions_apart(robot_a, a0, a1, robot_b, b0, b1, TOLERANCE)
    distance = sampled_distance(robot_a, a0, a1, robot_b, b0, b1, num_samples)
    assert not answer[distance < -1e-8].any()
    # Between samples the distance falls by at most as much as the bodies move in half a step.
    speed = np.linalg.norm((a1 - a0 - b1 + b0)[:, :2], axis=1)
    speed += robot_a.circumscribed_radius * np.abs(a1 - a0)[:, 2]
    speed += robot_b.circumscribed_radius * np.abs(b1 - b0)[:, 2]
    assert answer[distance > speed / (num_samples - 1) / 2 + 1e-6].all()
    if not robot_a == robot_b == POINT:
        assert 0.05 < answer.mean() < 0.95


# Teams

WORKSPACE = Workspace(((0, 0), (6, 6)), [shapely.box(2.5, 2.5, 3.5, 3.5)])
MOVERS = [DiscRobot(0.4), RectangleRobot(1.2, 0.4), PointRobot()]
TEST = JointMotionTest(WORKSPACE, MOVERS)


def test_joint_motion_is_free_if_all_robots_and_pairs_are():
    rng = np.random.default_rng(0)
    ends = zip(*(random_motions(rng, 600, 6.0, 0.8, 0.5) for _ in MOVERS), strict=True)
    q0, q1 = (np.stack(q, axis=1) for q in ends)
    expected = np.ones(len(q0), dtype=bool)
    for i, robot in enumerate(MOVERS):
        expected &= MotionTest(WORKSPACE, robot)(q0[:, i], q1[:, i])
    alone = expected.copy()
    for i, j in combinations(range(len(MOVERS)), 2):
        expected &= motions_apart(MOVERS[i], q0[:, i], q1[:, i], MOVERS[j], q0[:, j], q1[:, j], TOLERANCE)
    np.testing.assert_array_equal(TEST(q0, q1), expected)
    assert 10 < expected.sum() < alone.sum() - 10


CROWD = [POINT, DISC, BAR, WING, PEBBLE, DiscRobot(0.1), DISC, POINT, RectangleRobot(0.9, 0.3), WING]
CROWD_TEST = JointMotionTest(WORKSPACE, CROWD)


def random_path(rng, steps, side):
    """Short motions of the team in a square, some at rest, most of them turning."""
    q = np.cumsum(rng.normal(0, [0.3, 0.3, 0.4], (steps, len(CROWD), 3)), axis=0)
    q[:, ::3] = q[:1, ::3]
    return q + np.pad(rng.uniform(0, side, (len(CROWD), 2)), ((0, 0), (0, 1)))


def test_robots_meet_where_their_motions_are_not_apart():
    rng, collisions = np.random.default_rng(0), 0
    for i in range(len(CROWD)):
        path, motion = random_path(rng, 9, 3.0), rng.integers(0, 8, 60)
        begin, end = (path[motion + ahead, i] + rng.normal(0, 0.3, (60, 3)) for ahead in (0, 1))
        other = rng.choice(sorted(set(range(len(CROWD))) - {i}), 60)
        found = CROWD_TEST.meet(i, begin, end, TeamTrajectory(CROWD, path), motion, other)
        for k, j in enumerate(other.tolist()):
            theirs = (path[[motion[k] + ahead], j] for ahead in (0, 1))
            assert found[k] == ~CROWD_TEST.apart(i, begin[[k]], end[[k]], j, *theirs)[0]
        collisions += found.sum()
    assert 20 < collisions < 30 * len(CROWD)


def test_robots_near_lists_only_robots_within_reach():
    q = np.array([[(0.0, 0.0), (1.0, 0.0), (0.0, 9.0)]] * 2)
    traffic = TeamTrajectory([DISC] * 3, q)
    around, motion = circles(q[:1, :1], q[1:, :1]), np.array([0])
    assert [x.tolist() for x in traffic.robots_near(0, around, motion)] == [[], []]  # two radii are 0.6
    traffic.move(1, np.array([(0.5, 0.0)] * 2))
    assert [x.tolist() for x in traffic.robots_near(0, around, motion)] == [[0], [1]]
    assert [x.tolist() for x in traffic.robots_near(0, around, motion, (1,))] == [[], []]
    np.testing.assert_array_equal(q[:, 1], [(1.0, 0.0)] * 2, err_msg="the path given is left alone")


@pytest.mark.parametrize("seed", range(3))
def test_moved_rows_equal_a_new_trajectory(seed):
    rng = np.random.default_rng(seed)
    path = random_path(rng, 12, 4.0)
    traffic, changed = TeamTrajectory(CROWD, path), path.copy()
    for i, rows in ((1, slice(0, 12)), (3, slice(4, 9)), (3, slice(7, 12))):
        changed[rows, i][1:-1] += rng.normal(0, 1, (rows.stop - rows.start - 2, 3))
        traffic.move(i, changed[rows, i], rows)
    made = TeamTrajectory(CROWD, changed)
    np.testing.assert_array_equal(traffic.path, changed)
    around, motion = circles(*rng.uniform(0, 4, (2, 40, 2, 3))), rng.integers(0, 11, 40)
    for a, b in zip(traffic.robots_near(2, around, motion), made.robots_near(2, around, motion), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("i, j", [(1, 6), (2, 3), (0, 4)])
def test_robots_out_of_reach_are_apart(i, j):
    rng = np.random.default_rng(7)
    a0, b0 = rng.uniform(0, 4, (2, 200, 2, 3))
    a1, b1 = (q[:, :1] + rng.normal(0, 0.4, (200, 3, 3)) for q in (a0, b0))
    a = a0[:, :, None, None, None], a1[:, None, :, None, None]
    b = b0[:, None, None, :, None], b1[:, None, None, None]
    meet = np.flatnonzero(~motions_apart(CROWD[i], *a, CROWD[j], *b, TOLERANCE).all(axis=(1, 2, 3, 4)))
    near = np.flatnonzero(within_reach(CROWD[i], circles(a0, a1), CROWD[j], circles(b0, b1)))
    assert np.isin(meet, near).all() and 0 < len(meet) <= len(near) < 200
