import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robot_helpers import BAR, DISC, PEBBLE, POINT, WING

from plr_jax.collision.team import Traffic, circles, circles_along, motions_apart, within_reach

TEAM = [DISC, BAR, POINT, WING, PEBBLE, DISC]


def walk(rng, steps, side=4.0):
    q = np.cumsum(rng.normal(0, 0.5, (steps, len(TEAM), 3)), axis=0)
    return q + np.pad(rng.uniform(0, side, (len(TEAM), 2)), ((0, 0), (0, 1)))


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), k=st.integers(1, 4), share=st.floats(0, 1))
def test_a_circle_holds_every_position_on_the_way(seed, k, share):
    rng = np.random.default_rng(seed)
    begin, end = rng.normal(0, 2, (5, k, 3)), rng.normal(0, 2, (5, k + 1, 3))
    x, y, radius = circles(begin, end)
    at = (1 - share) * begin[:, :, None, :2] + share * end[:, None, :, :2]
    distance = np.hypot(at[..., 0] - x[:, None, None], at[..., 1] - y[:, None, None])
    assert (distance <= radius[:, None, None] + 1e-12).all()


def test_a_circle_around_one_motion_is_tight():
    x, y, radius = circles(np.array([[(1.0, 2.0)]]), np.array([[(4.0, 6.0)]]))
    np.testing.assert_allclose((x[0], y[0], radius[0]), (2.5, 4.0, 2.5))


@pytest.mark.parametrize("k", [1, 4])
def test_circles_along_a_path_are_those_of_each_motion(k):
    q = np.random.default_rng(k).normal(0, 2, (6, k, 3))
    for along, each in zip(circles_along(q), circles(q[:-1], q[1:]), strict=True):
        np.testing.assert_array_equal(along, each)


def test_nobody_far_away_is_near():
    q = np.array([[(0.0, 0.0), (1.0, 0.0), (0.0, 9.0)]] * 2)
    traffic = Traffic([DISC] * 3, q)
    around, motion = circles(q[:1, :1], q[1:, :1]), np.array([0])
    assert [x.tolist() for x in traffic.near(0, around, motion)] == [[], []]  # two radii are 0.6
    traffic.move(1, np.array([(0.5, 0.0)] * 2))
    assert [x.tolist() for x in traffic.near(0, around, motion)] == [[0], [1]]
    assert [x.tolist() for x in traffic.near(0, around, motion, (1,))] == [[], []]
    np.testing.assert_array_equal(q[:, 1], [(1.0, 0.0)] * 2, err_msg="the path given is left alone")


@pytest.mark.parametrize("seed", range(5))
def test_motions_changed_in_some_rows_are_as_if_the_path_had_been_made_so(seed):
    rng = np.random.default_rng(seed)
    path = walk(rng, 12)
    traffic, changed = Traffic(TEAM, path), path.copy()
    for i, rows in ((1, slice(0, 12)), (3, slice(4, 9)), (3, slice(7, 12))):
        changed[rows, i][1:-1] += rng.normal(0, 1, (rows.stop - rows.start - 2, 3))
        traffic.move(i, changed[rows, i], rows)
    made = Traffic(TEAM, changed)
    np.testing.assert_array_equal(traffic.path, changed)
    around, motion = circles(*rng.uniform(0, 4, (2, 40, 2, 3))), rng.integers(0, 11, 40)
    for a, b in zip(traffic.near(2, around, motion), made.near(2, around, motion), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("i, j", [(0, 5), (1, 3), (2, 4), (1, 1)])
def test_what_is_not_within_reach_is_apart(i, j):
    rng = np.random.default_rng(7)
    one, other = TEAM[i], TEAM[j]
    a0, b0 = rng.uniform(0, 4, (2, 200, 2, 3))
    a1, b1 = (q[:, :1] + rng.normal(0, 0.4, (200, 3, 3)) for q in (a0, b0))
    apart = motions_apart(
        one, a0[:, :, None, None, None], a1[:, None, :, None, None], other, b0[:, None, None, :, None],
        b1[:, None, None, None], 1e-9)  # fmt: skip
    meet = np.flatnonzero(~apart.all(axis=(1, 2, 3, 4)))
    near = within_reach(one, circles(a0, a1), other, circles(b0, b1))
    assert np.isin(meet, near).all() and 0 < len(meet) <= len(near) < 200
