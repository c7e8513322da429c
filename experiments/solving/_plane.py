"""PLRs of the plane without an oracle, beside roadmaps and grids; the truth is the exact oracle's.

``solve_eikonal`` is asked for 10,000 cells, then for 6,144 bytes, of 10,000 cells and of 1,500. Each call has a space
object of its own, and is not the first of its process; seconds of first calls are told apart. Errors and gaps are
shares of the mean distance, over random free points that reach the goal: of the PLR, of the lower bound to the truth,
and of the lower bound to the upper one where there is one. Bounds are tested at ten million points.

- PRM*: roadmaps of exact tests of motions, whose own answers are judged, without a PLR; cells are its samples.
- scikit-fmm: fast marching of second order, from centers of cells to centers of cells of a square grid, which are
  tested for being free; its field is interpolated. Bytes are one float32 a cell.
- Dijkstra: the same grid, 48 directions, exact tests of the motions along them.

Bytes of roadmaps are what answers for one goal: a vertex is its coordinates and its cost in float32. The map's own
preprocessing, which a workspace keeps, is in nobody's seconds.

Of eikonalfm, hj-reachability and adaptive, which others use for such fields, nothing is measured here: they are not
among the rivals that ``.[baselines]`` installs.
"""

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from experiments._measures import relative_errors
from experiments.benchmarks._maps import Map, load_map
from experiments.solving._rivals import (
    all_neighbors,
    counted,
    even_sizes,
    grid_search,
    marched,
    prm_star,
)
from plr_jax import PLR, PlaneSpace, VisibilityGraph, solve_eikonal

MAPS = ("maze", "thin_maze", "arena", "den312d")
_DEFAULT_CELLS = 10_000
LIMITS = ({"max_leaves": 10_000}, {"max_bytes": 6_144}, {"max_leaves": 1_500, "max_bytes": 6_144})
SAMPLES = (1_000, 3_000, 10_000, 30_000)
CELLS = {"scikit-fmm": (10_000, 100_000, 1_000_000), "Dijkstra, 48 directions": (10_000, 100_000)}
_DIJKSTRA_REACH = 4  # cells, of steps in 48 directions
POINTS, POINTS_TESTED, _BATCH = 200_000, 10_000_000, 500_000
_POINT_SEED = 60_000
_BYTES_A_FLOAT = 4
_ROUNDING = 1e-15  # of the largest distance: the exact oracle's own
_ROOT = Path(__file__).parents[2]

Points = Float[np.ndarray, "n 2"]


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    limits = ({"max_leaves": 300}, {"max_leaves": 300, "max_bytes": 512}) if smoke else LIMITS
    rows = []
    for name in MAPS[:1] if smoke else MAPS:
        if (found := load_map(name)) is None:
            continue
        exact = VisibilityGraph(*found)
        x = found[0].sample_free(5_000 if smoke else POINTS, _POINT_SEED + seed)
        distance = exact(x)
        x, distance = x[np.isfinite(distance)], distance[np.isfinite(distance)]
        solved = [_solved(found, limit, x, distance, seed) for limit in limits]
        counts = violations([plr for _, plr in solved], found, exact, 20_000 if smoke else POINTS_TESTED, seed)
        ours = [row | count for (row, _), count in zip(solved, counts, strict=True)]
        rows += [{"map": name, **row} for row in [*ours, *rivals(found, x, distance, seed, smoke)]]
    return {"first_call": first_call(limits[0]), "points": len(x), "rows": rows}


def first_call(limit: dict[str, int]) -> dict[str, float]:
    """Seconds of the first call in a new process, and of a second one, of the maze."""
    command = [sys.executable, "-m", __name__, json.dumps(limit)]
    return json.loads(subprocess.run(command, cwd=_ROOT, capture_output=True, text=True, check=True).stdout)


