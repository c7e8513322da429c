"""Heuristics of robots with headings: PLRs over positions and headings in teams."""

import math

import numpy as np
import pytest

from plr_jax import (
    BLOptions,
    Box,
    DiscRobot,
    PlaneSpace,
    Problem,
    RectangleRobot,
    RigidBodySpace,
    Status,
    Workspace,
    bl_plan,
    construct,
    robot_distance_fns,
    scenes,
    solve_eikonal,
    straight_line,
    sum_of_distances,
    validate,
)

FULL = 2 * math.pi
ROOM = Workspace(((0, 0), (4, 4)))
DOMAIN = Box((0, 0, -math.pi), (4, 4, math.pi), periodic=(False, False, True))
TEAM = Problem(ROOM, [DiscRobot(0.3), RectangleRobot(1.0, 0.4)], [(1, 1, 0), (1, 3, 3)], [(3, 1, 0), (3, 3, -3)], 0.7)


def turned(x, goal):
    """The smaller angle to the goal's heading, by the unit circle."""
    return np.arccos(np.clip(np.cos(x[:, 2] - goal[2]), -1, 1))


def turning_cost(goal, weight):
    """Exact in an empty room: length, and weighted turn."""
    return lambda x: np.hypot(x[:, 0] - goal[0], x[:, 1] - goal[1]) + weight * turned(x, goal)


@pytest.fixture(scope="module")
def of_headings():
    return construct(turning_cost(TEAM.goals[1], 0.7), DOMAIN, leaf="continuous", max_leaves=3000)


@pytest.fixture(scope="module")
def of_positions():
    goal = TEAM.goals[0, :2]
    return construct(lambda x: np.linalg.norm(x - goal, axis=1), ROOM.bounds, leaf="continuous", max_leaves=500)


def joint(position, headings):
    """The disc at its start, the rectangle at a position with some headings."""
    q = np.empty((len(headings), 2, 3))
    q[:, 0], q[:, 1, :2], q[:, 1, 2] = (1, 1, 5.0), position, headings
    return q


def test_the_heading_of_a_rectangle_counts(of_positions, of_headings):
    headings = np.array([-3.0, -1.5, 0.0, 1.5, 3.0])
    terms = sum_of_distances([of_positions, of_headings]).per_robot(joint((3, 3), headings))
    np.testing.assert_allclose(terms[:, 1], 0.7 * np.array([0, 1.5, 3.0, FULL - 4.5, FULL - 6.0]), atol=0.1)
    assert np.ptp(terms[:, 1]) > 1.5  # which the leading two coordinates say nothing of


def test_headings_outside_the_domain_are_wrapped(of_positions, of_headings):
    headings = np.linspace(-3.1, 3.1, 23)
    heuristic = sum_of_distances([of_positions, of_headings])
    inside = heuristic.per_robot(joint((1.3, 2.1), headings))
    for turns in (-3, -1, 1, 2):
        outside = heuristic.per_robot(joint((1.3, 2.1), headings + turns * FULL))
        np.testing.assert_allclose(outside, inside, atol=1e-4)
    assert np.isfinite(inside).all()


def test_a_stack_of_positions_and_headings_equals_each_alone(of_positions, of_headings):
    q = np.random.default_rng(0).uniform((0, 0, -9), (4, 4, 9), (300, 2, 3))
    stacked = sum_of_distances([of_positions, of_headings]).per_robot(q)
    # Others than PLRs are called one by one.
    alone = [lambda x, fn=fn: np.asarray(fn(x)) for fn in (of_positions, of_headings)]
    alone[0].dim, alone[1].dim = 2, 3
    np.testing.assert_array_equal(sum_of_distances(alone).per_robot(q), stacked)
    # A disc's heading is ignored.
    q[:, 0, 2] += 1.0
    np.testing.assert_array_equal(sum_of_distances([of_positions, of_headings]).per_robot(q), stacked)


def test_positions_and_headings_do_not_fit_a_team_of_discs(of_positions, of_headings):
    with pytest.raises(ValueError, match="robot 1 has 3 dimensions, got 2"):
        sum_of_distances([of_positions, of_headings])(np.zeros((1, 2, 2)))


