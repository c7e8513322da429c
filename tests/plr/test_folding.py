"""Foldings: which there are, how they fold, how files keep them; and PLRs of them."""

import struct

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plr_helpers import sealed

from plr_jax import Box, BuildOptions, Dubins, Euclidean, ReedsShepp, construct, from_bytes
from plr_jax._types import Symmetry
from plr_jax.plr.folding import folding_of

# Foldings: which there are of a distance function in a window, how they fold, and how files keep them.


WINDOW = Box((-2, -2, -np.pi), (2, 2, np.pi), periodic=(False, False, True))
SQUARE, FOUR = Box((-1, -1), (1, 1)), Box((0, 0), (4, 4))
ASIDE = Box((-3, -4, -np.pi), (5, 3, np.pi), periodic=(False, False, True))


class Stated:
    """A distance function that states reflections and turns about the origin."""

    def __init__(self, *matrices):
        self.symmetries = [Symmetry(np.array(matrix), np.zeros(len(matrix))) for matrix in matrices]

    def __call__(self, x):
        return np.zeros(len(x))


ALONG, SLANTED = np.diag([1.0, -1.0]), [[0.6, 0.8], [0.8, -0.6]]
POINT, PLANE = np.diag([-1.0, -1.0, -1.0]), np.diag([-1.0, 1.0, 1.0])


@pytest.mark.parametrize(
    ("oracle", "domain", "box"),
    [
        # Of a car that reverses, about the goal, a quarter of the window is left; of one that does not, a half.
        (ReedsShepp((0, 0, 0), 1), WINDOW, Box((0, 0, -np.pi), (2, 2, np.pi), periodic=(False, False, True))),
        (Dubins((0, 0, 0), 1), WINDOW, Box((-2, 0, -np.pi), (2, 2, np.pi), periodic=(False, False, True))),
        # A window that is not about the goal folds onto its larger parts, and only along mirrors that cut it.
        (Euclidean((1, 5)), FOUR, Box((0, -5), (3, -1))),
        (Euclidean((4, 2)), FOUR, Box((-4, 0), (0, 2))),
        (Dubins((0, 0, np.pi / 4), 1), WINDOW, None),  # turned, the box is not smaller
        (Euclidean((0, 0)), FOUR, None),
        # What is no reflection, or reverses angles alone, is left out.
        (Stated([[0.0, -1.0], [1.0, 0.0]]), SQUARE, None),
        (Stated(ALONG), Box((-1, -1), (1, 1), periodic=(False, True)), None),
        (lambda x: x[:, 0], SQUARE, None),
        # If reflections do not commute, the first one is used; here they have different centers.
        (Stated(ALONG, SLANTED), SQUARE, Box((-1, 0), (1, 1))),
        (Stated(POINT, PLANE), Box((-1, -1, -1), (1, 1, 1)), Box((0, 0, -1), (1, 1, 1))),
    ],
)
def test_mirror_symmetries_fold_domain_to_smallest_box(oracle, domain, box):
    folding = folding_of(oracle, domain)
    if box is None:
        assert folding is None
    else:
        assert folding.box == box and len(folding.mirrors) == round(np.log2(np.prod(domain.width / box.width)) + 0.3)


@pytest.mark.parametrize(
    ("oracle", "domain"),
    [
        (ReedsShepp((0.5, 0.25, 0), 1), ASIDE),
        (ReedsShepp((0.5, 0.25, 0.7), 1), ASIDE),
        (ReedsShepp((0.5, 0.25, 0), 1), Box((-3, -4, 0), (5, 3, 1))),
        (Euclidean((1, 2, 3)), Box((0, 0, 0), (4, 4, 4))),
    ],
)
@given(st.lists(st.floats(0, 1), min_size=3, max_size=3))
def test_unfolding_folded_points_keeps_their_distance(oracle, domain, share):
    folding = folding_of(oracle, domain)
    x = (domain.lo + domain.width * share)[None]
    z = folding(x)
    assert folding.box.contains(z).all()
    y = folding.unfold(z)
    assert domain.contains(y).all()
    np.testing.assert_allclose(oracle(y), oracle(x), rtol=1e-9, atol=1e-6)
    assert any(np.abs(domain.difference(image, x)).max() < 1e-9 for image, _ in folding.images(z))


