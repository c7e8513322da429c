import jax
import jax.numpy as jnp
import numpy as np
from plr_helpers import UNIT, cone, evaluate_by_search, leaf_by_search, walled

from plr_jax.geometry.box import Box
from plr_jax.plr import construct
from plr_jax.plr.leaves.plane.evaluation import heights_and_slopes
from plr_jax.plr.partition.cells import Cells


def test_numbers_are_the_value_at_the_corner_and_the_slopes():
    """The plane ``3 + 5 x - 2 y`` on [2, 4] x [1, 2], in its upper half along x."""
    cells = Cells.root(2).split(np.array([0]))[[1]]
    numbers = heights_and_slopes(Box((2, 1), (4, 2)), cells, np.array([[3 + 17.5 - 3, 2.5, -1.0]]))
    np.testing.assert_allclose(numbers, [[3 + 10 - 2, 5, -2]])


def test_a_query_is_the_plane_of_the_leaf_that_holds_the_point(x):
    plr = construct(walled, UNIT, max_leaves=100)
    np.testing.assert_allclose(plr(x), evaluate_by_search(plr, x), atol=1e-6)
    gradient = jax.vmap(jax.grad(plr))(jnp.asarray(x))
    np.testing.assert_allclose(gradient, plr.slope[leaf_by_search(plr, x)], rtol=1e-6)


def test_double_precision_is_exact(x):
    plr = construct(cone, UNIT, max_leaves=40)
    with jax.enable_x64(True):
        points = x.astype(np.float64)
        np.testing.assert_allclose(plr(points), evaluate_by_search(plr, points), rtol=1e-12)
