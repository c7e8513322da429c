"""Estimates on grids, against costs-to-go that are known."""

import numpy as np
import pytest
from eikonal_helpers import ROOM, BoxSpace
from space_helpers import Climb, Slow, rectangle

from plr_jax import (
    DiscRobot,
    LipschitzCost,
    PlaneSpace,
    RasterCost,
    VisibilityGraph,
    VoxelSpace,
    Workspace,
)
from plr_jax.eikonal import estimate as estimates
from plr_jax.geometry.box import Box


def grid_estimate(space, cost_map, goal, num_leaves=0):
    return estimates.grid_estimate(space, cost_map, np.atleast_2d(goal), num_leaves)


def samples(domain, num=500):
    return domain.lo + domain.width * np.random.default_rng(0).random((num, domain.dim))


def mean_error(found, truth):
    return np.abs(found - truth).mean() / truth.mean()


@pytest.mark.parametrize(
    ("domain", "blocks", "worst"),
    [
        (Box([0], [3]), None, 1e-6),
        (Box((0, -1), (2, 0), periodic=(False, True)), None, 1e-3),
        # Cheapest paths over a stencil, whose motions in the plane are one to three steps long along each axis.
        (
            Box((1e6, 1e6, 0), (1e6 + 1e-3, 1e6 + 2e-3, 6), periodic=(False, False, True)),
            (((0, 1), 1.0), ((2,), 1e-4)),
            0.02,
        ),
    ],
)
def test_where_nothing_is_in_the_way_straight_motions_are_best(domain, blocks, worst):
    space = BoxSpace(domain, blocks=blocks)
    goal = domain.lo + 0.37 * domain.width
    q = samples(domain)
    found, truth = grid_estimate(space, None, goal)(q), space.straight(q, goal)
    np.testing.assert_allclose(found, truth, rtol=3 * worst, atol=0.01 * truth.mean())
    assert mean_error(found, truth) < worst


def test_costs_that_rise_evenly_are_met_the_better_the_finer_the_grid():
    """The speed is linear, so that paths are arcs."""
    space, goal, rise = BoxSpace(Box((0, 0), (1, 2))), np.array([0.3, 0.6]), 3.0
    speed = lambda q: 0.5 + rise * q[:, 1]  # noqa: E731
    cost = LipschitzCost(lambda q: 1 / speed(q), rise / 0.25, 1 / 6.5)
    q = samples(Box((0, 0.1), (1, 1)))  # whose arcs stay inside
    square = np.sum((q - goal) ** 2, axis=1)
    truth = np.arccosh(1 + rise**2 * square / (2 * speed(q) * speed(goal[None]))) / rise
    coarse, fine = (mean_error(grid_estimate(space, cost, goal, leaves)(q), truth) for leaves in (0, 90_000))
    assert coarse < 1e-4 and fine < coarse / 2


def test_walls_between_nodes_are_gone_around_and_sealed_rooms_are_not_reached():
    q = ROOM.sample_free(500, 0)
    truth = VisibilityGraph(ROOM, (0.3, 0.4))(q)
    assert mean_error(grid_estimate(PlaneSpace(ROOM), None, np.array([0.3, 0.4]))(q), truth) < 1e-3
    space = BoxSpace(Box((0, 0), (1, 1)), ((0.5011, -1), (0.5012, 2)))
    q = np.array([(0.2, 0.7), (0.8, 0.7)])
    assert np.isfinite(grid_estimate(space, None, np.array([0.1, 0.1]))(q)).tolist() == [True, False]


def test_around_corners_on_nodes_costs_are_extrapolated():
    """The goal lies between nodes. Without extrapolation the error is 1.4e-4."""
    workspace, goal = Workspace(((0, 0), (1, 1)), [rectangle(0.4, 0.0, 0.5, 0.6)]), np.array([0.2011, 0.2003])
    q = workspace.sample_free(500, 0)
    estimate = grid_estimate(PlaneSpace(workspace), None, goal)
    assert mean_error(estimate(q), VisibilityGraph(workspace, goal)(q)) < 5e-5


@pytest.mark.parametrize("angle", [0.0, 0.2, np.pi / 4])
@pytest.mark.parametrize("size", [3, 8, 50, 401])
def test_nothing_passes_between_obstacles_that_touch_in_a_corner(angle, size):
    """Two triangles or squares that touch in the middle of the map split it."""
    turn = np.array([(np.cos(angle), -np.sin(angle)), (np.sin(angle), np.cos(angle))])
    rays = 4 * size * np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) @ turn.T
    middle = size / 2
    walls = [np.array((middle, middle)) + sign * rays for sign in (-1, 1)]
    workspace, open_workspace = (
        Workspace(((0, 0), (size, size)), walls, squeeze=squeeze) for squeeze in (False, True)
    )
    goal, beyond = (np.array((middle, middle)) + sign * turn @ (0.2 * size, -0.2 * size) for sign in (-1, 1))
    estimate = grid_estimate(PlaneSpace(workspace), None, goal)
    assert estimate(np.stack([goal, beyond])).tolist() == [0.0, np.inf]
    squeezed = grid_estimate(PlaneSpace(open_workspace), None, goal)(beyond[None])
    assert squeezed == pytest.approx(VisibilityGraph(open_workspace, goal)(beyond[None]), rel=0.02)


