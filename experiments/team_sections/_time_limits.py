"""How late calls of ``bl_plan`` return whose time is over, at work that never ends before: 200 of them.

Scenes take turns, and are more than those whose motions are kept: each call builds them anew, within its limit.
"""

from typing import Any

import numpy as np
from tqdm import tqdm

from experiments._planning import EXACT, build, is_valid, plan
from experiments._planning import SCENES as OF_TABLE_TWO
from experiments._tables import aligned
from plr_jax import BLOptions, scenes

NUM_RUNS = 200
SHORTEST, LONGEST = 0.1, 5.0
LATE, LATE_SHARE = 0.2, 0.1  # seconds, or share of the limit if that is more
SCENES = {
    **OF_TABLE_TWO,
    **{f"door {size}": lambda size=size: scenes.door(size) for size in (20, 50)},
    **{f"crowd {size}": lambda size=size: scenes.crowd(size) for size in (25, 50, 100)},
}


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    rng, rows = np.random.default_rng(seed), []
    problems = {name: scene() for name, scene in list(SCENES.items())[: 2 if smoke else None]}
    heuristics = {name: build(problem, EXACT).heuristic for name, problem in problems.items()}
    for run in tqdm(range(4 if smoke else NUM_RUNS), desc="time limits", delay=3, disable=None):
        name = list(problems)[run % len(problems)]
        limit = 0.1 if smoke else float(np.exp(rng.uniform(np.log(SHORTEST), np.log(LONGEST))))
        heuristic = heuristics[name] if run // len(problems) % 2 else None
        # No path costs as little as that, so that improving goes on until the time is over.
        solution, seconds = plan(problems[name], heuristic, BLOptions(cost_factor=1e-9, time_limit=limit))
        valid = is_valid(problems[name], solution)
        row = {"scene": name, "limit": round(limit, 4), "late": round(seconds - limit, 4), "valid": valid}
        rows.append({**row, "status": solution.status.name, "given": heuristic is not None})
    return {"rows": rows}


def is_late(row: dict[str, Any]) -> bool:
    return row["late"] > max(LATE, LATE_SHARE * row["limit"])


def table(results: dict[str, Any]) -> str:
    rows = [["scene", "runs", "worst s late", "too late", "paths", "not valid"]]
    for name in dict.fromkeys(row["scene"] for row in results["rows"]):
        runs = [row for row in results["rows"] if row["scene"] == name]
        valid = [row["valid"] for row in runs]
        counts = sum(map(is_late, runs)), sum(v is not None for v in valid), sum(v is False for v in valid)
        worst = max(row["late"] for row in runs)
        rows.append([name, str(len(runs)), f"{worst:.3f}", *map(str, counts)])
    return aligned(rows, 5)
