"""Paths by lookahead, for costs other than length and spaces other than the plane."""

import math

import numpy as np
import pytest
from descent_helpers import descended
from space_helpers import Climb, Slow, far_from
from space_helpers import rectangle as box

from plr_jax import RectangleRobot, Workspace, descend, solve_eikonal
from plr_jax._lookahead import PathCosts, unit_motions
from plr_jax.spaces import LipschitzCost, MotionCost, PlanarArm, PlaneSpace, RigidBodySpace

SQUARE = Workspace(((0, 0), (2, 2)))
SLOWNESS = 2.0
SLOW_BEYOND = Slow((1, -1), (9, 9), SLOWNESS)
SLOW_STRIP = Slow((0.99, -1), (1.01, 1.8), 10.0)  # open at the top
LINEAR = LipschitzCost(lambda q: 1 + q[:, 0], lipschitz=1.0, least=1.0)


def refracted(starts, goal):
    """Return least costs from the fast half to the slow one, and where paths cross, by the principle of Fermat."""
    lo, hi = np.zeros(len(starts)), np.full(len(starts), 2.0)
    for _ in range(60):  # bisection of the derivative of the cost in y
        y = (lo + hi) / 2
        fast, slow = np.hypot(1 - starts[:, 0], y - starts[:, 1]), np.hypot(goal[0] - 1, goal[1] - y)
        grows = (y - starts[:, 1]) * slow > SLOWNESS * (goal[1] - y) * fast
        lo, hi = np.where(grows, lo, y), np.where(grows, y, hi)
    return fast + SLOWNESS * slow, y


def test_path_into_slow_ground_is_refracted():
    goal, starts = np.array([1.6, 1.3]), np.array([(0.3, 0.2), (0.9, 0.5), (0.5, 1.3)])

    def field(x):
        return np.where(x[:, 0] <= 1, refracted(x, goal)[0], SLOWNESS * np.hypot(*(x - goal).T))

    costs, y = refracted(starts, goal)
    descent = descend(field, SQUARE, starts, goal, cost_map=SLOW_BEYOND)
    np.testing.assert_allclose(descent.costs, costs, rtol=1e-3)
    crossings = [np.interp(1.0, path[:, 0], path[:, 1]) for path in descent.paths]
    np.testing.assert_allclose(crossings, y, atol=0.05)
    assert (descent.lengths >= np.hypot(*(starts - goal).T) - 1e-12).all()


def test_paths_do_not_depend_on_the_unit_of_costs():
    goal, starts = np.array([1.6, 1.3]), [(0.3, 0.2)]
    slowness = LipschitzCost(lambda q: 3600 * (1 + q[:, 0]), lipschitz=3600.0, least=3600.0)
    in_hours = descend(far_from(goal), SQUARE, starts, goal, cost_map=LINEAR)
    in_seconds = descend(lambda x: 3600 * far_from(goal)(x), SQUARE, starts, goal, cost_map=slowness)
    np.testing.assert_allclose(in_seconds.vertices, in_hours.vertices, rtol=1e-9)
    np.testing.assert_allclose(in_seconds.costs, 3600 * in_hours.costs, rtol=1e-9)


def test_uphill_costs_more_than_downhill():
    """On a slope along x, of 1 in 2, where a unit of climbing costs 3."""
    ground = Climb(lambda q: np.tile([0.5, 0.0], (len(q), 1)), rate=3.0, lipschitz=0.0, steepest=0.5)
    low, high = np.array([0.2, 1.0]), np.array([1.8, 1.0])
    for start, goal, cost in ((low, high, 1.6 + 3 * 0.8), (high, low, 1.6)):

        def field(x, goal=goal):
            return far_from(goal)(x) + 1.5 * np.maximum(goal[0] - x[:, 0], 0)

        assert descend(field, SQUARE, [start], goal, cost_map=ground).costs[0] == pytest.approx(cost, rel=1e-3)


def test_costs_equal_integrals_of_the_factor():
    """A thin strip between samples has its cost, too."""
    space = PlaneSpace(SQUARE)
    a, b = np.array([[0.0, 0.0], [0.5, 0.5], [0.0, 1.0]]), np.array([[2.0, 2.0], [0.5, 1.5], [2.0, 1.0]])
    for cost_map, expected, rtol in (
        (SLOW_BEYOND, [math.sqrt(2) * 3, 1.0, 3.0], 1e-3),
        (SLOW_STRIP, [math.sqrt(2) * 2.18, 1.0, 2.18], 1e-3),
        (LINEAR, [2 * math.sqrt(8), 1.5, 4.0], 1e-9),
        (None, [math.sqrt(8), 1.0, 2.0], 1e-12),
    ):
        np.testing.assert_allclose(PathCosts(space, cost_map).integrals(a, b, 1e-3), expected, rtol=rtol)


