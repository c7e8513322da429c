import numpy as np
import pytest
from plr_helpers import random_partition

from plr_jax.geometry.box import Box
from plr_jax.plr._coarsen import leaves_that_meet
from plr_jax.plr.partition.cells import tree_of


@pytest.mark.parametrize("seed", range(12))
def test_pairs_that_meet_are_those_whose_boxes_overlap(seed):
    dim = 1 + seed % 3
    one, other = (tree_of(random_partition(seed + shift, dim, 25 * (1 + seed % 2))) for shift in (0, 100))
    domain = Box([0.0] * dim, [1.0] * dim)
    (lo, hi), (other_lo, other_hi) = one.leaves.boxes(domain), other.leaves.boxes(domain)
    first, second, common = leaves_that_meet(one, other)
    low, high = np.maximum(lo[:, None], other_lo), np.minimum(hi[:, None], other_hi)
    overlaps = (low < high).all(axis=2)
    found = np.zeros_like(overlaps, int)
    np.add.at(found, (first, second), 1)
    np.testing.assert_array_equal(found, overlaps)
    common_lo, common_hi = common.boxes(domain)
    np.testing.assert_array_equal(common_lo, low[first, second])
    np.testing.assert_array_equal(common_hi, high[first, second])


def test_a_partition_meets_itself_leaf_by_leaf():
    tree = tree_of(random_partition(3, 2, 40))
    first, second, common = leaves_that_meet(tree, tree)
    np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(common.position[np.argsort(first)], tree.leaves.position)
