import time
from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from planner_helpers import ROOM, exact, heuristic_table, joint_lattice_of, search_budget

from plr_jax import (
    BLOptions,
    DiscRobot,
    PointRobot,
    Problem,
    RectangleRobot,
    Workspace,
    bl_plan,
    path_cost,
    scenes,
    validate,
)
from plr_jax._problem import motion_costs
from plr_jax.collision.team import JointMotionTest
from plr_jax.planners import straight_line
from plr_jax.planners.bl.search import BestFirstSearch
from plr_jax.planners.smoothing import halved, shorten

ALONE = Problem(ROOM, [DiscRobot(0.4)], [(1, 1)], [(9, 5)])
BAR = Problem(ROOM, [RectangleRobot(1.2, 0.4)], [(1, 1, 3.0)], [(9, 5, -3.0)])
MIXED = Problem(
    ROOM,
    [DiscRobot(0.4), RectangleRobot(1.2, 0.4), PointRobot()],
    [(1, 1, 5), (1, 8, 0), (5, 1, 0)],
    [(9, 1, 5), (9, 8, 1), (5, 5, 0)],
)


def shortened(problem, path, deadline=np.inf):
    return shorten(problem, path, JointMotionTest(problem.workspace, problem.robots, deadline))


def zigzag(problem, steps, width):
    """The straight way, every other row moved aside."""
    path = straight(problem, steps)
    path[1:-1:2, :, 1] += width
    return path


def straight(problem, steps):
    turn = np.zeros_like(problem.goals)
    turn[:, :2] = problem.goals[:, :2] - problem.starts[:, :2]
    turn[:, 2:] = np.angle(np.exp(1j * (problem.goals - problem.starts)[:, 2:]))
    path = problem.starts + np.linspace(0, 1, steps)[:, None, None] * turn
    path[[0, -1]] = problem.starts, problem.goals
    return path


def found_on_lattice(problem, step):
    """A path of the planner before anything is shortened, by its search alone."""
    joint = joint_lattice_of(problem, step)
    search = BestFirstSearch(joint, heuristic_table(joint, exact(problem), 2.0), BLOptions(), search_budget())
    while search.run(100_000) is None:
        pass
    return joint.configurations(search.branch)


# What becomes straight


@pytest.mark.parametrize("problem", [ALONE, BAR, MIXED], ids=["disc", "bar", "mixed"])
@pytest.mark.parametrize("steps", [3, 10, 25])
def test_a_zigzag_in_an_empty_room_becomes_straight(problem, steps):
    path = zigzag(problem, steps, 0.7)
    short = shortened(problem, path)
    assert len(short) == len(path)
    assert path_cost(problem, short) == pytest.approx(motion_costs(problem, problem.starts, problem.goals).sum())
    assert path_cost(problem, path) > 1.1 * path_cost(problem, short) or steps == 3
    assert validate(problem, short).valid
    # The point's way lies along the zigzag, so its rows need not be evenly spaced.
    np.testing.assert_allclose(np.diff(short[:, :2, :2], 2, axis=0), 0, atol=1e-12, err_msg="constant speed")


def test_turns_to_and_fro_are_left_out():
    path = straight(BAR, 9)
    path[1:-1:2, 0, 2] += 0.6
    short = shortened(BAR, path)
    assert path_cost(BAR, short) == pytest.approx(motion_costs(BAR, BAR.starts, BAR.goals).sum())
    assert path_cost(BAR, short) < path_cost(BAR, path)


def test_a_long_zigzag_is_shortened_piece_by_piece():
    path = zigzag(ALONE, 101, 0.3)
    short = shortened(ALONE, path)
    assert path_cost(ALONE, short) < 1.02 * np.hypot(8, 4) < path_cost(ALONE, path) / 1.5


@pytest.mark.parametrize("steps", [1, 2])
def test_paths_of_one_or_two_rows_stay(steps):
    problem = Problem(ROOM, [DiscRobot(0.4)], [(1, 1)], [(1, 1) if steps == 1 else (9, 5)])
    path = np.stack([problem.starts, problem.goals])[:steps]
    np.testing.assert_array_equal(shortened(problem, path), path)


def test_the_path_given_is_left_alone():
    path = zigzag(ALONE, 9, 0.5)
    before = path.copy()
    shortened(ALONE, path)
    np.testing.assert_array_equal(path, before)


def test_past_the_deadline_nothing_is_done():
    path = zigzag(ALONE, 9, 0.5)
    np.testing.assert_array_equal(shortened(ALONE, path, time.perf_counter() - 1), path)


# What stands in the way


def test_a_wall_is_gone_around_tightly():
    workspace = Workspace(((0, 0), (10, 10)), [shapely.box(4.5, 0, 5.5, 6)])
    problem = Problem(workspace, [DiscRobot(0.5)], [(1, 1)], [(9, 1)])
    corners = np.array([(1, 1), (1, 9), (9, 9), (9, 1)], dtype=float)
    path = np.concatenate([np.linspace(a, b, 9) for a, b in pairwise(corners)])[:, None]
    short = shortened(problem, path)
    report = validate(problem, short)
    assert report.valid, report.message
    shortest = 2 * np.hypot(3.5, 5.5) + 1 - 1.0  # a bound: two legs to the corners and the wall's top, less rounding
    assert shortest < report.cost < 0.8 * path_cost(problem, path)


