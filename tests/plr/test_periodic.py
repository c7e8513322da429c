"""PLRs of domains with periodic axes, such as angles: no seam anywhere."""

import itertools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from plr_helpers import UNIT, random_contents, walled

from plr_jax import VisibilityGraph, scenes
from plr_jax.geometry.box import Box
from plr_jax.oracles import Euclidean
from plr_jax.plr import PLR, certify, construct, from_bytes, refine, sample_faces
from plr_jax.plr._assembly import plr_of_leaves
from plr_jax.plr._file import encode
from plr_jax.plr._location import leaf_of
from plr_jax.plr.certificate.certificate import Certificate, Proof

PI = np.pi
PERIOD = np.array([2 * PI, 0.0])
CYLINDER = Box((-PI, 0), (PI, 2), periodic=(True, False))
TORUS = Box((-PI, 0), (PI, 1), periodic=(True, True))
GOAL = np.array([2.5, 0.4])


def around(domain, goal, x):
    """Distance to a goal by brute force: to all of its images a period away or less."""
    turns = itertools.product(*[(-1, 0, 1) if periodic else (0,) for periodic in domain.periodic])
    return np.min([np.linalg.norm(x - goal - np.array(turn) * domain.width, axis=1) for turn in turns], axis=0)


def on_cylinder(x):
    return around(CYLINDER, GOAL, x)


def inside(domain, n, seed=0):
    return np.random.default_rng(seed).uniform(domain.lo, domain.hi, (n, domain.dim))


def at_seam(n=200):
    """Points at the lower end of the angle."""
    return np.column_stack([np.full(n, -PI), np.linspace(0, 2, n)])


@pytest.fixture(scope="module", params=["plane", "continuous", "smooth"])
def plr(request):
    return construct(on_cylinder, CYLINDER, leaf=request.param, max_leaves=150)


def test_both_ends_of_the_axis_have_one_value_bit_for_bit(plr):
    x = at_seam()
    expected = np.asarray(plr(x))
    for turns in (1, 2, 5, -1, -3):
        np.testing.assert_array_equal(plr(x + turns * PERIOD), expected)
    lower, upper = (jnp.asarray(x + turns * PERIOD, jnp.float32) for turns in (0, 1))
    np.testing.assert_array_equal(plr(upper), plr(lower))
    np.testing.assert_array_equal(plr(np.asarray(upper)), expected)
    np.testing.assert_array_equal(jax.jit(plr)(upper), expected)


def test_ends_that_floats_hold_have_one_value_however_many_turns_away():
    domain = Box((-1, 0), (3, 1), periodic=(True, False))
    for leaf in ("plane", "continuous"):
        plr = construct(lambda x: around(domain, np.array([2.9, 0.4]), x), domain, leaf=leaf, max_leaves=60)
        x = jnp.stack([jnp.full(50, -1.0), jnp.linspace(0, 1, 50)], axis=1)
        for turns in (1, 2, 7, -1, -6):
            np.testing.assert_array_equal(plr(x + turns * jnp.array([4.0, 0])), plr(x))


@pytest.mark.parametrize("leaf", ["continuous", "smooth"])
def test_tied_leaves_do_not_jump_at_the_seam(leaf):
    plr = construct(on_cylinder, CYLINDER, leaf=leaf, max_leaves=150)
    x, step = at_seam(), np.array([1e-6, 0.0])
    below, above = (np.asarray(plr((x + sign * step).astype(np.float32))) for sign in (-1, 1))
    assert np.abs(above - below).max() < 2e-5
    # Where the seam is an edge like any other, they do.
    flat = construct(on_cylinder, Box(CYLINDER.lo, CYLINDER.hi), leaf=leaf, max_leaves=150)
    assert np.abs(np.asarray(flat(x)) - np.asarray(flat(x + PERIOD))).max() > 1e-3
    if leaf == "smooth":
        gradient = jax.vmap(jax.grad(plr))
        sides = (np.asarray(gradient(jnp.asarray(x + sign * step))) for sign in (-1, 1))
        np.testing.assert_allclose(*sides, atol=1e-3)


@pytest.mark.parametrize("leaf", ["plane", "continuous", "smooth"])
@pytest.mark.parametrize("domain", [CYLINDER, TORUS], ids=["cylinder", "torus"])
def test_distances_around_are_those_by_brute_force(domain, leaf):
    def distance(x):
        assert (~np.array(domain.periodic) | ((domain.lo <= x) & (x <= domain.hi))).all()
        return around(domain, GOAL, x)

    plr = construct(distance, domain, leaf=leaf, max_leaves=300, margin=0.3 if leaf == "plane" else 0)
    x = inside(domain, 2000)
    away = x + np.random.default_rng(1).integers(-3, 4, x.shape) * domain.width * domain.periodic
    error = np.abs(np.asarray(plr(away)) - around(domain, GOAL, x))
    assert error.mean() < 0.006
    np.testing.assert_allclose(plr(away), plr(x), atol=2e-5 if leaf != "plane" else 0.05)


