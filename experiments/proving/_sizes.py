"""Cones, planes and continuous leaves at equal bytes: their errors, the largest found and the largest proven.

Mean errors are over random free points. The largest error is looked for as :mod:`experiments.proving._worst_points`
says, and so is closer to the truth than the largest over random points. Seconds are medians of three runs, fewer
where they take long, each with a workspace of its own and after a first that is not timed: of the oracle alone, and
of the whole chain from rings of free space to the certified PLR.
"""

import time
from typing import Any

import numpy as np

from experiments._tables import aligned
from experiments.benchmarks._maps import Map, load_map
from experiments.benchmarks._oracle import prepared
from experiments.proving._worst_points import largest_found
from plr_jax import PLR, VisibilityGraph, construct

LEAVES = ("cone", "plane", "continuous")
SIZES = {
    "maze": (256, 512, 1_024),
    "thin_maze": (256, 512, 1_024),
    "floor_plan": (1_024, 4_096),
    "arena": (2_048, 8_192),
    "den312d": (2_048, 6_144),
    "den520d": (16_384,),
}
POINTS, POINT_SEED = 500_000, 40_000
_EXACT = 1e-6  # of the largest distance
_RUNS, _SECONDS_IN_ALL = 3, 20.0


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    sizes = {"maze": (256,)} if smoke else SIZES
    points = 5_000 if smoke else POINTS
    rows = []
    for name, budgets in sizes.items():
        if (found := load_map(name)) is None:
            continue
        workspace, goal = found
        oracle = VisibilityGraph(workspace, goal)
        x = workspace.sample_free(points, POINT_SEED + seed)
        distance = oracle(x)
        reached = np.isfinite(distance)
        for budget in budgets:
            for leaf in LEAVES:
                plr, timing = timed_builds(found, leaf, budget, seed, smoke)
                errors = error_row(plr, oracle, x[reached], distance[reached], smoke)
                rows.append({"map": name, "budget": budget, "leaf": leaf, **errors, **timing})
                print(line(rows[-1]), flush=True)
    return {"points": points, "exact": _EXACT, "rows": rows}


def timed_builds(found: Map, leaf: str, budget: int, seed: int, smoke: bool) -> tuple[PLR, dict[str, Any]]:
    """A certified PLR, and median seconds of its parts."""
    workspace, goal = found

    def build() -> tuple[PLR, float, float]:
        to_workspace, to_oracle, oracle = prepared(workspace, goal)
        start = time.perf_counter()
        plr = construct(oracle, workspace.bounds, leaf=leaf, max_bytes=budget, certified=True, seed=seed)
        return plr, to_workspace + to_oracle, time.perf_counter() - start

    plr, *_ = build()  # compiles
    runs, begun = [], time.perf_counter()
    while not runs or (not smoke and len(runs) < _RUNS and time.perf_counter() - begun < _SECONDS_IN_ALL):
        runs.append(build()[1:])
    of_oracle, of_plr = np.array(runs).T
    timing = {"runs": len(runs), "seconds_oracle": of_oracle, "seconds": of_oracle + of_plr}
    return plr, {name: float(np.median(value)) if name != "runs" else value for name, value in timing.items()}


def error_row(plr: PLR, oracle: VisibilityGraph, x: np.ndarray, distance: np.ndarray, smoke: bool) -> dict[str, Any]:
    """Errors of a certified PLR at points that reach the goal, and the largest that can be found and proven."""
    errors = np.abs(np.asarray(plr(x), float) - distance)
    assert plr.max_error is not None
    found = largest_found(plr, oracle, x, errors, smoke)
    return {
        "bytes": plr.num_bytes,
        "leaves": plr.num_leaves,
        "mean": float(errors.mean()),
        "largest_of_points": float(errors.max()),
        "largest_found": found,
        "proven": plr.max_error,
        "proven_to_found": plr.max_error / found,
        "largest_distance": float(distance.max()),
        "share_exact": float((errors <= _EXACT * distance.max()).mean()),
    }


def line(row: dict[str, Any]) -> str:
    return (
        f"{row['map']:11}{row['budget']:>7,} {row['leaf']:11}{row['bytes']:>7,} bytes {row['leaves']:>6,} leaves  "
        f"mean {row['mean']:.2e}  found {row['largest_found']:.3e}  proven {row['proven']:.3e} "
        f"({row['proven_to_found']:.3f} x)  exact {row['share_exact']:.2%}  {row['seconds']:.2f} s"
    )


def table(results: dict[str, Any]) -> str:
    head = ["map", "budget", "leaf", "bytes", "leaves", "mean", "largest found", "largest proven", "ratio"]
    rows = [[*head, "mean %", "proven %", "exact", "s", "s of oracle"]]
    for row in results["rows"]:
        percent = [f"{100 * row[name] / row['largest_distance']:.2g}" for name in ("mean", "proven")]
        rows.append(
            [
                *(row["map"], f"{row['budget']:,}", row["leaf"], f"{row['bytes']:,}", f"{row['leaves']:,}"),
                *(f"{row[name]:.3g}" for name in ("mean", "largest_found", "proven", "proven_to_found")),
                *(*percent, f"{row['share_exact']:.2%}", f"{row['seconds']:.2f}", f"{row['seconds_oracle']:.3f}"),
            ]
        )
    return aligned(rows, numbers=len(rows[0]) - 3) + "%: of the largest distance.\n"
