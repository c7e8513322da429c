"""Time of a query: a million float32 points in 2-D (512 leaves) and in 4-D (50,000 leaves, two-level tables).

    python -m experiments.query [--smoke] [--seed N] [--output DIR]

Every contender answers the same points in the same process, in interleaved runs, after a warm-up; medians are
reported. The 2-D function is the maze's distance, the 4-D one the distance of two point robots in it that ignore one
another: the product of two metric spaces, ``sqrt(d1**2 + d2**2)``.
"""

import time

import jax
import jax.numpy as jnp
import numpy as np
from scipy.interpolate import RegularGridInterpolator

import plr_jax
from experiments._results import parse_arguments, write_results

RUNS = 25


def main() -> None:
    """Measure both queries, print them and write them down."""
    arguments = parse_arguments(__doc__)
    num_points = 10_000 if arguments.smoke else 1_000_000
    results = {"num_points": num_points, "2d": query_2d(num_points, arguments.seed)}
    num_leaves = 2_000 if arguments.smoke else 50_000
    results["4d"] = query_4d(num_points, num_leaves, arguments.seed)
    for name, row in results.items():
        print(name, row)
    write_results("query", results, arguments)


def query_2d(num_points: int, seed: int) -> dict:
    """PLR of the maze with 512 leaves against SciPy's bilinear interpolation of as many float32 bytes."""
    problem = plr_jax.scenes.maze()
    oracle = plr_jax.VisibilityGraph(problem.workspace, problem.goals[0])
    plr = plr_jax.construct(oracle, problem.workspace.bounds, max_leaves=512, seed=seed)
    x = np.random.default_rng(seed).random((num_points, 2)).astype(np.float32)
    nodes = int(np.sqrt(plr.num_bytes / 4))
    axis = np.linspace(0, 1, nodes)
    values = np.asarray(plr(np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1)))
    grid = RegularGridInterpolator((axis, axis), values)
    on_device = jnp.asarray(x)
    nanoseconds = interleaved_medians(
        {
            "plr": lambda: plr(on_device),
            "scipy RegularGridInterpolator": lambda: grid(x),
            "copy": lambda: copy(on_device),
        },
        num_points,
    )
    ratio = nanoseconds["scipy RegularGridInterpolator"] / nanoseconds["plr"]
    return {
        "num_leaves": plr.num_leaves,
        "bytes": plr.num_bytes,
        "resident_bytes": plr.resident_bytes,
        "grid_nodes": nodes**2,
        "nanoseconds_a_point": nanoseconds,
        "scipy_over_plr": ratio,
    }


def query_4d(num_points: int, num_leaves: int, seed: int) -> dict:
    """PLR of the joint distance of two point robots in the maze."""
    workspace = plr_jax.scenes.maze().workspace
    first = plr_jax.VisibilityGraph(workspace, np.array([0.06, 0.07]))
    second = first.with_goal(np.array([0.93, 0.95]))
    lo, hi = np.tile(workspace.bounds.lo, 2), np.tile(workspace.bounds.hi, 2)
    plr = plr_jax.construct(
        lambda q: np.hypot(first(q[:, :2]), second(q[:, 2:])),
        (lo, hi),
        max_leaves=num_leaves,
        num_samples=64,
        seed=seed,
    )
    q = np.concatenate([workspace.sample_free(num_points, seed), workspace.sample_free(num_points, seed + 1)], axis=1)
    distance = np.hypot(first(q[:, :2]), second(q[:, 2:]))
    on_device = jnp.asarray(q, jnp.float32)
    error = np.abs(np.asarray(plr(on_device)) - distance)
    return {
        "num_leaves": plr.num_leaves,
        "bytes": plr.num_bytes,
        "resident_bytes": plr.resident_bytes,
        "two_level": plr.tables.blocks is not None,
        "max_error": float(error.max()),
        "mean_error": float(error.mean()),
        "nanoseconds_a_point": interleaved_medians(
            {"plr": lambda: plr(on_device), "copy": lambda: copy(on_device)}, num_points
        ),
    }


@jax.jit
def copy(x):
    """Read all points and write one number each: the floor under any query."""
    return x.sum(axis=-1)


def interleaved_medians(contenders: dict, num_points: int) -> dict[str, float]:
    """Median nanoseconds a point of each contender, their runs taking turns."""
    seconds = {name: [] for name in contenders}
    for run in range(RUNS + 1):
        for name, query in contenders.items():
            start = time.perf_counter()
            jax.block_until_ready(query())
            if run > 0:
                seconds[name].append(time.perf_counter() - start)
    return {name: float(np.median(times)) / num_points * 1e9 for name, times in seconds.items()}


if __name__ == "__main__":
    main()
