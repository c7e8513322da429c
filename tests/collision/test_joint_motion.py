from itertools import combinations

import numpy as np
import pytest
import shapely
from robot_helpers import BAR, DISC, PEBBLE, POINT, WING, random_motions

from plr_jax import DiscRobot, PointRobot, RectangleRobot, Workspace
from plr_jax.collision.broad_phase import Traffic
from plr_jax.collision.joint_motion import JointMotionTest
from plr_jax.collision.pairs import motions_apart
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


@pytest.mark.parametrize("but", [(), (0, 4)])
@pytest.mark.parametrize("i", range(len(TEAM)))
def test_collisions_with_others_are_those_of_all_pairs(i, but):
    rng = np.random.default_rng(i)
    collisions, motions = 0, 0
    for side, places in ((2.0, 1), (6.0, 3), (30.0, 3)):
        path = random_path(rng, 9, side)
        motion = rng.integers(0, 8, 12)
        begin = path[motion, i][:, None] + rng.normal(0, 0.3, (12, places, 3))
        end = path[motion + 1, i][:, None] + rng.normal(0, 0.3, (12, places + 1, 3))
        found = TEAM_TEST.collisions_with_others(i, begin, end, Traffic(TEAM, path), motion, but)
        expected = np.zeros((12, places, places + 1, len(TEAM)), dtype=bool)
        for j in set(range(len(TEAM))) - {i, *but}:
            theirs = (path[motion + ahead, j][:, None, None] for ahead in (0, 1))
            expected[..., j] = ~TEAM_TEST.apart(i, begin[:, :, None], end[:, None], j, *theirs)
        assert set(zip(*(x.tolist() for x in found), strict=True)) == set(map(tuple, np.argwhere(expected).tolist()))
        collisions, motions = collisions + expected.sum(), motions + expected.size
    assert 10 < collisions < motions / 2


def test_no_motions_collide_with_nobody():
    path = random_path(np.random.default_rng(0), 3, 6.0)
    none, traffic = np.zeros((0, 2, 3)), Traffic(TEAM, path)
    assert [len(x) for x in TEAM_TEST.collisions_with_others(1, none, none, traffic, np.zeros(0, dtype=int))] == [
        0
    ] * 4
