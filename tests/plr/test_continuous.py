"""Continuous leaves: spaces, fits, files; no jumps where one may walk."""

from dataclasses import replace
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plr_helpers import UNIT, cone, points, random_partition, three_leaves, walled

from plr_jax import BuildOptions
from plr_jax.plr import construct
from plr_jax.plr.faces import face_points, shared_faces
from plr_jax.plr.finite_elements import coefficient_matrix, design, monomials, nodal_space
from plr_jax.plr.leaves.continuous import FaceTests, StoredValues, TiedPartition, fit_values
from plr_jax.plr.sampling import Sampler, sample_pattern
from plr_jax.plr.tree import Cells, tree_of

# Function spaces of continuous leaves: a basis, and that functions agree wherever leaves are tied.


def evaluate(order, cells, numbers, leaf, x, derivative=None):
    """A leaf's function, or its derivative by fractions of the domain along an axis, power by power."""
    t = np.ldexp(x, cells.depth[leaf]) - cells.position[leaf]
    powers = np.array(list(product(range((2, 4)[order]), repeat=cells.dim)))
    factor = np.ones((len(t), len(powers)))
    for axis in range(cells.dim):
        power, along = powers[:, axis], t[:, axis, None]
        if axis == derivative:
            factor *= power * along ** np.maximum(power - 1, 0) * np.ldexp(1.0, cells.depth[leaf, axis])[:, None]
        else:
            factor *= along**power
    return np.sum(factor * (numbers.reshape(len(cells), -1)[leaf] @ monomials(order, cells.dim)), axis=1)


@pytest.mark.parametrize("order", [0, 1])
@given(seed=st.integers(0, 10_000), data=st.data())
def test_functions_agree_across_every_tied_face(order, seed, data):
    """Seams of a torus among them: there the upper leaf is asked a period below; of order 1 for derivatives too."""
    rng, dim = np.random.default_rng(seed), data.draw(st.integers(1, 2 if order else 4))
    periodic = tuple(data.draw(st.lists(st.booleans(), min_size=dim, max_size=dim)))
    share = data.draw(st.sampled_from([0.5, 0.9, 1.0]))
    tree = tree_of(random_partition(seed, dim, 25))
    cells, faces = tree.leaves, shared_faces(tree, periodic)
    faces = faces[rng.random(len(faces)) < share]
    space = nodal_space(tree, faces, np.zeros(len(cells), bool))
    numbers = coefficient_matrix(order, space) @ rng.normal(size=len(space.free_dofs))
    x = face_points(cells, faces, rng.random((1, dim)))[:, 0]
    beyond = x - (x == 1) * np.eye(dim)[faces.axis]
    for derivative in (None, *range(dim if order else 0)):
        below = evaluate(order, cells, numbers, faces.lower, x, derivative)
        above = evaluate(order, cells, numbers, faces.upper, beyond, derivative)
        np.testing.assert_allclose(below, above, atol=1e-7 * max(1, np.abs(below).max(initial=0)))


# Continuous leaves: no jumps where one may walk, exact for what they can hold, within limits, fitted densely.


STEP = 2.0**-22  # moves a 32-bit point of the unit square off a face


@pytest.fixture(scope="module", params=["continuous", "smooth"])
def leaf(request):
    return request.param


@pytest.fixture(scope="module")
def plr(leaf):
    return construct(walled, UNIT, leaf=leaf, max_leaves=100, options=BuildOptions(num_samples=48))


def both_sides_of_faces(plr, distance_fn):
    """Random points on faces, moved a step to either side, where both sides can be reached."""
    faces, w = shared_faces(tree_of(plr.cells)), np.random.default_rng(0).random((20, plr.dim))
    on_face = plr.domain.lo + plr.domain.width * face_points(plr.cells, faces, w)
    across = STEP * plr.domain.width * np.eye(plr.dim)[faces.axis][:, None]
    below, above = ((on_face + sign * across).reshape(-1, plr.dim) for sign in (-1, 1))
    free = np.isfinite(distance_fn(below)) & np.isfinite(distance_fn(above))
    assert free.sum() > 500
    return below[free].astype(np.float32), above[free].astype(np.float32)


def jump(plr, distance_fn):
    below, above = both_sides_of_faces(plr, distance_fn)
    return np.abs(np.asarray(plr(below)) - np.asarray(plr(above))).max()


def test_no_jump_across_free_faces_nor_of_gradients_of_order_one(plr, leaf):
    assert jump(plr, walled) <= 1.4e-5
    assert jump(construct(walled, UNIT, max_leaves=150), walled) > 1e-4  # points do tell leaves apart: planes jump
    gradient = jax.vmap(jax.grad(plr))
    below, above = (np.asarray(gradient(jnp.asarray(x))) for x in both_sides_of_faces(plr, walled))
    largest = np.abs(below - above).max()
    assert largest < 1e-3 if leaf == "smooth" else largest > 0.1


def test_nothing_blends_across_a_wall(plr):
    y = np.linspace(0.05, 0.6, 50)
    left, right = (np.stack([np.full(50, at), y], axis=1) for at in (0.4 - 1e-4, 0.5 + 1e-4))
    assert (walled(right) - walled(left)).min() > 0.2
    for side in (left, right):
        np.testing.assert_allclose(plr(side), walled(side), atol=0.03)


