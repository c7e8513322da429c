"""Pairs of the cells of large grids, as fleets of robots need them: errors, bytes, seconds, nanoseconds, windows.

Two grids are made, of game terrain like that of the League of Robot Runners: 96,603 free cells in 656 x 1,491, narrow
passages, and 2,217,759 in 1,912 x 1,800, open land. Where ``PLR_JAX_FLEET_MAPS`` names a folder with maps of its
start kit, these are measured as well. The rival is a table for each goal, of 4 bytes a cell. Wrong is what differs
from a search (of 8-connected lengths, by more than a millionth), among random pairs and among pairs of cells at most
40 rows and columns apart. Seconds are those of processors, and of windows also elapsed, a process for each grid,
whose memory is the most that it took until the pairs were built.
"""

import ctypes
import os
import resource
import shutil
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Int
from scipy import ndimage

from experiments._c_headers import compiled_library, median_seconds
from experiments._runner import run
from plr_jax import GridGraph, GridPairs, construct_grid_pairs, scenes
from plr_jax.pairs.grid_query import GridTables

_MAPS = "orz900d", "scene_mp_2p_01", "warehouse_long_corridor_large", "Boston_0_256"
_GOALS, _TABLE_BYTES = 10_000, 4
_NEAR = 40
_RADIUS, _AGENTS = 5, 10_000


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    grids = [("made, small", terrain((40, 60), 900, 4, 1, 0))] if smoke else list(_grids())
    sizes = (2, 500, 50, 2_000) if smoke else (40, 25_000, 2_500, 10**6)
    rows = []
    for name, free in grids:
        for connectivity in (4, 8):
            if smoke:
                rows.append(_measure(name, free, connectivity, seed, *sizes))
            else:
                with ProcessPoolExecutor(1, get_context("spawn")) as process:
                    rows.append(process.submit(_measure, name, free, connectivity, seed, *sizes).result())
            print(rows[-1], flush=True)
    return {"rows": rows}


def _grids():
    yield "made, passages", terrain((656, 1491), 96_603, 2, 12, 0)
    yield "made, open land", terrain((1912, 1800), 2_217_759, 6, 1.5, 1)
    folder = Path(os.environ.get("PLR_JAX_FLEET_MAPS", ""))
    for name in _MAPS:
        if (folder / f"{name}.map").exists():
            yield name, scenes.read_cells(folder / f"{name}.map")
        else:
            print(f"{name}: skipped, PLR_JAX_FLEET_MAPS names no folder with {name}.map")


def terrain(
    shape: tuple[int, int], num_free: int, grain: int, smoothness: float, seed: int
) -> Bool[np.ndarray, "rows columns"]:
    """Land in blocks of cells, of which so many are free: those of a band of heights if few, else the lowest."""
    coarse = tuple(-(-size // grain) for size in shape)
    height = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=coarse), smoothness)
    height = abs(height) if 2 * num_free < shape[0] * shape[1] else height
    cells = height.repeat(grain, axis=0).repeat(grain, axis=1)[: shape[0], : shape[1]]
    free = np.zeros(shape, bool)
    free.ravel()[np.argsort(cells, axis=None, kind="stable")[:num_free]] = True
    return free


