"""Readers of files in C and NumPy, tables at the command line, a heuristic of cars, and what each leaf takes.

A C compiler called ``cc`` and ``size`` are needed.
"""

import ctypes
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from experiments._c_headers import (
    CompiledHeader,
    compiled_header,
    median_seconds,
    object_for_size,
    section_bytes,
    stack_bytes,
)
from experiments._measures import timed
from experiments._runner import Section, run
from plr_jax import PLR, Box, Euclidean, ReedsShepp, VisibilityGraph, construct, save, scenes
from plr_jax.metrics import error_map

# Readers of the format, each leaf model: are answers equal to the bit, how large is the code, how fast is it?
#
# Points are uniform in a box 2 % wider than the domain, in 32-bit floats; far from the origin in 64-bit ones.

NUM_POINTS, CHUNK, NUM_CALLS = 10_000_000, 1_000_000, 20_000
_WIDER = 1.02
_TURNS = Box((-5, -5, -np.pi), (5, 5, np.pi), periodic=(False, False, True))
_ZONE = Box((5e5, 4e6), (5e5 + 2000, 4e6 + 1500))


def readers(seed: int, smoke: bool) -> dict[str, Any]:
    num_points, num_calls = (20_000, 100) if smoke else (NUM_POINTS, NUM_CALLS)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for number, (name, make) in enumerate(plrs(512 if smoke else 2048).items()):
            plr = make()
            row = _measured(plr, Path(folder) / f"{number}", num_points, num_calls, seed)
            rows.append({"plr": name, "leaf": plr.leaf.name, "leaves": plr.num_leaves, "bytes": plr.num_bytes, **row})
            print(rows[-1], flush=True)
    return {"points": num_points, "rows": rows}


def plrs(max_bytes: int) -> dict[str, Callable[[], PLR]]:
    """PLRs of each leaf model, in several dimensions, with and without folding, near the origin and far from it."""
    problem = scenes.maze()
    oracle = VisibilityGraph(problem.workspace, problem.goals[0])
    car, ball = ReedsShepp((0, 0, 0), 1), Euclidean((0.3, 0.2, 0.1, 0, -0.3))
    square = problem.workspace.bounds
    return {
        "maze, planes": lambda: construct(oracle, square, max_bytes=max_bytes),
        "maze, continuous": lambda: construct(oracle, square, leaf="continuous", max_bytes=max_bytes),
        "maze, smooth": lambda: construct(oracle, square, leaf="smooth", max_bytes=max_bytes),
        "maze, cones": lambda: construct(oracle, square, leaf="cone", max_bytes=max_bytes, certified=True),
        "car, planes": lambda: construct(car, _TURNS, max_bytes=max_bytes),
        "car, continuous": lambda: construct(car, _TURNS, leaf="continuous", max_bytes=max_bytes),
        "car turned": lambda: construct(ReedsShepp((1, 0.5, 0.6), 1), _TURNS, leaf="continuous", max_bytes=max_bytes),
        "5-D, planes": lambda: construct(ball, (-np.ones(5), np.ones(5)), max_bytes=max_bytes),
        "5-D, continuous": lambda: construct(ball, (-np.ones(5), np.ones(5)), leaf="continuous", max_bytes=max_bytes),
        "UTM, planes": lambda: construct(Euclidean((5e5 + 700, 4e6 + 300)), _ZONE, max_bytes=max_bytes),
    }


def _measured(plr: PLR, folder: Path, num_points: int, num_calls: int, seed: int) -> dict[str, Any]:
    in_c, f, rng = compiled_header(plr, folder), plr.numpy(), np.random.default_rng(seed)
    center, half = (plr.domain.lo + plr.domain.hi) / 2, _WIDER / 2 * plr.domain.width
    in_c_equal, jax_equal = 0, 0
    for start in range(0, num_points, CHUNK):
        shape = (min(CHUNK, num_points - start), plr.dim)
        x = (center + half * rng.uniform(-1, 1, shape)).astype(in_c.real)
        expected = f(x).view(np.uint32)
        in_c_equal += int(np.count_nonzero(in_c(x).view(np.uint32) == expected))
        jax_equal += int(np.count_nonzero(np.asarray(plr(x)).view(np.uint32) == expected))
    inside = plr.domain.lo + plr.domain.width * rng.random((num_calls, plr.dim))
    points = list(map(tuple, inside.tolist()))
    return {
        **section_bytes(object_for_size(plr, folder)),
        "c_equal": in_c_equal / num_points,
        "jax_equal": jax_equal / num_points,
        "c_nanoseconds": in_c.nanoseconds(x),
        "numpy_microseconds": median_seconds(lambda: [f(point) for point in points]) / num_calls * 1e6,
        "numpy_batch_nanoseconds": median_seconds(lambda: f(x), 3) / len(x) * 1e9,
    }


# Small machines: for files of 4 KB, what headers of fast tables and compact headers take in flash and on the stack.
#
# The decoder of compact headers is counted in each of them. No header has data in memory besides the stack.

