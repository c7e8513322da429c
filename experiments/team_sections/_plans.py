"""What the sections on teams share: two teams of a kind, a plan that is timed and checked, medians, and a table."""

from typing import Any

import numpy as np

from experiments._planning import is_valid, plan
from experiments._tables import aligned, or_dash
from plr_jax import BLOptions, Problem, scenes

HEAD = ["scene", "path", "robots", "no path", "s to the first", "its ratio", "s in all", "ratio"]


def two_teams(scene: str, size: int, seed: int) -> tuple[Problem, Problem]:
    """A team to plan before another, and that other one: of one scene and size, in the same workspace."""
    if scene == "crowd":
        other, problem = (scenes.crowd(size, each) for each in (1000 + seed, seed))
        return Problem(problem.workspace, problem.robots, other.starts, other.goals), problem
    problem = getattr(scenes, scene)(size)
    return scenes.perturbed(problem, 1000 + seed), problem


def planned(problem: Problem, bound: float, options: BLOptions | None = None) -> dict[str, Any]:
    """A plan, timed from call to return and checked; costs are over a bound."""
    solution, seconds = plan(problem, None, options or BLOptions())
    history = solution.stats.history
    return {
        "robots": len(problem.robots),
        "runs": 1,
        "failures": int(not solution.solved),
        "seconds": round(seconds, 4),
        "first": round(history[0][0], 4) if history else None,
        "first_ratio": round(history[0][1] / bound, 5) if history else None,
        "ratio": round(solution.cost / bound, 5) if history else None,
        "valid": is_valid(problem, solution),
        "status": solution.status.name,
        "found_by": solution.stats.found_by,
        "phases": {name: round(seconds, 4) for name, seconds in solution.stats.seconds.items()},
    }


def middle(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Medians of some plans: seconds of all, the rest of those that found a path; how many did not."""
    checks = [run["valid"] for run in runs if run["valid"] is not None]
    return {
        "robots": runs[0]["robots"],
        "runs": len(runs),
        "failures": sum(run["failures"] for run in runs),
        **{key: _median([run[key] for run in runs]) for key in ("seconds", "first", "first_ratio", "ratio")},
        "valid": all(checks) if checks else None,
        "status": ", ".join(dict.fromkeys(run["status"] for run in runs)),
    }


def _median(values: list[float | None]) -> float | None:
    """The median of the values there are."""
    known = [value for value in values if value is not None]
    return round(float(np.median(known)), 5) if known else None


def table_of(results: dict[str, Any]) -> str:
    """The rows of a section, and what it says if it was skipped."""
    return aligned([HEAD, *map(_cells, results["rows"])], 6) + results.get("skipped", "")


def _cells(row: dict[str, Any]) -> list[str]:
    path = {True: "valid", False: "INVALID", None: row["status"]}[row["valid"]]
    forms = {"first": ".3f", "first_ratio": ".3f", "seconds": ".3f", "ratio": ".4f"}
    numbers = [or_dash(row[key], form) for key, form in forms.items()]
    return [row["scene"], path, f"{row['robots']}", f"{row['failures']}/{row['runs']}", *numbers]
