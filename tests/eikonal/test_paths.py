import itertools

import numpy as np
import pytest
from eikonal_helpers import EMPTY, BoxSpace
from space_helpers import BOUNDS, random_workspace, rectangle

from plr_jax import PlaneSpace, PointRobot, Problem, VisibilityGraph, Workspace, validate
from plr_jax.eikonal.mesh import coarse_mesh
from plr_jax.eikonal.paths import NodePaths, shortest_paths
from plr_jax.eikonal.program import cell_costs
from plr_jax.geometry.box import Box
from plr_jax.spaces import LipschitzCost

SLOPED = LipschitzCost(lambda q: 1 + q[:, 0] / 2 + q[:, 1] / 4, 0.6, 1.0)
BLOCK = Workspace(BOUNDS, [rectangle(1, 1, 2, 2)])


def paths_of(space, goal, *, cost_map=None, num_cells=200, rounds=2):
    """Return paths on a mesh whose mixed cells are halved, and the positions of their nodes."""
    mesh = coarse_mesh(space, num_cells, 4096)
    for _ in range(rounds):
        mesh = mesh.refined(np.flatnonzero(mesh.state == 2), space)
    fraction = (np.array(goal) - space.domain.lo) / space.domain.width
    paths = shortest_paths(mesh, cell_costs(space, cost_map, mesh), fraction[None], space)
    keep = np.append(np.unique(mesh.corners[mesh.state == 1]), len(mesh.nodes))
    place = np.full(len(mesh.nodes) + 1, len(keep) - 1)
    place[keep] = np.arange(len(keep))
    paths = NodePaths(paths.points[keep], paths.cost[keep], place[paths.next[keep]], place[paths.ends[keep]])
    return paths, space.domain.lo + paths.points * space.domain.width


def paths_above(workspace, goal, **options):
    """Check that legs of paths are free and no path is shorter than the distance; return both."""
    paths, x = paths_of(PlaneSpace(workspace), goal, **options)
    distance = VisibilityGraph(workspace, goal)(x)
    assert (paths.cost >= distance - 1e-9).all()
    legs = np.flatnonzero(np.isfinite(paths.cost))
    assert workspace.is_visible(x[legs], x[paths.next[legs]]).all()
    return paths, x, distance


def followed(paths, x, node):
    """Return the points of a path, the goal last."""
    nodes, goal = [node], len(x) - 1
    while nodes[-1] != goal:
        nodes.append(int(paths.next[nodes[-1]]))
        assert len(nodes) <= len(x)
    return x[nodes]


def integral(a, b, num=2000):
    """Integrate the sloped factor along a segment, by the midpoint rule."""
    share = (np.arange(num) + 0.5) / num
    return np.mean(SLOPED(a + share[:, None] * (b - a))) * np.linalg.norm(b - a)


@pytest.mark.parametrize("seed", range(2))
def test_costs_are_lengths_of_free_paths(seed):
    workspace = random_workspace(seed)
    goal = workspace.sample_free(1, seed)[0]
    paths, x, distance = paths_above(workspace, goal)
    np.testing.assert_allclose(x[-1], goal, atol=1e-12)
    assert paths.cost[-1] == 0
    known = np.flatnonzero(np.isfinite(paths.cost) & (distance > 0))
    assert len(known) > 100 and np.mean(paths.cost[known] / distance[known]) < 1.03
    for node in np.random.default_rng(seed).choice(known, 30):
        path = followed(paths, x, int(node))
        length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
        assert length <= paths.cost[node] <= (1 + 1e-9) * length
        assert validate(Problem(workspace, [PointRobot()], [x[node]], [goal]), path[:, None]).valid


def test_paths_in_empty_rooms_are_straight():
    for goal in ((0.3, 0.7), (0.5, 0.5), (0.0, 1.0)):
        paths, x = paths_of(EMPTY, goal)
        np.testing.assert_allclose(paths.cost, np.linalg.norm(x - goal, axis=1), rtol=1e-5, atol=1e-12)


