import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from plr_helpers import random_partition

from plr_jax.plr.partition.cells import Cells, levels_of, tree_of_levels


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), dim=st.integers(1, 4), num_splits=st.integers(0, 60))
def test_levels_give_back_the_same_leaves(seed, dim, num_splits):
    leaves = random_partition(seed, dim, num_splits)
    shuffled = leaves[np.random.default_rng(seed).permutation(len(leaves))]
    levels, order = levels_of(shuffled)
    again = tree_of_levels(levels, dim).leaves
    np.testing.assert_array_equal(again.depth, shuffled.depth[order])
    np.testing.assert_array_equal(again.position, shuffled.position[order])


def test_the_deepest_path_fits():
    leaves = Cells.root(1)
    for _ in range(60):
        leaves = leaves[[0]].split(np.array([0])).append(leaves[1:])
    levels, order = levels_of(leaves)
    assert len(levels) == 61
    np.testing.assert_array_equal(order, np.arange(61))
    np.testing.assert_array_equal(tree_of_levels(levels, 1).leaves.position, leaves.position)
