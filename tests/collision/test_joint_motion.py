from itertools import combinations

import numpy as np
import shapely
from robot_helpers import BAR, DISC, PEBBLE, POINT, WING, random_motions

from plr_jax import DiscRobot, PointRobot, RectangleRobot, Workspace
from plr_jax.collision.team import JointMotionTest, Traffic, motions_apart
from plr_jax.collision.walls import MotionTest

WORKSPACE = Workspace(((0, 0), (6, 6)), [shapely.box(2.5, 2.5, 3.5, 3.5)])
ROBOTS = [DiscRobot(0.4), RectangleRobot(1.2, 0.4), PointRobot()]
TEST = JointMotionTest(WORKSPACE, ROBOTS)


def motions(n, seed=0):
    rng = np.random.default_rng(seed)
    pairs = [random_motions(rng, n, 6.0, 0.8, 0.5) for _ in ROBOTS]
    return tuple(np.stack([pair[end] for pair in pairs], axis=1) for end in (0, 1))


def apart(i, a0, a1, j, b0, b1):
    return motions_apart(ROBOTS[i], a0, a1, ROBOTS[j], b0, b1, WORKSPACE.tolerance)


def test_a_joint_motion_is_free_if_each_robot_and_each_two_are():
    q0, q1 = motions(2_000)
    expected = np.ones(len(q0), dtype=bool)
    for i, robot in enumerate(ROBOTS):
        expected &= MotionTest(WORKSPACE, robot)(q0[:, i], q1[:, i])
    alone = expected.copy()
    for i, j in combinations(range(len(ROBOTS)), 2):
        expected &= apart(i, q0[:, i], q1[:, i], j, q0[:, j], q1[:, j])
    np.testing.assert_array_equal(TEST(q0, q1), expected)
    assert 20 < expected.sum() < alone.sum() - 20


def test_discs_that_swap_places_collide_and_those_that_follow_do_not():
    test = JointMotionTest(Workspace(((0, 0), (6, 2))), [DiscRobot(0.5)] * 2)
    q0 = np.array([[(1.0, 1.0), (3.0, 1.0)]] * 2)
    q1 = np.array([[(3.0, 1.0), (1.0, 1.0)], [(3.0, 1.0), (5.0, 1.0)]])
    assert test(q0, q1).tolist() == [False, True]


TEAM = [POINT, DISC, BAR, WING, PEBBLE, DiscRobot(0.1), DISC, POINT, RectangleRobot(0.9, 0.3), WING]
TEAM_TEST = JointMotionTest(WORKSPACE, TEAM)


def random_path(rng, steps, side):
    """Short motions of the team in a square, some at rest, most of them turning."""
    q = np.cumsum(rng.normal(0, [0.3, 0.3, 0.4], (steps, len(TEAM), 3)), axis=0)
    q[:, ::3] = q[:1, ::3]
    return q + np.pad(rng.uniform(0, side, (len(TEAM), 2)), ((0, 0), (0, 1)))


def test_motions_meet_others_as_they_are_not_apart_from_them():
    rng, collisions = np.random.default_rng(0), 0
    for i in range(len(TEAM)):
        path, motion = random_path(rng, 9, 3.0), rng.integers(0, 8, 300)
        begin, end = (path[motion + ahead, i] + rng.normal(0, 0.3, (300, 3)) for ahead in (0, 1))
        other = rng.choice(sorted(set(range(len(TEAM))) - {i}), 300)
        found = TEAM_TEST.meet(i, begin, end, Traffic(TEAM, path), motion, other)
        for k, j in enumerate(other.tolist()):
            theirs = (path[[motion[k] + ahead], j] for ahead in (0, 1))
            assert found[k] == ~TEAM_TEST.apart(i, begin[[k]], end[[k]], j, *theirs)[0]
        collisions += found.sum()
    assert 100 < collisions < 150 * len(TEAM)


def test_no_motions_meet_nobody():
    path = random_path(np.random.default_rng(0), 3, 6.0)
    none, nobody = np.zeros((0, 3)), np.zeros(0, dtype=int)
    assert len(TEAM_TEST.meet(1, none, none, Traffic(TEAM, path), nobody, nobody)) == 0
