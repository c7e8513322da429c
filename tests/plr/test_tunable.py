"""Tunable PLRs: answers, gradients, training by optax, and the files of trained values."""

import re
from dataclasses import replace
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from jax.core import Tracer
from plr_helpers import INDEPENDENT, LINEAR, cone, points
from portable_helpers import case, compiled_answers, full, hard_points, same_bits
from vectors import vector_names

from plr_jax import Box, construct, from_bytes
from plr_jax.plr.leaf_faces import face_points, shared_faces
from plr_jax.plr.tree import tree_of

QUICK = "around", "far from the origin"
REST = [name.replace("_", " ") for name in vector_names() if "cone" not in name and name != "around"]
FINE = 10**6  # bytes, enough for the finest step


@cache
def plr_of(name):
    """Return a PLR; the corner of the domain far from the origin is no 32-bit float."""
    far = Box((500_000.3, 4_000_000.7), (505_000.3, 4_004_000.7))
    return construct(lambda x: cone(x - far.lo), far, max_leaves=20) if name == "far from the origin" else case(name)


def with_other_values(tunable, seed=0):
    change = np.random.default_rng(seed).normal(size=tunable.values.shape) * np.std(tunable.values)
    return replace(tunable, values=tunable.values + jnp.asarray(change, jnp.float32))


@pytest.mark.parametrize("name", full(*QUICK))
def test_answers_in_64_bits(name):
    with jax.enable_x64(True):
        test_answers_and_gradients_are_those_of_a_file_with_these_values(name)


@pytest.mark.parametrize("name", [*QUICK, *full(*REST)])
def test_answers_and_gradients_are_those_of_a_file_with_these_values(name):
    """The file decodes its values and continues planes into unreachable leaves in its own way."""
    plr = plr_of(name)
    tunable, x = plr.tunable(), hard_points(plr, 500)
    assert same_bits(tunable(x), compiled_answers(plr, x))
    other = with_other_values(tunable)
    twin = from_bytes(other.to_plr().to_bytes())
    read = replace(tunable, values=twin.tunable().values)
    step = 0.0 if getattr(twin.stored, "bits", None) == 32 else twin.stored.step
    scale = float(np.abs(read.values).max())
    assert step <= 1.001 * plr.stored.step
    np.testing.assert_allclose(read.values, other.values, rtol=0, atol=0.501 * step + 1e-7 * scale)
    np.testing.assert_array_equal(twin.cells.hashes(), plr.cells.hashes())
    for of_type in {np.dtype(np.float32), x.dtype}:
        answers, expected = read(x.astype(of_type)), compiled_answers(twin, x.astype(of_type))
        np.testing.assert_allclose(answers, expected, rtol=1e-5, atol=5e-6 * scale)
    y = jnp.asarray(x[np.isfinite(compiled_answers(plr, x))][:200], jnp.float32)
    slopes = [jax.jit(jax.vmap(jax.grad(fn)))(y) for fn in (read, twin)]
    np.testing.assert_allclose(*slopes, rtol=1e-4, atol=1e-4 * np.abs(slopes[1]).max())


@pytest.mark.parametrize("name", ["cut off continuous", *full(*QUICK, "maze of gradients")])
def test_gradient_by_values_is_the_slope_of_answers(name):
    """Answers are linear in the values, so differences of answers are exact, up to rounding."""
    plr = plr_of(name)
    tunable, x = plr.tunable(), hard_points(plr, 500)
    x = x[np.isfinite(compiled_answers(plr, x))]
    weight = np.random.default_rng(1).normal(size=len(x)).astype(np.float32)
    loss = jax.jit(lambda fn: weight @ fn(x))
    gradient, other = jax.grad(loss)(tunable), with_other_values(tunable)
    assert jax.tree.structure(gradient) == jax.tree.structure(other) and np.count_nonzero(gradient.values) > 0
    change = np.asarray(other.values, float) - np.asarray(tunable.values, float)
    size = np.abs(weight) @ np.abs(np.asarray(other(x)) - np.asarray(tunable(x)))
    assert abs(float(loss(other) - loss(tunable)) - np.sum(change * gradient.values)) < 2e-5 * size
    both = jax.tree.map(lambda *values: jnp.stack(values), tunable, other)
    np.testing.assert_allclose(jax.vmap(lambda fn: fn(x))(both), [tunable(x), other(x)], rtol=1e-5, atol=1e-5)


def trained(tunable, x, target, steps):
    """Train a tunable PLR by optax; also return how often the step was compiled."""
    optimizer = optax.adam(0.02)

    @partial(jax.jit, donate_argnums=0)
    def step(fn, state):
        gradient = jax.grad(lambda fn: jnp.mean((fn(x) - target) ** 2))(fn)
        updates, state = optimizer.update(gradient, state, fn)
        return optax.apply_updates(fn, updates), state

    state = optimizer.init(tunable)
    for _ in range(steps):
        tunable, state = step(tunable, state)
    return tunable, step._cache_size()