def _measure(
    name: str,
    free: Bool[np.ndarray, "rows columns"],
    connectivity: int,
    seed: int,
    num_starts: int,
    num_random: int,
    num_near: int,
    num_timed: int,
) -> dict[str, Any]:
    graph = GridGraph(free, connectivity=connectivity)
    begin, cpu = time.perf_counter(), time.process_time()
    pairs = construct_grid_pairs(graph)
    seconds, cpu = time.perf_counter() - begin, time.process_time() - cpu
    assert isinstance(pairs.tables, GridTables), "exact, as no memory was asked for"
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    rng, cells = np.random.default_rng(seed), np.argwhere(free)
    starts = cells[rng.integers(len(cells), size=num_starts)]
    random = cells[rng.integers(len(cells), size=(num_starts, num_random))]
    near = starts[:, None] + rng.integers(-_NEAR, _NEAR + 1, (num_starts, num_near, 2))
    near = np.where((near < 0) | (near >= free.shape), starts[:, None], near)
    ends = cells[rng.integers(len(cells), size=(num_timed, 2))]
    x, y = (jnp.asarray(ends[:, k, ::-1], jnp.float32) for k in range(2))
    agents = slice(0, min(_AGENTS, num_timed))
    row = {
        "map": name,
        "connectivity": connectivity,
        "cells": len(cells),
        "corners": pairs.num_corners,
        "distances": type(pairs.tables.distances).__name__,
        "build_seconds": seconds,
        "build_cpu_seconds": cpu,
        "peak_gigabytes_of_process": peak,
        "file_bytes": pairs.num_bytes,
        "resident_bytes": pairs.resident_bytes,
        "tables_over_ours": _GOALS * _TABLE_BYTES * len(cells) / pairs.resident_bytes,
        "random_pairs": num_starts * num_random,
        "near_pairs": num_starts * num_near,
        "wrong": _num_wrong(graph, pairs, starts, np.concatenate([random, near], axis=1)),
        "cpu_nanoseconds": 1e9 * _seconds(lambda: pairs(x, y).block_until_ready())[0] / num_timed,
    }
    windows = _seconds(lambda: pairs.window(y[agents], x[agents], _RADIUS).block_until_ready())
    row |= dict(zip(("window_cpu_seconds", "window_seconds"), windows, strict=True))
    return row | _in_c(pairs, ends)


def _num_wrong(
    graph: GridGraph, pairs: GridPairs, starts: Int[np.ndarray, "n 2"], ends: Int[np.ndarray, "n k 2"]
) -> int:
    """Of how many pairs the answer is another than that of a search."""
    wrong = 0
    for start, others in zip(starts, ends, strict=True):
        x, y = (np.broadcast_to(points[..., ::-1], others.shape).astype(float) for points in (start, others))
        truth, found = graph.between(x, y), np.asarray(pairs(x, y), float)
        joined = np.isfinite(truth)
        # 8-connected lengths are never above the truth, and less than a millionth below.
        least = truth if graph.connectivity == 4 else truth * (1 - 1e-6)
        same = (found <= truth) & (found >= least)
        wrong += int(np.count_nonzero(~same[joined]) + np.count_nonzero(np.isfinite(found) != joined))
    return wrong


def _seconds(call) -> list[float]:
    """Of all cores, and until it was done."""
    call()
    times = []
    for _ in range(3):
        cpu, begin = time.process_time(), time.perf_counter()
        call()
        times.append((time.process_time() - cpu, time.perf_counter() - begin))
    return np.median(times, axis=0).tolist()


def _in_c(pairs: GridPairs, ends: Int[np.ndarray, "n 2 2"]) -> dict[str, float]:
    """One pair after the other in C, on one core; nothing where there is no compiler."""
    if shutil.which("cc") is None:
        return {}
    header = pairs.c_header("grid")
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "grid.table").write_bytes(header.table)
        table = np.memmap(Path(folder) / "grid.table", np.uint8, "r")
        code = (
            header.text + "int opened(const void *data, size_t size);\n"
            "void many(const uint32_t *a, const uint32_t *b, int32_t *s, size_t n);\n"
            "int opened(const void *data, size_t size) { return grid_open(data, size); }\n"
            "void many(const uint32_t *a, const uint32_t *b, int32_t *s, size_t n)\n"
            "{ grid_steps_of_pairs(a, b, s, n); }\n"
        )
        library = compiled_library(code, Path(folder))
        if not library.opened(ctypes.c_void_p(table.ctypes.data), ctypes.c_size_t(len(table))):
            raise RuntimeError("The table that was just written is refused.")
        columns = pairs.tables.shape[1]
        start, end = np.ascontiguousarray((ends[..., 0] * columns + ends[..., 1]).T.astype(np.uint32))
        steps = np.empty(len(start), np.int32)
        pointers = [ctypes.c_void_p(one.ctypes.data) for one in (start, end, steps)]
        seconds = median_seconds(lambda: library.many(*pointers, ctypes.c_size_t(len(steps))))
        del table
    return {"table_bytes": len(header.table), "c_nanoseconds": 1e9 * seconds / len(steps)}


if __name__ == "__main__":
    run("fleets", "Pairs of cells of the large grids that fleets drive on.", compute)
