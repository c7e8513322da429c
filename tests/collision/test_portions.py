"""Collision tests in portions, and under a deadline, give the answers of one large test."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from robot_helpers import BAR, DISC, PEBBLE, POINT, WING, random_motions

from plr_jax import _arrays
from plr_jax.collision import bodies, motions, walls
from plr_jax.collision.motions import JointMotionTest, motions_apart
from plr_jax.collision.walls import MotionTest, motion_test
from plr_jax.geometry import workspace as workspaces
from plr_jax.geometry.workspace import Workspace
from plr_jax.robots import PolygonRobot

BLOCKS = [[(x, y), (x + 0.3, y), (x + 0.2, y + 0.4)] for x in (0.5, 1.5, 2.5) for y in (0.5, 1.5, 2.5)]
ROOM = Workspace(((0, 0), (4, 4)), BLOCKS)
ANGLE = np.arange(60) * np.pi / 30
ELLIPSE = PolygonRobot(np.column_stack([0.5 * np.cos(ANGLE), 0.4 * np.sin(ANGLE)]))
LONG_AGO = -1.0  # on the clock


def random_columns(num, reach=0.3):
    q0, q1 = random_motions(np.random.default_rng(2), num, 4.0, reach, 1.0)
    middle = np.array([2.0, 2.0, 0.0])
    return q0 + middle, q1 + middle


@given(st.integers(3, 300), st.integers(0, 1000), st.floats(1e-6, 1.0))
def test_lowest_corner_equals_brute_force(num_corners, seed, flatness):
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(0, 2 * np.pi, (num_corners, 4)), axis=0)
    if seed % 2:  # crowded in one place
        angle = angle**6 / (2 * np.pi) ** 5
    corners = np.stack([np.cos(angle), flatness * np.sin(angle)]) + rng.uniform(-3, 3, (2, 1, 4))
    direction = rng.uniform(0, 2 * np.pi, (50, 4))
    direction[:8] = (np.arange(8) * np.pi / 4)[:, None]
    nx, ny = np.cos(direction), np.sin(direction)
    expected = np.einsum("dsn,dcn->scn", np.stack([nx, ny]), corners).min(axis=1)
    np.testing.assert_allclose(bodies._lowest(corners, nx, ny), expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize(("corners", "reach"), [(500, -1e-9), (40, 0.1), (2, -1e-9)])
def test_bisection_limits_corner_pairs_per_call(corners, reach):
    sizes, most = [], 1 << 16

    def undecided(a, b, reach):
        sizes.append(len(a.x) * (corners * corners if reach > 0 else corners + corners))
        return np.full(len(a.x), -np.inf), np.full(len(a.x), np.inf)

    body = bodies.moving_bodies(BAR, *random_columns(3)).with_size(np.zeros((2, corners)))
    assert not bodies.bisect(undecided, body, body, reach).any()
    assert max(sizes) <= most < sum(sizes)  # one call for all bodies would be larger


@pytest.mark.parametrize("robots", [(BAR, ELLIPSE), (WING, PEBBLE), (DISC, BAR)])
def test_pairs_in_portions_equal_one_call(robots, monkeypatch):
    (a0, a1), (b0, b1) = random_columns(20), random_columns(15, 0.5)
    moves = robots[0], a0[:, None], a1[:, None], robots[1], b0, b1
    whole = motions_apart(*moves, 1e-9)
    row = motions_apart(robots[0], a0[3:4], a1[3:4], robots[1], b0, b1, 1e-9)
    np.testing.assert_array_equal(row, whole[3])
    for module, name, value in ((bodies, "_CORNERS", 20), (motions, "_CHUNK_PAIRS", 7), (motions, "_MOST", 70)):
        monkeypatch.setattr(module, name, value)
    np.testing.assert_array_equal(motions_apart(*moves, 1e-9), whole)
    assert 0 < whole.mean() < 1


@pytest.mark.parametrize("robot", [POINT, DISC, BAR, ELLIPSE], ids=["point", "disc", "bar", "ellipse"])
def test_walls_in_portions_equal_one_call(robot, monkeypatch):
    q0, q1 = random_columns(150)
    whole = MotionTest(ROOM, robot)(q0, q1)
    for module, name, value in ((walls, "_PAIRS", 5), (walls, "_CENTERS", 60), (bodies, "_CORNERS", 20)):
        monkeypatch.setattr(module, name, value)
    np.testing.assert_array_equal(MotionTest(ROOM, robot)(q0, q1), whole)
    assert 0 < whole.mean() < 1


def test_clearance_by_tree_equals_clearance_by_lines(monkeypatch):
    x = np.random.default_rng(0).uniform(-1, 5, (500, 2))
    by_lines = ROOM.clearance(x)
    monkeypatch.setattr(workspaces, "_MANY_EDGES", 0)
    np.testing.assert_allclose(ROOM.clearance(x), by_lines, rtol=0, atol=1e-12)
    assert np.isnan(ROOM.clearance(np.array([[np.nan, 0.0]]))).all()


@pytest.mark.parametrize("robot", [POINT, DISC, BAR])
def test_collision_tests_past_deadline_raise(robot):
    q0, q1 = random_columns(50)
    test, late = MotionTest(ROOM, robot), JointMotionTest(ROOM, [robot, BAR], LONG_AGO)
    with pytest.raises(TimeoutError, match="before all motions were tested"):
        test(q0, q1, LONG_AGO)
    for call, arguments in (
        (MotionTest, (ROOM, robot, LONG_AGO)),
        (motions_apart, (robot, q0, q1, BAR, q0, q1, 1e-9, LONG_AGO)),
        (late.apart, (0, q0, q1, 1, q0, q1)),
    ):
        with pytest.raises(TimeoutError):
            call(*arguments)


def test_bisection_ends_at_deadline(monkeypatch):
    clock = iter(range(1000))
    monkeypatch.setattr(_arrays.time, "perf_counter", lambda: next(clock))
    body = bodies.moving_bodies(BAR, *random_columns(20)).with_size(np.zeros((2, 4)))
    with pytest.raises(TimeoutError):
        bodies.bisect(
            lambda a, b, reach: (np.full(len(a.x), -np.inf), np.full(len(a.x), np.inf)), body, body, -1e-9, deadline=5
        )
    assert next(clock) == 7  # six judgements were begun at most


def test_motion_tests_are_cached_per_workspace():
    room = Workspace(((0, 0), (4, 4)), BLOCKS)
    with pytest.raises(TimeoutError):
        motion_test(room, DISC, LONG_AGO)
    test = motion_test(room, DISC, 1e9)
    assert motion_test(room, DISC) is test
    assert motion_test(room, DISC, LONG_AGO) is test