def jumps(plr, shift=0.0):
    """Return how much values jump across tied faces, both asked at points moved by ``shift``, in their own leaves."""
    cells = plr.cells
    partition = getattr(plr.stored, "partition", None)
    faces = shared_faces(tree_of(cells)) if partition is None else partition.faces[partition.tied]
    x = face_points(cells, faces, points(5, 0)).reshape(-1, 2) + shift
    below, above = (plr.values_in_leaves(np.repeat(leaf, 5), x) for leaf in (faces.lower, faces.upper))
    return (below - above)[np.isfinite(below) & np.isfinite(above)]


KINDS = [("smooth", 50), *(pytest.param(leaf, 1000, marks=pytest.mark.full) for leaf in LINEAR)]


@pytest.mark.parametrize(("leaf", "steps"), KINDS, indirect=["leaf"])
def test_trained_leaves_fit_and_do_not_jump(plr, leaf, x, steps):
    target = 2 + np.sin(5 * x[:, 0]) * cone(x)
    tunable, compiled = trained(plr.tunable(), x, target, steps)
    result = tunable.to_plr(FINE)
    errors = [np.abs(np.asarray(fn(x)) - target)[np.isfinite(plr(x))].mean() for fn in (plr, tunable, result)]
    assert compiled == 1 and errors[1] < (0.6 if steps == 50 else 0.05) * errors[0]
    scale = np.abs(tunable.values).max()
    rounding = np.abs(np.asarray(tunable(x)) - np.asarray(result(x)))[np.isfinite(plr(x))].max()
    assert rounding < (1e-5 if leaf in INDEPENDENT else 1e-6) * scale
    h = 1e-6
    slopes = np.abs([(jumps(result, step) - jumps(result, -step)) / (2 * h) for step in h * np.eye(2)])
    assert len(jumps(result)) > 300
    assert np.abs(jumps(result)).max() <= 1e-6 * scale if leaf not in INDEPENDENT else len(set(jumps(result))) > 300
    assert slopes.max() <= 1e-5 * scale if leaf == "smooth" else slopes.max() > 0.1


def test_files_of_initial_values_and_of_byte_limits(plr, leaf):
    """The initial values give the same file, and a file is as fine as its limit allows."""
    tunable = plr.with_label("map").tunable()
    assert tunable.to_plr().to_bytes() == plr.with_label("map").to_bytes()
    other = with_other_values(tunable)
    with pytest.raises(ValueError, match="max_bytes must be at least") as error:
        other.to_plr(1)
    least = int(re.search(r"least (\d+)", str(error.value))[1])
    sizes = [other.to_plr(limit).num_bytes for limit in (least, 2 * least, 3 * least)]
    assert sizes[0] == least and 1.8 * least < sizes[1] <= 2 * least and 2.7 * least < sizes[2] <= 3 * least
    with pytest.raises(ValueError, match=f"at least {least}"):
        other.to_plr(least - 1)
    assert leaf in INDEPENDENT or other.to_plr(FINE).stored.step < plr.stored.step


@pytest.mark.usefixtures("unchecked_types")
def test_errors_and_what_a_tunable_plr_tells(x):
    plr = case("maze of values")
    tunable = plr.tunable()
    with pytest.raises(ValueError, match="Nothing is proven"):
        tunable.to_plr().bounds(x)
    assert tunable.domain == plr.domain and tunable.dim == 2 and repr(plr) in repr(tunable)
    assert jax.tree.structure(tunable) == jax.tree.structure(plr.tunable())
    fresh = from_bytes(plr.to_bytes())
    np.testing.assert_array_equal(jax.jit(lambda x: fresh.tunable()(x) + 1)(x), tunable(x) + 1)
    assert not isinstance(fresh.tunable().values, Tracer)
    with pytest.raises(ValueError) as error:
        case("maze of cones").tunable()
    assert all(repr(name) in str(error.value) for name in (*LINEAR, "cone"))
    with pytest.raises(ValueError, match="outside of jit"):
        jax.jit(lambda plr: plr.tunable().values)(plr)
    with pytest.raises(ValueError, match="stacked"):
        jax.tree.map(lambda *arrays: jnp.stack(arrays), plr, plr).tunable()
    with pytest.raises(ValueError, match="shape"):
        replace(tunable, values=tunable.values[None])(x)
    for values, message in ((tunable.values[1:], "shape"), (jnp.nan * tunable.values, "finite")):
        with pytest.raises(ValueError, match=message):
            replace(tunable, values=values).to_plr()
    for name in ("maze of values", "maze of planes"):
        large = case(name).tunable()
        with pytest.raises(ValueError, match="1e\\+30"):
            replace(large, values=1e35 * large.values).to_plr()
    with pytest.raises(ValueError, match="max_bytes must be an integer"):
        tunable.to_plr(1.5)
