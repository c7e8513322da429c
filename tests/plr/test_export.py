"""Queries exported by ``jax.export``, which no longer need this package, and queries on several devices."""

import os
import subprocess
import sys
from functools import partial

import jax
import numpy as np
import pytest
from jax import export
from portable_helpers import case

from plr_jax import Workspace, construct_pairs, stack

pytestmark = pytest.mark.usefixtures("unchecked_types")  # which know no symbolic sizes


def points(n, dim=2, seed=0):
    return np.random.default_rng(seed).uniform(0, 1, (n, dim)).astype(np.float32)


def in_square(n):
    return (points(n),)


def in_cube(n):
    return (9 * points(n, 3) - 4.5,)


def indexed(n):
    return np.arange(n, dtype=np.int32) % 2, points(n)


def two(n):
    return points(n), points(n, seed=1)


def pairs():
    workspace = Workspace(((0, 0), (1, 1)), [[(0.4, 0), (0.5, 0), (0.5, 0.7), (0.4, 0.7)]])
    return construct_pairs(workspace, max_bytes=300)


FULL = [
    (lambda: case("maze of gradients"), in_square),
    (lambda: case("folded car"), in_cube),
    (lambda: case("maze of cones").bounds, in_square),
    (lambda: case("maze of cones").waypoint, in_square),
    (lambda: jax.vmap(jax.grad(case("maze of cones"))), in_square),
    (lambda: stack([case("maze of cones"), case("maze of planes")]), indexed),
    (pairs, two),
]


@pytest.mark.parametrize(
    ("make", "points"),
    [
        (lambda: partial(case("maze of planes"), outside="clamp"), in_square),
        *(pytest.param(*row, marks=pytest.mark.full) for row in FULL),
    ],
)
def test_exported_queries_answer_any_number_of_points(make, points):
    """Programs become bytes, which ``jax.export`` writes with the package flatbuffers."""
    pytest.importorskip("flatbuffers")
    query, (size,) = make(), export.symbolic_shape("n")
    shapes = [jax.ShapeDtypeStruct((size, *each.shape[1:]), each.dtype) for each in points(2)]
    program = export.deserialize(export.export(jax.jit(query))(*shapes).serialize())
    for n in (1, 300):
        found, expected = program.call(*points(n)), jax.jit(query)(*points(n))
        for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-6)


CODE = """
import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
import plr_jax

assert len(jax.devices()) == 4
sharding = NamedSharding(Mesh(np.array(jax.devices()), ("points",)), PartitionSpec("points"))
plane = plr_jax.construct(plr_jax.Euclidean((0.06, 0.07)), ((0, 0), (1, 1)), max_leaves=20)
x, index = np.random.default_rng(0).random((400, 2), np.float32), np.arange(400, dtype=np.int32) % 2
for query, points in ((plane, (x,)), (plr_jax.stack([plane, plane]), (index, x))):
    there = query(*jax.device_put(points, sharding))
    assert there.sharding.is_equivalent_to(sharding, 1)
    np.testing.assert_array_equal(np.asarray(there), np.asarray(query(*map(jax.numpy.asarray, points))))
print("done")
"""


@pytest.mark.full
def test_answers_are_on_the_devices_of_their_points():
    flags = f"--xla_force_host_platform_device_count=4 {os.environ.get('XLA_FLAGS', '')}"
    command, environment = [sys.executable, "-c", CODE], {**os.environ, "XLA_FLAGS": flags}
    done = subprocess.run(command, check=False, capture_output=True, text=True, env=environment)
    assert done.returncode == 0 and done.stdout == "done\n", done.stderr
