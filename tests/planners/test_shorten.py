"""Shorter paths: by straight shortcuts, and by the cheapest motions within corridors."""

from itertools import pairwise, product

import numpy as np
import pytest
import shapely
from planner_helpers import ROOM, TRIO, exact, joint_lattice_of, search_budget

from plr_jax import DiscRobot, PointRobot, Problem, RectangleRobot, Workspace, scenes, validate
from plr_jax._problem import motion_costs
from plr_jax.collision.motions import JointMotionTest
from plr_jax.metrics import path_cost
from plr_jax.planners.best_first import BestFirstSearch, tabulate
from plr_jax.planners.shorten import _cheapest, shorten, shorten_in_corridors

ALONE = Problem(ROOM, [DiscRobot(0.4)], [(1, 1)], [(9, 5)])
POINT = Problem(ROOM, [PointRobot()], [(1, 5)], [(9, 5)])
BAR = Problem(ROOM, [RectangleRobot(1.2, 0.4)], [(1, 1, 3.0)], [(9, 5, -3.0)])


def checked(problem, path, shorten, *options, deadline=np.inf):
    """Return the shorter path, after checking: valid, same rows and ends, never costlier, the input unchanged."""
    before = np.array(path, dtype=float)
    path = before.copy()
    short = shorten(problem, path, JointMotionTest(problem.workspace, problem.robots, deadline), *options)
    np.testing.assert_array_equal(path, before)
    report = validate(problem, short)
    assert report.valid, report.message
    assert short.shape == path.shape and report.cost <= path_cost(problem, path) * (1 + 1e-12)
    np.testing.assert_array_equal(short[[0, -1]], path[[0, -1]])
    return short


def over_shortcuts(problem, path, **options):
    return checked(problem, path, shorten, **options)


def in_corridors(problem, path, width=0.2, **options):
    return checked(problem, path, shorten_in_corridors, width, **options)


def straight(problem, steps):
    turn = np.zeros_like(problem.goals)
    turn[:, :2] = problem.goals[:, :2] - problem.starts[:, :2]
    turn[:, 2:] = np.angle(np.exp(1j * (problem.goals - problem.starts)[:, 2:]))
    path = problem.starts + np.linspace(0, 1, steps)[:, None, None] * turn
    path[[0, -1]] = problem.starts, problem.goals
    return path


def zigzag(problem, steps, width):
    """Return the straight way, every other row moved aside."""
    path = straight(problem, steps)
    path[1:-1:2, :, 1] += width
    return path


def straight_cost(problem):
    return pytest.approx(motion_costs(problem, problem.starts, problem.goals).sum())


@pytest.mark.parametrize(("problem", "step"), [(scenes.four_rooms(2), 0.5), (scenes.cross(2), 0.4), (TRIO, 0.8)])
def test_search_paths_become_cheaper(problem, step):
    joint = joint_lattice_of(problem, step)
    search = BestFirstSearch(joint, tabulate(joint, exact(problem)), 2.0, search_budget())
    while search.run(100_000) is None:
        pass
    path = joint.configurations(search.solution_states)
    for shortened in (over_shortcuts, in_corridors):
        assert path_cost(problem, shortened(problem, path)) < path_cost(problem, path)


@pytest.mark.parametrize("shortened", [over_shortcuts, in_corridors])
def test_late_or_short_paths_stay_unchanged(shortened):
    path = zigzag(ALONE, 9, 0.5)
    np.testing.assert_array_equal(shortened(ALONE, path, deadline=-1.0), path)
    assert (shortened(ALONE, path, deadline=1e12) != path).any()
    still = Problem(ROOM, ALONE.robots, ALONE.starts, ALONE.starts)
    for problem, steps in ((still, 1), (ALONE, 2)):
        path = np.stack([problem.starts, problem.goals])[:steps]
        np.testing.assert_array_equal(shortened(problem, path), path)


@pytest.mark.parametrize("problem", [ALONE, BAR, TRIO], ids=["disc", "bar", "mixed"])
@pytest.mark.parametrize("steps", [3, 10, 25])
def test_zigzag_becomes_straight(problem, steps):
    path = zigzag(problem, steps, 0.7)
    short = over_shortcuts(problem, path)
    assert path_cost(problem, short) == straight_cost(problem)
    assert path_cost(problem, path) > 1.1 * path_cost(problem, short) or steps == 3
    # The point moves along the zigzag, so its rows need not be evenly spaced.
    np.testing.assert_allclose(np.diff(short[:, :2, :2], 2, axis=0), 0, atol=1e-12, err_msg="constant speed")


