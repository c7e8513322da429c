import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from piece_helpers import as_pieces, box, points_of, random_pieces

from plr_jax.geometry.convex_pieces import clip_to_box, cone_above_plane, difference_of_cones

SEEDS = st.integers(0, 100_000)
DENSE = np.linspace(0, 1, 129)


def cones(apex, offset):
    """The function of points ``(pieces, k, 2)`` that a cone a piece is."""
    return lambda x: offset[:, None] + np.linalg.norm(x - apex[:, None], axis=2)


def searched_extremes(pieces, function, apexes, rng):
    """Extremes that a search finds: dense samples of every edge, finer around the best, points inside, apexes."""
    start = pieces.transpose(1, 2, 0)
    way = np.roll(start, -1, axis=1) - start
    n, corners, _ = start.shape
    inside = [function(points_of(rng, pieces, 200))]
    for apex in apexes:
        x = np.array(
            [p if _holds(piece, p) else piece[:, 0] for p, piece in zip(apex, pieces.transpose(1, 0, 2), strict=True)]
        )
        inside.append(function(x[:, None]))
    found = []
    for best, sign in ((np.min, 1), (np.max, -1)):
        share = np.broadcast_to(DENSE, (n, corners, len(DENSE)))
        for step in DENSE[1] * 0.5 ** np.arange(0, 30, 6):
            x = start[:, :, None] + share[..., None] * way[:, :, None]
            value = function(x.reshape(n, -1, 2)).reshape(share.shape)
            near = np.take_along_axis(share, np.argmin(sign * value, axis=2)[..., None], axis=2)
            share = np.clip(near + step * (2 * DENSE - 1), 0, 1)
        found.append(best(np.concatenate([value.reshape(n, -1), *inside], axis=1), axis=1))
    return found


def _holds(piece, x):
    """Whether a convex piece holds a point, seen from which no corner turns clockwise."""
    d, e = piece.T - x, np.roll(piece.T, -1, axis=0) - x
    return (d[:, 0] * e[:, 1] - d[:, 1] * e[:, 0] >= 0).all()


def apexes_beside(rng, pieces):
    """Apexes of all kinds: at a corner, on an edge, inside, on an edge's line, near and far."""
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


@given(SEEDS)
@settings(max_examples=40, deadline=None)
def test_extremes_of_the_difference_are_those_a_search_finds(seed):
    rng = np.random.default_rng(seed)
    pieces = random_pieces(rng, 12)
    one, two = apexes_beside(rng, pieces), apexes_beside(rng, pieces)
    offsets = rng.uniform(0, 5, (2, 12))
    lowest, highest = difference_of_cones(pieces, one, offsets[0], two, offsets[1])
    first, second = cones(one, offsets[0]), cones(two, offsets[1])
    low, high = searched_extremes(pieces, lambda x: first(x) - second(x), (one, two), rng)
    np.testing.assert_allclose([lowest, highest], [low, high], atol=1e-7)
    assert (lowest <= low + 1e-11).all() and (highest >= high - 1e-11).all()


@given(SEEDS)
@settings(max_examples=20, deadline=None)
def test_extremes_hold_for_pieces_as_clipping_leaves_them(seed):
    """Corners doubled up by rounding, edges of a hair, apexes that are corners of what was cut."""
    rng = np.random.default_rng(seed)
    whole = random_pieces(rng, 30)
    corner = whole[:, 0, 0]
    width = np.ptp(whole[:, 0], axis=1)
    lo, hi = corner - width * rng.choice([1e-9, 1.0], 2), corner + width * rng.choice([1e-9, 1.0, 3.0], 2)
    pieces = clip_to_box(whole, lo, hi)[0]
    n = pieces.shape[1]
    assert n
    one, two, zero = np.tile(corner, (n, 1)), apexes_beside(rng, pieces), np.zeros(n)
    lowest, highest = difference_of_cones(pieces, one, zero, two, zero)
    first, second = cones(one, zero), cones(two, zero)
    low, high = searched_extremes(pieces, lambda x: first(x) - second(x), (one, two), rng)
    np.testing.assert_allclose([lowest, highest], [low, high], atol=1e-7)
    assert (lowest <= low + 1e-11).all() and (highest >= high - 1e-11).all()


