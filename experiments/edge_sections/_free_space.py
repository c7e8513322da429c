"""What is free and how far walls are, asked by compiled functions: tables beside Shapely, time a point."""

import time
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from experiments.benchmarks._maps import load_maps
from experiments.benchmarks._oracle import polygon_field
from plr_jax import Workspace

FIELDS, NUM_POINTS, NUM_RUNS = (4_000, 40_000), 1_000_000, 5


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    rows, (num_points, num_runs) = [], (1000, 1) if smoke else (NUM_POINTS, NUM_RUNS)
    for name, workspace in _maps(seed, smoke):
        rows.append({"map": name, **_measured(workspace, seed, num_points, num_runs)})
        print(_line(rows[-1]), end="", flush=True)
    return {"points": num_points, "rows": rows}


def _maps(seed: int, smoke: bool) -> Iterator[tuple[str, Workspace]]:
    for name, (workspace, _) in load_maps(("maze",) if smoke else ("maze", "arena", "den520d")).items():
        yield name, workspace
    for num_vertices in (80,) if smoke else FIELDS:
        yield f"field {num_vertices:,}", polygon_field(num_vertices, seed)[0]


def _measured(workspace: Workspace, seed: int, num_points: int, num_runs: int) -> dict[str, Any]:
    edges, (seconds, tables) = len(workspace.boundary.edges), _timed(lambda: workspace.tables)
    rng = np.random.default_rng(seed)
    x = jnp.asarray(rng.uniform(workspace.bounds.lo, workspace.bounds.hi, (num_points, 2)), jnp.float32)
    tables.clearance(x).block_until_ready()
    runs = [_timed(lambda: tables.clearance(x).block_until_ready()) for _ in range(num_runs)]
    by_shapely, expected = _timed(lambda: workspace.clearance(np.asarray(x, np.float64)))
    error = np.abs(np.asarray(runs[0][1], np.float64) - expected).max()
    return {
        "edges": edges,
        "bytes": sum(array.nbytes for array in jax.tree.leaves(tables)),
        "seconds_to_build": seconds,
        "nanoseconds": float(np.median([each for each, _ in runs])) / num_points * 1e9,
        "nanoseconds_shapely": by_shapely / num_points * 1e9,
        "largest_error": float(error / workspace.bounds.width.max()),
    }


def _timed(call: Callable[[], Any]) -> tuple[float, Any]:
    start = time.perf_counter()
    result = call()
    return time.perf_counter() - start, result


def table(results: dict[str, Any]) -> str:
    return "".join(map(_line, results["rows"]))


def _line(row: dict[str, Any]) -> str:
    return (
        f"{row['map']:14}{row['edges']:>7,} edges {row['bytes'] / 1e6:6.2f} MB, built in "
        f"{row['seconds_to_build']:.2f} s  ns a point {row['nanoseconds']:7.0f}, by Shapely "
        f"{row['nanoseconds_shapely']:7.0f}  largest error {row['largest_error']:.1e} of the longer side\n"
    )