def test_costs_integrate_the_cost_map_along_paths():
    for goal in ((3.3, 2.2), (1.0, 1.3)):  # the second beside a wall
        paths, x = paths_of(PlaneSpace(BLOCK), goal, cost_map=SLOPED)
        last = np.flatnonzero((paths.next == len(x) - 1) & np.isfinite(paths.cost))[:-1]
        nodes = np.random.default_rng(0).integers(len(x) - 1, size=40)
        for node in (*nodes[np.isfinite(paths.cost[nodes])], *last):
            cost = sum(itertools.starmap(integral, itertools.pairwise(followed(paths, x, int(node)))))
            assert cost <= paths.cost[node] <= 1.15 * cost
    assert len(last) > 20


@pytest.mark.parametrize("squeeze", [False, True])
def test_paths_do_not_pass_between_touching_obstacles(squeeze):
    workspace = Workspace(BOUNDS, [rectangle(1, 1.5, 2, 2.25), rectangle(2, 0.75, 3, 1.5)], squeeze=squeeze)
    paths, x, _ = paths_above(workspace, (1.9, 1.4), num_cells=256)
    beyond = np.flatnonzero(np.all((x > (2, 1.5)) & (x < (2.3, 1.8)), axis=1))
    assert np.isfinite(paths.cost[beyond]).all() and len(beyond)
    assert (paths.cost[beyond] > 1).all() != squeeze


@pytest.mark.parametrize("goal", [(1.0, 1.5), (1.0, 1.0), (1.0, 0.9999), (4.0, 1.3)])
def test_paths_lead_to_goals_beside_walls(goal):
    paths, _, distance = paths_above(BLOCK, goal)
    assert np.isfinite(paths.cost).all() and np.mean(paths.cost - distance) < 0.03 * distance.mean()


def test_paths_go_around_periodic_axes():
    space, goal = BoxSpace(Box((0, 0), (4, 2), (True, False)), [(1.0, 0.0), (1.3, 2.0)]), np.array([0.2, 1.3])
    paths, x = paths_of(space, goal)
    right = np.where(x[:, 0] > 1.1, x[:, 0] - 4, x[:, 0])
    expected = np.hypot(right - goal[0], x[:, 1] - goal[1])
    assert (paths.cost >= expected - 1e-9).all()
    np.testing.assert_allclose(paths.cost, expected, rtol=1e-2, atol=1e-9)


@pytest.mark.parametrize("goal", [(0.2, 0.3, 0.4), (0.0, 0.5, 1.0)])
def test_paths_in_space_are_free_and_costs_add_up(goal):
    domain, blocks = Box(np.zeros(3), np.ones(3), (False, False, True)), (((0, 1), 1.0), ((2,), 0.5))
    space = BoxSpace(domain, [(0.3, 0.0, 0.2), (0.6, 0.7, 0.8)], blocks=blocks)
    paths, x = paths_of(space, goal, num_cells=512, rounds=1)
    assert np.isfinite(paths.cost).all() and space.are_free(x, x[paths.next]).all()
    leg = space.straight(x, x[paths.next])
    np.testing.assert_allclose(paths.cost, leg + paths.cost[paths.next], rtol=1e-9, atol=1e-12)
    assert (paths.cost >= space.straight(x, goal) - 1e-12).all()


def test_paths_without_free_cells_hold_the_goal_only():
    paths, x = paths_of(PlaneSpace(BLOCK), (0.5, 0.5), num_cells=1, rounds=0)
    assert paths.cost.tolist() == [0] and len(x) == 1


def test_batches_of_edges_do_not_change_costs(monkeypatch):
    space = BoxSpace(Box([0.0] * 4, [1.0] * 4))
    mesh = coarse_mesh(space, 64, 64)
    arguments = mesh, cell_costs(space, None, mesh), np.full((1, 4), 0.3), space
    expected = shortest_paths(*arguments).cost
    monkeypatch.setattr("plr_jax.eikonal.paths._EDGES_AT_ONCE", 1 << 9)
    np.testing.assert_array_equal(shortest_paths(*arguments).cost, expected)
    np.testing.assert_allclose(expected[:-1], np.linalg.norm(mesh.nodes - 0.3, axis=1), rtol=0.2, atol=0.1)
