"""PLRs of distance functions that state symmetries, or a radial part."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from plr_jax import PLR, Box, Dubins, Euclidean, ReedsShepp, certify, construct, from_bytes, load, refine, save
from plr_jax.plr._location import leaf_of
from plr_jax.plr.file.container import Container

WINDOW = Box((-4, -4, -np.pi), (4, 4, np.pi), periodic=(False, False, True))
ASIDE = Box((-2, -4, -np.pi), (6, 3, np.pi), periodic=(False, False, True))
FAR = Box((998, -1e3 - 4, -np.pi), (1004, -1e3 + 2, np.pi), periodic=(False, False, True))
CASES = {
    "about": (ReedsShepp((0, 0, 0), 1), WINDOW),
    "aside": (ReedsShepp((1, 0.5, 0), 1), ASIDE),
    "turned": (ReedsShepp((1, 0.5, 0.6), 1), ASIDE),
    "far": (ReedsShepp((1e3, -1e3, 2), 1), FAR),
    "forward": (Dubins((0, 0, np.pi / 2), 1), WINDOW),
    "outside": (ReedsShepp((9, 9, 1), 1), WINDOW),
    "straight": (Euclidean((1, 2)), Box((-3, -1), (2, 4))),
}


@pytest.fixture(scope="module", params=CASES)
def folded(request):
    oracle, domain = CASES[request.param]
    return oracle, domain, construct(oracle, domain, leaf="continuous", max_leaves=300)


def points(domain, n=2000, seed=0):
    return np.random.default_rng(seed).uniform(domain.lo, domain.hi, (n, domain.dim))


def test_they_answer_near_the_distance_and_inf_outside(folded):
    oracle, domain, plr = folded
    assert plr.domain == domain and plr.folded_domain != domain
    x = points(domain)
    most = 0.4 if isinstance(oracle, Dubins) else 0.06  # whose distance jumps
    assert np.abs(np.asarray(plr(x)) - oracle(x)).mean() < most
    assert np.isfinite(plr(np.stack([domain.lo, domain.hi]))).all()
    outside = x.copy()
    outside[:, 1] += np.where(x[:, 1] < oracle.goal[1], -1, 1) * domain.width[1]
    assert np.isinf(np.asarray(plr(outside))[~domain.contains(outside)]).all()
    assert np.isnan(plr(np.full(domain.dim, np.nan)))


def test_images_get_one_answer(folded):
    oracle, domain, plr = folded
    x = points(domain)
    for symmetry in oracle.symmetries:
        image = x @ symmetry.matrix.T + symmetry.offset
        if plr.tables.folding.mirrors:
            inside = domain.contains(image)
            np.testing.assert_allclose(plr(image[inside]), plr(x[inside]), atol=2e-4)


@pytest.mark.parametrize("leaf", ["plane", "continuous"])
def test_images_get_one_answer_bit_for_bit_where_the_image_is_exact(leaf):
    plr = construct(*CASES["about"], leaf=leaf, max_leaves=200)
    x = points(WINDOW).astype(np.float32)
    for signs in ((-1, 1, -1), (1, -1, -1), (-1, -1, 1)):
        np.testing.assert_array_equal(plr(x * np.float32(signs)), plr(x))
        np.testing.assert_array_equal(leaf_of(plr, x * np.float32(signs)), leaf_of(plr, x))


def test_files_hold_all_of_them(folded, tmp_path):
    _, domain, plr = folded
    save(plr, tmp_path / "plr")
    again, x = load(tmp_path / "plr"), points(domain)
    assert again.to_bytes() == plr.to_bytes() and again.num_bytes == len(plr.to_bytes())
    np.testing.assert_array_equal(again(x), plr(x))
    assert again.folded_domain == plr.folded_domain


def test_budgets_of_bytes_count_the_folding():
    plr = construct(*CASES["turned"], leaf="continuous", max_bytes=400)
    assert len(plr.to_bytes()) == plr.num_bytes <= 400


def test_under_jit_vmap_and_in_stacks(folded):
    _, domain, plr = folded
    x = points(domain).astype(np.float32)
    answer = np.asarray(plr(jnp.asarray(x)))
    np.testing.assert_allclose(jax.jit(PLR.__call__)(plr, x), answer, atol=1e-5)
    np.testing.assert_allclose(jax.vmap(plr)(jnp.asarray(x)), answer, atol=1e-5)
    both = PLR.stack([plr, plr])(np.stack([x, x], axis=1).astype(np.float64))
    np.testing.assert_array_equal(both[:, 0], plr(x.astype(np.float64)))
    np.testing.assert_array_equal(both[:, 0], both[:, 1])


def test_gradients_are_those_of_the_answers():
    oracle, domain = CASES["turned"]
    plr = construct(oracle, domain, leaf="continuous", max_leaves=300)
    with jax.enable_x64(True):
        x = points(domain, 200)
        gradient = np.asarray(jax.vmap(jax.grad(plr))(jnp.asarray(x)))
        step = 1e-5
        for axis, unit in enumerate(np.eye(3)):
            ahead, behind = (np.asarray(plr(jnp.asarray(x + sign * step * unit))) for sign in (1, -1))
            difference = (ahead - behind) / (2 * step)
            assert np.mean(np.abs(difference - gradient[:, axis]) < 1e-3) > 0.97  # but beside faces


def test_gradients_are_finite_at_the_goal_and_zero_outside():
    oracle, domain = CASES["about"]
    plr = construct(oracle, domain, leaf="continuous", max_leaves=50)
    slope = jax.grad(plr)
    assert np.isfinite(slope(jnp.zeros(3))).all()
    for outside in ((9.0, 0.0, 0.0), (jnp.inf, 0.0, 0.0)):
        np.testing.assert_array_equal(slope(jnp.array(outside)), np.zeros(3))


def test_values_in_leaves_are_the_answers(folded):
    _, domain, plr = folded
    x = points(domain)
    np.testing.assert_allclose(plr.values_in_leaves(leaf_of(plr, x), x), plr(x), atol=2e-3, rtol=1e-5)


def test_boxes_of_leaves_fill_the_domain():
    oracle, domain = CASES["straight"]
    plr = construct(oracle, domain, max_leaves=20)
    lo, hi = plr.leaf_boxes
    middle = (lo + hi) / 2
    np.testing.assert_array_equal(leaf_of(plr, middle), plr.leaf_of_box)
    assert np.prod(hi - lo, axis=1).sum() == pytest.approx(25.0)
    assert plr.num_leaves == len(plr.cells) == len(plr.slope) == 20


def test_weights_count_where_any_image_has_one():
    """Accuracy is asked for on one side of the goal alone, on which the window has an image of all that is stored."""
    oracle, domain = CASES["about"]
    one_side = construct(oracle, domain, max_leaves=40, weight_fn=lambda x: (x[:, 0] >= 0).astype(float))
    assert one_side.to_bytes() == construct(oracle, domain, max_leaves=40).to_bytes()


def test_nothing_is_folded_of_a_function_that_states_nothing_or_for_cones():
    oracle, domain = CASES["straight"]
    for plr in (
        construct(partial(Euclidean.__call__, oracle), domain, max_leaves=9),
        construct(oracle, domain, leaf="cone", max_leaves=2),
    ):
        assert plr.tables.folding is None and plr.tables.radial == () and plr.folded_domain == plr.domain
        assert Container.from_bytes(plr.to_bytes()).folding is None


def test_what_is_not_known_of_folded_points_is_refused():
    oracle, domain = CASES["about"]
    plr = construct(oracle, domain, max_leaves=4)
    with pytest.raises(ValueError, match="cannot be refined"):
        refine(plr, points(domain), oracle(points(domain)))
    flat = construct(*CASES["straight"], max_leaves=4)
    with pytest.raises(ValueError, match="points are folded"):
        certify(flat, CASES["straight"][0])
    assert from_bytes(flat.to_bytes()).max_error is None


def test_folded_planes_are_refined():
    oracle, domain = CASES["straight"]
    plr = construct(oracle, domain, max_leaves=8)
    x = points(domain, 4000)
    refined, report = refine(plr, x, oracle(x), num_steps=20)
    assert report.refined.training.loss <= report.given.training.loss * 1.01
    assert refined.folded_domain == plr.folded_domain
