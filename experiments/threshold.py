"""The paper's threshold rule beside best-first growth.

The paper splits cells, with axes in turn, while the error at a center exceeds a threshold. The same rule under
a byte budget splits cells of larger errors first, and rounds coefficients as the budget requires. Two more rules
split along the best axis, by the error at the center and by the largest error (the default).
"""

from typing import Any

import numpy as np
from jaxtyping import Float

from experiments._measures import timed
from experiments._runner import run
from experiments.benchmarks._maps import load_map
from experiments.table1 import POINT_SEED
from plr_jax import BuildOptions, VisibilityGraph, construct, metrics
from plr_jax.plr import center_error, cyclic_axis

MAPS = "maze", "thin_maze", "floor_plan"
THRESHOLDS = 0.01, 0.001  # in units of the mean distance
NUM_POINTS = 500_000
CENTER_CYCLIC = BuildOptions(should_split=center_error, split=cyclic_axis)
THRESHOLD_RULE = "error at the center above the threshold, axes in turn"
BEST_FIRST = {
    "error at the center, axes in turn": CENTER_CYCLIC,
    "error at the center, best axis": BuildOptions(should_split=center_error),
    "largest error, best axis": BuildOptions(),
}


def measure(name: str, threshold: float, seed: int, num_points: int) -> list[dict[str, Any]]:
    """Return the rows of one map: the threshold rule, then best-first growth to the bytes of the first row's file."""
    workspace, goal = load_map(name)  # type: ignore[reportGeneralTypeIssues]
    exact = VisibilityGraph(workspace, goal)
    x = workspace.sample_free(num_points, POINT_SEED)
    truth = exact(x)
    rows: list[dict[str, Any]] = []

    def add(rule: str, **limits: Any) -> None:
        num_queries = 0

        def counted(q: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
            nonlocal num_queries
            num_queries += len(q)
            return exact(q)

        seconds, plr = timed(lambda: construct(counted, workspace.bounds, seed=seed, **limits))
        report = metrics.error_map(plr, lambda _: truth, x)
        row = {"map": name, "threshold": threshold, "rule": rule, "bytes": plr.num_bytes, "leaves": plr.num_leaves}
        rows.append(row | {"max": report.max, "mean": report.mean, "calls": num_queries, "seconds": seconds})

    add(THRESHOLD_RULE, tolerance=threshold * float(truth.mean()), options=CENTER_CYCLIC)
    for rule, options in BEST_FIRST.items():
        add(rule, max_bytes=rows[0]["bytes"], options=options)
    return rows


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    maps, thresholds, num_points = (MAPS[:1], THRESHOLDS[:1], 1_000) if smoke else (MAPS, THRESHOLDS, NUM_POINTS)
    rows = [row for name in maps for threshold in thresholds for row in measure(name, threshold, seed, num_points)]
    return {"points": num_points, "rows": rows}


if __name__ == "__main__":
    run("threshold", __doc__, compute)
