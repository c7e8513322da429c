"""Estimates on grids, compared with known costs-to-go."""

import numpy as np
import pytest
from eikonal_helpers import ROOM, BoxSpace, use_few_nodes
from scipy import ndimage
from space_helpers import Climb, Slow, rectangle

from plr_jax import DiscRobot, PlaneSpace, RasterCost, VisibilityGraph, VoxelSpace, Workspace
from plr_jax.eikonal import estimate as estimates
from plr_jax.geometry.box import Box
from plr_jax.spaces import LipschitzCost


def grid_estimate(space, cost_map, goal, num_leaves=0):
    return estimates.grid_estimate(space, cost_map, np.atleast_2d(goal), num_leaves)


def room(*walls, size=(1, 1)):
    return Workspace(((0, 0), size), [rectangle(*wall) for wall in walls])


def samples(domain, num=500):
    return domain.lo + domain.width * np.random.default_rng(0).random((num, domain.dim))


def mean_error(found, truth):
    return np.abs(found - truth).mean() / truth.mean()


# Shortest paths over a stencil, whose edges in the plane are one to three steps long along each axis.
TINY_BODY = Box((1e6, 1e6, 0), (1e6 + 1e-3, 1e6 + 2e-3, 6), periodic=(False, False, True))


@pytest.mark.parametrize(
    ("domain", "blocks", "worst"),
    [
        (Box([0], [3]), None, 1e-6),
        (Box((0, -1), (2, 0), periodic=(False, True)), None, 3e-3),
        (TINY_BODY, (((0, 1), 1.0), ((2,), 1e-4)), 0.03),
    ],
)
def test_estimate_in_empty_boxes_is_the_straight_cost(domain, blocks, worst, monkeypatch):
    use_few_nodes(monkeypatch)
    space, goal, q = BoxSpace(domain, blocks=blocks), domain.lo + 0.37 * domain.width, samples(domain)
    found, truth = grid_estimate(space, None, goal)(q), space.straight(q, goal)
    np.testing.assert_allclose(found, truth, rtol=3 * worst, atol=0.02 * truth.mean())
    assert mean_error(found, truth) < worst


def test_estimate_is_closer_on_finer_grids(monkeypatch):
    """The speed is linear, so that fastest paths are arcs."""
    space, goal, rise = BoxSpace(Box((0, 0), (1, 2))), np.array([0.3, 0.6]), 3.0
    speed = lambda q: 0.5 + rise * q[:, 1]  # noqa: E731
    cost = LipschitzCost(lambda q: 1 / speed(q), rise / 0.25, 1 / 6.5)
    q = samples(Box((0, 0.1), (1, 1)))  # whose arcs stay inside
    square = np.sum((q - goal) ** 2, axis=1)
    truth = np.arccosh(1 + rise**2 * square / (2 * speed(q) * speed(goal[None]))) / rise
    fine = mean_error(grid_estimate(space, cost, goal)(q), truth)
    use_few_nodes(monkeypatch)
    coarse, by_leaves = (mean_error(grid_estimate(space, cost, goal, leaves)(q), truth) for leaves in (0, 4_000))
    assert fine < 1e-4 and fine < by_leaves / 1.5 < coarse / 2


def test_walls_between_nodes_block_paths():
    q = ROOM.sample_free(500, 0)
    truth = VisibilityGraph(ROOM, (0.3, 0.4))(q)
    assert mean_error(grid_estimate(PlaneSpace(ROOM), None, np.array([0.3, 0.4]))(q), truth) < 1e-3
    space = BoxSpace(Box((0, 0), (1, 1)), ((0.5011, -1), (0.5012, 2)))
    q = np.array([(0.2, 0.7), (0.8, 0.7)])
    assert np.isfinite(grid_estimate(space, None, np.array([0.1, 0.1]))(q)).tolist() == [True, False]


