"""The race of Table II in short: cost over time of BL with PLRs and of OMPL's planners, at marks of time.

``python -m experiments.race`` runs all scenes, three starts each and up to 8 s a trial, for 13 minutes, and draws
cost over time. Here its own functions run on five scenes, one start each, with a limit of 2 s, so that the numbers
belong to the machine and the versions of the other sections; a table says what each planner's best path so far costs
at each mark. BL's seconds leave out building the PLRs, which is in a column of its own. There is no figure: the
race's has the same lines and more of them.
"""

import importlib.util
from typing import Any

import numpy as np
from tqdm import tqdm

from experiments import race
from experiments._tables import aligned

SCENES, SMOKE_SCENES = ("single door", "four rooms 4", "four rooms 8", "cross 3", "tangle"), ("single door",)
LIMIT, SMOKE_LIMIT = 2.0, 0.3
MARKS = (0.01, 0.03, 0.1, 0.3, 1.0, 2.0)


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    absent = [module for module in ("ompl", "numba") if importlib.util.find_spec(module) is None]
    if absent:
        return {"skipped": f"not installed: {', '.join(absent)} (pip install '.[baselines]')"}
    names, limit = (SMOKE_SCENES, SMOKE_LIMIT) if smoke else (SCENES, LIMIT)
    trials = [race.race(name, seed, limit, limit) for name in tqdm(names, desc="race", disable=None)]
    return {
        "limit": limit,
        "planners": list(race.PLANNERS),
        "trials": trials,
        "summary": [race.summary([trial]) for trial in trials],
    }


def cost_at(attempt: dict[str, Any], mark: float) -> float | None:
    """Cost of the best path that was there at a time; None if there was none."""
    known = np.array(attempt["history_seconds"]) <= mark
    return min(np.array(attempt["history_cost"])[known].tolist(), default=None)


def table(results: dict[str, Any]) -> str:
    if "skipped" in results:
        return f"skipped, {results['skipped']}\n"
    marks = [mark for mark in MARKS if mark <= results["limit"]]
    rows = [["scene", "planner", "build s", *(f"{mark:g} s" for mark in marks), "valid"]]
    for trial in results["trials"]:
        ours = trial["ours"]
        build = f"{ours['seconds_oracle'] + ours['seconds_plr']:.2f}"
        attempts = {race.OURS: (ours, build), **{name: (each, "") for name, each in trial["ompl"].items()}}
        for name, (attempt, seconds) in attempts.items():
            costs = [cost_at(attempt, mark) for mark in marks]
            over = ["-" if cost is None else f"{cost / trial['lower_bound']:.3f}" for cost in costs]
            valid = {None: "-", True: "yes", False: "no"}[attempt["valid"]]
            rows.append([trial["scene"], name, seconds, *over, valid])
    head = "Cost of the best path so far over the lower bound"
    return f"{head}\n\n{aligned(rows, numbers=len(rows[0]) - 2)}\n{race.summary_table(results)}"
