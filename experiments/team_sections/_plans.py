"""What the sections on teams share: two teams of a kind, a plan that is timed and checked, medians, and a table."""

from typing import Any

import numpy as np

from experiments._planning import plan_and_check, reversed_team
from experiments._tables import aligned, or_dash
from plr_jax import BLOptions, Problem, scenes

NUMBERS = ("first", "first_ratio", "seconds", "ratio")
FORMS = dict(zip(NUMBERS, (".3f", ".3f", ".3f", ".4f"), strict=True))
HEAD = ["scene", "path", "robots", "no path", "s to the first", "its ratio", "s in all", "ratio"]


def two_teams(scene: str, size: int, seed: int, variant: int = 0) -> tuple[Problem, Problem]:
    """A team to plan before another, and that other one: of one scene and size, in the same workspace.

    Variants of a crowd have starts and goals of their own; those of another scene are perturbed, but for the first.
    The team before goes from the other's goals to its starts.
    """
    if scene == "crowd":
        problem = scenes.crowd(size, seed + variant)
    else:
        problem = getattr(scenes, scene)(size)
        problem = scenes.perturbed(problem, seed + variant) if variant else problem
    return reversed_team(problem), problem


def planned(problem: Problem, bound: float, options: BLOptions | None = None) -> dict[str, Any]:
    """A plan, timed from call to return; its first path and its last are checked. Costs are over a bound."""
    solution, seconds, valid = plan_and_check(problem, None, options or BLOptions())
    history = solution.stats.history
    return {
        "robots": len(problem.robots),
        "runs": 1,
        "failures": int(not solution.solved),
        "seconds": round(seconds, 4),
        "first": round(history[0][0], 4) if history else None,
        "first_ratio": round(history[0][1] / bound, 5) if history else None,
        "ratio": round(solution.cost / bound, 5) if history else None,
        "valid": valid,
        "status": solution.status.name,
        "found_by": solution.stats.found_by,
        "phases": {name: round(seconds, 4) for name, seconds in solution.stats.seconds.items()},
    }


def middle(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Medians of some plans, and the largest: seconds of all, the rest of those with a path; how many have none."""
    checks = [run["valid"] for run in runs if run["valid"] is not None]
    return {
        "robots": runs[0]["robots"],
        "runs": len(runs),
        "failures": sum(run["failures"] for run in runs),
        **{key: _median([run[key] for run in runs]) for key in NUMBERS},
        "largest": {key: max((run[key] for run in runs if run[key] is not None), default=None) for key in NUMBERS},
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


def cell(row: dict[str, Any], key: str, form: str) -> str:
    """A number, or the median of several and in brackets the largest."""
    largest = row.get("largest", {}).get(key)
    return or_dash(row[key], form) + ("" if largest is None else f" ({largest:{form}})")


def _cells(row: dict[str, Any]) -> list[str]:
    path = {True: "valid", False: "INVALID", None: row["status"]}[row["valid"]]
    numbers = [cell(row, key, form) for key, form in FORMS.items()]
    return [row["scene"], path, f"{row['robots']}", f"{row['failures']}/{row['runs']}", *numbers]
