"""Time of a query: a PLR against its rivals, in the plane at equal bytes, and alone over dimensions and leaves.

In the plane, all answer the same random points of the maze:

- Nodes of grids and weights of the network are float32 numbers that fill the bytes of the PLR's file.
- SciPy's grid and LightGBM are timed with float32 and with float64 points; ratios are to the faster.
- LightGBM has one tree of as many leaves as the PLR, after the stump that it needs (see ``_trees.py``).
- The Numba loops read the PLR's own tables, on one core and on all.
- The floors: JAX reading the points and writing one float for each, and NumPy copying as many bytes.

In four dimensions the function is the joint distance of two point robots of the maze that change places and ignore
one another, ``sqrt(d1**2 + d2**2)``. How time grows with dimensions, leaves and points is in ``_query_sizes.py``.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from experiments._tables import aligned
from experiments.benchmarks import _query_sizes
from experiments.benchmarks._grids import filled_grid, interpax_grid, map_coordinates, scipy_grid, triangles
from experiments.benchmarks._network import train_network
from experiments.benchmarks._numba_loop import numba_loop
from experiments.benchmarks._rivals import Rival, make_all
from experiments.benchmarks._timing import interleaved
from experiments.benchmarks._trees import linear_trees
from plr_jax import PLR, VisibilityGraph, construct, metrics, scenes

POINT_SEED, TRAINING_SEED = 1_000, 2_000
LEAVES, SMOKE_LEAVES = 512, 64
_SAMPLES_OF_JOINT = 64
_DOUBLE = ", float64 points"
_RATIOS = {
    "map_coordinates": "at most 1.2",
    "Numba loop": "at most 2",
    "copy, JAX": "at most 6",
    "SciPy RegularGridInterpolator": "at most 1/40 = 0.025",
    "LightGBM linear tree": "at most 1/30 = 0.033",
}


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    points, turns, leaves = ([1, 1_000], 2, SMOKE_LEAVES) if smoke else ([1, 1_000, 1_000_000], 15, LEAVES)
    return {
        "plane": _plane(points, turns, leaves, seed, *((2_000, 20, 1_000) if smoke else (100_000, 4_000, 20_000))),
        "joint": _joint(points[-1], turns, 500 if smoke else 50_000, seed),
        **_query_sizes.measure(points, leaves, turns, seed, smoke),
    }


def maze_plr(leaves: int, seed: int) -> tuple[PLR, VisibilityGraph]:
    """The maze's distance as a PLR, and the distance itself."""
    problem = scenes.maze()
    exact = VisibilityGraph(problem.workspace, problem.goals[0])
    return construct(exact, problem.workspace.bounds, max_leaves=leaves, seed=seed), exact


def _plane(
    points: list[int], turns: int, leaves: int, seed: int, num_samples: int, num_steps: int, num_tests: int
) -> dict[str, Any]:
    """All contenders in the maze: bytes, errors, and quartiles of nanoseconds a point for every number of points."""
    plr, exact = maze_plr(leaves, seed)
    rivals, skipped = make_all(makers(plr, exact, num_samples, num_steps, seed))
    contenders = {"PLR": Rival(plr.num_bytes, plr, True), **rivals}
    x_free = scenes.maze().workspace.sample_free(num_tests, POINT_SEED + seed)
    rows = {name: {"bytes": rival.num_bytes, **_errors(rival, exact, x_free)} for name, rival in contenders.items()}
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
    workspace = scenes.maze().workspace
    grid = filled_grid(workspace, exact, plr.num_bytes)
    x = workspace.sample_free(num_samples, TRAINING_SEED + seed)
    distance = exact(x)
    return {
        "map_coordinates": lambda: map_coordinates(grid),
        "interpax, linear": lambda: interpax_grid(grid, "linear"),
        "network": lambda: train_network(x, distance, plr.num_bytes, num_steps, seed),
        "SciPy RegularGridInterpolator": lambda: scipy_grid(grid),
        "SciPy LinearNDInterpolator": lambda: triangles(workspace, plr.num_bytes, x, distance),
        "LightGBM linear tree": lambda: linear_trees(x, distance, plr.num_leaves, 1, seed),
        "Numba loop, one core": lambda: Rival(plr.num_bytes, numba_loop(plr, parallel=False)),
        "Numba loop, all cores": lambda: Rival(plr.num_bytes, numba_loop(plr, parallel=True)),
    }