def test_integrals_across_a_seam_stay_in_the_domain():
    space = RigidBodySpace(SQUARE, RectangleRobot(0.2, 0.1), rotation_weight=1.0)
    lo, hi = space.domain.lo, space.domain.hi

    def factor(q):
        """Return 1 + |heading|; fail outside the domain."""
        assert ((q >= lo) & (q <= hi)).all()
        return 1 + np.abs(q[:, 2])

    costs = PathCosts(space, LipschitzCost(factor, lipschitz=1.0, least=1.0))
    q = np.array([[1.0, 1.0, math.pi - 0.5], [1.0, 1.0, -math.pi + 0.5]])
    # A turn of 1 over headings whose sizes grow from pi - 0.5 to pi and shrink again.
    np.testing.assert_allclose(costs.integrals(q, q[::-1], 1e-3), 1 + math.pi - 0.25, rtol=1e-3)


def test_unit_motions_cost_one_and_come_in_opposite_pairs():
    for blocks, num_axes_alone in (([((0, 1), 1.0)], 4), ([((0, 1), 1.0), ((2,), 0.3)], 6), ([((0,), 2.0)], 2)):
        motion = MotionCost(tuple(blocks))
        steps = unit_motions(motion)
        np.testing.assert_allclose(motion.norm(steps), 1.0, rtol=1e-12)
        rounded = {tuple(step) for step in np.round(steps, 9) + 0.0}
        assert rounded == {tuple(-np.array(step) + 0.0) for step in rounded}
        assert sum(np.count_nonzero(step) == 1 for step in rounded) == num_axes_alone


# --- bodies that turn, and arms --------------------------------------------------------------------------


def test_body_turns_the_short_way_through_the_seam():
    space = RigidBodySpace(SQUARE, RectangleRobot(0.2, 0.1), rotation_weight=0.5)
    goal, starts = np.array([1.5, 1.0, 3.0]), np.array([[0.5, 1.0, -3.0], [0.5, 1.0, 2.8], [1.5, 1.0, 0.0]])
    turn = np.array([2 * math.pi - 6.0, 0.2, 3.0])
    exact = np.hypot(*(starts - goal)[:, :2].T) + 0.5 * turn

    def field(x):
        angle = np.abs(x[:, 2] - goal[2]) % (2 * math.pi)
        return np.hypot(*(x - goal)[:, :2].T) + 0.5 * np.minimum(angle, 2 * math.pi - angle)

    descent = descended(field, space, starts, goal)
    np.testing.assert_allclose(descent.costs, exact, rtol=1e-6)


@pytest.mark.full
def test_body_turns_to_fit_through_a_door():
    """The body is longer than the door is wide and starts parallel to the wall."""
    workspace = Workspace(((0, 0), (4, 4)), [box(1.9, 0, 2.1, 1.8), box(1.9, 2.2, 2.1, 4)])
    space = RigidBodySpace(workspace, RectangleRobot(0.6, 0.2), rotation_weight=0.3)
    goal, starts = np.array([3.0, 2.0, math.pi / 2]), np.array([[1.0, 2.0, math.pi / 2], [1.0, 2.0, -math.pi / 2]])
    plr = solve_eikonal(space, goal, max_leaves=1000)
    descent = descended(plr, space, starts, goal)
    # The chord of the body along the middle of the wall has to fit through 0.4: it turns by a sixth of pi and back.
    assert (descent.costs >= 2.0 + 2 * 0.3 * math.pi / 6).all()
    assert descent.costs[0] <= 2.9
    # From the other start, the body turns by half a turn in all.
    assert descent.costs[1] >= 2.0 + 0.3 * math.pi - 1e-6
    assert (descent.costs >= np.asarray(plr.lower(starts))).all()


@pytest.mark.full
def test_arm_goes_around_an_obstacle_and_through_the_seams():
    arm = PlanarArm(Workspace(((-2, -2), (2, 2)), [box(0.5, 0.5, 1.0, 1.0)]), [0.8, 0.6], (0, 0))
    goal, rng = np.array([1.8, 0.0]), np.random.default_rng(0)
    q = rng.uniform(-math.pi, math.pi, (60, 2))
    starts = q[arm.is_free(q)][:20]
    plr = solve_eikonal(arm, goal, max_leaves=1000)
    descent, lower = descended(plr, arm, starts, goal), np.asarray(plr.lower(starts))
    assert (descent.costs >= lower).all() and np.median(descent.costs / lower) < 1.05
    assert any(np.abs(np.diff(path, axis=0)).max() > math.pi for path in descent.paths)