def test_a_mixed_team_is_planned_for(of_positions, of_headings):
    solution = bl_plan(TEAM, sum_of_distances([of_positions, of_headings]))
    assert solution.status is Status.SOLVED and validate(TEAM, solution.path).valid
    # What estimates say proves nothing.
    assert solution.lower_bound == pytest.approx(straight_line(TEAM)(TEAM.starts[None])[0], rel=1e-6)


# --- what is proven ------------------------------------------------------------------------------------------

DOOR = Workspace(((0, 0), (4, 4)), [[(1.9, 0), (2.1, 0), (2.1, 1.7), (1.9, 1.7)],
                                    [(1.9, 2.3), (2.1, 2.3), (2.1, 4), (1.9, 4)]])  # fmt: skip
THROUGH = Problem(
    DOOR,
    [DiscRobot(0.2), RectangleRobot(0.9, 0.2)],
    [(0.5, 0.5, 0.0), (0.6, 3.2, math.pi / 2)],
    [(3.5, 3.4, 0.0), (3.4, 0.9, math.pi / 2)],
    0.4,
)


@pytest.fixture(scope="module")
def proven():
    """PLRs of a disc and of a rectangle that has to turn to fit through a door."""
    disc, rectangle = THROUGH.robots
    return [
        solve_eikonal(PlaneSpace(DOOR, disc), THROUGH.goals[0, :2], max_leaves=500),
        solve_eikonal(
            RigidBodySpace(DOOR, rectangle, float(THROUGH.rotation_weights[1])), THROUGH.goals[1], max_leaves=4000
        ),
    ]


def test_only_lower_bounds_bound_costs(proven):
    estimate, bound = sum_of_distances(proven), sum_of_distances([plr.lower for plr in proven])
    assert not estimate.is_lower_bound and bound.is_lower_bound
    assert not sum_of_distances([proven[0].lower, proven[1]]).is_lower_bound
    assert sum_of_distances([robot_distance_fns(THROUGH)[0], proven[1].lower]).is_lower_bound
    starts = THROUGH.starts[None]
    assert (bound.per_robot(starts) <= estimate.per_robot(starts)).all()
    straight = straight_line(THROUGH)(starts)[0]
    guessed, known = (bl_plan(THROUGH, h, BLOptions(max_expansions=1)) for h in (estimate, bound))
    assert guessed.lower_bound == pytest.approx(straight, rel=1e-6)
    assert known.lower_bound == pytest.approx(max(straight, bound(starts)[0]), rel=1e-6)


def test_bounds_of_bodies_are_nowhere_above_paths_that_are_there(proven):
    """Along a path of the team, what is left of it costs each robot at least its bound; turns count."""
    solution = bl_plan(THROUGH)
    assert validate(THROUGH, solution.path).valid
    path = np.asarray(solution.path)
    change = np.diff(path, axis=0)
    angle = np.arccos(np.clip(np.cos(change[..., 2]), -1, 1))
    cost = np.hypot(change[..., 0], change[..., 1]) + angle * [0.0, 0.4]
    left = np.concatenate([np.cumsum(cost[::-1], axis=0)[::-1], np.zeros((1, 2))])
    bound = sum_of_distances([plr.lower for plr in proven]).per_robot(path)
    assert (bound <= left + 1e-6).all() and (bound.sum(axis=0) > 0.7 * left.sum(axis=0)).all()
    turned_away = THROUGH.goals[None] - [0, 0, 1.2]
    assert 0 < sum_of_distances([plr.lower for plr in proven]).per_robot(turned_away)[0, 1] <= 0.4 * 1.2


def test_costs_of_bodies_lead_through_a_tangle():
    problem = scenes.tangle()
    plrs = [
        solve_eikonal(RigidBodySpace(problem.workspace, robot, float(weight)), goal, max_leaves=2000)
        for robot, goal, weight in zip(problem.robots, problem.goals, problem.rotation_weights, strict=True)
    ]
    solution = bl_plan(problem, sum_of_distances(plrs), BLOptions(searchers=("bl",), max_expansions=20_000))
    assert solution.status is Status.SOLVED and validate(problem, solution.path).valid
