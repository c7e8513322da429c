"""Queries exported by ``jax.export``, which need this package no more, and of points on several devices."""

import os
import subprocess
import sys
import textwrap

import jax
import numpy as np
import pytest
from jax import export
from portable_helpers import case

from plr_jax import Box, VisibilityGraph, Workspace, construct, construct_pairs, stack

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


def two_models():
    return stack([case("maze of cones"), case("maze of planes")])


def clamped():
    return lambda x: case("maze of planes")(2 * x, outside="clamp")


def pairs():
    workspace = Workspace(((0, 0), (1, 1)), [[(0.4, 0), (0.5, 0), (0.5, 0.7), (0.4, 0.7)]])
    return construct_pairs(workspace, max_bytes=300)


@pytest.mark.parametrize(
    ("make", "points"),
    [
        (clamped, in_square),
        pytest.param(lambda: case("maze of gradients"), in_square, marks=pytest.mark.full),
        pytest.param(lambda: case("folded car"), in_cube, marks=pytest.mark.full),
        pytest.param(lambda: case("maze of cones").bounds, in_square, marks=pytest.mark.full),
        pytest.param(lambda: case("maze of cones").waypoint, in_square, marks=pytest.mark.full),
        pytest.param(lambda: jax.vmap(jax.grad(case("maze of cones"))), in_square, marks=pytest.mark.full),
        pytest.param(two_models, indexed, marks=pytest.mark.full),
        pytest.param(pairs, two, marks=pytest.mark.full),
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


@pytest.mark.full
def test_exported_programs_take_the_arrays_of_a_plr():
    pytest.importorskip("flatbuffers", reason="jax.export writes bytes by the package flatbuffers")
    domain = Box((-1, -1), (3, 2))
    one, other = (construct(VisibilityGraph(Workspace(domain), (0.3, y)), domain, leaf="cone") for y in (0, 1))
    arrays, structure = jax.tree.flatten(one)
    assert jax.tree.structure(other) == structure  # one program for all PLRs of a class
    x = points(50, 2)

    def query(arrays, x):
        return jax.tree.unflatten(structure, arrays)(x)

    program = export.deserialize(export.export(jax.jit(query))(arrays, x).serialize())
    for plr in (one, other):
        np.testing.assert_allclose(program.call(jax.tree.leaves(plr), x), plr(x), rtol=1e-6, atol=1e-6)
    with pytest.raises(ValueError, match="Cannot serialize"):
        export.export(jax.jit(lambda plr, x: plr(x)))(one, x).serialize()


CODE = """
    import jax
    import numpy as np
    from jax.sharding import Mesh, NamedSharding, PartitionSpec
    import plr_jax

    devices = np.array(jax.devices())
    assert len(devices) == 4
    sharding = NamedSharding(Mesh(devices, ("points",)), PartitionSpec("points"))
    workspace = plr_jax.Workspace(((0, 0), (1, 1)), [[(0.4, 0), (0.5, 0), (0.5, 0.7), (0.4, 0.7)]])
    oracle = plr_jax.VisibilityGraph(workspace, (0.06, 0.07))
    x = workspace.sample_free(400, 0).astype(np.float32)
    plane = plr_jax.construct(oracle, workspace.bounds, max_bytes=200)
    cone = plr_jax.construct(oracle, workspace.bounds, leaf="cone", max_bytes=100)
    queries = {
        "planes": (plane, (x,)),
        "stack": (plr_jax.stack([cone, cone]), (np.arange(400, dtype=np.int32) % 2, x)),
    }
    for name, (query, points) in queries.items():
        here = query(*map(jax.numpy.asarray, points))
        there = query(*jax.device_put(points, sharding))
        assert there.sharding.is_equivalent_to(sharding, 1), name
        np.testing.assert_array_equal(np.asarray(there), np.asarray(here), err_msg=name)
        print(name)
"""


@pytest.mark.full
def test_answers_are_on_the_devices_of_their_points():
    flags = f"--xla_force_host_platform_device_count=4 {os.environ.get('XLA_FLAGS', '')}"
    command, environment = [sys.executable, "-c", textwrap.dedent(CODE)], {**os.environ, "XLA_FLAGS": flags}
    done = subprocess.run(command, check=False, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["planes", "stack"]