def test_linear_functions_are_held_across_leaves_and_walls(leaf, samples):
    def linear(x):
        return np.where(np.isfinite(walled(x)), 3 + x @ [2.0, -1.0], np.inf)

    plr, x = construct(linear, UNIT, leaf=leaf, tolerance=0), samples[0]
    assert plr.num_leaves < 200
    np.testing.assert_allclose(plr(x), linear(x), rtol=1e-5)


def test_at_equal_bytes_it_errs_less_than_planes(leaf, samples):
    tied, planes = (construct(walled, UNIT, max_bytes=600, leaf=each) for each in (leaf, "plane"))
    assert 570 <= tied.num_bytes <= 600
    x, distance = samples
    errors = [np.abs(np.asarray(plr(x)) - distance).mean() for plr in (tied, planes)]
    assert errors[0] < 0.8 * errors[1]


def test_limits_and_weights_are_kept():
    plr, x = construct(cone, UNIT, leaf="continuous", tolerance=0.01), points(5000, 0)
    assert np.abs(np.asarray(plr(x)) - cone(x)).max() < 0.015 and plr.num_leaves < 60
    weighted = construct(
        cone,
        UNIT,
        leaf="continuous",
        max_leaves=64,
        options=BuildOptions(weight_fn=lambda x: np.where(x[:, 0] > 0.5, 1.0, 0.001)),
    )
    assert np.mean(weighted.leaf_boxes[0][:, 0] >= 0.5) > 0.8
    deep = construct(
        lambda x: 10.0 * (x[:, 0] > 1 / 3) + cone(x), UNIT, leaf="continuous", max_leaves=60, max_depth=7
    )
    assert deep.depth == 7 and deep.num_leaves == 60
    for budget in (100, 300, 700):
        assert 0.95 * budget < construct(cone, UNIT, leaf="continuous", max_bytes=budget).num_bytes <= budget


@pytest.mark.parametrize("max_leaves", [100, 200, 400])
def test_exhausted_leaves_take_no_part_of_what_was_asked_for(max_leaves):
    """Leaves at a jump are halved until they may not be; once they were chosen, and 99, 193 and 380 leaves made."""

    def bumps_and_a_jump(x):
        return 2 + np.sin(40 * x[:, 0]) + 10 * (x[:, 0] > 1 / 3)

    plr = construct(
        bumps_and_a_jump,
        ([0.0], [1.0]),
        leaf="continuous",
        max_leaves=max_leaves,
        options=BuildOptions(num_samples=48),
    )
    assert plr.num_leaves == max_leaves


def space_and_fit(value):
    """A partition of 16 leaves, all tied, and samples of given values."""
    tree = tree_of(random_partition(4, 2, 15))
    fit = Sampler(lambda x: np.ones(len(x)), UNIT, None, *2 * [sample_pattern(2, 48, 0.0, 0)], 14)(tree.leaves)
    return nodal_space(tree, shared_faces(tree), np.zeros(16, bool)), replace(fit, value=value)


@pytest.mark.parametrize("order", [0, 1])
def test_values_are_those_of_a_dense_least_squares_fit(order):
    rng = np.random.default_rng(0)
    space, fit = space_and_fit(rng.normal(size=(16, 48)))
    weight = rng.random((16, 48))
    values, residual = fit_values(order, space, fit, weight)
    rows = np.kron(np.eye(16), design(order, (fit.pattern.u + 1) / 2)) @ coefficient_matrix(order, space).toarray()
    root = np.sqrt(weight).ravel()
    expected, *_ = np.linalg.lstsq(rows * root[:, None], fit.value.ravel() * root, rcond=None)
    np.testing.assert_allclose(values, expected, atol=1e-4)
    np.testing.assert_allclose(residual.ravel(), fit.value.ravel() - rows @ values, atol=1e-9)
    weight[2] = 0
    _, residual = fit_values(order, space, fit, weight)
    assert (residual[2] == 0).all() and (np.delete(residual, 2, axis=0) != 0).all()


def test_values_that_no_sample_holds_are_harmless():
    space, fit = space_and_fit(np.full((16, 48), 7.0))
    values, _ = fit_values(0, space, fit, np.where(np.arange(16) == 3, 1.0, 0.0)[:, None] * np.ones(48))
    np.testing.assert_allclose(values, 7.0, rtol=1e-6)


# Continuous leaves in files: the format stays, what is read is what was written, values are rounded.


def test_values_are_rounded_to_the_nearest_within_floats():
    tree = tree_of(three_leaves())
    faces = shared_faces(tree)
    partition = TiedPartition(tree, np.zeros(3, bool), faces, np.ones(len(faces), bool))
    values = np.random.default_rng(0).normal(size=len(partition.space.free_dofs))
    stored = StoredValues.quantize(partition, values, 0.1)
    assert np.abs(stored.decode() - values).max() <= 0.05 + 1e-6
    np.testing.assert_allclose(stored.step, 0.1, rtol=1e-6)
    with pytest.raises(ValueError, match="scale them down"):
        StoredValues.quantize(partition, np.full(len(values), 1e31), 1.0)


def test_a_face_on_the_edge_of_a_wall_is_not_free():
    halves = Cells.root(2).split(np.array([0]))
    tree = tree_of(halves.split(np.array([1, 1])))
    cells, faces = tree.leaves, shared_faces(tree)
    free = FaceTests(lambda x: np.where(x[:, 0] > 0.5, np.inf, 1.0), UNIT).are_free(cells, faces)
    np.testing.assert_array_equal(free, (faces.axis == 1) & (cells.position[faces.lower, 0] == 0))