def test_robots_that_give_way_go_on_giving_way():
    # The second robot stands in the way of the first, which goes around it.
    problem = Problem(ROOM, [DiscRobot(0.5), DiscRobot(0.5)], [(1, 5), (5, 5)], [(9, 5), (5, 5)])
    path = np.repeat(problem.starts[None], 9, axis=0)
    path[:, 0, 0] = np.linspace(1, 9, 9)
    path[1:-1, 0, 1] = 8
    short = shortened(problem, path)
    report = validate(problem, short)
    assert report.valid, report.message
    np.testing.assert_array_equal(short[:, 1], path[:, 1])
    assert 8 < report.cost < path_cost(problem, path)


def test_timing_matters_and_is_kept():
    # Two discs cross one after the other; each alone could go straight at once.
    problem = Problem(ROOM, [DiscRobot(0.5), DiscRobot(0.5)], [(1, 5), (5, 1)], [(9, 5), (5, 9)])
    path = np.repeat(problem.starts[None], 17, axis=0)
    path[:9, 0, 0], path[9:, 0, 0] = np.linspace(1, 9, 9), 9
    path[8:, 1, 1] = np.linspace(1, 9, 9)
    assert not validate(problem, straight(problem, 17)).valid and validate(problem, path).valid
    short = shortened(problem, path)
    assert validate(problem, short).valid and path_cost(problem, short) == pytest.approx(16)


@pytest.mark.parametrize(
    ("problem", "step"),
    [
        (scenes.single_door(), 0.4),
        (scenes.four_rooms(3), 0.5),
        (scenes.cross(2), 0.4),
        (scenes.maze(), 0.04),
        (MIXED, 0.8),
    ],
    ids=["door", "rooms", "cross", "maze", "mixed"],
)
def test_paths_of_the_search_become_cheaper_and_stay_valid(problem, step):
    path = found_on_lattice(problem, step)
    short = shortened(problem, path)
    report = validate(problem, short)
    assert report.valid, report.message
    assert short.shape == path.shape and report.cost < path_cost(problem, path)
    np.testing.assert_array_equal(short[[0, -1]], path[[0, -1]])


def test_one_robot_is_shortened_and_the_others_keep_their_motions():
    path = straight(MIXED, 13)
    path[1:-1:2, 0, 1] += 0.8  # the disc alone goes to and fro
    short = shortened(MIXED, path)
    np.testing.assert_allclose(short[:, 1:], path[:, 1:], atol=1e-12)
    assert np.ptp(short[:, 0, 1]) < 1e-12 and validate(MIXED, short).valid


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 10_000), steps=st.integers(3, 14))
def test_random_valid_walks_stay_valid_and_never_cost_more(seed, steps):
    rng = np.random.default_rng(seed)
    workspace = Workspace(((0, 0), (6, 6)), [shapely.box(2.5, 2.5, 3.5, 3.5)])
    robots = [DiscRobot(0.3), RectangleRobot(0.9, 0.3)]
    path = np.array([[(1.0, 1.0, 0.0), (5.0, 5.0, 0.5)]])
    for _ in range(steps - 1):
        row = path[-1:] + rng.normal(0, [0.9, 0.9, 0.8], (1, 2, 3)) * [[[1, 1, 0], [1, 1, 1]]]
        longer = np.concatenate([path, row])
        try:
            problem = Problem(workspace, robots, longer[0], longer[-1])
        except ValueError:
            continue
        if validate(problem, longer).valid:
            path = longer
    if len(path) == 1:
        return
    problem = Problem(workspace, robots, path[0], path[-1])
    for before in (path, halved(path)):
        short = shortened(problem, before)
        report = validate(problem, short)
        assert report.valid, report.message
        assert report.cost <= path_cost(problem, before) * (1 + 1e-12)
        np.testing.assert_array_equal(short[[0, -1]], before[[0, -1]])


# Subdivision


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), steps=st.integers(2, 6))
def test_subdivision_keeps_the_cost_and_the_rows(seed, steps):
    rng = np.random.default_rng(seed)
    path = np.concatenate([rng.uniform(0, 9, (steps, 3, 2)), rng.uniform(-9, 9, (steps, 3, 1))], axis=2)
    finer = halved(path)
    assert finer.shape == (2 * steps - 1, 3, 3)
    np.testing.assert_array_equal(finer[::2], path)
    problem = Problem(
        ROOM, [RectangleRobot(1.2, 0.4)] * 3, [(2, 2, 0), (5, 5, 0), (8, 8, 0)], [(2, 2, 0), (5, 5, 0), (8, 8, 0)]
    )
    costs, halves = motion_costs(problem, path[:-1], path[1:]), motion_costs(problem, finer[:-1], finer[1:])
    np.testing.assert_allclose(halves[::2], costs / 2, rtol=1e-9)
    np.testing.assert_allclose(halves[1::2], costs / 2, rtol=1e-9)


def test_the_middle_of_a_turn_across_the_half_turn():
    path = np.array([[(0.0, 0.0, 3.0)], [(1.0, 2.0, -3.0)]])
    middle = halved(path)[1, 0]
    np.testing.assert_allclose(middle[:2], (0.5, 1.0))
    assert np.cos(middle[2]) == pytest.approx(-1)


def test_subdivision_keeps_validity():
    solution = bl_plan(BAR, straight_line(BAR), BLOptions(step=0.7))
    finer = halved(solution.path)
    report = validate(BAR, finer)
    assert report.valid and report.cost == pytest.approx(solution.cost)
