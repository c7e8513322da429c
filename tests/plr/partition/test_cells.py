import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from plr_helpers import chain, random_partition, three_leaves

from plr_jax.geometry.box import Box
from plr_jax.plr.tree import (
    Cells,
    levels_of,
    tree_of,
    tree_of_levels,
)


def test_split_halves_one_axis_lower_child_first():
    root = Cells.root(2)
    np.testing.assert_array_equal(root.boxes(Box((-1, 2), (3, 4))), [[[-1, 2]], [[3, 4]]])
    lo, hi = root.split(np.array([1])).split(np.array([0, 1])).boxes(Box((0, 0), (8, 8)))
    np.testing.assert_array_equal(lo, [[0, 0], [4, 0], [0, 4], [0, 6]])
    np.testing.assert_array_equal(hi, [[4, 4], [8, 4], [8, 6], [8, 8]])


def test_points_are_the_local_coordinates_mapped_into_each_cell():
    cells = Cells.root(1).split(np.array([0]))
    x = cells.points(np.array([[-1.0], [0.0], [1.0]]), Box([10.0], [12.0]))
    np.testing.assert_array_equal(x[..., 0], [[10, 10.5, 11], [11, 11.5, 12]])


def test_a_tree_of_three_leaves():
    tree = tree_of(three_leaves())
    np.testing.assert_array_equal(tree.child, [1, -1, 3, -1, -1])
    np.testing.assert_array_equal(tree.node_of_leaf, [1, 3, 4])


@settings(max_examples=30)
@given(seed=st.integers(0, 10_000), dim=st.integers(1, 4), num_splits=st.integers(0, 60))
def test_leaves_are_the_cells_in_one_order_and_levels_give_them_back(seed, dim, num_splits):
    cells = random_partition(seed, dim, num_splits)
    shuffled = cells[np.random.default_rng(seed).permutation(len(cells))]
    leaves, again = tree_of(cells).leaves, tree_of(shuffled).leaves
    np.testing.assert_array_equal(again.position, leaves.position)
    np.testing.assert_array_equal(shuffled[tree_of(shuffled).order].position, leaves.position)
    rows = np.concatenate([leaves.depth, leaves.position], axis=1).tolist()
    assert sorted(rows) == sorted(np.concatenate([cells.depth, cells.position], axis=1).tolist())
    levels, order = levels_of(shuffled)
    of_levels = tree_of_levels(levels, dim).leaves
    np.testing.assert_array_equal(of_levels.depth, shuffled.depth[order])
    np.testing.assert_array_equal(of_levels.position, shuffled.position[order])


def test_the_deepest_path_fits():
    leaves = chain([0] * 60)
    levels, order = levels_of(leaves)
    assert len(levels) == 61
    np.testing.assert_array_equal(order, np.arange(61))
    np.testing.assert_array_equal(tree_of_levels(levels, 1).leaves.position, leaves.position)
