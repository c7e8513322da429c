"""How wide proven bounds of leaves are beside mean errors, and largest proven errors beside the largest found."""

from typing import Any

import numpy as np

from experiments._tables import aligned
from experiments.benchmarks._maps import load_maps
from experiments.proving._sizes import LEAVES, POINT_SEED
from experiments.proving._worst_points import largest_found
from plr_jax import VisibilityGraph, construct

BYTES, POINTS = 6_144, 500_000
_MAPS = ("maze", "arena")


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    budget, points = (512, 5_000) if smoke else (BYTES, POINTS)
    rows = []
    for name, (workspace, goal) in load_maps(_MAPS[:1] if smoke else _MAPS).items():
        oracle = VisibilityGraph(workspace, goal)
        x = workspace.sample_free(points, POINT_SEED + seed)
        distance = oracle(x)
        x, distance = x[np.isfinite(distance)], distance[np.isfinite(distance)]
        for leaf in LEAVES:
            options = {"leaf": leaf, "max_bytes": budget, "certified": True, "leaf_bounds": True, "seed": seed}
            plr = construct(oracle, workspace.bounds, **options)
            lower, upper = (np.asarray(bound, float) for bound in plr.bounds(x))
            errors = np.abs(np.asarray(plr(x), float) - distance)
            found, band = largest_found(plr, oracle, x, errors, smoke), float((upper - lower).mean())
            assert plr.max_error is not None
            row = {"map": name, "leaf": leaf, "bytes": plr.num_bytes, "mean": float(errors.mean()), "band": band}
            row |= {"band_to_mean": band / row["mean"], "largest_found": found, "proven": plr.max_error}
            row |= {"proven_to_found": plr.max_error / found}
            row |= {"violations": int((~((lower <= distance) & (distance <= upper))).sum())}
            rows.append(row)
    return {"points": points, "rows": rows}


def table(results: dict[str, Any]) -> str:
    names = ("mean", "band", "band_to_mean", "largest_found", "proven", "proven_to_found", "violations")
    head = [
        "map",
        "leaf",
        "bytes",
        "mean error",
        "mean of upper - lower",
        "ratio",
        "largest found",
        "proven",
        "ratio",
    ]
    rows = [[*head, "violations"]]
    for row in results["rows"]:
        rows.append([row["map"], row["leaf"], f"{row['bytes']:,}", *(f"{row[name]:.3g}" for name in names)])
    return aligned(rows, numbers=8)
