"""PLRs of all kinds: compiled and not, their gradients, in files and stacks, in 64 bits, and outside the domain."""

from functools import cache, partial
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from portable_helpers import case, full, is_far

from plr_jax import PLR, Box, Euclidean, Workspace, construct, construct_pairs, evaluate, from_bytes, stack

KINDS = ("maze of cones", "maze of gradients", "around", "around twice", "folded car", "far planes")
BOTH = full("far folded car")  # mirrors and points in 64 bits, which quick tests have one by one
COMPILED = pytest.mark.parametrize("name", [KINDS[0], *full(*KINDS[1:]), *BOTH])
# Quickly: cones with a proof; mirrors and a period; points in 64 bits. Tests of stacks have all leaf models.
STACKED = ["maze of cones", "folded car", "far planes", *full("maze of gradients", "around", "around twice"), *BOTH]
OUTSIDE = ("inf", "clamp", "nan")


@pytest.fixture(scope="module", params=[*KINDS, *BOTH])
def plr(request):
    return case(request.param)


def around(plr, n=500, seed=0):
    """Return points of a box three times as wide, half of them outside along some axis."""
    rng, domain = np.random.default_rng(seed), plr.domain
    return rng.uniform(domain.lo - domain.width, domain.hi + domain.width, (n, domain.dim))


def not_finite(plr):
    """Return the middle of the domain, its first coordinate replaced by NaN, inf and -inf."""
    middle, first = (plr.domain.lo + plr.domain.hi) / 2, np.eye(plr.dim)[0] > 0
    return np.array([np.where(first, bad, middle) for bad in (np.nan, np.inf, -np.inf)])


def clamped(domain, x):
    """Return the nearest point of the domain, and the distance to it."""
    nearest = np.where(domain.periodic, x, np.clip(x, domain.lo, domain.hi))
    return nearest, np.linalg.norm(x - nearest, axis=-1)


@jax.jit
def values_and_gradients(plr, x):
    """Return values and gradients of points evaluated one by one, outside inf or clamped."""
    return [jax.vmap(jax.value_and_grad(partial(plr, outside=outside)))(x) for outside in ("inf", "clamp")]


@cache
def compiled_answers(name):
    """Return points, the last two of which are infinite, and what one program answers there."""
    plr = case(name)
    x = jnp.asarray(np.concatenate([around(plr), not_finite(plr)[1:]]), jnp.float32)
    return x, *jax.tree.map(np.asarray, values_and_gradients(plr, x))


@COMPILED
def test_compiled_answers_equal_answers_of_one_point(name):
    plr, (x, (values, _), (clamped, _)) = case(name), compiled_answers(name)
    close = {"rtol": 1e-6, "atol": 0 if plr.tables.folding is None else 1e-5}
    assert np.isfinite(values).any()
    np.testing.assert_allclose(values, plr(x), **close)
    np.testing.assert_allclose([plr(each) for each in x[:20]], values[:20], **close)
    np.testing.assert_allclose(clamped, plr(x, outside="clamp"), **close)


@COMPILED
def test_gradients_equal_finite_differences(name):
    """Differences of a leaf's function, which needs no step into another leaf. Clamped, gradients lead back."""
    plr, (x, (values, gradient), (_, clamped_gradient)) = case(name), compiled_answers(name)
    assert (gradient[-2:] == 0).all() and (clamped_gradient[-2:] == 0).all()  # infinite
    exact = np.asarray(x[:-2], np.float64)
    values, gradient, clamped_gradient = values[:-2], gradient[:-2], clamped_gradient[:-2]
    nearest, way = clamped(plr.domain, exact)
    assert (gradient[way > 1e-3 * plr.domain.width.max()] == 0).all()
    assert np.isfinite(clamped_gradient).all()
    beyond = np.abs(exact - nearest) > 1e-3 * plr.domain.width
    outward = (exact - nearest) / np.maximum(way, 1e-9)[:, None]
    np.testing.assert_allclose(clamped_gradient[beyond], outward[beyond], atol=1e-2)
    inside = np.isfinite(values)
    np.testing.assert_allclose(clamped_gradient[inside], gradient[inside], atol=1e-5)
    points, leaf = exact[inside], plr.numpy().leaf(exact[inside])
    scale = np.maximum(np.linalg.norm(gradient[inside], axis=1), 0.1)
    for axis, step in enumerate(1e-6 * np.diag(plr.domain.width)):
        slope = plr.values_in_leaves(leaf, points + step) - plr.values_in_leaves(leaf, points - step)
        is_near = np.abs(slope / (2 * step[axis]) - gradient[inside, axis]) < 1e-3 * scale
        assert is_near.mean() > 0.97  # in 32 bits, some points are in another leaf


TWICE = [
    KINDS[0],
    *full(*KINDS[1:]),
    *BOTH,
    *full("cones in space", "maze of values", "straight bound", "estimate of planes"),
]


