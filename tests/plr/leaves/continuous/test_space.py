"""Function spaces of continuous leaves: a basis, and that functions agree wherever leaves are tied."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plr_helpers import random_partition, three_leaves

from plr_jax.plr.faces import face_points, shared_faces
from plr_jax.plr.finite_elements import design, monomials, nodal_space, numbers_of_leaves
from plr_jax.plr.tree import Cells, corner_bits, tree_of

SEEDS, HALVES = st.integers(0, 10_000), Cells.root(2).split(np.array([0]))


def powers_of(order, dim):
    return np.stack(np.meshgrid(*[np.arange((2, 4)[order])] * dim, indexing="ij"), -1).reshape(-1, dim)


@pytest.mark.parametrize("order", [0, 1])
@settings(deadline=None, max_examples=20)
@given(seed=SEEDS, dim=st.integers(1, 3))
def test_functions_are_their_powers(order, seed, dim):
    t = np.random.default_rng(seed).random((20, dim))
    by_power = np.prod(t[:, None] ** powers_of(order, dim), axis=2) @ monomials(order, dim).T
    np.testing.assert_allclose(design(order, t), by_power, atol=1e-12)


@pytest.mark.parametrize("order", [0, 1])
def test_numbers_are_the_values_at_the_corners_and_the_cubics_derivatives(order):
    corners, step = corner_bits(2).astype(float), 1e-6 * np.array([0.0, 1.0])
    np.testing.assert_allclose(design(order, corners).reshape(4, 4, -1)[:, :, 0], np.eye(4), atol=1e-12)
    if order == 1:
        slope = (design(1, corners + step) - design(1, corners - step)).reshape(4, 4, 4) / 2e-6
        np.testing.assert_allclose(slope[:, :, 1], np.eye(4), atol=1e-5)  # the second number is the slope along y
        np.testing.assert_allclose(slope[:, :, 0], 0, atol=1e-5)


def space_of(cells, tied=lambda faces: np.ones(len(faces), bool), periodic=()):
    tree = tree_of(cells)
    faces = shared_faces(tree, periodic)
    faces = faces[tied(faces)]
    return nodal_space(tree, faces, np.zeros(len(cells), bool)), faces


def evaluate(order, cells, numbers, leaf, x, derivative=None):
    """A leaf's function, or its derivative by fractions of the domain along an axis, power by power."""
    t = np.ldexp(x, cells.depth[leaf]) - cells.position[leaf]
    powers = powers_of(order, cells.dim)
    factor = np.ones((len(t), len(powers)))
    for axis in range(cells.dim):
        power, along = powers[:, axis], t[:, axis, None]
        if axis == derivative:
            factor *= power * along ** np.maximum(power - 1, 0) * np.ldexp(1.0, cells.depth[leaf, axis])[:, None]
        else:
            factor *= along**power
    return np.sum(factor * (numbers.reshape(len(cells), -1)[leaf] @ monomials(order, cells.dim)), axis=1)


def corners_of(cells):
    return ((cells.position[:, None] + corner_bits(cells.dim)) * 0.5 ** cells.depth[:, None]).reshape(-1, cells.dim)


def test_a_hanging_node_is_the_middle_of_the_edge_it_hangs_on():
    space, _ = space_of(three_leaves())
    assert len(space.masters) == 7  # nine points of three leaves, but (1/2, 1/2) hangs and (1, 1/2) is a point of two
    value = (space.values @ np.arange(7.0)).reshape(3, 4)
    np.testing.assert_array_equal(value[1, 1], (value[0, 2] + value[0, 3]) / 2)


def test_what_is_not_tied_has_nodes_of_its_own_and_what_is_unreachable_has_none():
    assert len(space_of(HALVES)[0].masters) == 6
    assert len(space_of(HALVES, lambda faces: np.zeros(len(faces), bool))[0].masters) == 8
    tree = tree_of(HALVES)
    space = nodal_space(tree, shared_faces(tree)[:0], np.array([True, False]))
    assert len(space.masters) == 4 and (space.values @ np.ones(4)).tolist() == [0] * 4 + [1] * 4


