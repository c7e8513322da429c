import jax
import jax.numpy as jnp
import numpy as np
import pytest

from plr_jax import Euclidean, Problem, RectangleRobot, Workspace, construct
from plr_jax.optimize.trajectory.arguments import differentiable

PROBLEM = Problem(
    Workspace(((0, 0), (10, 10))), [RectangleRobot(1.0, 0.5)] * 2, [(1, 1, 0), (1, 4, 0)], [(9, 1, 0), (9, 4, 0)]
)
Q = jnp.array([[3.0, 4.0, 12.0]])


def norm(q):
    return jnp.linalg.norm(q, axis=1)


def test_a_function_sees_as_many_coordinates_as_it_says():
    def of_the_plane(q):
        return norm(q)

    of_the_plane.dim = 2
    fns = differentiable(PROBLEM, [norm, of_the_plane])
    # A trip through JAX, which takes pytrees apart.
    np.testing.assert_allclose([jax.jit(lambda fn, q: fn(q))(fn, Q)[0] for fn in fns], [13, 5])
    assert jax.tree.structure(fns) == jax.tree.structure(differentiable(PROBLEM, [norm, of_the_plane]))


def test_a_plr_is_a_pytree_as_it_is():
    plr = construct(Euclidean((1, 1)), ((0, 0), (10, 10)), max_leaves=4)
    assert differentiable(PROBLEM, [plr, plr]) == (plr, plr)
    assert differentiable(PROBLEM, None) == ()


def test_a_pytree_of_one_array_is_one_as_it_is():
    def apart(goal, q):
        return jnp.linalg.norm(q - goal, axis=1)

    fn = jax.tree_util.Partial(apart, np.zeros(3))
    assert differentiable(PROBLEM, [fn, fn]) == (fn, fn)


@pytest.mark.parametrize("dim", [0, 4])
def test_a_function_of_more_coordinates_than_there_are(dim):
    def distance(q):
        return norm(q)

    distance.dim = dim
    with pytest.raises(ValueError, match=rf"distance_fns\[1\] takes {dim} coordinates, configurations have 3"):
        differentiable(PROBLEM, [norm, distance])
