"""Clearance in JAX against Shapely, and against motions sampled densely."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from robot_helpers import along, pebble, shapes, sled

from plr_jax import DiscRobot, PointRobot, PolygonRobot, RectangleRobot, Workspace, scenes
from plr_jax.optimize.trajectory.clearance import (
    convex_clearances,
    corner_clearance,
    outlines_of,
    padded_boundary,
    point_clearance,
    round_clearances,
)
from plr_jax.optimize.trajectory.scaled_problem import jit_iterations

# Compiled whole: operation by operation, they take longer to compile than to run.
point_clearance, corner_clearance, round_clearances, convex_clearances = map(
    jax.jit, (point_clearance, corner_clearance, round_clearances, convex_clearances)
)
BOX = Workspace(((0, 0), (10, 10)), [[(4, 3), (6, 3), (6, 7), (4, 7)]])
ORIGIN = np.zeros(2)


def of_scale(workspace, scale=10.0):
    return padded_boundary(workspace, workspace.bounds.lo, scale)


@pytest.mark.parametrize("workspace", [BOX, scenes.maze().workspace, scenes.four_rooms(4).workspace])
def test_points_are_as_far_from_walls_as_shapely_says(workspace):
    rng, lo, width = np.random.default_rng(0), workspace.bounds.lo, workspace.bounds.width
    x = lo + width * rng.uniform(-0.05, 1.05, (500, 2))
    scale = float(width.max())
    walls = padded_boundary(workspace, lo, scale)
    found = scale * np.asarray(point_clearance(walls, jnp.asarray((x - lo) / scale, jnp.float32)))
    np.testing.assert_allclose(found, workspace.clearance(x), atol=1e-5 * scale)


@pytest.mark.parametrize(
    "a, b, expected",
    [
        ((3.0, 2.0), (5.0, 2.0), 1.0),  # below the corner (4, 3)
        ((3.0, 4.0), (3.0, 2.0), 1.0),  # beside it
        ((2.9, 3.1), (4.1, 1.9), np.sqrt(0.5)),  # past it
        ((3.5, 3.7), (4.7, 2.5), -0.1 * np.sqrt(2)),  # through it
    ],
)
def test_a_segment_past_a_corner(a, b, expected):
    walls = of_scale(BOX)
    found = 10 * corner_clearance(walls.corners, *(jnp.asarray(x, jnp.float32) / 10 for x in (a, b)))
    assert float(found) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("exponent", range(-40, 0, 2))
def test_a_body_that_all_but_rests_has_a_gradient(exponent):
    """Rounding near the origin leaves motions so short that the square of their length is no 32-bit number."""
    corners, a = of_scale(BOX).corners, jnp.zeros(2)
    b = jnp.array([10.0**exponent, 0.0])
    gradient = jax.grad(lambda ab: corner_clearance(corners, *ab))((a, b))
    assert np.isfinite(gradient).all()


@given(st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_round_robots_in_motion_are_as_clear_as_dense_samples(seed):
    rng = np.random.default_rng(seed)
    robots = [DiscRobot(0.4), DiscRobot(0.7), PointRobot()]
    q0 = rng.uniform(0, 10, (3, 2))
    q1 = np.clip(q0 + rng.normal(0, 1.0, (3, 2)), 0, 10)
    q0, q1 = q0.astype(np.float32).astype(np.float64), q1.astype(np.float32).astype(np.float64)
    outlines, walls = outlines_of(robots, 1.0), padded_boundary(BOX, ORIGIN, 1.0)
    start, corner, pair = round_clearances(
        walls, outlines, jnp.asarray(q0, jnp.float32), jnp.asarray(q1, jnp.float32)
    )
    end, _, _ = round_clearances(walls, outlines, jnp.asarray(q1, jnp.float32), jnp.asarray(q0, jnp.float32))
    t = np.linspace(0, 1, 401)[:, None, None]
    q = q0 + t * (q1 - q0)
    for i, robot in enumerate(robots):
        distance = BOX.clearance(q[:, i]).min() - robot.rounding
        if BOX.is_visible(q0[i : i + 1], q1[i : i + 1])[0]:
            assert min(start[i], end[i], corner[i]) == pytest.approx(distance, abs=5e-3)
    expected = [
        np.linalg.norm(q[:, i] - q[:, j], axis=1).min() - robots[i].rounding - robots[j].rounding
        for i, j in ((0, 1), (0, 2), (1, 2))
    ]
    np.testing.assert_allclose(pair, expected, atol=5e-3)


TEAMS = {
    "boxes": [RectangleRobot(1.8, 0.5), RectangleRobot(1.0, 0.7), DiscRobot(0.4)],
    "any shapes": [PolygonRobot([(1.2, 0), (0.3, 0.7), (-0.6, 0.5), (-0.4, -0.5)]), pebble(1.0), DiscRobot(0.4)],
    "no headings": [sled(2.0), PointRobot(), sled(3.0)],
}


@pytest.mark.parametrize("robots", TEAMS.values(), ids=TEAMS)
@given(seed=st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_bodies_at_rest_are_as_clear_as_shapely_says(robots, seed):
    rng = np.random.default_rng(seed)
    q = np.column_stack([rng.uniform(1, 9, (3, 2)), rng.uniform(-7, 7, 3)]).astype(np.float32)
    at = jnp.asarray(q[:, : max(robot.dof for robot in robots)])
    *to_walls, first, second = convex_clearances(padded_boundary(BOX, ORIGIN, 1.0), outlines_of(robots, 1.0), at, at)
    bodies = [shapes(robot, q[i : i + 1].astype(np.float64))[0] for i, robot in enumerate(robots)]
    region = shapely.union_all([*BOX.obstacles, shapely.box(-9, -9, 19, 19).difference(shapely.box(0, 0, 10, 10))])
    walls = np.min([np.asarray(part).min(axis=1) for part in to_walls], axis=0)
    pairs = np.minimum(first, second).min(axis=1)
    for found, expected in [
        *((walls[i], shapely.distance(bodies[i], region) - robots[i].rounding) for i in range(3)),
        *(
            (pairs[k], shapely.distance(bodies[i], bodies[j]) - robots[i].rounding - robots[j].rounding)
            for k, (i, j) in enumerate(((0, 1), (0, 2), (1, 2)))
        ),
    ]:
        if expected > 0.01:
            assert found == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("robots", TEAMS.values(), ids=TEAMS)
def test_a_point_within_a_body_is_as_deep_as_its_nearest_side(robots):
    """Of the corners of an obstacle in the frame of a robot."""
    corner = np.array([4.0, 3.0])
    for robot in robots:
        if len(robot.core) > 1:
            inside = robot.core.mean(axis=0)
            at = jnp.asarray([[*(corner - inside), 0.0]], jnp.float32)
            seen = convex_clearances(padded_boundary(BOX, ORIGIN, 1.0), outlines_of([robot], 1.0), at, at)[2]
            depth = shapely.distance(shapely.Point(inside), shapely.Polygon(robot.core).exterior)
            assert float(seen.min()) == pytest.approx(-depth - robot.rounding, abs=1e-5)


def test_a_rectangle_that_cuts_a_corner_between_two_free_poses_is_seen():
    robot = RectangleRobot(1.0, 0.4)
    q0, q1 = np.array([[3.4, 3.0, 0.0]]), np.array([[3.8, 2.7, 0.0]])  # its corner goes from (3.9, 3.2) to (4.3, 2.9)
    swept = shapes(robot, along(q0, q1, 201))
    assert (
        shapely.distance(swept[[0, -1]], BOX.obstacles[0]).min() > 0.05
        and shapely.distance(swept, BOX.obstacles[0]).min() == 0
    )
    clearances = convex_clearances(
        padded_boundary(BOX, ORIGIN, 1.0), outlines_of([robot], 1.0), *(jnp.asarray(q, jnp.float32) for q in (q0, q1))
    )
    assert min(float(part.min()) for part in clearances[:3]) < -0.05


def test_gradients_are_finite_where_robots_coincide_and_on_walls():
    walls = of_scale(BOX)
    for robots in ([DiscRobot(4.0)] * 2, [RectangleRobot(4.0, 1.0)] * 2):
        bodies, dof = outlines_of(robots, 10.0), 2 + isinstance(robots[0], RectangleRobot)
        q = jnp.zeros((2, dof)).at[:, :2].set(0.4)
        kernel = round_clearances if dof == 2 else convex_clearances

        def total(q, kernel=kernel, bodies=bodies):
            return sum(jnp.where(jnp.isfinite(part), part, 0.0).sum() for part in kernel(walls, bodies, q, q))

        assert np.isfinite(jit_iterations(jax.grad(total))(q)).all()
