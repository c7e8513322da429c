import jax
import jax.numpy as jnp
import numpy as np
import pytest

from plr_jax import DiscRobot, Euclidean, Problem, RectangleRobot, VisibilityGraph, Workspace, construct
from plr_jax.optimize import optimize_paths
from plr_jax.optimize.trajectory.optimize_paths import differentiable

PROBLEM = Problem(
    Workspace(((0, 0), (10, 10))), [RectangleRobot(1.0, 0.5)] * 2, [(1, 1, 0), (1, 4, 0)], [(9, 1, 0), (9, 4, 0)]
)
Q = jnp.array([[3.0, 4.0, 12.0]])


SWAP = Problem(Workspace(((0, 0), (10, 10))), [DiscRobot(0.5)] * 2, [[2, 5], [8, 5]], [[8, 5], [2, 5]])
DETOUR = np.array([[[2.0, 5], [8, 5]], [[2, 8], [8, 2]], [[8, 8], [2, 2]], [[8, 5], [2, 5]]])


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


@pytest.mark.parametrize(
    "path, message",
    [
        (DETOUR[:, :1], r"Paths must have shape .* = \(2, 2\), .* got \(4, 1, 2\)"),
        (DETOUR[0], "Paths must have shape"),
        (DETOUR[:0], "at least one guess of one step"),
        ("abc", "Paths must be numbers"),
        (DETOUR + 0j, "Paths must be numbers"),
        (np.ma.masked_greater(DETOUR, 7), "Paths must be numbers .* and some are masked"),
        (DETOUR * np.array([1, np.nan, 1, 1])[:, None, None], "Paths must be finite; path 0"),
        (DETOUR[::-1], "Path 0 must have the problem's starts as its first row"),
        (DETOUR[:-1], "Path 0 must have the problem's goals as its last row"),
    ],
)
def test_paths_that_are_none_of_the_problem(path, message):
    with pytest.raises(ValueError, match=message):
        optimize_paths(SWAP, path)


@pytest.mark.parametrize(
    "options, message",
    [
        ({"num_retimings": -1}, "num_retimings must be an integer >= 0, got -1"),
        ({"num_iterations": 0}, "num_iterations must be an integer >= 1, got 0"),
        ({"seed": -1}, "seed must be an integer >= 0, got -1"),
        ({"margin": 0.0}, "margin must be a positive finite number"),
        ({"margin": np.nan}, "margin must be a positive finite number"),
        *(
            ({"makespan_factor": x}, "makespan_factor must be a number of at least 1")
            for x in (0.99, np.nan, -np.inf)
        ),
        ({"smoothness": -1.0}, "smoothness must be a finite number of at least 0"),
        ({"distance_fns": [jnp.sum]}, "one a robot, 2, got 1"),
        (
            {"distance_fns": [VisibilityGraph(SWAP.workspace, [8, 5])] * 2},
            r"distance_fns\[0\] must be a function that JAX",
        ),
        ({"distance_fns": [jnp.sum] * 2}, r"points \(n, dim\) to distances \(n,\), got \(\)"),
    ],
)
def test_options_out_of_range(options, message):
    with pytest.raises(ValueError, match=message):
        optimize_paths(SWAP, DETOUR, **options)
