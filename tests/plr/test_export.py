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

from plr_jax import stack

pytestmark = pytest.mark.usefixtures("unchecked_types")  # which know no symbolic sizes


def two_models(x):
    return stack([case("maze of cones"), case("maze of planes")])((x[:, 0] > 0.5).astype(np.int32), x)


FULL = [
    (2, lambda: case("maze of gradients")),
    (3, lambda: case("folded car")),
    (2, lambda: case("maze of cones").bounds),
    (2, lambda: case("maze of cones").waypoint),
    (2, lambda: jax.vmap(jax.grad(case("maze of cones")))),
    (2, lambda: two_models),
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
    pytest.importorskip("flatbuffers")
    query, (size,) = make(), export.symbolic_shape("n")
    shape = jax.ShapeDtypeStruct((size, dim), np.float32)
    program = export.deserialize(export.export(jax.jit(query))(shape).serialize())
    for n in (1, 300):
        x = np.random.default_rng(n).random((n, dim), np.float32)
        for one, other in zip(jax.tree.leaves(program.call(x)), jax.tree.leaves(jax.jit(query)(x)), strict=True):
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
