"""Steps between all pairs of cells of a grid, beside what fleet planners fall back to when tables grow too large.

The rivals are the open length (Manhattan or octile distance), which takes no bytes, and differential heuristics: the
largest difference of the distances to some landmarks, the first the cell farthest from some cell, each next one
farthest from those before; never less than the open length. They take tables of 16 bits, or of 8 bits with twice the
landmarks, rounded so that bounds stay bounds: of one megabyte, and of as many bytes as the arrays that our query
reads take in memory, which are far more than our file. Gaps are to the exact distance, over pairs that a path joins;
below a hundredth of a step they count as exact.
"""

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Integer
from scipy import ndimage

from experiments._runner import run
from experiments.benchmarks._timing import interleaved
from plr_jax import GridGraph, GridPairs, construct_grid_pairs, scenes

Points = Float[np.ndarray, "n 2"]
Bound = Callable[[Float[Array, "n 2"], Float[Array, "n 2"]], Float[Array, "n"]]

_PUBLISHED = ("dao/den520d", "dao/den312d", "street/Berlin_0_256")
_MEGABYTE = 10**6
_AT_ONCE = 2**20
_EXACT = 0.01  # steps: no table is blamed for its rounding


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    num_starts, num_goals, num_timed, num_turns = (20, 50, 1_000, 1) if smoke else (1_000, 10_000, 2**20, 5)
    rows = []
    for name, free in grids(smoke):
        for connectivity in (4, 8):
            graph = GridGraph(free, connectivity=connectivity)
            contenders = build(graph, [10_000] if smoke else [_MEGABYTE])
            x, y = random_pairs(free, num_starts, num_goals, seed)
            truth = graph.between(x, y)
            timed = [jnp.asarray(points, jnp.float32) for points in random_pairs(free, num_timed, 1, seed + 1)]
            calls = {one.name: partial(one.bound, *timed) for one in contenders}
            seconds = interleaved(calls, num_turns)
            for one in contenders:
                row = {"map": name, "connectivity": connectivity, "cells": int(free.sum()), **one.record()}
                row |= gaps(one.bound, x, y, truth)
                rows.append(row | {"nanoseconds": 1e9 * seconds[one.name].median / num_timed})
    return {"rows": rows}


def grids(smoke: bool) -> list[tuple[str, np.ndarray]]:
    """Free cells of maps by name, without published ones whose data are absent, which is said."""
    if smoke:
        return [("random", np.random.default_rng(0).random((32, 32)) > 0.2)]
    found = []
    for name in _PUBLISHED:
        path = Path(os.environ.get("PLR_JAX_DATA", ""), "movingai", f"{name}.map")
        if path.exists():
            found.append((path.stem, scenes.read_cells(path)))
        else:
            print(f"{name}: skipped, PLR_JAX_DATA names no folder with movingai/{name}.map")
    return found


@dataclass(frozen=True)
class Contender:
    """A bound from below of all distances, and what it takes."""

    name: str
    bound: Bound
    num_bytes: int
    resident_bytes: int
    build_seconds: float
    load_seconds: float | None = None

    def record(self) -> dict[str, Any]:
        """All but the bound, fit for JSON."""
        return {
            "method": self.name,
            "bytes": self.num_bytes,
            "resident_bytes": self.resident_bytes,
            "build_seconds": self.build_seconds,
            "load_seconds": self.load_seconds,
        }


def build(graph: GridGraph, budgets: list[int]) -> list[Contender]:
    start = time.perf_counter()
    pairs = construct_grid_pairs(graph)
    built = time.perf_counter()
    GridPairs.from_bytes(pairs.to_bytes())
    loaded = time.perf_counter()
    size = pairs.num_bytes, pairs.resident_bytes
    ours = Contender("GridPairs", pairs, *size, built - start, loaded - built)
    rivals = [
        differential(graph, budget, bits, f"{num_landmarks(graph, budget, bits)} landmarks, {bits} bits")
        for budget in [*budgets, pairs.resident_bytes]
        for bits in (16, 8)
    ]
    return [ours, Contender("open length", jax.jit(partial(open_length, graph.connectivity)), 0, 0, 0.0), *rivals]