@pytest.mark.parametrize(
    ("one", "two", "expected"),
    [
        ((0, 0), (3, 0), (-3, 1)),  # on the line of a side, from a corner
        ((-1, 0), (-3, 0), (-2, np.sqrt(5) - np.sqrt(13))),  # both before it: all of that side is farthest apart
        ((1, 1), (1, 1), (0, 0)),
        ((1, -2), (1, 4), (-2, 2)),  # above and below: stationary in the middle of two sides
        ((1, 1), (1, 5), (-4, np.sqrt(2) - np.sqrt(10))),  # one inside, from which on the difference is least
        ((0, 1), (0, 1 + 1e-9), (-1e-9, 1e-9)),
    ],
)
def test_differences_over_a_square(one, two, expected):
    square, offset = as_pieces([box(0, 0, 2, 2)]), np.array([7.0])
    one, two = np.array([one], float), np.array([two], float)
    found = difference_of_cones(square, one, offset, two, offset - 2)
    np.testing.assert_allclose(np.ravel(found), np.array(expected) + 2, atol=1e-12)


def test_no_digits_are_lost_where_cones_are_far_away():
    """From afar a cone is a plane: over a square of side 2 the two fall along the axes."""
    square, zero = as_pieces([box(0, 0, 2, 2)]), np.zeros(1)
    far = np.array([[1e8, 0.0]]), np.array([[0.0, 1e8]])
    low, high = difference_of_cones(square, far[0], zero, far[1], zero)
    np.testing.assert_allclose([low[0], high[0]], [-2, 2], atol=1e-6)


@given(SEEDS)
@settings(max_examples=40, deadline=None)
def test_extremes_above_a_plane_are_those_a_search_finds(seed):
    rng = np.random.default_rng(seed)
    pieces = random_pieces(rng, 12)
    apex, offset = apexes_beside(rng, pieces), rng.uniform(0, 5, 12)
    slope = rng.normal(size=(12, 2))
    slope[::3] /= np.linalg.norm(slope[::3], axis=1, keepdims=True)  # as steep as a cone
    slope[1::6] = [[1.0, 0.0]]
    intercept = rng.normal(size=12)
    lowest, highest = cone_above_plane(pieces, apex, offset, slope, intercept)
    cone = cones(apex, offset)
    low, high = searched_extremes(
        pieces, lambda x: cone(x) - np.einsum("pd,pkd->pk", slope, x) - intercept[:, None], (apex,), rng
    )
    scale = 1 + np.abs(apex).max(axis=1)
    assert (np.abs([lowest - low, highest - high]) <= 1e-7 * scale).all()
    assert (lowest <= low + 1e-12 * scale).all() and (highest >= high - 1e-12 * scale).all()


@pytest.mark.parametrize(
    ("apex", "slope", "expected"),
    [
        ((1, 1), (0, 0), (0, np.sqrt(2))),  # lowest at the apex
        ((1, 1), (2, 0), (-1, 2 + np.sqrt(2))),  # steeper than the cone: lowest on the side that it falls to
        ((0, 0), (1, 0), (0, 2)),  # as steep, along the side from a corner
        ((1, -1), (0, 0), (1, np.sqrt(10))),  # lowest on the side nearest to the apex
        ((0, -3), (0.6, 0), (2.4, 5)),  # lowest within the bottom, at x = 9/4 if it went on, else at its end
    ],
)
def test_cones_above_planes_over_a_square(apex, slope, expected):
    square = as_pieces([box(0, 0, 2, 2)])
    apex, slope = np.array([apex], float), np.array([slope], float)
    if (slope == [0.6, 0]).all():
        square[0] *= 2  # so that 9/4 is within
    found = cone_above_plane(square, apex, np.array([3.0]), slope, np.array([1.0]))
    plane_at_apex = 3 - 1 - (slope * apex).sum()  # which the cases leave out
    np.testing.assert_allclose(np.ravel(found), np.array(expected) + plane_at_apex, atol=1e-12)
