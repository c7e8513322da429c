"""Seconds of a construction, its errors, and where the time goes: oracle, fit, bookkeeping.

Two distances: one that costs next to nothing, the cone ``sqrt(x**2 + y**2)`` over the unit square, and the maze's
visibility graph. Seconds are medians of undisturbed runs. The shares come from one more run, in which Python reports
every call and return: each moment counts for the innermost of these that is under way: the distance function
(oracle), a function of the modules of fitting and of splitting (fit), anything else (bookkeeping: the tree, the
file's bytes, the tables of queries). What NumPy does counts for its caller.

Two more rows are tasks from end to end: the cone with 512 leaves and ``midrange`` planes, and from the maze's
obstacles as rings to a PLR within a largest error, by way of workspace and visibility graph, with the fewest leaves
that measure so.
"""

import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float
from tqdm import tqdm

from experiments._tables import aligned
from experiments.benchmarks._timing import interleaved
from plr_jax import PLR, DistanceFn, Problem, VisibilityGraph, Workspace, construct, midrange, scenes

LEAVES, FEW_LEAVES = (512, 4_096, 65_536), (64, 128)
CONE_LEAVES, CONE_ERROR, MAZE_ERROR = 512, 0.0005, 0.018
NUM_POINTS, NUM_TURNS, NUM_RUNS = 1_000_000, 15, 3
LIMIT, SECONDS_IN_ALL = 60.0, 10.0
_POINT_SEED = 1_000
_UNIT_SQUARE = ((0.0, 0.0), (1.0, 1.0))
_FIT_FOLDERS = ("plr_jax/plr/sampling/", "plr_jax/plr/leaves/")
_MORE_LEAVES = 1.05
_SAMPLES_OF_CONE = 64  # of a function that bends as little


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    num_points, leaves = (10_000, FEW_LEAVES) if smoke else (NUM_POINTS, LEAVES)
    problem = scenes.maze()
    oracle = VisibilityGraph(problem.workspace, problem.goals[0])
    square = np.random.default_rng(_POINT_SEED + seed).random((num_points, 2))
    free = problem.workspace.sample_free(num_points, _POINT_SEED + seed)
    cases: dict[str, tuple[DistanceFn, Float[np.ndarray, "n 2"]]] = {
        "cone": (cone, square),
        "maze, visibility graph": (oracle, free),
    }
    rows = [row for name, (fn, x) in cases.items() for row in _rows(name, fn, x, leaves, seed)]
    few = leaves[0] if smoke else CONE_LEAVES
    allowed, turns = (10 * MAZE_ERROR, 3) if smoke else (MAZE_ERROR, NUM_TURNS)
    tasks = _tasks(problem, square, free, few, allowed, turns, seed)
    return {"points": num_points, "rows": rows, "tasks": tasks}


def cone(x: Float[np.ndarray, "n dim"]) -> Float[np.ndarray, "n"]:
    """Distance to the origin: a function that costs next to nothing."""
    return np.sqrt(sum(column * column for column in x.T))


def _rows(
    name: str, distance_fn: DistanceFn, x: Float[np.ndarray, "n 2"], leaves: tuple[int, ...], seed: int
) -> Iterator[dict[str, Any]]:
    """One row a number of leaves; none that would take too long, going by the row before."""
    distance = distance_fn(x)
    construct(distance_fn, _UNIT_SQUARE, max_leaves=leaves[0], seed=seed)  # imports and compiles
    expected = 0.0
    for number in tqdm(leaves, desc=name, disable=None):
        if expected * number > LIMIT:
            yield {"function": name, "leaves": number, "skipped": f"{expected * number:.0f} s expected"}
            continue
        row = _row(distance_fn, x, distance, number, seed)
        expected = row["seconds"] / number
        yield {"function": name, "leaves": number, **row}