def _calls(contenders: dict[str, Rival], x: Float[np.ndarray, "n dim"]) -> dict[str, Callable[[], Any]]:
    """A call of each contender, and of the floors, for float32 points."""

    def call(answer: Callable[[Any], Any], x: Any) -> Callable[[], Any]:
        return lambda: answer(x)

    on_device = jnp.asarray(x)
    calls = {name: call(rival.answer, on_device if rival.on_device else x) for name, rival in contenders.items()}
    for name in contenders:
        if name in ("SciPy RegularGridInterpolator", "LightGBM linear tree"):
            calls[name + _DOUBLE] = call(contenders[name].answer, x.astype(np.float64))
    # Reading half of these bytes and writing the other half moves as many as reading points and writing answers.
    moved = np.zeros((x.size + len(x)) // 2, np.float32)
    return {**calls, "copy, JAX": call(_add_coordinates, on_device), "copy, NumPy": moved.copy}


@jax.jit
def _add_coordinates(x: Float[Array, "n dim"]) -> Float[Array, "n"]:
    return sum((x[:, axis] for axis in range(1, x.shape[1])), start=x[:, 0])


def _points(n: int, dim: int, seed: int) -> Float[np.ndarray, "n dim"]:
    return np.random.default_rng(POINT_SEED + seed).random((n, dim)).astype(np.float32)


def _errors(rival: Rival, exact: Callable, x: Float[np.ndarray, "n dim"]) -> dict[str, float]:
    report = metrics.error_map(lambda x: rival.on_host(np.asarray(x, np.float32)), exact, x)
    return {"mean": report.mean, "max": report.max, "unanswered": report.num_unanswered}


def _joint(num_points: int, turns: int, num_leaves: int, seed: int) -> dict[str, Any]:
    """Joint distance of two point robots in the maze that change places."""
    problem = scenes.maze()
    workspace = problem.workspace
    first = VisibilityGraph(workspace, problem.goals[0])
    second = first.with_goal(problem.starts[0])

    def distance(q: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "n"]:
        return np.hypot(first(q[:, :2]), second(q[:, 2:]))

    domain = (np.tile(workspace.bounds.lo, 2), np.tile(workspace.bounds.hi, 2))
    plr = construct(distance, domain, max_leaves=num_leaves, num_samples=_SAMPLES_OF_JOINT, seed=seed)
    rivals, skipped = make_all(
        {
            "Numba loop, one core": lambda: Rival(plr.num_bytes, numba_loop(plr, parallel=False)),
            "Numba loop, all cores": lambda: Rival(plr.num_bytes, numba_loop(plr, parallel=True)),
        }
    )
    contenders = {"PLR": Rival(plr.num_bytes, plr, True), **rivals}
    q = np.concatenate([workspace.sample_free(num_points, POINT_SEED + seed + robot) for robot in range(2)], axis=1)
    seconds = interleaved(_calls(contenders, q.astype(np.float32)), turns)
    return {
        **_query_sizes.size_of(plr),
        "points": num_points,
        "rows": {name: _errors(rival, distance, q[:100_000]) for name, rival in contenders.items()},
        "nanoseconds": {name: [1e9 / num_points * s for s in times] for name, times in seconds.items()},
        "skipped": skipped,
    }


def table(results: dict[str, Any]) -> str:
    plane, joint = results["plane"], results["joint"]
    joint_rows = [["4-D, two robots", "ns a point", "mean error", "max error"]]
    for name, quartiles in joint["nanoseconds"].items():
        joint_rows.append([name, f"{quartiles[0]:.2f}", *_error_cells(joint["rows"].get(name))])
    reasons = {**plane["skipped"], **joint["skipped"]}
    return "\n".join(
        [
            f"the maze, {plane['leaves']} leaves",
            aligned(_plane_rows(plane), len(plane["points"]) + 4),
            f"{joint['leaves']:,} leaves, {joint['bytes']:,} bytes, {joint['points']:,} points",
            aligned(joint_rows, 3),
            _query_sizes.table(results),
            *(f"skipped: {name}: {reason}" for name, reason in reasons.items()),
            *_ratios(plane),
            f"4-D, {joint['leaves']:,} leaves: {joint['nanoseconds']['PLR'][0]:.1f} ns a point (at most 12)",
            *_query_sizes.claims(results),
            "",
        ]
    )


def _plane_rows(plane: dict[str, Any]) -> list[list[str]]:
    head = ["", *(f"ns a point of {n:,}" for n in plane["points"]), "bytes", "mean error", "max error", "unanswered"]
    rows = [head]
    for name, times in plane["nanoseconds"].items():
        row = plane["rows"].get(name.removesuffix(_DOUBLE))
        cells = [f"{times[str(n)][0]:,.2f}" for n in plane["points"]]
        about = [f"{row['bytes']:,}", *_error_cells(row), f"{row['unanswered']:,}"] if row else ["-"] * 4
        rows.append([name, *cells, *about])
    return rows


def _error_cells(row: dict[str, Any] | None) -> list[str]:
    return [f"{row['mean']:.5f}", f"{row['max']:.4f}"] if row else ["-", "-"]


def _ratios(plane: dict[str, Any]) -> list[str]:
    """PLR over each kind of rival, of which the fastest counts, for the most points."""
    n = plane["points"][-1]
    medians = {name: times[str(n)][0] for name, times in plane["nanoseconds"].items()}
    lines = []
    for rival, claim in _RATIOS.items():
        names = [name for name in medians if name.startswith(rival)]
        if names:
            fastest = min(names, key=lambda name: medians[name])
            lines.append(f"{n:,} points: PLR / {fastest} {medians['PLR'] / medians[fastest]:.3f} ({claim})")
    return lines


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    return _query_sizes.draw(results, output)
