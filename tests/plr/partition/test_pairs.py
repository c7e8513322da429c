import numpy as np
import pytest
from plr_helpers import random_partition

from plr_jax.plr.partition.cells import tree_of
from plr_jax.plr.partition.faces import overlapping_leaves


def ends(cells):
    return np.ldexp(cells.position.astype(float), -cells.depth), np.ldexp(cells.position + 1.0, -cells.depth)


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_leaves_overlap_as_their_boxes_do(dim):
    for seed in range(5):
        a, b = (tree_of(random_partition(seed + shift, dim, 30)) for shift in (0, 100))
        (lo_a, hi_a), (lo_b, hi_b) = ends(a.leaves), ends(b.leaves)
        meet = np.all((lo_a[:, None] < hi_b) & (lo_b < hi_a[:, None]), axis=2)
        assert sorted(zip(*overlapping_leaves(a, b), strict=True)) == sorted(zip(*np.nonzero(meet), strict=True))
