import numpy as np
import pytest
from car_helpers import GOAL, LATTICE, RADIUS, driven, in_frame_of, ompl_distances, pose_error, random_poses
from hypothesis import given
from hypothesis import strategies as st

from plr_jax import ReedsShepp

ORACLE = ReedsShepp(GOAL, RADIUS)


@pytest.mark.parametrize(
    ("pose", "length"),
    [
        ((0, 0, 0), 0),
        ((-5, 0, 0), 5),
        ((5, 0, 0), 5),  # in reverse
        ((-2, 2, -np.pi / 2), np.pi),  # a quarter of a circle to the left
        ((2, 2, np.pi / 2), np.pi),  # the same in reverse
        ((-2, -2, np.pi / 2), np.pi),
        ((-4, 4, 0), 2 * np.pi),  # a quarter to the right, a quarter to the left
        ((0, 0, np.pi), 2 * np.pi),  # three turns of 60 degrees, and cusps between them
        ((0, 1e-10, 0), 4e-5),  # four turns u, as R L forward and R L in reverse: 2 u**2 radii aside
    ],
)
def test_lengths_drawn_by_hand(pose, length):
    np.testing.assert_allclose(ReedsShepp((0, 0, 0), 2)([pose]), [length], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("extent", [1, 4, 40])
def test_lengths_are_those_of_ompl(extent):
    poses = random_poses(4000, extent)
    expected = ompl_distances("ReedsSheppStateSpace", RADIUS, poses, GOAL)
    np.testing.assert_allclose(ORACLE(poses), expected, rtol=1e-12, atol=1e-12)


def test_lengths_are_those_of_ompl_where_words_meet():
    expected = ompl_distances("ReedsSheppStateSpace", 1.0, LATTICE, np.zeros(3))
    np.testing.assert_allclose(ReedsShepp((0, 0, 0), 1)(LATTICE), expected, rtol=1e-12, atol=1e-12)
    # In another frame the rounding of poses shows: a path aside by as little as 1e-16 is 4e-8 long.
    np.testing.assert_allclose(ReedsShepp(GOAL, 1)(in_frame_of(GOAL, LATTICE)), expected, atol=1e-7)


@pytest.mark.parametrize("extent", [0.01, 2, 8, 40])
def test_paths_end_at_the_goal_and_are_as_long_as_is_said(extent):
    for pose, length in zip(poses := random_poses(200, extent), ORACLE(poses), strict=True):
        path = ORACLE.shortest_path(pose)
        assert len(path) <= 5 and all(abs(piece) > 0 for _, piece in path)
        assert sum(abs(piece) for _, piece in path) == pytest.approx(length, rel=1e-12)
        assert pose_error(driven(pose, path, RADIUS), GOAL) < 1e-12 * (1 + extent)


def test_all_kinds_of_words_are_used():
    used = {"".join(letter for letter, _ in ORACLE.shortest_path(pose)) for pose in random_poses(3000, 6)}
    assert {"LSL", "LSR", "LRL", "LRLR", "LRSL", "LSRL", "LRSR", "LSLR", "LRSLR"} <= used
    assert {"RSR", "RSL", "RLR", "RLRL", "RLSR", "RSLR", "RLSL", "RSRL", "RLSRL"} <= used


@given(st.tuples(st.floats(-9, 9), st.floats(-9, 9), st.floats(-10, 10)), st.sampled_from("LSR"), st.floats(-6, 6))
def test_no_detour_is_shorter(pose, letter, length):
    """Of motions in any gear: the equation that a shortest path satisfies, and no other length above it does."""
    there = driven(pose, [(letter, length)], RADIUS)
    direct, onward = ORACLE(np.array([pose, there]))
    assert direct <= abs(length) + onward + 1e-7


@given(st.tuples(st.floats(-9, 9), st.floats(-9, 9), st.floats(-10, 10)))
def test_there_is_as_far_as_back(pose):
    np.testing.assert_allclose(ORACLE([pose]), ReedsShepp(pose, RADIUS)([GOAL]), atol=1e-7)


def test_whole_turns_are_no_way():
    poses = random_poses(500)
    for turns in (-1, 3):
        np.testing.assert_allclose(ORACLE(poses + np.array([0, 0, 2 * np.pi * turns])), ORACLE(poses), atol=1e-7)
    assert ReedsShepp((1, 2, 0.5), 3)([(1, 2, 0.5 + 2 * np.pi)]) < 1e-15
    assert 0 <= ORACLE([(0, 0, 1e300)])[0] < 20


def test_what_is_no_pose_is_out_of_reach():
    for bad in (np.nan, np.inf, -np.inf):
        np.testing.assert_array_equal(ORACLE(np.where(np.eye(3), bad, 1.0)), [np.inf] * 3)


def test_poses_very_far_away_are_as_far_as_the_crow_flies():
    np.testing.assert_allclose(ORACLE([(1e9, 0, 1), (3e200, 4e200, 1)]), [1e9, 5e200], rtol=1e-7)
    with pytest.raises(ValueError, match="nearer to the goal"):
        ORACLE.shortest_path((3e200, 4e200, 1))


def test_the_answer_of_a_pose_depends_on_no_other():
    poses = random_poses(9001)
    together = ORACLE(poses)
    np.testing.assert_array_equal(together, np.concatenate([ORACLE(part) for part in np.array_split(poses, 7)]))
    assert together.dtype == np.float64 and ORACLE(np.zeros((0, 3))).shape == (0,)


@pytest.mark.parametrize(
    ("goal", "radius", "x", "message"),
    [
        ((0, 0), 1, None, r"goal pose must be one point of shape \(3,\)"),
        ((0, 0, np.inf), 1, None, "goal pose must have finite"),
        ((0, 0, 0), 0, None, "radius must be a positive finite number, got 0"),
        ((0, 0, 0), np.nan, None, "radius must be a positive finite number, got nan"),
        ((0, 0, 0), "wide", None, "radius must be a positive finite number, got 'wide'"),
        ((0, 0, 0), 1, np.zeros((2, 2)), r"x must have shape \(n, 3\), got \(2, 2\)"),
        ((0, 0, 0), 1, np.zeros(3), r"x\[None\]"),
        ((0, 0, 0), 1, np.ma.masked_less([[0.0, 1.0, 2.0]], 1), "some are masked"),
    ],
)
@pytest.mark.usefixtures("unchecked_types")
def test_bad_input_is_refused(goal, radius, x, message):
    with pytest.raises(ValueError, match=message):
        ReedsShepp(goal, radius)(x)


def test_a_path_needs_a_pose():
    with pytest.raises(ValueError, match="start pose must have finite"):
        ORACLE.shortest_path((0, np.nan, 0))
    assert ReedsShepp((1, 2, 0.5), 3).shortest_path((1, 2, 0.5)) == []
