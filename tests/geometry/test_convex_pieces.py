import numpy as np
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from piece_helpers import as_pieces, box, points_of, polygons, random_pieces

from plr_jax.geometry.convex_pieces import (
    ROOM,
    areas,
    boxes_as_pieces,
    clip,
    clip_to_box,
    contain,
    convex_pieces,
    cut_parts,
)

SEEDS = st.integers(0, 100_000)


def half_plane(normal, offset):
    """The side of a line where ``normal . x >= offset``, as far as matters."""
    normal = np.asarray(normal, float) / np.linalg.norm(normal)
    foot, along = offset * normal, 1e3 * np.array([-normal[1], normal[0]])
    return shapely.Polygon([foot + along, foot - along, foot - along + 1e3 * normal, foot + along + 1e3 * normal])


@given(SEEDS)
@settings(max_examples=25, deadline=None)
def test_what_a_line_leaves_is_what_shapely_leaves(seed):
    rng = np.random.default_rng(seed)
    pieces = random_pieces(rng, 12)
    angle = rng.uniform(0, 2 * np.pi)
    normal = np.array([np.cos(angle), np.sin(angle)])
    across = normal @ pieces.mean(axis=(1, 2)) + rng.normal(0, 1)
    height = np.einsum("d,dpc->pc", normal, pieces) - across
    reach = (height > 0).any(axis=1)
    kept = clip(pieces[:, reach], height[reach])
    beyond = half_plane(normal, across)
    for before, after in zip(polygons(pieces[:, reach]), polygons(kept), strict=True):
        exact = before.intersection(beyond)
        assert after.symmetric_difference(exact).area <= 1e-9
        np.testing.assert_allclose(after.area, exact.area, rtol=1e-6, atol=1e-11)
    assert (areas(kept) >= -1e-12).all()


def test_a_square_cut_through_corners_and_along_a_side():
    square = as_pieces([box(0, 0, 2, 2)])
    diagonal = clip(square, square[0] - square[1])  # what is below the diagonal
    assert polygons(diagonal)[0].equals(shapely.Polygon([(0, 0), (2, 0), (2, 2)]))
    all_of_it = clip(square, square[0])
    assert polygons(all_of_it)[0].equals(polygons(square)[0])
    side = clip(square, square[0] - 2)
    np.testing.assert_array_equal(side[0], 2)
    assert set(side[1].ravel()) == {0, 2} and areas(side)[0] == 0
    corner = clip(square, square[0] + square[1] - 4)
    np.testing.assert_array_equal(corner, 2)


def test_a_triangle_cut_on_all_sides_has_seven_corners():
    triangle = as_pieces([[(0, 0), (10, 1), (4, 9)]])
    lo, hi = np.array([1.0, 0.3]), np.array([9.0, 7])
    cut = clip_to_box(triangle, lo, hi)[0]
    exact = polygons(triangle)[0].intersection(shapely.box(*lo, *hi))
    assert len(exact.exterior.coords) == 8 and cut.shape == (2, 1, ROOM)
    np.testing.assert_allclose(polygons(cut)[0].symmetric_difference(exact).area, 0, atol=1e-12)


def test_cutting_a_piece_over_and_over_through_its_own_corners_keeps_room():
    """Where lines meet corners up to rounding, corners double up, yet never beyond the room there is."""
    rng = np.random.default_rng(0)
    for _ in range(60):
        step = rng.choice([0.1, 1 / 3, 0.7])
        pieces = as_pieces([step * rng.permutation(np.argwhere(np.ones((6, 6))))[:3] for _ in range(40)])
        pieces = pieces[:, areas(pieces) > 0]
        exact = polygons(pieces)
        for _ in range(9):
            axis, sign, each = rng.integers(2), rng.choice([-1.0, 1.0]), np.arange(pieces.shape[1])
            line = pieces[axis, each, rng.integers(ROOM, size=len(each))]
            height = sign * (pieces[axis] - line[:, None])
            reach = height.max(axis=1) > 0
            ends = np.where(sign > 0, line, -50.0), np.where(sign > 0, 50.0, line)
            beyond = [
                shapely.box(*((a, -50, b, 50) if axis == 0 else (-50, a, 50, b))) for a, b in zip(*ends, strict=True)
            ]
            exact = [p.intersection(q) for p, q, r in zip(exact, beyond, reach, strict=True) if r]
            pieces = clip(pieces[:, reach], height[reach])
            np.testing.assert_allclose(areas(pieces), [p.area for p in exact], atol=1e-13)


@given(SEEDS)
@settings(max_examples=20, deadline=None)
def test_areas_are_shapelys(seed):
    pieces = random_pieces(np.random.default_rng(seed), 10)
    np.testing.assert_allclose(areas(pieces), [p.area for p in polygons(pieces)], rtol=1e-9, atol=1e-15)


def test_areas_far_from_the_origin_keep_their_digits():
    pieces = as_pieces([box(0, 0, 0.25, 0.5), [(0, 0), (1, 0), (0, 1)]])
    np.testing.assert_allclose(areas(pieces + 2.0**30), [0.125, 0.5], rtol=1e-6)


