"""What the sections on teams share: a plan that is timed and checked, and how a row of it is printed."""

import time
from typing import Any

import numpy as np

from plr_jax import BLOptions, HeuristicFn, Problem, Solution, bl_plan, robot_distance_fns, validate


def alone(problem: Problem, inflated: bool = True) -> float:
    """What the robots' shortest paths cost if each is alone."""
    fns = robot_distance_fns(problem, inflated=inflated)
    starts = problem.starts[:, None, :2]
    return float(sum(fn(start)[0] for fn, start in zip(fns, starts, strict=True)))


def timed(
    problem: Problem, options: BLOptions | None = None, heuristic: HeuristicFn | None = None
) -> tuple[Solution, float]:
    """A plan, and its seconds from call to return."""
    began = time.perf_counter()
    solution = bl_plan(problem, heuristic, options or BLOptions())
    return solution, time.perf_counter() - began


def planned(problem: Problem, bound: float, options: BLOptions | None = None) -> dict[str, Any]:
    """A plan, timed from call to return and checked."""
    solution, seconds = timed(problem, options)
    history = solution.stats.history
    return {
        "seconds": round(seconds, 4),
        "robots": len(problem.robots),
        "first": round(history[0][0], 4) if history else None,
        "first_ratio": round(history[0][1] / bound, 5) if history else None,
        "ratio": round(solution.cost / bound, 5) if history else None,
        "valid": validate(problem, solution.path).valid if solution.path is not None else None,
        "status": solution.status.name,
        "found_by": solution.stats.found_by,
        "phases": {name: round(seconds, 4) for name, seconds in solution.stats.seconds.items()},
    }


def middle(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Medians of some plans."""
    keys = ("seconds", "first", "first_ratio", "ratio")
    medians = {key: round(float(np.median([run[key] for run in runs])), 5) for key in keys}
    return {**medians, "valid": all(run["valid"] for run in runs), "robots": runs[0]["robots"], "status": ""}


def cells(row: dict[str, Any]) -> list[str]:
    """A row of a table: see :data:`HEAD`."""
    if row["first"] is None:
        return [row["scene"], row["status"], str(row["robots"]), "-", "-", f"{row['seconds']:.3f}", "-"]
    valid = {True: "valid", False: "INVALID"}[row["valid"]]
    numbers = f"{row['first']:.3f}", f"{row['first_ratio']:.3f}", f"{row['seconds']:.3f}", f"{row['ratio']:.4f}"
    return [row["scene"], valid, str(row["robots"]), *numbers]


HEAD = ["scene", "path", "robots", "s to the first", "its ratio", "s in all", "ratio"]
