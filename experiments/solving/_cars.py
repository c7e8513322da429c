"""Cars: closed forms of shortest paths, PLRs of them, and the table that planners look them up in.

The window is 50 by 50 turning radii, all headings, the goal in its middle. PLRs are built by ``construct`` of
continuous leaves. The table is that of a planner for a car of 0.4 m turning radius: cells of 5 cm over 20 m by 10 m,
the half that reflection leaves, and 72 headings, in float32. Planners take the nearest cell; interpolated, the same
table has a far smaller mean error. Errors are means over random poses, in turning radii. Closed forms and tables are
interpreted by NumPy in float64, PLRs compiled in float32.
"""

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from experiments.benchmarks._timing import interleaved
from plr_jax import Box, DistanceFn, Dubins, GridField, ReedsShepp, construct

ORACLES = {"Reeds-Shepp": ReedsShepp, "Dubins": Dubins}
HALF = 25.0  # turning radii
BYTES, _SMOKE_BYTES = (16_384, 65_536), (1_024,)
TABLE, _SMOKE_TABLE = (401, 201, 72), (41, 21, 12)
POSES, BATCHES = 1_000_000, (1, 1_000, 100_000)
_POSE_SEED = 63_000
_WINDOW = Box((-HALF, -HALF, -np.pi), (HALF, HALF, np.pi), periodic=(False, False, True))


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    rng = np.random.default_rng(_POSE_SEED + seed)
    x = _WINDOW.lo + _WINDOW.width * rng.random((2_000 if smoke else POSES, 3))
    batches = [size for size in BATCHES if size <= len(x)]
    rows = []
    for name, make in ORACLES.items():
        oracle = make((0, 0, 0), 1.0)
        truth = oracle(x)
        row = {"car": name, "method": "closed form", "nanoseconds": _nanoseconds(oracle, x, batches, smoke)}
        rows.append({**row, "bytes": 0, "seconds": 0.0, **_errors(truth, truth)})
        for max_bytes in _SMOKE_BYTES if smoke else BYTES:
            began = time.perf_counter()
            plr = construct(oracle, _WINDOW, leaf="continuous", max_bytes=max_bytes, seed=seed)
            row = {"car": name, "method": "PLR", "seconds": time.perf_counter() - began, "bytes": plr.num_bytes}
            row["nanoseconds"] = _nanoseconds(jax.jit(plr), x.astype(np.float32), batches, smoke)
            rows.append(row | _errors(np.asarray(plr(x), float), truth))
        began = time.perf_counter()
        values = lookup_table(oracle, _SMOKE_TABLE if smoke else TABLE)
        table = {"car": name, "seconds": time.perf_counter() - began, "bytes": values.nbytes}
        field = field_of(values)
        for method, of_table in {
            "table, nearest": partial(looked_up, values),
            "table, interpolated": lambda x, field=field: field(_reflected(x)),
        }.items():
            row = table | {"method": method, "nanoseconds": _nanoseconds(of_table, x, batches, smoke)}
            rows.append(row | _errors(of_table(x), truth))
    return {"poses": len(x), "batches": batches, "rows": rows}


def _nanoseconds(
    answer: Callable[[Any], Any], x: Float[np.ndarray, "n 3"], batches: list[int], smoke: bool
) -> list[float]:
    """Of a pose, in batches of several sizes."""
    turns = {"num_turns": 1, "seconds_a_turn": 0.0} if smoke else {}
    calls = {f"{size}": lambda size=size: answer(x[:size]) for size in batches}
    seconds = interleaved(calls, **turns)
    return [1e9 * seconds[f"{size}"].median / size for size in batches]


def lookup_table(oracle: DistanceFn, sizes: tuple[int, int, int]) -> Float[np.ndarray, "columns rows headings"]:
    """Distances at ``x`` from border to border, ``y`` from the middle to the border, and even headings."""
    steps = _steps(np.array(sizes))
    axes = [start + step * np.arange(n) for start, step, n in zip((-HALF, 0, -np.pi), steps, sizes, strict=True)]
    poses = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    return oracle(poses.reshape(-1, 3)).astype(np.float32).reshape(sizes)


def looked_up(values: Float[np.ndarray, "columns rows headings"], x: Float[np.ndarray, "n 3"]) -> Any:
    """What the nearest cell of a table says; poses to the right of the goal's heading are reflected."""
    sizes = np.array(values.shape)
    columns, rows, headings = np.rint((_reflected(x) - (-HALF, 0, -np.pi)) / _steps(sizes)).astype(int).T
    return values[columns, rows, headings % sizes[2]]


def field_of(values: Float[np.ndarray, "columns rows headings"]) -> GridField:
    """The table as a field between the centers of its cells."""
    half = _steps(np.array(values.shape)) / 2
    lo, hi = np.array([-HALF, 0, -np.pi]) - half, np.array([HALF, HALF, np.pi]) + half * (1, 1, -1)
    return GridField(values.T, Box(lo, hi, periodic=(False, False, True)))


def _reflected(x: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    return np.where(x[:, 1:2] < 0, x * (1, -1, -1), x)


def _steps(sizes: Any) -> Float[np.ndarray, "3"]:
    return np.array([2 * HALF, HALF, 2 * np.pi]) / (sizes - np.array([1, 1, 0]))


def _errors(answer: Float[np.ndarray, " n"], truth: Float[np.ndarray, " n"]) -> dict[str, float]:
    error = np.abs(answer - truth)
    return {"mean": float(error.mean()), "largest": float(error.max()), "mean_distance": float(truth.mean())}
