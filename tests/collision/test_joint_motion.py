from itertools import combinations

import numpy as np
import pytest
import shapely
from robot_helpers import random_motions

from plr_jax import DiscRobot, PointRobot, RectangleRobot, Workspace
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


@pytest.mark.parametrize(("i", "but"), [(0, ()), (1, (0,)), (2, (0, 1))])
def test_motions_of_one_robot_against_the_path_of_the_others(i, but):
    rng = np.random.default_rng(1)
    path = np.concatenate([rng.uniform(0, 6, (9, 3, 2)), rng.uniform(-1, 1, (9, 3, 1))], axis=2)
    q0, q1 = (rng.uniform(0, 6, (40, 3)) for _ in range(2))
    motion = np.arange(8)[:, None]
    table = TEST.apart_from_others(i, q0, q1, path, motion, but)
    assert table.shape == (8, 40) and (table.all() if len(but) == 2 else 0 < table.sum() < table.size)
    for row in range(8):
        expected = np.ones(40, dtype=bool)
        for j in {0, 1, 2} - {i, *but}:
            theirs = (np.repeat(path[[end], j], 40, axis=0) for end in (row, row + 1))
            expected &= apart(i, q0, q1, j, *theirs)
        np.testing.assert_array_equal(table[row], expected)
