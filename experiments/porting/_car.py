"""A heuristic of cars in C: lengths of Reeds and Shepp's shortest paths, in a header or in a 3-D table.

Both cover poses up to 12.5 turning radii from the goal along x and y, at any heading. The table is what planners
keep: lengths at 401 x 201 places of the half with y of 0 and more, of which the other half is the mirror image, and
72 headings. It answers with that of the nearest pose. Errors are in turning radii, over random poses.
"""

import ctypes
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from experiments._tables import aligned
from experiments.porting._headers import CompiledHeader, compiled_header, object_for_size, section_bytes
from plr_jax import Box, ReedsShepp, construct

REACH, SHAPE = 12.5, (401, 201, 72)
BYTES, NUM_POSES = (4_096, 16_384), 1_000_000
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


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    oracle, (columns, rows, turns) = ReedsShepp((0, 0, 0), 1), (41, 21, 8) if smoke else SHAPE
    domain = Box((-REACH, -REACH, -np.pi), (REACH, REACH, np.pi), periodic=(False, False, True))
    x = np.random.default_rng(seed).uniform(domain.lo, domain.hi, (1_000 if smoke else NUM_POSES, 3))
    x = x.astype(np.float32)
    exact, found = oracle(x.astype(np.float64)), []
    with tempfile.TemporaryDirectory() as folder:
        for max_bytes in BYTES[:1] if smoke else BYTES:
            seconds, plr = _timed(lambda m=max_bytes: construct(oracle, domain, leaf="continuous", max_bytes=m))
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
        seconds, lengths = _timed(lambda: _table(oracle, columns, rows, turns))
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
    turns = 72 if len(lengths) == np.prod(SHAPE) else 8
    rows = 201 if turns == 72 else 21
    numbers = {"per_radian": repr(turns / (2 * np.pi)), "per_radius": repr((rows - 1) / REACH)}
    code = _LOOKUP.format(turns=turns, rows=rows, reach=REACH, **numbers)
    function = CompiledHeader(code, "table", np.float32, 3, folder)
    ctypes.c_void_p.in_dll(function.library, "table").value = lengths.ctypes.data
    return {"nanoseconds": function.nanoseconds(x), **_errors(function(x), exact)}


def _errors(answer: np.ndarray, exact: np.ndarray) -> dict[str, float]:
    error = np.abs(answer - exact)
    return {"mean": float(error.mean()), "largest": float(error.max())}


def _timed(call) -> tuple[float, Any]:
    began = time.process_time()
    result = call()
    return time.process_time() - began, result


def table(results: dict[str, Any]) -> str:
    rows = [["in C", "file B", "program B", "mean error", "largest", "ns a query", "s to build"]]
    for row in results["rows"]:
        sizes = [f"{row['file']:,}", f"{row['bytes']:,}"]
        errors = [f"{row['mean']:.2g}", f"{row['largest']:.2g}"]
        rows.append([row["what"], *sizes, *errors, f"{row['nanoseconds']:.0f}", f"{row['seconds']:.1f}"])
    return f"{results['poses']:,} random poses\n" + aligned(rows, 6)