def test_long_zigzag_is_shortened_in_pieces():
    path = zigzag(ALONE, 101, 0.3)
    assert path_cost(ALONE, over_shortcuts(ALONE, path)) < 1.02 * np.hypot(8, 4) < path_cost(ALONE, path) / 1.5


def test_path_around_wall_becomes_tight():
    workspace = Workspace(((0, 0), (10, 10)), [shapely.box(4.5, 0, 5.5, 6)])
    problem = Problem(workspace, [DiscRobot(0.5)], [(1, 1)], [(9, 1)])
    corners = np.array([(1, 1), (1, 9), (9, 9), (9, 1)], dtype=float)
    path = np.concatenate([np.linspace(a, b, 9) for a, b in pairwise(corners)])[:, None]
    shortest = 2 * np.hypot(3.5, 5.5) + 1 - 1.0  # a bound: two legs to the corners and the wall's top, less rounding
    assert shortest < path_cost(problem, over_shortcuts(problem, path)) < 0.8 * path_cost(problem, path)


def test_robots_keep_crossing_one_after_the_other():
    # Two discs cross one after the other; each alone could go straight at once.
    problem = Problem(ROOM, [DiscRobot(0.5), DiscRobot(0.5)], [(1, 5), (5, 1)], [(9, 5), (5, 9)])
    path = np.repeat(problem.starts[None], 17, axis=0)
    path[:9, 0, 0], path[9:, 0, 0] = np.linspace(1, 9, 9), 9
    path[8:, 1, 1] = np.linspace(1, 9, 9)
    assert not validate(problem, straight(problem, 17)).valid and validate(problem, path).valid
    assert path_cost(problem, over_shortcuts(problem, path)) == pytest.approx(16)


def test_shortening_one_robot_keeps_other_motions():
    path = straight(TRIO, 13)
    path[1:-1:2, 0, 1] += 0.8  # the disc alone goes to and fro
    short = over_shortcuts(TRIO, path)
    np.testing.assert_allclose(short[:, 1:], path[:, 1:], atol=1e-12)
    assert np.ptp(short[:, 0, 1]) < 1e-12


# Corridors


def test_zigzag_becomes_straight_in_corridor():
    np.testing.assert_allclose(path_cost(POINT, in_corridors(POINT, zigzag(POINT, 17, 0.4))), 8, rtol=2e-3)


def test_touching_robots_share_the_detour():
    """One robot goes straight and the other around it: only both together can gain."""
    problem = Problem(ROOM, [DiscRobot(0.5)] * 2, [(1, 5), (9, 5)], [(9, 5), (1, 5)])
    x, steps = np.linspace(1, 9, 21), 21
    around = 5 + 1.02 * np.clip(2 - np.abs(x - 5) / 1.5, 0, 1)
    path = np.stack([np.stack([x, np.full(steps, 5.0)], 1), np.stack([x[::-1], around[::-1]], 1)], axis=1)
    assert validate(problem, path).valid
    result = in_corridors(problem, path)
    middle = result[9:12, :, 1] - 5
    assert middle[:, 0].min() < -0.2 and middle[:, 1].max() < 0.8
    # The least there is: each passes the other's side by a radius, along tangents.
    least = 4 * np.hypot(4, 0.5)
    assert path_cost(problem, result) < path_cost(problem, path) - 0.3
    assert least - 1e-9 <= path_cost(problem, result) <= 1.005 * least


def test_needless_turn_is_removed():
    problem = Problem(ROOM, [RectangleRobot(1, 0.5)], [(2, 5, 0)], [(8, 5, 0)])
    path = straight(problem, 13)
    path[1:-1, 0, 2] = 0.3
    assert path_cost(problem, path) > 6.3
    np.testing.assert_allclose(path_cost(problem, in_corridors(problem, path, width=0.1)), 6, rtol=2e-2)


def test_cheapest_sequence_equals_brute_force():
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
