import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plr_helpers import random_partition

from plr_jax.plr.leaves.continuous.space import monomials, nodal_space, numbers_of_leaves
from plr_jax.plr.partition.cells import Cells, corner_bits, tree_of
from plr_jax.plr.partition.faces import face_points, shared_faces


def space_of(cells, tied=lambda faces: np.ones(len(faces), bool), periodic=()):
    tree = tree_of(cells)
    faces = shared_faces(tree, periodic)
    faces = faces[tied(faces)]
    return nodal_space(tree, faces, np.zeros(len(cells), bool)), faces


def evaluate(order, cells, numbers, leaf, x, derivative=None):
    """A leaf's function, or its derivative by fractions of the domain along an axis, power by power."""
    t = np.ldexp(x, cells.depth[leaf]) - cells.position[leaf]
    powers = np.stack(np.meshgrid(*[np.arange((2, 4)[order])] * cells.dim, indexing="ij"), -1).reshape(-1, cells.dim)
    factor = np.ones((len(t), len(powers)))
    for axis in range(cells.dim):
        power, along = powers[:, axis], t[:, axis, None]
        if axis == derivative:
            factor *= power * along ** np.maximum(power - 1, 0) * np.ldexp(1.0, cells.depth[leaf, axis])[:, None]
        else:
            factor *= along**power
    return np.sum(factor * (numbers.reshape(len(cells), -1)[leaf] @ monomials(order, cells.dim)), axis=1)


def points_on(cells, faces, rng):
    return face_points(cells, faces, rng.random((1, cells.dim)))[:, 0]


def corners_of(cells):
    return ((cells.position[:, None] + corner_bits(cells.dim)) * 0.5 ** cells.depth[:, None]).reshape(-1, cells.dim)


def test_a_hanging_node_is_the_middle_of_the_edge_it_hangs_on():
    halves = Cells.root(2).split(np.array([0]))
    cells = halves[[0]].append(halves[[1]].split(np.array([1])))
    space, _ = space_of(cells)
    assert len(space.masters) == 7  # nine points of three leaves, but (1/2, 1/2) hangs and (1, 1/2) is a point of two
    value = space.values @ np.arange(7.0)
    np.testing.assert_array_equal(
        value.reshape(3, 4)[1, 1], (value.reshape(3, 4)[0, 2] + value.reshape(3, 4)[0, 3]) / 2
    )


def test_what_is_not_tied_has_nodes_of_its_own():
    halves = Cells.root(2).split(np.array([0]))
    assert len(space_of(halves)[0].masters) == 6
    assert len(space_of(halves, lambda faces: np.zeros(len(faces), bool))[0].masters) == 8


def test_unreachable_leaves_have_no_values():
    halves = Cells.root(2).split(np.array([0]))
    tree = tree_of(halves)
    space = nodal_space(tree, shared_faces(tree)[:0], np.array([True, False]))
    assert len(space.masters) == 4
    assert (space.values @ np.ones(4)).tolist() == [0] * 4 + [1] * 4


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 10_000), dim=st.integers(1, 4), share=st.sampled_from([0.5, 0.9, 1.0]))
def test_functions_agree_across_every_tied_face(seed, dim, share):
    rng = np.random.default_rng(seed)
    cells = tree_of(random_partition(seed, dim, 25)).leaves
    space, faces = space_of(cells, lambda faces: rng.random(len(faces)) < share)
    numbers = numbers_of_leaves(0, space) @ rng.normal(size=len(space.masters))
    x = points_on(cells, faces, rng)
    sides = [evaluate(0, cells, numbers, leaf, x) for leaf in (faces.lower, faces.upper)]
    np.testing.assert_allclose(*sides, atol=1e-8)


def test_both_ends_of_a_periodic_axis_are_one():
    root = Cells.root(2)
    assert [len(space_of(root, periodic=periodic)[0].masters) for periodic in ((), (True, False), (True, True))] == [
        4,
        2,
        1,
    ]
    space, _ = space_of(root, periodic=(True, False))
    np.testing.assert_array_equal(space.values @ [3.0, 5.0], [3, 5, 3, 5])
    # Of the three leaves of a torus: (0, 0), (1/2, 0) and (0, 1/2), which hangs on the left half, as (1/2, 1/2) does.
    halves = Cells.root(2).split(np.array([0]))
    space, _ = space_of(halves[[0]].append(halves[[1]].split(np.array([1]))), periodic=(True, True))
    value = (space.values @ np.array([3.0, 5.0])).reshape(3, 4)
    np.testing.assert_array_equal(value, [[3, 3, 5, 5], [5, 5, 3, 3], [5, 5, 3, 3]])


