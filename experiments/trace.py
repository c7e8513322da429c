"""Ways home read from PLRs of cones alone: how many arrive and meet no wall, and how much longer those are.

On each map, at each size: paths from random free starts, each leg tested by Shapely, how deep it is inside walls.
"""

from typing import Any

import numpy as np
import shapely
from jaxtyping import Float

from experiments._runner import run
from experiments.benchmarks._maps import load_maps
from plr_jax import TraceStatus, VisibilityGraph, construct, trace

START_SEED = 0
SIZES = {"maze": [512, 1_024], "thin_maze": [512, 1_024], "arena": [2_048, 4_096], "den312d": [4_096]}
"""Bytes of the PLRs of each map."""
DEPTH = 1e-5
"""How deep inside walls a path may be, in widths of the map, and still count as clear."""


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    num_starts, sizes = (200, {"maze": [1_024]}) if smoke else (10_000, SIZES)
    rows = []
    for name, (workspace, goal) in load_maps(sizes).items():
        exact = VisibilityGraph(workspace, goal)
        starts = workspace.sample_free(num_starts, START_SEED + seed)
        for max_bytes in sizes[name]:
            rows.append({"map": name, "budget": max_bytes, **_measure(exact, starts, max_bytes)})
    return {"starts": num_starts, "depth": DEPTH, "rows": rows}


def _measure(exact: VisibilityGraph, starts: Float[np.ndarray, "n 2"], max_bytes: int) -> dict[str, Any]:
    plr = construct(exact, exact.workspace.bounds, leaf="cone", max_bytes=max_bytes)
    traces, distance = trace(plr, starts), exact(starts)
    error = np.abs(np.asarray(plr(starts)) - distance)
    # A path is clear if it is nowhere deeper inside walls than ``DEPTH``.
    grown = exact.workspace.free_space.buffer(DEPTH * exact.workspace.bounds.width.max(), join_style="round")
    shapely.prepare(grown)
    paths: Any = shapely.linestrings(traces.paths)
    is_clear = shapely.covers(grown, paths)
    ratio = (traces.lengths / distance)[traces.arrived & is_clear & np.isfinite(distance) & (distance > 0)]
    return {
        "bytes": plr.num_bytes,
        "leaves": plr.num_leaves,
        "starts": len(starts),
        "arrived": float(traces.arrived.mean()),
        "clear": float((traces.arrived & is_clear).mean()),
        "clear_by_status": float((trace(plr, starts, exact.workspace).status != TraceStatus.CROSSES_WALL).mean()),
        "ratio": {"mean": float(ratio.mean()), "max": float(ratio.max())},
        "error": {"mean": float(error.mean()), "max": float(error.max())},
    }


if __name__ == "__main__":
    run("trace", "Ways home read from PLRs of cones alone.", compute)
