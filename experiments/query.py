"""Time of a query: a million float32 points in 2-D (512 leaves) and in 4-D (50,000 leaves, two-level tables).

Every contender answers the same points in the same process, in interleaved runs, after a warm-up; medians are
reported. The 2-D function is the maze's distance, the 4-D one the distance of two point robots in it that ignore one
another: the product of two metric spaces, ``sqrt(d1**2 + d2**2)``.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.interpolate import RegularGridInterpolator

from experiments._results import run
from plr_jax import PLR, VisibilityGraph, construct, scenes

NUM_RUNS = 25
POINT_SEED = 1_000


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    num_points, num_leaves, num_runs = (10_000, 2_000, 3) if smoke else (1_000_000, 50_000, NUM_RUNS)
    return {
        "points": num_points,
        "runs": num_runs,
        "plane": query_2d(num_points, num_runs, seed),
        "joint": query_4d(num_points, num_leaves, num_runs, seed),
    }


def query_2d(num_points: int, num_runs: int, seed: int) -> dict[str, Any]:
    """PLR of the maze with 512 leaves against SciPy's bilinear interpolation of as many float32 numbers."""
    problem = scenes.maze()
    oracle = VisibilityGraph(problem.workspace, problem.goals[0])
    plr = construct(oracle, problem.workspace.bounds, max_leaves=512, seed=seed)
    x = np.random.default_rng(POINT_SEED).random((num_points, 2)).astype(np.float32)
    nodes = int(np.sqrt(plr.num_bytes / 4))
    axis = np.linspace(0, 1, nodes)
    values = np.asarray(plr(np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1)))
    grid = RegularGridInterpolator((axis, axis), values)
    x_on_device = jnp.asarray(x)
    nanoseconds = interleaved_medians(
        {
            "PLR": lambda: plr(x_on_device),
            "SciPy RegularGridInterpolator": lambda: grid(x),
            "adding the coordinates": lambda: add_coordinates(x_on_device),
        },
        num_points,
        num_runs,
    )
    return {"grid_nodes": nodes**2, **size_of(plr), "nanoseconds_a_point": nanoseconds}


def query_4d(num_points: int, num_leaves: int, num_runs: int, seed: int) -> dict[str, Any]:
    """PLR of the joint distance of two point robots in the maze that change places."""
    problem = scenes.maze()
    workspace = problem.workspace
    first = VisibilityGraph(workspace, problem.goals[0])
    second = first.with_goal(problem.starts[0])

    def distance(q: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "n"]:
        return np.hypot(first(q[:, :2]), second(q[:, 2:]))

    domain = (np.tile(workspace.bounds.lo, 2), np.tile(workspace.bounds.hi, 2))
    plr = construct(distance, domain, max_leaves=num_leaves, num_samples=64, seed=seed)
    pair = [workspace.sample_free(num_points, POINT_SEED + robot) for robot in range(2)]
    q = np.concatenate(pair, axis=1)
    q_on_device = jnp.asarray(q, jnp.float32)
    error = np.abs(np.asarray(plr(q_on_device)) - distance(q))
    nanoseconds = interleaved_medians(
        {"PLR": lambda: plr(q_on_device), "adding the coordinates": lambda: add_coordinates(q_on_device)},
        num_points,
        num_runs,
    )
    return {
        **size_of(plr),
        "two_level": plr.tables.blocks is not None,
        "max": float(error.max()),
        "mean": float(error.mean()),
        "nanoseconds_a_point": nanoseconds,
    }


def size_of(plr: PLR) -> dict[str, int]:
    return {"leaves": plr.num_leaves, "bytes": plr.num_bytes, "resident_bytes": plr.resident_bytes}


@jax.jit
def add_coordinates(x: Float[Array, "n dim"]) -> Float[Array, "n"]:
    """Read all points and write one number for each: the floor under any query."""
    return sum((x[:, axis] for axis in range(1, x.shape[1])), start=x[:, 0])


def interleaved_medians(contenders: dict[str, Callable[[], Any]], num_points: int, num_runs: int) -> dict[str, float]:
    """Median nanoseconds a point of each contender, their runs taking turns after one to warm up."""
    seconds = {name: [] for name in contenders}
    for number in range(num_runs + 1):
        for name, query in contenders.items():
            start = time.perf_counter()
            jax.block_until_ready(query())
            if number > 0:
                seconds[name].append(time.perf_counter() - start)
    return {name: float(np.median(times)) / num_points * 1e9 for name, times in seconds.items()}


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    """The table as text."""
    lines = []
    for name in ("plane", "joint"):
        row = results[name]
        for contender, nanoseconds in row["nanoseconds_a_point"].items():
            lines.append(f"{name:6}{row['leaves']:>7,} leaves  {contender:30}{nanoseconds:8.2f} ns a point")
    path = output / "query.txt"
    path.write_text("\n".join(lines) + "\n")
    print("\n".join(lines))
    return [path]


if __name__ == "__main__":
    run("query", "Time of a query against SciPy's, in 2-D and in 4-D.", compute, draw)