def _row(
    distance_fn: DistanceFn, x: Float[np.ndarray, "n 2"], distance: Float[np.ndarray, "n"], leaves: int, seed: int
) -> dict[str, Any]:
    def build(function: DistanceFn = distance_fn) -> PLR:
        return construct(function, _UNIT_SQUARE, max_leaves=leaves, seed=seed)

    num_samples = 0

    def oracle(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n"]:
        nonlocal num_samples
        num_samples += len(points)
        return distance_fn(points)

    parts = shares(lambda: build(oracle), oracle.__code__)
    seconds, plr = _median_seconds(build)
    return {**_error(plr, x, distance), "seconds": seconds, "samples": num_samples, "shares": parts}


def _median_seconds(build: Callable[[], PLR]) -> tuple[float, PLR]:
    """Median of a few runs, of one where that takes long, and what was built. Warm: one has been built before."""
    seconds, plr = [], None
    while plr is None or (len(seconds) < NUM_RUNS and sum(seconds) < SECONDS_IN_ALL):
        start = time.perf_counter()
        plr = build()
        seconds.append(time.perf_counter() - start)
    return float(np.median(seconds)), plr


def shares(build: Callable[[], Any], oracle: CodeType) -> dict[str, float]:
    """Shares of the time of a run: ``oracle``, ``fit`` and ``bookkeeping``.

    Args:
        build: The run.
        oracle: The code of the distance function that it calls.
    """
    seconds = {"oracle": 0.0, "fit": 0.0, "bookkeeping": 0.0}
    doing = ["bookkeeping"]
    since = time.perf_counter()

    def on_event(frame: FrameType, event: str, _: Any) -> None:
        nonlocal since
        seconds[doing[-1]] += time.perf_counter() - since
        if event == "call":
            doing.append(_part_of(frame.f_code, oracle) or doing[-1])
        elif event == "return" and len(doing) > 1:
            doing.pop()
        since = time.perf_counter()

    sys.setprofile(on_event)
    try:
        build()
    finally:
        sys.setprofile(None)
    return {part: value / sum(seconds.values()) for part, value in seconds.items()}


def _part_of(code: CodeType, oracle: CodeType) -> str | None:
    """The part that a function begins; None where it goes on with its caller's."""
    if code is oracle:
        return "oracle"
    path = Path(code.co_filename).as_posix()
    return "fit" if any(folder in path for folder in _FIT_FOLDERS) else None


def _error(plr: PLR, x: Float[np.ndarray, "n 2"], distance: Float[np.ndarray, "n"]) -> dict[str, Any]:
    error = np.abs(np.asarray(plr(x), np.float64) - distance)
    return {"bytes": plr.num_bytes, "max": float(error.max()), "mean": float(error.mean())}


def _tasks(
    problem: Problem,
    square: Float[np.ndarray, "n 2"],
    free: Float[np.ndarray, "m 2"],
    cone_leaves: int,
    allowed: float,
    num_turns: int,
    seed: int,
) -> dict[str, Any]:
    """The two tasks from end to end, warm."""
    distance = VisibilityGraph(problem.workspace, problem.goals[0])(free)
    rings = [shapely.get_coordinates(obstacle) for obstacle in problem.workspace.obstacles]
    goal = problem.goals[0]

    def maze_plr(leaves: int) -> PLR:
        workspace = Workspace(_UNIT_SQUARE, rings)
        return construct(VisibilityGraph(workspace, goal), workspace.bounds, max_leaves=leaves, seed=seed)

    def cone_plr() -> PLR:
        return construct(
            cone,
            _UNIT_SQUARE,
            max_leaves=cone_leaves,
            compute_coefficients=midrange,
            num_samples=_SAMPLES_OF_CONE,
            seed=seed,
        )

    leaves = fewest_leaves(lambda leaves: _error(maze_plr(leaves), free, distance)["max"], allowed)
    seconds = interleaved({"cone": cone_plr, "maze": lambda: maze_plr(leaves)}, num_turns)
    measured = {
        "cone": {"leaves": cone_leaves, "allowed": CONE_ERROR, **_error(cone_plr(), square, cone(square))},
        "maze": {"leaves": leaves, "allowed": allowed, **_error(maze_plr(leaves), free, distance)},
    }
    return {name: {**task, **seconds[name]._asdict()} for name, task in measured.items()}


def fewest_leaves(largest_error: Callable[[int], float], allowed: float) -> int:
    """The first number of leaves with an error that is allowed, going up from 32 by a twentieth."""
    leaves = 32
    while largest_error(leaves) > allowed:
        leaves = int(np.ceil(leaves * _MORE_LEAVES))
    return leaves


def table(results: dict[str, Any]) -> str:
    rows = [["function", "leaves", "seconds", "max error", "mean error", "bytes", "oracle", "fit", "bookkeeping"]]
    notes = []
    for row in results["rows"]:
        if "skipped" in row:
            notes.append(f"{row['function']}, {row['leaves']:,} leaves: skipped, {row['skipped']}")
            continue
        parts = [f"{100 * row['shares'][part]:.0f} %" for part in rows[0][-3:]]
        errors = [f"{row['max']:.2e}", f"{row['mean']:.2e}"]
        cells = [f"{row['leaves']:,}", f"{row['seconds']:.4f}", *errors, f"{row['bytes']:,}", *parts]
        rows.append([row["function"], *cells])
    a_cone, a_maze = results["tasks"]["cone"], results["tasks"]["maze"]
    ratios = [
        f"cone, {_task(a_cone)}, {1e3 * a_cone['median']:.1f} ms (at most 15)",
        f"maze, workspace to PLR, {_task(a_maze)}, {a_maze['median']:.3f} s (at most 0.15)",
    ]
    return "\n".join([aligned(rows, numbers=len(rows[0]) - 1), *notes, *ratios]) + "\n"


def _task(task: dict[str, Any]) -> str:
    return f"{task['leaves']:,} leaves: largest error {task['max']:.2g} (at most {task['allowed']})"