@pytest.mark.parametrize("leaf", ["plane", "continuous"])
def test_poses_that_turn(leaf):
    domain = Box((0, 0, -PI), (1, 1, PI), periodic=(False, False, True))
    goal = np.array([0.3, 0.6, 3.0])
    plr = construct(lambda x: around(domain, goal, x), domain, leaf=leaf, max_leaves=600)
    x, turn = inside(domain, 500), np.array([0, 0, 2 * PI])
    assert np.abs(np.asarray(plr(x)) - around(domain, goal, x)).mean() < 0.05
    x[:, 2] = -PI
    np.testing.assert_array_equal(plr(x + turn), plr(x))
    if leaf == "continuous":
        np.testing.assert_allclose(plr(x + turn - [0, 0, 1e-6]), plr(x), atol=1e-5)


def test_nothing_blends_across_a_wall_at_the_seam():
    def distance(x):
        return np.where(np.abs(x[:, 0]) > PI - 0.1, np.inf, np.linalg.norm(x - GOAL, axis=1))

    plr = construct(distance, CYLINDER, leaf="continuous", max_leaves=150)
    y = np.linspace(0, 2, 50)
    for angle in (-PI + 0.11, PI - 0.11):
        x = np.stack([np.full(50, angle), y], axis=1)
        np.testing.assert_allclose(plr(x), distance(x), atol=0.05)


@pytest.mark.parametrize("leaf", ["plane", "continuous", "smooth"])
@pytest.mark.parametrize("seed", range(2))
def test_files_of_any_partition_of_a_torus(leaf, seed):
    contents = random_contents(seed, 2, leaf, periodic=(bool(seed % 2), True))
    plr = from_bytes(encode(contents))
    assert plr.to_bytes() == encode(contents) and plr.domain == contents.domain
    x = inside(plr.domain, 200, seed)
    away = x + 2 * plr.domain.width * plr.domain.periodic
    np.testing.assert_array_equal(leaf_of(plr, away), leaf_of(plr, x))
    np.testing.assert_allclose(plr(away), plr(x), atol=1e-3)


def test_compiled_or_not_one_by_one_or_at_once(plr):
    x = jnp.asarray(4 * inside(CYLINDER, 100) - 3, jnp.float32)
    expected = np.asarray(plr(x))
    assert np.isfinite(expected).any() and np.isinf(expected).any()  # the other axis has ends
    np.testing.assert_array_equal(jax.jit(plr)(x), expected)
    np.testing.assert_array_equal(jax.jit(lambda plr, x: plr(x))(plr, x), expected)
    np.testing.assert_array_equal([plr(one) for one in x], expected)
    np.testing.assert_array_equal(jax.vmap(plr)(x), expected)


def test_gradients_pass_through_the_wrap(plr):
    x = jnp.asarray(inside(CYLINDER, 100), jnp.float32)
    gradient = jax.vmap(jax.grad(plr))
    np.testing.assert_allclose(gradient(x + jnp.array([4 * PI, 0])), gradient(x), atol=2e-3)
    assert (np.abs(np.asarray(gradient(x))).max(axis=1) > 0.1).all()
    assert np.isfinite(np.asarray(gradient(jnp.array([[jnp.inf, 0], [9.0, 5.0], [9.0, 0.5]])))).all()


def test_what_is_not_finite_is_outside_or_nan(plr):
    x = np.array([[np.inf, 1], [-np.inf, 1], [np.nan, 1], [50, 2.1], [50, np.nan], [1e30, 1]])
    for points in (x, jnp.asarray(x)):
        found = np.asarray(plr(points))
        np.testing.assert_array_equal(np.isinf(found), [True, True, False, True, False, False])
        np.testing.assert_array_equal(np.isnan(found), [False, False, True, False, True, False])


def test_a_stack_equals_the_plrs_bit_for_bit(plr):
    far = Box((1e6, 0), (1e6 + 2 * PI, 2), periodic=(True, False))
    plrs = [plr, construct(walled, UNIT, max_leaves=30), construct(on_cylinder, far, max_leaves=30)]
    q = np.random.default_rng(0).uniform(-10, 10, (200, 3, 3))
    q[:, :, 1] = np.abs(q[:, :, 1]) / 8
    q[:, 2, 0] += 1e6
    q[:3, :, 0] = PI, 3 * PI, np.nan
    found = PLR.stack(plrs)(q)
    for i, each in enumerate(plrs):
        np.testing.assert_array_equal(found[:, i], np.asarray(each(q[:, i, :2]), np.float64))
    assert np.isfinite(found[3:, 0]).sum() > 150


