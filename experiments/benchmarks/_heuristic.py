"""The heuristic of a planner: robots' distances evaluated a second, for teams of 2 to 16 discs in four rooms.

What a planner calls is a function of NumPy arrays: ``sum_of_distances(plrs)``, or its ``per_robot`` for the terms. A
user who stays on the device sums the PLRs within ``jax.jit``. Beside them: a compiled loop of one thread over the
same planes (Numba, float64), and what OMPL offers, a callback from C++ to Python for one state at a time, which
evaluates the planes with the same compiled loop; beside that, a callback that does nothing but return.

Teams of 2 are the first of 4; teams of 16 are those of 8 twice, each PLR with arrays of its own.
"""

import importlib.util
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from tqdm import tqdm

from experiments._planning import PLR_BYTES
from experiments._tables import aligned
from experiments.benchmarks._timing import interleaved
from plr_jax import PLR, Problem, construct, robot_distance_fns, scenes, sum_of_distances

TEAMS = (2, 4, 8, 16)
BATCHES, SMOKE_BATCHES = (1, 64, 4_096, 32_768, 1_000_000), (1, 64)
NUM_TURNS, NUM_STATES = 9, 10_000
SUM, TERMS, IN_JIT, LOOP = "sum_of_distances", "its terms, per_robot", "sum within jax.jit", "Numba loop"
CALLBACK, FLOOR = "OMPL callback", "OMPL callback that does nothing"
_POINT_SEED, _NUM_ERRORS = 1_000, 20_000
_ALONE = {LOOP: ("numba",), CALLBACK: ("ompl", "numba"), FLOOR: ("ompl", "numba")}


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    teams, batches = (TEAMS[:2], SMOKE_BATCHES) if smoke else (TEAMS, BATCHES)
    missing = {name: [part for part in parts if not importlib.util.find_spec(part)] for name, parts in _ALONE.items()}
    skipped = {
        name: f"not installed: {', '.join(parts)} (pip install '.[baselines]')"
        for name, parts in missing.items()
        if parts
    }
    rows = []
    for size in sorted({_scene_size(robots) for robots in teams}):
        problem = scenes.four_rooms(size)
        plrs, errors = team_plrs(problem, 512 if smoke else PLR_BYTES, seed)
        for robots in tqdm([robots for robots in teams if _scene_size(robots) == size], desc="teams", disable=None):
            rows.append(_row(problem, team_of(plrs, robots), batches, seed, smoke, skipped) | errors)
    return {"skipped": skipped, "rows": rows}


def _scene_size(robots: int) -> int:
    """Robots of the scene that a team's PLRs are of."""
    return 4 if robots <= 4 else 8


def team_plrs(problem: Problem, num_bytes: int, seed: int) -> tuple[list[PLR], dict[str, float]]:
    """A PLR for each robot of a problem, and the errors of them all."""
    exact = robot_distance_fns(problem)
    plrs = [construct(fn, problem.workspace.bounds, max_bytes=num_bytes, seed=seed) for fn in exact]
    x = problem.workspace.sample_free(_NUM_ERRORS, _POINT_SEED + seed)
    error = np.concatenate([np.abs(plr(x) - fn(x)) for plr, fn in zip(plrs, exact, strict=True)])
    error = error[np.isfinite(error)]  # a disc's center cannot be next to a wall
    return plrs, {"max": float(error.max()), "mean": float(error.mean())}


def team_of(plrs: list[PLR], robots: int) -> list[PLR]:
    """The first PLRs, or all of them several times, each with arrays of its own."""
    return [jax.tree.map(jnp.copy, plrs[i % len(plrs)]) for i in range(robots)]


def team_configurations(problem: Problem, robots: int, n: int, seed: int) -> Float[np.ndarray, "n robots 2"]:
    """Random joint configurations, each robot somewhere in free space."""
    return problem.workspace.sample_free(n * robots, _POINT_SEED + seed).reshape(n, robots, 2)


