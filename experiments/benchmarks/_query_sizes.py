"""Time of a PLR's query over dimensions, leaves and points; of one point; and compilations of a second PLR.

The function is the distance to a point off the center of the unit cube (a cone).
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from experiments._tables import aligned
from experiments.benchmarks._timing import interleaved
from plr_jax import PLR, VisibilityGraph, construct, scenes

POINT_SEED = 1_000
_DIMS = (2, 3, 4, 5, 6)
_LEAVES = (64, 1_024, 16_384, 65_536)
_LARGEST, _LARGEST_DIMS, _LARGEST_SECONDS = 10**6, (2, 4), 30
_SAMPLES = 16
_OTHER_GOALS = 4
_COMPILED = "/jax/core/compile/backend_compile_duration"
_COLORS = ("#0072B2", "#009E73", "#D55E00", "#CC79A7", "#444444")


def measure(points: list[int], leaves: int, turns: int, seed: int, smoke: bool) -> dict[str, Any]:
    sizes, skipped = _sizes(_DIMS[:2] if smoke else _DIMS, (64,) if smoke else _LEAVES, points, turns, seed)
    return {
        "sizes": sizes,
        "sizes_skipped": skipped,
        "one_point": _one_point(leaves, turns, seed),
        "other_goals": _other_goals(1 if smoke else _OTHER_GOALS, leaves, seed),
    }


def size_of(plr: PLR) -> dict[str, int]:
    return {"leaves": plr.num_leaves, "bytes": plr.num_bytes, "resident_bytes": plr.resident_bytes}


def _sizes(
    dims: tuple[int, ...], leaves: tuple[int, ...], points: list[int], turns: int, seed: int
) -> tuple[list[dict[str, Any]], dict[str, str]]:
    """Rows of all sizes. A million leaves are built only where that will not take long, judged by the size before."""
    rows, skipped = [], {}
    for dim in tqdm(dims, desc="dimensions", disable=None):
        plrs, seconds = {}, 0.0
        for number in leaves:
            plrs[number], seconds = _cone(dim, number, seed)
        expected = seconds * _LARGEST / max(leaves)
        if len(leaves) > 1 and dim in _LARGEST_DIMS:
            if expected < _LARGEST_SECONDS:
                plrs[_LARGEST], _ = _cone(dim, _LARGEST, seed)
            else:
                reason = f"would take {expected:.0f} s to construct, more than {_LARGEST_SECONDS} s"
                skipped[f"{_LARGEST:,} leaves in {dim}-D"] = reason
        rows += _rows(plrs, points, turns, seed)
    return rows, skipped


def _cone(dim: int, leaves: int, seed: int) -> tuple[PLR, float]:
    tip = np.linspace(0.31, 0.43, dim)
    begun = time.perf_counter()
    domain = (np.zeros(dim), np.ones(dim))
    plr = construct(
        lambda x: np.linalg.norm(x - tip, axis=1), domain, max_leaves=leaves, num_samples=_SAMPLES, seed=seed
    )
    return plr, time.perf_counter() - begun


def _rows(plrs: dict[int, PLR], points: list[int], turns: int, seed: int) -> list[dict[str, Any]]:
    """Nanoseconds a point of PLRs of one dimension, taking turns."""
    dim = next(iter(plrs.values())).dim
    rows = {leaves: {"dim": dim, **size_of(plr), "nanoseconds": {}} for leaves, plr in plrs.items()}
    for n in points:
        x = jnp.asarray(np.random.default_rng(POINT_SEED + seed).random((n, dim)), jnp.float32)
        calls: dict[str, Callable[[], Any]] = {str(leaves): partial(plr, x) for leaves, plr in plrs.items()}
        for leaves, seconds in interleaved(calls, turns).items():
            rows[int(leaves)]["nanoseconds"][str(n)] = [1e9 / n * s for s in seconds]
    return list(rows.values())


def _maze_plr(goal: np.ndarray, leaves: int, seed: int) -> PLR:
    workspace = scenes.maze().workspace
    return construct(VisibilityGraph(workspace, goal), workspace.bounds, max_leaves=leaves, seed=seed)


def _one_point(leaves: int, turns: int, seed: int) -> dict[str, list[float]]:
    """Microseconds of a call with one point."""
    plr = _maze_plr(scenes.maze().goals[0], leaves, seed)
    x = np.random.default_rng(POINT_SEED + seed).random((1, 2)).astype(np.float32)
    on_device, closed_over = jnp.asarray(x), jax.jit(plr)
    calls = {
        "plr(x), JAX array": lambda: plr(on_device),
        "plr(x), NumPy array": lambda: plr(x),
        "in a jitted function that holds the PLR": lambda: closed_over(on_device),
    }
    return {name: [1e6 * s for s in seconds] for name, seconds in interleaved(calls, turns).items()}


def _other_goals(number: int, leaves: int, seed: int) -> list[dict[str, Any]]:
    """Compilations when PLRs of other goals, with as many leaves, answer points after the first did."""
    workspace = scenes.maze().workspace
    first = _maze_plr(scenes.maze().goals[0], leaves, seed)
    x = jnp.asarray(np.random.default_rng(POINT_SEED + seed).random((1_000, 2)), jnp.float32)
    first(x).block_until_ready()
    rows, seen = [], {_shapes(first)}
    for goal in workspace.sample_free(number, POINT_SEED + seed):
        plr = _maze_plr(goal, leaves, seed)
        with compilations() as compiled:
            plr(x).block_until_ready()
        rows.append(
            {"leaves": plr.num_leaves, "tables_of_known_size": _shapes(plr) in seen, "compilations": len(compiled)}
        )
        seen.add(_shapes(plr))
    return rows


def _shapes(plr: PLR) -> tuple:
    return tuple((leaf.shape, str(leaf.dtype)) for leaf in jax.tree_util.tree_leaves(plr.tables))


@contextmanager
def compilations() -> Iterator[list[float]]:
    """Seconds of everything that XLA compiles meanwhile."""
    compiled: list[float] = []

    def listen(event: str, duration_secs: float, **_: Any) -> None:
        if event == _COMPILED:
            compiled.append(duration_secs)

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield compiled
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)


def table(results: dict[str, Any]) -> str:
    points = list(results["sizes"][0]["nanoseconds"])
    rows = [["dim", "leaves", *(f"ns a point of {int(n):,}" for n in points), "bytes in the file", "bytes resident"]]
    for row in results["sizes"]:
        times = [f"{row['nanoseconds'][n][0]:,.2f}" for n in points]
        rows.append(
            [str(row["dim"]), f"{row['leaves']:,}", *times, f"{row['bytes']:,}", f"{row['resident_bytes']:,}"]
        )
    one_point = [["one point", "us"], *([name, f"{times[0]:.1f}"] for name, times in results["one_point"].items())]
    left_out = [f"left out: {what}: {why}" for what, why in results["sizes_skipped"].items()]
    return "\n".join([aligned(rows, len(rows[0])), *left_out, aligned(one_point, 1)])


def claims(results: dict[str, Any]) -> list[str]:
    """What the section states of a single point and of a second PLR."""
    one_point = results["one_point"]["plr(x), JAX array"][0]
    alike = [row for row in results["other_goals"] if row["tables_of_known_size"]]
    known = sum(row["compilations"] for row in alike)
    others = sum(row["compilations"] for row in results["other_goals"]) - known
    return [
        f"one point through plr(x): {one_point:.1f} us (at most 15)",
        f"PLRs of {len(results['other_goals'])} other goals with as many leaves: {len(alike)} have tables of a known "
        f"size, and cause {known} compilations (none); the others cause {others}",
    ]


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
