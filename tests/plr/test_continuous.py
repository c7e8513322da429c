"""Continuous and smooth leaves: function spaces, faces without jumps, fits, stored values."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plr_helpers import UNIT, cone, points, random_partition, three_leaves, walled

from plr_jax import BuildOptions
from plr_jax.plr import construct
from plr_jax.plr.finite_elements import basis_monomials, basis_values, coefficient_matrix, nodal_space
from plr_jax.plr.leaf_faces import face_points, shared_faces
from plr_jax.plr.leaves.continuous import FaceTests, StoredValues, TiedPartition, fit_values
from plr_jax.plr.sampling import Sampler, sample_pattern
from plr_jax.plr.tree import Cells, tree_of

# Function spaces.


def evaluate(order, cells, numbers, leaf, x, derivative=None):
    """Evaluate leaf functions, or their derivatives along an axis, power by power, at fractions of the domain."""
    t = np.ldexp(x, cells.depth[leaf]) - cells.position[leaf]
    powers = np.array(list(product(range((2, 4)[order]), repeat=cells.dim)))
    factor = np.ones((len(t), len(powers)))
    for axis in range(cells.dim):
        power, along = powers[:, axis], t[:, axis, None]
        if axis == derivative:
            factor *= power * along ** np.maximum(power - 1, 0) * np.ldexp(1.0, cells.depth[leaf, axis])[:, None]
        else:
            factor *= along**power
    return np.sum(factor * (numbers.reshape(len(cells), -1)[leaf] @ basis_monomials(order, cells.dim)), axis=1)


@pytest.mark.parametrize("order", [0, 1])
@given(seed=st.integers(0, 10_000), data=st.data())
def test_functions_agree_across_tied_faces(order, seed, data):
    """Also at seams of a torus, where the upper leaf is a period below. With order 1, derivatives agree, too."""
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


# PLRs of continuous and smooth leaves.


STEP = 2.0**-22  # moves a 32-bit point of the unit square off a face


@pytest.fixture(scope="session", params=["continuous", "smooth"])
def leaf(request):
    return request.param


def both_sides_of_faces(plr):
    """Return random points on faces, moved a step to either side, where both sides reach the goal."""
    faces, w = shared_faces(tree_of(plr.cells)), np.random.default_rng(0).random((10, plr.dim))
    on_face = face_points(plr.cells, faces, w)
    across = STEP * np.eye(plr.dim)[faces.axis][:, None]
    below, above = ((on_face + sign * across).reshape(-1, plr.dim) for sign in (-1, 1))
    free = np.isfinite(walled(below)) & np.isfinite(walled(above))
    assert free.sum() > 500
    return below[free], above[free]


def jumps(plr, shift=0.0):
    """Return how much values jump across faces, both asked at points moved by ``shift``, in their own leaves."""
    sides = both_sides_of_faces(plr)
    leaves = (plr.numpy().leaf(x.astype(np.float32)) for x in sides)
    below, above = (plr.values_in_leaves(leaf, x + shift) for leaf, x in zip(leaves, sides, strict=True))
    return below - above


def test_no_jumps_across_free_faces(plr, leaf):
    """Of smooth leaves, gradients do not jump either."""
    assert np.abs(jumps(plr)).max() <= 1.4e-5
    planes = construct(walled, UNIT, max_leaves=150)
    assert np.abs(jumps(planes)).max() > 1e-4  # points do tell leaves apart
    h = 1e-4
    gradient_jumps = [(jumps(plr, step) - jumps(plr, -step)) / (2 * h) for step in h * np.eye(2)]
    largest = np.abs(gradient_jumps).max()
    assert largest < 0.01 if leaf == "smooth" else largest > 0.1


def test_values_do_not_blend_across_a_wall(plr):
    y = np.linspace(0.05, 0.6, 50)
    left, right = (np.stack([np.full(50, at), y], axis=1) for at in (0.4 - 1e-4, 0.5 + 1e-4))
    assert (walled(right) - walled(left)).min() > 0.2
    for side in (left, right):
        np.testing.assert_allclose(plr(side), walled(side), atol=0.03)


def test_linear_functions_are_exact(leaf, samples):
    def linear(x):
        return np.where(np.isfinite(walled(x)), 3 + x @ [2.0, -1.0], np.inf)

    plr, x = construct(linear, UNIT, leaf=leaf, tolerance=0), samples[0]
    assert plr.num_leaves < 200
    np.testing.assert_allclose(plr(x), linear(x), rtol=1e-5)


def test_continuous_leaves_err_less_than_planes_of_equal_bytes(leaf, samples):
    tied, planes = (construct(walled, UNIT, max_bytes=300, leaf=each) for each in (leaf, "plane"))
    assert 280 <= tied.num_bytes <= 300
    x, distance = samples
    errors = [np.abs(np.asarray(plr(x)) - distance).mean() for plr in (tied, planes)]
    assert errors[0] < 0.8 * errors[1]


def build(distance_fn, domain=UNIT, **limits):
    options = BuildOptions(num_samples=48, weight_fn=limits.pop("weight_fn", None))
    return construct(distance_fn, domain, leaf="continuous", options=options, **limits)


def test_limits_and_weights_are_kept():
    plr, x = build(cone, tolerance=0.01), points(5000, 0)
    assert np.abs(np.asarray(plr(x)) - cone(x)).max() < 0.015 and plr.num_leaves < 60
    weighted = build(cone, max_leaves=64, weight_fn=lambda x: np.where(x[:, 0] > 0.5, 1.0, 0.001))
    assert np.mean(weighted.leaf_boxes[0][:, 0] >= 0.5) > 0.8
    deep = build(lambda x: 10.0 * (x[:, 0] > 1 / 3) + cone(x), max_leaves=60, max_depth=7)
    assert deep.depth == 7 and deep.num_leaves == 60
    for budget in (100, 300):
        assert 0.95 * budget < build(cone, max_bytes=budget).num_bytes <= budget


def test_leaves_that_may_not_be_split_take_no_part_of_the_limit():
    """Leaves at a jump become as small as allowed. They were once chosen nevertheless, and 99 leaves were made."""

    def bumps_and_a_jump(x):
        return 2 + np.sin(40 * x[:, 0]) + 10 * (x[:, 0] > 1 / 3)

    assert build(bumps_and_a_jump, ([0.0], [1.0]), max_leaves=100).num_leaves == 100


# Fits and stored values.


def space_and_fit(value):
    """Return the space of a partition of 16 leaves, all tied, and samples of given values."""
    tree = tree_of(random_partition(4, 2, 15))
    fit = Sampler(lambda x: np.ones(len(x)), UNIT, None, *2 * [sample_pattern(2, 48, 0.0, 0)], 14)(tree.leaves)
    return nodal_space(tree, shared_faces(tree), np.zeros(16, bool)), replace(fit, value=value)


@pytest.mark.parametrize("order", [0, 1])
def test_fitted_values_equal_dense_least_squares(order):
    rng = np.random.default_rng(0)
    space, fit = space_and_fit(rng.normal(size=(16, 48)))
    weight = rng.random((16, 48))
    values, residual = fit_values(order, space, fit, weight)
    rows = np.kron(np.eye(16), basis_values(order, (fit.pattern.u + 1) / 2)) @ coefficient_matrix(order, space)
    root = np.sqrt(weight).ravel()
    expected, *_ = np.linalg.lstsq(rows * root[:, None], fit.value.ravel() * root, rcond=None)
    np.testing.assert_allclose(values, expected, atol=1e-4)
    np.testing.assert_allclose(residual.ravel(), fit.value.ravel() - rows @ values, atol=1e-9)
    weight[2] = 0
    _, residual = fit_values(order, space, fit, weight)
    assert (residual[2] == 0).all() and (np.delete(residual, 2, axis=0) != 0).all()


def test_values_without_samples_continue_their_neighbors():
    space, fit = space_and_fit(np.full((16, 48), 7.0))
    values, _ = fit_values(0, space, fit, np.where(np.arange(16) == 3, 1.0, 0.0)[:, None] * np.ones(48))
    np.testing.assert_allclose(values, 7.0, rtol=1e-6)


def test_stored_values_are_rounded_to_the_nearest_step():
    tree = tree_of(three_leaves())
    faces = shared_faces(tree)
    partition = TiedPartition(tree, np.zeros(3, bool), faces, np.ones(len(faces), bool))
    values = np.random.default_rng(0).normal(size=len(partition.space.free_dofs))
    stored = StoredValues.quantize(partition, values, 0.1)
    assert np.abs(stored.decode() - values).max() <= 0.05 + 1e-6
    np.testing.assert_allclose(stored.step, 0.1, rtol=1e-6)
    with pytest.raises(ValueError, match="scale them down"):
        StoredValues.quantize(partition, np.full(len(values), 1e31), 1.0)


def test_faces_on_the_edge_of_a_wall_are_not_free():
    halves = Cells.root(2).split(np.array([0]))
    tree = tree_of(halves.split(np.array([1, 1])))
    cells, faces = tree.leaves, shared_faces(tree)
    free = FaceTests(lambda x: np.where(x[:, 0] > 0.5, np.inf, 1.0), UNIT).are_free(cells, faces)
    np.testing.assert_array_equal(free, (faces.axis == 1) & (cells.position[faces.lower, 0] == 0))