def num_landmarks(graph: GridGraph, budget: int, bits: int) -> int:
    """Landmarks whose tables take the bytes, or a little more."""
    return -(-8 * budget // (bits * int(graph.free.sum())))


def differential(graph: GridGraph, budget: int, bits: int, name: str) -> Contender:
    """A differential heuristic of so many bytes."""
    start = time.perf_counter()
    cells = np.argwhere(graph.free)[:, ::-1].astype(float)
    landmarks = farthest_landmarks(graph, cells, num_landmarks(graph, budget, bits))
    longest = landmarks[np.isfinite(landmarks)].max(initial=1)
    most = 2**bits - 2
    step = 1.0 if graph.connectivity == 4 and longest <= most else longest / most
    # What is rounded down differs by less than one step more than it says.
    slack = 0.0 if step == 1.0 else step * (1 + 1e-6)
    coded = np.where(np.isfinite(landmarks), np.floor(landmarks / step), most + 1).astype(f"uint{bits}")
    number = np.zeros(graph.free.shape, np.int32)
    number[graph.free] = np.arange(len(cells))
    table, places = jnp.asarray(np.ascontiguousarray(coded.T)), jnp.asarray(number)
    bound = partial(differences, graph.connectivity, step, slack, table, places)
    return Contender(name, bound, coded.nbytes, coded.nbytes, time.perf_counter() - start)


def farthest_landmarks(graph: GridGraph, cells: Points, count: int) -> Float[np.ndarray, "landmarks cells"]:
    """Distances of all free cells to landmarks of the largest part, each as far as can be from those before."""
    parts: Any = ndimage.label(graph.free)
    label = parts[0][graph.free]
    in_part = label == np.bincount(label).argmax()
    nearest, tables = graph.with_goal(cells[in_part][0])(cells), []
    for number in range(count):
        landmark = cells[int(np.argmax(np.where(in_part, nearest, -1)))]
        tables.append(graph.with_goal(landmark)(cells))
        nearest = tables[-1] if number == 0 else np.minimum(nearest, tables[-1])
    return np.stack(tables)


@partial(jax.jit, static_argnums=0)
def differences(
    connectivity: int,
    step: float,
    slack: float,
    table: Integer[Array, "cells landmarks"],
    places: Int[Array, "rows columns"],
    x: Float[Array, "n 2"],
    y: Float[Array, "n 2"],
) -> Float[Array, "n"]:
    """The largest difference of distances to landmarks, at least the open length."""

    def largest(ends: tuple[Int[Array, "chunk"], Int[Array, "chunk"]]) -> Int[Array, "chunk"]:
        a, b = (table[end].astype(jnp.int32) for end in ends)
        return jnp.abs(a - b).max(axis=1)

    size = min(1024, len(x))
    ends = [places[tuple(points.astype(jnp.int32)[:, ::-1].T)] for points in (x, y)]
    chunks = [jnp.pad(end, (0, -len(x) % size)).reshape(-1, size) for end in ends]
    bound = jax.lax.map(largest, tuple(chunks)).ravel()[: len(x)]
    bound = jnp.where(slack > 0, (bound * step - slack) * (1 - 2.0**-22), bound)
    return jnp.maximum(bound, open_length(connectivity, x, y))


def open_length(connectivity: int, x: Float[Array, "n 2"], y: Float[Array, "n 2"]) -> Float[Array, "n"]:
    """Length without obstacles, rounded down."""
    columns, rows = jnp.abs(jnp.floor(x) - jnp.floor(y)).T
    if connectivity == 4:
        return columns + rows
    diagonal = jnp.minimum(columns, rows)
    length = jnp.abs(columns - rows) + diagonal * np.float32(np.sqrt(2))
    return jnp.where(diagonal > 0, length * (1 - 2.0**-22), length)


def random_pairs(free: np.ndarray, num_starts: int, num_goals: int, seed: int) -> tuple[Points, Points]:
    """Random free cells, and as many random ones for each of them."""
    rng = np.random.default_rng(seed)
    cells = np.argwhere(free)[:, ::-1].astype(float)
    starts = cells[rng.integers(len(cells), size=num_starts)]
    return np.repeat(starts, num_goals, axis=0), cells[rng.integers(len(cells), size=num_starts * num_goals)]


def gaps(bound: Bound, x: Points, y: Points, truth: Float[np.ndarray, "n"]) -> dict[str, Any]:
    """How far below the truth a bound is, over pairs that a path joins, and how often it is above."""
    parts = [slice(begin, begin + _AT_ONCE) for begin in range(0, len(x), _AT_ONCE)]
    found = [np.asarray(bound(*(jnp.asarray(one[part], jnp.float32) for one in (x, y))), float) for part in parts]
    joined = np.isfinite(truth)
    gap = truth[joined] - np.concatenate(found)[joined]
    return {
        "pairs": len(gap),
        "mean_truth": float(truth[joined].mean()),
        "mean_gap": float(gap.mean()),
        "max_gap": float(gap.max()),
        "exact": float(np.mean(gap < _EXACT)),
        "violations": int(np.count_nonzero(gap < 0)),
    }


if __name__ == "__main__":
    run("grid_pairs", "Steps between all pairs of cells, beside differential heuristics.", compute)
