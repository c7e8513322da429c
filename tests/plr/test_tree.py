"""Cells, trees and faces, compared with all pairs of boxes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plr_helpers import contents_of_planes, random_partition

from plr_jax.geometry.box import Box
from plr_jax.plr._file import filled_coefficients
from plr_jax.plr.leaf_faces import corner_parents, face_points, overlapping_leaves, shared_faces
from plr_jax.plr.leaf_faces import neighbor_of_largest_contact as lenders
from plr_jax.plr.leaves.plane import quantize
from plr_jax.plr.tree import Cells, corner_bits, tree_of


@given(seed=st.integers(0, 10_000), dim=st.integers(1, 4), num_splits=st.integers(0, 60))
def test_trees_order_leaves_independently_of_their_input(seed, dim, num_splits):
    cells = random_partition(seed, dim, num_splits)
    shuffled = cells[np.random.default_rng(seed).permutation(len(cells))]
    leaves, again = tree_of(cells).leaves, tree_of(shuffled).leaves
    np.testing.assert_array_equal(again.position, leaves.position)
    np.testing.assert_array_equal(shuffled[tree_of(shuffled).order].position, leaves.position)
    rows = np.concatenate([leaves.depth, leaves.position], axis=1).tolist()
    assert sorted(rows) == sorted(np.concatenate([cells.depth, cells.position], axis=1).tolist())


def unit_boxes(cells):
    return cells.boxes(Box(np.zeros(cells.dim), np.ones(cells.dim)))


def listed(faces):
    return list(zip(faces.lower.tolist(), faces.upper.tolist(), faces.axis.tolist(), strict=True))


@given(seed=st.integers(0, 1000), dim=st.integers(1, 3), wraps=st.integers(0, 7))
def test_faces_equal_those_of_all_pairs_of_boxes(seed, dim, wraps):
    periodic = tuple(bool(wraps >> axis & 1) for axis in range(dim))
    tree = tree_of(random_partition(seed, dim, 20))
    lo, hi = unit_boxes(tree.leaves)
    expected = {}
    for a, b, axis in np.ndindex(len(lo), len(lo), dim):
        low, high = np.maximum(lo[a], lo[b]), np.minimum(hi[a], hi[b])
        at_seam = periodic[axis] and hi[a, axis] == 1 and lo[b, axis] == 0
        if (hi[a, axis] == lo[b, axis] or at_seam) and (low < high)[np.arange(dim) != axis].all():
            low[axis] = high[axis] = hi[a, axis]
            expected[a, b, axis] = low, high
    faces = shared_faces(tree, periodic)
    assert sorted(expected) == listed(faces)
    ends = face_points(tree.leaves, faces, np.repeat([[0.0], [1.0]], dim, axis=1))
    np.testing.assert_array_equal(ends, np.array([expected[face] for face in listed(faces)]).reshape(ends.shape))


@given(seed=st.integers(0, 1000), dim=st.integers(1, 3))
def test_corners_are_the_middle_of_their_parents(seed, dim):
    tree = tree_of(random_partition(seed, dim, 20))
    cells = tree.leaves
    ends, is_made = corner_parents(tree)
    corner = ((cells.position[:, None] + corner_bits(dim)) * 0.5 ** cells.depth[:, None]).reshape(-1, dim)
    middle = corner[ends].mean(axis=2)
    np.testing.assert_array_equal(middle[is_made], corner.reshape(*is_made.shape, dim)[is_made])
    np.testing.assert_array_equal(is_made, ~np.isin(corner, [0, 1]).all(axis=1).reshape(is_made.shape))


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_overlapping_leaves_equal_overlapping_boxes(dim):
    for seed in range(5):
        a, b = (tree_of(random_partition(seed + shift, dim, 30)) for shift in (0, 100))
        (lo_a, hi_a), (lo_b, hi_b) = unit_boxes(a.leaves), unit_boxes(b.leaves)
        meet = np.all((lo_a[:, None] < hi_b) & (lo_b < hi_a[:, None]), axis=2)
        assert sorted(zip(*overlapping_leaves(a, b), strict=True)) == sorted(zip(*np.nonzero(meet), strict=True))


# Leaves that lend to blocked ones.


@given(seed=st.integers(0, 1000), dim=st.integers(1, 3), wraps=st.integers(0, 7))
def test_neighbors_of_largest_contact_equal_all_pairs(seed, dim, wraps):
    tree, periodic = tree_of(random_partition(seed, dim, 25)), tuple(bool(wraps >> axis & 1) for axis in range(dim))
    cells = tree.leaves
    blocked = np.random.default_rng(seed).random(len(cells)) < 0.6
    lo, hi = unit_boxes(cells)
    slot = 0.5 ** cells.depth.max(axis=0)  # the narrowest there is
    borrowers = np.flatnonzero(blocked)
    found = lenders(tree, borrowers, np.flatnonzero(~blocked), periodic)
    for leaf, lender in zip(borrowers, found, strict=True):
        shares = np.ones(len(cells))
        for axis in range(dim):
            overlap = np.minimum(hi[:, axis], hi[leaf, axis]) - np.maximum(lo[:, axis], lo[leaf, axis])
            around = (np.minimum(lo[:, axis], lo[leaf, axis]) == 0) & (np.maximum(hi[:, axis], hi[leaf, axis]) == 1)
            touch = (overlap == 0) | (around if periodic[axis] else False)
            shares *= np.where(overlap > 0, overlap, np.where(touch, slot[axis] / 2**20, 0.0))
        shares[blocked] = 0.0
        assert lender == (np.argmax(shares) if shares.any() else -1)


@pytest.mark.parametrize("wraps", [False, True])
def test_blocked_leaves_continue_the_plane_of_a_neighbor(wraps):
    """Slabs of the plane ``1 + 14 x + 7 y``, which goes on across a seam at ``x`` below 0, which is the last slab.

    And a larger borrower: the left half continues ``3 y`` of the upper right quarter.
    """
    center = np.array([1 + 14 / 8 + 7 / 2, np.inf, np.inf, np.inf])
    half = np.array([[14 / 8, 7 / 2]] + [[0.0, 0.0]] * 3)
    slabs = Cells.root(2).split(np.array([0])).split(np.array([0, 0]))
    domain = Box((0, 0), (1, 1), periodic=(wraps, False))
    coefficients = filled_coefficients(contents_of_planes(slabs, quantize(center, half, 32), domain))
    np.testing.assert_allclose(coefficients[1], [1 + 14 * 3 / 8 + 7 / 2, 14 / 8, 7 / 2])
    np.testing.assert_allclose(coefficients[3], [1 - 14 / 8 + 7 / 2, 14 / 8, 7 / 2] if wraps else [np.inf, 0, 0])
    np.testing.assert_array_equal(coefficients[2], [np.inf, 0, 0])
    left, right = (Cells.root(2).split(np.array([0]))[[side]] for side in (0, 1))
    low, high = (right.split(np.array([1]))[[side]] for side in (0, 1))
    cells = left.append(low.split(np.array([1])), high)
    planes = quantize(np.array([np.inf, np.inf, np.inf, 9 / 4]), np.array([[0, 0]] * 3 + [[0, 3 / 4]]), 32)
    coefficients = filled_coefficients(contents_of_planes(cells, planes))
    np.testing.assert_allclose(coefficients[[0, 2]], [[1.5, 0, 1.5], [9 / 8, 0, 3 / 8]])
    assert np.isinf(coefficients[:, 0]).tolist() == [False, True, False, False]
