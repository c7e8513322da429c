import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from plr_helpers import random_partition

from plr_jax.geometry.box import Box
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.partition.neighbors import fill_unreachable


def quarters():
    """Four slabs: [0, 1/4], [1/4, 1/2], [1/2, 3/4] and [3/4, 1] along axis 0."""
    halves = Cells.root(2).split(np.array([0]))
    return halves.split(np.array([0, 0]))


def test_only_direct_neighbors_lend_their_plane():
    slope, intercept = fill_unreachable(
        quarters(), np.array([False, True, True, True]), np.full((4, 2), 7.0), np.array([1.0, 2, 3, 4])
    )
    np.testing.assert_array_equal(intercept, [1, 1, np.inf, np.inf])
    np.testing.assert_array_equal(slope, [[7, 7], [7, 7], [0, 0], [0, 0]])


def test_the_largest_contact_lends():
    # Left half blocked; right half: lower quarter in two, so the upper leaf has the longer side in common.
    halves = Cells.root(2).split(np.array([0]))
    right = halves[[1]].split(np.array([1]))
    lower = right[[0]].split(np.array([1]))
    cells = halves[[0]].append(lower).append(right[[1]])
    _, intercept = fill_unreachable(cells, np.array([True, False, False, False]), np.zeros((4, 2)), np.arange(4.0))
    np.testing.assert_array_equal(intercept, [3, 1, 2, 3])


def test_nothing_to_fill_or_to_borrow():
    _, intercept = fill_unreachable(quarters(), np.zeros(4, bool), np.zeros((4, 2)), np.arange(4.0))
    np.testing.assert_array_equal(intercept, np.arange(4.0))
    _, intercept = fill_unreachable(quarters(), np.ones(4, bool), np.zeros((4, 2)), np.arange(4.0))
    assert np.isinf(intercept).all()


@given(seed=st.integers(0, 1000), dim=st.integers(1, 3))
def test_exactly_the_blocked_leaves_that_touch_an_open_one_are_filled(seed, dim):
    cells = random_partition(seed, dim, 25)
    blocked = np.random.default_rng(seed).random(len(cells)) < 0.7
    _, intercept = fill_unreachable(cells, blocked, np.zeros((len(cells), dim)), np.arange(float(len(cells))))
    lo, hi = cells.boxes(Box(np.zeros(dim), np.ones(dim)))
    for leaf in np.flatnonzero(blocked):
        touches = ~blocked & np.all((lo <= hi[leaf]) & (hi >= lo[leaf]), axis=1)
        assert np.isfinite(intercept[leaf]) == touches.any()
        assert np.isinf(intercept[leaf]) or touches[int(intercept[leaf])]
    np.testing.assert_array_equal(intercept[~blocked], np.flatnonzero(~blocked))