def test_costs_behind_corners_on_nodes_are_extrapolated():
    """The goal lies between nodes. Without extrapolation the error is 1.4e-4."""
    workspace, goal = room((0.4, 0.0, 0.5, 0.6)), np.array([0.2011, 0.2003])
    q = workspace.sample_free(500, 0)
    estimate = grid_estimate(PlaneSpace(workspace), None, goal)
    assert mean_error(estimate(q), VisibilityGraph(workspace, goal)(q)) < 5e-5


@pytest.mark.parametrize(("angle", "size"), [(0.2, 8), (np.pi / 4, 401)])
def test_no_path_passes_between_touching_obstacles(angle, size, monkeypatch):
    """Two triangles or squares that touch in the middle of the map split it."""
    use_few_nodes(monkeypatch)
    turn, middle = np.array([(np.cos(angle), -np.sin(angle)), (np.sin(angle), np.cos(angle))]), np.full(2, size / 2)
    rays = 4 * size * np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) @ turn.T
    goal, beyond = (middle + sign * turn @ (0.2 * size, -0.2 * size) for sign in (-1, 1))
    closed, passable = (
        Workspace(((0, 0), (size, size)), [middle - rays, middle + rays], squeeze=squeeze)
        for squeeze in (False, True)
    )
    estimate = grid_estimate(PlaneSpace(closed), None, goal)
    assert estimate(np.stack([goal, beyond])).tolist() == [0.0, np.inf]
    squeezed = grid_estimate(PlaneSpace(passable), None, goal)(beyond[None])
    assert squeezed == pytest.approx(VisibilityGraph(passable, goal)(beyond[None]), rel=0.03)


@pytest.mark.parametrize("dim", [2, 3])
def test_no_path_passes_between_touching_voxels(dim, monkeypatch):
    use_few_nodes(monkeypatch)
    free = np.zeros((2,) * dim, bool)
    free[(0,) * dim] = free[(1,) * dim] = True
    estimate = grid_estimate(VoxelSpace(free.repeat(4, 0).repeat(4, 1)), None, np.full(dim, 0.4))
    assert estimate(estimate.space.domain.hi[None] - 0.1).tolist() == [np.inf]


def test_path_leads_through_hole_between_oblong_voxels(monkeypatch):
    use_few_nodes(monkeypatch)
    free = np.ones((40, 30, 6), bool)
    free[20] = False
    free[20, 15, 3] = True
    estimate = grid_estimate(VoxelSpace(free, ((0, 0, 0), (4, 30, 1.2))), None, np.array([0.5, 15.5, 0.7]))
    found = estimate(np.array([(3.5, 15.5, 0.7), (1.5, 15.5, 0.7), (0.5, 17.5, 0.7)]))
    np.testing.assert_allclose(found, [3, 1, 2], rtol=0.03)