SMALL_BYTES, NUM_SMALL = 4_096, 1_000_000


def small(seed: int, smoke: bool) -> dict[str, Any]:
    rows, num_points = [], 10_000 if smoke else NUM_SMALL
    with tempfile.TemporaryDirectory() as folder:
        for name in ("maze",) if smoke else ("maze", "floor_plan"):
            problem = getattr(scenes, name)()
            oracle, domain = VisibilityGraph(problem.workspace, problem.goals[0]), problem.workspace.bounds
            center, half = (domain.lo + domain.hi) / 2, _WIDER / 2 * domain.width
            x = (center + half * np.random.default_rng(seed).uniform(-1, 1, (num_points, 2))).astype(np.float32)
            for leaf in LEAVES:
                plr = construct(oracle, domain, leaf=leaf, max_bytes=512 if smoke else SMALL_BYTES)
                expected = plr.numpy()(x).view(np.uint32)
                for compact in (False, True):
                    place = Path(folder) / f"{name}_{leaf}_{compact}"
                    compiled, header = object_for_size(plr, place, compact), compiled_header(plr, place, compact)
                    row = {"map": name, "leaf": leaf, "leaves": plr.num_leaves, "bytes": plr.num_bytes}
                    row |= {"compact": compact, **section_bytes(compiled), "stack": stack_bytes(compiled)}
                    row |= {"equal": float(np.mean(header(x).view(np.uint32) == expected))}
                    rows.append(row | {"nanoseconds": header.nanoseconds(x)})
                    print(rows[-1], flush=True)
    return {"points": num_points, "rows": rows}


# ``plr-jax query``: seconds and memory of tables of ten times as many rows, each of two numbers of six decimals.

ROWS, MOST_AT_ONCE = (100_000, 1_000_000, 10_000_000), 100_000
_CODE = r"""
import pathlib, re, sys
from plr_jax.cli import load_app
try: load_app()(["query", *sys.argv[1:]])
except SystemExit: pass
kilobytes = re.findall(r"VmHWM:\s+(\d+)", pathlib.Path("/proc/self/status").read_text())
print(*kilobytes, "jax" in sys.modules, file=sys.stderr)
"""


