"""What is tested in portions, under a clock, is what is tested at once."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from robot_helpers import BAR, DISC, PEBBLE, POINT, WING, random_motions

from plr_jax import _arrays
from plr_jax.collision import bodies, walls
from plr_jax.collision import team as pairs
from plr_jax.collision.team import JointMotionTest, motions_apart
from plr_jax.collision.walls import MotionTest, motion_test
from plr_jax.geometry import workspace as workspaces
from plr_jax.geometry.workspace import Workspace
from plr_jax.robots.robot import PolygonRobot

BLOCKS = [[(x, y), (x + 0.3, y), (x + 0.2, y + 0.4)] for x in (0.5, 1.5, 2.5) for y in (0.5, 1.5, 2.5)]
ROOM = Workspace(((0, 0), (4, 4)), BLOCKS)
MIDDLE = np.array([2.0, 2.0, 0.0])
LONG_AGO = -1.0  # on the clock


def ellipse(num_corners, width=0.5, height=0.4):
    angle = np.arange(num_corners) * 2 * np.pi / num_corners
    return PolygonRobot(np.column_stack([width * np.cos(angle), height * np.sin(angle)]))


def columns(num, reach=0.3):
    q0, q1 = random_motions(np.random.default_rng(2), num, 4.0, reach, 1.0)
    return q0 + MIDDLE, q1 + MIDDLE


@given(st.integers(3, 300), st.integers(0, 1000), st.floats(1e-6, 1.0))
def test_the_lowest_of_many_corners_is_found_in_every_direction(num_corners, seed, flatness):
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


@pytest.mark.parametrize(
    ("corners", "reach", "most"), [(500, -1e-9, 1 << 16), (40, 0.1, 1 << 16), (2, -1e-9, 1 << 16)]
)
def test_few_bodies_are_judged_at_a_time_however_long_they_are_in_doubt(corners, reach, most):
    judged = []

    def undecided(a, b, reach):
        judged.append(len(a.x) * (corners * corners if reach > 0 else corners + corners))
        return np.zeros(len(a.x), dtype=bool), np.zeros(len(a.x), dtype=bool)

    q0, q1 = columns(3)
    body = bodies.moving_bodies(BAR, q0, q1).with_size(np.zeros((2, corners)))
    assert not bodies.bisect(undecided, body, body, reach).any()
    assert max(judged) <= most
    assert sum(judged) > most  # all at once would be more


@pytest.mark.parametrize("robots", list(itertools.combinations([BAR, WING, PEBBLE, DISC, ellipse(60)], 2)))
def test_pairs_in_portions(robots, monkeypatch):
    (a0, a1), (b0, b1) = columns(40), columns(30, 0.5)
    motions = robots[0], a0[:, None], a1[:, None], robots[1], b0, b1
    whole = motions_apart(*motions, 1e-9)
    row = motions_apart(robots[0], a0[3:4], a1[3:4], robots[1], b0, b1, 1e-9)
    np.testing.assert_array_equal(row, whole[3])
    for module, name, value in ((bodies, "_CORNERS", 20), (pairs, "_CHUNK_PAIRS", 7), (pairs, "_MOST", 70)):
        monkeypatch.setattr(module, name, value)
    np.testing.assert_array_equal(motions_apart(*motions, 1e-9), whole)
    assert 0 < whole.mean() < 1


@pytest.mark.parametrize("robot", [POINT, DISC, BAR, WING, PEBBLE, ellipse(60)], ids=repr)
def test_walls_in_portions(robot, monkeypatch):
    q0, q1 = columns(300)
    whole = MotionTest(ROOM, robot)(q0, q1)
    for module, name, value in ((walls, "_PAIRS", 5), (walls, "_CENTERS", 100), (bodies, "_CORNERS", 20)):
        monkeypatch.setattr(module, name, value)
    np.testing.assert_array_equal(MotionTest(ROOM, robot)(q0, q1), whole)
    assert 0 < whole.mean() < 1


def test_clearance_is_the_same_by_a_tree(monkeypatch):
    x = np.random.default_rng(0).uniform(-1, 5, (500, 2))
    by_lines = ROOM.clearance(x)
    monkeypatch.setattr(workspaces, "_MANY_EDGES", 0)
    np.testing.assert_allclose(ROOM.clearance(x), by_lines, rtol=0, atol=1e-12)
    assert np.isnan(ROOM.clearance(np.array([[np.nan, 0.0]]))).all()


@pytest.mark.parametrize("robot", [POINT, DISC, BAR])
def test_tests_end_at_the_deadline(robot):
    q0, q1 = columns(50)
    test = MotionTest(ROOM, robot)
    with pytest.raises(TimeoutError, match="before all motions were tested"):
        test(q0, q1, LONG_AGO)
    with pytest.raises(TimeoutError):
        MotionTest(ROOM, robot, LONG_AGO)
    with pytest.raises(TimeoutError):
        motions_apart(robot, q0, q1, BAR, q0, q1, 1e-9, LONG_AGO)
    late = JointMotionTest(ROOM, [robot, BAR], LONG_AGO)
    with pytest.raises(TimeoutError):
        late.apart(0, q0, q1, 1, q0, q1)


def test_bodies_in_doubt_are_given_up_at_the_deadline(monkeypatch):
    clock = iter(range(1000))
    monkeypatch.setattr(_arrays.time, "perf_counter", lambda: next(clock))
    q0, q1 = columns(20)
    body = bodies.moving_bodies(BAR, q0, q1).with_size(np.zeros((2, 4)))
    never = np.zeros(20, dtype=bool)
    with pytest.raises(TimeoutError):
        bodies.bisect(lambda a, b, reach: (np.resize(never, len(a.x)),) * 2, body, body, -1e-9, deadline=5)
    assert next(clock) == 7  # six judgements were begun at most


def test_motion_tests_are_kept_whatever_their_deadlines():
    room = Workspace(((0, 0), (4, 4)), BLOCKS)
    with pytest.raises(TimeoutError):
        motion_test(room, DISC, LONG_AGO)
    test = motion_test(room, DISC, 1e9)
    assert motion_test(room, DISC) is test
    assert motion_test(room, DISC, LONG_AGO) is test
