"""Proven bounds of the distance of any two points, beside the exact oracle: are any wrong, and how wide are they?

Files of all pairs of the bytes that ``compare_summaries`` gives every rival. Each of 5,000 goals has 2,000 points of
its own. A violation is a lower bound above the exact distance, or an upper bound below it, by more than what the
oracle itself rounds. The times are of warm calls of a million pairs, for the distance and for its bounds.
"""

import time
from functools import partial
from typing import Any

import numpy as np

from experiments._runner import run
from experiments.benchmarks._maps import load_maps
from experiments.benchmarks._timing import interleaved
from experiments.compare_summaries import MAX_BYTES
from experiments.summaries._given import draw_pairs
from plr_jax import PairPLR, VisibilityGraph, construct_pairs

_ORACLE = 1e-12  # of the domain's width: what the oracle rounds
_GOALS, _POINTS, _GOALS_AT_ONCE, _TIMED, _RUNS = 5_000, 2_000, 500, 1_000_000, 5
_SEED = 40_000


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    maps = load_maps(["maze"] if smoke else MAX_BYTES)
    goals, points, timed = (20, 50, 1_000) if smoke else (_GOALS, _POINTS, _TIMED)
    rows = []
    for name, (workspace, goal) in maps.items():
        begin = time.perf_counter()
        pairs = construct_pairs(workspace, max_bytes=MAX_BYTES[name])
        row: dict[str, Any] = {"map": name, "bytes": pairs.num_bytes, "build_seconds": time.perf_counter() - begin}
        row["resident_bytes"] = pairs.resident_bytes
        exact = VisibilityGraph(workspace, goal)
        parts = [
            _judged(pairs, exact, min(_GOALS_AT_ONCE, goals - first), points, _SEED + seed + first)
            for first in range(0, goals, _GOALS_AT_ONCE)
        ]
        row |= _together(parts)
        x, y = np.split(workspace.sample_free(2 * timed, _SEED + seed).astype(np.float32), 2)
        calls = {"nanoseconds": partial(pairs, x, y), "nanoseconds_of_bounds": partial(pairs.bounds, x, y)}
        row |= {name: 1e9 * each.median / timed for name, each in interleaved(calls, _RUNS).items()}
        rows.append(row)
    return {"rows": rows}


def _judged(pairs: PairPLR, exact: VisibilityGraph, goals: int, points: int, seed: int) -> dict[str, Any]:
    """Sums over pairs that a path joins."""
    some = draw_pairs(exact, goals, points, seed)
    lower, upper = (np.asarray(bound, float) for bound in pairs.bounds(some.x, some.y))
    slack = _ORACLE * float(pairs.domain.width.max())
    is_told = np.isfinite(upper)
    error = np.abs(np.asarray(pairs(some.x, some.y), float) - some.distance)
    return {
        "pairs": len(lower),
        "violations": int((lower > some.distance + slack).sum() + (upper < some.distance - slack).sum()),
        "error": float(error.sum()),
        "largest": float(error.max()),
        "gap": float((some.distance - lower).sum()),
        "largest_gap": float((some.distance - lower).max()),
        "told": int(is_told.sum()),
        "gap_above": float((upper - some.distance)[is_told].sum()),
        "distance": float(some.distance.sum()),
    }


def _together(parts: list[dict[str, Any]]) -> dict[str, Any]:
    """Means and largest values over all parts."""
    total = {name: sum(part[name] for part in parts) for name in parts[0]}
    largest = {name: max(part[name] for part in parts) for name in ("largest", "largest_gap")}
    count = total["pairs"]
    means = {name: total[name] / count for name in ("error", "gap", "distance")}
    told = {"told": total["told"] / count, "gap_above": total["gap_above"] / max(total["told"], 1)}
    return {"pairs": count, "violations": total["violations"], **means, **largest, **told}


if __name__ == "__main__":
    run("pair_bounds", "Proven bounds of distances of pairs: violations, gaps, seconds.", compute)
