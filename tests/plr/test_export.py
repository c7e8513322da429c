"""Queries exported by ``jax.export``, which no longer need this package."""

from functools import partial

import jax
import numpy as np
import pytest
from jax import export
from portable_helpers import case

from plr_jax import construct_grid_pairs, construct_pairs, scenes, stack

pytestmark = pytest.mark.usefixtures("unchecked_types")  # which know no symbolic sizes


GRID = np.random.default_rng(0).random((32, 32)) > 0.3  # of free cells


def two_models(x):
    return stack([case("maze of cones"), case("maze of planes")])((x[:, 0] > 0.5).astype(np.int32), x)


FULL = [
    (2, lambda: case("maze of gradients")),
    (3, lambda: case("folded car")),
    (2, lambda: case("maze of cones").bounds),
    (2, lambda: case("maze of cones").waypoint),
    (2, lambda: jax.vmap(jax.grad(case("maze of cones")))),
    (2, lambda: two_models),
    (2, lambda: lambda x: construct_pairs(scenes.maze().workspace, max_bytes=300)(x, x[:, ::-1])),
    (2, lambda: lambda x: construct_grid_pairs(GRID)(32 * x, 32 * x[:, ::-1])),
    (2, lambda: partial(lambda to, x: to(32 * x), construct_grid_pairs(GRID).to(np.argwhere(GRID)[0, ::-1]))),
]
# Objects that are arguments of exported functions, and functions of them and points.
GIVEN = [
    (lambda: case("cones of exits"), lambda plr, x: (plr(x), plr.which(x), *plr.bounds(x))),
    (lambda: stack([case("maze of cones"), case("maze of planes")]).lower, lambda lower, x: lower(1, x)),
    (lambda: construct_pairs(scenes.maze().workspace, max_bytes=300), lambda pairs, x: pairs.tables.step * x),
    (lambda: construct_grid_pairs(np.arange(20).reshape(4, 5) % 7 > 1), lambda pairs, x: pairs(4 * x, x[:, ::-1])),
]


@pytest.mark.parametrize(
    ("dim", "make"),
    [
        (2, lambda: partial(case("maze of planes"), outside="clamp")),
        *(pytest.param(*row, marks=pytest.mark.full) for row in FULL),
    ],
)
def test_exported_queries_answer_any_number_of_points(dim, make):
    """Programs become bytes, which ``jax.export`` writes with the package flatbuffers."""
    assert_exported(make(), dim)


@pytest.mark.full
@pytest.mark.parametrize(("make", "query"), GIVEN)
def test_exported_functions_take_objects(make, query):
    assert_exported(query, 2, make())


def assert_exported(query, dim, *given):
    pytest.importorskip("flatbuffers")
    (size,) = export.symbolic_shape("n")
    shape = jax.ShapeDtypeStruct((size, dim), np.float32)
    program = export.deserialize(export.export(jax.jit(query))(*given, shape).serialize())
    for n in (1, 300):
        x = np.random.default_rng(n).random((n, dim), np.float32)
        answers = program.call(*given, x), jax.jit(query)(*given, x)
        for one, other in zip(*map(jax.tree.leaves, answers), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-6)