def queries(seed: int, smoke: bool) -> dict[str, Any]:
    problem = scenes.maze()
    oracle, rows = VisibilityGraph(problem.workspace, problem.goals[0]), []
    with tempfile.TemporaryDirectory() as folder:
        plr = Path(folder) / "maze.plr"
        save(construct(oracle, problem.workspace.bounds, leaf="cone", max_bytes=1024), plr)
        for number in (1_000, 10_000) if smoke else ROWS:
            points = Path(folder) / "points.csv"
            x = np.random.default_rng(seed).random((min(number, MOST_AT_ONCE), 2))
            text = "".join(f"{a:.6f},{b:.6f}\n" for a, b in x.tolist())
            with open(points, "w") as file:
                for _ in range(number // len(x)):
                    file.write(text)
            began, before = time.perf_counter(), _of_children()
            with open(Path(folder) / "answers.txt", "wb") as answers:
                command = [sys.executable, "-c", _CODE, str(plr), str(points)]
                done = subprocess.run(command, check=True, stdout=answers, stderr=subprocess.PIPE, text=True)
            seconds, of_processor = time.perf_counter() - began, _of_children() - before
            *kilobytes, has_jax = done.stderr.split()
            megabytes = int(kilobytes[0]) / 1024 if kilobytes else None
            rows.append(
                {
                    "rows": number,
                    "seconds": seconds,
                    "processor": of_processor,
                    "megabytes": megabytes,
                    "jax": has_jax == "True",
                }
            )
            print(rows[-1], flush=True)
    return {"rows": rows}


def _of_children() -> float:
    """Seconds of a processor that all processes took that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


# A heuristic of cars in C: lengths of Reeds and Shepp's shortest paths, in a header or in a 3-D table.
#
# Both cover poses up to 12.5 turning radii from the goal along x and y, at any heading. The table is what planners
# keep: lengths at 401 x 201 places of the half with y of 0 and more, of which the other half is the mirror image, and
# 72 headings. It answers with that of the nearest pose. Errors are in turning radii, over random poses.

REACH, SHAPE = 12.5, (401, 201, 72)
CAR_BYTES, NUM_POSES = (4_096, 16_384), 1_000_000
_LOOKUP = """#include <stdint.h>
extern const float *table;
const float *table;
static inline float table_distance(const float x[3])
{{
    const int mirrored = x[1] < 0.0f;
    const float heading = (mirrored ? -x[2] : x[2]) * {per_radian}f;
    const int turn = (int)(heading + {turns}.5f) % {turns};
    const int column = (int)((x[0] + {reach}f) * {per_radius}f + 0.5f);
    const int row = (int)((mirrored ? -x[1] : x[1]) * {per_radius}f + 0.5f);
    return table[(column * {rows} + row) * {turns} + turn];
}}
"""


def car(seed: int, smoke: bool) -> dict[str, Any]:
    oracle, (columns, rows, turns) = ReedsShepp((0, 0, 0), 1), (41, 21, 8) if smoke else SHAPE
    domain = Box((-REACH, -REACH, -np.pi), (REACH, REACH, np.pi), periodic=(False, False, True))
    x = np.random.default_rng(seed).uniform(domain.lo, domain.hi, (1_000 if smoke else NUM_POSES, 3))
    x = x.astype(np.float32)
    exact, found = oracle(x.astype(np.float64)), []
    with tempfile.TemporaryDirectory() as folder:
        for max_bytes in CAR_BYTES[:1] if smoke else CAR_BYTES:
            seconds, plr = timed(lambda m=max_bytes: construct(oracle, domain, leaf="continuous", max_bytes=m))
            header = compiled_header(plr, Path(folder) / f"{max_bytes}")
            sizes = section_bytes(object_for_size(plr, Path(folder) / f"{max_bytes}"))
            error = _errors(header(x), exact)
            found.append(
                {
                    "what": f"header, {plr.num_leaves:,} leaves",
                    "file": plr.num_bytes,
                    "bytes": sizes["code"] + sizes["data"],
                    "seconds": seconds,
                    "nanoseconds": header.nanoseconds(x),
                    **error,
                }
            )
            print(found[-1], flush=True)
        seconds, lengths = timed(lambda: _table(oracle, columns, rows, turns))
        found.append({"what": f"table {columns} x {rows} x {turns}", "file": lengths.nbytes, "bytes": lengths.nbytes})
        found[-1] |= {"seconds": seconds, **_looked_up(lengths, x, exact, Path(folder) / "table")}
        print(found[-1], flush=True)
    return {"poses": len(x), "rows": found}


def _table(oracle: ReedsShepp, columns: int, rows: int, turns: int) -> np.ndarray:
    """Lengths by column, row and heading."""
    x, y = np.linspace(-REACH, REACH, columns), np.linspace(0, REACH, rows)
    heading = 2 * np.pi / turns * np.arange(turns)
    poses = np.stack(np.meshgrid(x, y, heading, indexing="ij"), axis=-1)
    return np.stack([oracle(part.reshape(-1, 3)) for part in poses]).astype(np.float32).ravel()


def _looked_up(lengths: np.ndarray, x: np.ndarray, exact: np.ndarray, folder: Path) -> dict[str, float]:
    rows, turns = SHAPE[1:] if len(lengths) == np.prod(SHAPE) else (21, 8)
    numbers = {"per_radian": repr(turns / (2 * np.pi)), "per_radius": repr((rows - 1) / REACH)}
    code = _LOOKUP.format(turns=turns, rows=rows, reach=REACH, **numbers)
    function = CompiledHeader(code, "table", np.float32, 3, folder)
    ctypes.c_void_p.in_dll(function.library, "table").value = lengths.ctypes.data
    return {"nanoseconds": function.nanoseconds(x), **_errors(function(x), exact)}


def _errors(answer: np.ndarray, exact: np.ndarray) -> dict[str, float]:
    error = np.abs(answer - exact)
    return {"mean": float(error.mean()), "largest": float(error.max())}


# Which leaf: bytes of the file, of the tables that ``plr(x)`` reads and of the compiled C header, errors and proofs.

LEAVES, LEAF_BYTES, NUM_FREE = ("cone", "continuous", "smooth", "plane"), 2_048, 200_000


def leaves(seed: int, smoke: bool) -> dict[str, Any]:
    num_points, rows = 2_000 if smoke else NUM_FREE, []
    with tempfile.TemporaryDirectory() as folder:
        for name in ("maze",) if smoke else ("maze", "floor_plan"):
            problem = getattr(scenes, name)()
            oracle = VisibilityGraph(problem.workspace, problem.goals[0])
            x = problem.workspace.sample_free(num_points, seed)
            for leaf in LEAVES:
                rows.append({"map": name, **leaf_row(oracle, leaf, x, seed, Path(folder) / name)})
                print(rows[-1], flush=True)
    return {"points": num_points, "budget": LEAF_BYTES, "rows": rows}


def leaf_row(oracle: VisibilityGraph, leaf: str, x: np.ndarray, seed: int, folder: Path) -> dict[str, Any]:
    plr = construct(oracle, oracle.workspace.bounds, leaf=leaf, max_bytes=LEAF_BYTES, certified=True, seed=seed)
    sizes, error = section_bytes(object_for_size(plr, folder)), error_map(plr, oracle, x)
    row = {"leaf": leaf, "leaves": plr.num_leaves, "bytes": plr.num_bytes}
    row |= {"resident_bytes": plr.resident_bytes, "c_bytes": sizes["code"] + sizes["data"]}
    row |= {"mean": error.mean, "largest": error.max, "proven": plr.max_error}
    return row | {"largest_distance": error.max_distance}


SECTIONS = {
    "readers": Section(readers),
    "small": Section(small),
    "query": Section(queries),
    "car": Section(car),
    "leaves": Section(leaves),
}

if __name__ == "__main__":
    run("portable", __doc__, SECTIONS)