@pytest.mark.parametrize(("dim", "share"), [(2, 0.65), (3, 0.4), (3, 0.7)])
def test_groups_of_voxels_reach_what_voxels_reach(dim, share, monkeypatch):
    """Sealed and open rooms beside noise, in which tunnels are one voxel wide."""
    monkeypatch.setattr(estimates, "_MOST_GROUPS", 4_000 if dim > 2 else 400)
    rng, shape = np.random.default_rng(0), (58, 43, 31)[:dim]
    free = rng.random(shape) < share
    free[:20] = free[24:44] = True
    free[:, 20] = free[34] = False
    free[10, 20] = True
    part, _ = ndimage.label(free)
    reached = part == part[(5,) * dim]
    assert reached[28].any() and not reached[38].any()
    estimate = grid_estimate(VoxelSpace(free), None, np.full(dim, 5.2))
    assert estimate.cost.shape == tuple(-(-n // 3) for n in shape)
    voxel = np.argwhere(free)
    found, is_reached = estimate(voxel + rng.random(voxel.shape)), reached[free]
    assert np.isfinite(found[is_reached]).all()
    assert np.isinf(found[~ndimage.binary_dilation(reached, np.ones((5,) * dim))[free]]).all()  # beyond a group


def test_groups_of_voxels_keep_walls_and_doors(monkeypatch):
    """Two rooms with a wall one voxel thick, at each of the places where it may lie in groups of 3 x 3 x 3 voxels."""
    monkeypatch.setattr(estimates, "_MOST_GROUPS", 3_000)
    goal, x = np.array([9.5, 20.5, 20.5]), np.array([(30.5, 20.5, 20.5), (30.5, 4.5, 4.5)])
    empty = grid_estimate(VoxelSpace(np.ones((41, 40, 40), bool)), None, goal)
    np.testing.assert_allclose(empty(x), np.linalg.norm(x - goal, axis=1), rtol=0.01)
    for wall in (18, 19, 20):
        free = np.ones((41, 40, 40), bool)
        free[wall] = False
        assert np.isinf(grid_estimate(VoxelSpace(free), None, goal)(x)).all()
        free[wall, 20, 20] = True  # straight ahead
        straight = np.linalg.norm(x - (wall + 0.5, 20.5, 20.5), axis=1) + wall - 9
        ratio = grid_estimate(VoxelSpace(free), None, goal)(x) / straight
        assert (ratio > 0.97).all() and (ratio < 1.2).all()


def test_discs_pass_gaps_as_wide_as_they_are(monkeypatch):
    use_few_nodes(monkeypatch)
    for width, reaches in ((0.401, True), (0.399, False)):
        workspace = room((0, 1.9, 2, 2.1), (2 + width, 1.9, 4, 2.1), size=(4, 4))
        estimate = grid_estimate(PlaneSpace(workspace, DiscRobot(0.2)), None, np.array([1.0, 1.0]))
        assert np.isfinite(estimate(np.array([(1.0, 3.0)]))).tolist() == [reaches]


@pytest.mark.parametrize("interpolation", ["bilinear", "nearest"])
def test_paths_follow_cheap_lines_one_cell_wide(interpolation, monkeypatch):
    use_few_nodes(monkeypatch)
    values = np.full((7, 20), 50.0)
    values[1] = 1.0
    road = RasterCost(values, ((0, 0), (20, 7)), interpolation)
    found = grid_estimate(road.space(), road, np.array([19.5, 1.5]))(np.array([(0.5, 1.5), (10.5, 1.5)]))
    np.testing.assert_allclose(found, [19, 9], rtol=1e-6)
    if interpolation == "nearest":  # also if the raster does not fill the domain
        space = PlaneSpace(Workspace(((-1, -1), (21, 8))))
        found = grid_estimate(space, road, np.array([19.5, 1.5]))(np.array([(0.5, 1.5)]))
        assert found == pytest.approx([19], rel=0.01)


@pytest.mark.parametrize("ratio", [1.3, 255.0])
def test_paths_avoid_expensive_cells(ratio, monkeypatch):
    use_few_nodes(monkeypatch)
    values = np.ones((5, 5))
    values[2, 2] = ratio
    tower = RasterCost(values, ((0, 0), (5, 5)), "nearest")
    found = grid_estimate(tower.space(), tower, np.array([0.5, 2.5]))(np.array([(4.5, 2.5)]))
    # Straight through, or around by two corners of the expensive cell.
    assert found == pytest.approx(min(3 + ratio, 1 + 2 * np.hypot(1.5, 0.5)), rel=0.03)


def test_steady_climbs_cost_their_height(monkeypatch):
    use_few_nodes(monkeypatch)
    space, goal, uphill = BoxSpace(Box((0, 0), (1, 1))), np.array([0.4, 0.3]), np.array([0.6, -0.3])
    climbing = Climb(lambda q: np.broadcast_to(uphill, q.shape), rate=2.0, lipschitz=0.0, steepest=0.7)
    q = samples(space.domain)
    truth = np.linalg.norm(goal - q, axis=1) + 2 * np.maximum((goal - q) @ uphill, 0)
    assert mean_error(grid_estimate(space, climbing, goal)(q), truth) < 0.015


@pytest.mark.parametrize(("jump", "goal_x", "error"), [(20.0, 0.25, 0.01), (0.7, 0.95, 0.004)])
def test_paths_refract_where_costs_jump(jump, goal_x, error):
    """Beyond a border at x = 1: Snell's law gives the truth, from many crossings of the border."""
    space, goal = PlaneSpace(room(size=(2, 1))), np.array([goal_x, 0.5])
    q = samples(space.domain, 300)
    border = np.linspace(0, 1, 1_001)
    beyond = np.maximum(q[:, :1] - 1, 0)
    crossing = np.hypot(1 - goal_x, border - 0.5) + jump * np.hypot(beyond, border - q[:, 1:])
    straight = np.linalg.norm(q - goal, axis=1)
    truth = np.where(q[:, 0] > 1, crossing.min(axis=1), straight)
    found = grid_estimate(space, Slow((1, -1), (9, 9), jump), goal)(q)
    some = (q[:, 0] > 1) | (jump > 1)  # behind a cheap border, paths on the goal's side may run along it
    assert (found > 0.998 * min(jump, 1) * straight).all()
    assert mean_error(found[some], truth[some]) < error


@pytest.mark.parametrize("periodic", [(False,), (True, False), (False, False, False)])
def test_nearest_of_many_goals_is_found(periodic, monkeypatch):
    """In an empty box, in which two goals share a cell of the grid."""
    use_few_nodes(monkeypatch)
    dim, rng = len(periodic), np.random.default_rng(0)
    domain = Box(np.zeros(dim), np.ones(dim), periodic)
    space, goals, x = BoxSpace(domain), 0.5 * rng.random((60, dim)), rng.random((1_000, dim))
    goals[1] = goals[0] + 1e-5
    estimate = grid_estimate(space, None, goals)
    distances = np.stack([space.straight(x, goal) for goal in goals])
    step = np.linalg.norm(domain.width / estimate.cost.shape)
    np.testing.assert_allclose(estimate(x), distances.min(axis=0), atol=step)
    excess = distances[estimate.which(x), np.arange(len(x))] - distances.min(axis=0)
    assert excess.max() < 2 * step
    np.testing.assert_array_equal(estimate.which(goals), np.arange(60))


def test_nearest_goal_depends_on_walls_and_climbs(monkeypatch):
    """Each goal is alone on its side of a wall."""
    use_few_nodes(monkeypatch, 4_000)
    space = BoxSpace(Box((0, 0), (2, 1)), [(0.98, 0.0), (1.02, 0.9)])
    goals, uphill = np.array([(0.5, 0.2), (1.2, 0.5)]), np.array([0.0, 1.0])
    climbing = Climb(lambda q: np.broadcast_to(uphill, q.shape), rate=2.0, lipschitz=0.0, steepest=1.0)
    x = np.array([(0.97, 0.1), (0.97, 0.5), (1.03, 0.1), (1.9, 0.9)])
    assert grid_estimate(space, climbing, goals).which(x).tolist() == [0, 0, 1, 1]
    # Without walls: 0.6 up, or 0.8 down.
    level, goals = BoxSpace(Box((0, 0), (1, 2))), np.array([(0.5, 1.6), (0.5, 0.2)])
    assert grid_estimate(level, None, goals).which(np.array([(0.5, 1.0)])).tolist() == [0]
    assert grid_estimate(level, climbing, goals).which(np.array([(0.5, 1.0)])).tolist() == [1]


def test_walls_at_round_coordinates_lie_on_nodes_despite_rasters(monkeypatch):
    use_few_nodes(monkeypatch, 40_000)
    workspace = room((0.9, 0, 1, 0.6), size=(2, 1))
    cost = RasterCost(np.ones((100, 200)), workspace.bounds)
    found = grid_estimate(PlaneSpace(workspace), cost, (0.2, 0.2))
    x = workspace.sample_free(500, 0)
    assert mean_error(found(x), VisibilityGraph(workspace, (0.2, 0.2))(x)) < 1e-3
