"""Every prefix of files of pairs: does it load, is it exact, and do its bounds hold?

Behind the outline alone the joined corners are found out by the reader, from corners that a lattice has rounded; of
one map the lattice hides a detail. Goals have 1,000 points each. Beyond bounds is a distance that is so by more than
what the exact oracle rounds.
"""

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import shapely

import plr_jax
from experiments.benchmarks._oracle import polygon_field
from experiments.summaries._truth import Pairs, draw_pairs
from plr_jax import PairPLR, VisibilityGraph, Workspace, scenes

MAX_BYTES = 16_384
NUM_GOALS, SMOKE_GOALS, POINTS = 100, 2, 1_000
_CORNERS = 400
_ORACLE = 1e-12  # of the domain's width: what the oracle rounds


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    rows = []
    for name, workspace in _maps(seed, smoke):
        pairs = plr_jax.construct_pairs(workspace, max_bytes=MAX_BYTES)
        exact = VisibilityGraph(workspace, workspace.sample_free(1, seed)[0])
        some = draw_pairs(exact, SMOKE_GOALS if smoke else NUM_GOALS, POINTS, seed)
        data = pairs.to_bytes()
        prefixes = [_judged(_read(data[:mark]), some) for mark in (*pairs.file_marks, len(data))]
        rows.append({"file": name, "corners": pairs.num_corners, "pairs": len(some.distance), "prefixes": prefixes})
        print(_line(rows[-1]), flush=True)
    return {"rows": rows}


def _maps(seed: int, smoke: bool) -> Iterator[tuple[str, Workspace]]:
    yield "maze", scenes.maze().workspace
    arc = np.linspace(0, np.pi, 9)
    top = np.stack([3 + 4 * arc / np.pi, 5 + 1e-7 * np.sin(arc)], axis=1)
    yield "arc of 1e-8 widths", Workspace(((0, 0), (10, 10)), [[*top.tolist(), (7, 2), (3, 2)]])
    if not smoke:
        floor, far = scenes.floor_plan().workspace, np.array([5e5, 4e6])
        yield "floor_plan", floor
        rings = [far + shapely.get_coordinates(obstacle) for obstacle in floor.obstacles]
        yield "floor_plan, UTM", Workspace((far + floor.bounds.lo, far + floor.bounds.hi), rings)
        yield f"{_CORNERS} corners", polygon_field(_CORNERS, seed)[0]


def _read(data: bytes) -> PairPLR:
    with TemporaryDirectory() as folder:
        path = Path(folder, "prefix")
        path.write_bytes(data)
        return plr_jax.load_pairs(path)


def _judged(pairs: PairPLR, some: Pairs) -> dict[str, Any]:
    lower, upper = (np.asarray(bound, np.float64) for bound in pairs.bounds(some.x, some.y))
    slack = _ORACLE * float(pairs.domain.width.max())
    is_told = np.isfinite(upper)
    return {
        "bytes": pairs.num_bytes,
        "beyond": int((lower > some.distance + slack).sum() + (upper < some.distance - slack).sum()),
        "largest_error": float(np.abs(np.asarray(pairs(some.x, some.y), np.float64) - some.distance).max()),
        "mean_distance": float(some.distance.mean()),
        "told": float(is_told.mean()),
        "gap": float((upper - lower)[is_told].mean()),
    }


def table(results: dict[str, Any]) -> str:
    rows = results["rows"]
    prefixes = [prefix for row in rows for prefix in row["prefixes"]]
    beyond = sum(prefix["beyond"] for prefix in prefixes)
    last = f"{len(rows)} files, {len(prefixes)} prefixes; beyond bounds {beyond} of {rows[0]['pairs']:,} pairs each"
    first = "bytes: pairs beyond bounds; largest error and mean gap between bounds, over the mean distance\n"
    return first + "".join(_line(row) + "\n" for row in rows) + last + "\n"


def _line(row: dict[str, Any]) -> str:
    cells = []
    for prefix in row["prefixes"]:
        error, gap = (prefix[name] / prefix["mean_distance"] for name in ("largest_error", "gap"))
        cells.append(f"{prefix['bytes']:,} B: {prefix['beyond']}; {error:.0e}, {gap:.0e}")
    return f"{row['file']:20}" + "   ".join(cells)
