import numpy as np
import pytest
import shapely
from piece_helpers import SEEDS, as_pieces, points_of, polygons, random_pieces

from plr_jax.geometry.convex_pieces import (
    ROOM,
    areas,
    clip,
    clip_to_boxes,
    cone_above_plane,
    contain,
    difference_of_cones,
)

DENSE = np.linspace(0, 1, 129)


def test_repeated_cuts_through_corners_keep_the_area():
    """Lines meet corners up to rounding, so corners double up, yet their number stays below the limit."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        step = rng.choice([0.1, 1 / 3, 0.7])
        pieces = as_pieces([step * rng.permutation(np.argwhere(np.ones((6, 6))))[:3] for _ in range(40)])
        pieces = pieces[:, areas(pieces) > 0]
        exact = np.array(polygons(pieces))
        for _ in range(9):
            axis, sign, each = rng.integers(2), rng.choice([-1.0, 1.0]), np.arange(pieces.shape[1])
            line = pieces[axis, each, rng.integers(ROOM, size=len(each))]
            height = sign * (pieces[axis] - line[:, None])
            reach = height.max(axis=1) > 0
            ends = np.where(sign > 0, line, -50.0), np.where(sign > 0, 50.0, line)
            corners = (ends[0], -50, ends[1], 50) if axis == 0 else (-50, ends[0], 50, ends[1])
            exact = shapely.intersection(exact, shapely.box(*corners))[reach]
            pieces = clip(pieces[:, reach], height[reach])
            np.testing.assert_allclose(areas(pieces), shapely.area(exact), atol=1e-13)


@pytest.mark.parametrize("seed", SEEDS)
def test_contained_points_equal_those_of_shapely(seed):
    rng = np.random.default_rng(seed)
    pieces = random_pieces(rng, 15)
    x = np.concatenate([points_of(rng, pieces, 2), rng.uniform(0, 10, (15, 2, 2))], axis=1)
    shapes, points = np.array(polygons(pieces))[:, None], shapely.points(x)
    inside = np.where(shapely.covers(shapes, points), 1, -1)
    depth = inside * shapely.distance(shapely.boundary(shapes), points)
    clear = np.abs(depth) > 1e-9
    np.testing.assert_array_equal(contain(pieces, x, 0.0)[clear], depth[clear] > 0)
    assert contain(pieces, x, 0.1)[depth > -0.1 + 1e-9].all()


@pytest.mark.parametrize("seed", SEEDS)
def test_clipped_pieces_equal_intersections_of_shapely(seed):
    rng = np.random.default_rng(seed)
    pieces = random_pieces(rng, 15)
    lo, hi = np.sort(rng.uniform(0, 10, (2, 2)), axis=0)
    cut = clip_to_boxes(pieces, lo[None], hi[None])[0]
    exact = shapely.intersection(polygons(pieces), shapely.box(*lo, *hi))
    assert (areas(cut) > 0).all()
    kept, exact = polygons(cut[:, areas(cut) > 1e-9]), exact[shapely.area(exact) > 1e-9]
    assert (shapely.area(shapely.symmetric_difference(kept, exact)) <= 1e-9).all() and len(kept) == len(exact)
    np.testing.assert_allclose(shapely.area(kept), shapely.area(exact), rtol=1e-6, atol=1e-11)


# --- cones -----------------------------------------------------------------------------------------------


def cones(apex, offset):
    """Return one cone per piece, as a function of points ``(pieces, k, 2)``."""
    return lambda x: offset[:, None] + np.linalg.norm(x - apex[:, None], axis=2)


def check_extremes(found, pieces, function, apexes, rng, scale=1.0, beyond=1e-11):
    """Check extremes against a search: dense samples of every edge, finer around the best, points inside, apexes."""
    start = pieces.transpose(1, 2, 0)
    way = np.roll(start, -1, axis=1) - start
    n, corners, _ = start.shape
    inside = [function(points_of(rng, pieces, 200))]
    for apex in apexes:
        d, e = start - apex[:, None], np.roll(start, -1, axis=1) - apex[:, None]
        holds = (d[..., 0] * e[..., 1] - d[..., 1] * e[..., 0] >= 0).all(axis=1)  # no corner turns clockwise
        inside.append(function(np.where(holds[:, None], apex, start[:, 0])[:, None]))
    for extreme, best, sign in zip(found, (np.min, np.max), (1, -1), strict=True):
        share = np.broadcast_to(DENSE, (n, corners, len(DENSE)))
        for step in DENSE[1] * 0.5 ** np.arange(0, 30, 6):
            x = start[:, :, None] + share[..., None] * way[:, :, None]
            value = function(x.reshape(n, -1, 2)).reshape(share.shape)
            near = np.take_along_axis(share, np.argmin(sign * value, axis=2)[..., None], axis=2)
            share = np.clip(near + step * (2 * DENSE - 1), 0, 1)
        expected = best(np.concatenate([value.reshape(n, -1), *inside], axis=1), axis=1)
        assert (np.abs(extreme - expected) <= 1e-7 * scale).all()
        assert (sign * (extreme - expected) <= beyond * scale).all()


def apexes_beside(rng, pieces):
    """Return apexes at a corner, on an edge, inside, on the line of an edge, near or far."""
    n = pieces.shape[1]
    each, corner = np.arange(n), rng.integers(pieces.shape[2], size=n)
    a, b = pieces[:, each, corner].T, pieces[:, each, (corner + 1) % pieces.shape[2]].T
    share = rng.random((n, 1))
    kinds = [
        a,
        a + share * (b - a),
        points_of(rng, pieces, 1)[:, 0],
        b + 3 * share * (b - a),
        a + 10.0 ** rng.uniform(-6, 0, (n, 1)) * rng.normal(size=(n, 2)),
        rng.uniform(0, 10, (n, 2)),
        1e3 * rng.normal(size=(n, 2)),
    ]
    return np.array(kinds)[rng.integers(len(kinds), size=n), each]


@pytest.mark.parametrize("is_clipped", [False, True])
@pytest.mark.parametrize("seed", SEEDS)
def test_extremes_of_cone_differences_equal_a_search(seed, is_clipped):
    """Clipping doubles corners up to rounding, and leaves edges of a hair and apexes at former corners."""
    rng = np.random.default_rng(seed)
    pieces = random_pieces(rng, 20)
    corner, width = pieces[:, 0, 0], np.ptp(pieces[:, 0], axis=1)
    if is_clipped:
        lo, hi = corner - width * rng.choice([1e-9, 1.0], 2), corner + width * rng.choice([1e-9, 1.0, 3.0], 2)
        pieces = clip_to_boxes(pieces, lo[None], hi[None])[0]
    n = pieces.shape[1]
    one = np.tile(corner, (n, 1)) if is_clipped else apexes_beside(rng, pieces)
    two, offsets = apexes_beside(rng, pieces), rng.uniform(0, 5, (2, n))
    first, second = cones(one, offsets[0]), cones(two, offsets[1])
    found = difference_of_cones(pieces, one, offsets[0], two, offsets[1])
    check_extremes(found, pieces, lambda x: first(x) - second(x), (one, two), rng)


@pytest.mark.parametrize("seed", SEEDS)
def test_extremes_of_cone_above_plane_equal_a_search(seed):
    rng = np.random.default_rng(seed)
    pieces = random_pieces(rng, 12)
    apex, offset = apexes_beside(rng, pieces), rng.uniform(0, 5, 12)
    slope, intercept = rng.normal(size=(12, 2)), rng.normal(size=12)
    slope[::3] /= np.linalg.norm(slope[::3], axis=1, keepdims=True)  # as steep as a cone
    slope[1::6] = [[1.0, 0.0]]
    found, cone = cone_above_plane(pieces, apex, offset, slope, intercept), cones(apex, offset)
    scale = 1 + np.abs(apex).max(axis=1)

    def above(x):
        return cone(x) - np.einsum("pd,pkd->pk", slope, x) - intercept[:, None]

    check_extremes(found, pieces, above, (apex,), rng, scale, 1e-12)
