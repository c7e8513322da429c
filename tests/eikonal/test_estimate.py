"""Estimates on grids, against costs-to-go that are known."""

import numpy as np
import pytest
from eikonal_helpers import ROOM, BoxSpace
from space_helpers import Climb, Slow, rectangle

from plr_jax import LipschitzCost, PlaneSpace, VisibilityGraph, Workspace
from plr_jax.eikonal.estimate import swept_estimate
from plr_jax.geometry.box import Box


def estimate_of(space, goal, num_nodes, cost_map=None):
    domain = space.domain
    estimate = swept_estimate(space, cost_map, (np.array(goal) - domain.lo) / domain.width, num_nodes)
    return lambda q: estimate((q - domain.lo) / domain.width)


def samples(domain, num=500):
    return domain.lo + domain.width * np.random.default_rng(0).random((num, domain.dim))


@pytest.mark.parametrize(
    ("domain", "blocks"),
    [
        (Box([0], [3]), None),
        (Box((0, -1), (2, 0), periodic=(False, True)), None),
        pytest.param(
            Box((1e6, 1e6, 0), (1e6 + 1e-3, 1e6 + 2e-3, 6), periodic=(False, False, True)),
            (((0, 1), 1.0), ((2,), 1e-4)),
            marks=pytest.mark.full,
        ),
    ],
)
def test_where_nothing_is_in_the_way_straight_motions_are_best(domain, blocks):
    space = BoxSpace(domain, blocks=blocks)
    goal = domain.lo + 0.37 * domain.width
    q = samples(domain)
    found, truth = estimate_of(space, goal, 700)(q), space.straight(q, goal)
    np.testing.assert_allclose(found, truth, rtol=0.01)  # half a turn from the goal two ways are best
    assert np.abs(found - truth).mean() < 3e-4 * truth.mean()


@pytest.mark.full
def test_costs_that_rise_evenly_are_met_the_better_the_finer_the_grid():
    """The speed is linear, so that paths are arcs."""
    space, goal, rise = BoxSpace(Box((0, 0), (1, 2))), np.array([0.3, 0.6]), 3.0
    speed = lambda q: 0.5 + rise * q[:, 1]  # noqa: E731
    cost = LipschitzCost(lambda q: 1 / speed(q), rise / 0.25, 1 / 6.5)
    q = samples(Box((0, 0.1), (1, 1)))  # whose arcs stay inside
    square = np.sum((q - goal) ** 2, axis=1)
    truth = np.arccosh(1 + rise**2 * square / (2 * speed(q) * speed(goal[None]))) / rise
    coarse, fine = (np.abs(estimate_of(space, goal, n, cost)(q) - truth).mean() / truth.mean() for n in (600, 9_000))
    assert fine < 3e-4 and fine < coarse / 6


def test_walls_between_nodes_are_gone_around_and_sealed_rooms_are_not_reached():
    q = ROOM.sample_free(500, 0)
    truth = VisibilityGraph(ROOM, (0.3, 0.4))(q)
    found = estimate_of(PlaneSpace(ROOM), (0.3, 0.4), 9_000)(q)
    assert np.abs(found - truth).mean() < 7e-3 * truth.mean()
    space = BoxSpace(Box((0, 0), (1, 1)), ((0.501, -1), (0.502, 2)))
    q = np.array([(0.2, 0.7), (0.8, 0.7)])
    assert np.isfinite(estimate_of(space, (0.1, 0.1), 700)(q)).tolist() == [True, False]


@pytest.mark.full
def test_climbing_evenly_costs_what_is_climbed():
    space, goal, uphill = BoxSpace(Box((0, 0), (1, 1))), np.array([0.4, 0.3]), np.array([0.6, -0.3])
    climbing = Climb(lambda q: np.broadcast_to(uphill, q.shape), rate=2.0, lipschitz=0.0, steepest=0.7)
    q = samples(space.domain)
    truth = np.linalg.norm(goal - q, axis=1) + 2 * np.maximum((goal - q) @ uphill, 0)
    found = estimate_of(space, goal, 2_000, climbing)(q)
    assert np.abs(found - truth).mean() < 5e-3 * truth.mean()


@pytest.mark.full
def test_ways_lead_to_the_goal():
    goal = np.array([0.1, 0.133])
    estimate = swept_estimate(PlaneSpace(ROOM), None, goal, 2_000)
    x = (ROOM.sample_free(100, 1) - ROOM.bounds.lo) / ROOM.bounds.width
    *_, last = estimate.along(x, (50, 500))
    assert np.abs(last - goal).max() < 0.05


@pytest.mark.full
def test_walls_in_space_are_gone_around_and_no_way_is_shorter_than_straight():
    """Walls as high as the domain, with a window: the distance is that of the plane and the height, by Pythagoras."""
    walls = [[(0.5, 0.0), (0.53, 0.375)], [(0.5, 0.625), (0.53, 1.0)]]
    space, goal = BoxSpace(Box((0,) * 3, (1,) * 3), *([(*lo, 0), (*hi, 1)] for lo, hi in walls)), (0.2, 0.13, 0.37)
    plane = Workspace(((0, 0), (1, 1)), [rectangle(*lo, *hi) for lo, hi in walls])
    estimate = swept_estimate(space, None, np.array(goal), 4096)
    assert estimate.ratio.min() > 0.995
    x = samples(space.domain)
    x = x[space.is_free(x)]
    truth = np.hypot(VisibilityGraph(plane, goal[:2])(x[:, :2]), x[:, 2] - goal[2])
    assert np.abs(estimate(x) - truth).mean() < 0.03 * truth.mean()


@pytest.mark.full
@pytest.mark.parametrize("jump", [3.0, 20.0])
def test_where_costs_jump_nothing_is_below_what_is_possible(jump):
    """Across a border of two halves by Snell's law; no way is shorter than the straight one at the lower cost."""
    space, cost = PlaneSpace(Workspace(((0, 0), (2, 1)))), Slow((1, -1), (9, 9), jump)
    q = samples(space.domain)
    found = estimate_of(space, (0.25, 0.5), 3_000, cost)(q)
    border = np.linspace(0, 1, 4_001)
    beyond = np.maximum(q[:, :1] - 1, 0)
    crossing = np.hypot(0.75, border - 0.5) + jump * np.hypot(beyond, border - q[:, 1:])
    straight = np.linalg.norm(q - (0.25, 0.5), axis=1)
    truth = np.where(q[:, 0] > 1, crossing.min(axis=1), straight)
    assert (found > 0.999 * straight).all()
    assert np.abs(found - truth).mean() < jump / 2 / 32  # the border is a node's, who costs the mean of both
