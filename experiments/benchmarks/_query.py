"""Time of a query: a PLR's over dimensions, leaves and points, and that of contenders on the maze.

Over dimensions, the function is the distance to a point off the center of the unit cube (a cone).
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from matplotlib.figure import Figure
from tqdm import tqdm

from experiments.benchmarks._numba_loop import numba_loop
from experiments.benchmarks._rivals import (
    NUM_STEPS,
    Rival,
    coded_grid,
    jax_grid,
    leaves_that_fit,
    linear_trees,
    make_all,
    scipy_grid,
    train_network,
)
from experiments.benchmarks._timing import interleaved
from plr_jax import PLR, BuildOptions, VisibilityGraph, construct, metrics, scenes

_DIMS = (2, 3, 4, 5, 6)
_LEAVES = (64, 1_024, 16_384, 65_536)
_LARGEST, _LARGEST_DIMS = 10**6, (2, 4)
_SAMPLES = 16
_COLORS = ("#0072B2", "#009E73", "#D55E00", "#CC79A7", "#444444")


def measure_sizes(points: list[int], turns: int, seed: int, smoke: bool) -> dict[str, Any]:
    """Rows of all sizes; a million leaves only in the dimensions where that does not take long to build."""
    rows = []
    for dim in tqdm(_DIMS[:2] if smoke else _DIMS, desc="dimensions", disable=None):
        leaves = (64,) if smoke else (*_LEAVES, _LARGEST) if dim in _LARGEST_DIMS else _LEAVES
        rows += _rows({number: _cone(dim, number, seed) for number in leaves}, points, turns, seed)
    return {"sizes": rows}


def size_of(plr: PLR) -> dict[str, int]:
    return {"leaves": plr.num_leaves, "bytes": plr.num_bytes, "resident_bytes": plr.resident_bytes}


def _cone(dim: int, leaves: int, seed: int) -> PLR:
    tip, domain = np.linspace(0.31, 0.43, dim), (np.zeros(dim), np.ones(dim))
    options = BuildOptions(num_samples=_SAMPLES)
    return construct(lambda x: np.linalg.norm(x - tip, axis=1), domain, max_leaves=leaves, options=options, seed=seed)


def _rows(plrs: dict[int, PLR], points: list[int], turns: int, seed: int) -> list[dict[str, Any]]:
    """Nanoseconds a point of PLRs of one dimension, taking turns."""
    dim = next(iter(plrs.values())).dim
    rows = {leaves: {"dim": dim, **size_of(plr), "nanoseconds": {}} for leaves, plr in plrs.items()}
    for n in points:
        x = jnp.asarray(np.random.default_rng(POINT_SEED + seed).random((n, dim)), jnp.float32)
        calls: dict[str, Callable[[], Any]] = {str(leaves): partial(jax.jit(plr), x) for leaves, plr in plrs.items()}
        for leaves, seconds in interleaved(calls, turns).items():
            rows[int(leaves)]["nanoseconds"][str(n)] = [1e9 / n * s for s in seconds]
    return list(rows.values())


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    """Nanoseconds a point of the largest batch against leaves, one line a dimension."""
    most = list(results["sizes"][0]["nanoseconds"])[-1]
    figure = Figure(figsize=(5.6, 3.8), layout="constrained", facecolor="white")
    ax = figure.subplots()
    for dim, color in zip(sorted({row["dim"] for row in results["sizes"]}), _COLORS, strict=False):
        rows = [row for row in results["sizes"] if row["dim"] == dim]
        leaves, times = [row["leaves"] for row in rows], [row["nanoseconds"][most][0] for row in rows]
        ax.loglog(leaves, times, "-o", color=color, ms=4, lw=1.5)
        ax.annotate(f"{dim}-D", (leaves[-1], times[-1]), (6, 0), textcoords="offset points", color=color, va="center")
    ax.set_xlabel("leaves")
    ax.set_ylabel(f"nanoseconds a point, {int(most):,} points")
    ax.grid(True, which="major", color="#dddddd", lw=0.6)
    ax.spines[["top", "right"]].set_visible(False)
    path = output / "benchmark_query.png"
    figure.savefig(path, dpi=150)
    return [path]


# Time of a query: a PLR against its rivals, in the plane at equal bytes, and alone over dimensions and leaves.
#
# In the plane, all answer the same random points of the maze:
#
# - The coded grid, the network's 32-bit weights and LightGBM's tree take at most the bytes of the PLR's file. JAX and
#   SciPy read the same grid, decoded. LightGBM has one tree, after the stump that it needs (see ``_rivals.py``).
# - The Numba loops read the PLR's own tables, on all cores and on one.
# - The floors: JAX reading the points and writing one float for each, and NumPy copying as many bytes.
#
# In four dimensions the function is the joint distance of two point robots of the maze that change places and ignore
# one another, ``sqrt(d1**2 + d2**2)``.

POINT_SEED, TRAINING_SEED = 1_000, 2_000
MAX_BYTES, SMOKE_BYTES = 6_144, 1_024
_SAMPLES_OF_JOINT = 64


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    points, turns = ([1, 1_000], 2) if smoke else ([1, 1_000, 1_000_000], 15)
    sizes = (SMOKE_BYTES, 2_000, 20, 1_000) if smoke else (MAX_BYTES, 100_000, NUM_STEPS, 20_000)
    return {
        "plane": _plane(points, turns, seed, *sizes),
        "joint": _joint(points[-1], turns, 500 if smoke else 50_000, seed),
        **measure_sizes(points, turns, seed, smoke),
    }


def _plane(
    points: list[int], turns: int, seed: int, max_bytes: int, num_samples: int, num_steps: int, num_tests: int
) -> dict[str, Any]:
    """All contenders in the maze: bytes, errors, and quartiles of nanoseconds a point for every number of points."""
    problem = scenes.maze()
    exact = VisibilityGraph(problem.workspace, problem.goals[0])
    plr = construct(exact, problem.workspace.bounds, max_bytes=max_bytes, seed=seed)
    rivals, skipped = make_all(makers(plr, exact, num_samples, num_steps, seed))
    contenders = {"PLR, planes": Rival(plr.num_bytes, jax.jit(plr), True), **rivals}
    x_free = problem.workspace.sample_free(num_tests, POINT_SEED + seed)
    rows = {name: {"bytes": rival.num_bytes, **errors(rival, exact, x_free)} for name, rival in contenders.items()}
    times = {n: interleaved(_calls(contenders, _points(n, 2, seed)), turns) for n in points}
    nanoseconds = {
        name: {str(n): [1e9 / n * s for s in seconds[name]] for n, seconds in times.items()}
        for name in times[points[0]]
    }
    return {"leaves": plr.num_leaves, "points": points, "rows": rows, "nanoseconds": nanoseconds, "skipped": skipped}


def makers(
    plr: PLR, exact: VisibilityGraph, num_samples: int, num_steps: int, seed: int
) -> dict[str, Callable[[], Rival]]:
    """Makers of the rivals of a PLR of the maze, at its bytes."""
    workspace = exact.workspace
    x = workspace.sample_free(num_samples, TRAINING_SEED + seed)
    distance = exact(x)
    grid = coded_grid(workspace, exact, plr.num_bytes, x, distance)
    num_leaves = leaves_that_fit(plr.num_bytes, 1)
    return {
        "grid, JAX": lambda: jax_grid(grid),
        "grid, SciPy": lambda: scipy_grid(grid),
        "network": lambda: train_network(x, distance, plr.num_bytes, num_steps, seed),
        "LightGBM linear tree": lambda: linear_trees(x, distance, num_leaves, 1, seed),
        "PLR, planes, Numba loop": lambda: Rival(plr.num_bytes, numba_loop(plr, parallel=True)),
        "PLR, planes, Numba loop, one core": lambda: Rival(plr.num_bytes, numba_loop(plr, parallel=False)),
    }


def _calls(contenders: dict[str, Rival], x: Float[np.ndarray, "n dim"]) -> dict[str, Callable[[], Any]]:
    """A call of each contender, and of the floors, for float32 points."""

    def call(answer: Callable[[Any], Any], x: Any) -> Callable[[], Any]:
        return lambda: answer(x)

    on_device = jnp.asarray(x)
    calls = {name: call(rival.answer, on_device if rival.on_device else x) for name, rival in contenders.items()}
    # Reading half of these bytes and writing the other half moves as many as reading points and writing answers.
    moved = np.zeros((x.size + len(x)) // 2, np.float32)
    return {**calls, "copy, JAX": call(_add_coordinates, on_device), "copy, NumPy": moved.copy}


@jax.jit
def _add_coordinates(x: Float[Array, "n dim"]) -> Float[Array, " n"]:
    return sum((x[:, axis] for axis in range(1, x.shape[1])), start=x[:, 0])


def _points(n: int, dim: int, seed: int) -> Float[np.ndarray, "n dim"]:
    return np.random.default_rng(POINT_SEED + seed).random((n, dim)).astype(np.float32)


def errors(rival: Rival, exact: Callable, x: Float[np.ndarray, "n dim"]) -> dict[str, float]:
    report = metrics.error_map(lambda x: rival.on_host(np.asarray(x, np.float32)), exact, x)
    return {"mean": report.mean, "max": report.max, "unanswered": report.num_unanswered}


def _joint(num_points: int, turns: int, num_leaves: int, seed: int) -> dict[str, Any]:
    """Joint distance of two point robots in the maze that change places."""
    problem = scenes.maze()
    workspace = problem.workspace
    first = VisibilityGraph(workspace, problem.goals[0])
    second = first.with_goal(problem.starts[0])

    def distance(q: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, " n"]:
        return np.hypot(first(q[:, :2]), second(q[:, 2:]))

    domain = (np.tile(workspace.bounds.lo, 2), np.tile(workspace.bounds.hi, 2))
    plr = construct(
        distance, domain, max_leaves=num_leaves, options=BuildOptions(num_samples=_SAMPLES_OF_JOINT), seed=seed
    )
    rivals, skipped = make_all(
        {
            "Numba loop, one core": lambda: Rival(plr.num_bytes, numba_loop(plr, parallel=False)),
            "Numba loop, all cores": lambda: Rival(plr.num_bytes, numba_loop(plr, parallel=True)),
        }
    )
    contenders = {"PLR": Rival(plr.num_bytes, jax.jit(plr), True), **rivals}
    q = np.concatenate([workspace.sample_free(num_points, POINT_SEED + seed + robot) for robot in range(2)], axis=1)
    seconds = interleaved(_calls(contenders, q.astype(np.float32)), turns)
    return {
        **size_of(plr),
        "points": num_points,
        "rows": {name: errors(rival, distance, q[:100_000]) for name, rival in contenders.items()},
        "nanoseconds": {name: [1e9 / num_points * s for s in times] for name, times in seconds.items()},
        "skipped": skipped,
    }