@pytest.mark.parametrize("dim", [2, 3])
def test_voxels_that_touch_in_edges_or_corners_do_not_join(dim):
    free = np.zeros((2,) * dim, bool)
    free[(0,) * dim] = free[(1,) * dim] = True
    estimate = grid_estimate(VoxelSpace(free.repeat(4, 0).repeat(4, 1)), None, np.full(dim, 0.4))
    last = np.array(estimate.space.domain.hi) - 0.1
    assert estimate(last[None]).tolist() == [np.inf]


def test_sides_of_voxels_may_differ_tenfold():
    """A wall with a hole of one voxel, straight through which a path leads."""
    free = np.ones((40, 30, 6), bool)
    free[20] = False
    free[20, 15, 3] = True
    estimate = grid_estimate(VoxelSpace(free, ((0, 0, 0), (4, 30, 1.2))), None, np.array([0.5, 15.5, 0.7]))
    found = estimate(np.array([(3.5, 15.5, 0.7), (1.5, 15.5, 0.7), (0.5, 17.5, 0.7)]))
    np.testing.assert_allclose(found, [3, 1, 2], rtol=0.02)


def test_a_disc_passes_gaps_that_are_as_wide_as_it_is_and_no_narrower_ones():
    for width, reaches in ((0.401, True), (0.399, False)):
        workspace = Workspace(((0, 0), (4, 4)), [rectangle(0, 1.9, 2, 2.1), rectangle(2 + width, 1.9, 4, 2.1)])
        estimate = grid_estimate(PlaneSpace(workspace, DiscRobot(0.2)), None, np.array([1.0, 1.0]), 100_000)
        assert np.isfinite(estimate(np.array([(1.0, 3.0)]))).tolist() == [reaches]


@pytest.mark.parametrize("interpolation", ["bilinear", "nearest"])
@pytest.mark.parametrize("ratio", [3.0, 50.0, 255.0])
def test_cheap_lines_and_dear_cells_of_one_cell_are_seen(interpolation, ratio):
    values = np.full((7, 20), ratio)
    values[1] = 1.0
    road = RasterCost(values, ((0, 0), (20, 7)), interpolation)
    found = grid_estimate(road.space(), road, np.array([19.5, 1.5]))(np.array([(0.5, 1.5), (10.5, 1.5)]))
    np.testing.assert_allclose(found, [19, 9], rtol=1e-6)
    values = np.ones((5, 5))
    values[2, 2] = ratio
    tower = RasterCost(values, ((0, 0), (5, 5)), "nearest")
    found = grid_estimate(tower.space(), tower, np.array([0.5, 2.5]))(np.array([(4.5, 2.5)]))
    # Straight through, or around by two corners of the dear cell.
    assert found == pytest.approx(min(3 + ratio, 1 + 2 * np.hypot(1.5, 0.5)), rel=0.02)


def test_a_raster_that_does_not_fill_the_domain_is_seen_all_the_same():
    values = np.full((7, 20), 50.0)
    values[1] = 1.0
    road = RasterCost(values, ((0, 0), (20, 7)), "nearest")
    space = PlaneSpace(Workspace(((-1, -1), (21, 8))))
    found = grid_estimate(space, road, np.array([19.5, 1.5]))(np.array([(0.5, 1.5)]))
    assert found == pytest.approx([19], rel=0.01)


def test_climbing_evenly_costs_what_is_climbed():
    space, goal, uphill = BoxSpace(Box((0, 0), (1, 1))), np.array([0.4, 0.3]), np.array([0.6, -0.3])
    climbing = Climb(lambda q: np.broadcast_to(uphill, q.shape), rate=2.0, lipschitz=0.0, steepest=0.7)
    q = samples(space.domain)
    truth = np.linalg.norm(goal - q, axis=1) + 2 * np.maximum((goal - q) @ uphill, 0)
    assert mean_error(grid_estimate(space, climbing, goal)(q), truth) < 0.015


@pytest.mark.full
def test_walls_in_space_are_gone_around_and_no_path_is_shorter_than_straight():
    """Walls as high as the domain, with a window: the distance is that of the plane and the height, by Pythagoras."""
    walls = [[(0.5, 0.0), (0.53, 0.375)], [(0.5, 0.625), (0.53, 1.0)]]
    space, goal = BoxSpace(Box((0,) * 3, (1,) * 3), *([(*lo, 0), (*hi, 1)] for lo, hi in walls)), (0.2, 0.13, 0.37)
    plane = Workspace(((0, 0), (1, 1)), [rectangle(*lo, *hi) for lo, hi in walls])
    estimate = grid_estimate(space, None, np.array(goal))
    x = samples(space.domain)
    x = x[space.is_free(x)]
    truth = np.hypot(VisibilityGraph(plane, goal[:2])(x[:, :2]), x[:, 2] - goal[2])
    found = estimate(x)
    assert mean_error(found, truth) < 0.01
    assert (found > 0.997 * space.straight(x, np.array(goal))).all()