def test_both_ends_of_a_periodic_axis_are_one():
    root, around = Cells.root(2), ((), (True, False), (True, True))
    assert [len(space_of(root, periodic=periodic)[0].masters) for periodic in around] == [4, 2, 1]
    space, _ = space_of(root, periodic=(True, False))
    np.testing.assert_array_equal(space.values @ [3.0, 5.0], [3, 5, 3, 5])
    # Of the three leaves of a torus: (0, 0), (1/2, 0) and (0, 1/2), which hangs on the left half, as (1/2, 1/2) does.
    space, _ = space_of(three_leaves(), periodic=(True, True))
    value = (space.values @ np.array([3.0, 5.0])).reshape(3, 4)
    np.testing.assert_array_equal(value, [[3, 3, 5, 5], [5, 5, 3, 3], [5, 5, 3, 3]])


@pytest.mark.parametrize("order", [0, 1])
@settings(deadline=None, max_examples=60)
@given(seed=SEEDS, data=st.data())
def test_functions_agree_across_every_tied_face(order, seed, data):
    """Seams of a torus among them: there the upper leaf is asked a period below; of order 1 for derivatives too."""
    rng, dim = np.random.default_rng(seed), data.draw(st.integers(1, 2 if order else 4))
    periodic = tuple(data.draw(st.lists(st.booleans(), min_size=dim, max_size=dim)))
    share = data.draw(st.sampled_from([0.5, 0.9, 1.0]))
    cells = tree_of(random_partition(seed, dim, 25)).leaves
    space, faces = space_of(cells, lambda faces: rng.random(len(faces)) < share, periodic)
    numbers = numbers_of_leaves(order, space) @ rng.normal(size=len(space.masters))
    x = face_points(cells, faces, rng.random((1, dim)))[:, 0]
    beyond = x - (x == 1) * np.eye(dim)[faces.axis]
    for derivative in (None, *range(dim if order else 0)):
        below = evaluate(order, cells, numbers, faces.lower, x, derivative)
        above = evaluate(order, cells, numbers, faces.upper, beyond, derivative)
        np.testing.assert_allclose(below, above, atol=1e-7 * max(1, np.abs(below).max(initial=0)))


def of_masters(space, values):
    """Of values at the corners of all leaves those of the masters."""
    of_group = np.empty(space.group.max() + 1)
    of_group[space.group] = values
    return of_group[space.masters]


@pytest.mark.parametrize("order", [0, 1])
@settings(deadline=None, max_examples=30)
@given(seed=SEEDS)
def test_linear_functions_are_among_them(order, seed):
    rng, cells = np.random.default_rng(seed), tree_of(random_partition(seed, 2, 25)).leaves
    space, _ = space_of(cells, lambda faces: rng.random(len(faces)) < 0.7)
    numbers = numbers_of_leaves(order, space) @ of_masters(space, 3 + corners_of(cells) @ [2.0, -5.0])
    x = rng.random((200, 2))
    leaf = np.argmax(np.all(np.floor(np.ldexp(x[:, None], cells.depth)) == cells.position, axis=2), axis=1)
    np.testing.assert_allclose(evaluate(order, cells, numbers, leaf, x), 3 + x @ [2.0, -5.0], atol=1e-9)


@settings(deadline=None, max_examples=60)
@given(seed=SEEDS, dim=st.integers(1, 3), periodic=st.booleans())
def test_predictions_need_coarser_values_alone_and_are_right_for_linear_functions(seed, dim, periodic):
    rng, cells = np.random.default_rng(seed), tree_of(random_partition(seed, dim, 25)).leaves
    space, _ = space_of(cells, lambda faces: (rng.random(len(faces)) < 0.7) | periodic, (periodic,) * dim)
    row, column = space.prediction.nonzero()
    assert np.all(space.level[column] < space.level[row])
    np.testing.assert_allclose(space.values @ np.ones(len(space.masters)), 1)
    if periodic:  # all corners of a torus are one point
        assert len(np.unique(space.group[np.isin(corners_of(cells), [0, 1]).all(axis=1)])) == 1
    else:
        values, is_finer = of_masters(space, 3 + corners_of(cells).sum(axis=1)), space.level > 0
        np.testing.assert_allclose((space.prediction @ values)[is_finer], values[is_finer], atol=1e-9)