def test_far_from_the_origin_points_are_wrapped_in_64_bits():
    far = Box((1e6, 0), (1e6 + 2 * PI, 2), periodic=(True, False))
    goal = np.array([1e6 + 6.1, 0.4])
    plr = construct(lambda x: around(far, goal, x), far, leaf="continuous", max_leaves=150)
    x = inside(far, 500)
    away = x + np.random.default_rng(1).integers(-2, 3, (500, 1)) * [far.width[0], 0]
    np.testing.assert_allclose(plr(away), plr(x), atol=2e-6)
    assert np.abs(np.asarray(plr(away)) - around(far, goal, x)).mean() < 0.01
    x[:, 0] = 1e6
    np.testing.assert_array_equal(plr(x + np.array([far.width[0], 0])), plr(x))
    np.testing.assert_array_equal(leaf_of(plr, away), leaf_of(plr, far.wrapped(away)))


def test_in_64_bits(plr):
    x = inside(CYLINDER, 300)
    away = x + 20 * PI * np.array([1, 0])
    with jax.enable_x64(True):
        twin = from_bytes(plr.to_bytes())
        expected = np.asarray(twin(x))
        assert expected.dtype == np.float64
        for points in (away, jnp.asarray(away)):
            is_near = np.abs(np.asarray(twin(points)) - expected) < 1e-9
            assert is_near.mean() > (0.99 if plr.leaf.name == "plane" else 0.9999)
        upper = jnp.asarray(at_seam() + PERIOD)
        np.testing.assert_allclose(jax.jit(twin)(upper), twin(at_seam()), atol=1e-9)


def test_values_in_leaves_are_asked_for_the_nearest_image(plr):
    x = inside(CYLINDER, 300)
    leaf = leaf_of(plr, x)
    for turns in (0, 1, -2):
        values = plr.values_in_leaves(leaf, x + turns * PERIOD)
        np.testing.assert_allclose(values, plr(x), atol=1e-5)
    # The faces of the leaves at both ends of the axis meet.
    lo, hi = plr.leaf_boxes
    first, last = np.flatnonzero(lo[:, 0] == -PI), np.flatnonzero(hi[:, 0] == PI)
    corner = lo[first]
    np.testing.assert_allclose(
        plr.values_in_leaves(first, corner + PERIOD), plr.values_in_leaves(first, corner), atol=1e-9
    )
    assert len(last) and np.isfinite(plr.values_in_leaves(last, lo[last] + 7 * PERIOD)).all()


def test_bounds_are_wrapped_too():
    contents = random_contents(3, 2, "plane", periodic=(True, True))
    codes = np.random.default_rng(0).integers(0, 256, (2, len(contents.cells))).astype(np.uint8)
    plr = plr_of_leaves(replace(contents, certificate=Certificate(0.5, codes, Proof.OPEN_LEAVES)))
    x = inside(plr.domain, 200)
    np.testing.assert_allclose(plr.bounds(x + 2 * plr.domain.width), plr.bounds(x), atol=1e-4)
    np.testing.assert_allclose(plr.lower(x - plr.domain.width), plr.lower(x), atol=1e-4)


def test_other_domains_are_not_wrapped():
    plr = construct(walled, UNIT, max_leaves=20)
    assert plr.tables.periodic == () and plr._placement is None
    assert "floor" not in str(jax.make_jaxpr(plr)(jnp.zeros(2)))
    assert not from_bytes(plr.to_bytes()).domain.is_periodic
    assert np.isinf(plr(np.array([1.5, 0.5])))


def test_refinement_goes_around():
    x = inside(CYLINDER, 4000)
    plr = construct(on_cylinder, CYLINDER, leaf="continuous", max_leaves=40)
    refined, report = refine(plr, x, on_cylinder(x))
    assert refined.domain == CYLINDER
    assert report.refined.training.rms < 1.05 * report.given.training.rms
    faces = sample_faces(refined, on_cylinder)
    lower, upper = faces.leaves.T
    lo, hi = refined.leaf_boxes
    assert ((hi[lower, 0] == PI) & (lo[upper, 0] == -PI) & (faces.x[:, 0] == PI)).sum() > 5
    assert np.abs(faces.jumps(refined)).max() < 1e-9


@pytest.mark.parametrize("fit", [construct, lambda *args, **options: construct(*args, max_bytes=500, **options)])
def test_cones_are_refused(fit):
    with pytest.raises(ValueError, match="Leaves of kind 'cone' hold Euclidean distances"):
        fit(Euclidean(GOAL), CYLINDER, leaf="cone")


def test_files_of_cones_are_refused():
    cones = construct(Euclidean((0.5, 0.5)), UNIT, leaf="cone", max_leaves=5)
    contents = replace(cones._contents, domain=Box((0, 0), (1, 1), periodic=(True, False)))
    with pytest.raises(ValueError, match="Use continuous ones or planes"):
        from_bytes(encode(contents))


def test_proofs_are_refused():
    problem = scenes.maze()
    oracle = VisibilityGraph(problem.workspace, problem.goals[0])
    domain = Box((0, 0), (1, 1), periodic=(True, False))
    with pytest.raises(ValueError, match="the plane, which has no periodic axis"):
        construct(oracle, domain, certified=True)
    plr = construct(oracle, domain, max_leaves=10)
    with pytest.raises(ValueError, match="Build the PLR without one"):
        certify(plr, oracle)