@given(SEEDS)
@settings(max_examples=20, deadline=None)
def test_pieces_contain_what_shapely_says_to_the_tolerance(seed):
    rng = np.random.default_rng(seed)
    pieces = random_pieces(rng, 15)
    x = np.concatenate([points_of(rng, pieces, 2), rng.uniform(0, 10, (15, 2, 2))], axis=1)
    shapes, points = np.array(polygons(pieces))[:, None], shapely.points(x)
    inside = np.where(shapely.covers(shapes, points), 1, -1)
    depth = inside * shapely.distance(shapely.boundary(shapes), points)
    clear = np.abs(depth) > 1e-9
    np.testing.assert_array_equal(contain(pieces, x, 0.0)[clear], depth[clear] > 0)
    assert contain(pieces, x, 0.1)[depth > -0.1 + 1e-9].all()


def test_a_piece_contains_its_corners_and_what_is_beside_it_within_the_tolerance():
    square = as_pieces([box(0, 0, 2, 2)] * 4)
    assert contain(square, box(0, 0, 2, 2)[:, None], 0.0).all()
    beside = np.array([[2.1, 1], [1, -0.1], [2.3, 1], [1, 2.3]])
    np.testing.assert_array_equal(contain(square, beside[:, None], 0.2)[:, 0], [True, True, False, False])


@given(SEEDS)
@settings(max_examples=20, deadline=None)
def test_what_a_box_leaves_is_what_shapely_leaves(seed):
    rng = np.random.default_rng(seed)
    pieces = random_pieces(rng, 15)
    lo, hi = np.sort(rng.uniform(0, 10, (2, 2)), axis=0)
    cut = clip_to_box(pieces, lo, hi)[0]
    exact = [p.intersection(shapely.box(*lo, *hi)) for p in polygons(pieces)]
    assert (areas(cut) > 0).all()
    large = areas(cut) > 1e-9
    expected = [p for p in exact if p.area > 1e-9]
    for polygon, q in zip(polygons(cut[:, large]), expected, strict=True):
        assert polygon.symmetric_difference(q).area <= 1e-9


def test_what_touches_a_box_is_not_in_it():
    pieces = as_pieces([box(0, 0, 1, 1), box(1, 0, 2, 1), box(1, 1, 3, 2), box(5, 5, 6, 6)])
    cut = clip_to_box(pieces, np.array([1.0, 0.5]), np.array([2.0, 1.0]))[0]
    assert cut.shape[1] == 1 and polygons(cut)[0].equals(shapely.box(1, 0.5, 2, 1))


def test_boxes_as_pieces():
    lo, hi = np.array([[0.0, 1], [2, 2]]), np.array([[1.0, 3], [5, 4]])
    pieces = boxes_as_pieces(lo, hi)
    assert pieces.shape == (2, 2, ROOM)
    assert [p.equals(shapely.box(*a, *b)) for p, a, b in zip(polygons(pieces), lo, hi, strict=True)] == [True, True]
    np.testing.assert_array_equal(areas(pieces), [2, 6])  # counterclockwise


def test_triangles_fill_a_region_counterclockwise():
    region = shapely.union_all([shapely.box(0, 0, 5, 5) - shapely.box(1, 1, 2, 4), shapely.box(6, 0, 7, 1)])
    triangles = convex_pieces(region)
    assert (areas(triangles) > 0).all()
    np.testing.assert_allclose(areas(triangles).sum(), region.area)
    assert shapely.union_all(polygons(triangles)).symmetric_difference(region).area <= 1e-12


@given(SEEDS)
@settings(max_examples=20, deadline=None)
def test_parts_of_cells_have_what_shapely_leaves_of_the_cells_pieces(seed):
    rng = np.random.default_rng(seed)
    pieces = random_pieces(rng, 12)
    first = np.array([0, 5, 5, 12])  # three cells, one without pieces
    parent, axis, is_upper = rng.integers(3, size=6), rng.integers(2, size=6), rng.random(6) < 0.5
    lo, hi = np.full((6, 2), -50.0), np.full((6, 2), 50.0)
    each, bound = np.arange(6), rng.uniform(0, 10, 6)
    lo[each[is_upper], axis[is_upper]] = bound[is_upper]
    hi[each[~is_upper], axis[~is_upper]] = bound[~is_upper]
    found, part, piece, is_cut = cut_parts(pieces, first, parent, axis, is_upper, lo, hi)
    assert (np.diff(part) >= 0).all()
    np.testing.assert_array_equal(np.searchsorted(first, piece, side="right") - 1, parent[part])
    np.testing.assert_array_equal(found[:, ~is_cut], pieces[:, piece[~is_cut]])
    left = np.zeros((6, 12))
    left[part, piece] = areas(found)
    shapes = np.array(polygons(pieces))
    for k in range(6):
        for i in range(first[parent[k]], first[parent[k] + 1]):
            np.testing.assert_allclose(
                left[k, i], shapes[i].intersection(shapely.box(*lo[k], *hi[k])).area, atol=1e-9
            )