@pytest.mark.parametrize("name", TWICE)
def test_hessians_equal_differences_of_gradients(name):
    with jax.enable_x64(True):
        plr = from_bytes(case(name).to_bytes())
        functions = [plr, partial(plr, outside="clamp")]
        if name != KINDS[0]:
            functions += [partial(stack([plr]), 0), *([] if plr.band is None else [plr.lower])]

        @jax.jit
        def derivatives(x):
            return [(jax.vmap(jax.grad(f))(x), jax.vmap(jax.hessian(f))(x)) for f in functions]

        x, steps = around(plr, 150), np.vstack([np.zeros(plr.dim), 1e-6 * np.diag(plr.domain.width)])
        x = np.concatenate([x, not_finite(plr)[1:]])
        moved = np.concatenate([x + step for step in (*steps, *-steps)])
        answers = jax.tree.map(np.asarray, derivatives(moved))
    for gradient, hessian in answers:
        after, before = np.split(gradient.reshape(-1, *x.shape), 2)
        expected = ((after - before)[1:] / (2 * steps[1:].max(axis=1)[:, None, None])).transpose(1, 2, 0)
        scale = np.maximum(np.abs(expected).max(axis=(1, 2)), 0.1 / plr.domain.width.max())
        is_near = np.abs(hessian[: len(x)] - expected).max(axis=(1, 2)) < 1e-6 * scale
        assert is_near.mean() > 0.97
        assert all((each[len(x) - 2 : len(x)] == 0).all() for each in (gradient, hessian))
    curved = np.abs(answers[0][1]).max() > 0.1
    assert curved == (plr.leaf.name != "plane" or plr.tables.straight is not None)


def test_points_outside_are_clamped_to_the_nearest_point(plr):
    """The distance to that point is added. Without clamping, answers outside are inf or NaN."""
    x = around(plr)
    nearest, way = clamped(plr.domain, x)
    is_outside = way > 0
    assert is_outside.sum() > 50 or plr.domain.periodic == (True, True)
    value = plr(x, outside="clamp")
    inset = plr.domain.lo + np.clip((nearest - plr.domain.lo) / plr.domain.width, 1e-5, 1 - 1e-5) * plr.domain.width
    inset = np.where(plr.domain.periodic, nearest, inset)  # from where rounding does not lead outside
    expected = np.asarray(plr(inset), np.float64) + way
    close = np.isclose(value, expected, rtol=1e-5, atol=1e-3 * plr.domain.width.max())
    assert close.mean() > 0.97  # the others are beside a face across which the function jumps
    np.testing.assert_array_equal(evaluate(plr, x, outside="clamp"), value)
    np.testing.assert_array_equal(np.isnan(plr(x, outside="nan")), is_outside)
    assert np.isinf(plr(x))[is_outside].all()
    inside = np.concatenate([x[~is_outside], [plr.domain.lo, plr.domain.hi]])
    single = jnp.asarray(x, jnp.float32)
    finite = np.isfinite(plr(single))
    for outside in OUTSIDE:
        np.testing.assert_array_equal(plr(inside, outside=outside), plr(inside))
        np.testing.assert_array_equal(plr(single, outside=outside)[finite], plr(single)[finite])
        bad, answers = not_finite(plr), [np.nan] + 2 * [np.nan if outside == "nan" else np.inf]
        for points in (bad, jnp.asarray(bad)):
            np.testing.assert_array_equal(plr(points, outside=outside), answers)
    far = (plr.domain.lo + plr.domain.hi) / 2 + 1e30 * np.eye(plr.dim)[0]  # as long a way as floats go
    if not plr.domain.periodic[0]:
        np.testing.assert_allclose(plr(far, outside="clamp"), 1e30, rtol=1e-5)


def test_files_and_arrays_keep_all_of_a_plr(plr):
    x = around(plr)
    labeled = jax.tree.map(jnp.array, plr.with_label("x" * 1000)).with_label("")  # sizes of tables ignore labels
    for again in (from_bytes(plr.to_bytes()), jax.tree.map(jnp.array, plr), labeled):
        assert again.to_bytes() == plr.to_bytes() and again.num_bytes == len(plr.to_bytes())
        assert again.folded_domain == plr.folded_domain and again.max_error == plr.max_error
        np.testing.assert_array_equal(again(x), plr(x))
    inside = x[clamped(plr.domain, x)[1] == 0]
    found = plr.values_in_leaves(plr.numpy().leaf(inside), inside)
    is_near = np.isclose(found, plr(inside), rtol=1e-5, atol=2e-3)
    assert is_near.mean() > (0.99 if is_far(plr) else 0.999)


