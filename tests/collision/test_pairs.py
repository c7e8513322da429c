from itertools import combinations_with_replacement

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robot_helpers import BAR, DISC, PEBBLE, POINT, ROBOTS, WING, pebble, random_motions, sampled_distance

from plr_jax.collision.team import motions_apart
from plr_jax.robots.shapes import DiscRobot, RectangleRobot

TOLERANCE = 1e-9
CORNER = BAR.circumscribed_radius
PAIRS = list(combinations_with_replacement(ROBOTS, 2))
UP = np.pi / 2


def apart(robot_a, a0, a1, robot_b, b0, b1):
    q = (np.array([x], dtype=float) for x in (a0, a1, b0, b1))
    a0, a1, b0, b1 = q
    return bool(motions_apart(robot_a, a0, a1, robot_b, b0, b1, TOLERANCE)[0])


# BAR is 0.9 x 0.3, DISC has radius 0.3. In each case the two touch; moved up, the second one is clear.
STILL, GO = (0.0, 0.0, 0.0), (2.0, 0.0, 0.0)
CASES = {
    "discs pass head-on, side by side": (DISC, STILL, GO, DISC, (2.0, 0.6, 0), (0.0, 0.6, 0)),
    "one disc overtakes a disc at rest": (DISC, STILL, GO, DISC, (1.0, 0.6, 0), (1.0, 0.6, 0)),
    "a disc ends at a disc": (DISC, (0, -2, 0), STILL, DISC, (0, 0.6, 0), (0, 0.6, 0)),
    "discs follow one another": (DISC, STILL, (0, 9, 0), DISC, (0, 0.6, 0), (0, 9.6, 0)),
    "a point passes a disc": (POINT, STILL, GO, DISC, (1.0, 0.3, 0), (1.0, 0.3, 0)),
    "a point slides along a bar": (POINT, STILL, GO, BAR, (1.0, 0.15, 0), (1.0, 0.15, 0)),
    "a point passes the end of an upright bar": (POINT, STILL, GO, BAR, (1.0, 0.45, UP), (1.0, 0.45, UP)),
    "a disc slides along a bar": (DISC, STILL, GO, BAR, (1.0, 0.45, 0), (1.0, 0.45, 0)),
    "a disc passes a bar's corner": (
        DISC, (-1, 1, 0), (1, -1, 0), BAR, (0.45 + 0.3 / 2**0.5, 0.15 + 0.3 / 2**0.5, 0), None),
    "bars slide along one another": (BAR, STILL, GO, BAR, (2.0, 0.3, 0), (0.0, 0.3, 0)),
    "bars in line stay in line": (BAR, STILL, (0, 5, 0), BAR, (0, 0.3, 0), (0, 5.3, 0)),
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
def test_touching_is_free_and_any_less_is_not(case):
    robot_a, a0, a1, robot_b, b0, b1 = case
    b1 = b0 if b1 is None else b1
    turning = a0[2] != a1[2]
    for lift, expected in ((1e-6, True), (0.0, True), (-1e-6, False), (-0.1, False)):
        if turning and lift == 0.0:
            continue  # allowed to err on the side of caution
        (xb0, yb0, tb0), (xb1, yb1, tb1) = b0, b1
        up0, up1 = (xb0, yb0 + lift, tb0), (xb1, yb1 + lift, tb1)
        assert apart(robot_a, a0, a1, robot_b, up0, up1) == expected
        assert apart(robot_b, up0, up1, robot_a, a0, a1) == expected
        assert apart(robot_a, a1, a0, robot_b, up1, up0) == expected  # backwards in time


def test_a_collision_in_the_middle_of_a_motion_is_found():
    """Robots that change places are apart at both ends."""
    for robot_a, robot_b in PAIRS:
        far = apart(robot_a, (-9, 0, 0), (9, 0, 0), robot_b, (0, -9, 1), (0, 9, 1))
        assert far == (robot_a == robot_b == POINT)


def test_simultaneous_motions_are_judged_at_the_same_time():
    """Paths that cross are free when one robot is through before the other comes."""
    assert apart(DISC, (0, 0, 0), (4, 0, 0), DISC, (1, -3, 0), (1, 1, 0))
    assert apart(BAR, (0, 0, 0), (4, 0, 0), BAR, (1, -3, 0), (1, 1, 0))
    assert not apart(DISC, (0, 0, 0), (4, 0, 0), DISC, (2, -2, 0), (2, 2, 0))


def test_headings_are_periodic_and_turns_take_the_shorter_way():
    post = (0.0, 0.4, 0.0)
    assert apart(BAR, (0, 0, -0.2), (0, 0, 2 * np.pi + 0.2), POINT, post, post)
    assert not apart(BAR, (0, 0, 0.2), (0, 0, np.pi - 0.2), POINT, post, post)
    # From just above to just below the negative x axis: past it, not around.
    assert apart(BAR, (0, 0, np.pi - 0.2), (0, 0, 0.2 - np.pi), POINT, post, post)
    assert not apart(BAR, (0, 0, 0), (0, 0, np.pi), POINT, post, post)


@pytest.mark.parametrize(("robot_a", "robot_b"), PAIRS)
def test_against_dense_samples(robot_a, robot_b):
    rng = np.random.default_rng(3)
    n, num_samples = 200, 101
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


@pytest.mark.parametrize(("robot_a", "robot_b"), PAIRS)
def test_batches_broadcast(robot_a, robot_b):
    rng = np.random.default_rng(5)
    a0, a1 = random_motions(rng, 7, 1.0, 0.4, 1.0)
    b0, b1 = random_motions(rng, 11, 1.0, 0.4, 1.0)
    table = motions_apart(robot_a, a0[:, None], a1[:, None], robot_b, b0, b1, TOLERANCE)
    assert table.shape == (7, 11)
    for i in range(7):
        row = motions_apart(robot_a, a0[i : i + 1], a1[i : i + 1], robot_b, b0, b1, TOLERANCE)
        np.testing.assert_array_equal(table[i], row)


def test_batches_larger_than_a_chunk_are_answered_row_by_row():
    rng = np.random.default_rng(6)
    a0, a1 = random_motions(rng, 20_000, 1.5, 0.3, 0.5)
    b0, b1 = random_motions(rng, 20_000, 1.5, 0.3, 0.5)
    whole = motions_apart(BAR, a0, a1, BAR, b0, b1, TOLERANCE)
    picked = slice(8_000, 20_000, 997)
    np.testing.assert_array_equal(
        whole[picked], motions_apart(BAR, a0[picked], a1[picked], BAR, b0[picked], b1[picked], TOLERANCE)
    )


def test_an_empty_batch():
    q = np.zeros((0, 3))
    assert motions_apart(BAR, q, q, DISC, q, q, TOLERANCE).shape == (0,)


pose = st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-4, 4))
robot = st.one_of(
    st.just(POINT),
    st.builds(DiscRobot, st.floats(0.05, 0.6)),
    st.builds(RectangleRobot, st.floats(0.05, 1), st.floats(0.05, 1)),
    st.just(WING),
    st.builds(pebble, st.floats(0.05, 0.6)),
)


