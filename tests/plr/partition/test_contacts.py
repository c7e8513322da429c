import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from plr_helpers import contents_of_planes, random_partition

from plr_jax.geometry.box import Box
from plr_jax.plr._file import filled_coefficients
from plr_jax.plr.leaves.plane import encode_planes
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.partition.faces import neighbor_of_largest_contact


def lenders(cells, blocked, periodic=()):
    """For each blocked leaf the one that lends to it; -1 for none."""
    blocked = np.array(blocked, bool)
    return neighbor_of_largest_contact(cells, np.flatnonzero(blocked), np.flatnonzero(~blocked), periodic)


def slabs():
    """Four slabs: [0, 1/4], [1/4, 1/2], [1/2, 3/4] and [3/4, 1] along axis 0."""
    halves = Cells.root(2).split(np.array([0]))
    return halves.split(np.array([0, 0]))


def l_shape():
    """The left half, and of the right one its lowest quarter, the one above, and the upper half."""
    halves = Cells.root(2).split(np.array([0]))
    right = halves[[1]].split(np.array([1]))
    return halves[[0]].append(right[[0]].split(np.array([1])), right[[1]])


def test_only_direct_neighbors_lend():
    assert lenders(slabs(), [False, True, True, True]).tolist() == [0, -1, -1]


def test_neighbors_across_a_seam_lend():
    assert lenders(slabs(), [False, True, True, True], (True, False)).tolist() == [0, -1, 0]
    assert lenders(slabs(), [False, True, True, True], (False, True)).tolist() == [0, -1, -1]
    # The two halves touch in two places, of which none counts twice.
    assert lenders(l_shape(), [False, True, False, False], (True, True)).tolist() == [0]


def test_the_largest_contact_lends():
    assert lenders(l_shape(), [True, False, False, False]).tolist() == [3]


def test_nobody_to_lend_or_to_borrow():
    assert lenders(slabs(), [False] * 4).tolist() == []
    assert lenders(slabs(), [True] * 4).tolist() == [-1] * 4


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), dim=st.integers(1, 3))
def test_exactly_the_blocked_leaves_that_touch_an_open_one_borrow_from_one_of_those(seed, dim):
    cells = random_partition(seed, dim, 25)
    blocked = np.random.default_rng(seed).random(len(cells)) < 0.7
    lo, hi = cells.boxes(Box(np.zeros(dim), np.ones(dim)))
    for leaf, lender in zip(np.flatnonzero(blocked), lenders(cells, blocked), strict=True):
        touches = ~blocked & np.all((lo <= hi[leaf]) & (hi >= lo[leaf]), axis=1)
        assert touches[lender] if lender >= 0 else not touches.any()


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 1000), dim=st.integers(1, 3), wraps=st.integers(0, 7))
def test_lenders_are_those_of_all_pairs(seed, dim, wraps):
    cells, periodic = random_partition(seed, dim, 25), tuple(bool(wraps >> axis & 1) for axis in range(dim))
    blocked = np.random.default_rng(seed).random(len(cells)) < 0.6
    lo, hi = cells.boxes(Box(np.zeros(dim), np.ones(dim)))
    slot = 0.5 ** cells.depth.max(axis=0)  # the narrowest there is
    for leaf, lender in zip(np.flatnonzero(blocked), lenders(cells, blocked, periodic), strict=True):
        shares = np.ones(len(cells))
        for axis in range(dim):
            overlap = np.minimum(hi[:, axis], hi[leaf, axis]) - np.maximum(lo[:, axis], lo[leaf, axis])
            around = (np.minimum(lo[:, axis], lo[leaf, axis]) == 0) & (np.maximum(hi[:, axis], hi[leaf, axis]) == 1)
            touch = (overlap == 0) | (around if periodic[axis] else False)
            shares *= np.where(overlap > 0, overlap, np.where(touch, slot[axis] / 2**20, 0.0))
        shares[blocked] = 0.0
        assert lender == (np.argmax(shares) if shares.any() else -1)


def test_a_borrower_continues_the_lenders_plane_and_the_others_answer_inf():
    """The plane ``1 + 14 x + 7 y``, whose value in the middle of the first slab is 1 + 14 / 8 + 7 / 2."""
    center = np.array([1 + 14 / 8 + 7 / 2, np.inf, np.inf, np.inf])
    half = np.array([[14 / 8, 7 / 2]] + [[0.0, 0.0]] * 3)
    contents = contents_of_planes(slabs(), encode_planes(center, half, 32))
    coefficients = filled_coefficients(contents)
    np.testing.assert_allclose(coefficients[1], [1 + 14 * 3 / 8 + 7 / 2, 14 / 8, 7 / 2])
    np.testing.assert_array_equal(coefficients[2:], [[np.inf, 0, 0]] * 2)


def test_a_borrower_continues_the_plane_across_the_seam():
    """The plane ``1 + 14 x + 7 y`` of the first slab goes on at ``x`` below 0, which is the last slab."""
    center = np.array([1 + 14 / 8 + 7 / 2, np.inf, np.inf, np.inf])
    half = np.array([[14 / 8, 7 / 2]] + [[0.0, 0.0]] * 3)
    domain = Box((0, 0), (1, 1), periodic=(True, False))
    coefficients = filled_coefficients(contents_of_planes(slabs(), encode_planes(center, half, 32), domain))
    np.testing.assert_allclose(coefficients[3], [1 - 14 / 8 + 7 / 2, 14 / 8, 7 / 2])
    assert np.isinf(coefficients[2, 0])


def test_a_larger_borrower_continues_the_plane_too():
    """The left half borrows ``3 y`` from the upper right quarter."""
    center = np.array([np.inf, np.inf, np.inf, 3 * 0.75])
    half = np.array([[0.0, 0.0]] * 3 + [[0.0, 3 / 4]])
    coefficients = filled_coefficients(contents_of_planes(l_shape(), encode_planes(center, half, 32)))
    np.testing.assert_allclose(coefficients[[0, 2]], [[1.5, 0, 1.5], [3 * 3 / 8, 0, 3 / 8]])
    assert np.isinf(coefficients[:, 0]).tolist() == [False, True, False, False]
