"""Distances among polygons whose vertices are traced, compared with the visibility graph of the same map."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from plr_jax import Box, VisibilityGraph, Workspace, polygon_distance
from plr_jax.traced import polygons_of_discs

MAPS, STARS, SHAPE, POINTS = 24, 12, (6, 6, 2), 40
BOUNDS = np.array([(-0.5, -0.5), (1.5, 1.5)], np.float32)
BOX = np.array([(0, 0), (2, 0), (2, 1), (0, 1)], np.float32)


def star(rng, k):
    """Return a polygon of ``k`` vertices around a point, convex or not."""
    angle = (np.arange(k) + 0.8 * rng.random(k)) / k * 2 * np.pi
    return rng.random(2) + rng.uniform(0.1, 0.4, (k, 1)) * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def boxes(rng, k):
    """Return a rectangle on a grid, which shares sides and corners with others, and repeats its last vertex."""
    (x0, y0), (x1, y1) = (corner := rng.integers(0, 7, 2) / 8), corner + rng.integers(1, 4, 2) / 8
    return np.array([(x0, y0), (x1, y0), (x1, y1)] + [(x0, y1)] * (k - 3))


def padded(rng, polygon, k):
    """Add NaN rows to a polygon, turn it and let it start anywhere: neither changes a distance."""
    rows = np.concatenate([polygon, np.full((k - len(polygon), 2), np.nan)])
    return np.roll(rows[:: rng.choice([-1, 1])], rng.integers(k), axis=0)


def rings(polygons):
    """Return polygons as a Workspace takes them, without NaN and repeated vertices, and the indices of vertices."""

    def distinct(polygon):
        at = np.flatnonzero(~np.isnan(polygon).any(axis=1))
        return at[(polygon[at] != np.roll(polygon[at], 1, axis=0)).any(axis=1)]

    index = [distinct(polygon) for polygon in polygons]
    return [polygon[at].astype(float) for polygon, at in zip(polygons, index, strict=True)], index


@cache
def maps():
    """Return polygons, of which the first ``STARS`` maps overlap and the others touch, two goals each, and points."""
    rng = np.random.default_rng(0)
    polygons = np.full((MAPS, *SHAPE), np.nan)
    for number, each in enumerate(polygons):
        for place in range(SHAPE[0]):
            shape = (star if number < STARS else boxes)(rng, int(rng.integers(4, SHAPE[1] + 1)))
            each[place] = padded(rng, shape, SHAPE[1])
    polygons = polygons.astype(np.float32)
    spaces = [Workspace(BOUNDS, rings(each)[0]) for each in polygons]
    goals = np.stack([space.sample_free(2, seed=1) for space in spaces]).astype(np.float32)
    return polygons, goals, rng.uniform(*BOUNDS, (MAPS, POINTS, 2)).astype(np.float32), spaces


@cache
def answers(of_pairs=False):
    """Return, for all maps, distances to the first goal or between points and this goal, and gradients of their sums.

    Gradients are by polygons, goal and points. The last result are distances to the nearer of both goals.
    """

    def of_map(polygons, goals, x):
        def total(polygons, goal, x):
            if of_pairs:
                distance = polygon_distance(polygons, None, bounds=BOUNDS)(x, goal)
            else:
                distance = polygon_distance(polygons, goal, bounds=BOUNDS)(x)
            return jnp.where(jnp.isfinite(distance), distance, 0).sum(), distance

        (_, distance), gradients = jax.value_and_grad(total, (0, 1, 2), has_aux=True)(polygons, goals[0], x)
        return distance, gradients, distance if of_pairs else polygon_distance(polygons, goals, bounds=BOUNDS)(x)

    return jax.tree.map(np.asarray, jax.jit(jax.vmap(of_map))(*maps()[:3]))


@cache
def oracles():
    goals, spaces = maps()[1].astype(float), maps()[3]
    first = [VisibilityGraph(space, goal) for space, (goal, _) in zip(spaces, goals, strict=True)]
    return first, [oracle.with_goal(goal) for oracle, (_, goal) in zip(first, goals, strict=True)]


def test_distances_equal_the_visibility_graph():
    x = maps()[2]
    first, second = (np.stack([o(p) for o, p in zip(each, x, strict=True)]) for each in oracles())
    to_first, _, to_nearer = answers()
    assert 0.05 < np.isinf(first).mean() < 0.6
    assert_allclose(to_first, first, atol=1e-5)
    assert_allclose(to_nearer, np.minimum(first, second), atol=1e-5)


@pytest.mark.parametrize("of_pairs", [False, pytest.param(True, marks=pytest.mark.full)])
def test_gradients_equal_those_of_the_visibility_graph(of_pairs):
    polygons, _, x, _ = maps()
    distances, (by_polygons, by_goal, by_points), _ = answers(of_pairs)
    for number in range(STARS):
        oracle = oracles()[0][number]
        assert_allclose(distances[number], oracle(x[number]), atol=1e-5)
        matrix = oracle.vertex_gradient(x[number].astype(float))
        total = np.asarray(matrix.sum(axis=0)).reshape(-1, 2)
        expected = np.zeros(SHAPE)
        order = np.concatenate([at + place * SHAPE[1] for place, at in enumerate(rings(polygons[number])[1])])
        expected.reshape(-1, 2)[order] = total[:-1]
        assert_allclose(by_polygons[number], expected, atol=1e-4)
        assert_allclose(by_goal[number], total[-1], atol=1e-4)
        directions = np.nan_to_num(oracle.directions(x[number].astype(float)))
        assert_allclose(by_points[number], -directions, atol=1e-4)


SQRT2 = np.sqrt(2)
# Points around the box from (0, 0) to (2, 1), and their distances to (1, -1). The first path passes on the left.
AROUND = {
    (0.9, 2): np.hypot(0.9, 1) + 1 + SQRT2,
    (0, 0): SQRT2,
    (1, 0): 1,  # on a wall
    (1, 1): 2 + SQRT2,
    (1, -1): 0,
    (1, 0.5): np.inf,
    (np.inf, 0): np.inf,
    (0, 1e18): np.inf,
    (np.nan, 0): np.nan,
}
POINTS_AROUND, DISTANCES_AROUND = np.array(list(AROUND), np.float32), np.array(list(AROUND.values()))
BELOW = np.array([1, -1], np.float32)


def around(polygon=BOX, goal=BELOW, bounds=None):
    return np.asarray(polygon_distance(polygon[None], goal, bounds=bounds)(POINTS_AROUND))


def test_points_on_walls_inside_and_far_away():
    assert_allclose(around(), DISTANCES_AROUND, rtol=1e-6)
    assert_allclose(around(bounds=Box((-0.5, -2), (5, 3))), DISTANCES_AROUND, rtol=1e-6)
    pairs = polygon_distance(BOX[None], None)(POINTS_AROUND, BELOW)
    assert_allclose(pairs, DISTANCES_AROUND, rtol=1e-6)


def test_no_path_leads_between_a_polygon_and_bounds_that_it_touches_or_crosses():
    right = around(bounds=((0, -2), (5, 3)))  # the left side touches the bounds
    assert_allclose(right[0], np.hypot(1.1, 1) + 1 + SQRT2, rtol=1e-6)
    assert_allclose(around(bounds=((0.5, -2), (5, 3)))[[0, 1]], [right[0], np.inf], rtol=1e-6)
    assert_allclose(around(bounds=((0, -2), (2, 3)))[[0, 2]], [np.inf, 1], rtol=1e-6)
    # Nor between corners that lie on the bounds; points between the box and the bounds are not free.
    along = polygon_distance(BOX[None], (0, 0), bounds=((-1, 0), (5, 3)))(np.array([(2, 0), (1, 0), (-1, 0)]))
    assert_allclose(along, [4, np.inf, 1], rtol=1e-6)


@pytest.mark.full
@pytest.mark.parametrize("order", [1, -1])
def test_a_point_where_two_corners_touch_lies_on_one_side(order):
    """The way out of a corner of one box leads into the other box."""
    boxes, contact = np.stack([BOX, BOX + BOX[2]])[::order], BOX[2]
    sides = np.array([(1, 2), (3, 0)], np.float32)  # both at a distance of sqrt(2), if on the contact's side
    to_contact, from_contact = polygon_distance(boxes, contact)(sides), polygon_distance(boxes, None)(contact, sides)
    assert_allclose(to_contact, from_contact)
    assert_allclose([to_contact.min(), to_contact.max()], [SQRT2, 4 + SQRT2], rtol=1e-6)


def test_wrong_numbers_give_nan_and_goals_in_obstacles_inf():
    for bad in (np.nan, np.inf):
        broken = BOX.copy()
        broken[2, 0] = bad
        assert np.isnan(around(broken)).all()
    assert np.isnan(around(goal=np.array([np.nan, 0], np.float32))).all()
    assert np.isnan(around(bounds=((np.nan, 0), (1, 1)))).all()
    for goal in ((1, 0.5), (np.inf, 0)):
        assert np.isinf(around(goal=np.array(goal, np.float32))[:-1]).all()
    empty = around(np.full_like(BOX, np.nan))
    assert_allclose(empty[:6], np.linalg.norm(POINTS_AROUND[:6] - BELOW, axis=1), rtol=1e-6)


@pytest.mark.full
def test_gradients_are_zero_where_the_distance_is_infinite():
    def total(polygons, goal, x):
        distance = polygon_distance(polygons, goal)(x)
        return jnp.where(jnp.isfinite(distance), distance, 0).sum()

    polygons = np.concatenate([BOX, [(np.nan, np.nan)] * 2]).astype(np.float32)[None]
    by_polygons, by_goal, by_x = jax.jit(jax.grad(total, (0, 1, 2)))(polygons, BELOW, POINTS_AROUND[:8])
    assert np.isfinite(by_polygons).all() and np.isfinite(by_goal).all() and not by_polygons[0, 4:].any()
    assert not by_x[5:].any() and not by_x[4].any()  # also at the goal
    assert_allclose(
        by_x[:3], [(0.9 / np.hypot(0.9, 1), 1 / np.hypot(0.9, 1)), (-1 / SQRT2, 1 / SQRT2), (0, 1)], atol=1e-6
    )


def test_polygons_of_discs_touch_the_discs_from_outside():
    centers, radii = np.array([(1.0, 2.0), (5.0, 5.0)], np.float32), np.array([0.5, 2.0], np.float32)
    polygons = np.asarray(polygons_of_discs(centers, radii, corners=8))
    assert polygons.shape == (2, 8, 2)
    assert_allclose(
        np.linalg.norm(polygons - centers[:, None], axis=2),
        (radii / np.cos(np.pi / 8))[:, None] * np.ones(8),
        rtol=1e-6,
    )
    middles = (polygons + np.roll(polygons, 1, axis=1)) / 2
    assert_allclose(np.linalg.norm(middles - centers[:, None], axis=2), radii[:, None] * np.ones(8), rtol=1e-6)
    assert_allclose(polygons_of_discs(centers[:1], 0.5, 8)[0], polygons[0], rtol=1e-6)


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: polygon_distance(BOX, (1, 1)), "polygons must have shape"),
        (lambda: polygon_distance(np.zeros((5, 52, 2)), (1, 1)), "at most 256 vertices, got 260 .* VisibilityGraph"),
        (lambda: polygon_distance([[(0, 0), (1, 0)], [(1, 1)]], (1, 1)), "polygons must be points"),
        (lambda: polygon_distance(BOX[None] > 0, (1, 1)), "polygons must be real numbers"),
        (lambda: polygon_distance(BOX[None], np.zeros((1, 1, 2))), "goal must have shape"),
        (lambda: polygon_distance(BOX[None], np.zeros((0, 2))), "goal must have shape"),
        (lambda: polygon_distance(BOX[None], (1, 1), bounds=(1, 2)), "bounds must be a Box"),
        (lambda: polygons_of_discs(BOX, 1, corners=2), "corners must be"),
        (lambda: polygons_of_discs(BOX, [1, 2, 3]), "radii a number or"),
    ],
)
def test_wrong_arguments_raise_also_while_traced(call, message):
    with pytest.raises(ValueError, match=message):
        call()
    with pytest.raises(ValueError, match=message):
        jax.eval_shape(call)


@pytest.mark.full
def test_64_bits_are_exact_and_promote_nothing():
    polygons, goals, x, _ = maps()
    with jax.enable_x64(True), jax.numpy_rank_promotion("raise"), jax.numpy_dtype_promotion("strict"):
        field = jax.jit(lambda *given: polygon_distance(*given[:2], bounds=BOUNDS.astype(float))(given[2]))
        for number, oracle in enumerate(oracles()[0]):
            # VisibilityGraph treats 32-bit points near walls as on the walls, so ask both in 64 bits.
            given = [each[number].astype(float) for each in (polygons, goals[:, 0], x)]
            assert_allclose(field(*given), oracle(given[2]), atol=1e-10)


@pytest.mark.full
def test_second_derivatives_equal_differences_of_gradients():
    with jax.enable_x64(True), jax.numpy_rank_promotion("raise"):
        polygons, goal, x = (each[0].astype(float) for each in (maps()[0], maps()[1][:, 0], maps()[2]))
        x = x[np.isfinite(oracles()[0][0](x))][:20]
        by_polygons = jax.jit(jax.grad(lambda polygons: polygon_distance(polygons, goal)(x).sum()))
        direction = np.random.default_rng(1).standard_normal(polygons.shape)
        second = jax.jvp(by_polygons, (polygons,), (direction,))[1]
        ahead, behind = (by_polygons(polygons + step * direction) for step in (1e-6, -1e-6))
        assert_allclose(second, (ahead - behind) / 2e-6, atol=1e-3)
