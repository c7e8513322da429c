"""Angles between the gradient of a certified PLR and the exact direction."""

from typing import Any

from experiments._tables import aligned
from experiments.proving._sizes import LEAVES, POINT_SEED
from plr_jax import VisibilityGraph, construct, metrics, scenes

BYTES, POINTS = 1_024, 100_000


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    problem, points = scenes.maze(), 2_000 if smoke else POINTS
    workspace, goal = problem.workspace, problem.goals[0]
    oracle = VisibilityGraph(workspace, goal)
    x = workspace.sample_free(points, POINT_SEED + seed)
    rows = []
    for leaf in LEAVES:
        plr = construct(oracle, workspace.bounds, leaf=leaf, max_bytes=BYTES, certified=True, seed=seed)
        report = metrics.gradient_report(plr, oracle.directions, workspace, goal, x)
        angles = {str(quantile): angle for quantile, angle in report.angles.items()}
        row = {"leaf": leaf, "bytes": plr.num_bytes, "angles": angles, "max_angle": report.max_angle}
        rows.append({**row, "num_zero": report.num_zero, "num_not_finite": report.num_not_finite})
    return {"map": "maze", "points": points, "rows": rows}


def table(results: dict[str, Any]) -> str:
    rows = [["leaf", "bytes", "median angle", "90 %", "99 %", "largest", "zero", "not finite"]]
    for row in results["rows"]:
        angles = [f"{angle:.3g}" for angle in (*row["angles"].values(), row["max_angle"])]
        rows.append([row["leaf"], f"{row['bytes']:,}", *angles, str(row["num_zero"]), str(row["num_not_finite"])])
    return aligned(rows, numbers=7) + f"The {results['map']}, degrees, {results['points']:,} free points.\n"
