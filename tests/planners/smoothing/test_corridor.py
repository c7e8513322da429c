"""The cheapest motions within corridors, of one robot and of two."""

import time
from itertools import product

import numpy as np
import pytest
from planner_helpers import ROOM, exact

from plr_jax import BLOptions, DiscRobot, PointRobot, Problem, RectangleRobot, bl_plan, path_cost, scenes, validate
from plr_jax.collision.team import JointMotionTest
from plr_jax.planners.smoothing import _cheapest, _groups, shorten_in_corridors

NEVER = float("inf")


def shortened(problem, path, width=0.2, deadline=NEVER):
    test = JointMotionTest(problem.workspace, problem.robots, deadline)
    return shorten_in_corridors(problem, np.asarray(path, dtype=float), test, width)


def test_a_zigzag_of_one_robot_becomes_straight():
    problem = Problem(ROOM, [PointRobot()], [(1, 5)], [(9, 5)])
    x = np.linspace(1, 9, 17)
    path = np.stack([x, 5 + 0.4 * (np.arange(17) % 2)], axis=1)[:, None]
    result = shortened(problem, path)
    assert validate(problem, result).valid
    np.testing.assert_allclose(path_cost(problem, result), 8, rtol=2e-3)


def test_two_robots_that_touch_share_the_way_around_one_another():
    """One goes straight and the other around it: neither gains by moving alone, both together do."""
    problem = Problem(ROOM, [DiscRobot(0.5)] * 2, [(1, 5), (9, 5)], [(9, 5), (1, 5)])
    x, steps = np.linspace(1, 9, 21), 21
    around = 5 + 1.02 * np.clip(2 - np.abs(x - 5) / 1.5, 0, 1)
    path = np.stack([np.stack([x, np.full(steps, 5.0)], 1), np.stack([x[::-1], around[::-1]], 1)], axis=1)
    assert validate(problem, path).valid
    result = shortened(problem, path)
    assert validate(problem, result).valid
    middle = result[9:12, :, 1] - 5
    assert middle[:, 0].min() < -0.2 and middle[:, 1].max() < 0.8
    # The least there is: each passes the other's side by a radius, along tangents.
    least = 4 * np.hypot(4, 0.5)
    assert path_cost(problem, result) < path_cost(problem, path) - 0.3
    assert least - 1e-9 <= path_cost(problem, result) <= 1.005 * least


@pytest.mark.parametrize(
    ("scene", "step"), [(scenes.four_rooms(3), 0.4), (scenes.cross(2), 0.4), (scenes.tangle(), 0.4)]
)
def test_a_shortened_path_is_valid_and_never_costlier(scene, step):
    raw = bl_plan(scene, exact(scene), BLOptions(step=step, cost_factor=1e6)).path
    result = shortened(scene, raw)
    assert validate(scene, result).valid
    assert path_cost(scene, result) < path_cost(scene, raw)
    assert result.shape == raw.shape
    np.testing.assert_array_equal(result[[0, -1]], raw[[0, -1]])


def test_a_rectangle_turns_back_a_turn_that_leads_nowhere():
    problem = Problem(ROOM, [RectangleRobot(1, 0.5)], [(2, 5, 0)], [(8, 5, 0)])
    heading = 0.3 * (np.arange(13) % 12 > 0)
    path = np.stack([np.linspace(2, 8, 13), np.full(13, 5.0), heading], axis=1)[:, None]
    result = shortened(problem, path, width=0.1)
    assert validate(problem, result).valid
    assert path_cost(problem, path) > 6.3
    np.testing.assert_allclose(path_cost(problem, result), 6, rtol=2e-2)


def test_a_reached_deadline_leaves_the_path():
    problem = Problem(ROOM, [PointRobot()], [(1, 5)], [(9, 5)])
    path = np.array([[[1, 5]], [[5, 6]], [[9, 5]]], dtype=float)
    np.testing.assert_array_equal(shortened(problem, path, deadline=time.perf_counter() - 1), path)


def test_pairs_are_shortened_where_they_touch():
    problem = Problem(ROOM, [DiscRobot(0.5)] * 3, [(1, 1), (1, 9), (9, 5)], [(9, 1), (9, 9), (1, 5)])
    x = np.linspace(1, 9, 17)
    path = np.stack([np.stack([x, np.full(17, y)], 1) for y in (1.0, 9.0)] + [np.stack([x[::-1], 5 + 0 * x], 1)], 1)
    assert [robots for robots, _ in _groups(problem, path, 0.2)] == [(0,), (1,), (2,)]
    path[8, 2] = (5, 2.1)
    groups = dict(_groups(problem, path, 0.2))
    assert set(groups) == {(0,), (1,), (2,), (2, 0)}
    assert (groups[2, 0].start, groups[2, 0].stop) == (8 - 3, 8 + 4)


def test_the_cheapest_sequence_is_that_of_a_brute_force():
    rng = np.random.default_rng(0)
    for _ in range(20):
        cost = rng.uniform(size=(4, 3, 3))
        cost[rng.uniform(size=cost.shape) < 0.3] = np.inf
        cost[:, 0, 0] = 2.0
        places = _cheapest(cost)
        assert places[0] == places[-1] == 0
        every = [(0, *inner, 0) for inner in product(range(3), repeat=3)]
        costs = [sum(cost[t, s[t], s[t + 1]] for t in range(4)) for s in every]
        found = sum(cost[t, places[t], places[t + 1]] for t in range(4))
        assert found == min(costs)