@pytest.mark.parametrize("order", [0, 1])
@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 10_000), data=st.data())
def test_functions_agree_across_every_tied_face_of_a_torus(order, seed, data):
    """Seams among them: there the upper leaf is asked a period below; of order 1 for derivatives too."""
    rng, dim = np.random.default_rng(seed), data.draw(st.integers(1, 2 if order else 4))
    periodic = tuple(data.draw(st.lists(st.booleans(), min_size=dim, max_size=dim)))
    share = data.draw(st.sampled_from([0.5, 1.0]))
    cells = tree_of(random_partition(seed, dim, 25)).leaves
    space, faces = space_of(cells, lambda faces: rng.random(len(faces)) < share, periodic)
    numbers = numbers_of_leaves(order, space) @ rng.normal(size=len(space.masters))
    x = points_on(cells, faces, rng)
    beyond = x - (x == 1) * np.eye(dim)[faces.axis]
    for derivative in (None, *range(dim if order else 0)):
        below = evaluate(order, cells, numbers, faces.lower, x, derivative)
        above = evaluate(order, cells, numbers, faces.upper, beyond, derivative)
        np.testing.assert_allclose(below, above, atol=1e-7 * max(1, np.abs(below).max(initial=0)))


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 10_000), dim=st.integers(1, 3))
def test_on_a_torus_too_predictions_need_coarser_values_alone(seed, dim):
    cells = tree_of(random_partition(seed, dim, 25)).leaves
    space, _ = space_of(cells, periodic=(True,) * dim)
    row, column = space.prediction.nonzero()
    assert np.all(space.level[column] < space.level[row])
    of_domain = np.isin(corners_of(cells), [0, 1]).all(axis=1)
    assert len(np.unique(space.group[of_domain])) == 1  # all corners of a torus are one point
    np.testing.assert_allclose(space.values @ np.ones(len(space.masters)), 1)


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 10_000), dim=st.integers(1, 2), share=st.sampled_from([0.5, 0.9, 1.0]))
def test_gradients_of_order_one_agree_across_every_tied_face(seed, dim, share):
    rng = np.random.default_rng(seed)
    cells = tree_of(random_partition(seed, dim, 25)).leaves
    space, faces = space_of(cells, lambda faces: rng.random(len(faces)) < share)
    numbers = numbers_of_leaves(1, space) @ rng.normal(size=len(space.masters))
    x = points_on(cells, faces, rng)
    for derivative in (None, *range(dim)):
        sides = [evaluate(1, cells, numbers, leaf, x, derivative) for leaf in (faces.lower, faces.upper)]
        np.testing.assert_allclose(*sides, atol=1e-7 * max(1, np.abs(sides).max(initial=0)))


@pytest.mark.parametrize("order", [0, 1])
@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 10_000))
def test_linear_functions_are_among_them(order, seed):
    rng = np.random.default_rng(seed)
    cells = tree_of(random_partition(seed, 2, 25)).leaves
    space, _ = space_of(cells, lambda faces: rng.random(len(faces)) < 0.7)
    linear = 3 + corners_of(cells) @ [2.0, -5.0]
    of_group = np.empty(space.group.max() + 1)
    of_group[space.group] = linear
    numbers = numbers_of_leaves(order, space) @ of_group[space.masters]
    x = rng.random((200, 2))
    leaf = np.argmax(np.all(np.floor(np.ldexp(x[:, None], cells.depth)) == cells.position, axis=2), axis=1)
    np.testing.assert_allclose(evaluate(order, cells, numbers, leaf, x), 3 + x @ [2.0, -5.0], atol=1e-9)


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 10_000), dim=st.integers(1, 3))
def test_predictions_need_coarser_values_alone_and_are_right_for_linear_functions(seed, dim):
    rng = np.random.default_rng(seed)
    cells = tree_of(random_partition(seed, dim, 25)).leaves
    space, _ = space_of(cells, lambda faces: rng.random(len(faces)) < 0.7)
    row, column = space.prediction.nonzero()
    assert np.all(space.level[column] < space.level[row])
    of_group = np.empty(space.group.max() + 1)
    of_group[space.group] = 3 + corners_of(cells).sum(axis=1)
    predicted = space.prediction @ of_group[space.masters]
    np.testing.assert_allclose(predicted[space.level > 0], of_group[space.masters][space.level > 0], atol=1e-9)
