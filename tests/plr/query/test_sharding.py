"""Points on several devices: answered where they are, by the same numbers; of pairs to rounding."""

import os
import subprocess
import sys
import textwrap

CODE = """
    import jax
    import numpy as np
    from jax.sharding import Mesh, NamedSharding, PartitionSpec
    import plr_jax

    devices = np.array(jax.devices())
    assert len(devices) == 4
    sharding = NamedSharding(Mesh(devices, ("points",)), PartitionSpec("points"))
    workspace = plr_jax.scenes.maze().workspace
    oracle = plr_jax.VisibilityGraph(workspace, (0.06, 0.07))
    x = workspace.sample_free(400, 0).astype(np.float32)
    plane = plr_jax.construct(oracle, workspace.bounds, max_bytes=300)
    oracles = [oracle.with_goal(goal) for goal in x[:3]]
    cones = [plr_jax.construct(each, workspace.bounds, leaf="cone", max_bytes=200) for each in oracles]
    queries = {
        "planes": (plane, (x,)),
        "cones": (cones[0], (x,)),
        "stack": (plr_jax.stack(cones), (np.arange(400, dtype=np.int32) % 3, x)),
        "pairs": (plr_jax.construct_pairs(workspace, max_bytes=1024), (x, x[::-1].copy())),
    }
    for name, (query, points) in queries.items():
        here = query(*map(jax.numpy.asarray, points))
        there = query(*jax.device_put(points, sharding))
        assert there.sharding.is_equivalent_to(sharding, 1), name
        rounding = 1e-6 if name == "pairs" else 0  # which compile otherwise for batches of other sizes
        np.testing.assert_allclose(np.asarray(there), np.asarray(here), rtol=rounding, err_msg=name)
        print(name)
"""


def test_answers_are_the_same_and_on_the_devices_of_their_points():
    flags = f"--xla_force_host_platform_device_count=4 {os.environ.get('XLA_FLAGS', '')}"
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(CODE)],
        check=False,
        capture_output=True,
        text=True,
        env={**os.environ, "XLA_FLAGS": flags},
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["planes", "cones", "stack", "pairs"]