@settings(max_examples=300, deadline=None)
@given(robot, pose, pose, robot, pose, pose)
def test_never_accepts_what_samples_refute(robot_a, a0, a1, robot_b, b0, b1):
    if not apart(robot_a, a0, a1, robot_b, b0, b1):
        return
    q = [np.array([x]) for x in (a0, a1, b0, b1)]
    assert sampled_distance(robot_a, q[0], q[1], robot_b, q[2], q[3], 65)[0] > -1e-5


@settings(max_examples=200, deadline=None)
@given(robot, pose, pose, robot, pose, pose, st.floats(-3, 3))
def test_the_order_of_the_robots_and_the_frame_do_not_matter(robot_a, a0, a1, robot_b, b0, b1, angle):
    """But within rounding of contact."""
    c, s = np.cos(angle), np.sin(angle)
    turned = [(5 + c * x - s * y, -2 + s * x + c * y, t + angle) for x, y, t in (a0, a1, b0, b1)]
    answers = {
        apart(robot_a, a0, a1, robot_b, b0, b1),
        apart(robot_b, b0, b1, robot_a, a0, a1),
        apart(robot_a, *turned[:2], robot_b, *turned[2:]),
    }
    if len(answers) == 2:
        q = [np.array([x]) for x in (a0, a1, b0, b1)]
        assert abs(sampled_distance(robot_a, q[0], q[1], robot_b, q[2], q[3], 4001)[0]) < 2e-3