def _row(
    problem: Problem, plrs: list[PLR], batches: tuple[int, ...], seed: int, smoke: bool, skipped: dict[str, str]
) -> dict[str, Any]:
    """A team's distances a second, by contender and batch."""
    q = team_configurations(problem, len(plrs), max(batches), seed)
    turns = 3 if smoke else NUM_TURNS
    rates: dict[str, dict[str, float]] = {}
    for n in batches:
        seconds = interleaved(_batched(plrs, q[:n], skipped), turns)
        for name, each in seconds.items():
            rates.setdefault(name, {})[str(n)] = n * len(plrs) / each.median
    row = {"robots": len(plrs), "bytes": sum(plr.num_bytes for plr in plrs), "distances_a_second": rates}
    callbacks = {} if CALLBACK in skipped else _callbacks(plrs, q[: 500 if smoke else NUM_STATES])
    seconds = interleaved(callbacks, turns)
    calls = {name: callbacks[name].num_calls / seconds[name].median for name in callbacks}
    return {**row, "calls_a_second": calls}


def _batched(
    plrs: list[PLR], q: Float[np.ndarray, "n robots 2"], skipped: dict[str, str]
) -> dict[str, Callable[[], Any]]:
    heuristic, on_device = sum_of_distances(plrs), jnp.asarray(q, jnp.float32)
    contenders = {
        SUM: lambda: heuristic(q),
        TERMS: lambda: heuristic.per_robot(q),
        IN_JIT: lambda: _sum_in_jit(plrs, on_device),
    }
    if LOOP not in skipped:
        from experiments.benchmarks._scalar_heuristic import ScalarTables, sums

        tables = ScalarTables(plrs)
        contenders[LOOP] = lambda: sums(q, tables.address)
    return contenders


def _callbacks(plrs: list[PLR], q: Float[np.ndarray, "n robots 2"]) -> dict[str, Any]:
    from experiments.benchmarks._scalar_heuristic import Callback, ScalarTables

    return {CALLBACK: Callback(q, ScalarTables(plrs)), FLOOR: Callback(q, None)}


@jax.jit
def _sum_in_jit(plrs: list[PLR], q: Float[Array, "n robots 2"]) -> Float[Array, "n"]:
    return sum((plr(q[:, i]) for i, plr in enumerate(plrs)), start=jnp.zeros(len(q)))


def table(results: dict[str, Any]) -> str:
    rows = results["rows"]
    batches = list(rows[0]["distances_a_second"][SUM])
    cells = [["robots", "contender", *(f"n = {int(n):,}" for n in batches), "bytes", "max error", "mean error"]]
    for row in rows:
        size = [f"{row['bytes']:,}", f"{row['max']:.3f}", f"{row['mean']:.4f}"]
        for name, rates in row["distances_a_second"].items():
            cells.append([f"{row['robots']}", name, *(_millions(rates[n]) for n in batches), *size])
        for name, calls in row["calls_a_second"].items():
            one = _millions(calls * row["robots"]) if name == CALLBACK else f"({_millions(calls)})"
            cells.append([f"{row['robots']}", name, one, *[""] * (len(batches) - 1), *size])
    notes = [
        "Millions of robot distances a second; in brackets, millions of calls.",
        *(f"{name}: skipped, {reason}" for name, reason in results["skipped"].items()),
    ]
    return "\n".join([aligned(cells, numbers=len(cells[0]) - 2), *notes, *_ratios(rows)]) + "\n"


def _ratios(rows: list[dict[str, Any]]) -> list[str]:
    lines = []
    for row in rows:
        best = {name: max(rates.values()) for name, rates in row["distances_a_second"].items()}
        asked = " (at least 150)" if row["robots"] == 4 else ""
        rates = ", ".join(f"{name} {_millions(best[name])}" for name in (SUM, TERMS, IN_JIT))
        lines.append(f"{row['robots']} discs, millions a second in the best batch: {rates}{asked}")
        if CALLBACK in row["calls_a_second"]:
            callback = row["calls_a_second"][CALLBACK] * row["robots"]
            lines.append(f"{row['robots']} discs: {SUM} / {CALLBACK} {best[SUM] / callback:.0f}")
    return lines


def _millions(rate: float) -> str:
    return f"{rate / 1e6:,.1f}" if rate >= 1e7 else f"{rate / 1e6:,.3f}"
