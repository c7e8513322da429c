"""Free points beside walls, rounded to 32 bits, count as free in oracles, planners and paths."""

import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from shapely import box

import plr_jax as pj

TURNED = [shapely.affinity.rotate(box(x, y, x + 0.2, y + 0.3), 7 * i) for i, (x, y) in enumerate(
    [(0.1, 0.1), (0.3, 0.6), (0.6, 0.1), (0.7, 0.55)])]  # fmt: skip
WORKSPACE = pj.Workspace(((0, 0), (0.9, 1.1)), [*TURNED, [(0, 0.5), (0.2, 0.52), (0, 0.53)]])
ORACLE = pj.VisibilityGraph(WORKSPACE, (0.45, 0.5))


def points_on_walls(workspace, n):
    start, end = workspace.boundary.segments[np.arange(n) % len(workspace.boundary.edges)].transpose(1, 0, 2)
    return start + np.random.default_rng(0).random((n, 1)) * (end - start)


def test_points_rounded_into_walls_reach_the_goal():
    exact = points_on_walls(WORKSPACE, 400)
    points, distances = exact.astype(np.float32), ORACLE(exact)
    assert (~shapely.intersects_xy(WORKSPACE.free_space, *points.T.astype(float))).sum() > 100
    for answer in (ORACLE(points), ORACLE(jnp.asarray(points)), pj.NearestGoal([ORACLE])(points)):
        np.testing.assert_allclose(answer, distances, atol=1e-6)
    np.testing.assert_allclose([ORACLE(point[None])[0] for point in points[:40]], distances[:40], atol=1e-6)
    np.testing.assert_allclose(ORACLE.between(points, points[::-1]), ORACLE.between(exact, exact[::-1]), atol=1e-6)
    assert np.isfinite(pj.Roadmap.from_workspace(WORKSPACE, points[1], 300)(points)).all()
    assert pj.descend(ORACLE, WORKSPACE, points, points[1]).reached.all()
    cones = pj.construct(ORACLE, WORKSPACE.bounds, leaf="cone", max_leaves=60)
    assert pj.trace(cones, points, WORKSPACE).arrived.all()
    inside = np.array([shapely.get_coordinates(each.centroid)[0] for each in TURNED], np.float32)
    assert np.isinf(ORACLE(inside)).all()


def test_points_rounded_beside_contacts_lie_on_both_sides():
    workspace = pj.Workspace(((0, 0), (0.9, 0.9)), [box(0.1, 0.1, 0.3, 0.3), box(0.3, 0.3, 0.7, 0.7)])
    corner = np.float32([[0.3, 0.3]])
    for goal in ((0.1, 0.5), (0.5, 0.1)):
        assert pj.VisibilityGraph(workspace, goal)(corner) == pytest.approx(np.hypot(0.2, 0.2), abs=1e-6)


@pytest.mark.parametrize("robot", [pj.PointRobot(), pj.DiscRobot(0.03), pj.RectangleRobot(0.05, 0.03)])
def test_plans_of_rounded_starts_and_goals_are_valid(robot):
    workspace = pj.Workspace(((0, 0), (1, 1)), [box(0.3, 0.3, 0.7, 0.7)])
    radius = min(robot.circumscribed_radius, robot.breadth / 2)
    ends = np.array([[0.3 - radius, 0.5, np.pi / 2], [0.7 + radius, 0.6, np.pi / 2]])[:, : robot.dof]
    problem = pj.Problem(workspace, [robot], *ends[:, None].astype(np.float32))
    path = pj.bl_plan(problem).path
    assert pj.validate(problem, path).valid and pj.validate(problem, path.astype(np.float32)).valid
    exact = pj.Problem(workspace, [robot], *ends[:, None])
    path[[0, -1]] = ends[:, None]
    assert pj.validate(exact, path.astype(np.float32)).valid


def test_points_rounded_into_the_next_cell_reach_the_goal():
    free = np.ones((6, 5, 4), bool)
    free[3:, 2:, 1:] = False
    below = np.nextafter(np.array([[3.0, 3, 2]]), 0)
    rounded, goal = below.astype(np.float32), (0.5, 0.5, 0.5)
    assert np.isfinite(pj.VoxelGraph(free, goal)(rounded))
    flat, plane = pj.GridGraph(free[:, :, 2].T, (0.5, 0.5)), rounded[:, :2]
    assert np.isfinite(flat(plane)) and flat.with_goal(plane[0])(plane) == 0
    field = pj.GridField(np.where(free[:, :, 2].T, 1.0, np.inf), ((0, 0), (6, 5)))
    assert np.isfinite(field(plane))
    costs = pj.cost_distance(np.where(free[:, :, 2].T, 1.0, np.inf), plane)
    assert costs.distance[0, 0] > 0


@pytest.mark.full
def test_spaces_take_rounded_starts_and_goals():
    space, corner = pj.PlaneSpace(pj.Workspace(((0, 0), (6, 5)), [box(3.1, 2.1, 6, 5)])), np.float32([3.1, 2.1])
    plr = pj.solve_eikonal(space, corner, certified=False, max_leaves=200)
    assert pj.descend(plr, space, corner[None], corner).reached.all()
