"""Queries exported by ``jax.export``: compiled programs that need this package no more."""

from functools import cache

import jax
import numpy as np
import pytest
from jax import export

from plr_jax import Box, ReedsShepp, VisibilityGraph, construct, construct_pairs, scenes, stack

pytestmark = pytest.mark.usefixtures("unchecked_types")  # which know no symbolic sizes

CAR = Box((-4, -4, -np.pi), (4, 4, np.pi), periodic=(False, False, True))


@cache
def maze():
    problem = scenes.maze()
    return problem.workspace, VisibilityGraph(problem.workspace, problem.goals[0])


@cache
def built(leaf, max_bytes=512):
    workspace, oracle = maze()
    return construct(oracle, workspace.bounds, leaf=leaf, max_bytes=max_bytes, certified=True)


def in_the_maze(n):
    return (maze()[0].sample_free(n, 0).astype(np.float32),)


def indexed(n):
    return np.arange(n, dtype=np.int32) % 2, *in_the_maze(n)


def two(n):
    return in_the_maze(n)[0], maze()[0].sample_free(n, 1).astype(np.float32)


def poses(n):
    return (np.random.default_rng(0).uniform(1.2 * CAR.lo, 1.2 * CAR.hi, (n, 3)).astype(np.float32),)


def car():
    return construct(ReedsShepp((0, 0, 0), 1), CAR, leaf="continuous", max_leaves=50)


def pairs():
    return construct_pairs(maze()[0], max_bytes=512)


QUERIES = {
    "plane": (lambda: built("plane"), in_the_maze),
    "cone, pages": (lambda: built("cone"), in_the_maze),
    "continuous": (lambda: built("continuous"), in_the_maze),
    "smooth": (lambda: built("smooth"), in_the_maze),
    "folded": (car, poses),
    "bounds": (lambda: built("cone").bounds, in_the_maze),
    "lower": (lambda: built("plane").lower, in_the_maze),
    "waypoint": (lambda: built("cone").waypoint, in_the_maze),
    "gradient": (lambda: jax.vmap(jax.grad(built("cone"))), in_the_maze),
    "clamp": (lambda: lambda x: built("plane")(2 * x, outside="clamp"), in_the_maze),
    "stack, trie": (lambda: stack([built("cone"), built("cone", 1024)]), indexed),
    "stack, several models": (lambda: stack([built("cone"), built("plane")]), indexed),
    "pairs": (pairs, two),
    "bounds of pairs": (lambda: pairs().bounds, two),
}


def exported(query, arguments, sizes):
    shapes = [jax.ShapeDtypeStruct((*sizes, *each.shape[1:]), each.dtype) for each in arguments]
    return export.export(jax.jit(query))(*shapes)


@pytest.mark.parametrize("name", QUERIES)
def test_of_any_number_of_points(name):
    make, points = QUERIES[name]
    query = make()
    program = exported(query, points(2), export.symbolic_shape("n"))
    for n in (1, 300):
        found, expected = program.call(*points(n)), query(*points(n))
        for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("name", ["plane", "cone, pages", "stack, trie", "pairs"])
def test_bytes_answer_alike(name):
    pytest.importorskip("flatbuffers", reason="jax.export writes bytes by the package flatbuffers")
    make, points = QUERIES[name]
    query, x = make(), points(100)
    for sizes in ((100,), export.symbolic_shape("n")):
        program = exported(query, x, sizes)
        again = export.deserialize(program.serialize())
        np.testing.assert_array_equal(again.call(*x), program.call(*x))
        np.testing.assert_allclose(again.call(*x), query(*x), rtol=1e-6, atol=1e-6)


def test_arrays_of_a_plr_are_an_argument_of_what_is_serialized():
    pytest.importorskip("flatbuffers", reason="jax.export writes bytes by the package flatbuffers")
    one, other = built("cone", 450), built("cone", 400)
    arrays, structure = jax.tree.flatten(one)
    assert jax.tree.structure(other) == structure  # one program for all PLRs of a class
    (x,) = in_the_maze(50)

    def query(arrays, x):
        return jax.tree.unflatten(structure, arrays)(x)

    program = export.deserialize(export.export(jax.jit(query))(arrays, x).serialize())
    for plr in (one, other):
        np.testing.assert_allclose(program.call(jax.tree.leaves(plr), x), plr(x), rtol=1e-6, atol=1e-6)
    with pytest.raises(ValueError, match="Cannot serialize"):
        export.export(jax.jit(lambda plr, x: plr(x)))(one, x).serialize()
