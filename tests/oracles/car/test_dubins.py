import numpy as np
import pytest
from car_helpers import GOAL, LATTICE, RADIUS, driven, in_frame_of, ompl_distances, pose_error, random_poses
from hypothesis import given
from hypothesis import strategies as st

from plr_jax import Dubins, Euclidean, ReedsShepp

ORACLE = Dubins(GOAL, RADIUS)


@pytest.mark.parametrize(
    ("pose", "length"),
    [
        ((0, 0, 0), 0),
        ((-5, 0, 0), 5),
        ((9, 0, 0), 9 + 4 * np.pi),  # half a circle, back, half a circle
        ((0, 4, np.pi), 2 * np.pi),  # half a circle to the left
        ((-2, 2, -np.pi / 2), np.pi),
        ((-2, -2, np.pi / 2), np.pi),
        ((2, 2, np.pi / 2), 3 * np.pi),  # three quarters to the left
        ((-4, 4, 0), 2 * np.pi),  # a quarter to the right, a quarter to the left
        ((0, 0, np.pi), 2 * np.pi * 7 / 3),  # 60 degrees to a side, 300 to the other, 60 back
    ],
)
def test_lengths_drawn_by_hand(pose, length):
    np.testing.assert_allclose(Dubins((0, 0, 0), 2)([pose]), [length], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("extent", [1, 4, 40])
def test_lengths_are_those_of_ompl(extent):
    poses = random_poses(4000, extent)
    expected = ompl_distances("DubinsStateSpace", RADIUS, poses, GOAL)
    np.testing.assert_allclose(ORACLE(poses), expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("goal", [(0, 0, 0), GOAL, (100.1, -37.3, -1.1)])
def test_lengths_are_those_of_ompl_where_they_jump(goal):
    goal = np.array(goal, float)
    expected = ompl_distances("DubinsStateSpace", 1.0, LATTICE, np.zeros(3))
    np.testing.assert_allclose(Dubins(goal, 1)(in_frame_of(goal, LATTICE)), expected, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("extent", [0.01, 2, 8, 40])
def test_paths_end_at_the_goal_and_are_as_long_as_is_said(extent):
    for pose, length in zip(poses := random_poses(200, extent), ORACLE(poses), strict=True):
        path = ORACLE.shortest_path(pose)
        assert len(path) <= 3 and all(piece > 0 for _, piece in path)
        assert sum(piece for _, piece in path) == pytest.approx(length, rel=1e-12)
        assert pose_error(driven(pose, path, RADIUS), GOAL) < 1e-12 * (1 + extent)


def test_all_words_are_used():
    used = {"".join(letter for letter, _ in ORACLE.shortest_path(pose)) for pose in random_poses(3000, 6)}
    assert used == {"LSL", "RSR", "LSR", "RSL", "LRL", "RLR"}


POSE = st.tuples(st.floats(-9, 9), st.floats(-9, 9), st.floats(-10, 10))
TURN = st.floats(0, 6 * RADIUS)


@given(POSE, st.sampled_from("LSR"), TURN)
def test_no_detour_is_shorter(pose, letter, length):
    there = driven(pose, [(letter, length)], RADIUS)
    direct, onward = ORACLE(np.array([pose, there]))
    assert direct <= length + onward + 1e-8


@given(st.permutations("LSR"), st.tuples(TURN, TURN, TURN))
def test_no_path_driven_is_shorter(letters, lengths):
    """Among them single turns and those of both sides, where the distance jumps."""
    path = list(zip(letters, lengths, strict=True))
    goal = driven((0.0, 0.0, 0.0), path, RADIUS)
    assert Dubins(goal, RADIUS)([(0, 0, 0)])[0] <= sum(lengths) + 1e-8


@given(POSE)
def test_gears_and_room_to_turn_save_length(pose):
    fns = Euclidean(GOAL[:2]), ReedsShepp(GOAL, RADIUS), ORACLE
    direct, both_ways, forward = (fn([pose[: fn.dim]])[0] for fn in fns)
    assert direct <= both_ways + 1e-9 and both_ways <= forward + 1e-7


def test_it_jumps_where_a_single_turn_leads_to_the_goal():
    quarter = np.array([[-1.0, 1.0, -np.pi / 2]])
    for offset, turns in ((0, 0.25), (1e-12, 0.25), (-1e-12, 0.25), (1e-6, 1.25), (-1e-6, 0.25)):
        pose = in_frame_of(GOAL, quarter + np.array([offset, 0, 0]))
        np.testing.assert_allclose(Dubins(GOAL, 1)(pose), [turns * 2 * np.pi], atol=1e-5)
    assert Dubins(GOAL, 1)([GOAL + np.array([0, 0, 1e-6])])[0] > 6
    assert Dubins(GOAL, 1)([GOAL + np.array([0, 0, 1e-12])])[0] < 1e-11


def test_it_is_not_as_far_back_as_there():
    np.testing.assert_allclose(Dubins((0, 0, 0), 1)([(-9, 0, 0)]), [9])
    np.testing.assert_allclose(Dubins((-9, 0, 0), 1)([(0, 0, 0)]), [9 + 2 * np.pi])


def test_whole_turns_are_no_way():
    poses = random_poses(500)
    for turns in (-1, 3):
        np.testing.assert_allclose(ORACLE(poses + np.array([0, 0, 2 * np.pi * turns])), ORACLE(poses), rtol=1e-11)
    assert Dubins((1, 2, 0.5), 3)([(1, 2, 0.5 + 2 * np.pi)]) < 1e-15


def test_what_is_no_pose_is_out_of_reach():
    for bad in (np.nan, np.inf, -np.inf):
        np.testing.assert_array_equal(ORACLE(np.where(np.eye(3), bad, 1.0)), [np.inf] * 3)


def test_poses_very_far_away_are_as_far_as_the_crow_flies():
    np.testing.assert_allclose(ORACLE([(1e9, 0, 1), (3e200, 4e200, 1)]), [1e9, 5e200], rtol=1e-7)
    with pytest.raises(ValueError, match="nearer to the goal"):
        ORACLE.shortest_path((3e200, 4e200, 1))


@pytest.mark.parametrize(
    ("goal", "radius", "x", "message"),
    [
        ((0, 0), 1, None, r"goal pose must be one point of shape \(3,\)"),
        ((0, 0, 0), -1, None, "radius must be a positive finite number, got -1"),
        ((0, 0, 0), 1, np.zeros((2, 2)), r"x must have shape \(n, 3\), got \(2, 2\)"),
    ],
)
def test_bad_input_is_refused(goal, radius, x, message):
    with pytest.raises(ValueError, match=message):
        Dubins(goal, radius)(x)