def _solved(
    found: Map, limit: dict[str, Any], x: Points, distance: Float[np.ndarray, " n"], seed: int
) -> tuple[dict[str, Any], PLR]:
    workspace, goal = found
    solve_eikonal(PlaneSpace(workspace), goal, max_leaves=100)  # imports and compiles
    space = counted(PlaneSpace(workspace))
    began = time.perf_counter()
    plr = solve_eikonal(space, goal, **limit, seed=seed)
    seconds, cells = time.perf_counter() - began, limit.get("max_leaves", _DEFAULT_CELLS)
    row = {"method": "solve_eikonal", "seconds": seconds, "cells": cells, "leaves": plr.num_leaves}
    lower, upper = (np.asarray(bound, float) for bound in plr.bounds(x))
    bounded = np.isfinite(upper)
    gaps = {
        "below": float((distance - lower).mean() / distance.mean()),
        "gap": float((upper - lower)[bounded].mean() / distance[bounded].mean()) if bounded.any() else None,
        "without_upper": float(1 - bounded.mean()),
    }
    return row | relative_errors(np.asarray(plr(x), float), distance) | gaps | {
        "bytes": plr.num_bytes,
        "tests": space.tests.for_json(),
    }, plr


def violations(
    plrs: list[PLR], found: Map, exact: VisibilityGraph, num_points: int, seed: int
) -> list[dict[str, int]]:
    """At how many random free points the truth is beyond a bound, of each PLR."""
    counts = [{"points_tested": 0, "lower_violated": 0, "upper_violated": 0} for _ in plrs]
    for begin in range(0, num_points, _BATCH):
        x = found[0].sample_free(min(_BATCH, num_points - begin), _POINT_SEED + seed + 1 + begin // _BATCH)
        distance = exact(x)
        x, distance = x[np.isfinite(distance)], distance[np.isfinite(distance)]
        rounding = _ROUNDING * distance.max()
        for plr, count in zip(plrs, counts, strict=True):
            lower, upper = (np.asarray(bound, float) for bound in plr.bounds(x))
            count["points_tested"] += len(x)
            count["lower_violated"] += int(np.count_nonzero(~(lower <= distance + rounding)))
            count["upper_violated"] += int(np.count_nonzero(~(distance <= upper + rounding)))
    return counts


def rivals(found: Map, x: Points, distance: Float[np.ndarray, " n"], seed: int, smoke: bool) -> list[dict[str, Any]]:
    """Roadmaps and grids of several sizes."""
    workspace, goal = found
    rows = []
    for num_samples in SAMPLES[:1] if smoke else SAMPLES:
        sampled = prm_star(PlaneSpace(workspace), goal, num_samples, seed)
        size = {"cells": num_samples, "bytes": sampled.num_bytes, "seconds": sampled.seconds}
        rows.append(
            {"method": "PRM*", **size, "tests": sampled.tests, **relative_errors(sampled.roadmap(x), distance)}
        )
    for method, sizes in CELLS.items():
        for num_cells in sizes[:1] if smoke else sizes:
            space = counted(PlaneSpace(workspace))
            began = time.perf_counter()
            sides = even_sizes(space.domain, np.ones(2), num_cells)
            if method == "scikit-fmm":
                field = marched(space, goal, sides)
            else:
                field = grid_search(space, goal, sides, all_neighbors(2, _DIJKSTRA_REACH))
            size = {"cells": field.values.size, "bytes": _BYTES_A_FLOAT * field.values.size}
            row = {"method": method, **size, "seconds": time.perf_counter() - began}
            rows.append(row | {"tests": space.tests.for_json()} | relative_errors(field(x), distance))
    return rows


def main(limit: str) -> None:
    """What a new process is for: two calls, and their seconds."""
    found = load_map("maze")
    assert found is not None
    seconds = []
    for _ in range(2):
        began = time.perf_counter()
        solve_eikonal(PlaneSpace(found[0]), found[1], **json.loads(limit))
        seconds.append(time.perf_counter() - began)
    print(json.dumps({"first": seconds[0], "second": seconds[1]}))


if __name__ == "__main__":
    main(sys.argv[1])