@pytest.mark.parametrize(
    ("heading", "at", "change", "message"),
    [
        (0, 0, struct.pack("<d", np.nan), "not finite"),
        (0, 0, struct.pack("<d", 7.0), "does not cut the domain"),
        (0.4, 24, b"\2", "not in canonical form"),
        (0, 25, b"\377", "end too early"),
        (0, 26, b"\0\0\1", "must reverse an axis of its own"),
        (0, 32, b"\1\1\0", "which only plr_jax 0.1 reads"),
        (0.4, 25, struct.pack("<d", 0.5), "not orthogonal"),
        (0, 3 - 52, b"\xa3", "its points are folded, but its leaves have sources"),
    ],
)
def test_files_of_invalid_foldings_raise(heading, at, change, message):
    """A folding follows four bytes and the domain, which has 48."""
    data = construct(ReedsShepp((0, 0, heading), 1), WINDOW, max_leaves=4).to_bytes()
    assert data[3] >> 5 & 1
    at += 52
    with pytest.raises(ValueError, match=message):
        from_bytes(sealed(data[:at] + change + data[at + len(change) : -4]))


# PLRs of distance functions that state symmetries.


AROUND = Box((-4, -4, -np.pi), (4, 4, np.pi), periodic=(False, False, True))
SIDE = Box((-2, -4, -np.pi), (6, 3, np.pi), periodic=(False, False, True))
FAR = Box((998, -1e3 - 4, -np.pi), (1004, -1e3 + 2, np.pi), periodic=(False, False, True))
ABOUT = (ReedsShepp((0, 0, 0), 1), AROUND)
TURNED = (ReedsShepp((1, 0.5, 0.6), 1), SIDE)
STRAIGHT = (Euclidean((1, 2)), Box((-3, -1), (2, 4)))


def points(domain, n=1000, seed=0):
    return np.random.default_rng(seed).uniform(domain.lo, domain.hi, (n, domain.dim))


@pytest.mark.parametrize(
    ("oracle", "domain", "most"),
    [
        (*TURNED, 0.05),
        (ReedsShepp((1e3, -1e3, 2), 1), FAR, 0.05),
        (Dubins((0, 0, np.pi / 2), 1), AROUND, 0.4),  # the distance jumps
        (*STRAIGHT, 0.001),
    ],
)
def test_answers_are_near_the_distance_and_equal_at_images(oracle, domain, most):
    plr = construct(oracle, domain, leaf="continuous", max_leaves=300)
    assert plr.domain == domain and plr.folded_domain != domain
    x = points(domain)
    assert np.abs(np.asarray(plr(x)) - oracle(x)).mean() < most
    assert np.isfinite(plr(np.stack([domain.lo, domain.hi]))).all()
    outside = x.copy()
    outside[:, 1] += np.where(x[:, 1] < oracle.goal[1], -1, 1) * domain.width[1]
    assert np.isinf(np.asarray(plr(outside))[~domain.contains(outside)]).all()
    for symmetry in oracle.symmetries if plr.tables.folding.mirrors else ():
        image = x @ symmetry.matrix.T + symmetry.offset
        inside = domain.contains(image)
        np.testing.assert_allclose(plr(image[inside]), plr(x[inside]), atol=2e-4)


def test_exact_images_of_points_get_equal_answers():
    plr = construct(*ABOUT, leaf="continuous", max_leaves=50)
    x = points(AROUND).astype(np.float32)
    for signs in ((-1, 1, -1), (1, -1, -1), (-1, -1, 1)):
        np.testing.assert_array_equal(plr(x * np.float32(signs)), plr(x))
        np.testing.assert_array_equal(plr.numpy().leaf(x * np.float32(signs)), plr.numpy().leaf(x))
    assert np.isfinite(jax.grad(plr)(jax.numpy.zeros(3))).all()


def test_byte_budgets_include_the_folding():
    plr = construct(*TURNED, leaf="plane", max_bytes=400)
    assert len(plr.to_bytes()) == plr.num_bytes <= 400


def test_unfolded_boxes_of_leaves_fill_the_domain():
    plr = construct(*STRAIGHT, max_leaves=20)
    lo, hi = plr.leaf_boxes
    np.testing.assert_array_equal(plr.numpy().leaf((lo + hi) / 2), plr.leaf_of_box)
    assert np.prod(hi - lo, axis=1).sum() == pytest.approx(25.0)
    assert plr.num_leaves == len(plr.cells) == len(plr.slope) == 20
    with pytest.raises(ValueError, match="along rotated axes"):
        folding_of(ReedsShepp((0.5, 0.25, 0.7), 1), ASIDE).boxes(np.zeros((1, 3)), np.ones((1, 3)))


def test_weights_count_for_all_images_of_a_point():
    """Weights are positive only on one side of the goal, which has an image of each stored point."""
    options = BuildOptions(weight_fn=lambda x: (x[:, 0] >= 0).astype(float))
    one_side = construct(*ABOUT, max_leaves=40, options=options)
    assert one_side.to_bytes() == construct(*ABOUT, max_leaves=40).to_bytes()