@pytest.mark.usefixtures("unchecked_types")
def test_plr_of_other_arrays_answers_by_them_but_has_no_file(plr):
    arrays, structure = jax.tree.flatten(plr)
    numbers = next(i for i, array in enumerate(arrays) if array is plr.tables.leaf_parameters)
    changed = structure.unflatten([*arrays[:numbers], 1.5 * arrays[numbers], *arrays[numbers + 1 :]])
    # Doubling changes the bytes of the file too.
    doubled, several = (jax.tree.map(lambda *a, f=f: f(a), plr, plr) for f in (sum, np.stack))
    x, rows = around(plr), [(changed, "built with the file"), (doubled, "built with the file"), (several, "stacked")]
    calls = [PLR.to_bytes, lambda plr: plr.max_error, lambda plr: plr.with_label("a")]
    for call, (each, message) in product(calls, rows):
        with pytest.raises(ValueError, match=message):
            call(each)
    of_file = [lambda plr: plr.with_nearest_goal(len).c_header("a")] + [lambda plr: plr(x)] * is_far(plr)
    for call in of_file + [lambda plr: plr.bounds(x), lambda plr: plr.lower] * (plr.band is not None):
        with pytest.raises(ValueError, match="built with the file"):
            call(changed)
    assert "replaced" in repr(doubled) and changed.num_leaves == plr.num_leaves
    assert is_far(plr) or np.mean(changed(x) == plr(x)) < 0.9


def test_64_bit_mode_answers_in_64_bits(plr):
    x = np.random.default_rng(2).uniform(plr.domain.lo, plr.domain.hi, (300, plr.dim))
    single = x.astype(np.float32)
    with jax.enable_x64(True):
        twin = from_bytes(plr.to_bytes())
        for answer in (twin(x), twin(jnp.asarray(x))):
            assert answer.dtype == np.float64
            assert np.isclose(answer, np.asarray(twin(x)), rtol=1e-9, atol=1e-9).mean() > 0.99
        assert np.isclose(answer, plr(x if is_far(plr) else single), rtol=1e-4, atol=1e-3).mean() > 0.98
        assert plr(single).dtype == np.float32 and plr(x).dtype == np.float64
    assert plr(x).dtype == np.float32  # what was decided for one mode of JAX is not kept for the other


@pytest.mark.parametrize("plr", STACKED, indirect=True)
def test_stacks_answer_as_their_plrs(plr):
    other = construct(Euclidean(plr.domain.lo), Box(plr.domain.lo, plr.domain.hi), max_leaves=20)
    stacked, x = stack([plr, other]), around(plr) if is_far(plr) else jnp.asarray(around(plr), jnp.float32)
    for outside in OUTSIDE:
        for index, each in enumerate((plr, other)):
            found, expected = stacked(index, x, outside=outside), each(x, outside=outside)
            np.testing.assert_allclose(found, expected, rtol=2e-6, atol=2e-6 * plr.domain.width.max())
    if plr.band is not None:
        twice = stack([plr, plr])
        for found, expected in zip((twice.lower(1, x), twice.bounds(1, x)[1]), plr.bounds(x), strict=True):
            np.testing.assert_allclose(found, expected, rtol=2e-6, atol=2e-6 * plr.domain.width.max())
    with pytest.raises(ValueError, match="stack must have a proof"):
        stacked.lower(0, x)
    q = np.stack([around(plr), around(plr, seed=3)], axis=1)
    answers = [np.asarray(plr(q[:, 0]), np.float64), np.asarray(other(q[:, 1]), np.float64)]
    np.testing.assert_array_equal(PLR.stack([plr, other])(q), np.stack(answers, axis=1))


def test_points_clamped_in_64_bits_are_inside():
    domain = Box((1 / 3, -0.1), (2 / 3, 1e-9))
    plr = construct(Euclidean((0.5, 0)), domain, max_leaves=30)
    with jax.enable_x64(True):
        for reach in (1.0, 1e-15, 1e-12):
            away = reach * np.array([[1, 1], [0, 1], [1, 0]])
            x = np.concatenate([domain.lo - away, domain.hi + away])
            assert np.isfinite(plr(x, outside="clamp")).all()


@pytest.mark.full
def test_pairs_outside_add_the_distances_of_both_ends():
    pairs = construct_pairs(
        Workspace(((0, 0), (1, 1)), [[(0.4, 0), (0.5, 0), (0.5, 0.7), (0.4, 0.7)]]), max_bytes=300
    )
    x, y = np.random.default_rng(1).uniform(-1, 2, (2, 300, 2))
    (near_x, way_x), (near_y, way_y) = clamped(pairs.domain, x), clamped(pairs.domain, y)
    value = pairs(x, y, outside="clamp")
    np.testing.assert_allclose(value, pairs(near_x, near_y) + way_x + way_y, rtol=1e-5, atol=1e-5)
    is_outside = (way_x > 0) | (way_y > 0)
    assert np.isinf(pairs(x, y))[is_outside].all()
    np.testing.assert_array_equal(np.isnan(pairs(x, y, outside="nan")), is_outside)
    np.testing.assert_array_equal(value[~is_outside], pairs(x, y)[~is_outside])
    x[:2, 0] = np.nan, np.inf
    np.testing.assert_array_equal(pairs(x, y, outside="clamp")[:2], [np.nan, np.inf])


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize("outside", ["clip", None, 0, ["clamp"]])
def test_unknown_value_of_outside_raises(outside):
    plr, x = case("one leaf"), np.zeros((3, 2))
    for ask in (plr, partial(stack([plr]), 0), plr.numpy(), lambda x, **kwargs: plr.numpy()([0.5, 0.5], **kwargs)):
        with pytest.raises(ValueError, match="outside must be 'inf', 'clamp' or 'nan'"):
            ask(x, outside=outside)
