"""Cones of a distance function that offers nothing but its values: sources have to be found from samples.

Noise, where there is some, is normal, of 1e-6 units, and the same whenever a point is asked about again. Errors are
against the exact distance, over random free points. Planes stand beside them.
"""

from typing import Any

import numpy as np
from jaxtyping import Float

from experiments._tables import aligned
from experiments.benchmarks._maps import load_map
from plr_jax import DistanceFn, VisibilityGraph, construct

MAPS, BUDGET = ("maze", "thin_maze"), 1_024
POINTS, POINT_SEED = 200_000, 50_000
NOISE = 1e-6
_LEAVES = ("cone", "plane")


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    points, budget, maps = (5_000, 256, MAPS[:1]) if smoke else (POINTS, BUDGET, MAPS)
    rows = []
    for name in maps:
        found = load_map(name)
        assert found is not None, "the package has these maps"
        workspace, goal = found
        oracle = VisibilityGraph(workspace, goal)
        x = workspace.sample_free(points, POINT_SEED + seed)
        distance = oracle(x)
        for noise in (0.0, NOISE):
            for leaf in _LEAVES:
                plr = construct(with_noise(oracle, noise), workspace.bounds, leaf=leaf, max_bytes=budget, seed=seed)
                error = np.abs(np.asarray(plr(x), float) - distance)
                sizes = {"bytes": plr.num_bytes, "leaves": plr.num_leaves}
                errors = {"mean": float(error.mean()), "largest_of_points": float(error.max())}
                rows.append({"map": name, "noise": noise, "leaf": leaf, **sizes, **errors})
    return {"points": points, "rows": rows}


def with_noise(oracle: VisibilityGraph, noise: float) -> DistanceFn:
    """The oracle's values alone, with noise that depends on the point."""

    def distance(x: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n"]:
        bits = np.ascontiguousarray(x).view(np.uint64)
        mixed = (bits[:, 0] * np.uint64(0x9E3779B97F4A7C15)) ^ (bits[:, 1] * np.uint64(0xC2B2AE3D27D4EB4F))
        mixed = (mixed ^ (mixed >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
        halves = np.stack([mixed >> np.uint64(32), mixed & np.uint64(0xFFFFFFFF)]) + 0.5
        u, v = halves.astype(np.float64) / 2.0**32
        return oracle(x) + noise * np.sqrt(-2 * np.log(u)) * np.cos(2 * np.pi * v)

    return distance


def table(results: dict[str, Any]) -> str:
    rows = [["map", "leaf", "noise", "bytes", "leaves", "mean", "largest of points"]]
    for row in results["rows"]:
        cells = [f"{row['bytes']:,}", f"{row['leaves']:,}", f"{row['mean']:.2g}", f"{row['largest_of_points']:.2g}"]
        rows.append([row["map"], row["leaf"], f"{row['noise']:g}", *cells])
    return aligned(rows, numbers=5)
