"""PLRs of distance functions that state symmetries."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from plr_jax import Box, BuildOptions, Dubins, Euclidean, ReedsShepp, construct
from plr_jax.plr._plr import leaf_of
from plr_jax.plr.container import Container

WINDOW = Box((-4, -4, -np.pi), (4, 4, np.pi), periodic=(False, False, True))
ASIDE = Box((-2, -4, -np.pi), (6, 3, np.pi), periodic=(False, False, True))
FAR = Box((998, -1e3 - 4, -np.pi), (1004, -1e3 + 2, np.pi), periodic=(False, False, True))
CASES = {
    "about": (ReedsShepp((0, 0, 0), 1), WINDOW),
    "turned": (ReedsShepp((1, 0.5, 0.6), 1), ASIDE),
    "far": (ReedsShepp((1e3, -1e3, 2), 1), FAR),
    "forward": (Dubins((0, 0, np.pi / 2), 1), WINDOW),
    "straight": (Euclidean((1, 2)), Box((-3, -1), (2, 4))),
}


def points(domain, n=2000, seed=0):
    return np.random.default_rng(seed).uniform(domain.lo, domain.hi, (n, domain.dim))


@pytest.mark.parametrize(("oracle", "domain"), CASES.values(), ids=CASES)
def test_they_answer_near_the_distance_and_images_alike(oracle, domain):
    plr = construct(oracle, domain, leaf="continuous", max_leaves=300)
    assert plr.domain == domain and plr.folded_domain != domain
    x = points(domain)
    most = 0.4 if isinstance(oracle, Dubins) else 0.06  # whose distance jumps
    assert np.abs(np.asarray(plr(x)) - oracle(x)).mean() < most
    assert np.isfinite(plr(np.stack([domain.lo, domain.hi]))).all()
    outside = x.copy()
    outside[:, 1] += np.where(x[:, 1] < oracle.goal[1], -1, 1) * domain.width[1]
    assert np.isinf(np.asarray(plr(outside))[~domain.contains(outside)]).all()
    for symmetry in oracle.symmetries if plr.tables.folding.mirrors else ():
        image = x @ symmetry.matrix.T + symmetry.offset
        inside = domain.contains(image)
        np.testing.assert_allclose(plr(image[inside]), plr(x[inside]), atol=2e-4)


@pytest.mark.parametrize("leaf", ["plane", "continuous"])
def test_images_get_one_answer_bit_for_bit_where_the_image_is_exact(leaf):
    plr = construct(*CASES["about"], leaf=leaf, max_leaves=50)
    x = points(WINDOW).astype(np.float32)
    for signs in ((-1, 1, -1), (1, -1, -1), (-1, -1, 1)):
        np.testing.assert_array_equal(plr(x * np.float32(signs)), plr(x))
        np.testing.assert_array_equal(leaf_of(plr, x * np.float32(signs)), leaf_of(plr, x))
    assert np.isfinite(jax.grad(plr)(jnp.zeros(3))).all()


def test_budgets_of_bytes_count_the_folding():
    plr = construct(*CASES["turned"], leaf="continuous", max_bytes=400)
    assert len(plr.to_bytes()) == plr.num_bytes <= 400


def test_boxes_of_leaves_fill_the_domain():
    plr = construct(*CASES["straight"], max_leaves=20)
    lo, hi = plr.leaf_boxes
    np.testing.assert_array_equal(leaf_of(plr, (lo + hi) / 2), plr.leaf_of_box)
    assert np.prod(hi - lo, axis=1).sum() == pytest.approx(25.0)
    assert plr.num_leaves == len(plr.cells) == len(plr.slope) == 20


def test_weights_count_where_any_image_has_one():
    """Accuracy is asked for on one side of the goal alone, on which the window has an image of all that is stored."""
    one_side = construct(
        *CASES["about"], max_leaves=40, options=BuildOptions(weight_fn=lambda x: (x[:, 0] >= 0).astype(float))
    )
    assert one_side.to_bytes() == construct(*CASES["about"], max_leaves=40).to_bytes()


def test_nothing_is_folded_of_a_function_that_states_nothing():
    oracle, domain = CASES["straight"]
    plr = construct(partial(Euclidean.__call__, oracle), domain, max_leaves=9)
    assert plr.tables.folding is None and plr.folded_domain == plr.domain
    assert Container.from_bytes(plr.to_bytes()).folding is None