@pytest.mark.parametrize("jump", [3.0, 20.0])
def test_where_costs_jump_nothing_is_below_what_is_possible(jump):
    """Across a border of two halves by Snell's law; no path is shorter than the straight one at the lower cost."""
    space, cost = PlaneSpace(Workspace(((0, 0), (2, 1)))), Slow((1, -1), (9, 9), jump)
    q = samples(space.domain)
    found = grid_estimate(space, cost, np.array([0.25, 0.5]))(q)
    border = np.linspace(0, 1, 4_001)
    beyond = np.maximum(q[:, :1] - 1, 0)
    crossing = np.hypot(0.75, border - 0.5) + jump * np.hypot(beyond, border - q[:, 1:])
    straight = np.linalg.norm(q - (0.25, 0.5), axis=1)
    truth = np.where(q[:, 0] > 1, crossing.min(axis=1), straight)
    assert (found > 0.998 * straight).all()
    assert mean_error(found, truth) < 0.01


def test_a_jump_of_costs_near_the_goal_is_seen():
    """What lies beyond the border is cheaper, so that no path there comes back: Snell's law gives the truth."""
    space, cost, goal = PlaneSpace(Workspace(((0, 0), (2, 1)))), Slow((1, -1), (9, 9), 0.7), np.array([0.95, 0.5])
    q = samples(space.domain)
    q = q[q[:, 0] > 1]
    border = np.linspace(0, 1, 4_001)
    crossing = np.hypot(0.05, border - 0.5) + 0.7 * np.hypot(q[:, :1] - 1, border - q[:, 1:])
    assert mean_error(grid_estimate(space, cost, goal)(q), crossing.min(axis=1)) < 0.004


@pytest.mark.parametrize("periodic", [(False,), (True, False), (False, False, False)])
def test_of_many_goals_the_nearest_is_found(periodic):
    """In an empty box, in which some goals share a cell of the grid and one is twice as far from all others."""
    dim, rng = len(periodic), np.random.default_rng(0)
    domain = Box(np.zeros(dim), np.ones(dim), periodic)
    space, goals, x = BoxSpace(domain), 0.5 * rng.random((60, dim)), rng.random((5_000, dim))
    goals[1] = goals[0] + 1e-5
    estimate = grid_estimate(space, None, goals)
    distances = np.stack([space.straight(x, goal) for goal in goals])
    step = np.linalg.norm(domain.width / estimate.cost.shape)
    np.testing.assert_allclose(estimate(x), distances.min(axis=0), atol=step)
    excess = distances[estimate.which(x), np.arange(len(x))] - distances.min(axis=0)
    assert excess.max() < 2 * step
    np.testing.assert_array_equal(estimate.which(goals), np.arange(60))


def test_which_goal_is_nearest_behind_walls_where_costs_depend_on_the_direction():
    """Each goal is alone on its side of a wall; below the wall's gap, climbing decides."""
    space = BoxSpace(Box((0, 0), (2, 1)), [(0.98, 0.0), (1.02, 0.9)])
    goals, uphill = np.array([(0.5, 0.2), (1.2, 0.5)]), np.array([0.0, 1.0])
    climbing = Climb(lambda q: np.broadcast_to(uphill, q.shape), rate=2.0, lipschitz=0.0, steepest=1.0)
    x = np.array([(0.97, 0.1), (0.97, 0.5), (1.03, 0.1), (1.9, 0.9)])
    assert grid_estimate(space, climbing, goals).which(x).tolist() == [0, 0, 1, 1]
    # Without walls: 0.6 up, or 0.8 down.
    level, goals = BoxSpace(Box((0, 0), (1, 2))), np.array([(0.5, 1.6), (0.5, 0.2)])
    assert grid_estimate(level, None, goals).which(np.array([(0.5, 1.0)])).tolist() == [0]
    assert grid_estimate(level, climbing, goals).which(np.array([(0.5, 1.0)])).tolist() == [1]


def test_walls_at_round_coordinates_lie_on_nodes_whatever_cells_an_interpolated_raster_has():
    workspace = Workspace(((0, 0), (2, 1)), [[(0.9, 0), (1, 0), (1, 0.6), (0.9, 0.6)]])
    cost = RasterCost(np.ones((100, 200)), workspace.bounds)
    found = grid_estimate(PlaneSpace(workspace), cost, (0.2, 0.2))
    x = workspace.sample_free(500, 0)
    assert mean_error(found(x), VisibilityGraph(workspace, (0.2, 0.2))(x)) < 5e-4
